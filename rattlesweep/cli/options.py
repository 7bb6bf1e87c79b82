"""What commands share: their class, their options, and the types of option values."""

import json
import pkgutil
import re
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from functools import partial, wraps
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import Any, TypeAlias

import click
from click import Choice, argument, option

from rattlesweep.compiling.loading import listening
from rattlesweep.kernel.method.tableau import DOP853, DT, METHODS
from rattlesweep.system.console import Bar, counted
from rattlesweep.system.processors import MOST_THREADS, check_settings
from rattlesweep.system.shipped import linked
from rattlesweep.words.defaults import (
    LAUNCH_PUSH,
    LAUNCH_SPIN,
    LEAST_ROWS,
    MESH_UNIT,
    ROWS_A_PERIOD,
)
from rattlesweep.words.engines import ENGINES
from rattlesweep.words.errors import (
    ConfigError,
    OutputError,
    as_lines,
    one_line,
    printable,
)
from rattlesweep.words.names import (
    ACCURACY_NAMES,
    DOCUMENT_NAMES,
    EXPORT_FORMATS,
    MODEL_NAMES,
    PLOT_NAMES,
    PRESET_NAMES,
)
from rattlesweep.words.quantities import LOSSES, QUANTITIES, RATE
from rattlesweep.words.units import (
    KINDS,
    Quantity,
    natural_number,
    quantities,
    quantity,
    seconds_of,
)

# A command returns its exit code, or None for success.
Function: TypeAlias = Callable[..., int | None]
Decorator: TypeAlias = Callable[[Function], Function]
Given: TypeAlias = dict[str, Any]  # options by name, of the types that they declare

# Exit codes.
DONE = 0
EXIT_FAILED = 1
WRONG = 2
SOME_FAILED = 3
EARLY = 75

SECTIONS = ("Sweeps", "Results of a sweep", "One run", "Studies", "Documentation")
PRINTED_ROWS = 60  # rows of a table that are printed


