"""Options and arguments that several commands have, each written once."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import argument, option

from rattlesweep.cli.common import types
from rattlesweep.cli.common.output import say
from rattlesweep.text import align

if TYPE_CHECKING:
    from rattlesweep.sweeps.config.schema import Config
    from rattlesweep.sweeps.plan import Plan
    from rattlesweep.sweeps.single import Launch

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

config = argument("config", type=click.Path(path_type=Path))
directory = argument("directory", type=click.Path(path_type=Path))
overrides = option(
    "--set", "overrides", metavar="KEY=VALUE", multiple=True,
    help="Override a key of the config, such as bodies.samples=10; may be repeated.",
)  # fmt: skip
threads = option("-j", "--threads", type=click.IntRange(1), help="Number of threads of the kernel.",
                 callback=lambda context, option, count: types.check_threads(count))  # fmt: skip
as_json = option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
quiet = option("-q", "--quiet", is_flag=True, help="No progress, closing words or warning.")
t_end = option(
    "--t-end", type=types.DURATION,
    help="Horizon, in sqrt(a/g), or as in 20s; by default 5 t_rGH, or that of the sweep.",
)  # fmt: skip
from_time = option("--from-time", type=float, help="Begin the rows at this time, in sqrt(a/g).")


def output(help: str = "Output directory; overrides the config's.", **settings: Any) -> Decorator:
    """The directory to write."""
    return option("-o", "--output", type=types.DIRECTORY, help=help, **settings)


def title(kind: types.Grammar = types.TITLE) -> Decorator:
    """The title of a page or a picture."""
    return option("--title", type=kind, help="Of the page or the picture.")


def file(name: str, *endings: str, help: str, **settings: Any) -> Decorator:
    """A file to write, of a format that its name's ending tells."""
    names = ("-o", name) if name == "--output" else (name,)
    return option(*names, type=types.file(*endings), help=help, **settings)


figure = file("--figure", *types.PICTURES, help="Plot to an .svg, .png or .pdf file.")


class Group:
    """Some options as one decorator: the command gets those that are given as a dictionary.

    ``into`` is the command's argument, ``keys`` are keys of the dictionary that are not the
    options' names.
    """

    def __init__(self, into: str, *options: Decorator, **keys: str) -> None:
        self._into, self._options, self._keys = into, options, keys
        self.names: list[str] = []

    def __call__(self, command: Callable[..., Any]) -> Callable[..., Any]:
        """Add the options to a command."""

        @wraps(command)
        def grouped(*args: Any, **given: Any) -> Any:
            values = {self._keys.get(name, name): given.pop(name) for name in self.names}
            values = {key: value for key, value in values.items() if value is not None}
            return command(*args, **{self._into: values}, **given)

        for add in reversed(self._options):
            add(grouped)
        added: list[click.Parameter] = vars(grouped)["__click_params__"][-len(self._options) :]
        self.names = [parameter.name or "" for parameter in added]
        return grouped

    def flags(self, values: dict[str, Any]) -> list[str]:
        """Options that were given, of the dictionary that the command got."""
        given = (name for name in self.names if self._keys.get(name, name) in values)
        return [f"--{name.replace('_', '-')}" for name in given]


body = Group(
    "body",
    option("--preset", type=types.PRESETS,
           help="A named body (Garcia and Hubbard 1988, Kane and Levinson 1982)."),
    option("--alpha", type=float, help="I_xx + 1, in M a^2."),
    option("--beta", type=float, help="I_yy + 1, in M a^2."),
    option("--gamma", type=float, help="I_zz, in M a^2."),
    option("--f-sd", type=float, help="I_yy/I_zz of a shell-dumbbell body; replaces alpha, beta."),
    option("--theta", type=float, help="Larger principal curvature, in 1/a."),
    option("--phi", type=float, help="Smaller principal curvature, in 1/a."),
    option("--xi", type=float, help="Skew angle in radians."),
    option("--xi-deg", type=float, help="Skew angle in degrees."),
    option("--c", type=types.SEMI_AXIS,
           help="Vertical semi-axis of an ellipsoid, in a, or as in 2cm."),
    option("--mass", type=types.MASS, help="Instead of all these in SI units: mass, as in 85g."),
    option("--height", type=types.LENGTH, help="Height of the centre of mass over the contact."),
    option("--inertia", type=types.INERTIA,
           help="Tensor of inertia about the centre of mass, as in '2,16,17,-0.2 kg cm^2'."),
    option("--radii", type=types.RADII,
           help="Principal radii of curvature at the bottom, as in '50,1.5 cm'."),
    option("--axes-angle", type=types.ANGLE,
           help="Angle from the x axis of --inertia to the direction of the first of --radii."),
    option("--z-up", is_flag=True, default=None, help="The z axis of --inertia points up."),
)  # fmt: skip
dissipation = Group(
    "dissipation",
    option("--sigma", type=types.DAMPING,
           help="Dissipation: sigma of a torque -sigma omega, in M a^2 sqrt(g/a), or as in "
           "'1e-4 N m s'."),
    option("--rolling", type=types.LEVER,
           help="Dissipation: lever of a rolling resistance, in a, or as in 50um."),
)  # fmt: skip
spin = Group(
    "spin",
    option("--n-i", type=types.SPIN, default=0.1,
           help="Initial spin, in sqrt(g/a), or as in 60rpm."),
    option("--omega-xy0", type=types.SPIN, default=0.01,
           help="Initial oscillation, in sqrt(g/a)."),
)  # fmt: skip
launch = Group(
    "launch",
    option("--n-i", type=types.SPIN,
           help="Initial spin, in sqrt(g/a), or as in 60rpm.  [default: 0.1]"),
    option("--omega-xy0", type=types.SPIN,
           help="Initial oscillation, in sqrt(g/a).  [default: 0.01]"),
    option("--psi", type=types.PSI, metavar="DIRECTION",
           help="Direction of the oscillation: relevant, pitch, roll, or degrees.  "
           "[default: relevant]"),
    option("--omega", type=types.VECTOR,
           help="A full state instead: angular velocity along the body's axes, in sqrt(g/a)."),
    option("--u", type=types.VECTOR,
           help="Vertical unit vector along the body's axes.  [default: 0,0,-1]"),
)  # fmt: skip


