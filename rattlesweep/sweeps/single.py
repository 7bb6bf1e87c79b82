"""One run from Python or the command line, prepared as a sweep prepares its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import Batch
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.sweeps.block import prepare_runs
from rattlesweep.sweeps.bodies.sources import GridBodies, Source
from rattlesweep.sweeps.config.load import parse_config
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.launches import Launches, with_energies
from rattlesweep.sweeps.plan import Plan, make_plan


@dataclass(frozen=True)
class Launch:
    """One run as it is asked for: what is launched, how, and what follows it.

    The spin is given by `n_i`, `omega_xy0` and `psi` (``relevant``, which None stands for,
    ``pitch``, ``roll`` or degrees), or by a full state: angular velocity `omega` in ``sqrt(g/a)``
    and vertical unit vector `u` (None: upright), in components along the body's axes. `t_end` is
    None for 5 t_rGH of the spin's own direction; `integrator` has keys of the config's. The reduced
    model begins with the energies `e_p0` and `e_r0` of pitch and roll, in ``M g a``, None for the
    launch's.
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

    @property
    def surface(self) -> dict[str, Any]:
        """The part of a config's `bodies` that says it."""
        return {} if self.body.c is None else {"surface": "ellipsoid", "c": self.body.c}

    @property
    def config(self) -> dict[str, Any]:
        """The part of a config that says it."""
        spin = {"n_i": self.n_i, "omega_xy0": self.omega_xy0, "psi": self.psi}
        if is_full_state(self.omega, self.u, spin):
            state = {"omega": self.omega, "u": self.u}
            return {"launch": {name: list(v) for name, v in state.items() if v is not None}}
        for name in ("n_i", "omega_xy0"):
            if spin[name] is None:
                raise ConfigError(f"{name}: missing; give n_i and omega_xy0, or omega and u")
        if self.t_end is None and self.n_i == 0:
            raise ConfigError(
                "t_end: missing; a launch without spin has no t_rGH, so give t_end in sqrt(a/g)"
            )
        return {"spin": {name: value for name, value in spin.items() if value is not None}}


def is_full_state(omega: Any, u: Any, spin: Mapping[str, Any]) -> bool:
    """Whether a launch is a full state; refuses half of one, and one beside a spin."""
    if omega is None and u is None:
        return False
    if given := [name for name, value in spin.items() if value is not None]:
        raise ConfigError(
            f"{' and '.join(given)} given with a full state, which says the spin and the "
            "oscillation itself; keep omega and u, or n_i, omega_xy0 and psi"
        )
    if omega is None:
        raise ConfigError("omega: missing; a full state has omega and u")
    return True


def plan_of(launch: Launch, source: Source | None = None) -> Plan:
    """A sweep of one body, or of the bodies of `source`, which may bring their own launches."""
    config = parse_config(
        {
            "bodies": {"source": "preset", "name": "GH"} | launch.surface,
            **launch.config,
            "model": launch.model,
            "horizon": {"t_rgh": 5.0} if launch.t_end is None else {"t": launch.t_end},
            "integrator": dict(launch.integrator),
            "dissipation": {"sigma": launch.sigma, "rolling": launch.rolling},
            "record": list(launch.record),
        }
    )
    if source is None:
        # The body itself, checked when it was made, in the preset's place.
        names = [*PARAMETERS, *(["c"] if launch.surface else [])]
        source = GridBodies({name: getattr(launch.body, name) for name in names}, {})
    return make_plan(config, source=source)


def single_run(launch: Launch) -> tuple[Config, Launches, Batch | None]:
    """Config, launch and batch of one run: those of a sweep of one body; no batch for ``gh``."""
    plan = plan_of(launch)
    launches, batch = prepare_runs(plan, np.zeros(1, np.int64), np.zeros(1, np.int64))
    if batch is not None and launch.model == "reduced":
        batch = with_energies(batch, launch.e_p0, launch.e_r0)
    return plan.config, launches, batch
