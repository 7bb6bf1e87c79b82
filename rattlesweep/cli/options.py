"""What commands share: how they are made and end, their options, the kinds of their values."""

from __future__ import annotations

import json
import pkgutil
from collections.abc import Callable
from contextlib import suppress
from functools import partial
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
MOST_ROWS = 20  # of a table that is printed


class Command(click.Command):
    """A command; its function returns the exit code, or None if all is done."""

    section = ""

    def invoke(self, ctx: click.Context) -> None:
        """Check the environment, call the function and end with its exit code."""
        check_settings()
        with listening(Bar.of_command(bool(ctx.params.get("quiet"))).compiling):
            code = super().invoke(ctx)
        ctx.exit(code or DONE)


COMMANDS: list[Command] = []


def command(section: str, *examples: str) -> Callable[[Callable[..., Any]], Command]:
    """Make a function a command, listed in a section, whose help ends with some examples."""

    def make(function: Callable[..., Any]) -> Command:
        head = "Examples" if len(examples) > 1 else "Example"
        made = click.command(cls=Command, epilog="\n  ".join([f"\b\n{head}:", *examples]))(function)
        made.section = section
        COMMANDS.append(made)
        return made

    return make


def say(text: str) -> None:
    """Write a line to standard error, where everything goes that is not data."""
    click.echo(printable(text), err=True)


def to_json(data: Any) -> str:
    """Return data as JSON that every reader takes."""
    return json.dumps(data, indent=2, allow_nan=False, default=str)


def probe(*files: Path | None) -> None:
    """Raise an OutputError if files cannot be written, before anything is computed."""
    from rattlesweep.sweeps.files import probe_directory

    for path in filter(None, files):
        if path.is_dir():
            raise OutputError(f"cannot write {path}: a directory is in the way")
        probe_directory(path.parent)


def pick(given: dict[str, Any], *names: str) -> dict[str, Any]:
    """Take options out of all that were read, and return those that were given."""
    taken = {name: given.pop(name) for name in names if name in given}
    return {name: value for name, value in taken.items() if value is not None}


class Kind(click.ParamType):  # type: ignore[type-arg]
    """Values that a function reads from text, and refuses by a ValueError.

    The function may be given by its place, ``module:function``, if its module takes long to import.
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
            flag = "" if param is None else max(param.opts, key=len)
            raise ConfigError(f"{flag} {one_line(value)}".strip() + f": {error}") from None


def _numbers(example: str, low: float, high: float, text: str) -> tuple[float, ...]:
    """Read as many numbers as an example has, with commas between them."""
    with suppress(ValueError):
        values = tuple(map(float, text.split(",")))
        if len(values) == 1 + example.count(",") and all(low <= x <= high for x in values):
            return values
    raise ValueError(f"give numbers from {low:g} to {high:g}, as in {example}")


def _measured(kind: str, text: str) -> float | str:
    """Read a number in the body's units, or check one with an SI unit; without a kind, a word."""
    with suppress(ValueError):
        return float(text)
    if kind:
        quantity(text, kind)
    return text


def several(metavar: str, kind: str, *counts: int) -> Kind:
    """Return the kind of so many quantities with one unit."""
    return Kind(metavar, lambda text: quantities(text, kind, *counts))


