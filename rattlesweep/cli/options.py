"""What commands share: their class, their options, and the types of the values of
these.
"""
# ruff: noqa: D102, D103 - names and types say it

import json
import pkgutil
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial, reduce
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import Any

import click
from click import Choice, argument, option

from rattlesweep.errors import ConfigError, OutputError, one_line, printable
from rattlesweep.integrate import MOST_THREADS, check_settings
from rattlesweep.integrate.compile import listening
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.text import Bar
from rattlesweep.units import quantities, quantity, seconds_of

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
DONE, FAILED, WRONG, SOME_FAILED, EARLY = 0, 1, 2, 3, 75  # exit codes
MOST_ROWS = 20  # rows of a table that are printed


class Command(click.Command):
    """A command whose function returns the exit code, or None for success."""

    section = ""

    def invoke(self, ctx: click.Context) -> None:
        check_settings()
        if self.section == "Sweeps":
            start_without_pandas()
        with listening(Bar.of_command(bool(ctx.params.get("quiet"))).compiling):
            code = super().invoke(ctx)
        ctx.exit(code or DONE)


COMMANDS: list[Command] = []


class _NoPandas(MetaPathFinder):
    """A finder of modules that says of pandas that it is not installed."""

    def find_spec(self, name: str, *_: object) -> None:
        if name == "pandas":
            raise ModuleNotFoundError(name)


def start_without_pandas() -> None:
    """Keep pyarrow from importing pandas, which takes a third of a short command.

    With its first array pyarrow looks for pandas, and so imports it, only to recognise
    its types.  If that fails, it looks again where it needs pandas.
    """
    import pyarrow as pa

    if "pandas" not in sys.modules:
        finder = _NoPandas()
        sys.meta_path.insert(0, finder)
        try:
            pa.array([0.0])
        finally:
            sys.meta_path.remove(finder)


def command(section: str, *examples: str) -> Callable[[Callable[..., Any]], Command]:
    """Make a function a command of a section, with examples at the end of its help."""
    epilog = "\n  ".join(["\b\nExamples:", *examples])

    def make(function: Callable[..., Any]) -> Command:
        made = click.command(cls=Command, epilog=epilog)(function)
        made.section = section
        COMMANDS.append(made)
        return made

    return make


def say(text: str) -> None:
    """Print a line to standard error, where everything but data goes."""
    click.echo(printable(text), err=True)


def to_json(data: Any) -> str:
    return json.dumps(data, indent=2, allow_nan=False, default=str)


def probe(*files: Path | None) -> None:
    """Raise an OutputError before the work begins if files cannot be written after
    it.
    """
    from rattlesweep.sweeps.files import probe_directory

    for path in filter(None, files):
        if path.is_dir():
            raise OutputError(f"cannot write {path}: a directory is in the way")
        probe_directory(path.parent)


def pick(given: dict[str, Any], *names: str) -> dict[str, Any]:
    """Remove options from `given`, and return those that have a value."""
    taken = {name: given.pop(name) for name in names if name in given}
    return {name: value for name, value in taken.items() if value is not None}


