"""Random shell-dumbbell bodies, drawn again until a torque coefficient meets its target.

Points of a scrambled Sobol' sequence (Owen, J. Complexity 14, 466, 1998) fill the ranges more
evenly than random ones; each is a function of the seed and its own number.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import Any, cast

import numpy as np
from numba import njit
from numba.extending import register_jitable

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.compile import Kernel, load_kernel
from rattlesweep.integrate.task import Control, side_by_side
from rattlesweep.physics import body, theory
from rattlesweep.sweeps.bodies import philox
from rattlesweep.sweeps.bodies.philox import uniforms
from rattlesweep.sweeps.config.schema import Target

# The formulas of `physics`, compiled for scalars: one source for both uses.
_shell_dumbbell = njit(nogil=True)(body.shell_dumbbell)
register_jitable(nogil=True)(theory.hessian)
torque_coefficients = njit(nogil=True)(theory.torque_coefficients)


def word_of(coefficient: str, value: float) -> int:
    """Return the second word of the Philox key of samples that are drawn for a target.

    It is the 64 bits of the value as a float, which is positive; the sign bit is set for ``K_p``.
    So a draw does not depend on the other targets in the list.
    """
    return int(np.float64(-value if coefficient == "K_p" else value).view(np.int64))


def unit_to_ranges(u, ranges):
    """Return ``gamma, f_sd, theta, phi, xi`` at a point ``u`` of the unit cube, or at many."""
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
    """Return ``gamma, f_sd, theta, phi, xi, alpha, beta`` at a point ``u`` of the unit cube."""
    gamma, f_sd, theta, phi, xi = _unit_to_ranges(u, ranges)
    alpha, beta = _shell_dumbbell(gamma, f_sd)
    return gamma, f_sd, theta, phi, xi, alpha, beta


def bodies_of(points: Floats, ranges: Floats) -> Floats:
    """Return the columns of :func:`draw_bodies` at points of the unit cube, one row a range."""
    gamma, f_sd, theta, phi, xi = cast("Any", unit_to_ranges)(points, ranges)
    c = [low + (high - low) * u for (low, high), u in zip(ranges[5:], points[5:], strict=True)]
    return np.stack([gamma, f_sd, theta, phi, xi, *body.shell_dumbbell(gamma, f_sd), *c])


def sequence_points(dimensions: int, seed: int, first: int, stop: int, group: int = 1) -> Floats:
    """Return points of the unit cube by their numbers, shape (dimensions, points).

    With a `group` above 1, samples come in groups about two points, for indices of sensitivity:
    the first sample is the one point, the second the other, and each of the rest is the first point
    with one coordinate of the second.
    """
    # scipy.stats takes longer to import than all the rest.
    from scipy.stats import qmc

    if group > 1:
        number, place = np.divmod(np.arange(first, stop), group)
        pairs = sequence_points(2 * dimensions, seed, int(number[0]), int(number[-1]) + 1)
        one, other = np.split(pairs[:, number - number[0]], 2)
        swapped = (place == 1) | (place == 2 + np.arange(dimensions)[:, None])
        return np.where(swapped, other, one)
    sobol = qmc.Sobol(dimensions, rng=np.random.default_rng((seed, 0)))
    if first:
        sobol.fast_forward(first)
    # SciPy warns if the first points it is asked for are not a power of two.
    count = stop - first
    points: Floats = sobol.random(count if first else 1 << (count - 1).bit_length())[:count].T
    return points


def _draw(
    first, last, stop, seed, samples, word, ranges, which, target, rel_tol, max_draws,
    out, draws, nearest,
):  # fmt: skip
    """Draw the bodies of the samples from ``first`` up to ``last`` into the columns of ``out``.

    ``which`` is 0 for no target, 1 for K_p and 2 for K_r.  Where no draw meets the target ``draws``
    is -1 and ``nearest`` holds the coefficient that came closest.  Returns early once ``stop[0]``
    is set.
    """
    for i in range(first, last):
        if stop[0]:
            return
        best = np.inf
        draws[i] = -1
        for k in range(max_draws):
            u = uniforms(seed, word, samples[i], k)
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
    samples: Integers,
    ranges: Floats,
    target: Target | None = None,
    value: float = np.nan,
    threads: int | None = None,
) -> tuple[Floats, Integers]:
    """Draw the bodies of some samples; each depends on the seed, the target's value and its number.

    Parameters
    ----------
    seed, samples : int and ndarray of int
        Seed of the sweep, numbers of the samples.
    ranges : ndarray, shape (5, 2) or (6, 2)
        Ranges of ``gamma, f_sd, theta, phi``, minus ``xi`` in degrees, and perhaps ``c``.
    target, value : Target and float, optional
        The coefficient to be met, and which of its values.
    threads : int, optional
        Threads that draw for a target; by default one for each processor.

    Returns
    -------
    bodies : ndarray, shape (7, samples) or (8, samples)
        ``gamma, f_sd, theta, phi, xi, alpha, beta``, and perhaps ``c``.
    draws : ndarray of int
        Draws that each sample took.

    Raises
    ------
    ConfigError
        If a sample does not meet the target within ``target.max_draws`` draws.
    """
    out = np.full((2 + len(ranges), samples.size), np.nan)
    draws = np.zeros(samples.size, dtype=np.int64)
    nearest = np.full(samples.size, np.nan)
    word, aim = 0, (0, 0.0, 0.0, 1)
    if target is not None:
        word = word_of(target.name, value)
        aim = (1 if target.name == "K_p" else 2, float(value), target.rel_tol, target.max_draws)
    # The copies have the types that the sampler is compiled for.
    settings = (
        seed, np.array(samples, dtype=np.int64), word, np.array(ranges, dtype=float, order="C"),
        *aim, out, draws, nearest,
    )  # fmt: skip
    draw = load_kernel(sampler)
    if target is None:
        draw(0, samples.size, Control().flag, *settings)
        return out, draws
    threads = threads or available_threads()
    edges = np.linspace(0, samples.size, threads + 1).astype(int).tolist()
    # Python's threads: a pool of Numba's aborts the process if another kernel runs at that time.
    # This thread stays free to notice Ctrl-C.
    side_by_side([partial(_part, draw, *ends, settings) for ends in pairwise(edges)], threads)
    for place in np.flatnonzero(draws < 0):
        raise ConfigError(
            f"bodies.target.{target.name}: {value:g} was not met to {target.rel_tol:g} in "
            f"{target.max_draws} draws of sample {samples[place]}, the nearest being "
            f"{nearest[place]:.6g}; choose another target, wider ranges, a larger rel_tol "
            "or more max_draws"
        )
    return out, draws


def _part(draw: Any, first: int, last: int, settings: tuple[Any, ...], control: Control) -> None:
    draw(first, last, control.flag, *settings)
