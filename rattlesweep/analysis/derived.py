"""The quantities that theory derives from a body and its launch."""

import math
from typing import Any, NamedTuple

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics import full, steady, stone, theory
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.readings import Shape, turning_friction
from rattlesweep.physics.si import Units
from rattlesweep.physics.theory import direction, garcia_hubbard
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import (
    COUPLE_CONSTANTS,
    LENGTH,
    LOSSES,
    QUANTITIES,
    RATE,
    TIME,
)

IN_RPM = ("n", "n_i", "n_0", "n_c1", "n_reduced", "n_gh")  # in SI units in rpm
TORQUES = ("pivot_torque",)  # in SI units in N m, although their unit is of energies
# A coefficient of friction that a smooth stone on a smooth table may lack.
COMMON_FRICTION = 0.3
SLIPS_AT_REVERSAL = (
    "to reverse without slip this launch needs a coefficient of friction of about "
    "{:.2g}; with less the body slips, as it does with mu"
)


class DerivedQuantity(NamedTuple):
    """A derived number, or None where theory has none."""

    name: str
    value: float | None
    unit: str
    description: str
    # Value and SI unit, if the size of the body is known.
    in_si: tuple[float, str] | None


def needed_friction(body: Rattleback, psi: Floats, n_0: Floats) -> float:
    """Return about the coefficient of friction that rolling needs at a reversal.

    There all of the energy, that of the spin `n_0`, is in the oscillation along `psi`.
    NaN if the body would tip over.
    """
    surface = [body.theta, body.phi, body.xi]
    ix, iy, iz, cxx, cxy, cyy = full.constants(
        body.alpha, body.beta, body.gamma, *surface
    )
    shape = Shape(cxx, cxy, cyy, stone.inverse_semi_axis(body.c))
    energy = float(0.5 * body.gamma * n_0**2)
    return turning_friction(np.array([ix, iy, iz]), shape, float(psi), energy)


def derived(
    body: Rattleback, n_i: float, omega_xy0: float, **losses: float
) -> list[DerivedQuantity]:
    """Return all that theory says about a body and a launch on the relevant mode.

    `losses` are constants of dissipation.
    """
    if n_i == 0:
        raise ConfigError("--n-i 0: a launch without spin has no reversal time")
    b = body
    m = theory.modes(b.alpha, b.beta, b.theta, b.phi, b.xi)
    psi = direction(m, n_i, "relevant")
    gh = garcia_hubbard(b, m, n_i, omega_xy0, psi)
    friction = needed_friction(body, psi, gh.n_0)
    losses = {name: losses.get(name, 0.0) for name in COUPLE_CONSTANTS}
    sigma = losses["sigma"]
    lossy = any(value > 0 for value in losses.values())
    # With losses no spin is steady.
    n_c1 = float(theory.bondi_threshold(b.alpha, b.beta, b.gamma, b.theta, b.phi))
    if b.xi > 0:
        n_c1 = -n_c1
    if lossy:
        n_c1 = math.nan
    constants = full.constants(b.alpha, b.beta, b.gamma, b.theta, b.phi, b.xi)
    damping = np.array(theory.damping_rates(b.alpha, b.beta, m, sigma))
    exact = np.array(steady.growth(constants, n_i, sigma))
    small = np.array(theory.growth_rates(m.K_p, m.K_r, n_i)) - damping
    outgrows = 2 * damping / [m.K_p, -m.K_r]
    if any(losses[name] > 0 for name in COUPLE_CONSTANTS if not LOSSES[name].is_linear):
        # For example, with rolling resistance no small oscillation grows.
        exact *= math.nan
        small *= math.nan
        outgrows *= math.nan
    rows: list[tuple[str, Any, str, str]] = []
    for name in PARAMETERS:
        rows.append((name, getattr(b, name), QUANTITIES[name].unit, "body"))
    if b.c is not None:
        rows.append(("c", b.c, LENGTH, "body: vertical semi-axis of the ellipsoid"))
    rows += [
        ("omega_p", m.omega_p, RATE, "frequency of the pitch (the faster mode)"),
        ("omega_r", m.omega_r, RATE, "frequency of the roll (the slower mode)"),
        ("omega_p0", m.omega_p0, RATE, "frequency of the pitch at zero skew angle"),
        ("omega_r0", m.omega_r0, RATE, "frequency of the roll at zero skew angle"),
        ("psi_p", m.psi_p, "rad", "direction of the pitch from the x axis"),
        ("psi_r", m.psi_r, "rad", "direction of the roll from the x axis"),
        ("K_p", m.K_p, "1", "asymmetric torque coefficient of the pitch"),
        ("K_r", m.K_r, "1", "asymmetric torque coefficient of the roll"),
        ("n_c1", n_c1, RATE, "Bondi's threshold of the steady spin"),
        ("n_i", n_i, RATE, "initial spin"),
        ("omega_xy0", omega_xy0, RATE, "initial oscillation"),
        ("psi", psi, "rad", "direction of the launch: the relevant mode"),
        ("n_0", gh.n_0, RATE, "spin if all energy were spin"),
        (
            "t_rgh",
            gh.t_rgh,
            TIME,
            "Garcia and Hubbard's reversal time in the spin's direction",
        ),
        ("friction", friction, "1", "friction that rolling needs where it reverses"),
        ("growth_pitch", small[0], RATE, "growth rate of the pitch, small spin"),
        ("growth_roll", small[1], RATE, "growth rate of the roll, small spin"),
        ("growth_pitch_exact", exact[0], RATE, "growth rate of the pitch at n_i"),
        ("growth_roll_exact", exact[1], RATE, "growth rate of the roll at n_i"),
    ]
    if lossy:
        decay = sigma / b.gamma
        for name, loss in LOSSES.items():
            if name not in losses or (loss.optional and not losses[name]):
                continue
            rows.append((name, losses[name], loss.unit, f"dissipation: {loss.meaning}"))
        rows += [
            ("spin_decay", decay, RATE, "rate at which an upright spin falls"),
            (
                "n_growth_pitch",
                outgrows[0],
                RATE,
                "spin above which the pitch grows, small spin",
            ),
            (
                "n_growth_roll",
                outgrows[1],
                RATE,
                "spin below which the roll grows, small spin",
            ),
        ]
    return [quantity_of(body, *row) for row in rows]


def quantity_of(
    body: Rattleback, name: str, number: float, unit: str, description: str
) -> DerivedQuantity:
    """Return a number with its value in SI units; None if it is not finite."""
    if not math.isfinite(number):
        return DerivedQuantity(name, None, unit, description, None)
    value = float(number)
    if body.units is None or unit not in body.units.sizes:
        return DerivedQuantity(name, value, unit, description, None)
    size, si_unit = si_of(name, unit, body.units)
    return DerivedQuantity(name, value, unit, description, (value * size, si_unit))


def si_of(name: str, unit: str, units: Units) -> tuple[float, str]:
    """Return the size of a quantity's unit in SI units, and the name of these."""
    size, si_unit = units.sizes[unit]
    if name in IN_RPM:
        return size * (30 / math.pi), "rpm"
    if name in TORQUES:
        return size, "N m"
    return size, si_unit