class Command(click.Command):
    """A command whose function returns the exit code, or None for success."""

    section = ""

    def format_help_text(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """Write the text of the help, with commands that print pages."""
        self.help = linked(self.help or "")
        super().format_help_text(ctx, formatter)

    def invoke(self, ctx: click.Context) -> None:
        """Run the command, and report the compilation of kernels."""
        check_settings()
        if self.section == "Sweeps":
            start_without_pandas()
        bar = Bar.of_command(bool(ctx.params.get("quiet")))
        with listening(bar.compiling):
            code = super().invoke(ctx)
        ctx.exit(code or DONE)


COMMANDS: list[Command] = []


def command(section: str, *examples: str) -> Callable[[Function], Command]:
    """Make a function a command of a section, with examples at the end of its help."""
    if section not in SECTIONS:
        raise ValueError(f"no section {section}")
    epilog = "\n  ".join(["\b\nExamples:", *examples])
    named = dict.fromkeys(re.findall(r"configs/(\w+)", epilog))
    if named:
        # Whoever has no clone has no configs yet.
        writers = [f"rattlesweep init --example {name}" for name in named]
        epilog += "\n\n" + "\n  ".join(["\b\nWrite these configs by:", *writers])

    def register(function: Function) -> Command:
        new = click.command(cls=Command, epilog=epilog)(function)
        new.section = section
        COMMANDS.append(new)
        return new

    return register


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


def say(text: str) -> None:
    """Print a line to standard error, where everything but data goes."""
    click.echo(printable(text), err=True)


def warn(text: str) -> None:
    """Print a warning to standard error, unless the command is to be quiet."""
    context = click.get_current_context(silent=True)
    if context is None or not context.params.get("quiet"):
        say(f"warning: {text}")


def tell(*lines: object) -> None:
    """Print lines to standard output, each of them safe for a terminal."""
    click.echo(as_lines(lines))


def to_json(data: object) -> str:
    """Return data as JSON; what is not finite is null.

    Numbers and arrays of NumPy are those of Python, and what JSON does not know is a
    text.
    """
    from pydantic_core import to_jsonable_python

    def known(value: Any) -> object:
        return value.tolist() if hasattr(value, "tolist") else str(value)

    plain = to_jsonable_python(data, fallback=known, inf_nan_mode="null")
    return json.dumps(plain, indent=2, allow_nan=False)


def print_result(as_json: bool, data: object, text: str) -> None:
    """Print the result of a command: as text, or its data as JSON."""
    click.echo(to_json(data) if as_json else text)


def probe_files(*files: Path | None) -> None:
    """Raise an OutputError before the work begins if a file cannot be written then."""
    from rattlesweep.system.files import probe_directory

    for path in files:
        if path is None:
            continue
        if path.is_dir():
            raise OutputError(f"cannot write {path}: a directory is in the way")
        if not path.parent.exists():
            # Its name may be mistyped.
            raise OutputError(
                f"cannot write in {path.parent}: there is no such folder; make it first"
            )
        probe_directory(path.parent)


def pick(given: Given, *names: str) -> Given:
    """Remove options from `given`, and return those that have a value."""
    taken = {name: given.pop(name) for name in names if name in given}
    return {name: value for name, value in taken.items() if value is not None}


def flag(name: str) -> str:
    """Return the flag of an argument."""
    if name == "shape":
        return "--half-ellipsoid"
    return f"--{name.replace('_', '-')}"


def refuse(given: Given, sentence: str) -> None:
    """Raise a ConfigError about the first option that has a value."""
    for name, value in given.items():
        if value is not None:
            raise ConfigError(f"{flag(name)}: {sentence}")


class Kind(click.ParamType):  # type: ignore[type-arg]
    """The type of values that a function reads, or refuses with a ValueError.

    The function may be named, as in ``module:function``, and is then imported when it
    is needed.
    """

    def __init__(self, name: str, read: Callable[[str], object] | str) -> None:
        self.name = name
        self._read = read

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> object:
        """Return the value of a text; defaults are values already."""
        if not isinstance(value, str):
            return value
        read = self._read
        if isinstance(read, str):
            read = pkgutil.resolve_name(read)
        try:
            return read(value)
        except ValueError as error:
            flag = "" if param is None else max(param.opts, key=len)
            what = f"{flag} {one_line(value)}".strip()
            raise ConfigError(f"{what}: {error}") from None


# Readers of single values, each with the refusal that its kind of value needs.


def _whole(low: int, high: float, text: str) -> int:
    with suppress(ValueError):
        if low <= int(text) <= high:
            return int(text)
    raise ValueError(f"give a whole number from {low:g} to {high:g}")


def _number(low: float, high: float, text: str) -> float:
    with suppress(ValueError):
        if low <= float(text) <= high:
            return float(text)
    raise ValueError(f"give a number from {low:g} to {high:g}")


def _numbers(example: str, low: float, high: float, text: str) -> tuple[float, ...]:
    """Read numbers between commas, as many as in an example."""
    count = 1 + example.count(",")
    given = text.split(",")
    if len(given) != count:
        raise ValueError(
            f"has {counted(len(given), 'number')}, and {count} are needed, as in "
            f"{example}"
        )
    with suppress(ValueError):
        values = tuple(map(float, given))
        if all(low <= value <= high for value in values):
            return values
    raise ValueError(f"give {count} numbers from {low:g} to {high:g}, as in {example}")


def _measured(kind: str, text: str) -> float | str:
    """Read a number, or check a quantity in SI units, which stays a text."""
    with suppress(ValueError):
        return float(text)
    if natural_number(text, kind) is None:
        quantity(text, kind)
    return text


def _points(text: str) -> list[tuple[Quantity, list[float | str]]]:
    """Read point masses with places, which are numbers or have units."""
    example = "as in '7.5g@45,-9,0; 7.5g@-45,9,0'"
    points = []
    for part in filter(str.strip, text.split(";")):
        mass, at, place = part.partition("@")
        coordinates = place.split(",")
        if not at or len(coordinates) != 3:
            raise ValueError(f"a point is no mass at a place; write it {example}")
        lengths = [_measured("length", coordinate) for coordinate in coordinates]
        points.append((Quantity(mass, "mass"), lengths))
    if not points:
        raise ValueError(f"has no point; write it {example}")
    return points


def _direction(text: str) -> float | str:
    """Read degrees, or a word, which the launch checks."""
    with suppress(ValueError):
        return float(text)
    return text


def _base(text: str) -> dict[str, float | str]:
    """Read a drive: a frequency, and an acceleration or an amplitude."""
    example = "as in 2.88,0.02 or 25Hz,0.1mm, or 1.44,0.02,90deg along the plane"
    parts = [part.strip() for part in text.split(",")]
    if len(parts) not in (2, 3):
        raise ValueError(f"is no frequency with an acceleration; write it {example}")
    frequency, strength, *azimuths = parts
    base = {"frequency": _measured("frequency", frequency)}
    for azimuth in azimuths:
        degrees = azimuth.removesuffix("deg").strip()
        try:
            base["azimuth_deg"] = float(degrees)
        except ValueError:
            raise ValueError(f"has no azimuth in degrees; write it {example}") from None
        base["direction"] = "horizontal"
    with suppress(ValueError):
        return base | {"acceleration": float(strength)}
    return base | {"amplitude": _measured("length", strength)}


def _materials(text: str) -> tuple[str | dict[str, str | float], ...]:
    """Read materials, each a name or as in ``E=3.5GPa nu=0.36``."""
    materials: list[str | dict[str, str | float]] = []
    for each in _names(text):
        constants: dict[str, str | float] = dict(
            re.findall(r"(\w+)\s*=\s*([^=]*?)\s*(?=\w+\s*=|$)", each)
        )
        if "nu" in constants:
            with suppress(ValueError):
                constants["nu"] = float(constants["nu"])
        materials.append(constants or each)
    return tuple(materials)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _directory(text: str) -> Path:
    if not text:
        raise ValueError("the directory has no name; give one")
    return _path(text)


def _file(endings: tuple[str, ...], text: str) -> Path:
    if not text.lower().endswith(endings):
        raise ValueError(f"the name must end in {' or '.join(endings)}")
    return _path(text)


def _path(text: str) -> Path:
    from rattlesweep.system.files import expand

    return Path(expand(text))


def measured(kind: str, name: str = "") -> Kind:
    """Return the type of a number in units of the body, or of one with a unit."""
    return Kind(name or kind, partial(_measured, kind))


def si_quantity(kind: str) -> Kind:
    """Return the type of a quantity that needs a unit."""
    return Kind(kind, partial(Quantity, kind=kind))


def with_unit(kind: str) -> Kind:
    """Return the type of a quantity that needs a unit, and stays a text."""

    def read(text: str) -> str:
        quantity(text, kind)
        return text

    return Kind(kind, read)


def several(metavar: str, kind: str, *counts: int) -> Kind:
    """Return the type of quantities with one unit, as in ``2,16,17 kg cm^2``."""
    return Kind(metavar, lambda text: quantities(text, kind, *counts))


PICTURES = (".svg", ".png", ".pdf")
FILE = Kind("file", _path)
COUNT = Kind("n", partial(_whole, 1, 1e12))
NUMBER = Kind("n", partial(_whole, 0, 1e12))
THREADS = Kind("n", partial(_whole, 1, MOST_THREADS))
SHARE = Kind("share", partial(_number, 0.0, 1.0))
DPI_VALUE = Kind("dpi", partial(_number, 20.0, 600.0))
TIME_VALUE = Kind("time", seconds_of)
NAME_LIST = Kind("a,b,...", _names)
MATERIAL_PAIR = Kind("body,plane", _materials)
FIGURE_SIZE = Kind("w,h", partial(_numbers, "7,4.5", 1, 24))
LOW_HIGH = Kind("low,high", partial(_numbers, "0.01,0.1", -1e12, 1e12))
VECTOR = Kind("x,y,z", partial(_numbers, "0,0,-1", -1e12, 1e12))
SPIN_VALUE = measured("spin")
DURATION = measured("time")
_LENGTH_VALUE = measured("length")
ENERGY_VALUE = measured("energy")
MASS = si_quantity("mass")
HEIGHT = si_quantity("length")
TURNS_A_TIME = with_unit("spin")
SECONDS = with_unit("time")
ANGLE = si_quantity("angle")
POCKET_SIZE = several("diameter,depth", "length", 2)
PRESET_CHOICE = Choice(PRESET_NAMES)
MODEL_CHOICE = Choice(MODEL_NAMES)
ACCURACY_CHOICE = Choice(ACCURACY_NAMES)
PLOTS = Choice(PLOT_NAMES)
DOCUMENT_CHOICE = Choice(DOCUMENT_NAMES)
FORMAT_CHOICE = Choice(EXPORT_FORMATS)
ENGINE_CHOICE = Choice(tuple(ENGINES))
LIST_OF_METHODS = Choice(list(METHODS))

# Groups of options.

# A flag, the type of its value (None: it has none), and its help.
_Row: TypeAlias = "tuple[str, click.ParamType | type | None, str]"  # type: ignore[type-arg]


def stack(*decorators: Decorator) -> Decorator:
    """Return one decorator for several, listed in the order of the help."""

    def decorate(function: Function) -> Function:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return decorate


def group(*rows: _Row) -> Decorator:
    """Return one decorator for several options without defaults."""
    decorators = [
        option(flag, type=kind, is_flag=kind is None, default=None, help=text)
        for flag, kind, text in rows
    ]
    return stack(*decorators)


def named(name: str, kind: Kind | type, more: str = "") -> _Row:
    """Return the row of an option for a quantity, explained as in the registry."""
    quantity = QUANTITIES[name]
    text = quantity.meaning[:1].upper() + quantity.meaning[1:]
    if quantity.unit != "1":
        text += f", in {quantity.unit}"
    if isinstance(kind, Kind):
        text += f", or as in '{KINDS[quantity.kind][1]}'"
    return f"--{name.replace('_', '-')}", kind, f"{text}.{more}"


def output(
    help: str = "Output directory; overrides the config's.", required: bool = False
) -> Decorator:
    """Return the option of an output directory."""
    kind = Kind("dir", _directory)
    return option("-o", "--output", type=kind, help=help, required=required)


def file(
    name: str,
    *endings: str,
    help: str,
    required: bool = False,
    multiple: bool = False,
) -> Decorator:
    """Return the option of a file to write, whose name has one of some endings."""
    names = ("-o", name) if name == "--output" else (name,)
    kind = Kind("file", partial(_file, endings))
    return option(*names, type=kind, help=help, required=required, multiple=multiple)


def path(name: str, **settings: Any) -> Decorator:
    """Return an argument that is a path."""
    return argument(name, type=Kind("path", _path), **settings)


directory = path("directory")
overrides = option(
    "--set",
    "overrides",
    metavar="KEY=VALUE",
    multiple=True,
    help="Override a key of the config, as in bodies.samples=10; may be repeated.",
)
sweep_options = stack(path("config"), output(), overrides)
threads = option(
    "-j", "--threads", type=THREADS, help="Threads; by default one per processor."
)
title = option("--title", metavar="TEXT", help="Title of the page.")
as_json = option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
quiet = option(
    "-q", "--quiet", is_flag=True, help="Print no progress, summaries or warnings."
)
_figure_options = stack(
    file("--figure", *PICTURES, help="Also draw a figure, an .svg, .png or .pdf file."),
    option("--size", type=FIGURE_SIZE, help="Width and height of it, in inches."),
    option("--style", metavar="STYLE", help="A style of Matplotlib, as of `plot`."),
)


def figure(function: Function) -> Function:
    """Add the options of a figure, and draw it in the size and style that are given."""

    @wraps(function)
    def drawing(
        *arguments: Any,
        figure: Path | None,
        size: tuple[float, float] | None,
        style: str | None,
        **given: Any,
    ) -> int | None:
        for name, value in (("--size", size), ("--style", style)):
            if value is not None and figure is None:
                raise ConfigError(f"{name}: there is no figure; add --figure FILE")
        looks: AbstractContextManager[None] = nullcontext()
        if figure is not None:
            from rattlesweep.analysis.room import drawn_as

            looks = drawn_as(size, style)
        with looks:
            return function(*arguments, figure=figure, **given)

    return _figure_options(drawing)


data = file(
    "--data", ".csv", ".parquet", help="Also write the numbers, as .csv or .parquet."
)
t_end = group(
    (
        "--t-end",
        DURATION,
        "Horizon, in sqrt(a/g) or as in 20s; by default 5 t_rGH, or that of the sweep.",
    ),
)
from_time = group(
    ("--from-time", DURATION, "Time of the first row, in sqrt(a/g) or as in 2s."),
)
where = option(
    "--where",
    metavar="CONDITION",
    help="Only runs that meet a pandas query, as in 'type == \"SW\" and K_r < 0.005'.",
)
which = stack(
    group(
        ("--case", int, "Case of the run."),
        ("--sample", int, "Its sample."),
    ),
    where,
)

_BODY: tuple[_Row, ...] = (
    (
        "--preset",
        PRESET_CHOICE,
        "The body of Garcia and Hubbard, or of Kane and Levinson.",
    ),
    named("alpha", float),
    named("beta", float),
    named("gamma", float),
    named("f_sd", float, "  Makes a shell-dumbbell body, without --alpha and --beta."),
    named("theta", float),
    named("phi", float),
    named("xi", float),
    ("--xi-deg", float, "The same in degrees."),
    named("c", _LENGTH_VALUE),
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
        "Instead of height, inertia and radii: a solid half ellipsoid, flat side up, "
        "as in 12cm,3cm,12mm.",
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
        "Place of one weight, along and across from the middle, as in 45,-9mm; the "
        "other lies opposite.",
    ),
    (
        "--wall",
        HEIGHT,
        "Thickness of an open shell, as in 2mm; without it the body is solid.",
    ),
    (
        "--mesh",
        Kind("file", _path),
        "Instead of height, inertia and radii: a closed mesh (STL, OBJ, PLY, 3MF).",
    ),
    ("--unit", str, f"Unit of the mesh.  [default: {MESH_UNIT}]"),
    (
        "--density",
        si_quantity("density"),
        "Density of the mesh instead of --mass, as in '1.24 g/cm^3'.",
    ),
    (
        "--mass-points",
        Kind("mass@x,y,z;...", _points),
        "Point masses in the mesh, not in --mass, with places in its unit, as in "
        "'7.5g@45,-9,0; 7.5g@-45,9,0'.",
    ),
    (
        "--up",
        VECTOR,
        "Direction of the mesh that is up, roughly; by default that of its flat side, "
        "or z.",
    ),
)
BODY = [flag.removeprefix("--").replace("-", "_") for flag, _, _ in _BODY]
body_options = group(*_BODY)


