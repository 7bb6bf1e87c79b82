"""What theory says of bodies, in closed form, of one or of arrays."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rattlesweep.api.arrays import Bodies, body_columns, broadcast, column_scale, numbers
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.physics import full, steady, theory
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.physics.launch import direction, garcia_hubbard
from rattlesweep.physics.theory import Modes

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


class GrowthRates(NamedTuple):
    """Growth rates of the amplitudes of the two modes of a steady spin, in ``sqrt(g/a)``."""

    pitch: Floats | float
    roll: Floats | float


def modes(body: Bodies) -> Modes:
    """Frequencies, directions and torque coefficients of bodies (Eqs. def-omega_pr, Kp, Kr).

    Parameters
    ----------
    body : Rattleback, sequence or array of Rattleback, or DataFrame
        A table has the columns ``alpha beta gamma theta phi xi``, angles in radians.

    Returns
    -------
    Modes
        ``omega_p omega_r omega_p0 omega_r0`` in ``sqrt(g/a)``, ``psi_p psi_r`` in radians,
        ``K_p K_r`` without a unit: floats of one body, arrays of the shape of several.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> gh = rs.Rattleback.gh()
    >>> round(rs.modes(gh).omega_p, 3)
    1.439
    >>> rs.modes([gh, gh.mirrored()]).K_r.round(4)
    array([ 0.0968, -0.0968])
    """
    found = theory.modes(*_parameters(body, "alpha", "beta", "theta", "phi", "xi").values())
    return Modes(**{name: _plain(value) for name, value in vars(found).items()})


def reversal_time_gh(body: Bodies, n_i: ArrayLike, omega_xy0: ArrayLike) -> Any:
    """Garcia and Hubbard's time of reversal (Eqs. trgh-p, trgh-m), in ``sqrt(a/g)``.

    Parameters
    ----------
    body : Rattleback, sequence or array of Rattleback, or DataFrame
        As for :func:`modes`.
    n_i : array_like
        Initial spin, not zero; its sign chooses the direction.
    omega_xy0 : array_like
        Oscillation along the relevant mode, above zero; both in ``sqrt(g/a)``.

    Returns
    -------
    float or ndarray
        Of the shape to which bodies, spins and oscillations broadcast.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> gh = rs.Rattleback.gh()
    >>> round(rs.reversal_time_gh(gh, n_i=0.1, omega_xy0=0.01), 1)
    108.2
    >>> rs.reversal_time_gh(gh, n_i=[0.1, -0.1], omega_xy0=[[0.01], [0.1]]).round(1)
    array([[108.2, 833.5],
           [ 22.8, 343.4]])
    """
    columns = body_columns(body)
    scale = column_scale(columns)
    launch = {
        "n_i": numbers("n_i", n_i, scale),
        "omega_xy0": numbers("omega_xy0", omega_xy0, scale),
    }
    if not launch["n_i"].all():
        raise ConfigError("n_i: a launch without spin, n_i = 0, has no time of reversal")
    parts, _ = broadcast({name: columns[name] for name in PARAMETERS} | launch)
    body_ = SimpleNamespace(**parts)
    found = theory.modes(body_.alpha, body_.beta, body_.theta, body_.phi, body_.xi)
    psi = direction(found, body_.n_i, "relevant")
    return _plain(garcia_hubbard(body_, found, body_.n_i, body_.omega_xy0, psi).t_rgh)


def bondi_threshold(body: Bodies) -> Any:
    """Bondi's threshold spin ``n_c1`` (Eq. def-nc1), in ``sqrt(g/a)``.

    A steady spin beyond it, ``n < n_c1 < 0``, is linearly stable; of mirrored bodies (``xi > 0``)
    all signs are the other ones.

    Parameters
    ----------
    body : Rattleback, sequence or array of Rattleback, or DataFrame
        As for :func:`modes`.

    Returns
    -------
    float or ndarray
        Of the shape of the bodies; NaN where no spin is stable.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> gh = rs.Rattleback.gh()
    >>> rs.bondi_threshold([gh, gh.mirrored()]).round(3)
    array([-1.676,  1.676])
    """
    parts = _parameters(body, *PARAMETERS)
    xi = parts.pop("xi")
    threshold = theory.bondi_threshold(**parts)
    return _plain(np.where(xi > 0, -threshold, threshold))


def growth_rates(body: Bodies, n: ArrayLike, *, exact: bool = False) -> GrowthRates:
    """Growth rates of the amplitudes of pitch and roll while the spin is ``n``.

    Parameters
    ----------
    body : Rattleback, sequence or array of Rattleback, or DataFrame
        As for :func:`modes`.
    n : array_like
        Spin, in ``sqrt(g/a)``.
    exact : bool
        Whether to take the eigenvalues at this spin; by default their limit for a small one,
        ``n K_p / 2`` and ``-n K_r / 2`` (Eq. case-instab1).  Energies grow twice as fast.

    Returns
    -------
    GrowthRates
        ``pitch`` and ``roll``, in ``sqrt(g/a)``: floats, or arrays of the shape to which bodies and
        spins broadcast.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> gh = rs.Rattleback.gh()
    >>> small, exact = rs.growth_rates(gh, 0.1), rs.growth_rates(gh, 0.1, exact=True)
    >>> round(small.pitch, 5), round(exact.pitch, 5)
    (0.02767, 0.0276)
    >>> rs.growth_rates(gh, [-1.6, -1.7], exact=True).roll.round(5)
    array([ 0.00151, -0.00046])
    """
    columns = body_columns(body)
    n = numbers("n", n, column_scale(columns))
    parts, _ = broadcast({name: columns[name] for name in PARAMETERS} | {"n": n})
    spin = parts.pop("n")
    if exact:
        rates = steady.growth(full.constants(**parts), spin)
    else:
        del parts["gamma"]
        found = theory.modes(**parts)
        rates = theory.growth_rates(found.K_p, found.K_r, spin)
    return GrowthRates(*map(_plain, rates))


def _parameters(body: Bodies, *names: str) -> dict[str, Floats]:
    columns = body_columns(body)
    return {name: columns[name] for name in names}


def _plain(values: Floats) -> Any:
    """A float where there is one value, else the array."""
    return float(values) if np.ndim(values) == 0 else np.asarray(values)
