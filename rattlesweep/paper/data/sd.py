"""Random bodies of the set SD, for figures that need no dynamics: frequencies and coefficients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rattlesweep.paper.data.progress import Progress
from rattlesweep.physics import theory
from rattlesweep.physics.body import shell_dumbbell
from rattlesweep.sweeps.cases.sampler import draw_bodies
from rattlesweep.sweeps.config.bodies import SdRanges

Floats = NDArray[np.float64]


SEED = 2017
# Points of a cumulative distribution.
LEVELS = 2001
# The paper's lower bound of omega_p / omega_r (Methods).
BOUND = 1.3
# Bodies drawn at a time: a tenth of a second.
CHUNK = 100_000


def ranges_array(ranges: SdRanges) -> Floats:
    """Ranges as the sampler takes them, shape (5, 2)."""
    return np.array([ranges.gamma, ranges.f_sd, ranges.theta, ranges.phi, ranges.minus_xi_deg])


def sd_bodies(samples: int, seed: int = SEED) -> tuple[Floats, ...]:
    """``alpha, beta, gamma, theta, phi, xi`` of random bodies of the set SD."""
    drawn = draw_bodies(seed, 0, np.arange(samples), ranges_array(SdRanges()))[0]
    gamma, _, theta, phi, xi, alpha, beta = drawn
    return alpha, beta, gamma, theta, phi, xi


def wide_bodies(samples: int, seed: int = SEED) -> tuple[Floats, ...]:
    """The same far beyond the set SD: any inertia, any skew angle, nearly any surface."""
    rng = np.random.default_rng(seed)
    largest = 10 ** rng.uniform(-1, 2, samples)
    alpha, beta = shell_dumbbell(largest, rng.uniform(0.01, 0.49, samples))
    # I_xx - I_yy < I_zz < I_xx + I_yy; the shell-dumbbell bodies are at the upper end.
    gamma = alpha - beta + (largest - (alpha - beta)) * rng.uniform(0, 1, samples)
    theta = rng.uniform(0.05, 0.99, samples)
    phi = theta * 10 ** rng.uniform(-3, -0.01, samples)
    return alpha, beta, gamma, theta, phi, -np.radians(rng.uniform(0.01, 89.99, samples))


def draw_modes(
    names: Sequence[str], samples: int, ranges: SdRanges, progress: Progress, share: float = 1.0
) -> dict[str, Floats]:
    """Attributes of :class:`rattlesweep.physics.theory.Modes` of random bodies.

    Parameters
    ----------
    names : sequence of str
        Attributes to keep.
    samples : int
        Bodies 0 to ``samples - 1`` of the seed.
    ranges : SdRanges
    progress : callable
    share : float
        What share of the figure this is.
    """
    kept = {name: np.empty(samples) for name in names}
    limits = ranges_array(ranges)
    for first in range(0, samples, CHUNK):
        part = np.arange(first, min(first + CHUNK, samples))
        _, _, theta, phi, xi, alpha, beta = draw_bodies(SEED, 0, part, limits)[0]
        found = theory.modes(alpha, beta, theta, phi, xi)
        for name in names:
            kept[name][part] = getattr(found, name)
        progress(share * (part[-1] + 1) / samples, f"{part[-1] + 1:,} bodies")
    return kept


def cumulative(values: dict[str, Floats], levels: int = LEVELS) -> dict[str, Floats]:
    """Cumulative distributions: their ``probability`` in even steps, and the values there."""
    probability = np.linspace(0, 1, levels)
    return {"probability": probability} | {
        name: quantiles(own, probability) for name, own in values.items()
    }


def quantiles(values: Floats, probability: Floats) -> Floats:
    """Values of the cumulative distribution's inverse: members of ``values``, ends included.

    Parameters
    ----------
    values : ndarray
    probability : ndarray
        From 0, the least value, to 1, the largest.
    """
    ordered = np.sort(values)
    place = np.ceil(probability * len(ordered)).astype(np.int64) - 1
    return ordered[np.clip(place, 0, None)]