def some_of_body(*names: str) -> Decorator:
    """Return those options of a body that have some names."""
    return group(*(row for row in _BODY if row[0].removeprefix("--") in names))


dissipation = group(
    *(
        named(name, measured(loss.kind, loss.kind.split()[0]) if loss.kind else float)
        for name, loss in LOSSES.items()
    )
)
# In units of the body, whether or not it has a size.
SPIN_DEFAULTS = {
    "n_i": f"{LAUNCH_SPIN:g} {RATE}",
    "omega_xy0": f"{LAUNCH_PUSH:g} {RATE}",
}
spin_options = group(
    named("n_i", SPIN_VALUE, f"  [default: {LAUNCH_SPIN:g}]"),
    named("omega_xy0", SPIN_VALUE, f"  [default: {LAUNCH_PUSH:g}]"),
)
base = group(
    (
        "--base",
        Kind("frequency,acceleration", _base),
        "A plane that shakes: angular frequency in sqrt(g/a) or with a unit, and "
        "acceleration in g, or amplitude with a unit, as in 25Hz,0.1mm; along the "
        "plane with a third part, the azimuth from the body's x axis, as in "
        "25Hz,0.1mm,90deg.",
    ),
)
launch_options = stack(
    spin_options,
    group(
        (
            "--psi",
            Kind("direction", _direction),
            "Direction of the oscillation: relevant, pitch, roll, or degrees.  "
            "[default: relevant]",
        ),
        (
            "--omega",
            VECTOR,
            "Instead of these, a full state: angular velocity along the body's axes, "
            "in sqrt(g/a).",
        ),
        (
            "--u",
            VECTOR,
            "Vertical unit vector along the body's axes.  [default: 0,0,-1]",
        ),
    ),
    dissipation,
    base,
    t_end,
)
integrator = stack(
    group(
        ("--method", LIST_OF_METHODS, f"Integrator.  [default: {DOP853.name}]"),
        ("--tol", float, "Tolerance of an adaptive method.  [default: 1e-9]"),
        ("--dt-step", float, f"Step of a fixed-step method.  [default: {DT:g}]"),
        ("--accuracy", ACCURACY_CHOICE, "Instead of a method and its tolerance."),
    ),
)
rows = stack(
    group(
        (
            "--points",
            int,
            "Number of rows, evenly spaced up to the horizon.  "
            f"[default: {LEAST_ROWS}, or {ROWS_A_PERIOD} per pitch period if that is "
            "more]",
        ),
        ("--dt", DURATION, "Spacing of the rows in time."),
        ("--steps", None, "One row per accepted step."),
    ),
    from_time,
)
