"""The Python interface: a few calls over the rooms below, which they import when they are made."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.errors import ConfigError, ConfigWarning, OutputError
from rattlesweep.physics import theory
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.launch import direction, garcia_hubbard
from rattlesweep.physics.theory import Modes

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas as pd

    from rattlesweep.study.onerun.course import Trajectory

__all__ = ["ConfigError", "Modes", "OutputError", "Rattleback", "Run", "Sweep", "load", "modes",
           "replay", "reversal_time_gh", "simulate", "sweep", "trajectory"]  # fmt: skip


def modes(body: Rattleback) -> Modes:
    """Frequencies, directions and torque coefficients of a body (Eqs. def-omega_pr, Kp, Kr).

    Parameters
    ----------
    body : Rattleback

    Returns
    -------
    Modes
        With floats: ``omega_p omega_r omega_p0 omega_r0`` in ``sqrt(g/a)``, ``psi_p psi_r`` in
        radians, ``K_p K_r`` without a unit.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> round(rs.modes(rs.Rattleback.gh()).omega_p, 3)
    1.439
    """
    found = theory.modes(body.alpha, body.beta, body.theta, body.phi, body.xi)
    numbers: dict[str, Any] = {name: float(value) for name, value in vars(found).items()}
    return replace(found, **numbers)


def reversal_time_gh(body: Rattleback, n_i: float, omega_xy0: float) -> float:
    """Garcia and Hubbard's time of reversal (Eqs. trgh-p, trgh-m), in ``sqrt(a/g)``.

    Parameters
    ----------
    body : Rattleback
    n_i : float
        Initial spin, not zero; its sign chooses the direction.
    omega_xy0 : float
        Oscillation along the relevant mode, above zero; both in ``sqrt(g/a)``.

    Raises
    ------
    ConfigError
        If there is no such launch.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> round(rs.reversal_time_gh(rs.Rattleback.gh(), n_i=0.1, omega_xy0=0.01), 1)
    108.2
    """
    from rattlesweep.study.derived import check_launch

    check_launch(n_i, omega_xy0)
    found = theory.modes(body.alpha, body.beta, body.theta, body.phi, body.xi)
    psi = direction(found, n_i, "relevant")
    return float(garcia_hubbard(body, found, n_i, omega_xy0, psi).t_rgh)


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


def simulate(
    body: Rattleback,
    *,
    n_i: float,
    omega_xy0: float,
    t_end: float | None = None,
    psi: str | float = "relevant",
    model: str = "full",
    method: str = "dop853",
    tol: float | None = None,
    dt_step: float | None = None,
    dt: float | None = None,
) -> Run:
    """Integrate one body from one launch to its first reversal or to ``t_end``.

    Parameters
    ----------
    body : Rattleback
    n_i, omega_xy0 : float
        Initial spin and oscillation, in ``sqrt(g/a)``.
    t_end : float, optional
        Horizon, in ``sqrt(a/g)``; by default 5 t_rGH of the spin's own direction.
    psi : str or float
        ``relevant``, ``pitch``, ``roll`` or degrees.
    model : str
        ``full``, ``reduced`` or ``gh``.
    method, tol, dt_step
        Method, and the tolerance of an adaptive one or the step of a fixed-step one: ``method, tol,
        dt`` of the config's ``integrator``, with its defaults.
    dt
        Former name of ``dt_step``; in :func:`trajectory` it is the distance of two rows.

    Returns
    -------
    Run

    Raises
    ------
    ConfigError
        If an argument is wrong.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> run = rs.simulate(rs.Rattleback.gh(), n_i=0.1, omega_xy0=0.01)
    >>> round(run.t_r, 2), run.type, run.status
    (112.09, 'R', 'ok')
    """
    from rattlesweep.sweeps.blocks.block import finish_block
    from rattlesweep.sweeps.blocks.single import Launch, single_run
    from rattlesweep.sweeps.tables.arrow import build_table
    from rattlesweep.sweeps.tables.columns import runs_schema

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
    integrator = _integrator(method, tol, dt_step)
    run = single_run(Launch(body, n_i, omega_xy0, t_end, psi, model, integrator))
    table = build_table(finish_block(*run, threads=1), runs_schema((), model))
    (row,) = table.select(list(Run.__dataclass_fields__)).to_pylist()
    return Run(**row)


def trajectory(
    body: Rattleback,
    *,
    n_i: float,
    omega_xy0: float,
    t_end: float | None = None,
    psi: str | float = "relevant",
    model: str = "full",
    channels: Sequence[str] = ("t", "n"),
    points: int | None = None,
    dt: float | None = None,
    steps: bool = False,
    times: Any = None,
    method: str = "dop853",
    tol: float | None = None,
    dt_step: float | None = None,
    e_p0: float | None = None,
    e_r0: float | None = None,
) -> Trajectory:
    """Integrate one launch to ``t_end``, past its reversals, and give it as a table.

    Parameters
    ----------
    body, n_i, omega_xy0, t_end, psi, model
        As for :func:`simulate`.
    channels : sequence of str
        Columns of the table; ``rattlesweep trajectory --channels list`` prints all of them.
    points, dt, steps, times
        One way to choose the rows: so many evenly from 0 to ``t_end`` (by default 2001, or 20 a
        period of the pitch if that is more), one every ``dt``, one per accepted step, or any
        increasing times; in ``sqrt(a/g)``.
    method, tol, dt_step
        As for :func:`simulate`; not to be confused with ``dt``.
    e_p0, e_r0 : float, optional
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
    >>> path = rs.trajectory(rs.Rattleback.gh(), n_i=0.1, omega_xy0=0.01, t_end=150, points=4)
    >>> path.table.shape, path.reversals.round(2)
    ((4, 2), array([112.09]))
    """
    from rattlesweep.study.onerun.course import Course, collect
    from rattlesweep.study.onerun.rows import Rows
    from rattlesweep.sweeps.blocks.single import Launch

    integrator = _integrator(method, tol, dt_step)
    launch = Launch(body, n_i, omega_xy0, t_end, psi, model, integrator, e_p0, e_r0)
    return collect(Course(launch, channels=channels, rows=Rows(points, dt, steps, times)))


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
    channels, points, dt, steps, times
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
    from rattlesweep.study.onerun.course import Course, collect
    from rattlesweep.study.onerun.replay import Replay
    from rattlesweep.study.onerun.rows import Rows

    source = Replay(Path(directory))
    run = source.find(case, sample)
    rows = Rows(points, dt, steps, times)
    course = Course(source.prepare(run, t_end), channels=channels, rows=rows)
    source.prove(run)
    found = collect(course)
    run.check(course)
    return found


def _integrator(method: str, tol: float | None, dt_step: float | None) -> dict[str, Any]:
    """The config's `integrator`, which refuses what its method does not take."""
    given = {"method": method, "tol": tol, "dt": dt_step}
    return {key: value for key, value in given.items() if value is not None}


