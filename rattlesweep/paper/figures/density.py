"""How (K_p, K_r) of random bodies spread over the plane: a histogram of 1e8 bodies, streamed.

Bodies are drawn, turned into torque coefficients and counted in one compiled loop, and never
stored: memory is one histogram a thread.  The bodies are the sampler's (group 0, first draw), so
that body number ``i`` here is sample ``i`` of a sweep of the same seed.  One core counts 13 million
bodies a second (EPYC, Zen 5).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import hashlib
import threading
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.cache import cached, specialise
from rattlesweep.sweeps.cases import philox, sampler

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# Names that the compiled loop sees.
uniforms = philox.uniforms
torque_coefficients = sampler.torque_coefficients

# Bodies that a thread takes at a time: 0.07 s, so that a stop is heard and both threads end
# together.
PIECE = 1_000_000
THREAD = "rattlesweep-density"
POLL = 0.05


def _count(first, last, stop, seed, ranges, scale, p_low, p_step, r_low, r_step, limit,
           counts, least):  # fmt: skip
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
        if scale == 1:
            K_p, K_r = np.log10(K_p), np.log10(K_r)
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
    """Bins of equal width, in K or in its decimal logarithm.

    Attributes
    ----------
    K_p, K_r : tuple of float
        Ends of the two axes.
    bins : int
        On each axis.
    log : bool
        Whether bins are equal in ``log10 K``.
    """

    K_p: tuple[float, float]
    K_r: tuple[float, float]
    bins: int
    log: bool = False

    def edges(self, name: str) -> Floats:
        """Edges of the bins of ``K_p`` or ``K_r``, shape (bins + 1,)."""
        low, high = self.ends(name)
        edges: Floats = np.linspace(low, high, self.bins + 1)
        return 10**edges if self.log else edges

    def ends(self, name: str) -> tuple[float, float]:
        """Ends of an axis in the variable that is binned."""
        low, high = self.K_p if name == "K_p" else self.K_r
        return (float(np.log10(low)), float(np.log10(high))) if self.log else (low, high)


@dataclass(frozen=True)
class Density:
    """Histogram of bodies.

    Attributes
    ----------
    grid : Grid
    counts : ndarray of int64, shape (bins, bins)
        Bodies by ``K_p`` (first axis) and ``K_r``.
    samples : int
        Bodies in all.
    outside : int
        Bodies outside the grid.
    least_ratio : float
        Least ``omega_p / omega_r``.
    below : int
        Bodies whose ratio is below the limit asked for.
    """

    grid: Grid
    counts: NDArray[np.int64]
    samples: int
    outside: int
    least_ratio: float
    below: int


def count_bodies(
    samples: int,
    seed: int,
    ranges: Floats,
    grid: Grid,
    *,
    limit: float = 0.0,
    threads: int | None = None,
    report: Callable[[float], None] = lambda _: None,
) -> Density:
    """Draw bodies and count them by their torque coefficients.

    Parameters
    ----------
    samples : int
        Bodies: numbers 0 to ``samples - 1`` of the seed.
    seed : int
    ranges : ndarray, shape (5, 2)
        Of ``gamma, f_sd, theta, phi`` and minus ``xi`` in degrees.
    grid : Grid
    limit : float
        Bodies with ``omega_p / omega_r`` below it are counted, too.
    threads : int, optional
        By default all; the counts are the same for any number.
    report : callable
        Called in this thread, some twenty times a second, with the share that is done; what it
        raises ends the counting.
    """
    threads = threads or available_threads()
    bins = grid.bins
    counts = np.zeros((threads, bins + 1, bins + 1), dtype=np.int64)
    least = np.tile([np.inf, 0.0], (threads, 1))
    stop = np.zeros(1, dtype=np.int64)
    settings: list[Any] = [stop, seed, np.ascontiguousarray(ranges, dtype=float), int(grid.log)]
    for name in ("K_p", "K_r"):
        low, high = grid.ends(name)
        settings += [low, (high - low) / bins]
    settings.append(limit**2)
    count = kernel()
    # Compiled here, if at all, and not in two threads at once.
    count(0, 0, *settings, counts[0], least[0])
    pieces = iter(range(0, samples, PIECE))
    lock = threading.Lock()
    done = [0] * threads
    errors: list[BaseException] = []

    def work(own: int) -> None:
        try:
            while not stop[0]:
                with lock:
                    first = next(pieces, None)
                if first is None:
                    return
                last = min(first + PIECE, samples)
                count(first, last, *settings, counts[own], least[own])
                done[own] += last - first
        except BaseException as error:
            errors.append(error)
            stop[0] = 1

    team = [
        threading.Thread(target=work, args=(own,), daemon=True, name=THREAD)
        for own in range(threads)
    ]
    for thread in team:
        thread.start()
    try:
        while any(thread.is_alive() for thread in team):
            for thread in team:
                thread.join(POLL / threads)
            report(sum(done) / max(1, samples))
    except BaseException:
        stop[0] = 1
        raise
    if errors:
        raise errors[0]
    total = counts.sum(axis=0)
    return Density(
        grid=grid,
        counts=total[:-1, :-1],
        samples=samples,
        outside=int(total[-1, -1]),
        least_ratio=float(np.sqrt(least[:, 0].min())),
        below=int(least[:, 1].sum()),
    )
