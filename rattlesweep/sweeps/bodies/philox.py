"""Counter-based random numbers: Philox 4x64-10 (Salmon et al., SC'11), compiled.

A draw is a function of ``(seed, word, sample, draw)`` and of nothing else, so that every sample can
be drawn again alone, in any thread and any block.  The word stands for the target of a sample.  The
bits are those of ``numpy.random.Philox(key=(seed, word), counter=(2 draw, sample, 0, 0))``, whose
objects take too long to create for every sample.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np
from numba import njit

_M0 = np.uint64(0xD2E7470EE14C6C93)
_M1 = np.uint64(0xCA5A826395121157)
_W0 = np.uint64(0x9E3779B97F4A7C15)
_W1 = np.uint64(0xBB67AE8584CAA73B)
_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_SHIFT = np.uint64(11)
_UNIT = 2.0**-53


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