def names(text: str) -> tuple[str, ...]:
    """Return what stands between commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _directory(text: str) -> Path:
    if not text:
        raise ValueError("the directory has no name; give one")
    return Path(text)


def _file(endings: tuple[str, ...], text: str) -> Path:
    if not text.lower().endswith(endings):
        raise ValueError(f"the name must end in {' or '.join(endings)}")
    return Path(text)


PICTURES = (".svg", ".png", ".pdf")
COUNT = click.IntRange(1)
TIME = Kind("time", seconds_of)
SIZE = Kind("w,h", partial(_numbers, "7,4.5", 1, 24))
LIMITS = Kind("low,high", partial(_numbers, "0.01,0.1", -1e12, 1e12))
VECTOR = Kind("x,y,z", partial(_numbers, "0,0,-1", -1e12, 1e12))
SPIN, DURATION, LENGTH, ENERGY = (
    Kind(kind, partial(_measured, kind)) for kind in ("spin", "time", "length", "energy")
)
DAMPING = Kind("sigma", partial(_measured, "torque per spin"))
MASS, HEIGHT, ANGLE = (Kind(k, partial(quantity, kind=k)) for k in ("mass", "length", "angle"))
# The modules that hold these words too take long to import; a test compares.
PRESETS = Choice(["GH", "KL"])
MODELS = Choice(["full", "reduced", "gh"])
ACCURACIES = Choice(["draft", "standard", "reference"])
KINDS = Choice(["fractions", "times", "ratio", "map", "reversals", "distribution", "scatter"])


def stack(*decorators: Decorator) -> Decorator:
    """Return one decorator for several options, in this order."""

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return add


def output(help: str = "Output directory; overrides the config's.", **settings: Any) -> Decorator:
    """Return the option of the directory to write."""
    return option("-o", "--output", type=Kind("dir", _directory), help=help, **settings)


def file(name: str, *endings: str, help: str, **settings: Any) -> Decorator:
    """Return the option of a file to write, whose ending tells the format."""
    names = ("-o", name) if name == "--output" else (name,)
    return option(*names, type=Kind("file", partial(_file, endings)), help=help, **settings)


def path(name: str, **settings: Any) -> Decorator:
    """Return an argument that is a path."""
    return argument(name, type=click.Path(path_type=Path), **settings)


directory = path("directory")
overrides = option("--set", "overrides", metavar="KEY=VALUE", multiple=True, help="Override a key "
                   "of the config, as in bodies.samples=10; may be repeated.")  # fmt: skip
sweep = stack(path("config"), output(), overrides)
threads = option("-j", "--threads", type=click.IntRange(1, MOST_THREADS), metavar="N",
                 help="Threads of the kernel; by default one for each processor.")  # fmt: skip
title = option("--title", metavar="TEXT", help="Title of the page.")
as_json = option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
quiet = option("-q", "--quiet", is_flag=True, help="No progress, closing words or warnings.")
figure = file("--figure", *PICTURES, help="Also draw a figure, an .svg, .png or .pdf file.")
data = file("--data", ".csv", ".parquet", help="Also write the numbers, as .csv or .parquet.")
t_end = option("--t-end", type=DURATION, help="Horizon, in sqrt(a/g) or as in 20s; by default "
               "5 t_rGH, or that of the sweep.")  # fmt: skip
from_time = option("--from-time", type=DURATION, help="Time of the first row, likewise.")
where = option("--where", metavar="CONDITION", help="Runs for which a pandas query on their "
               "columns is true, as in 'type == \"SW\" and K_r < 0.005'.")  # fmt: skip
which = stack(
    option("--case", type=int, help="Case of the run."),
    option("--sample", type=int, help="Sample of the run."),
    where,
)

BODY = ("preset", "alpha", "beta", "gamma", "f_sd", "theta", "phi", "xi", "xi_deg", "c", "mass",
        "height", "inertia", "radii", "axes_angle", "z_up",
        "half_ellipsoid", "skew", "weights", "at")  # fmt: skip
body = stack(
    option("--preset", type=PRESETS, help="A body of Garcia and Hubbard, Kane and Levinson."),
    option("--alpha", type=float, help="I_xx + 1, in M a^2."),
    option("--beta", type=float, help="I_yy + 1, in M a^2."),
    option("--gamma", type=float, help="I_zz, in M a^2."),
    option("--f-sd", type=float, help="I_yy/I_zz of a shell-dumbbell body; replaces alpha, beta."),
    option("--theta", type=float, help="Larger principal curvature, in 1/a."),
    option("--phi", type=float, help="Smaller principal curvature, in 1/a."),
    option("--xi", type=float, help="Skew angle in radians."),
    option("--xi-deg", type=float, help="Skew angle in degrees."),
    option("--c", type=LENGTH, help="Vertical semi-axis of an ellipsoid, in a, or as in 2cm."),
    option("--mass", type=MASS, help="Instead of all these, a body in SI units: mass, as in 85g."),
    option("--height", type=HEIGHT, help="Height of the centre of mass over the contact."),
    option("--inertia", type=several("ixx,iyy,izz,ixy unit", "moment of inertia", 3, 4, 5, 6),
           help="About the centre of mass, as in '2,16,17,-0.2 kg cm^2'."),
    option("--radii", type=several("r1,r2 unit", "length", 2),
           help="Principal radii of curvature at the bottom, as in '50,1.5 cm'."),
    option("--axes-angle", type=ANGLE, help="Angle from the x axis of --inertia to the first of "
           "--radii."),
    option("--z-up", is_flag=True, default=None, help="The z axis of --inertia points up."),
    option("--half-ellipsoid", type=several("length,width,height", "length", 3),
           help="Instead of height, inertia and radii: a solid half ellipsoid with its flat side "
                "up, as in 12cm,3cm,12mm; --mass is without weights."),
    option("--skew", type=ANGLE, help="Turns its axes of inertia clockwise, seen from above."),
    option("--weights", type=MASS, help="Mass of each of two weights on its flat side."),
    option("--at", type=several("x,y", "length", 2), help="Place of one weight from the middle, "
           "along and across, as in 45,-9mm; the other lies opposite."),
)  # fmt: skip
dissipation = stack(
    option("--sigma", type=DAMPING, help="Dissipation: sigma of a torque -sigma omega, in "
           "M a^2 sqrt(g/a), or as in '1e-4 N m s'."),
    option("--rolling", type=LENGTH, help="Lever of a rolling resistance, in a, or as in 50um."),
)  # fmt: skip
SPIN_DEFAULTS = {"n_i": 0.1, "omega_xy0": 0.01}
spin = stack(
    option("--n-i", type=SPIN, help="Initial spin, in sqrt(g/a) or as in 60rpm.  [default: 0.1]"),
    option("--omega-xy0", type=SPIN, help="Initial oscillation, likewise.  [default: 0.01]"),
)
launch = stack(
    spin,
    option("--psi", type=Kind("direction", partial(_measured, "")), help="Direction of the "
           "oscillation: relevant, pitch, roll, or degrees.  [default: relevant]"),
    option("--omega", type=VECTOR, help="A full state instead: angular velocity along the body's "
           "axes, in sqrt(g/a)."),
    option("--u", type=VECTOR, help="Vertical unit vector along these.  [default: 0,0,-1]"),
    dissipation,
    t_end,
    option("--method", type=Choice(list(METHODS)), help="Method.  [default: dop853]"),
    option("--tol", type=float, help="Tolerance of an adaptive method.  [default: 1e-9]"),
    option("--dt-step", type=float, help="Step of a fixed-step method.  [default: 0.002]"),
    option("--accuracy", type=ACCURACIES, help="Instead of a method and its tolerance."),
)  # fmt: skip
ROWS = ("points", "dt", "steps", "from_time")
rows = stack(
    option("--points", type=int, help="Number of rows, evenly spaced up to the horizon.  "
           "[default: 2001, or 20 per pitch period if that is more]"),
    option("--dt", type=DURATION, help="Spacing of the rows in time."),
    option("--steps", is_flag=True, default=None, help="One row per accepted step."),
    from_time,
)  # fmt: skip
