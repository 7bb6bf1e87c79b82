"""The Python interface: a few calls over the rooms below."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.integrate.status import Status
from rattlesweep.physics import theory
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.launch import direction, garcia_hubbard
from rattlesweep.physics.theory import Modes

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas as pd

    from rattlesweep.study.onerun.course import Trajectory

__all__ = ["Modes", "Rattleback", "Run", "Sweep", "load", "modes", "reversal_time_gh", "simulate",
           "sweep", "trajectory"]  # fmt: skip


def modes(body: Rattleback) -> Modes:
    """Frequencies, directions and torque coefficients of a body (Eqs. def-omega_pr, Kp, Kr).

    Returns
    -------
    Modes
        With floats: ``omega_p omega_r psi_p psi_r omega_p0 omega_r0 K_p K_r``.
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
        Time of the first reversal; None without one by ``t_end``.
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
        ``full`` or ``reduced``.
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
    """
    from rattlesweep.errors import ConfigError
    from rattlesweep.sweeps.blocks.block import finish_block
    from rattlesweep.sweeps.blocks.single import Launch, single_run
    from rattlesweep.sweeps.tables.types import TYPES

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
    launch = Launch(body, n_i, omega_xy0, t_end, psi, model, _integrator(method, tol, dt_step))
    config, launches, batch = single_run(launch)
    columns = finish_block(config, launches, batch, threads=1)
    codes, _ = columns["type"]
    status, words = columns["status"]
    row: dict[str, Any] = {
        name: _number(columns[name][0])
        for name in ("t_r", "t_end", "n_end", "n_steps", "energy_drift", "amp_growth",
                     "n_departure", "near_tangencies")
    }  # fmt: skip
    good = int(status[0]) == Status.OK
    return Run(type=TYPES[int(codes[0])] if good else None, status=words[int(status[0])], **row)


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
    body : Rattleback
    n_i, omega_xy0 : float
        Initial spin and oscillation, in ``sqrt(g/a)``.
    t_end : float, optional
        Horizon, in ``sqrt(a/g)``; by default 5 t_rGH of the spin's own direction.
    psi : str or float
        ``relevant``, ``pitch``, ``roll`` or degrees.
    model : str
        ``full``, ``reduced`` or ``gh``.
    channels : sequence of str
        Columns of the table; ``rattlesweep.study.onerun.channels.CHANNELS`` lists them.
    points, dt, steps, times
        One way to choose the rows: so many evenly from 0 to ``t_end`` (by default 2001, or 20 a
        period of the pitch if that is more), one every ``dt``, one per accepted step, or any
        increasing times.
    method, tol, dt_step
        As for :func:`simulate`; not to be confused with ``dt``.
    e_p0, e_r0 : float, optional
        Energies of pitch and roll with which the reduced model begins, in ``M g a``; by default
        the launch's, where one of them is zero.

    Returns
    -------
    Trajectory
        ``table`` (pandas), ``reversals``, ``zeros`` (of the spin, all of them), ``status``,
        ``warning``.  The accepted steps, and so the first zero, are those of :func:`simulate`,
        whatever rows are asked for.

    Raises
    ------
    ConfigError
        If an argument is wrong.
    """
    from rattlesweep.study.onerun.course import Course, collect

    return collect(
        Course(
            body, n_i=n_i, omega_xy0=omega_xy0, t_end=t_end, psi=psi, model=model,
            channels=channels, points=points, dt=dt, steps=steps, times=times,
            integrator=_integrator(method, tol, dt_step), e_p0=e_p0, e_r0=e_r0,
        )
    )  # fmt: skip


def _integrator(method: str, tol: float | None, dt_step: float | None) -> dict[str, Any]:
    """The config's `integrator`, which refuses what its method does not take."""
    given = {"method": method, "tol": tol, "dt": dt_step}
    return {key: value for key, value in given.items() if value is not None}


def _number(value: Any) -> Any:
    plain = value.item()
    return None if plain != plain else plain


class Sweep:
    """An output directory; tables are read when they are asked for.

    Parameters
    ----------
    directory : path
        Of a sweep, whole or still running.
    """

    def __init__(self, directory: str | Path) -> None:
        from rattlesweep.sweeps.store.provenance import read_manifest
        from rattlesweep.sweeps.store.store import Store

        self.directory = Path(directory)
        self._store = Store(self.directory)
        self.manifest: dict[str, Any] = read_manifest(self._store)

    @property
    def runs(self) -> pd.DataFrame:
        """One row a run: the columns of ``runs/*.parquet``; no rows before the first block."""
        import pyarrow as pa

        from rattlesweep.sweeps.tables.columns import runs_schema

        tables = [table for _, table in self._store.iter_blocks()]
        if not tables:
            config = self.manifest["config"]
            tables = [runs_schema(config["record"], config["model"]).empty_table()]
        frame: pd.DataFrame = pa.concat_tables(tables).to_pandas()
        return frame

    @property
    def summary(self) -> pd.DataFrame:
        """One row a case."""
        frame: pd.DataFrame = self._store.read_summary().to_pandas()
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
    """
    from rattlesweep.errors import ConfigWarning
    from rattlesweep.sweeps.config.load import load_config, parse_config
    from rattlesweep.sweeps.engines.run import run_sweep
    from rattlesweep.sweeps.sense.sense import checked_plan

    file = isinstance(config, str | Path)
    loaded = load_config(config) if isinstance(config, str | Path) else parse_config(config)
    base = Path(str(config)).resolve().parent if file else None
    plan, doubts = checked_plan(loaded, base)
    for doubt in doubts:
        warnings.warn(doubt, ConfigWarning, stacklevel=2)
    directory = Path(output if output is not None else loaded.directory)
    run_sweep(plan, directory, base=base, threads=threads)
    return Sweep(directory)
