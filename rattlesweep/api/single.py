"""Runs of bodies from their launches: one, or one for each entry of arrays."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeAlias, overload

import numpy as np

from rattlesweep.api import arguments as arguments
from rattlesweep.api.arguments import (
    BodiesLike,
    check_count,
    numbers,
    one_number,
    only_number,
)
from rattlesweep.arrays import Floats
from rattlesweep.system.console import Bar
from rattlesweep.words.errors import ConfigError, ConfigWarning, check_names
from rattlesweep.words.quantities import ACTING, INITIAL_RATES

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
    from numpy.typing import ArrayLike

    from rattlesweep.analysis.onerun.course import PreparedRun
    from rattlesweep.design.bodies.table import TableBodies
    from rattlesweep.design.launch import Launch
    from rattlesweep.design.plan import Plan
    from rattlesweep.physics.body import Rattleback
    from rattlesweep.physics.si import Units


# A number, or text with an SI unit such as "60 rpm".
NumberOrText: TypeAlias = "float | str"
# Columns of a full state.
_STATE = ("omega_x", "omega_y", "omega_z", "u_x", "u_y", "u_z")
# Arguments that are keys of the section `integrator` of a config; its `dt` is `dt_step`
# here.
INTEGRATOR = ("method", "tol", "dt_step", "accuracy")
LAUNCH_ARGUMENTS = (
    *INITIAL_RATES,
    "omega",
    "u",
    "t_end",
    "psi",
    "model",
    *ACTING,
    "base",
    *INTEGRATOR,
)


class Run(SimpleNamespace):
    """Outcome of one run: an attribute for each column of ``runs``, and `units`.

    Stability: stable.
    """

    def __getitem__(self, name: str) -> Any:
        check_names("columns", [name], vars(self))
        return getattr(self, name)

    def __repr__(self) -> str:
        shown = ["t_r=None"]
        if self.t_r is not None:
            shown = [f"t_r={self.t_r:.10g}"]
        if getattr(self, "t_r_s", None) is not None:
            shown.append(f"{self.t_r_s:.5g} s")
        shown.append(f"t_end={self.t_end:.10g}")
        shown += [f"type={self.type}", f"status={self.status}"]
        return f"<Run {', '.join(shown)}>"

    def to_dict(self) -> dict[str, Any]:
        """Return all columns of the run by name."""
        return {name: value for name, value in vars(self).items() if name != "units"}


# One body and numbers are one run.
@overload
def simulate(
    body: Rattleback | str,
    *,
    n_i: NumberOrText | None = None,
    omega_xy0: NumberOrText | None = None,
    omega: tuple[NumberOrText, NumberOrText, NumberOrText] | None = None,
    u: tuple[float, float, float] | None = None,
    t_end: NumberOrText | None = None,
    psi: NumberOrText | None = None,
    model: str = "full",
    record: str | Sequence[str] = (),
    threads: int | None = None,
    progress: bool | None = None,
    **settings: NumberOrText | Mapping[str, float] | None,
) -> Run: ...


# Several bodies are several runs.
@overload
def simulate(
    body: list[Any] | tuple[Any, ...] | pd.DataFrame,
    *,
    n_i: ArrayLike | None = None,
    omega_xy0: ArrayLike | None = None,
    omega: ArrayLike | None = None,
    u: ArrayLike | None = None,
    t_end: ArrayLike | None = None,
    psi: ArrayLike | None = None,
    model: str = "full",
    record: str | Sequence[str] = (),
    threads: int | None = None,
    progress: bool | None = None,
    **settings: Any,
) -> pd.DataFrame: ...


# An array may hold one number, so that only the call tells what comes of it.
@overload
def simulate(
    body: BodiesLike,
    *,
    n_i: ArrayLike | None = None,
    omega_xy0: ArrayLike | None = None,
    omega: ArrayLike | None = None,
    u: ArrayLike | None = None,
    t_end: ArrayLike | None = None,
    psi: ArrayLike | None = None,
    model: str = "full",
    record: str | Sequence[str] = (),
    threads: int | None = None,
    progress: bool | None = None,
    **settings: Any,
) -> Run | pd.DataFrame: ...


def simulate(
    body: BodiesLike,
    *,
    n_i: ArrayLike | None = None,
    omega_xy0: ArrayLike | None = None,
    omega: ArrayLike | None = None,
    u: ArrayLike | None = None,
    t_end: ArrayLike | None = None,
    psi: ArrayLike | None = None,
    model: str = "full",
    record: str | Sequence[str] = (),
    threads: int | None = None,
    progress: bool | None = None,
    **settings: Any,
) -> Run | pd.DataFrame:
    """Integrate bodies from their launches to their first reversals or to ``t_end``.

    Arrays are broadcast by NumPy's rules.  If the size of the bodies is known, spins,
    times and losses need a unit: ``"60 rpm"``, ``"20 s"``, ``"1e-5 N m s"``, or ``"0.2
    sqrt(g/a)"``.  Numbers are for bodies without a size, and for columns of tables.

    Returns a ``Run``, or a DataFrame if any argument is an array: one row per run, in C
    order of ``attrs["shape"]``, with the columns of a sweep's ``runs`` except ``case``
    and ``sample``, ``t_r_s`` and ``n_i_rpm`` if sizes are known, and the index of a
    DataFrame of bodies.

    Stability: stable.

    Parameters
    ----------
    body : Rattleback, str, sequence or array of these, or DataFrame
        A text is the name of a preset, ``"GH"`` or ``"KL"``.  A table, such as the runs
        of a sweep, has the columns ``alpha beta gamma theta phi xi``.  It may have the
        launches, as columns ``n_i omega_xy0 psi t_end``.  Arguments that give a launch
        replace those of the table, with their horizons; a column ``t_end`` beside no
        launches is kept.  Angles in tables are in radians, ``psi`` too, unlike the
        argument.
    n_i, omega_xy0 : array_like
        Initial spin and oscillation, in ``sqrt(g/a)``; ``n_i=0`` is a tap, by default
        on the pitch.
    omega, u : array_like, shape (..., 3)
        A full state instead, along the body's axes: angular velocity, in ``sqrt(g/a)``,
        and vertical unit vector, by default ``(0, 0, -1)`` (upright).
    t_end : array_like, optional
        Horizon, in ``sqrt(a/g)``, by default 5 t_rGH of the spin's own direction.  It
        replaces the column ``t_end`` of a table.
    psi : array_like, optional
        Direction of the oscillation: ``relevant`` (default), ``pitch``, ``roll``, or
        degrees.  The column ``psi`` of the result is in radians.
    model : str
        ``full``, ``reduced`` or ``gh``.
    record : str or sequence of str
        Extra columns, such as ``["error", "energy"]``.
    threads : int, optional
        Threads of the kernel, by default all.
    progress : bool, optional
        Whether to show a bar, by default in a terminal and in a notebook.
    **settings
        Dissipation, a plane that shakes, and the integrator, by the names of the
        config's keys; only ``dt`` is ``dt_step`` here:

        - ``sigma`` : array_like, coefficient of a torque ``-sigma omega``, in ``M a^2
          sqrt(g/a)``
        - ``rolling`` : array_like, lever of a rolling resistance, in ``a``
        - ``pivot`` : array_like, lever of the torque against pivoting, in ``a``
        - ``creep`` : array_like, friction in the patch that pivots, which then gives
          way
        - ``viscous`` : array_like, friction of the foot over its speed of slip, in ``M
          sqrt(g/a)``; at 0 it does not slip
        - ``mu`` : array_like, coefficient of sliding friction; without it the foot
          never slides
        - ``base`` : tuple or mapping, a plane that shakes: ``(frequency,
          acceleration)`` or the keys of a config, such as ``{"frequency": "25 Hz",
          "amplitude": "0.1 mm"}``
        - ``method`` : str, with its ``tol`` or ``dt_step``
        - ``accuracy`` : ``"draft"`` or a mapping such as ``{"t_r": 1e-6}``, instead

    Examples
    --------
    >>> rs.simulate("GH", n_i=0.1, omega_xy0=0.01)
    <Run t_r=112.093878, t_end=112.093878, type=R, status=ok>
    """
    from rattlesweep.design.launch import plan_of_rows

    check_names(
        "arguments", settings, (*LAUNCH_ARGUMENTS, "record", "threads", "progress")
    )
    integrator = {name: settings[name] for name in INTEGRATOR if name in settings}
    losses = {name: settings[name] for name in ACTING if name in settings}
    check_count("threads", threads)
    launch = {"n_i": n_i, "omega_xy0": omega_xy0, "t_end": t_end, **losses}
    base = settings.get("base")
    columns, shape = _columns_of_runs(body, launch, omega, u, psi, base)
    _doubt_taps(columns)
    names = arguments.names_of("record", record)
    plan = plan_of_rows(_rows_of_runs(columns), model, integrator, names)
    if not shape:
        threads = 1  # one run is not shared out
    table = _integrated(plan, threads, progress)
    if not shape:
        return Run(**table.to_pylist()[0], units=arguments.units_of(table.schema))
    frame = arguments.to_frame(table)
    frame.attrs["shape"] = shape
    if arguments.is_frame(body) and shape == (len(body),):
        frame.index = body.index
    return frame


def _columns_of_runs(
    body: BodiesLike,
    launch: Mapping[str, ArrayLike | None],
    omega: ArrayLike | None,
    u: ArrayLike | None,
    psi: ArrayLike | None,
    base: object,
) -> tuple[dict[str, Floats], tuple[int, ...]]:
    """Return the columns of bodies with their launches, and the shape of the runs.

    Launches are in units of the bodies.
    """
    from rattlesweep.design.bodies.table import launched_from, unknown_columns
    from rattlesweep.design.launch import directions, is_full_state

    if arguments.is_table(body):
        unused = unknown_columns(arguments.column_names(body))
        if unused:
            text = f"bodies: columns not used: {', '.join(unused)}"
            warnings.warn(text, ConfigWarning, stacklevel=3)
    columns = arguments.body_columns(body)
    units = arguments.column_units(columns)
    arrays = _arrays(launch, base, units)
    spin = {name: launch[name] for name in INITIAL_RATES}
    is_full = is_full_state(omega, u, {**spin, "psi": psi})
    if is_full:
        arrays |= arguments.full_states(omega, u, units)
    if psi is not None and not isinstance(psi, str):
        arrays["psi"] = np.radians(numbers("psi", psi))
    columns, shape = arguments.broadcast(_with_launches(columns, arrays, psi))
    columns = {name: column.ravel() for name, column in columns.items()}
    if is_full:
        columns |= launched_from(columns)
    elif isinstance(psi, str):
        columns["psi"] = directions(columns, psi)
    return columns, shape


def _doubt_taps(columns: Mapping[str, Floats]) -> None:
    """Warn of spins so small that a tap may be meant."""
    from rattlesweep.design.plausible import near_tap

    if "u_x" in columns:
        return
    question = near_tap(columns["n_i"])
    if question is not None:
        warnings.warn(f"n_i: {question}", ConfigWarning, stacklevel=3)


def _rows_of_runs(columns: Mapping[str, Floats]) -> TableBodies:
    """Return columns over runs as those of a table, with the sizes of its bodies."""
    from rattlesweep.design.bodies.table import TableBodies

    units = arguments.column_units(columns)
    others = dict(columns)
    sizes = {
        name: others.pop(name) for name in arguments.SIZE_COLUMNS if name in columns
    }
    if units is None:
        # Without units, no size is known: at most a mass is, which is none.
        sizes = {name: size for name, size in sizes.items() if name == "rim"}
    return TableBodies(others, units, sizes)


def _integrated(plan: Plan, threads: int | None, progress: bool | None) -> pa.Table:
    """Return the rows of a plan without their keys, and show the progress."""
    from rattlesweep.compiling.loading import listening
    from rattlesweep.work.run import integrate_plan

    with Bar.of_call(progress) as bar, listening(bar.compiling):
        report = bar.counting(f"{plan.runs:,} runs")
        table = integrate_plan(plan, threads, report)
    return table.cast(plan.schema).drop_columns(["case", "sample"])


def prepare_launch(body: object, **launch: Any) -> PreparedRun:
    """Return one launch, ready to be integrated."""
    from rattlesweep.analysis.onerun.course import PreparedRun

    return PreparedRun.of(launch_of(body, **launch))


def launch_of(
    body: object,
    *,
    psi: object = None,
    omega: object = None,
    u: Any = None,
    model: str = "full",
    **values: Any,
) -> Launch:
    """Return one launch with its numbers in the units of its body."""
    from rattlesweep.design.launch import Launch

    stone = arguments.one_body(body)
    check_names("arguments", values, (*LAUNCH_ARGUMENTS, "e_p0", "e_r0"))
    integrator = {name: values.pop(name, None) for name in INTEGRATOR}
    base = values.pop("base", None)
    single: dict[str, Any] = {
        name: only_number(name, column)
        for name, column in _arrays(values, base, stone.units).items()
    }
    losses = {name: single.pop(name) for name in ACTING if name in single}
    components: list[float] | None = None
    if omega is not None:
        state = arguments.full_states(omega, u, stone.units)
        components = [only_number("omega", state[f"omega_{axis}"]) for axis in "xyz"]
        if u is not None:
            u = [only_number("u", state[f"u_{axis}"]) for axis in "xyz"]
    return Launch(
        stone,
        psi=psi if isinstance(psi, str) else one_number("psi", psi),
        omega=components,
        u=u,
        model=model,
        integrator=integrator,
        losses=losses,
        **single,
    )


def _arrays(
    values: Mapping[str, Any], base: object, units: Units | None
) -> dict[str, Floats]:
    """Return the values of a launch that are given, as arrays in units of the bodies.

    A plane that shakes, `base`, is among them by its columns.
    """
    arrays = {
        name: numbers(name, value, units)
        for name, value in values.items()
        if value is not None
    }
    if base is not None:
        arrays |= arguments.columns_of_base(base, units)
    return arrays


def _with_launches(
    columns: dict[str, Floats], arrays: dict[str, Floats], psi: object
) -> dict[str, Floats]:
    """Return the columns of bodies with the launches, or else those of their table."""
    from rattlesweep.design.launch import check_launched

    if any(name in arrays for name in (*INITIAL_RATES, *_STATE)):
        replaced = {*INITIAL_RATES, "psi", *_STATE}
        if columns.keys() & replaced:
            # The horizons of a table belong to its own launches, if it has some.
            replaced.add("t_end")
        columns = {
            name: column for name, column in columns.items() if name not in replaced
        }
    elif psi is not None:
        if "u_x" in columns:
            raise ConfigError(
                "psi does not go with the full states of the table; leave it out"
            )
        columns.pop("psi", None)
    launched = columns | arrays
    if "u_x" not in launched:
        check_launched([name for name in INITIAL_RATES if name not in launched])
    return launched
