"""Random shell-dumbbell bodies, drawn again until a torque coefficient meets its target."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import threading
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.cache import cached, specialise
from rattlesweep.physics import theory
from rattlesweep.sweeps.cases import philox
from rattlesweep.sweeps.cases.philox import uniforms

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# Name of the threads that draw; they may outlive a Ctrl-C for as long as one sample takes.
THREAD = "rattlesweep-draw"
POLL = 0.05

# The formulas of the theory, compiled for scalars: one source for both uses.  The second
# calls the first by its global name.
_hessian = njit(nogil=True)(theory.hessian)
torque_coefficients = njit(nogil=True)(
    specialise(theory.torque_coefficients, "torque_coefficients_scalar", hessian=_hessian)
)


def _draw(
    first, last, stop, seed, samples, group, ranges, which, target, rel_tol, max_draws,
    out, draws, nearest,
):  # fmt: skip
    """Fill ``out`` with ``gamma, f_sd, theta, phi, xi, alpha, beta`` of each sample.

    ``which`` is 0 for no target, 1 for K_p and 2 for K_r.  Where no draw meets the target ``draws``
    is -1 and ``nearest`` holds the coefficient that came closest.  Works on the samples from
    ``first`` up to ``last`` and gives up once ``stop[0]`` is set.
    """
    for i in range(first, last):
        if stop[0]:
            return
        best = np.inf
        draws[i] = -1
        for k in range(max_draws):
            u = uniforms(seed, group, samples[i], k)
            gamma = ranges[0, 0] + (ranges[0, 1] - ranges[0, 0]) * u[0]
            f_sd = ranges[1, 0] + (ranges[1, 1] - ranges[1, 0]) * u[1]
            theta = ranges[2, 0] + (ranges[2, 1] - ranges[2, 0]) * u[2]
            phi = ranges[3, 0] + (ranges[3, 1] - ranges[3, 0]) * u[3]
            # From (low, high]: the skew angle is never zero.
            xi = -np.radians(ranges[4, 1] - (ranges[4, 1] - ranges[4, 0]) * u[4])
            alpha = (1 - f_sd) * gamma + 1
            beta = f_sd * gamma + 1
            if which > 0:
                coefficients = torque_coefficients(alpha, beta, theta, phi, xi)
                value = coefficients[2] if which == 1 else coefficients[3]
                off = abs(value - target)
                if off < best:
                    best = off
                    nearest[i] = value
                if off > rel_tol * target:
                    continue
            draws[i] = k + 1
            out[0, i] = gamma
            out[1, i] = f_sd
            out[2, i] = theta
            out[3, i] = phi
            out[4, i] = xi
            out[5, i] = alpha
            out[6, i] = beta
            break


@cache
def kernel() -> Any:
    """The compiled sampler."""
    return cached(_draw, also=(philox.__file__,), nogil=True)


def draw_bodies(
    seed: int,
    group: int,
    samples: NDArray[np.int64],
    ranges: Floats,
    which: int = 0,
    target: float = 0.0,
    rel_tol: float = 1e-3,
    max_draws: int = 1,
    threads: int | None = None,
) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Draw bodies of some samples.

    Parameters
    ----------
    seed, group : int
        Of the sweep and of the target's place in its list.
    samples : ndarray of int64
        Sample numbers; each depends on its own number alone.
    ranges : ndarray, shape (5, 2)
        Of ``gamma, f_sd, theta, phi`` and minus ``xi`` in degrees.
    which : int
        0 without a target, 1 for ``K_p``, 2 for ``K_r``.
    target, rel_tol, max_draws
        Relative distance allowed, and draws after which a sample is given up.
    threads : int, optional
        Threads that draw for a target; they are Python's, since one of Numba's thread pools aborts
        the process when the integrator's kernel runs in another thread at the same time.

    Returns
    -------
    bodies : ndarray, shape (7, samples)
        ``gamma, f_sd, theta, phi, xi, alpha, beta``.
    draws : ndarray
        Draws used, -1 where the target was not met.
    nearest : ndarray
        Coefficient nearest to the target.
    """
    out = np.full((7, samples.size), np.nan)
    draws = np.zeros(samples.size, dtype=np.int64)
    nearest = np.full(samples.size, np.nan)
    settings = (
        seed, samples, group, np.ascontiguousarray(ranges, dtype=float), which,
        float(target), float(rel_tol), max_draws, out, draws, nearest,
    )  # fmt: skip
    stop = np.zeros(1, dtype=np.int64)
    if which == 0:
        kernel()(0, samples.size, stop, *settings)
    else:
        _in_threads(threads or available_threads(), samples.size, stop, settings)
    return out, draws, nearest


def _in_threads(
    threads: int, size: int, stop: NDArray[np.int64], settings: tuple[Any, ...]
) -> None:
    """Draw in threads of their own: the calling one goes on hearing Ctrl-C."""
    errors: list[BaseException] = []
    draw = kernel()
    # Compiled here, if at all: in a thread CPython 3.11 may map and unmap its stack at every call
    # (a million times, which took as long again as the compilation).
    draw(0, 0, stop, *settings)

    def work(first: int, last: int) -> None:
        try:
            draw(first, last, stop, *settings)
        except BaseException as error:
            errors.append(error)

    edges = np.linspace(0, size, threads + 1).astype(int).tolist()
    team = [
        threading.Thread(target=work, args=ends, daemon=True, name=THREAD)
        for ends in pairwise(edges)
    ]
    for thread in team:
        thread.start()
    try:
        for thread in team:
            while thread.is_alive():
                thread.join(POLL)
    except BaseException:
        stop[0] = 1
        raise
    if errors:
        raise errors[0]
