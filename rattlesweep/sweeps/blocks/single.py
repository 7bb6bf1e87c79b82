"""One run from Python or the command line, prepared as a sweep prepares its runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.sweeps.blocks.block import prepare_block
from rattlesweep.sweeps.cases.launches import with_energies
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.cases.sources import GridBodies
from rattlesweep.sweeps.config.load import parse_config

if TYPE_CHECKING:
    from rattlesweep.integrate.batch import Batch
    from rattlesweep.sweeps.cases.launches import Launches
    from rattlesweep.sweeps.cases.plan import Plan
    from rattlesweep.sweeps.cases.sources import Source
    from rattlesweep.sweeps.config.schema import Config


@dataclass(frozen=True)
class Launch:
    """One run as it is asked for: what is launched, how, and what follows it.

    Attributes
    ----------
    body : Rattleback
        Mirror images too.
    n_i, omega_xy0 : float
        Initial spin and oscillation, in ``sqrt(g/a)``.
    t_end : float or None
        Horizon, in ``sqrt(a/g)``; None for 5 t_rGH of the spin's own direction.
    psi : str or float
        ``relevant``, ``pitch``, ``roll`` or degrees.
    model : str
        ``full``, ``reduced`` or ``gh``.
    integrator : mapping
        Keys of the config's ``integrator``.
    e_p0, e_r0 : float or None
        Energies of pitch and roll with which the reduced model begins, in ``M g a``; None for the
        launch's.
    """

    body: Rattleback
    n_i: float
    omega_xy0: float
    t_end: float | None = None
    psi: str | float = "relevant"
    model: str = "full"
    integrator: Mapping[str, Any] = field(default_factory=dict)
    e_p0: float | None = None
    e_r0: float | None = None


def plan_of(launch: Launch, source: Source | None = None) -> Plan:
    """A sweep of one body, or of the bodies of `source`, which may bring their own launches.

    Raises
    ------
    ConfigError
        If an argument is wrong.
    """
    config = parse_config(
        {
            "bodies": {"source": "preset", "name": "GH"},
            "spin": {"n_i": [launch.n_i], "omega_xy0": [launch.omega_xy0], "psi": launch.psi},
            "model": launch.model,
            "horizon": {"t_rgh": 5.0} if launch.t_end is None else {"t": launch.t_end},
            "integrator": dict(launch.integrator),
        }
    )
    if source is None:
        # The body itself, checked when it was made, in the preset's place.
        source = GridBodies({name: getattr(launch.body, name) for name in PARAMETERS}, {})
    return replace(make_plan(config), source=source)


def single_run(launch: Launch) -> tuple[Config, Launches, Batch | None]:
    """Config, launch and batch of one run: those of a sweep of one body; no batch for ``gh``.

    Raises
    ------
    ConfigError
        If an argument is wrong.
    """
    plan = plan_of(launch)
    launches, batch = prepare_block(plan, plan.block(0))
    if batch is not None and launch.model == "reduced":
        batch = with_energies(batch, launch.e_p0, launch.e_r0)
    return plan.config, launches, batch
