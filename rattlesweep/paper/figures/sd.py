"""Random bodies of the set SD, for figures that need no dynamics: frequencies and coefficients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.paper.workspace import Progress
from rattlesweep.physics import theory
from rattlesweep.sweeps.cases.sampler import draw_bodies
from rattlesweep.sweeps.config.bodies import SdRanges

SEED = 2017
# Points of a cumulative distribution.
LEVELS = 2001
# The paper's lower bound of omega_p / omega_r (Methods).
BOUND = 1.3
# Bodies drawn at a time: a tenth of a second.
CHUNK = 100_000


def draw(first: int, last: int, ranges: SdRanges, seed: int = SEED) -> tuple[Floats, ...]:
    """``alpha, beta, gamma, theta, phi, xi`` of the bodies from one number up to another.

    They are those of the sampler's group 0, so that body number ``i`` here is sample ``i`` of a
    sweep of the same seed.
    """
    limits = [ranges.gamma, ranges.f_sd, ranges.theta, ranges.phi, ranges.minus_xi_deg]
    drawn = draw_bodies(seed, 0, np.arange(first, last), np.array(limits))[0]
    gamma, _, theta, phi, xi, alpha, beta = drawn
    return alpha, beta, gamma, theta, phi, xi


def draw_modes(
    names: Sequence[str], samples: int, ranges: SdRanges, progress: Progress
) -> dict[str, Floats]:
    """Attributes of :class:`rattlesweep.physics.theory.Modes` of so many random bodies."""
    kept = {name: np.empty(samples) for name in names}
    for first in range(0, samples, CHUNK):
        last = min(first + CHUNK, samples)
        alpha, beta, _, theta, phi, xi = draw(first, last, ranges)
        found = theory.modes(alpha, beta, theta, phi, xi)
        for name in names:
            kept[name][first:last] = getattr(found, name)
        progress(last / samples, f"{last:,} bodies")
    return kept


def cumulative(values: dict[str, Floats], levels: int = LEVELS) -> dict[str, Floats]:
    """Cumulative distributions: their ``probability`` in even steps, and the values there.

    The values are members of what is given: from the least to the largest.
    """
    probability = np.linspace(0, 1, levels)
    return {"probability": probability} | {
        name: np.quantile(own, probability, method="inverted_cdf") for name, own in values.items()
    }
