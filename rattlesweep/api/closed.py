"""What theory says of a body, in closed form."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from rattlesweep.physics import theory
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.launch import direction, garcia_hubbard
from rattlesweep.physics.theory import Modes


def modes(body: Rattleback) -> Modes:
    """Frequencies, directions and torque coefficients of a body (Eqs. def-omega_pr, Kp, Kr).

    Parameters
    ----------
    body : Rattleback

    Returns
    -------
    Modes
        With floats: ``omega_p omega_r omega_p0 omega_r0`` in ``sqrt(g/a)``, ``psi_p psi_r`` in
        radians, ``K_p K_r`` without a unit.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> round(rs.modes(rs.Rattleback.gh()).omega_p, 3)
    1.439
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
        Oscillation along the relevant mode, above zero; both in ``sqrt(g/a)``.

    Raises
    ------
    ConfigError
        If there is no such launch.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> round(rs.reversal_time_gh(rs.Rattleback.gh(), n_i=0.1, omega_xy0=0.01), 1)
    108.2
    """
    from rattlesweep.study.derived import check_launch

    check_launch(n_i, omega_xy0)
    found = theory.modes(body.alpha, body.beta, body.theta, body.phi, body.xi)
    psi = direction(found, n_i, "relevant")
    return float(garcia_hubbard(body, found, n_i, omega_xy0, psi).t_rgh)
