"""Random shell-dumbbell bodies, drawn again until a torque coefficient meets its target.

A draw is a function of ``(seed, word, sample, draw)`` and of nothing else, so that every sample can
be drawn again alone, in any thread and any block; the word stands for the target.  The bits are
those of ``numpy.random.Philox(key=(seed, word), counter=(2 draw, sample, 0, 0))`` (Philox 4x64-10,
Salmon et al., SC'11), whose objects take too long to create for every sample.

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
from rattlesweep.sweeps.config.schema import Target

_M0, _M1 = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
_W0, _W1 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B)
_LOW, _HALF, _SHIFT = np.uint64(0xFFFFFFFF), np.uint64(32), np.uint64(11)
_UNIT = 2.0**-53

# The formulas of `physics`, compiled for scalars: one source for both uses.
_shell_dumbbell = njit(nogil=True)(body.shell_dumbbell)
register_jitable(nogil=True)(theory.hessian)
_torque_coefficients = njit(nogil=True)(theory.torque_coefficients)


@njit(nogil=True)
def _multiply(a, b):
    """Return the high and the low word of a 64 by 64 bit product."""
    a_high, a_low = a >> _HALF, a & _LOW
    b_high, b_low = b >> _HALF, b & _LOW
    low = a_low * b_low
    middle = a_high * b_low + (low >> _HALF)
    cross = a_low * b_high + (middle & _LOW)
    return a_high * b_high + (middle >> _HALF) + (cross >> _HALF), a * b


@njit(nogil=True)
def _philox(key0, key1, c0, c1):
    """Return four numbers in [0, 1), multiples of 2^-53, for one counter (64 bit words)."""
    c2 = c3 = np.uint64(0)
    for _ in range(10):
        high0, low0 = _multiply(_M0, c0)
        high1, low1 = _multiply(_M1, c2)
        c0, c1, c2, c3 = high1 ^ c1 ^ key0, low1, high0 ^ c3 ^ key1, low0
        key0 += _W0
        key1 += _W1
    return (
        float(c0 >> _SHIFT) * _UNIT,
        float(c1 >> _SHIFT) * _UNIT,
        float(c2 >> _SHIFT) * _UNIT,
        float(c3 >> _SHIFT) * _UNIT,
    )


@njit(nogil=True)
def uniforms(seed, word, sample, draw):
    """Return eight numbers in [0, 1)."""
    s, w, k = np.uint64(seed), np.uint64(word), np.uint64(sample)
    # NumPy raises its counter before it uses it.
    first = np.uint64(2) * np.uint64(draw) + np.uint64(1)
    return _philox(s, w, first, k) + _philox(s, w, first + np.uint64(1), k)


def _unit_to_ranges(u, ranges):
    """Return ``gamma, f_sd, theta, phi, xi`` at a point ``u`` of the unit cube, or at many."""
    gamma = ranges[0, 0] + (ranges[0, 1] - ranges[0, 0]) * u[0]
    f_sd = ranges[1, 0] + (ranges[1, 1] - ranges[1, 0]) * u[1]
    theta = ranges[2, 0] + (ranges[2, 1] - ranges[2, 0]) * u[2]
    phi = ranges[3, 0] + (ranges[3, 1] - ranges[3, 0]) * u[3]
    # From (low, high]: the skew angle is never zero.
    xi = -np.radians(ranges[4, 1] - (ranges[4, 1] - ranges[4, 0]) * u[4])
    return gamma, f_sd, theta, phi, xi


_ranged = njit(nogil=True)(_unit_to_ranges)


def bodies_of(points: Floats, ranges: Floats) -> Floats:
    """Return the columns of :func:`draw_bodies` at points of the unit cube, one row a range."""
    gamma, f_sd, theta, phi, xi = cast("Any", _unit_to_ranges)(points, ranges)
    c = [low + (high - low) * u for (low, high), u in zip(ranges[5:], points[5:], strict=True)]
    return np.stack([gamma, f_sd, theta, phi, xi, *body.shell_dumbbell(gamma, f_sd), *c])


def sequence_points(dimensions: int, seed: int, first: int, stop: int, group: int = 1) -> Floats:
    """Return points of the unit cube by their numbers, shape (dimensions, points).

    With a `group` above 1, samples come in groups about two points (Saltelli's design): the first
    sample is the one point, the second the other, and each of the rest is the first point with one
    coordinate of the second.
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
    first, last, stop, seed, samples, word, ranges, which, target, rel_tol, max_draws, out, draws
):
    """Draw the bodies of the samples from ``first`` up to ``last`` into the columns of ``out``.

    ``which`` is 0 for no target, 1 for K_p and 2 for K_r; ``draws`` is -1 where none meets it.
    """
    for i in range(first, last):
        if stop[0]:
            return
        draws[i] = -1
        for k in range(max_draws):
            u = uniforms(seed, word, samples[i], k)
            gamma, f_sd, theta, phi, xi = _ranged(u, ranges)
            alpha, beta = _shell_dumbbell(gamma, f_sd)
            if which > 0:
                coefficients = _torque_coefficients(alpha, beta, theta, phi, xi)
                if abs(coefficients[1 + which] - target) > rel_tol * target:
                    continue
            draws[i] = k + 1
            drawn = (gamma, f_sd, theta, phi, xi, alpha, beta)
            for row in range(7):
                out[row, i] = drawn[row]
            if len(ranges) > 5:
                out[7, i] = ranges[5, 0] + (ranges[5, 1] - ranges[5, 0]) * u[5]
            break


