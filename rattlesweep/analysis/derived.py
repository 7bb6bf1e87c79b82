"""The quantities that theory derives from a body and its launch."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rattlesweep.arrays import Floats
from rattlesweep.physics import full, steady, stone, theory
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.driven import driven_spin, growth_of_drive, spin_of_push
from rattlesweep.physics.friction import losses as laws
from rattlesweep.physics.readings import Shape, turning_friction
from rattlesweep.physics.si import Units
from rattlesweep.physics.theory import direction, garcia_hubbard
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import (
    COUPLE_CONSTANTS,
    DRIVES,
    LENGTH,
    LOSSES,
    QUANTITIES,
    RATE,
    TIME,
)

IN_RPM = (
    *("n", "n_i", "n_0", "n_c1", "n_reduced", "n_gh"),
    *("n_base_pitch", "n_base_roll", "n_base"),
)  # in SI units in rpm
IN_HERTZ = ("base_frequency", "base_frequency_pitch", "base_frequency_roll")
TORQUES = ("pivot_torque",)  # in SI units in N m, although their unit is of energies
# A coefficient of friction that a smooth stone on a smooth table may lack.
COMMON_FRICTION = 0.3
SLIPS_AT_REVERSAL = (
    "to reverse without slip this launch needs a coefficient of friction of about "
    "{:.2g}; with less the body slips, as it does with mu"
)


MODES = ("pitch", "roll")
# Unit and meaning of each quantity.  A body without `c` lacks it, and one without
# losses or on a plane at rest what follows `growth_roll_exact`.
DERIVED: dict[str, tuple[str, str]] = {
    **{name: (QUANTITIES[name].unit, "body") for name in PARAMETERS},
    "c": (LENGTH, "body: vertical semi-axis of the ellipsoid"),
    "omega_p": (RATE, "frequency of the pitch (the faster mode)"),
    "omega_r": (RATE, "frequency of the roll (the slower mode)"),
    "omega_p0": (RATE, "frequency of the pitch at zero skew angle"),
    "omega_r0": (RATE, "frequency of the roll at zero skew angle"),
    "psi_p": ("rad", "direction of the pitch from the x axis"),
    "psi_r": ("rad", "direction of the roll from the x axis"),
    "K_p": ("1", "asymmetric torque coefficient of the pitch"),
    "K_r": ("1", "asymmetric torque coefficient of the roll"),
    "n_c1": (RATE, "Bondi's threshold of the steady spin"),
    "n_i": (RATE, "initial spin"),
    "omega_xy0": (RATE, "initial oscillation"),
    "psi": ("rad", "direction of the launch: the relevant mode"),
    "n_0": (RATE, "spin if all energy were spin"),
    "t_rgh": (TIME, "Garcia and Hubbard's reversal time in the spin's direction"),
    "friction": ("1", "friction that rolling needs where it reverses"),
    "growth_pitch": (RATE, "growth rate of the pitch, small spin"),
    "growth_roll": (RATE, "growth rate of the roll, small spin"),
    "growth_pitch_exact": (RATE, "growth rate of the pitch at n_i"),
    "growth_roll_exact": (RATE, "growth rate of the roll at n_i"),
    **{
        name: (loss.unit, f"dissipation: {loss.meaning}")
        for name, loss in LOSSES.items()
        if name in COUPLE_CONSTANTS
    },
    "spin_decay": (RATE, "rate at which sigma slows an upright spin"),
    "n_growth_pitch": (RATE, "spin above which the pitch grows, small spin"),
    "n_growth_roll": (RATE, "spin below which the roll grows, small spin"),
    "least_pitch": (RATE, "least pitch that grows at n_i"),
    "least_roll": (RATE, "least roll that grows at n_i"),
    "K_p_creep": ("1", "K_p less what creep takes"),
    "K_r_creep": ("1", "K_r less what creep takes"),
    "lever_critical": (LENGTH, "lever of pivoting above which no steady spin reverses"),
    "base_frequency": (RATE, QUANTITIES["base_frequency"].meaning),
    "base_acceleration": ("1", "amplitude of its acceleration in g"),
    "n_base": (RATE, "mean spin under the drive; none: none, or not known"),
}
for _mode in MODES:
    DERIVED |= {
        f"base_frequency_{_mode}": (
            RATE,
            f"drive at which the {_mode} spins the body up",
        ),
        f"n_base_{_mode}": (
            RATE,
            f"mean spin under a drive of this acceleration tuned to the {_mode}",
        ),
        f"growth_base_{_mode}": (
            RATE,
            f"growth rate of the {_mode} at rest under the drive",
        ),
    }


class DerivedQuantity(NamedTuple):
    """A derived number, or None where theory has none."""

    name: str
    value: float | None
    unit: str
    description: str
    # Value and SI unit, if the size of the body is known.
    in_si: tuple[float, str] | None


@dataclass(frozen=True)
class GrowingModes:
    """What pitch and roll gain from the spin and lose; arrays of both, pitch first.

    The formulas are those of :mod:`rattlesweep.physics.friction.losses`: small spins.
    """

    omega: Floats
    moment: Floats  # about the contact point
    gain: Floats  # share of the energy, per spin: K_p and -K_r
    share: Floats  # of the energy that is lost at any spin
    creep: Floats  # the same by creep, per unit of |n|
    rolling: float  # lever
    mu: float  # friction in the patch

    def rates(self, n: float) -> Floats:
        """Return the growth rates of amplitudes, without rolling resistance."""
        return laws.growth_of_mode(self.gain, n, self.share, self.creep)

    @property
    def thresholds(self) -> Floats:
        """The spins beyond which the modes grow, without rolling resistance."""
        return laws.growing_from(self.gain, self.share, self.creep)

    def least(self, n: float) -> Floats:
        """Return the oscillations above which the modes outgrow rolling resistance."""
        return laws.least_growing(self.rates(n), self.moment, self.rolling)

    @property
    def K_creep(self) -> Floats:
        """The gains less what creep takes, where its sign is that of the gain."""
        return laws.less_creep(self.gain, self.creep)

    @property
    def critical_lever(self) -> float:
        """The lever of pivoting above which no steady spin reverses."""
        roll = self.gain[1], self.omega[1], self.moment[1]
        return float(laws.critical_lever(*roll, self.mu))


def growing_modes(
    body: Rattleback, modes: theory.Modes, losses: Mapping[str, float]
) -> GrowingModes:
    """Return the gains and losses of a body's modes."""
    omega = np.array([modes.omega_p, modes.omega_r])
    moment = np.array(theory.mode_moments(body.alpha, body.beta, modes))
    given = {name: np.asarray(value) for name, value in losses.items()}
    pivot = losses["pivot"], losses["creep"]
    return GrowingModes(
        omega=omega,
        moment=moment,
        gain=np.array([modes.K_p, -modes.K_r]),
        share=np.array(theory.loss_shares(moment[0], moment[1], modes, given)),
        creep=laws.share_of_creep(omega, moment, *pivot),
        rolling=losses["rolling"],
        mu=losses["creep"],
    )


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

    `losses` are constants of dissipation, and those of a plane that shakes.
    """
    drive = {name: losses.pop(name) for name in DRIVES if name in losses}
    if n_i == 0:
        raise ConfigError(
            "--n-i 0: a launch without spin has no reversal time; leave --n-i out"
        )
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
    exact = np.array(steady.growth(constants, n_i, sigma))
    if any(losses[name] > 0 for name in COUPLE_CONSTANTS if not LOSSES[name].is_linear):
        # No spin is steady, or the equations are not linear.
        exact *= math.nan
    growing = growing_modes(body, m, losses)
    small = growing.rates(n_i)
    least = growing.least(n_i)
    outgrows = growing.thresholds
    has_rates = all(
        LOSSES[name].is_averaged for name, value in losses.items() if value > 0
    )
    if losses["rolling"] > 0 or not has_rates:
        # No oscillation grows that is small enough, or its growth is not known.
        small = small * math.nan
        outgrows = outgrows * math.nan
    values: dict[str, Any] = {name: getattr(b, name) for name in PARAMETERS}
    if b.c is not None:
        values["c"] = b.c
    values |= {
        "omega_p": m.omega_p,
        "omega_r": m.omega_r,
        "omega_p0": m.omega_p0,
        "omega_r0": m.omega_r0,
        "psi_p": m.psi_p,
        "psi_r": m.psi_r,
        "K_p": m.K_p,
        "K_r": m.K_r,
        "n_c1": n_c1,
        "n_i": n_i,
        "omega_xy0": omega_xy0,
        "psi": psi,
        "n_0": gh.n_0,
        "t_rgh": gh.t_rgh,
        "friction": friction,
        "growth_pitch": small[0],
        "growth_roll": small[1],
        "growth_pitch_exact": exact[0],
        "growth_roll_exact": exact[1],
    }
    if lossy:
        for name, loss in LOSSES.items():
            if name not in losses or (loss.optional and not losses[name]):
                continue
            values[name] = losses[name]
        values |= {
            "spin_decay": sigma / b.gamma,
            "n_growth_pitch": outgrows[0],
            "n_growth_roll": outgrows[1],
        }
        if losses["rolling"] > 0:
            values |= {"least_pitch": least[0], "least_roll": least[1]}
        if losses["creep"] > 0:
            values |= {
                "K_p_creep": growing.K_creep[0],
                "K_r_creep": -growing.K_creep[1],
                "lever_critical": growing.critical_lever,
            }
    if drive:
        damping = -growing.rates(0.0)
        if not np.isfinite(small).all():
            damping = damping * math.nan
        # The spins are known with sigma alone.
        limits = outgrows
        if any(loss > 0 for name, loss in losses.items() if name != "sigma"):
            limits = outgrows * math.nan
        values |= _of_base(b, m, damping, limits, drive)
    return [
        quantity_of(body, name, value, *DERIVED[name]) for name, value in values.items()
    ]


def _of_base(
    b: Rattleback,
    m: theory.Modes,
    damping: Floats,
    limits: Floats,
    drive: dict[str, float],
) -> dict[str, float]:
    """Return what a plane that shakes does: where the body spins up, and how far.

    `limits` are the spins beyond which pitch and roll grow.  A mode that is driven
    turns the body until the spin stops it, or until the spin makes the other mode grow:
    over a long time this one neither grows nor decays, so the mean is its limit.
    Without losses the pitch turns the body twice as far, once and for all, and the
    roll to no lasting spin.  A plane that shakes along itself drives a mode at its own
    frequency, and a drive of the roll leads to no lasting spin once the pitch grows.
    """
    frequency = drive["base_frequency"]
    acceleration = drive["base_acceleration"]
    omega = np.array([m.omega_p, m.omega_r], float)
    coefficients = np.array([m.K_p, -np.asarray(m.K_r)], float)
    is_along = "base_azimuth" in drive
    tuned = omega if is_along else 2 * omega
    of_pitch, of_roll = limits

    def pushed(frequency: ArrayLike) -> Floats:
        psi = np.array([m.psi_p, m.psi_r], float)
        inertia = theory.inertia_along(b.alpha, b.beta, psi)
        of_mode = inertia, damping, coefficients
        pitch, roll = spin_of_push(omega, frequency, acceleration, *of_mode)
        lasting = roll if roll < of_pitch else math.nan
        return np.array([np.maximum(pitch, of_roll), lasting])

    def lifted(frequency: ArrayLike) -> Floats:
        growth = growth_of_drive(omega, frequency, acceleration)
        spins = driven_spin(growth, damping, coefficients)
        if not limits.any():
            return spins * [2.0, math.nan]
        return np.clip(spins, [of_roll, -math.inf], [math.inf, of_pitch])

    # From the drive as it is, and from one that is tuned to each mode.
    mean_spins = pushed if is_along else lifted
    spins = mean_spins(frequency)
    tuned_spins = mean_spins(tuned)
    values = {"base_frequency": frequency, "base_acceleration": acceleration}
    for k, mode in enumerate(MODES):
        values[f"base_frequency_{mode}"] = tuned[k]
        values[f"n_base_{mode}"] = tuned_spins[k]
        if not is_along:
            growth = growth_of_drive(omega, frequency, acceleration)
            values[f"growth_base_{mode}"] = growth[k] - damping[k]
    reached = spins[np.isfinite(spins)]
    values["n_base"] = reached[0] if reached.size else math.nan
    if is_along:
        values["n_base"] = spins[0]
    return values


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
    if name in IN_HERTZ:
        return size / (2 * math.pi), "Hz"
    if name in TORQUES:
        return size, "N m"
    return size, si_unit