class Sweep:
    """An output directory; tables are read when they are asked for.

    Parameters
    ----------
    directory : path
        Of a sweep, whole or still running.

    Attributes
    ----------
    directory : Path
    manifest : dict
        The resolved config, its hash, versions, machine and times.
    """

    def __init__(self, directory: str | Path) -> None:
        from rattlesweep.sweeps.store.stored import open_stored

        self.directory = Path(directory)
        self._stored = open_stored(self.directory)
        self.manifest: dict[str, Any] = self._stored.manifest.dump()

    @property
    def runs(self) -> pd.DataFrame:
        """One row a run: the columns of ``runs/*.parquet``; no rows before the first block."""
        import pyarrow as pa

        from rattlesweep.sweeps.tables.columns import runs_schema

        tables = [table for _, table in self._stored.store.iter_blocks()]
        if not tables:
            config = self._stored.config
            tables = [runs_schema(config.record, config.model).empty_table()]
        frame: pd.DataFrame = pa.concat_tables(tables).to_pandas()
        return frame

    @property
    def summary(self) -> pd.DataFrame:
        """One row a case."""
        frame: pd.DataFrame = self._stored.store.read_summary().to_pandas()
        return frame

    def __repr__(self) -> str:
        """Name the directory and how far it is."""
        return f"<Sweep {self.directory}: {self.manifest['runs']} runs, {self.manifest['state']}>"


def load(directory: str | Path) -> Sweep:
    """Open an output directory.

    Raises
    ------
    ConfigError
        If it is none.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> rs.load("out/steady").summary[["n_i", "fraction_R"]]  # doctest: +SKIP
    """
    return Sweep(directory)


def sweep(
    config: str | Path | Mapping[str, Any],
    *,
    output: str | Path | None = None,
    threads: int | None = None,
) -> Sweep:
    """Run a sweep, or go on with one that was stopped.

    Parameters
    ----------
    config : path or mapping
        A config file, or what one would hold.
    output : path, optional
        Output directory; overrides the config's.
    threads : int, optional
        Threads of the kernel.

    Returns
    -------
    Sweep

    Raises
    ------
    ConfigError, OutputError
        If the config is wrong, or the directory cannot be written.

    Warns
    -----
    ConfigWarning
        Of what makes little physical sense in the config, as ``rattlesweep run`` does.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> rs.sweep("configs/quickstart.yaml").runs.t_r.describe()  # doctest: +SKIP
    """
    from rattlesweep.sweeps.config.load import load_config, parse_config
    from rattlesweep.sweeps.engines.run import run_sweep
    from rattlesweep.sweeps.sense.sense import checked_plan

    if isinstance(config, str | Path):
        loaded, base = load_config(config), Path(config).resolve().parent
    else:
        loaded, base = parse_config(config), None
    plan, doubts = checked_plan(loaded, base)
    for doubt in doubts:
        warnings.warn(doubt, ConfigWarning, stacklevel=2)
    directory = Path(output if output is not None else loaded.directory)
    run_sweep(plan, directory, base=base, threads=threads)
    return Sweep(directory)
