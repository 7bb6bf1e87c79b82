"""Kinds of values on the command line; what is none of its kind is refused in one sentence."""

from __future__ import annotations

import math
import pkgutil
import unicodedata
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import click

from rattlesweep.durations import seconds_of
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.integrate import check_settings
from rattlesweep.integrate.tableau import METHODS as TABLEAUS
from rattlesweep.units import SI, quantities, quantity


def _flag(param: click.Parameter | None) -> str:
    return "" if param is None else max(param.opts, key=len)


class Grammar(click.ParamType):  # type: ignore[type-arg]
    """A kind that a function reads from text; its name stands in `--help`, in capitals.

    The function gives the value, or raises a ValueError that says what the text is and what to
    write; or it is said where such a function is, for modules that take long to load.
    """

    def __init__(self, name: str, read: Callable[[str], Any] | str) -> None:
        self.name, self._read = name, read

    def convert(self, value: Any, param: click.Parameter | None, ctx: Any) -> Any:
        """Read what was typed."""
        if not isinstance(value, str):
            return value
        read = pkgutil.resolve_name(self._read) if isinstance(self._read, str) else self._read
        try:
            return read(value)
        except ValueError as error:
            given = f"{_flag(param)} {one_line(value)}".strip()
            raise ConfigError(f"{given}: {error}") from None


class Choice(click.Choice[str]):
    """One of some words; what is nearly one of them is told.  Or a number, such as of degrees."""

    def __init__(self, words: Sequence[str], *, or_number: bool = False) -> None:
        super().__init__(words)
        self._or_number = or_number

    def convert(self, value: Any, param: click.Parameter | None, ctx: Any) -> Any:
        """Read what was typed."""
        if value in self.choices:
            return value
        if self._or_number:
            with suppress(ValueError):
                return float(value)
        # Not at import time, for the sake of `--help`; so below.
        from rattlesweep.sweeps.config.messages import not_one_of

        raise ConfigError(f"{_flag(param)}: {not_one_of(value, self.choices)}")


def check_threads(threads: int | None) -> int | None:
    """Refuse more threads than the kernels can use."""
    if threads is None:
        return None
    check_settings()
    from rattlesweep.integrate.batch import most_threads

    if threads > (most := most_threads()):
        raise click.BadParameter(f"{threads} is more than the {most} processors there are")
    return threads


def _numbers(
    count: int, fit: Callable[..., bool], wanted: str
) -> Callable[[str], tuple[float, ...]]:
    """So many numbers with commas between them that fit; what is none is told what is wanted."""

    def read(text: str) -> tuple[float, ...]:
        with suppress(ValueError):
            values = tuple(map(float, text.split(",")))
            if len(values) == count and fit(*values):
                return values
        raise ValueError(wanted)

    return read


def _measured(kind: str) -> Callable[[str], float]:
    """A plain number, in the body's units, or one with a unit, in SI units."""

    def read(text: str) -> float:
        try:
            return float(text)
        except ValueError:
            return SI(quantity(text, kind))

    return read


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _directory(text: str) -> Path:
    if not text:
        raise ValueError("the directory has no name; give one")
    if text != text.encode(errors="replace").decode():
        raise ValueError("the name is not UTF-8; give one that is")
    return Path(text)


PICTURES = (".svg", ".png", ".pdf")


def file(*endings: str) -> Grammar:
    """A file to write, of a format that the name's ending tells."""

    def read(text: str) -> Path:
        if not text.lower().endswith(endings):
            *others, last = endings
            wanted = f"{', '.join(others)} or {last}" if others else last
            raise ValueError(f"the name must end in {wanted}")
        return Path(text)

    return Grammar("file", read)


def _title(text: str) -> str:
    bad = next((c for c in text if unicodedata.category(c) in ("Cc", "Cs")), None)
    if bad is not None:
        what = "a control character" if unicodedata.category(bad) == "Cc" else "no text"
        raise ValueError(f"{ascii(bad)[1:-1]} in it is {what}; leave it out")
    return text


def _formula(text: str) -> str:
    from rattlesweep.analysis.style import formula_error

    if (error := formula_error(_title(text))) is not None:
        raise ValueError(
            f"what stands between dollar signs cannot be read as a formula ({error}); write \\$ "
            "for a dollar sign"
        )
    return text


TIME = Grammar("time", seconds_of)
SHARD = Grammar("i/n", "rattlesweep.sweeps.run:Shard.parse")
SLURM_TIME = Grammar("time", "rattlesweep.sweeps.slurm:limit_of")
SLURM_MEMORY = Grammar("size", "rattlesweep.sweeps.slurm:memory_of")
SIZE = Grammar("w,h", _numbers(2, lambda w, h: 1 <= w <= 60 and 1 <= h <= 60,
               "give width and height in inches, each from 1 to 60, as in 7,4.5"))  # fmt: skip
LIMITS = Grammar("low,high", _numbers(2, lambda low, high: -math.inf < low < high < math.inf,
                 "give the lower and the upper end, as in 0.01,0.1"))  # fmt: skip
MASS = Grammar("mass", partial(quantity, kind="mass"))
LENGTH = Grammar("length", partial(quantity, kind="length"))
RADII = Grammar("r1,r2 unit", lambda text: quantities(text, "length", 2))
INERTIA = Grammar(
    "ixx,iyy,izz,ixy unit", lambda text: quantities(text, "moment of inertia", 3, 4, 5, 6)
)
ANGLE = Grammar("angle", partial(quantity, kind="angle"))
SPIN = Grammar("spin", _measured("spin"))
DURATION = Grammar("time", _measured("time"))
SEMI_AXIS = LEVER = Grammar("length", _measured("length"))
DAMPING = Grammar("sigma", _measured("torque per spin"))
VECTOR = Grammar("x,y,z", _numbers(3, lambda *xyz: True,
                 "is no vector; give three numbers, such as 0,0,-1"))  # fmt: skip
NAMES = Grammar("a,b,...", _names)
DIRECTORY = Grammar("dir", _directory)
TITLE = Grammar("text", _title)
# A title that Matplotlib reads.
FORMULA = Grammar("text", _formula)
METHODS = Choice(list(TABLEAUS))
# What other registries hold, spelled out since `--help` loads none of them; a test compares.
PRESETS = Choice(["GH", "KL"])
ACCURACIES = Choice(["draft", "standard", "reference"])
MODELS = Choice(["full", "reduced", "gh"])
KINDS = Choice(["fractions", "times", "ratio", "map", "reversals", "distribution", "scatter"])
PSI = Choice(["relevant", "pitch", "roll"], or_number=True)
