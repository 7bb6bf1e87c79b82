"""Random bodies of the set SD, for figures that need no dynamics: frequencies and coefficients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rattlesweep.paper.data.progress import Progress
from rattlesweep.physics import theory
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
