"""The plan of one run, or of rows in memory, without a config file."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.config.body_sources import TableSource
from rattlesweep.config.read import parse_config
from rattlesweep.config.schema import DIRECTIONS
from rattlesweep.design.bodies.table import TableBodies
from rattlesweep.design.plan import Plan, make_plan
from rattlesweep.physics import theory
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.words.errors import ConfigError, not_one_of
from rattlesweep.words.quantities import DRIVES


@dataclass(frozen=True)
class Launch:
    """One run, as the arguments of a call describe it, in units of the body.

    The names and values are those of the keys of a config, except that the key ``dt``
    of the integrator is ``dt_step`` here.  A run is launched by `n_i`, `omega_xy0` and
    `psi`, or by a full state, `omega` and `u`.  Without `t_end` it ends at 5 t_rGH.
    In the reduced model `e_p0` and `e_r0` replace the initial energies of pitch and
    roll, in ``M g a``.
    """

    body: Rattleback
    n_i: float | None = None
    omega_xy0: float | None = None
    t_end: float | None = None
    psi: str | float | None = None
    model: str = "full"
    integrator: Mapping[str, object] = field(default_factory=dict)
    e_p0: float | None = None
    e_r0: float | None = None
    omega: Sequence[float] | None = None
    u: Sequence[float] | None = None
    # Constants of what acts on the body, by name.
    losses: Mapping[str, float] = field(default_factory=dict)
    record: Sequence[str] = ()


def is_full_state(omega: object, u: object, spin: Mapping[str, object]) -> bool:
    """Return whether a launch is a full state.

    Raises a ConfigError if it also has a value of `spin`, or lacks omega.
    """
    if omega is None and u is None:
        return False
    given = [name for name, value in spin.items() if value is not None]
    if given:
        advice = "keep omega and u, or n_i, omega_xy0 and psi"
        raise ConfigError(f"{' and '.join(given)} given with a full state; {advice}")
    if omega is None:
        raise ConfigError("omega: missing; a full state has omega and u")
    return True


def directions(columns: Mapping[str, Floats], psi: str) -> Floats:
    """Return the direction of the push in each row, from a word for the mode."""
    if psi not in DIRECTIONS:
        raise ConfigError(f"psi: {not_one_of(psi, DIRECTIONS)}, or give degrees")
    names = ("alpha", "beta", "theta", "phi", "xi")
    modes = theory.modes(*(columns[name] for name in names))
    return theory.direction(modes, columns["n_i"], psi)


def plan_of(run: Launch) -> Plan:
    """Return the plan of one run."""
    # The body as a table of one row.  A paraboloid has no c; None becomes NaN.
    names = (*PARAMETERS, "c")
    rows = TableBodies(
        {name: np.array([getattr(run.body, name)], float) for name in names}
    )
    if run.body.rim is not None:
        rows.carried["rim"] = np.array([run.body.rim])
    losses = dict(run.losses)
    for name in DRIVES:
        if name in losses:
            # As a column, since the key of the phase is in degrees.
            rows.columns[name] = np.array([losses.pop(name)], float)
    spin = {"n_i": run.n_i, "omega_xy0": run.omega_xy0, "psi": run.psi}
    if is_full_state(run.omega, run.u, spin):
        launch: dict[str, object] = {"launch": {"omega": run.omega, "u": run.u}}
    elif run.t_end is None and run.n_i == 0:
        raise ConfigError("t_end: missing; a launch without spin has no t_rGH")
    else:
        launch = {"spin": spin}
    horizon = {"t_rgh": 5.0}
    if run.t_end is not None:
        horizon = {"t": run.t_end}
    keys = {"horizon": horizon, "dissipation": losses, **launch}
    return plan_of_rows(rows, run.model, run.integrator, run.record, keys)


def plan_of_rows(
    rows: TableBodies,
    model: str,
    integrator: Mapping[str, object],
    record: Sequence[str],
    keys: Mapping[str, object] = MappingProxyType({}),
) -> Plan:
    """Return the plan of bodies in memory, by default up to 5 t_rGH.

    `keys` are further keys of a config, such as ``spin``.  What they leave out, the
    rows must have as columns.
    """
    steps = {name: value for name, value in integrator.items() if value is not None}
    if "dt_step" in steps:
        steps["dt"] = steps.pop("dt_step")
    try:
        config = parse_config(
            {"model": model, "integrator": steps, "record": list(record), **keys},
            bodies=TableSource.in_memory(rows.surface),
        )
    except ConfigError as error:
        raise ConfigError(map(_of_arguments, error.messages)) from None
    return make_plan(config, rows=rows)


def _of_arguments(message: str) -> str:
    """Return a message about a key of the integrator, as it is named in calls.

    Calls have no section `integrator`.  They name the step ``dt_step``, as ``dt`` is
    the time between the rows of a trajectory.
    """
    message = message.removeprefix("integrator.")
    if message.startswith("dt: "):
        return re.sub(r"\bdt\b", "dt_step", message)
    return message
