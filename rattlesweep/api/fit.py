"""Fit parameters to measurements."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from rattlesweep.api.arrays import one_body
from rattlesweep.errors import ConfigError
from rattlesweep.physics.body import Rattleback

if TYPE_CHECKING:
    from rattlesweep.analysis.fit import Fit

LAUNCH = ("n_i", "omega_xy0", "psi", "omega", "u")


def fit(
    body: Rattleback | str,
    data: Any,
    *,
    free: Iterable[str] | Mapping[str, Any],
    launch: Mapping[str, Any] | None = None,
    sigma: float | str = 0.0,
    rolling: float | str = 0.0,
) -> Fit:
    """Fit parameters of one run to a measured angle or spin, or to reversal times.

    Parameters
    ----------
    body : Rattleback or str
        As measured otherwise.  It needs units, as those of ``from_si`` and ``half_ellipsoid`` have,
        if the data are in seconds.
    data : path, DataFrame or mapping of columns
        ``t_s`` and ``angle_deg`` or ``spin_rpm``, or ``reversal_s`` alone; other units go likewise,
        as in ``t_ms``, ``angle_rad`` or ``spin_rad/s``.  The angle is that of the long axis, seen
        from above and counterclockwise, and may jump by half turns; the spin is its central
        difference.  The spin ``u . omega`` is called ``n_rpm``; ``t`` and ``n`` are in the units of
        the body.  A row without a value is NaN.  The first row, or the time 0 of the reversals, is
        the launch.
    free : sequence of str, or mapping
        Parameters to fit, of ``n_i, omega_xy0, psi_deg, sigma, rolling, skew`` (which is ``-xi``),
        ``xi, theta, phi, alpha, beta, gamma, c``.  In a mapping the value is where to begin, or
        ``{"start": ..., "low": ..., "high": ...}``, or None.
    launch : mapping, optional
        ``n_i, omega_xy0, psi`` or ``omega, u``, as of :func:`rattlesweep.trajectory`; what is free
        may be left out.
    sigma, rolling : float
        Dissipation.  These and the numbers in `launch` and `free` are in the units of the body, or
        texts with a unit such as ``"60 rpm"``.

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
    from rattlesweep.analysis.fit import PARAMETERS, Free, fit_run, in_body_units, read_data
    from rattlesweep.sweeps.config.messages import not_one_of
    from rattlesweep.sweeps.single import Launch

    body = one_body(body)

    def number(name: str, value: Any, place: str) -> float:
        try:
            return in_body_units(name, value, body.units)
        except (ValueError, TypeError) as error:
            raise ConfigError(f"{place}: {error}") from None

    if isinstance(free, str):
        free = [free]
    wanted: dict[str, Free] = {}
    for name, value in (free if isinstance(free, Mapping) else dict.fromkeys(free)).items():
        if name not in PARAMETERS:
            raise ConfigError(f"free: {not_one_of(name, PARAMETERS)}")
        known, given = PARAMETERS[name], value if isinstance(value, Mapping) else {"start": value}
        for key in given:
            if key not in ("start", "low", "high"):
                raise ConfigError(f"free.{name}: {not_one_of(key, ('start', 'low', 'high'))}")
        start, low, high = (
            default if given.get(key) is None else number(name, given[key], f"free.{name}")
            for key, default in (("start", None), ("low", known.low), ("high", known.high))
        )
        if not known.low <= low < high <= known.high or not low <= (start or low) <= high:
            raise ConfigError(f"free.{name}: start {start}, low {low:g} and high {high:g} must "
                              f"ascend and lie between {known.low:g} and {known.high:g}")  # fmt: skip
        wanted[name] = Free(start, low, high)
    if not wanted:
        raise ConfigError(f"free: name what to fit, of {', '.join(PARAMETERS)}")
    if {"skew", "xi"} <= wanted.keys():
        raise ConfigError("free: skew is -xi; keep one of them")
    if "c" in wanted and body.c is None:
        raise ConfigError("free: c is of an ellipsoid, and the body is a paraboloid")
    arguments = dict(launch or {})
    for name, value in arguments.items():
        if name not in LAUNCH:
            raise ConfigError(f"launch: {not_one_of(name, LAUNCH)}")
        if name in ("n_i", "omega_xy0"):
            arguments[name] = number(name, value, f"launch.{name}")
    losses = {
        name: number(name, value, name) for name, value in (("sigma", sigma), ("rolling", rolling))
    }
    for name in arguments.keys() & {"omega", "u"}:
        if own := wanted.keys() & {"n_i", "omega_xy0", "psi_deg"}:
            raise ConfigError(f"launch.{name}: a full state has no free {' or '.join(own)}")
    run = Launch(body, **arguments, **losses)
    return fit_run(run, read_data(data, body.units), wanted)
