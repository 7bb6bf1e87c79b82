"""Where a search begins: from what is given, and from what the data show."""

from __future__ import annotations

import math
from typing import NamedTuple

from rattlesweep.analysis.fit.measured import Prior
from rattlesweep.analysis.fit.problem import OF_BODY, SIZES, FitProblem
from rattlesweep.arrays import Floats
from rattlesweep.physics.theory import modes
from rattlesweep.words.quantities import ACTING, DAMPING

# A spin that is given is no better than that of the first rows if they differ by more.
SPINS_APART = 0.03
# How far a quantity of the body that is given may be off: angles in radians, others as
# a share of the value.
ANGLE_OFF = math.radians(1.5)
SHARE_OFF = 0.05
SEMI_AXIS_OFF = 0.3
# Times of reversals are searched up to so many such distances to both sides.
_WIDE = 2.0
# Factors, below and above the first values, within which a quantity is searched.
FACTORS = {"n_i": (0.7, 1.3), "omega_xy0": (0.3, 3.0)}
LOSS_FACTORS = (0.1, 5.0)
UNKNOWN_SPINS = (0.03, 0.6)
# First values where nothing but zero is given.
UNKNOWN_SPIN = 0.1
UNKNOWN_SKEW = math.radians(1)
DIRECTIONS_OFF = 90.0  # degrees
PHASES_OFF = math.pi / 2


class Span(NamedTuple):
    """The values of a parameter among which a search begins, evenly or by ratios."""

    low: float
    high: float
    by_ratio: bool = False

    def at(self, share: float) -> float:
        """Return the value at a share of the way from low to high."""
        if self.by_ratio:
            return float(self.low * (self.high / self.low) ** share)
        return self.low + share * (self.high - self.low)


def given(problem: FitProblem, name: str) -> float | None:
    """Return the value that is given of a parameter, None if there is none or zero."""
    launch = problem.launch
    if name in problem.priors:
        # A quantity that was measured as zero is not larger than its error.
        return problem.priors[name].value or problem.priors[name].error
    if name in SIZES and problem.stone is not None:
        return problem.stone.size(name)
    value = launch.losses.get(name) or getattr(launch, name, None)
    return value or getattr(launch.body, name, None) or None


def first_values(problem: FitProblem) -> dict[str, list[float]]:
    """Return values of each free parameter from which the search may begin."""
    launch = problem.launch
    film = problem.film
    body = launch.body
    is_tap = launch.n_i == 0
    spin = UNKNOWN_SPIN
    if launch.n_i is not None and not is_tap:
        spin = launch.n_i
    size = abs(spin)
    if film.kind != "reversal":
        spin = film.first_spin
        size = film.spin_size
    shares = (0.01, 0.03, 0.1, 0.3)
    if is_tap:
        # All the spin of a tap comes from the oscillation.
        shares = (0.1, 0.3, 1.0, 3.0)
    decay = body.gamma / float(film.t[-1])
    oscillations = modes(body.alpha, body.beta, body.theta, body.phi, body.xi)
    psi = oscillations.psi_p
    if launch.psi == "roll":
        psi = oscillations.psi_r
    psi_deg = math.degrees(psi)
    if isinstance(launch.psi, float):
        psi_deg = launch.psi
    skew = -body.xi
    if skew == 0:
        skew = UNKNOWN_SKEW
    guesses = {
        "n_i": [spin],
        "omega_xy0": [share * size for share in shares],
        "psi_deg": [psi_deg],
        "skew": [skew],
    }
    for name, constant in ACTING.items():
        size = decay if constant.unit == DAMPING else 1.0
        guesses[name] = [size * value for value in constant.first_values]
    values: dict[str, list[float]] = {}
    for name in problem.scales:
        value = given(problem, name)
        if value is None:
            # A shape that is given as zero begins beside it.
            values[name] = guesses.get(name, [SHARE_OFF])
        elif name == "n_i" and abs(spin - value) > SPINS_APART * size:
            values[name] = [value, spin]
        else:
            values[name] = [value]
    return values


def scales_of(problem: FitProblem, values: dict[str, list[float]]) -> dict[str, float]:
    """Return the scales of the free parameters, for their first values."""
    scales = {name: max(map(abs, firsts)) for name, firsts in values.items()}
    if "n_i" in scales and problem.film.kind != "reversal":
        # A film may begin without spin.
        scales["n_i"] = max(scales["n_i"], problem.film.spin_size)
    return scales


def distance_off(name: str, value: float) -> float:
    """Return how far a quantity of the body that is given may be off."""
    if name in ("skew", "xi", "axes_angle"):
        return ANGLE_OFF
    if name == "c":
        return SEMI_AXIS_OFF * value
    return SHARE_OFF * value


def tethers(problem: FitProblem, x: Floats) -> dict[str, Prior]:
    """Return loose priors for the quantities of the body, at ``x``.

    The beginning of a film hardly tells them, and without a prior they go astray.
    """
    return {
        name: Prior(value, distance_off(name, value))
        for name, value in problem.values(x).items()
        if name in OF_BODY and name not in problem.priors and value
    }


def spans(problem: FitProblem, values: dict[str, list[float]]) -> dict[str, Span]:
    """Return the values of each free parameter that a search of reversals tries."""
    ranges = {}
    for name, firsts in values.items():
        least = min(firsts)
        most = max(firsts)
        is_known = given(problem, name) is not None
        if name in problem.priors:
            width = _WIDE * problem.priors[name].error
            ranges[name] = Span(least - width, most + width)
        elif name == "n_i" and not is_known:
            ranges[name] = Span(*UNKNOWN_SPINS, by_ratio=True)
        elif name in FACTORS:
            low, high = FACTORS[name]
            by_ratio = name == "omega_xy0"
            ranges[name] = Span(low * least, high * most, by_ratio)
        elif name == "base_phase":
            ranges[name] = Span(least - PHASES_OFF, most + PHASES_OFF)
        elif name in ACTING:
            low, high = LOSS_FACTORS
            ranges[name] = Span(low * least, high * most, by_ratio=True)
        elif name == "psi_deg":
            ranges[name] = Span(least - DIRECTIONS_OFF, most + DIRECTIONS_OFF)
        else:
            width = _WIDE * abs(distance_off(name, least))
            ranges[name] = Span(least - width, most + width)
    return ranges
