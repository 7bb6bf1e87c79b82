"""How (K_p, K_r) of random bodies spread over the plane: a histogram of 1e8 bodies, streamed.

Bodies are drawn, turned into torque coefficients and counted in one compiled loop, and never
stored: memory is one histogram a thread.  The bodies are the sampler's (group 0, first draw), so
that body number ``i`` here is sample ``i`` of a sweep of the same seed.  One core counts 13 million
bodies a second (EPYC, Zen 5).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.cache import cached, specialise
from rattlesweep.integrate.task import Control, side_by_side
from rattlesweep.paper.data.sd import SEED
from rattlesweep.sweeps.cases import philox, sampler

Floats = NDArray[np.float64]

# Names that the compiled loop sees.
uniforms = philox.uniforms
torque_coefficients = sampler.torque_coefficients

# Bodies that a thread takes at a time: 0.07 s, so that a stop is heard and both threads end
# together.
PIECE = 1_000_000


def _count(first, last, stop, seed, ranges, p_low, p_step, r_low, r_step, limit, counts, least):
    """Add the bodies from ``first`` up to ``last`` to ``counts``.

    ``counts`` has one more row and column than there are bins, for the bodies outside;
    ``least[0]`` is the least ``(omega_p/omega_r)^2`` and ``least[1]`` the number below ``limit``.
    """
    rows, columns = counts.shape[0] - 1, counts.shape[1] - 1
    # Kept here meanwhile: the threads' entries share a cache line.
    smallest, below = least[0], least[1]
    for i in range(first, last):
        if i & 4095 == 0 and stop[0]:
            return
        u = uniforms(seed, 0, i, 0)
        gamma = ranges[0, 0] + (ranges[0, 1] - ranges[0, 0]) * u[0]
        f_sd = ranges[1, 0] + (ranges[1, 1] - ranges[1, 0]) * u[1]
        theta = ranges[2, 0] + (ranges[2, 1] - ranges[2, 0]) * u[2]
        phi = ranges[3, 0] + (ranges[3, 1] - ranges[3, 0]) * u[3]
        xi = -np.radians(ranges[4, 1] - (ranges[4, 1] - ranges[4, 0]) * u[4])
        square_p, square_r, K_p, K_r = torque_coefficients(
            (1 - f_sd) * gamma + 1, f_sd * gamma + 1, theta, phi, xi
        )
        ratio = square_p / square_r
        smallest = min(smallest, ratio)
        if ratio < limit:
            below += 1
        # Compared as floats: what lies far outside may not fit an integer.
        x, y = (K_p - p_low) / p_step, (K_r - r_low) / r_step
        if 0 <= x < rows and 0 <= y < columns:
            counts[int(x), int(y)] += 1
        else:
            counts[rows, columns] += 1
    least[0], least[1] = smallest, below


@cache
def kernel() -> Any:
    """The compiled loop.

    The cache on disk knows this file and the rooms ``physics`` and ``integrate``; the sampler's
    sources, which the loop also contains, are put into its name.
    """
    sources = (Path(str(module.__file__)).read_bytes() for module in (philox, sampler))
    digest = hashlib.sha256(b"".join(sources)).hexdigest()[:16]
    return cached(specialise(_count, f"count_{digest}"), nogil=True, error_model="numpy")


@dataclass(frozen=True)
class Grid:
    """Bins of equal width: the ends of the two axes, and the number of bins on each."""

    K_p: tuple[float, float]
    K_r: tuple[float, float]
    bins: int

    def edges(self, name: str) -> Floats:
        """Edges of the bins of ``K_p`` or ``K_r``, shape (bins + 1,)."""
        low, high = self.K_p if name == "K_p" else self.K_r
        return np.linspace(low, high, self.bins + 1)


@dataclass(frozen=True)
class Density:
    """Histogram of bodies.

    Attributes
    ----------
    counts : ndarray of int64, shape (bins, bins)
        Bodies by ``K_p`` (first axis) and ``K_r``.
    outside : int
        Bodies outside the grid.
    least_ratio : float
        Least ``omega_p / omega_r``.
    below : int
        Bodies whose ratio is below the limit asked for.
    """

    counts: NDArray[np.int64]
    outside: int
    least_ratio: float
    below: int


def count_bodies(
    samples: int,
    ranges: Floats,
    grid: Grid,
    *,
    seed: int = SEED,
    limit: float = 0.0,
    threads: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Density:
    """Draw bodies and count them by their torque coefficients.

    Parameters
    ----------
    samples : int
        Bodies: numbers 0 to ``samples - 1`` of the seed.
    ranges : ndarray, shape (5, 2)
        Of ``gamma, f_sd, theta, phi`` and minus ``xi`` in degrees.
    grid : Grid
    seed : int
    limit : float
        Bodies with ``omega_p / omega_r`` below it are counted, too.
    threads : int, optional
        By default all; the counts are the same for any number.
    progress : callable
        As for :func:`rattlesweep.integrate.task.side_by_side`.
    """
    threads = threads or available_threads()
    settings: list[Any] = [seed, np.ascontiguousarray(ranges, dtype=float)]
    for low, high in (grid.K_p, grid.K_r):
        settings += [low, (high - low) / grid.bins]
    settings.append(limit**2)
    shape = (threads, grid.bins + 1, grid.bins + 1)
    counts, least = np.zeros(shape, dtype=np.int64), np.tile([np.inf, 0.0], (threads, 1))
    count = kernel()
    # Compiled here, if at all, and not in two threads at once.
    count(0, 0, np.zeros(1, dtype=np.int64), *settings, counts[0], least[0])
    # One histogram for each of the calls that are under way.
    free = list(zip(counts, least, strict=True))

    def call(first: int, control: Control) -> None:
        own = free.pop()
        count(first, min(first + PIECE, samples), control.flag, *settings, *own)
        free.append(own)

    side_by_side([partial(call, k) for k in range(0, samples, PIECE)], threads, progress)
    total = counts.sum(axis=0)
    return Density(
        counts=total[:-1, :-1],
        outside=int(total[-1, -1]),
        least_ratio=float(np.sqrt(least[:, 0].min())),
        below=int(least[:, 1].sum()),
    )