class Kind(click.ParamType):  # type: ignore[type-arg]
    """The type of values that a function, perhaps at ``module:function``, reads or
    refuses.
    """

    def __init__(self, name: str, read: Callable[[str], Any] | str) -> None:
        self.name, self._read = name, read

    def convert(self, value: Any, param: click.Parameter | None, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        read = (
            pkgutil.resolve_name(self._read)
            if isinstance(self._read, str)
            else self._read
        )
        try:
            return read(value)
        except ValueError as error:
            flag = "" if param is None else max(param.opts, key=len)
            raise ConfigError(
                f"{flag} {one_line(value)}".strip() + f": {error}"
            ) from None


def _number(kind: type[int] | type[float], low: float, high: float, text: str) -> float:
    with suppress(ValueError):
        if low <= (value := kind(text)) <= high:
            return value
    what = "whole number" if kind is int else "number"
    raise ValueError(f"give a {what} from {low:g} to {high:g}")


def _numbers(example: str, low: float, high: float, text: str) -> tuple[float, ...]:
    """Read numbers between commas, as many as in an example."""
    with suppress(ValueError):
        values = tuple(map(float, text.split(",")))
        if len(values) == 1 + example.count(",") and all(
            low <= x <= high for x in values
        ):
            return values
    raise ValueError(f"give numbers from {low:g} to {high:g}, as in {example}")


def _measured(kind: str, text: str) -> float | str:
    """Read a number, or a quantity in SI units, which stays a text; or a word if no
    kind is set.
    """
    with suppress(ValueError):
        return float(text)
    if kind:
        quantity(text, kind)
    return text


def several(metavar: str, kind: str, *counts: int) -> Kind:
    return Kind(metavar, lambda text: quantities(text, kind, *counts))


def _directory(text: str) -> Path:
    if not text:
        raise ValueError("the directory has no name; give one")
    return Path(text)


def _file(endings: tuple[str, ...], text: str) -> Path:
    if not text.lower().endswith(endings):
        raise ValueError(f"the name must end in {' or '.join(endings)}")
    return Path(text)


PICTURES = (".svg", ".png", ".pdf")
COUNT, NUMBER = (Kind("n", partial(_number, int, least, 1e12)) for least in (1, 0))
THREADS = Kind("n", partial(_number, int, 1, MOST_THREADS))
SHARE = Kind("share", partial(_number, float, 0, 1))
DPI = Kind("dpi", partial(_number, float, 20, 600))
TIME = Kind("time", seconds_of)
NAMES = Kind(
    "a,b,...", lambda text: tuple(x.strip() for x in text.split(",") if x.strip())
)
SIZE = Kind("w,h", partial(_numbers, "7,4.5", 1, 24))
LIMITS = Kind("low,high", partial(_numbers, "0.01,0.1", -1e12, 1e12))
VECTOR = Kind("x,y,z", partial(_numbers, "0,0,-1", -1e12, 1e12))
_MEASURED = ("spin", "time", "length", "energy")
SPIN, DURATION, LENGTH, ENERGY = (
    Kind(kind, partial(_measured, kind)) for kind in _MEASURED
)
DAMPING = Kind("sigma", partial(_measured, "torque per spin"))
MASS, HEIGHT, ANGLE = (
    Kind(k, partial(quantity, kind=k)) for k in ("mass", "length", "angle")
)
# Repeated here, as the modules that define these words are slow to import; a test
# compares them.
PRESETS = Choice(["GH", "KL"])
MODELS = Choice(["full", "reduced", "gh"])
ACCURACIES = Choice(["draft", "standard", "reference"])
KINDS = Choice(
    ["fractions", "times", "ratio", "map", "reversals", "distribution", "scatter"]
)


def stack(*decorators: Decorator) -> Decorator:
    return lambda function: reduce(
        lambda made, each: each(made), reversed(decorators), function
    )


def group(*rows: tuple[str, Any, str]) -> Decorator:
    """Return one decorator for several options, each a name, a type (None: a flag) and
    a help.
    """
    return stack(
        *(
            option(name, type=kind, is_flag=kind is None, default=None, help=words)
            for name, kind, words in rows
        )
    )


def output(
    help: str = "Output directory; overrides the config's.", **settings: Any
) -> Decorator:
    return option("-o", "--output", type=Kind("dir", _directory), help=help, **settings)


def file(name: str, *endings: str, help: str, **settings: Any) -> Decorator:
    names = ("-o", name) if name == "--output" else (name,)
    return option(
        *names, type=Kind("file", partial(_file, endings)), help=help, **settings
    )


def path(name: str, **settings: Any) -> Decorator:
    return argument(name, type=click.Path(path_type=Path), **settings)


directory = path("directory")
overrides = option(
    "--set",
    "overrides",
    metavar="KEY=VALUE",
    multiple=True,
    help="Override a key of the config, as in bodies.samples=10; may be repeated.",
)
sweep = stack(path("config"), output(), overrides)
threads = option(
    "-j", "--threads", type=THREADS, help="Threads; by default one per processor."
)
title = option("--title", metavar="TEXT", help="Title of the page.")
as_json = option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
quiet = option(
    "-q", "--quiet", is_flag=True, help="Print no progress, summaries or warnings."
)
figure = file(
    "--figure", *PICTURES, help="Also draw a figure, an .svg, .png or .pdf file."
)
data = file(
    "--data", ".csv", ".parquet", help="Also write the numbers, as .csv or .parquet."
)
t_end = group(
    (
        "--t-end",
        DURATION,
        "Horizon, in sqrt(a/g) or as in 20s; by default 5 t_rGH, or that of the sweep.",
    )
)
from_time = group(
    ("--from-time", DURATION, "Time of the first row, in sqrt(a/g) or as in 2s.")
)
where = option(
    "--where",
    metavar="CONDITION",
    help="Only runs that meet a pandas query, as in 'type == \"SW\" and K_r < 0.005'.",
)
which = stack(
    group(("--case", int, "Case of the run."), ("--sample", int, "Its sample.")), where
)

_BODY: tuple[tuple[str, Any, str], ...] = (
    ("--preset", PRESETS, "The body of Garcia and Hubbard, or of Kane and Levinson."),
    ("--alpha", float, "I_xx + 1, in M a^2."),
    ("--beta", float, "I_yy + 1, in M a^2."),
    ("--gamma", float, "I_zz, in M a^2."),
    ("--f-sd", float, "I_yy/I_zz of a shell-dumbbell body; replaces alpha, beta."),
    ("--theta", float, "Larger principal curvature, in 1/a."),
    ("--phi", float, "Smaller principal curvature, in 1/a."),
    ("--xi", float, "Skew angle in radians."),
    ("--xi-deg", float, "Skew angle in degrees."),
    ("--c", LENGTH, "Vertical semi-axis of an ellipsoid, in a, or as in 2cm."),
    ("--mass", MASS, "Instead of all these, a body in SI units: mass, as in 85g."),
    ("--height", HEIGHT, "Height of the centre of mass over the contact."),
    (
        "--inertia",
        several("ixx,iyy,izz,ixy unit", "moment of inertia", 3, 4, 5, 6),
        "Inertia about the centre of mass, as in '2,16,17,-0.2 kg cm^2'.",
    ),
    (
        "--radii",
        several("r1,r2 unit", "length", 2),
        "Principal radii of curvature at the bottom, as in '50,1.5 cm'.",
    ),
    (
        "--axes-angle",
        ANGLE,
        "Angle from the x axis of --inertia to the first of --radii.",
    ),
    ("--z-up", None, "The z axis of --inertia points up."),
    (
        "--half-ellipsoid",
        several("length,width,height", "length", 3),
        "Instead of height, "
        "inertia and radii: a solid half ellipsoid, flat side up, as in 12cm,3cm,12mm.",
    ),
    (
        "--skew",
        ANGLE,
        "Angle by which its axes of inertia are turned, clockwise from above.",
    ),
    (
        "--weights",
        MASS,
        "Mass of each of two equal weights on its flat side, not in --mass.",
    ),
    (
        "--at",
        several("x,y", "length", 2),
        "Place of one weight, along and across from the "
        "middle, as in 45,-9mm; the other lies opposite.",
    ),
    (
        "--wall",
        HEIGHT,
        "Thickness of an open shell, as in 2mm; without it the body is solid.",
    ),
)
BODY = [name[2:].replace("-", "_") for name, *_ in _BODY]
body = group(*_BODY)
dissipation = group(
    (
        "--sigma",
        DAMPING,
        "Dissipation by a torque -sigma omega, in M a^2 sqrt(g/a), or as in "
        "'1e-4 N m s'.",
    ),
    ("--rolling", LENGTH, "Lever of the rolling resistance, in a, or as in 50um."),
)
SPIN_DEFAULTS = {"n_i": 0.1, "omega_xy0": 0.01}
spin = group(
    ("--n-i", SPIN, "Initial spin, in sqrt(g/a) or as in 60rpm.  [default: 0.1]"),
    ("--omega-xy0", SPIN, "Initial oscillation, likewise.  [default: 0.01]"),
)
launch = stack(
    spin,
    group(
        (
            "--psi",
            Kind("direction", partial(_measured, "")),
            "Direction of the oscillation: "
            "relevant, pitch, roll, or degrees.  [default: relevant]",
        ),
        (
            "--omega",
            VECTOR,
            "Instead of these, a full state: angular velocity along the body's "
            "axes, in sqrt(g/a).",
        ),
        (
            "--u",
            VECTOR,
            "Vertical unit vector along the body's axes.  [default: 0,0,-1]",
        ),
    ),
    dissipation,
    t_end,
    group(
        ("--method", Choice(list(METHODS)), "Integrator.  [default: dop853]"),
        ("--tol", float, "Tolerance of an adaptive method.  [default: 1e-9]"),
        ("--dt-step", float, "Step of a fixed-step method.  [default: 0.002]"),
        ("--accuracy", ACCURACIES, "Instead of a method and its tolerance."),
    ),
)
rows = stack(
    group(
        (
            "--points",
            int,
            "Number of rows, evenly spaced up to the horizon.  "
            "[default: 2001, or 20 per pitch period if that is more]",
        ),
        ("--dt", DURATION, "Spacing of the rows in time."),
        ("--steps", None, "One row per accepted step."),
    ),
    from_time,
)
