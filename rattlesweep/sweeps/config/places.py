"""Where the keys of a config stand, and the lines that say what is wrong with them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.sweeps.config.yamlfile import Key, Problem

if TYPE_CHECKING:
    from rattlesweep.sweeps.config.schema import Config

Origin = tuple[int, int] | str
"""Line and column in the file, or the ``--set KEY=VALUE`` that gave the value."""

MAX_TOLD = 20
"""Problems told in full; of the rest only the number."""

_DOTTED = re.compile(r"[A-Za-z_]\w*(?:\.\w+|\[\d+\])*(?=: )")


def dotted(key: Key) -> str:
    """A key as people write it: ``bodies.ranges.theta[1]``."""
    text = ""
    for part in key:
        text += f"[{part}]" if isinstance(part, int) else f".{one_line(part)}"
    text = text.removeprefix(".")
    return text if len(text) <= 200 else f"{text[:120]}...{text[-77:]}"


@dataclass(frozen=True)
class Places:
    """Where a config's keys stand; all are equal, as places change no config.

    Attributes
    ----------
    file
        Name of the file as the user gave it; None for Python data.
    origins
        Place of each key that was given.
    """

    file: str | None = field(default=None, compare=False)
    origins: Mapping[Key, Origin] = field(default_factory=dict, compare=False)

    def rank(self, key: Key, position: tuple[int, int] | None = None) -> tuple[int, int, int]:
        """What problems are sorted by: their place in the file, then that among the settings."""
        origin = position if position is not None and self.file else self._origin(key)
        if isinstance(origin, tuple):
            return 0, *origin
        return (0 if origin is None else 1), 0, 0

    def line(self, problem: Problem) -> str:
        """One line: place, key, sentence."""
        origin = self._origin(problem.key)
        if problem.position is not None and self.file is not None:
            origin = problem.position
        place = f"{self.file}:{origin[0]}:{origin[1]}" if isinstance(origin, tuple) else origin
        return ": ".join(part for part in (place, dotted(problem.key), problem.message) if part)

    def lines(self, problems: Iterable[Problem], more: int = 0) -> list[str]:
        """A line per problem, in the order of their places; `more` are known only by number."""
        ordered = sorted(problems, key=lambda one: self.rank(one.key, one.position))
        lines = list(dict.fromkeys(self.line(problem) for problem in ordered))
        more += max(0, len(lines) - MAX_TOLD)
        if more:
            rest = f"and {more} more; fix these first"
            lines = [*lines[:MAX_TOLD], f"{self.file}: {rest}" if self.file else rest]
        return lines

    def locate(self, message: str) -> str:
        """`message` with its place in front if it begins with a key."""
        found = _DOTTED.match(message)
        if found is None:
            return message
        parts = re.findall(r"\w+", found[0])
        key: Key = tuple(int(part) if part.isdigit() else part for part in parts)
        return self.line(Problem(key, message[found.end() + 2 :]))

    def _origin(self, key: Key) -> Origin | None:
        """Place of a key, or of the nearest one around it."""
        while key not in self.origins and key:
            key = key[:-1]
        return self.origins.get(key)


@contextmanager
def locating(config: Config) -> Iterator[None]:
    """Give the messages of a ConfigError from inside the places of the keys they begin with."""
    try:
        yield
    except ConfigError as error:
        keys = type(config).model_fields
        raise ConfigError(
            config.places.locate(line) if re.split(r"\W", line)[0] in keys else line
            for line in error.messages
        ) from None
