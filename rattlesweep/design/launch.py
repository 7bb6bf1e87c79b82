"""Launches of one run or of several in memory, and their plan."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.config.body_sources import TableSource
from rattlesweep.config.read import parse_config
from rattlesweep.config.schema import DIRECTIONS
from rattlesweep.design.bodies.table import OMEGA, TableBodies, U, launched_from
from rattlesweep.design.plan import Plan, make_plan
from rattlesweep.physics import theory
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.words.errors import ConfigError, not_one_of

UPRIGHT = (0.0, 0.0, -1.0)  # the vertical along the axes of an upright body


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


def is_full_state(omega: object, u: object, spin: Mapping[str, object]) -> bool:
    """Return whether a launch is a full state.

    Raises a ConfigError if it also has a value of `spin`, or lacks omega.
    """
    if omega is None and u is None:
        return False
    given = [name for name, value in spin.items() if value is not None]
    if given:
        raise ConfigError(
            f"{' and '.join(given)} given with a full state; keep omega and u, or n_i, "
            "omega_xy0 and psi"
        )
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


def launch_rows(launches: Sequence[Launch]) -> TableBodies:
    """Return the runs of launches, which have values of the same names, as rows."""
    first = launches[0]
    # A paraboloid has no c, and a launch may have no end; None becomes NaN.
    columns = {
        name: np.array([getattr(run.body, name) for run in launches], float)
        for name in (*PARAMETERS, "c")
    }
    columns["t_end"] = np.array([run.t_end for run in launches], float)
    for name in first.losses:
        columns[name] = np.array([run.losses[name] for run in launches], float)
    spin = {"n_i": first.n_i, "omega_xy0": first.omega_xy0}
    if is_full_state(first.omega, first.u, {**spin, "psi": first.psi}):
        omega = np.array([run.omega for run in launches], float)
        u = np.array([UPRIGHT if run.u is None else run.u for run in launches], float)
        columns |= dict(zip(OMEGA, omega.T, strict=True))
        columns |= dict(zip(U, u.T, strict=True))
        columns |= launched_from(columns)
    else:
        check_launched([name for name, value in spin.items() if value is None])
        for name in spin:
            columns[name] = np.array([getattr(run, name) for run in launches], float)
        if first.psi is None or isinstance(first.psi, str):
            columns["psi"] = directions(columns, first.psi or "relevant")
        else:
            columns["psi"] = np.radians(np.array([run.psi for run in launches], float))
    rows = TableBodies(columns)
    if first.body.rim is not None:
        rows.carried["rim"] = np.array([run.body.rim for run in launches], float)
    return rows


def check_launched(missing: Sequence[str]) -> None:
    """Raise a ConfigError about the values that a launch lacks, if it lacks some."""
    if missing:
        names = " and ".join(missing)
        raise ConfigError(f"{names} missing; give both, or omega")


def plan_of(run: Launch) -> Plan:
    """Return the plan of one run."""
    return plan_of_rows(launch_rows([run]), run.model, run.integrator, [])


def plan_of_rows(
    rows: TableBodies,
    model: str,
    integrator: Mapping[str, object],
    record: Sequence[str],
) -> Plan:
    """Return the plan of launches in memory, by default up to 5 t_rGH."""
    steps = {name: value for name, value in integrator.items() if value is not None}
    if "dt_step" in steps:
        steps["dt"] = steps.pop("dt_step")
    try:
        config = parse_config(
            {"model": model, "integrator": steps, "record": list(record)},
            bodies=TableSource.in_memory(rows.surface),
        )
        return make_plan(config, rows=rows)
    except ConfigError as error:
        raise ConfigError(map(_of_arguments, error.messages)) from None


def _of_arguments(message: str) -> str:
    """Return a message about a key of a config, as it is named in calls.

    Calls have no sections `integrator`, `dissipation` and `horizon`.  They name the
    step ``dt_step``, as ``dt`` is the time between the rows of a trajectory.
    """
    message = message.removeprefix("integrator.").replace("dissipation.", "")
    if message.startswith("dt: "):
        return re.sub(r"\bdt\b", "dt_step", message)
    if message.startswith("horizon.t: "):
        return message.replace("horizon.t", "t_end").partition(", so give horizon")[0]
    return message
