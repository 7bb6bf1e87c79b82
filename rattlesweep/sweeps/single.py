"""One run from Python or the command line, prepared in the way of a sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import Batch
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.sweeps.block import prepare_runs
from rattlesweep.sweeps.bodies.sources import GridBodies
from rattlesweep.sweeps.bodies.table import TableBodies
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.launches import Launches, with_energies
from rattlesweep.sweeps.plan import Plan, make_plan


@dataclass(frozen=True)
class Launch:
    """One run as a user asks for it, in the words of a config.

    The launch is `n_i` and `omega_xy0`, or the full state `omega` and `u` (None: upright), with
    components along the body's axes.  Without `t_end` the horizon is 5 t_rGH of the spin's own
    direction.  `e_p0` and `e_r0` are initial energies of pitch and roll in the reduced model, in
    ``M g a``; None stands for those of the launch.
    """

    body: Rattleback
    n_i: float | None = None
    omega_xy0: float | None = None
    t_end: float | None = None
    psi: str | float | None = None
    model: str = "full"
    integrator: Mapping[str, Any] = field(default_factory=dict)
    e_p0: float | None = None
    e_r0: float | None = None
    omega: Sequence[float] | None = None
    u: Sequence[float] | None = None
    sigma: float = 0.0
    rolling: float = 0.0
    record: Sequence[str] = ()


def is_full_state(omega: Any, u: Any, spin: Mapping[str, Any]) -> bool:
    """Return whether a launch is a full state; refuse half of one, and one beside a spin."""
    if omega is None and u is None:
        return False
    if given := [name for name, value in spin.items() if value is not None]:
        told = f"{' and '.join(given)} given with a full state"
        raise ConfigError(f"{told}; keep omega and u, or n_i, omega_xy0 and psi")
    if omega is None:
        raise ConfigError("omega: missing; a full state has omega and u")
    return True


def plan_of(launch: Launch, source: TableBodies | None = None) -> Plan:
    """Return the sweep of one body, or of the bodies, launches and dissipation of `source`."""
    c = launch.body.c
    bodies: dict[str, Any] = {"source": "preset", "name": "GH"}
    if source is not None:
        bodies = {"source": "table", "path": "the table is in memory"}
        bodies |= {"surface": "ellipsoid"} if source.has_semi_axes else {}
    elif c is not None:
        bodies |= {"surface": "ellipsoid", "c": c}
    spin = {"n_i": launch.n_i, "omega_xy0": launch.omega_xy0, "psi": launch.psi}
    if is_full_state(launch.omega, launch.u, spin):
        state = {"omega": launch.omega, "u": launch.u}
        own: dict[str, Any] = {"launch": {k: list(v) for k, v in state.items() if v is not None}}
    elif launch.t_end is None and launch.n_i == 0:
        raise ConfigError("t_end: missing; a launch without spin has no t_rGH")
    else:
        own = {"spin": {k: v for k, v in spin.items() if v is not None}}
    config = parse_config({
        "bodies": bodies,
        **own,
        "model": launch.model,
        "horizon": {"t_rgh": 5.0} if launch.t_end is None else {"t": launch.t_end},
        "integrator": dict(launch.integrator),
        "dissipation": {"sigma": launch.sigma, "rolling": launch.rolling},
        "record": list(launch.record),
    })  # fmt: skip
    if source is not None:
        assert config.bodies.source == "table"
        return make_plan(config, source=source.with_surface(config.bodies))
    # The body itself, which was checked when it was made, takes the place of the preset.
    names = PARAMETERS if c is None else (*PARAMETERS, "c")
    one = GridBodies({name: getattr(launch.body, name) for name in names}, {})
    return make_plan(config, source=one)


def single_run(launch: Launch) -> tuple[Config, Launches, Batch | None]:
    """Return config, launch and batch of one run, as a sweep has them; no batch for ``gh``."""
    plan = plan_of(launch)
    launches, batch = prepare_runs(plan, np.zeros(1, np.int64), np.zeros(1, np.int64))
    if batch is not None and launch.model == "reduced":
        batch = with_energies(batch, launch.e_p0, launch.e_r0)
    return plan.config, launches, batch
