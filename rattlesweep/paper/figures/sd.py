"""Random bodies of the set SD, for figures that need no dynamics: frequencies and coefficients."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.physics import theory
from rattlesweep.sweeps.cases.sampler import draw_bodies

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from rattlesweep.sweeps.config.bodies import SdRanges

    Floats = NDArray[np.float64]
    Report = Callable[[float, str], None]

# Bodies drawn at a time: a tenth of a second.
CHUNK = 100_000


def ranges_array(ranges: SdRanges) -> Floats:
    """Ranges as the sampler takes them, shape (5, 2)."""
    return np.array([ranges.gamma, ranges.f_sd, ranges.theta, ranges.phi, ranges.minus_xi_deg])


def draw_modes(
    names: Sequence[str],
    samples: int,
    seed: int,
    ranges: SdRanges,
    report: Report,
    share: float = 1.0,
) -> dict[str, Floats]:
    """Attributes of :class:`rattlesweep.physics.theory.Modes` of random bodies.

    Parameters
    ----------
    names : sequence of str
        Attributes to keep.
    samples, seed : int
        Bodies 0 to ``samples - 1`` of the seed.
    ranges : SdRanges
    report : callable
        Told after each chunk what share of the figure is done.
    share : float
        What share of the figure this is.
    """
    kept = {name: np.empty(samples) for name in names}
    limits = ranges_array(ranges)
    for first in range(0, samples, CHUNK):
        part = np.arange(first, min(first + CHUNK, samples))
        _, _, theta, phi, xi, alpha, beta = draw_bodies(seed, 0, part, limits)[0]
        found = theory.modes(alpha, beta, theta, phi, xi)
        for name in names:
            kept[name][part] = getattr(found, name)
        report(share * (part[-1] + 1) / samples, f"{part[-1] + 1:,} bodies")
    return kept


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


def distance(one: Floats, other: Floats) -> float:
    """Largest difference of two cumulative distributions (Kolmogorov and Smirnov)."""
    one, other = np.sort(one), np.sort(other)
    both = np.concatenate([one, other])
    first = np.searchsorted(one, both, side="right") / len(one)
    second = np.searchsorted(other, both, side="right") / len(other)
    return float(np.abs(first - second).max())