def sampler() -> Kernel:
    """Return the sampler, to be compiled."""
    whole = np.zeros(0, dtype=np.int64)
    arguments = (
        0, 0, Control().flag, 0, whole, 0, np.zeros((5, 2)), 0, 0.0, 0.0, 0, np.zeros((7, 0)), whole
    )  # fmt: skip
    return Kernel(_draw, arguments, {"nogil": True}, (__file__,))


def draw_bodies(
    seed: int,
    samples: Integers,
    ranges: Floats,
    target: Target | None = None,
    value: float = np.nan,
    threads: int | None = None,
) -> tuple[Floats, Integers]:
    """Return the bodies of some samples, and how many draws each took.

    `ranges`, of the shape (5, 2) or (6, 2), are those of ``gamma, f_sd, theta, phi``, minus ``xi``
    in degrees, and perhaps ``c``; `value` is that of the values of the target which is to be met.
    The rows of the bodies are ``gamma, f_sd, theta, phi, xi, alpha, beta``, and perhaps ``c``.
    Raises a ConfigError if a sample does not meet the target in ``target.max_draws`` draws.
    """
    out = np.full((2 + len(ranges), samples.size), np.nan)
    draws = np.zeros(samples.size, dtype=np.int64)
    word, aim = 0, (0, 0.0, 0.0, 1)
    if target is not None:
        # The word is the value's 64 bits, with the sign bit set for K_p: a draw does not depend on
        # the other targets of the list.
        word = int(np.float64(-value if target.name == "K_p" else value).view(np.int64))
        aim = (1 if target.name == "K_p" else 2, float(value), target.rel_tol, target.max_draws)
    # The copies have the types that the sampler is compiled for.
    settings = (
        seed, np.array(samples, dtype=np.int64), word, np.array(ranges, dtype=float, order="C"),
        *aim, out, draws,
    )  # fmt: skip
    draw = load_kernel(sampler)
    if target is None:
        draw(0, samples.size, Control().flag, *settings)
        return out, draws
    threads = threads or available_threads()
    edges = np.linspace(0, samples.size, threads + 1).astype(int).tolist()

    def part(first: int, last: int, control: Control) -> None:
        draw(first, last, control.flag, *settings)

    # Python's threads: a pool of Numba's aborts the process if another kernel runs at that time.
    # This thread stays free to notice Ctrl-C.
    side_by_side([partial(part, *ends) for ends in pairwise(edges)], threads)
    if (draws < 0).any():
        raise ConfigError(
            f"bodies.target.{target.name}: {value:g} was not met to {target.rel_tol:g} in "
            f"{target.max_draws} draws of sample {samples[np.argmin(draws)]}; choose another "
            "target, wider ranges, a larger rel_tol or more max_draws"
        )
    return out, draws
