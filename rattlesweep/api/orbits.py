"""Orbits that return: single ones, those near a run, and their families."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.analysis.orbits.branch import Branch as Branch
from rattlesweep.analysis.orbits.orbit import Orbit as Orbit
from rattlesweep.api.arguments import check_count, full_states, one_body, one_number
from rattlesweep.api.single import NumberOrText, prepare_launch
from rattlesweep.physics.body import Rattleback
from rattlesweep.system.console import Bar
from rattlesweep.words.defaults import BRANCH_STEPS, SEARCH_SECTION
from rattlesweep.words.errors import ConfigError, check_names
from rattlesweep.words.names import BRANCH_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Sequence

_UNIT = 1e-3  # a vertical of another length is a slip


def orbit(
    body: Rattleback | str,
    *,
    omega: Sequence[NumberOrText] | None = None,
    u: Sequence[float] | None = None,
    period: NumberOrText | None = None,
    energy: NumberOrText | None = None,
    symmetric: bool = False,
) -> Orbit:
    """Return the periodic orbit near a state, with its multipliers and their errors.

    The body rolls without friction.  A state is ``u`` and ``omega``, so that a motion
    that returns turned about the vertical is periodic, too.  The period of the result
    is the least one.  docs/orbits.md explains the kinds and the method.

    Stability: stable.

    Parameters
    ----------
    body : Rattleback or str
        A body, or the name of a preset.
    omega, u : sequence of three numbers
        A state near the orbit, along the body's axes: angular velocity in ``sqrt(g/a)``
        and vertical unit vector.
    period : number or str
        Its period, roughly, in ``sqrt(a/g)``.
    energy : number or str, optional
        Energy of the orbit in ``M g a``, zero upright at rest; by default that of the
        state.  Orbits come in families over it.
    symmetric : bool
        Whether to search an orbit that ``(u, omega) -> (u, -omega)`` maps to itself,
        from a position of rest, without omega.  It has an energy of its own.

    Raises
    ------
    ConfigError
        If an argument is wrong, or the state leads to no orbit.

    Examples
    --------
    >>> body = rs.Rattleback(7, 3, 7, 1 / 4, 1 / 9, -0.485)
    >>> found = rs.orbit(body, omega=(1.02, 1.19, -0.28),
    ...     u=(-0.2898, -0.1618, -0.9433), period=7.9, energy=6.52)
    >>> found.kind, round(found.period, 9), found.multipliers.round(5)
    ('doubling', 7.921360272, array([-1.31265,  0.96606, -0.66472]))
    """
    from rattlesweep.analysis.orbits.orbit import find_orbit, find_symmetric
    from rattlesweep.physics.full import from_vectors

    described = one_body(body)
    length = one_number("period", period, described.units)
    if length is None or u is None or (omega is None and not symmetric):
        raise ConfigError(
            "omega, u, period: an orbit needs all three to begin with (a symmetric one "
            "u and period); find_orbits, or orbit --search, finds orbits near a run"
        )
    if not length > 0:
        raise ConfigError(f"period {length:g}: it must be positive")
    wanted = one_number("energy", energy, described.units)
    if symmetric and (omega is not None or wanted is not None):
        raise ConfigError(
            "symmetric: such an orbit begins at rest and has its own energy; leave "
            "omega and energy out"
        )
    given = (0.0, 0.0, 0.0) if omega is None else omega
    columns = full_states(given, u, described.units)
    vectors = [
        np.array([float(columns[f"{name}_{axis}"]) for axis in "xyz"])
        for name in ("u", "omega")
    ]
    size = float(np.linalg.norm(vectors[0]))
    if abs(size - 1) > _UNIT or not vectors[0][2] < 0:
        raise ConfigError(
            "u must be a vector of length 1 with u_z below 0, as [0, 0, -1]"
        )
    vectors[0] /= size
    if symmetric:
        return find_symmetric(described, vectors[0], length)
    return find_orbit(described, from_vectors(*vectors), length, wanted)


def find_orbits(
    body: Rattleback | str,
    *,
    section: str = SEARCH_SECTION,
    from_time: NumberOrText | None = None,
    **launch: Any,
) -> list[Orbit]:
    """Return the periodic orbits near the late part of a run, without repetitions.

    Rows of a section that nearly return are the starts of :func:`orbit`.

    Stability: may change.

    Parameters
    ----------
    body, **launch
        As for ``trajectory``, without friction.
    section : str
        A channel that crosses a value, as for ``trajectory``.
    from_time : number or str, optional
        Begin of the late part; by default 400 before the end, or half of the run if
        that is later.

    Raises
    ------
    ConfigError
        If an argument is wrong, or nothing that nearly returns leads to an orbit.
    """
    from rattlesweep.analysis.orbits.near_returns import orbits_near

    run = prepare_launch(body, **launch)
    start = one_number("from_time", from_time, run.units)
    return orbits_near(run, section, start)


def branch(
    orbit: Orbit,
    along: str = "energy",
    *,
    to: NumberOrText,
    steps: int = BRANCH_STEPS,
    progress: bool | None = None,
) -> Branch:
    """Follow the family of an orbit along the energy or a parameter of the body.

    The family is followed in its arclength, so that it passes folds.  It ends at `to`,
    or after a number of steps.  Along a parameter the energy stays.

    Stability: stable.

    Parameters
    ----------
    orbit : Orbit
        Where the branch begins.
    along : str
        ``energy``, or ``alpha``, ``beta``, ``gamma``, ``theta``, ``phi`` or ``xi``.
    to : number or str
        Value of the energy or the parameter at which the branch ends.
    steps : int
        Largest number of steps; the first one is such that as many lead to `to`.
    progress : bool, optional
        Whether to show a bar, by default in a terminal and in a notebook.

    Raises
    ------
    ConfigError
        If an argument is wrong.

    Examples
    --------
    >>> body = rs.Rattleback(7, 3, 7, 1 / 4, 1 / 9, -0.485)
    >>> first = rs.orbit(body, omega=(1.02, 1.19, -0.28),
    ...     u=(-0.2898, -0.1618, -0.9433), period=7.9, energy=6.52)
    >>> rs.branch(first, "energy", to=6.45, steps=10)
    11 orbits along energy from 6.52 to 6.45; it has reached 6.45
    doubling at energy 6.47785559369 +- 1e-12, period 7.841023687 (row 4)
    """
    from rattlesweep.analysis.orbits.branch import follow_branch

    if not isinstance(orbit, Orbit):
        raise ConfigError("orbit: give an orbit, as rs.orbit returns it")
    check_names("along", [along], BRANCH_PARAMETERS)
    check_count("steps", steps)
    name = "energy" if along == "energy" else "to"
    end = one_number(name, to, orbit.body.units)
    assert end is not None
    with Bar.of_call(progress) as bar:
        report = bar.counting("orbits")
        return follow_branch(orbit, along, end, steps, lambda n: report(n / steps))