integrator = Group(
    "integrator",
    option("--method", type=types.METHODS, help="Method of integration.  [default: dop853]"),
    option("--tol", type=float, help="Tolerance of an adaptive method.  [default: 1e-9]"),
    option("--dt-step", type=float, help="Step of a fixed-step method.  [default: 0.002]"),
    option("--accuracy", type=types.ACCURACIES,
           help="A named accuracy instead of a method and its tolerance."),
    dt_step="dt",
)  # fmt: skip
rows = Group(
    "rows",
    option("--points", type=int, help="Number of rows, evenly spaced up to the horizon.  "
           "[default: 2001, or 20 per pitch period if that is more]"),
    option("--dt", type=float, help="Spacing of the rows in time."),
    option("--steps", is_flag=True, help="One row per accepted step."),
    from_time,
)  # fmt: skip
where = option(
    "--where",
    metavar="CONDITION",
    help="Select runs by a pandas query on their columns, as in 'type == \"SW\" and K_r < 0.005'.",
)
_which = (
    option("--case", type=int, help="Case of the run."),
    option("--sample", type=int, help="Sample of the run."),
    where,
)
which_run = Group("which", *_which)
which_runs = Group(
    "which",
    *_which,
    option("--first", type=click.IntRange(1),
           help="Number of runs to take from --where.  [default: 1]"),
)  # fmt: skip


def _list_channels(
    context: click.Context, parameter: click.Parameter, names: tuple[str, ...] | None
) -> tuple[str, ...] | None:
    """Print every channel with its unit and its words, if that is what is asked for."""
    if names != ("list",):
        return names
    from rattlesweep.analysis.onerun.channels import CHANNELS

    lines = []
    for c in CHANNELS.values():
        models = "" if "gh" in c.models else f" ({', '.join(c.models)})"
        lines.append((c.name, c.unit, c.description + models))
    click.echo(align(lines, "<"))
    context.exit()


channels = option(
    "--channels",
    type=types.NAMES,
    callback=_list_channels,
    help="Columns, and panels of the figure if given; 'list' prints all of them.  [default: t,n]",
)


def launched(
    body: dict[str, Any], launch: dict[str, Any], dissipation: dict[str, Any], **rest: Any
) -> Launch:
    """The run that the options of these names ask for, in the units of its body.

    The spin and the oscillation have their defaults unless a state is given.
    """
    from rattlesweep.analysis.derived import in_units_of, make_body
    from rattlesweep.sweeps.single import Launch

    made = make_body(body)
    default = {} if {"omega", "u"} & launch.keys() else {"n_i": 0.1, "omega_xy0": 0.01}
    return Launch(made, **in_units_of(made.units, default | launch | dissipation | rest))


def load_sweep(path: Path, overrides: tuple[str, ...], output: Path | None = None) -> Config:
    """The config of a sweep, with what the command line says instead."""
    from rattlesweep.sweeps.config.read import load_config

    loaded = load_config(path, overrides)
    return loaded if output is None else loaded.model_copy(update={"output": str(output)})


def planned(loaded: Config, path: Path) -> Plan:
    """The plan of a config that was read from a file; what is doubtful in it is said."""
    from rattlesweep.sweeps.plausible import checked_plan

    plan, doubts = checked_plan(loaded, path.resolve().parent)
    for doubt in doubts:
        say(f"warning: {doubt}")
    return plan
