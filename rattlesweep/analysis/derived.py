"""Derive all quantities of one body, with units and words."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

from rattlesweep.errors import ConfigError
from rattlesweep.physics import full, steady, theory
from rattlesweep.physics.body import PARAMETERS, PRESETS, Rattleback
from rattlesweep.physics.theory import direction, garcia_hubbard

FREQUENCY, TIME = "sqrt(g/a)", "sqrt(a/g)"
SPINS = ("n_c1", "n_i", "n_0")  # in turns a minute
# Options that make a body, and those that may stand beside them.
WAYS: dict[str, tuple[set[str], set[str]]] = {
    "preset": ({"preset"}, {*PARAMETERS, "c"}),
    "plain": ({*PARAMETERS}, {"c"}),
    "dumbbell": ({"gamma", "f_sd", "theta", "phi", "xi"}, {"c"}),
    "si": ({"mass", "height", "inertia", "radii"}, {"axes_angle", "z_up", "c"}),
    "half_ellipsoid": ({"half_ellipsoid", "mass"}, {"skew", "weights", "at"}),
}


class Quantity(NamedTuple):
    """A number with its unit and what it is; None where there is none."""

    name: str
    value: float | None
    unit: str
    description: str
    in_si: tuple[float, str] | None  # with an SI unit, of a body that was given in such


def make_body(given: dict[str, Any]) -> Rattleback:
    """Return the body of the options of the command line; None stands for not given."""
    given = {name: value for name, value in given.items() if value is not None}
    if "xi_deg" in given and "xi" not in given:
        given["xi"] = math.radians(given.pop("xi_deg"))
    way = next((w for w, (own, more) in WAYS.items() if own <= set(given) <= own | more), "")
    c = given.get("c")
    if not way:
        ways = "; ".join(map(_options, (own for own, _ in WAYS.values())))
        raise ConfigError(
            f"{_options(given) or 'no option'} given, which is not one whole body; give one of "
            f"these, and what may change in it: {ways}"
        )
    if isinstance(c, str) and way != "si":
        raise ConfigError("--c has a unit, but the body has no size; give a number in a")
    try:
        if way == "preset":
            return replace(PRESETS[given.pop("preset")](), **given)
        if way == "dumbbell":
            given.pop("c", None)
            return replace(Rattleback.shell_dumbbell(**given), c=c)
        if way == "si":
            given |= {"c": c * given["height"]} if isinstance(c, float) else {}
            return Rattleback.from_si(**given)
        if way == "half_ellipsoid":
            sizes = zip(("length", "width", "height"), given.pop(way), strict=True)
            return Rattleback.half_ellipsoid(**dict(sizes), **given)
        return Rattleback(**given)
    except ValueError as error:
        raise ConfigError(str(error)) from None


def _options(names: Iterable[str]) -> str:
    return " ".join(sorted(f"--{name.replace('_', '-')}" for name in names))


def derived(
    body: Rattleback, n_i: float, omega_xy0: float, sigma: float = 0.0, rolling: float = 0.0
) -> list[Quantity]:
    """Return everything theory says of a body and a launch along the relevant mode."""
    good = 0 < abs(n_i) < math.inf and 0 < omega_xy0 < math.inf
    if not (good and 0 <= sigma < math.inf and 0 <= rolling < math.inf):
        raise ConfigError(
            f"--n-i {n_i:g}, --omega-xy0 {omega_xy0:g}, --sigma {sigma:g}, --rolling {rolling:g}: "
            "the spin must not be zero, the oscillation positive, the dissipation not negative"
        )
    b, m = body, theory.modes(body.alpha, body.beta, body.theta, body.phi, body.xi)
    psi = direction(m, n_i, "relevant")
    gh = garcia_hubbard(b, m, n_i, omega_xy0, psi)
    n_c1 = float(theory.bondi_threshold(b.alpha, b.beta, b.gamma, b.theta, b.phi))
    constants = full.constants(b.alpha, b.beta, b.gamma, b.theta, b.phi, b.xi)
    exact = steady.growth(constants, n_i, sigma)
    damping = theory.damping_rates(b.alpha, b.beta, m, sigma)
    rates = theory.growth_rates(m.K_p, m.K_r, n_i)
    small = [rate - loss for rate, loss in zip(rates, damping, strict=True)]
    # Under rolling resistance nothing small grows, and with losses no spin stays.
    known = math.nan if rolling > 0 else 1.0
    losses: list[tuple[str, Any, str, str]] = []
    if sigma > 0 or rolling > 0:
        n_c1 = math.nan
        losses = [
            ("sigma", sigma, "M a^2 sqrt(g/a)", "dissipation: torque -sigma omega"),
            ("rolling", rolling, "a", "dissipation: lever of the rolling resistance"),
            ("spin_decay", sigma / b.gamma, FREQUENCY, "rate at which an upright spin falls"),
            ("n_growth_pitch", known * 2 * damping[0] / m.K_p, FREQUENCY,
             "spin above which the pitch grows, small spin"),
            ("n_growth_roll", known * -2 * damping[1] / m.K_r, FREQUENCY,
             "spin below which the roll grows, small spin"),
        ]  # fmt: skip
    shape = [] if b.c is None else [("c", b.c, "a", "body: vertical semi-axis of the ellipsoid")]
    rows: list[tuple[str, Any, str, str]] = [
        *((name, getattr(b, name), "rad" if name == "xi" else "1", "body") for name in PARAMETERS),
        *shape,
        ("omega_p", m.omega_p, FREQUENCY, "frequency of the pitch (the faster mode)"),
        ("omega_r", m.omega_r, FREQUENCY, "frequency of the roll (the slower mode)"),
        ("omega_p0", m.omega_p0, FREQUENCY, "frequency of the pitch at zero skew angle"),
        ("omega_r0", m.omega_r0, FREQUENCY, "frequency of the roll at zero skew angle"),
        ("psi_p", m.psi_p, "rad", "direction of the pitch from the x axis"),
        ("psi_r", m.psi_r, "rad", "direction of the roll from the x axis"),
        ("K_p", m.K_p, "1", "asymmetric torque coefficient of the pitch"),
        ("K_r", m.K_r, "1", "asymmetric torque coefficient of the roll"),
        ("n_c1", -n_c1 if b.xi > 0 else n_c1, FREQUENCY, "Bondi's threshold of the steady spin"),
        ("n_i", n_i, FREQUENCY, "initial spin"),
        ("omega_xy0", omega_xy0, FREQUENCY, "initial oscillation"),
        ("psi", psi, "rad", "direction of the launch: the relevant mode"),
        ("n_0", gh.n_0, FREQUENCY, "spin if all energy were spin"),
        ("t_rgh", gh.t_rgh, TIME, "Garcia and Hubbard's reversal time in the spin's direction"),
        ("growth_pitch", known * small[0], FREQUENCY, "growth rate of the pitch, small spin"),
        ("growth_roll", known * small[1], FREQUENCY, "growth rate of the roll, small spin"),
        ("growth_pitch_exact", known * exact[0], FREQUENCY, "growth rate of the pitch at n_i"),
        ("growth_roll_exact", known * exact[1], FREQUENCY, "growth rate of the roll at n_i"),
        *losses,
    ]
    sizes = {} if b.units is None else b.units.sizes
    found = []
    for name, number, unit, text in rows:
        value = float(number) if math.isfinite(float(number)) else None
        size, si_unit = sizes.get(unit, (math.nan, ""))
        if name in SPINS:
            size, si_unit = size * 30 / math.pi, "rpm"
        in_si = (value * size, si_unit) if value is not None and unit in sizes else None
        found.append(Quantity(name, value, unit, text, in_si))
    return found
