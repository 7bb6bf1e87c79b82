"""Random shell-dumbbell bodies, drawn again until a torque coefficient meets its target."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import Any, cast

import numpy as np
from numba import njit
from numba.extending import register_jitable

from rattlesweep.arrays import Floats, Integers
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.compile import Kernel, load_kernel
from rattlesweep.integrate.task import Control, side_by_side
from rattlesweep.physics import body, theory
from rattlesweep.sweeps.bodies import philox
from rattlesweep.sweeps.bodies.philox import uniforms

# The formulas, compiled for scalars: one source for both uses.  The last calls `hessian`.
_shell_dumbbell = njit(nogil=True)(body.shell_dumbbell)
register_jitable(nogil=True)(theory.hessian)
torque_coefficients = njit(nogil=True)(theory.torque_coefficients)


def unit_to_ranges(u, ranges):
    """``gamma, f_sd, theta, phi, xi`` at a point ``u`` of the unit cube, or at many."""
    gamma = ranges[0, 0] + (ranges[0, 1] - ranges[0, 0]) * u[0]
    f_sd = ranges[1, 0] + (ranges[1, 1] - ranges[1, 0]) * u[1]
    theta = ranges[2, 0] + (ranges[2, 1] - ranges[2, 0]) * u[2]
    phi = ranges[3, 0] + (ranges[3, 1] - ranges[3, 0]) * u[3]
    # From (low, high]: the skew angle is never zero.
    xi = -np.radians(ranges[4, 1] - (ranges[4, 1] - ranges[4, 0]) * u[4])
    return gamma, f_sd, theta, phi, xi


_unit_to_ranges = njit(nogil=True)(unit_to_ranges)


@njit(nogil=True)
def body_at(u, ranges):
    """``gamma, f_sd, theta, phi, xi, alpha, beta`` at a point ``u`` of the unit cube."""
    gamma, f_sd, theta, phi, xi = _unit_to_ranges(u, ranges)
    alpha, beta = _shell_dumbbell(gamma, f_sd)
    return gamma, f_sd, theta, phi, xi, alpha, beta


def bodies_of(points: Floats, ranges: Floats) -> Floats:
    """What `draw_bodies` gives at points of the unit cube, of as many dimensions as ranges."""
    gamma, f_sd, theta, phi, xi = cast("Any", unit_to_ranges)(points, ranges)
    c = [low + (high - low) * u for (low, high), u in zip(ranges[5:], points[5:], strict=True)]
    return np.stack([gamma, f_sd, theta, phi, xi, *body.shell_dumbbell(gamma, f_sd), *c])


def _draw(
    first, last, stop, seed, samples, group, ranges, which, target, rel_tol, max_draws,
    out, draws, nearest,
):  # fmt: skip
    """Fill ``out`` with what `body_at` gives for each sample.

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
            drawn = body_at(u, ranges)
            if which > 0:
                _, _, theta, phi, xi, alpha, beta = drawn
                coefficients = torque_coefficients(alpha, beta, theta, phi, xi)
                value = coefficients[2] if which == 1 else coefficients[3]
                off = abs(value - target)
                if off < best:
                    best = off
                    nearest[i] = value
                if off > rel_tol * target:
                    continue
            draws[i] = k + 1
            for row in range(7):
                out[row, i] = drawn[row]
            if len(ranges) > 5:
                out[7, i] = ranges[5, 0] + (ranges[5, 1] - ranges[5, 0]) * u[5]
            break


def sampler() -> Kernel:
    """Return the sampler, to be compiled."""
    whole, real = np.zeros(0, dtype=np.int64), np.zeros(0)
    arguments = (
        0, 0, Control().flag, 0, whole, 0, np.zeros((5, 2)), 0, 0.0, 0.0, 0,
        np.zeros((7, 0)), whole, real,
    )  # fmt: skip
    return Kernel(_draw, arguments, {"nogil": True}, (__file__, philox.__file__))


def draw_bodies(
    seed: int,
    group: int,
    samples: Integers,
    ranges: Floats,
    which: int = 0,
    target: float = 0.0,
    rel_tol: float = 1e-3,
    max_draws: int = 1,
    threads: int | None = None,
) -> tuple[Floats, Integers, Floats]:
    """Draw bodies of some samples; each depends on the seed, its group and its own number alone.

    `group` is the place of the target in its list, `ranges`, of shape (5, 2) or (6, 2), are those
    of ``gamma, f_sd, theta, phi``, minus ``xi`` in degrees and perhaps ``c``; `which` is 0 without
    a target, 1 for ``K_p`` and 2 for ``K_r``. The threads that draw for a target are Python's,
    since one of Numba's pools aborts the process when the integrator's kernel runs in another
    thread at the same time.

    Returns
    -------
    bodies : ndarray, shape (7, samples) or (8, samples)
        ``gamma, f_sd, theta, phi, xi, alpha, beta``, perhaps ``c``.
    draws, nearest : ndarray
        Draws used, -1 where the target was not met, and the coefficient nearest to it.
    """
    out = np.full((2 + len(ranges), samples.size), np.nan)
    draws = np.zeros(samples.size, dtype=np.int64)
    nearest = np.full(samples.size, np.nan)
    # Copies are of the types that it is compiled for, whatever is given.
    settings = (
        seed, np.array(samples), group, np.array(ranges, dtype=float, order="C"), which,
        float(target), float(rel_tol), max_draws, out, draws, nearest,
    )  # fmt: skip
    draw = load_kernel(sampler)
    if which == 0:
        draw(0, samples.size, Control().flag, *settings)
    else:
        threads = threads or available_threads()
        edges = np.linspace(0, samples.size, threads + 1).astype(int).tolist()
        # In threads of their own: this one goes on hearing Ctrl-C.
        side_by_side([partial(_part, draw, *ends, settings) for ends in pairwise(edges)], threads)
    return out, draws, nearest


def _part(draw: Any, first: int, last: int, settings: tuple[Any, ...], control: Control) -> None:
    draw(first, last, control.flag, *settings)
