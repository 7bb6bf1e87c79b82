"""Single runs: outcomes, time series, pages that move; and stored runs again."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.api.arrays import (
    Bodies,
    body_columns,
    broadcast,
    check_count,
    column_scale,
    full_states,
    is_frame,
    number,
    numbers,
    one_body,
    scale_of,
    table_bodies,
    to_frame,
    units_of,
)
from rattlesweep.arrays import Floats, take
from rattlesweep.errors import ConfigError
from rattlesweep.physics.body import Rattleback
from rattlesweep.progress import Bar

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rattlesweep.analysis.onerun.course import Course, Trajectory
    from rattlesweep.analysis.onerun.replay import Replay, StoredRun
    from rattlesweep.analysis.onerun.rows import Rows
    from rattlesweep.sweeps.bodies.protocol import Scale
    from rattlesweep.sweeps.single import Launch

    # A number, or text with an SI unit such as "60 rpm".
    Number = float | str

LAUNCH = ("n_i", "omega_xy0")
STATE = ("omega_x", "omega_y", "omega_z", "u_x", "u_y", "u_z")


class Run:
    """Outcome of one run: each column of a sweep's ``runs`` is an attribute.

    Attributes
    ----------
    t_r : float or None
        Time of the first reversal, in ``sqrt(a/g)``; None without one by ``t_end``.
    t_end : float
        Time reached.
    type, status : str
        ``type`` is None where ``status`` is not ``ok``.
    units : dict
        Unit of each column.
    """

    def __init__(self, row: dict[str, Any], units: dict[str, str]) -> None:
        self._row, self.units = row, units

    def __getattr__(self, name: str) -> Any:
        row = self.__dict__.get("_row", {})
        if name not in row:
            raise AttributeError(f"a run has no column {name}; there are {', '.join(row)}")
        return row[name]

    def __getitem__(self, name: str) -> Any:
        return self._row[name]

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._row)

    def __dir__(self) -> list[str]:
        return sorted([*self._row, "to_dict", "units"])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Run) and self._row == other._row

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        shown = [f"t_r={self.t_r:.10g}" if self.t_r is not None else "t_r=None"]
        shown += [f"{self.t_r_s:.5g} s"] if self._row.get("t_r_s") is not None else []
        shown += [f"t_end={self.t_end:.10g}", f"type={self.type}", f"status={self.status}"]
        return f"<Run {', '.join(shown)}>"

    def to_dict(self) -> dict[str, Any]:
        """Return all columns of the run by name."""
        return dict(self._row)


@dataclass(frozen=True)
class Page:
    """A self-contained HTML page, which a notebook shows.

    Attributes
    ----------
    content : bytes
    path : Path or None
        File that it was written to.
    """

    content: bytes = field(repr=False)
    path: Path | None = None

    def save(self, path: str | Path) -> Page:
        """Write the page to a file, and return it with its path."""
        from rattlesweep.sweeps.files import replace_file

        replace_file(Path(path), self.content)
        return Page(self.content, Path(path))

    def _repr_html_(self) -> str:
        # A frame of its own, whose scripts see nothing of the notebook.
        style = "width: 100%; height: 720px; border: 0"
        text = html.escape(self.content.decode())
        return f'<iframe sandbox="allow-scripts" style="{style}" srcdoc="{text}"></iframe>'


def simulate(
    body: Bodies,
    *,
    n_i: ArrayLike | None = None,
    omega_xy0: ArrayLike | None = None,
    omega: ArrayLike | None = None,
    u: ArrayLike | None = None,
    t_end: ArrayLike | None = None,
    psi: str | ArrayLike | None = None,
    model: str = "full",
    method: str | None = None,
    tol: float | None = None,
    dt_step: float | None = None,
    accuracy: str | Mapping[str, float] | None = None,
    sigma: ArrayLike | None = None,
    rolling: ArrayLike | None = None,
    record: str | Sequence[str] = (),
    threads: int | None = None,
    progress: bool | None = None,
) -> Any:
    """Integrate bodies from their launches to their first reversals or to ``t_end``.

    One body and numbers give one :class:`Run`.  If anything is an array, all are broadcast by
    NumPy's rules, and a thousand runs cost what a thousand rows of a sweep cost.  Spins, times and
    losses of bodies whose size is known may be texts with a unit, alone or in arrays: ``"60 rpm"``,
    ``"20 s"``, ``"1e-5 N m s"``.

    Parameters
    ----------
    body : Rattleback, str, sequence or array of these, or DataFrame
        A text is the name of a preset, ``"GH"`` or ``"KL"``.  A table has the columns ``alpha beta
        gamma theta phi xi``, angles in radians; if it also has ``n_i omega_xy0`` and perhaps ``psi
        t_end`` (in radians), these are the launches of its rows unless `n_i` and `omega_xy0` are
        given.  The runs of a sweep are such a table.
    n_i, omega_xy0 : array_like
        Initial spin and oscillation, in ``sqrt(g/a)``; ``n_i=0`` is a tap, by default on the pitch.
    omega, u : array_like, shape (..., 3)
        A full state instead of these: angular velocity in ``sqrt(g/a)`` and vertical unit vector
        (by default upright, ``(0, 0, -1)``), in components along the body's axes.
    t_end : array_like, optional
        Horizon, in ``sqrt(a/g)``; by default 5 t_rGH of the spin's own direction, which a launch
        without spin has not.
    psi : str or array_like, optional
        ``relevant`` (the default), ``pitch``, ``roll`` or degrees.
    model : str
        ``full``, ``reduced`` or ``gh``.
    method, tol, dt_step, accuracy
        Method, and the tolerance of an adaptive one or the step of a fixed-step one; or an accuracy
        instead, such as ``"draft"`` or ``{"t_r": 1e-6}``: the keys of the config's ``integrator``.
    sigma, rolling : array_like, optional
        Torque ``-sigma omega``, in ``M a^2 sqrt(g/a)``; lever of a rolling resistance, in ``a``.
    record : str or sequence of str
        Further columns, as of the config's ``record``, such as ``["error", "energy"]``.
    threads : int, optional
        Threads of the kernel; by default one for each processor.  The results do not depend on it.
    progress : bool, optional
        Whether to show a bar; by default in a terminal and in a notebook, if it takes long.

    Returns
    -------
    Run or pandas.DataFrame
        The table has one row a run and the columns of a sweep's ``runs`` but ``case`` and
        ``sample``, with ``attrs["units"]``, and ``attrs["shape"]``, the shape to which the
        arguments were broadcast: its rows are in C order.  It has the index of a DataFrame of
        bodies of which each row is one run.  Of bodies whose size is known there are ``t_r_s`` and
        ``n_i_rpm``; :func:`to_si` gives the others.

    Raises
    ------
    ConfigError
        If an argument is wrong.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> rs.simulate("GH", n_i=0.1, omega_xy0=0.01)
    <Run t_r=112.093878, t_end=112.093878, type=R, status=ok>
    >>> runs = rs.simulate("GH", n_i=[0.1, 0.2, 0.4], omega_xy0=[[0.01], [0.1]])
    >>> runs.t_r.to_numpy().reshape(runs.attrs["shape"]).round(2)
    array([[112.09,  74.67,  68.48],
           [ 26.77,  33.15,  45.7 ]])
    """
    from rattlesweep.integrate.compile import listening
    from rattlesweep.sweeps.bodies.table import launched_from
    from rattlesweep.sweeps.memory import integrate_plan
    from rattlesweep.sweeps.single import Launch, is_full_state, plan_of

    check_count("threads", threads)
    columns = body_columns(body)
    scale = column_scale(columns)
    given = {"n_i": n_i, "omega_xy0": omega_xy0, "t_end": t_end, "sigma": sigma, "rolling": rolling}
    arrays = {name: numbers(name, x, scale) for name, x in given.items() if x is not None}
    state: dict[str, Floats] = {}
    if is_full_state(omega, u, {"n_i": n_i, "omega_xy0": omega_xy0, "psi": psi}):
        state = full_states(omega, u, scale)
    if psi is not None and not isinstance(psi, str):
        arrays["psi"] = np.radians(numbers("psi", psi))
    columns, shape = broadcast(_launched(columns, state | arrays, psi is not None))
    columns = {name: column.ravel() for name, column in columns.items()}
    if state:
        columns |= launched_from(columns, "launch")
    # Its body and its launch are replaced by those of the rows.
    launch = Launch(
        Rattleback.gh(), n_i=1.0, omega_xy0=1.0, psi=psi if isinstance(psi, str) else "relevant",
        model=model, integrator=_integrator(method, tol, dt_step, accuracy),
        record=[record] if isinstance(record, str) else list(record),
    )  # fmt: skip
    plan = plan_of(launch, table_bodies(columns))
    with Bar.of_call(progress) as bar, listening(bar.compiling):
        table = integrate_plan(plan, threads if shape else 1, bar.counting(f"{plan.runs:,} runs"))
    table = table.cast(plan.schema).drop_columns(["case", "sample"])
    if not shape:
        return Run(table.to_pylist()[0], units_of(table.schema))
    frame = to_frame(table)
    frame.attrs["shape"] = shape
    if is_frame(body) and shape == (len(body),):
        frame.index = body.index
    return frame


def trajectory(
    body: Rattleback | str,
    *,
    n_i: Number | None = None,
    omega_xy0: Number | None = None,
    omega: Sequence[Number] | None = None,
    u: Sequence[float] | None = None,
    t_end: Number | None = None,
    psi: str | float | None = None,
    model: str = "full",
    channels: Sequence[str] = ("t", "n"),
    points: int | None = None,
    dt: Number | None = None,
    steps: bool = False,
    times: Any = None,
    from_time: Number | None = None,
    method: str | None = None,
    tol: float | None = None,
    dt_step: float | None = None,
    accuracy: str | None = None,
    e_p0: Number | None = None,
    e_r0: Number | None = None,
    sigma: Number = 0.0,
    rolling: Number = 0.0,
) -> Trajectory:
    """Integrate one launch to ``t_end``, past its reversals, and give it as a table.

    Parameters
    ----------
    body, n_i, omega_xy0, omega, u, t_end, psi, model
        As for :func:`simulate`, of one body.
    channels : sequence of str
        Columns of the table; ``rattlesweep trajectory --channels list`` prints all of them.
    points, dt, steps, times
        One way to choose the rows: so many evenly from 0 to ``t_end`` (by default 2001, or 20 a
        period of the pitch if that is more), one every ``dt``, one per accepted step, or any
        increasing times; in ``sqrt(a/g)``.
    from_time : float or str, optional
        Time of the first row, in ``sqrt(a/g)``; the run begins at its launch all the same.
    method, tol, dt_step, accuracy, sigma, rolling
        As for :func:`simulate`; ``dt_step`` is not to be confused with ``dt``.
    e_p0, e_r0 : float or str, optional
        Energies of pitch and roll with which the reduced model begins, in ``M g a``; by default
        the launch's, where one of them is zero.

    Returns
    -------
    Trajectory
        ``table`` (pandas), ``units``, ``reversals``, ``zeros`` (of the spin, all of them),
        ``status``, ``warning``.  The accepted steps, and so the first zero, are those of
        :func:`simulate`, whatever rows are asked for.

    Raises
    ------
    ConfigError
        If an argument is wrong.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> path = rs.trajectory("GH", n_i=0.1, omega_xy0=0.01, t_end=150, points=4)
    >>> path["n"].shape, path.reversals.round(2)
    ((4,), array([112.09]))
    """
    from rattlesweep.analysis.onerun.course import Course, collect

    launch = launch_of(
        body, n_i=n_i, omega_xy0=omega_xy0, omega=omega, u=u, t_end=t_end, psi=psi, e_p0=e_p0,
        e_r0=e_r0, sigma=sigma, rolling=rolling, model=model, method=method, tol=tol,
        dt_step=dt_step, accuracy=accuracy,
    )  # fmt: skip
    scale = scale_of(launch.body.units)
    rows = rows_of(scale, points, dt, steps, times, from_time)
    return collect(Course(launch, channels=channels, rows=rows), partial(_page, launch, scale))


def show(
    body: Rattleback | str,
    *,
    n_i: Number | None = None,
    omega_xy0: Number | None = None,
    omega: Sequence[Number] | None = None,
    u: Sequence[float] | None = None,
    t_end: Number | None = None,
    psi: str | float | None = None,
    from_time: Number | None = None,
    points: int | None = None,
    sigma: Number = 0.0,
    rolling: Number = 0.0,
    title: str | None = None,
    path: str | Path | None = None,
) -> Page:
    """Make a page on which a body rolls on the plane, with its trace and its spin.

    Parameters
    ----------
    body, n_i, omega_xy0, omega, u, t_end, psi, sigma, rolling
        As for :func:`simulate`, of one body.
    from_time : float or str, optional
        When the page begins, in ``sqrt(a/g)``.
    points : int, optional
        Number of rows; by default 20 a period of the pitch.
    title : str, optional
    path : path, optional
        An .html file to write it to.

    Returns
    -------
    Page
        A notebook shows it; ``save`` writes it.

    Raises
    ------
    ConfigError
        If an argument is wrong, or the run is too long for a page.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> rs.show("GH", n_i=-0.1, omega_xy0=0.01, t_end=20, path="roll.html").path.name
    'roll.html'
    """
    launch = launch_of(
        body, n_i=n_i, omega_xy0=omega_xy0, omega=omega, u=u, t_end=t_end, psi=psi, sigma=sigma,
        rolling=rolling,
    )  # fmt: skip
    name = f"Rattleback {body}" if isinstance(body, str) else "Rattleback"
    scale = scale_of(launch.body.units)
    return _page(launch, scale, points=points, from_time=from_time, title=title or name, path=path)


def replay(
    directory: str | Path,
    case: int,
    sample: int,
    *,
    t_end: Number | None = None,
    channels: Sequence[str] = ("t", "n"),
    points: int | None = None,
    dt: Number | None = None,
    steps: bool = False,
    times: Any = None,
    from_time: Number | None = None,
) -> Trajectory:
    """Integrate a stored run again as a trajectory, proved to be the stored one bit for bit.

    Parameters
    ----------
    directory : path
        Output directory of a sweep, whole or still running.
    case, sample : int
        Which run: the columns of ``runs`` of these names.
    t_end : float or str, optional
        Horizon, in ``sqrt(a/g)``; by default the sweep's.
    channels, points, dt, steps, times, from_time
        As for :func:`trajectory`.

    Returns
    -------
    Trajectory

    Raises
    ------
    ConfigError
        If an argument is wrong, or there is no such run.
    OutputError
        If the run is not stored yet, is damaged, or comes out otherwise than stored.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> path = rs.replay("out/steady", case=3, sample=17)  # doctest: +SKIP
    """
    from rattlesweep.analysis.onerun.course import Course, collect
    from rattlesweep.analysis.onerun.replay import Replay

    check_count("case", case, 0)
    check_count("sample", sample, 0)
    source = Replay(Path(directory))
    run = source.find(case, sample)
    scale = stored_scale(source, run)
    rows = rows_of(scale, points, dt, steps, times, from_time)
    prepared = source.prepare(run, number("t_end", t_end, scale))
    source.prove(run)
    course = Course(prepared, channels=channels, rows=rows)
    found = collect(course, partial(_page, prepared, scale, title=run.name))
    run.check(course)
    return found


def show_stored(
    directory: Path, which: dict[str, Any], *, path: str | Path | None = None, **settings: Any
) -> Page:
    """Return the page of a stored run, written to a file if there is a path."""
    page = stored_page(directory, which, **settings)[0]
    return page if path is None else page.save(path)


def stored_page(
    directory: Path,
    which: dict[str, Any],
    *,
    title: str | None = None,
    t_end: Any = None,
    **rows: Any,
) -> tuple[Page, Course, list[str]]:
    """Return the page of a run, proved to be the stored one, its course, and what was shown."""
    from rattlesweep.analysis.onerun.replay import Replay

    source = Replay(directory)
    run = source.select(**which)[0]
    scale = stored_scale(source, run)
    prepared = source.prepare(run, number("t_end", t_end, scale))
    source.prove(run)
    cause = source.cause(run)
    kind = f", type {run.type}" if run.type else ""
    title = title or f"{source.config.name}: {run.name}{kind}"
    page, course = page_of(prepared, scale, title, cause, **rows)
    run.check(course)
    return page, course, [run.proof, *([cause] if cause else [])]


def page_of(
    run: Any,
    scale: Scale | None,
    title: str,
    cause: str = "",
    *,
    points: int | None = None,
    from_time: Any = None,
    watch: Callable[[float], None] | None = None,
) -> tuple[Page, Course]:
    """Return the page of a launch or a stored run, and its course; `cause` as of `make_scene`."""
    from rattlesweep.analysis.viewer import show as viewer

    check_count("points", points, 2)
    from_time = number("from_time", from_time, scale)
    course = viewer.course_of(run, points, watch, from_time=from_time)
    scene = viewer.make_scene(course, cause)
    return Page(viewer.make_page(scene, title, viewer.describe(course))), course


def _page(
    run: Any, scale: Scale | None, *, title: str = "Rattleback", path: Any = None, **rows: Any
) -> Page:
    page, _ = page_of(run, scale, title, **rows)
    return page if path is None else page.save(path)


def launch_of(
    body: Any,
    *,
    psi: Any = None,
    omega: Any = None,
    u: Any = None,
    model: str = "full",
    method: str | None = None,
    tol: Any = None,
    dt_step: Any = None,
    accuracy: Any = None,
    **values: Any,
) -> Launch:
    """Return one launch, whose numbers are single ones in the units of its body."""
    from rattlesweep.sweeps.single import Launch

    made = one_body(body)
    scale = scale_of(made.units)
    single: dict[str, Any] = {name: number(name, x, scale) for name, x in values.items()}
    psi = psi if isinstance(psi, str) else number("psi", psi)
    if omega is not None:
        state = full_states(omega, u, scale)
        omega = [float(state[f"omega_{x}"]) for x in "xyz"]
    integrator = _integrator(method, tol, dt_step, accuracy)
    return Launch(made, psi=psi, omega=omega, u=u, model=model, integrator=integrator, **single)


def rows_of(
    scale: Scale | None,
    points: int | None = None,
    dt: Any = None,
    steps: bool = False,
    times: Any = None,
    from_time: Any = None,
) -> Rows:
    """Return the rows of a trajectory, whose times may be in seconds."""
    from rattlesweep.analysis.onerun.rows import Rows

    check_count("points", points, 2)
    times = None if times is None else numbers("times", times, scale)
    return Rows(
        points, number("dt", dt, scale), steps, times, number("from_time", from_time, scale)
    )


def stored_scale(source: Replay, run: StoredRun) -> Scale | None:
    """Return the units of the body of a stored run, None if its size is not known."""
    return take(source.prepare(run)[1].bodies.scale, 0)  # type: ignore[arg-type]


def _launched(
    columns: dict[str, Floats], arrays: dict[str, Floats], directed: bool
) -> dict[str, Floats]:
    """Return bodies with the launches that are given, or those of their own table.

    `directed` says whether ``psi`` is given, as a word or in `arrays`.
    """
    if any(name in arrays for name in (*LAUNCH, *STATE)):
        # Directions and horizons of the table belong to its own launches.
        own = (*LAUNCH, "psi", "t_end", *STATE)
        columns = {name: columns[name] for name in columns if name not in own}
    elif directed:
        if "u_x" in columns:
            raise ConfigError("psi does not go with the full states of the table; leave it out")
        columns.pop("psi", None)
    launched = columns | arrays
    missing = [name for name in LAUNCH if name not in launched]
    if missing and "u_x" not in launched:
        raise ConfigError(
            f"{' and '.join(missing)} missing; give n_i and omega_xy0, or a DataFrame that has them"
        )
    return launched


def _integrator(method: Any, tol: Any, dt_step: Any, accuracy: Any) -> dict[str, Any]:
    """Return the config's `integrator`, which refuses what its method does not take."""
    given = {"method": method, "tol": tol, "dt": dt_step, "accuracy": accuracy}
    return {key: value for key, value in given.items() if value is not None}
