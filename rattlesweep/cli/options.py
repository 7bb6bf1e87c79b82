"""Options that several commands have, and the kinds of their values."""

from __future__ import annotations

import math
import os
import pkgutil
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import click
from click import Choice, argument, option

from rattlesweep.durations import seconds_of
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.integrate import check_settings
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.units import quantities, quantity

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


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


def _numbers(count: int, fit: Callable[..., bool], wanted: str, text: str) -> tuple[float, ...]:
    """Read so many numbers, with commas between them, that fit."""
    with suppress(ValueError):
        values = tuple(map(float, text.split(",")))
        if len(values) == count and fit(*values):
            return values
    raise ValueError(wanted)


def _measured(kind: str, text: str) -> float | str:
    """Read a number in the body's units, or check one with an SI unit; a direction is a word."""
    with suppress(ValueError):
        return float(text)
    if kind != "direction":
        quantity(text, kind)
    return text


def names(text: str) -> tuple[str, ...]:
    """Return what stands between commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _directory(text: str) -> Path:
    if not text:
        raise ValueError("the directory has no name; give one")
    if text != text.encode(errors="replace").decode():
        raise ValueError("the name is not UTF-8; give one that is")
    return Path(text)


def _file(endings: tuple[str, ...], text: str) -> Path:
    if not text.lower().endswith(endings):
        known = " or ".join(", ".join(endings).rsplit(", ", 1))
        raise ValueError(f"the name must end in {known}")
    return Path(text)


def _check_threads(context: click.Context, _: click.Parameter, count: int | None) -> int | None:
    """Refuse more threads than Numba can start here, unless they are a scheduler's elsewhere."""
    check_settings()
    affinity = getattr(os, "sched_getaffinity", None)
    there = len(affinity(0)) if affinity else os.cpu_count() or 1
    most = int(os.environ.get("NUMBA_NUM_THREADS", there))
    if count is not None and count > most and not context.params.get("scheduler"):
        raise ConfigError(f"--threads {count}: is more than the {most} processors there are")
    return count


PICTURES = (".svg", ".png", ".pdf")
COUNT = click.IntRange(1)
TIME = Kind("time", seconds_of)
SIZE = Kind("w,h", partial(_numbers, 2, lambda w, h: 1 <= w <= 24 and 1 <= h <= 24,
            "give width and height in inches, each from 1 to 24, as in 7,4.5"))  # fmt: skip
LIMITS = Kind("low,high", partial(_numbers, 2, lambda a, b: -math.inf < a < b < math.inf,
              "give the lower and the upper end, as in 0.01,0.1"))  # fmt: skip
VECTOR = Kind("x,y,z", partial(_numbers, 3, lambda *xyz: True,
              "is no vector; give three numbers, such as 0,0,-1"))  # fmt: skip
SPIN, DURATION, LENGTH, ENERGY, DAMPING = (
    Kind(name, partial(_measured, kind))
    for name, kind in (("spin", "spin"), ("time", "time"), ("length", "length"),
                       ("energy", "energy"), ("sigma", "torque per spin"))
)  # fmt: skip
MASS, HEIGHT, ANGLE = (
    Kind(kind, partial(quantity, kind=kind)) for kind in ("mass", "length", "angle")
)
# The modules that hold these words too take long to import; a test compares.
PRESETS = Choice(["GH", "KL"])
ACCURACIES = Choice(["draft", "standard", "reference"])
MODELS = Choice(["full", "reduced", "gh"])
KINDS = Choice(["fractions", "times", "ratio", "map", "reversals", "distribution", "scatter"])


def stack(*decorators: Decorator) -> Decorator:
    """Return one decorator for several options, in this order."""

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return add


def pick(given: dict[str, Any], *names: str) -> dict[str, Any]:
    """Take options out of all that were read, and return those that were given."""
    taken = {name: given.pop(name) for name in names if name in given}
    return {name: value for name, value in taken.items() if value is not None}


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


config, directory = path("config"), path("directory")
overrides = option(
    "--set", "overrides", metavar="KEY=VALUE", multiple=True,
    help="Override a key of the config, such as bodies.samples=10; may be repeated.",
)  # fmt: skip
threads = option("-j", "--threads", type=COUNT, callback=_check_threads,
                 help="Threads of the kernel; by default one a processor.")  # fmt: skip
title = option("--title", metavar="TEXT", help="Title of the page.")
as_json = option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
quiet = option("-q", "--quiet", is_flag=True, help="No progress, closing words or warnings.")
figure = file("--figure", *PICTURES, help="Also draw a figure, an .svg, .png or .pdf file.")
data = file("--data", ".csv", ".parquet", help="Also write the numbers, as .csv or .parquet.")
t_end = option("--t-end", type=DURATION, help="Horizon, in sqrt(a/g), or as in 20s; by default "
               "5 t_rGH, or that of the sweep.")  # fmt: skip
from_time = option("--from-time", type=DURATION, help="Time of the first row, likewise.")

