"""One run from Python or the command line, prepared as a sweep prepares its runs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.sweeps.blocks.block import prepare_block
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.cases.sources import GridBodies
from rattlesweep.sweeps.config.load import parse_config

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rattlesweep.integrate.batch import Batch
    from rattlesweep.sweeps.cases.launches import Launches
    from rattlesweep.sweeps.config.schema import Config


def single_run(
    body: Rattleback,
    *,
    n_i: float,
    omega_xy0: float,
    t_end: float | None,
    psi: str | float,
    model: str,
    integrator: Mapping[str, Any],
) -> tuple[Config, Launches, Batch | None]:
    """Config, launch and batch of one run: those of a sweep of one body.

    Parameters
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
        ``full``, ``reduced`` or ``gh``; for the last there is no batch.
    integrator : mapping
        Keys of the config's ``integrator``.

    Raises
    ------
    ConfigError
        If an argument is wrong.
    """
    config = parse_config(
        {
            "bodies": {"source": "preset", "name": "GH"},
            "spin": {"n_i": [n_i], "omega_xy0": [omega_xy0], "psi": psi},
            "model": model,
            "horizon": {"t_rgh": 5.0} if t_end is None else {"t": t_end},
            "integrator": dict(integrator),
        }
    )
    # The body itself, checked when it was made, in the preset's place.
    source = GridBodies({name: getattr(body, name) for name in PARAMETERS}, {})
    plan = replace(make_plan(config), source=source)
    return config, *prepare_block(plan, plan.block(0))
