"""The Python interface: a few calls over the rooms below."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.integrate.status import Status
from rattlesweep.physics import theory
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.launch import direction
from rattlesweep.physics.theory import Modes

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

__all__ = ["Modes", "Rattleback", "Run", "Sweep", "load", "modes", "reversal_time_gh", "simulate",
           "sweep"]  # fmt: skip


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
        Oscillation along the relevant mode; both in ``sqrt(g/a)``.
    """
    found = theory.modes(body.alpha, body.beta, body.theta, body.phi, body.xi)
    psi = direction(found, n_i, "relevant")
    speed = theory.oscillation_speed(body.alpha, body.beta, body.gamma, omega_xy0, psi)
    relevant = theory.relevant_coefficient(found.K_p, found.K_r, n_i)
    return float(theory.reversal_time(relevant, n_i, speed))


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
    tol: float = 1e-9,
    dt: float = 0.002,
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
    method, tol, dt
        As in the config's ``integrator``.

    Returns
    -------
    Run

    Raises
    ------
    ConfigError
        If an argument is wrong.
    """
    from rattlesweep.sweep.blocks import finish_block, prepare_block
    from rattlesweep.sweep.bodies import GridBodies
    from rattlesweep.sweep.config import parse_config
    from rattlesweep.sweep.plan import make_plan
    from rattlesweep.sweep.types import TYPES

    adaptive = {"tol": tol} if _adaptive(method) else {"dt": dt}
    config = parse_config(
        {
            "bodies": {"source": "preset", "name": "GH"},
            "spin": {"n_i": [n_i], "omega_xy0": [omega_xy0], "psi": psi},
            "model": model,
            "horizon": {"t_rgh": 5.0} if t_end is None else {"t": t_end},
            "integrator": {"method": method, **adaptive},
        }
    )
    # The body itself, checked when it was made, in the preset's place; mirror images too.
    source = GridBodies({name: getattr(body, name) for name in PARAMETERS}, {})
    plan = replace(make_plan(config), source=source)
    columns = finish_block(config, *prepare_block(plan, plan.block(0)), threads=1)
    codes, _ = columns["type"]
    status, words = columns["status"]
    row: dict[str, Any] = {
        name: _number(columns[name][0])
        for name in ("t_r", "t_end", "n_end", "n_steps", "energy_drift", "amp_growth",
                     "n_departure", "near_tangencies")
    }  # fmt: skip
    good = int(status[0]) == Status.OK
    return Run(type=TYPES[int(codes[0])] if good else None, status=words[int(status[0])], **row)


def _adaptive(method: str) -> bool:
    from rattlesweep.integrate.tableau import METHODS

    return method not in METHODS or METHODS[method].adaptive


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
        from rattlesweep.sweep.store import Store

        self.directory = Path(directory)
        self._store = Store(self.directory)
        self.manifest: dict[str, Any] = self._store.read_manifest()

    @property
    def runs(self) -> pd.DataFrame:
        """One row a run: the columns of ``runs/*.parquet``."""
        import pyarrow as pa

        tables = [table for _, table in self._store.iter_blocks()]
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
    """
    from rattlesweep.sweep.config import load_config, parse_config
    from rattlesweep.sweep.config_physics import checked_plan
    from rattlesweep.sweep.engine import run_sweep

    file = isinstance(config, str | Path)
    loaded = load_config(config) if isinstance(config, str | Path) else parse_config(config)
    base = Path(str(config)).resolve().parent if file else None
    plan, _ = checked_plan(loaded, base)
    directory = Path(output if output is not None else loaded.directory)
    run_sweep(plan, directory, base=base, threads=threads)
    return Sweep(directory)
