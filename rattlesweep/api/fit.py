"""Fit parameters to measurements."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from rattlesweep.api.arrays import one_body
from rattlesweep.api.single import launch_of
from rattlesweep.errors import ConfigError
from rattlesweep.physics.body import Rattleback

if TYPE_CHECKING:
    from rattlesweep.analysis.fit import Fit

LAUNCH = ("n_i", "omega_xy0", "psi", "omega", "u")


def fit(
    body: Rattleback | str,
    data: Any,
    *,
    free: Iterable[str],
    launch: Mapping[str, Any] | None = None,
    sigma: float | str = 0.0,
    rolling: float | str = 0.0,
) -> Fit:
    """Fit parameters of one run to a measured angle or spin, or to reversal times.

    Parameters
    ----------
    body : Rattleback or str
        As measured otherwise.  It needs a size, as those of ``from_si`` and ``half_ellipsoid`` have
        one, if the data are in seconds.
    data : path, DataFrame or mapping of columns
        ``t_s`` and ``angle_deg`` or ``spin_rpm``, or ``reversal_s`` alone; other units go likewise,
        as in ``t_ms`` or ``angle_rad``.  The angle is that of the long axis, seen from above and
        counterclockwise, and may jump by half turns; the spin is its central difference.  The spin
        ``u . omega`` is called ``n_rpm``; ``t`` and ``n`` are in the units of the body.  A row
        without a value is NaN.  The launch is the first row, or the time 0 of the reversals.
    free : sequence of str
        Parameters to fit, of ``n_i, omega_xy0, psi_deg, sigma, rolling, skew`` (which is ``-xi``),
        ``xi, theta, phi, alpha, beta, gamma, c``.  The search begins at what else is given of them.
    launch : mapping, optional
        ``n_i, omega_xy0, psi`` or ``omega, u``, as of :func:`rattlesweep.trajectory`; what is free
        may be left out.
    sigma, rolling : float
        Dissipation.  Numbers are in the units of the body, or texts such as ``"60 rpm"``.

    Returns
    -------
    Fit
        ``values`` and 95 % ``intervals`` by name, ``body`` and ``launch`` with them, ``noise``,
        ``remarks`` on what the data cannot tell, and ``plot()``.

    Raises
    ------
    ConfigError
        If an argument or the data are wrong.

    Notes
    -----
    The intervals are those of the Jacobian at the best fit, for noise that is equal and independent
    from row to row and whose size is estimated from the residuals.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> truth = {"n_i": 0.1, "omega_xy0": 0.01, "sigma": 1e-3}
    >>> data = rs.trajectory("GH", t_end=200, points=400, **truth).table
    >>> found = rs.fit("GH", data, free=["sigma"], launch={"n_i": 0.1, "omega_xy0": 0.01})
    >>> round(found.values["sigma"], 6)
    0.001
    """
    from rattlesweep.analysis.fit import PARAMETERS, fit_run, read_data
    from rattlesweep.sweeps.config import not_one_of

    body = one_body(body)
    names = list(dict.fromkeys([free] if isinstance(free, str) else free))
    for name in names:
        if name not in PARAMETERS:
            raise ConfigError(f"free: {not_one_of(name, PARAMETERS)}")
    if not names:
        raise ConfigError(f"free: name what to fit, of {', '.join(PARAMETERS)}")
    if {"skew", "xi"} <= set(names):
        raise ConfigError("free: skew is -xi; keep one of them")
    if "c" in names and body.c is None:
        raise ConfigError("free: c is of an ellipsoid, and the body is a paraboloid")
    for name in (given := dict(launch or {})):
        if name not in LAUNCH:
            raise ConfigError(f"launch: {not_one_of(name, LAUNCH)}")
    own = [name for name in ("n_i", "omega_xy0", "psi_deg") if name in names]
    if own and {"omega", "u"} & given.keys():
        raise ConfigError(f"launch: a full state has no free {' or '.join(own)}")
    run = launch_of(body, **given, sigma=sigma, rolling=rolling)
    return fit_run(run, read_data(data, body.units), names)
