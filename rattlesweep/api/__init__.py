"""The Python interface; theory in closed form is in this module.

A wrong argument raises a ``ConfigError``, which is a ``ValueError``; files that cannot
be read or written raise an ``OutputError``.  Calls import what they need when they are
made.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rattlesweep.analysis.contact import ContactPatch
from rattlesweep.api.arguments import (
    BodiesLike,
    body_columns,
    broadcast,
    column_units,
    numbers,
)
from rattlesweep.api.contact import contact_patch
from rattlesweep.api.drawn import draw_bodies
from rattlesweep.api.exports import export
from rattlesweep.api.fits import fit
from rattlesweep.api.orbits import Branch, Orbit, branch, find_orbits, orbit
from rattlesweep.api.single import Run, simulate
from rattlesweep.api.sweeps import Sweep, load, sweep
from rattlesweep.api.trajectories import Page, Trajectory, replay, show, trajectory
from rattlesweep.api.verdicts import Verdict, verdict
from rattlesweep.arrays import Floats
from rattlesweep.config.clashes import refuse_slip_beside
from rattlesweep.physics import full, steady, theory
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.chaos import is_chaotic
from rattlesweep.physics.theory import Modes, direction, garcia_hubbard
from rattlesweep.statistics.intervals import wilson
from rattlesweep.store.provenance import machine, versions
from rattlesweep.words.errors import ConfigError, OutputError
from rattlesweep.words.quantities import LOSSES

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = [
    "Branch",
    "ConfigError",
    "ContactPatch",
    "GrowthRates",
    "Modes",
    "Orbit",
    "OutputError",
    "Page",
    "Rattleback",
    "Run",
    "Sweep",
    "Trajectory",
    "Verdict",
    "bondi_threshold",
    "branch",
    "contact_patch",
    "draw_bodies",
    "export",
    "find_orbits",
    "fit",
    "growth_rates",
    "is_chaotic",
    "load",
    "machine",
    "modes",
    "orbit",
    "replay",
    "reversal_time_gh",
    "show",
    "simulate",
    "sweep",
    "trajectory",
    "verdict",
    "versions",
    "wilson",
]


# Constants under which small oscillations grow or decay exponentially.
LINEAR_LOSSES = tuple(
    name for name, loss in LOSSES.items() if loss.is_averaged and name != "rolling"
)


class GrowthRates(NamedTuple):
    """Growth rates of the amplitudes of the two modes of a steady spin, in
    ``sqrt(g/a)``.

    Stability: stable.
    """

    pitch: Floats | float
    roll: Floats | float


def modes(body: BodiesLike) -> Modes:
    """Return frequencies, directions and torque coefficients (Eqs. 24, 39 and 40).

    `body` is a body or the name of a preset, a sequence or an array of these, or a
    table with the columns ``alpha beta gamma theta phi xi``.  The result has ``omega_p
    omega_r omega_p0 omega_r0`` in ``sqrt(g/a)``, ``psi_p psi_r`` in radians and ``K_p
    K_r``, each a float for one body and an array for several.

    Stability: stable.

    Examples
    --------
    >>> gh = rs.Rattleback.gh()
    >>> rs.modes([gh, gh.mirrored()]).K_r.round(4)
    array([ 0.0968, -0.0968])
    """
    both: dict[str, Any] = vars(_modes(_columns(body)))
    plain: dict[str, Any] = {name: _plain(values) for name, values in both.items()}
    return Modes(**plain)


def reversal_time_gh(
    body: BodiesLike, n_i: ArrayLike, omega_xy0: ArrayLike
) -> Floats | float:
    """Return Garcia and Hubbard's time of reversal (Eqs. 56 and 58), in ``sqrt(a/g)``.

    `body` is as for ``modes``.  The sign of the initial spin ``n_i``, which must not be
    zero, chooses the direction; ``omega_xy0`` is the initial oscillation along the
    relevant mode, both in ``sqrt(g/a)``.  All arguments broadcast.

    Stability: stable.

    Examples
    --------
    >>> rs.reversal_time_gh("GH", n_i=[0.1, -0.1], omega_xy0=[[0.01], [0.1]]).round(1)
    array([[108.2, 833.5],
           [ 22.8, 343.4]])
    """
    columns = _columns(body, n_i=n_i, omega_xy0=omega_xy0)
    spin = columns["n_i"]
    if not spin.all():
        raise ConfigError("n_i: a launch without spin, n_i = 0, has no reversal time")
    bodies = SimpleNamespace(**columns)
    both = _modes(columns)
    psi = direction(both, spin, "relevant")
    closed = garcia_hubbard(bodies, both, spin, columns["omega_xy0"], psi)
    return _plain(closed.t_rgh)


def bondi_threshold(body: BodiesLike) -> Floats | float:
    """Return Bondi's threshold spin ``n_c1`` (Eq. 73), in ``sqrt(g/a)``.

    A steady spin beyond it, ``n < n_c1 < 0``, is linearly stable.  For mirrored bodies
    (``xi > 0``) all signs change.  `body` is as for ``modes``; the result is NaN where
    no spin is stable.

    Stability: stable.
    """
    columns = _columns(body)
    xi = columns.pop("xi")
    threshold = theory.bondi_threshold(**columns)
    return _plain(np.where(xi > 0, -threshold, threshold))


def growth_rates(
    body: BodiesLike, n: ArrayLike, *, exact: bool = False, **losses: ArrayLike
) -> GrowthRates:
    """Return the growth rates of the amplitudes of pitch and roll at a spin ``n``.

    `body` is as for ``modes``, and ``n``, in ``sqrt(g/a)``, broadcasts with the bodies.
    The rates are eigenvalues if `exact`, else their limits for a small spin, ``n K_p /
    2`` and ``-n K_r / 2`` (Eq. 74).  Energies grow twice as fast.

    `losses` are constants of dissipation by name, which lower the rates: ``sigma``, the
    lever ``pivot`` with the coefficient ``creep``, and ``viscous``.  Eigenvalues are
    known with ``sigma`` alone.

    Stability: stable.

    Raises
    ------
    ConfigError
        If a loss has no growth rate, or friction is viscous and of another kind.
    """
    for name in losses:
        known = ("sigma",) if exact else LINEAR_LOSSES
        if name not in known:
            of_kind = "eigenvalue" if exact else "growth rate"
            raise ConfigError(
                f"{name}: no {of_kind} is known with it; give {' or '.join(known)}"
            )
    columns = _columns(body, n=n, **losses)
    spin = columns.pop("n")
    lossy = {name: columns.pop(name) for name in losses}
    refuse_slip_beside([name for name, values in lossy.items() if np.any(values)])
    if exact:
        sigma = lossy.get("sigma", 0.0)
        pitch, roll = steady.growth(full.constants(**columns), spin, sigma)
    else:
        given = {name: np.zeros(()) for name in LOSSES} | lossy
        pitch, roll = theory.lossy_growth_rates(
            columns["alpha"], columns["beta"], _modes(columns), spin, given
        )
    return GrowthRates(_plain(pitch), _plain(roll))


def _columns(body: BodiesLike, **arrays: ArrayLike) -> dict[str, Floats]:
    """Return the parameters of bodies and other arguments as arrays of one shape."""
    table = body_columns(body)
    units = column_units(table)
    columns = {name: table[name] for name in PARAMETERS}
    for name, values in arrays.items():
        columns[name] = numbers(name, values, units)
    return broadcast(columns)[0]


def _modes(columns: dict[str, Floats]) -> Modes:
    """Return the modes of bodies, which do not depend on gamma."""
    names = [name for name in PARAMETERS if name != "gamma"]
    return theory.modes(**{name: columns[name] for name in names})


def _plain(values: Floats) -> Floats | float:
    """Return an array without dimensions as a float."""
    if np.ndim(values) == 0:
        return float(values)
    return np.asarray(values)