BODY = ("preset", "alpha", "beta", "gamma", "f_sd", "theta", "phi", "xi", "xi_deg", "c", "mass",
        "height", "inertia", "radii", "axes_angle", "z_up",
        "half_ellipsoid", "skew", "weights", "at")  # fmt: skip
body = stack(
    option("--preset", type=PRESETS,
           help="A named body (Garcia and Hubbard 1988, Kane and Levinson 1982)."),
    option("--alpha", type=float, help="I_xx + 1, in M a^2."),
    option("--beta", type=float, help="I_yy + 1, in M a^2."),
    option("--gamma", type=float, help="I_zz, in M a^2."),
    option("--f-sd", type=float, help="I_yy/I_zz of a shell-dumbbell body; replaces alpha, beta."),
    option("--theta", type=float, help="Larger principal curvature, in 1/a."),
    option("--phi", type=float, help="Smaller principal curvature, in 1/a."),
    option("--xi", type=float, help="Skew angle in radians."),
    option("--xi-deg", type=float, help="Skew angle in degrees."),
    option("--c", type=LENGTH, help="Vertical semi-axis of an ellipsoid, in a, or as in 2cm."),
    option("--mass", type=MASS, help="Instead of all these in SI units: mass, as in 85g."),
    option("--height", type=HEIGHT, help="Height of the centre of mass over the contact."),
    option("--inertia", type=Kind("ixx,iyy,izz,ixy unit",
           lambda text: quantities(text, "moment of inertia", 3, 4, 5, 6)),
           help="Inertia about the centre of mass, as in '2,16,17,-0.2 kg cm^2'."),
    option("--radii", type=Kind("r1,r2 unit", lambda text: quantities(text, "length", 2)),
           help="Principal radii of curvature at the bottom, as in '50,1.5 cm'."),
    option("--axes-angle", type=ANGLE,
           help="Angle from the x axis of --inertia to the direction of the first of --radii."),
    option("--z-up", is_flag=True, default=None, help="The z axis of --inertia points up."),
    option("--half-ellipsoid", type=Kind("length,width,height",
           lambda text: quantities(text, "length", 3)),
           help="Instead of height, inertia and radii: a solid half ellipsoid with its flat side "
                "up, as in 12cm,3cm,12mm; --mass is without weights."),
    option("--skew", type=ANGLE,
           help="Angle by which its axes of inertia are turned clockwise, seen from above."),
    option("--weights", type=MASS, help="Mass of each of two weights on its flat side."),
    option("--at", type=Kind("x,y", lambda text: quantities(text, "length", 2)),
           help="Place of one weight from the middle, along and across, as in 45,-9mm; the other "
                "one lies opposite."),
)  # fmt: skip
dissipation = stack(
    option("--sigma", type=DAMPING, help="Dissipation: sigma of a torque -sigma omega, in "
           "M a^2 sqrt(g/a), or as in '1e-4 N m s'."),
    option("--rolling", type=LENGTH, help="Dissipation: lever of a rolling resistance, in a, or "
           "as in 50um."),
)  # fmt: skip
SPIN_DEFAULTS = {"n_i": 0.1, "omega_xy0": 0.01}
spin = stack(
    option("--n-i", type=SPIN,
           help="Initial spin, in sqrt(g/a), or as in 60rpm.  [default: 0.1]"),
    option("--omega-xy0", type=SPIN,
           help="Initial oscillation, in sqrt(g/a), or as in 5rpm.  [default: 0.01]"),
)  # fmt: skip
launch = stack(
    spin,
    option("--psi", type=Kind("direction", partial(_measured, "direction")),
           help="Direction of the oscillation: relevant, pitch, roll, or degrees.  "
                "[default: relevant]"),
    option("--omega", type=VECTOR, help="A full state instead: angular velocity along the body's "
           "axes, in sqrt(g/a)."),
    option("--u", type=VECTOR,
           help="Vertical unit vector along the body's axes.  [default: 0,0,-1]"),
    dissipation,
    t_end,
    option("--method", type=Choice(list(METHODS)),
           help="Method of integration.  [default: dop853]"),
    option("--tol", type=float, help="Tolerance of an adaptive method.  [default: 1e-9]"),
    option("--dt-step", type=float, help="Step of a fixed-step method.  [default: 0.002]"),
    option("--accuracy", type=ACCURACIES,
           help="A named accuracy instead of a method and its tolerance."),
)  # fmt: skip
ROWS = ("points", "dt", "steps", "from_time")
rows = stack(
    option("--points", type=int, help="Number of rows, evenly spaced up to the horizon.  "
           "[default: 2001, or 20 per pitch period if that is more]"),
    option("--dt", type=DURATION, help="Spacing of the rows in time."),
    option("--steps", is_flag=True, default=None, help="One row per accepted step."),
    from_time,
)  # fmt: skip
where = option("--where", metavar="CONDITION", help="Runs for which a pandas query on their "
               "columns is true, as in 'type == \"SW\" and K_r < 0.005'.")  # fmt: skip
which = stack(
    option("--case", type=int, help="Case of the run."),
    option("--sample", type=int, help="Sample of the run."),
    where,
)
