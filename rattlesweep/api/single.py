"""One run: simulated, as a time series, or a stored one again."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from rattlesweep.api.arrays import (
    Bodies,
    body_columns,
    broadcast,
    check_threads,
    full_states,
    is_frame,
    numbers,
    to_frame,
)
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.physics.body import Rattleback
from rattlesweep.progress import Bar

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd
    from numpy.typing import ArrayLike

    from rattlesweep.analysis.onerun.course import Trajectory

LAUNCH, OF_LAUNCH = ("n_i", "omega_xy0"), ("psi", "t_end")
STATE = ("omega_x", "omega_y", "omega_z", "u_x", "u_y", "u_z")


@dataclass(frozen=True)
class Run:
    """Outcome of one run; the fields are the columns of ``runs`` of the same names.

    Attributes
    ----------
    t_r : float or None
        Time of the first reversal, in ``sqrt(a/g)``; None without one by ``t_end``.
    t_end : float
        Time reached.
    type, status : str
        ``type`` is None where ``status`` is not ``ok``.
    """

    t_r: float | None
    t_end: float
    type: str | None
    status: str
    n_end: float
    n_steps: int
    energy_drift: float
    amp_growth: float | None
    n_departure: float | None
    near_tangencies: int


@overload
def simulate(
    body: Rattleback,
    *,
    n_i: float | None = ...,
    omega_xy0: float | None = ...,
    omega: Sequence[float] | None = ...,
    u: Sequence[float] | None = ...,
    t_end: float | None = ...,
    psi: str | float | None = ...,
    model: str = ...,
    method: str = ...,
    tol: float | None = ...,
    dt_step: float | None = ...,
    dt: float | None = ...,
    sigma: float = ...,
    rolling: float = ...,
    threads: int | None = ...,
    progress: bool | None = ...,
) -> Run: ...
@overload
def simulate(
    body: Bodies,
    *,
    n_i: ArrayLike | None = ...,
    omega_xy0: ArrayLike | None = ...,
    omega: ArrayLike | None = ...,
    u: ArrayLike | None = ...,
    t_end: ArrayLike | None = ...,
    psi: str | ArrayLike | None = ...,
    model: str = ...,
    method: str = ...,
    tol: float | None = ...,
    dt_step: float | None = ...,
    dt: float | None = ...,
    sigma: float = ...,
    rolling: float = ...,
    threads: int | None = ...,
    progress: bool | None = ...,
) -> Run | pd.DataFrame: ...
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
    method: str = "dop853",
    tol: float | None = None,
    dt_step: float | None = None,
    dt: float | None = None,
    sigma: float = 0.0,
    rolling: float = 0.0,
    threads: int | None = None,
    progress: bool | None = None,
) -> Run | pd.DataFrame:
    """Integrate bodies from their launches to their first reversals or to ``t_end``.

    One body and numbers give one :class:`Run`.  If anything is an array, all are broadcast by
    NumPy's rules, and a thousand runs cost what a thousand rows of a sweep cost.

    Parameters
    ----------
    body : Rattleback, sequence or array of Rattleback, or DataFrame
        A table has the columns ``alpha beta gamma theta phi xi``, angles in radians; if it also has
        ``n_i omega_xy0`` and perhaps ``psi t_end`` (in radians), these are the launches of its
        rows unless `n_i` and `omega_xy0` are given.  The runs of a sweep are such a table.
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
    method, tol, dt_step
        Method, and the tolerance of an adaptive one or the step of a fixed-step one: ``method, tol,
        dt`` of the config's ``integrator``, with its defaults.
    dt
        Former name of ``dt_step``; in :func:`trajectory` it is the distance of two rows.
    sigma, rolling : float
        Torque ``-sigma omega``, in ``M a^2 sqrt(g/a)``; lever of a rolling resistance, in ``a``.
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
        bodies of which each row is one run.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> gh = rs.Rattleback.gh()
    >>> run = rs.simulate(gh, n_i=0.1, omega_xy0=0.01)
    >>> round(run.t_r, 2), run.type, run.status
    (112.09, 'R', 'ok')
    >>> runs = rs.simulate(gh, n_i=[0.1, 0.2, 0.4], omega_xy0=[[0.01], [0.1]])
    >>> runs.t_r.to_numpy().reshape(runs.attrs["shape"]).round(2)
    array([[112.09,  74.67,  68.48],
           [ 26.77,  33.15,  45.7 ]])
    """
    if dt is not None:
        if dt_step is not None:
            raise ConfigError("dt and dt_step are both given, and mean the same; give dt_step")
        warnings.warn(
            "dt of simulate is called dt_step now, as in trajectory, where dt is the distance of "
            "two rows",
            DeprecationWarning,
            stacklevel=2,
        )
        dt_step = dt
    from rattlesweep.integrate.compile import listening
    from rattlesweep.sweeps.bodies.table import TableBodies, launched_from
    from rattlesweep.sweeps.memory import integrate_plan
    from rattlesweep.sweeps.single import Launch, is_full_state, plan_of

    check_threads(threads)
    columns = body_columns(body)
    given = {"n_i": n_i, "omega_xy0": omega_xy0, "t_end": t_end}
    full = is_full_state(omega, u, {"n_i": n_i, "omega_xy0": omega_xy0, "psi": psi})
    state = full_states(omega, u) if full else {}
    arrays = {name: numbers(name, value) for name, value in given.items() if value is not None}
    if psi is not None and not isinstance(psi, str):
        arrays["psi"] = np.radians(numbers("psi", psi))
    columns, shape = broadcast(_launched(columns, state | arrays, psi is not None))
    columns = {name: column.ravel() for name, column in columns.items()}
    if state:
        columns |= launched_from(columns, "launch")
    launch = Launch(
        # Replaced by the bodies and launches of the rows.
        Rattleback.gh(),
        n_i=1.0, omega_xy0=1.0, psi=psi if isinstance(psi, str) else "relevant",
        model=model,
        integrator=_integrator(method, tol, dt_step),
        sigma=sigma, rolling=rolling,
    )  # fmt: skip
    plan = plan_of(launch, TableBodies(columns))
    with Bar.of_call(progress) as bar, listening(bar.compiling):
        table = integrate_plan(plan, threads if shape else 1, bar.counting(f"{plan.runs} runs"))
    if not shape:
        (row,) = table.select(list(Run.__dataclass_fields__)).to_pylist()
        return Run(**row)
    frame = to_frame(table.drop_columns(["case", "sample"]))
    frame.attrs["shape"] = shape
    if is_frame(body) and shape == (len(body),):
        frame.index = body.index
    return frame


def trajectory(
    body: Rattleback,
    *,
    n_i: float | None = None,
    omega_xy0: float | None = None,
    omega: Sequence[float] | None = None,
    u: Sequence[float] | None = None,
    t_end: float | None = None,
    psi: str | float | None = None,
    model: str = "full",
    channels: Sequence[str] = ("t", "n"),
    points: int | None = None,
    dt: float | None = None,
    steps: bool = False,
    times: Any = None,
    from_time: float | None = None,
    method: str = "dop853",
    tol: float | None = None,
    dt_step: float | None = None,
    e_p0: float | None = None,
    e_r0: float | None = None,
    sigma: float = 0.0,
    rolling: float = 0.0,
) -> Trajectory:
    """Integrate one launch to ``t_end``, past its reversals, and give it as a table.

    Parameters
    ----------
    body, n_i, omega_xy0, omega, u, t_end, psi, model
        As for :func:`simulate`.
    channels : sequence of str
        Columns of the table; ``rattlesweep trajectory --channels list`` prints all of them.
    points, dt, steps, times
        One way to choose the rows: so many evenly from 0 to ``t_end`` (by default 2001, or 20 a
        period of the pitch if that is more), one every ``dt``, one per accepted step, or any
        increasing times; in ``sqrt(a/g)``.
    from_time : float, optional
        When the rows begin, in ``sqrt(a/g)``; the run begins at its launch all the same.
    method, tol, dt_step, sigma, rolling
        As for :func:`simulate`; ``dt_step`` is not to be confused with ``dt``.
    e_p0, e_r0 : float, optional
        Energies of pitch and roll with which the reduced model begins, in ``M g a``; by default
        the launch's, where one of them is zero.

    Returns
    -------
    Trajectory
        ``table`` (pandas), ``units``, ``reversals``, ``zeros`` (of the spin, all of them),
        ``status``, ``warning``.  The accepted steps, and so the first zero, are those of
        :func:`simulate`, whatever rows are asked for.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> path = rs.trajectory(rs.Rattleback.gh(), n_i=0.1, omega_xy0=0.01, t_end=150, points=4)
    >>> path.table.shape, path.reversals.round(2)
    ((4, 2), array([112.09]))
    """
    from rattlesweep.analysis.onerun.course import Course, collect
    from rattlesweep.analysis.onerun.rows import Rows
    from rattlesweep.sweeps.single import Launch

    integrator = _integrator(method, tol, dt_step)
    launch = Launch(
        body, n_i, omega_xy0, t_end, psi, model, integrator, e_p0, e_r0, omega, u, sigma, rolling
    )
    rows = Rows(points, dt, steps, times, from_time)
    return collect(Course(launch, channels=channels, rows=rows))


def replay(
    directory: str | Path,
    case: int,
    sample: int,
    *,
    t_end: float | None = None,
    channels: Sequence[str] = ("t", "n"),
    points: int | None = None,
    dt: float | None = None,
    steps: bool = False,
    times: Any = None,
    from_time: float | None = None,
) -> Trajectory:
    """Integrate a stored run again as a trajectory, proved to be the stored one bit for bit.

    Parameters
    ----------
    directory : path
        Of a sweep, whole or still running.
    case, sample : int
        Which run: the columns of ``runs`` of these names.
    t_end : float, optional
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
    from rattlesweep.analysis.onerun.rows import Rows

    source = Replay(Path(directory))
    run = source.find(case, sample)
    rows = Rows(points, dt, steps, times, from_time)
    course = Course(source.prepare(run, t_end), channels=channels, rows=rows)
    source.prove(run)
    found = collect(course)
    run.check(course)
    return found


def _launched(
    columns: dict[str, Floats], arrays: dict[str, Floats], directed: bool
) -> dict[str, Floats]:
    """Bodies with the launches that are given, or those of their own table.

    ``directed`` says whether ``psi`` is given, as a word or in ``arrays``.
    """
    if any(name in arrays for name in (*LAUNCH, *STATE)):
        # Directions and horizons of the table belong to its own launches.
        own = (*LAUNCH, *OF_LAUNCH, *STATE)
        columns = {name: columns[name] for name in columns if name not in own}
    elif directed:
        if "u_x" in columns:
            raise ConfigError("psi does not go with the full states of the table; leave it out")
        columns.pop("psi", None)
    launched = columns | arrays
    if "u_x" in launched:
        return launched
    if missing := [name for name in LAUNCH if name not in launched]:
        raise ConfigError(
            f"{' and '.join(missing)} missing; give n_i and omega_xy0, or a DataFrame that has them"
        )
    return launched


def _integrator(method: str, tol: float | None, dt_step: float | None) -> dict[str, Any]:
    """The config's `integrator`, which refuses what its method does not take."""
    given = {"method": method, "tol": tol, "dt": dt_step}
    return {key: value for key, value in given.items() if value is not None}
