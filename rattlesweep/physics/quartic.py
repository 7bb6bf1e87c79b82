"""Roots of real quartics and eigenvalues of symmetric 4 x 4 matrices, over arrays.

All is addition, multiplication, division and square root of real numbers, element by element,
which IEEE 754 rounds in one way only.  NumPy's product of complex numbers is fused on some
processors, and LAPACK's last bits differ with its build and its kernels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rattlesweep.arrays import Flags, Floats

    Pair = tuple[Floats, Floats]
    Pairs = tuple[Pair, Pair]
    Coefficients = tuple[Floats, Floats, Floats, Floats]

EPS = np.finfo(float).eps
# Newton's method comes to a simple root in about 7 steps and to a double root in about 30.
MOST_STEPS = 100
POLISHING_STEPS = 2
JACOBI_SWEEPS = 6


def quadratics(a3: Floats, a2: Floats, a1: Floats, a0: Floats) -> Pairs:
    """Factor ``z^4 + a3 z^3 + a2 z^2 + a1 z + a0`` into two real quadratics ``z^2 + b z + c``.

    Returns ``(b1, c1), (b2, c2)``, with ``|c1| >= |c2|``.  The sum ``s`` of the two constant terms
    is a root of Ferrari's resolvent cubic, the largest one if the four roots are two complex pairs.
    Newton's method finds it; two of its steps for all four coefficients then remove what rounding
    has left in the small ones.
    """
    s = _resolvent_root(a3, a2, a1, a0)
    # Squared differences of the quadratics' coefficients, and the product of the differences.
    # The one that stands out farther from its rounding is found by a root, the other by division.
    apart_b, size_b = a3 * a3 - 4 * (a2 - s), a3 * a3 + 4 * (np.abs(a2) + np.abs(s))
    apart_c, size_c = s * s - 4 * a0, s * s + 4 * np.abs(a0)
    product = a3 * s - 2 * a1
    by_c = apart_c * size_b >= apart_b * size_c
    apart, size = np.where(by_c, apart_c, apart_b), np.where(by_c, size_c, size_b)
    apart = np.where(apart > 4 * EPS * size, apart, 0.0)
    root = np.sqrt(apart)
    other = np.where(apart > 0, product, 0.0) / np.where(apart > 0, root, 1.0)
    difference_b, difference_c = np.where(by_c, other, root), np.where(by_c, root, other)
    # The first quadratic is the one with the larger constant term.
    turn = np.where(s * difference_c < 0, -1.0, 1.0)
    difference_b, difference_c = turn * difference_b, turn * difference_c
    b1, b2 = (a3 + difference_b) / 2, (a3 - difference_b) / 2
    c1 = (s + difference_c) / 2
    c2 = a0 / np.where(c1 != 0, c1, 1.0)
    found = (b1, c1), (b2, c2)
    for _ in range(POLISHING_STEPS):
        found = _polish(found, (a3, a2, a1, a0))
    return found


def _resolvent_root(a3: Floats, a2: Floats, a1: Floats, a0: Floats) -> Floats:
    """Return the largest root of the resolvent cubic, or the only one.

    It is ``(s - a2)(s^2 - 4 a0) + a1 a3 s - a1^2 - a3^2 a0``.
    """
    linear, constant = a1 * a3, a1 * a1 + a3 * a3 * a0

    def cubic(s: Floats) -> Floats:
        result: Floats = (s - a2) * (s * s - 4 * a0) + (linear * s - constant)
        return result

    bend = a2 * a2 - 3 * (linear - 4 * a0)
    radius = np.maximum(np.sqrt(np.abs(bend)), (np.abs(a2) + np.sqrt(np.abs(a0))) / 10)
    # Where the cubic is positive both at its inflection and at its minimum, its only root is
    # below; elsewhere the largest is above the minimum.  From beyond the root, as beyond
    # a2/3 + 2/3 radius if all three are real, the steps all go one way.
    least = (a2 + np.sqrt(np.maximum(bend, 0.0))) / 3
    size = (np.abs(least) + np.abs(a2)) * (least * least + 4 * np.abs(a0))
    noise = 8 * EPS * (size + np.abs(linear * least) + np.abs(a1 * a1) + np.abs(a3 * a3 * a0))
    side = np.where((cubic(a2 / 3) > 0) & (cubic(least) > noise), -1.0, 1.0)
    s: Floats = (a2 + 2 * side * radius) / 3
    for step in range(MOST_STEPS):
        slope = (3 * s - 2 * a2) * s + (linear - 4 * a0)
        there = s - cubic(s) / np.where(slope != 0, slope, 1.0)
        there = np.where(side > 0, np.maximum(there, least), there)
        # Only the first step may be outwards.  A run whose steps have ended stays where it is,
        # however many more the others take.
        there = np.where((side * there < side * s) | (step == 0), there, s)
        if np.array_equal(there, s):
            break
        s = there
    return s


def _polish(found: Pairs, quartic: Coefficients) -> Pairs:
    """Take a step of Newton's method for the coefficients of both quadratics (Bairstow)."""
    (b1, c1), (b2, c2) = found
    r3, r2, r1, r0 = rests = _rests(found, quartic)
    b, c, rest = b1 - b2, c1 - c2, r2 - b1 * r3
    e0, e1 = r0 - c1 * rest, r1 - c1 * r3 - b1 * rest
    # Where the two have a root in common, it is zero, and they stay as they are.
    resultant = c * c - b1 * b * c + c1 * b * b
    inverse = np.where(resultant != 0, 1.0, 0.0) / np.where(resultant != 0, resultant, 1.0)
    db1 = (b * e0 - c * e1) * inverse
    dc1 = ((b1 * b - c) * e0 - c1 * b * e1) * inverse
    step = (b1 + db1, c1 + dc1), (b2 + (r3 - db1), c2 + (rest - dc1 + b * db1))
    # Nor may a step lead away, as one out of rounding does where they almost have.
    scale = np.sqrt(np.abs(c1) + b1 * b1 + b2 * b2)

    def size(rests: Coefficients) -> Floats:
        r3, r2, r1, r0 = (np.abs(r) for r in rests)
        total: Floats = ((r3 * scale + r2) * scale + r1) * scale + r0
        return total

    noise = 16 * EPS * np.square(scale * scale)
    good = size(_rests(step, quartic)) <= size(rests) + noise
    return choose(good, step[0], found[0]), choose(good, step[1], found[1])


def choose(where: Flags, one: Pair, other: Pair) -> Pair:
    """Return one pair where a condition is true, else the other."""
    return np.where(where, one[0], other[0]), np.where(where, one[1], other[1])


def _rests(found: Pairs, quartic: Coefficients) -> Coefficients:
    """Return what the product of two quadratics lacks of a quartic, coefficient by coefficient."""
    (b1, c1), (b2, c2) = found
    a3, a2, a1, a0 = quartic
    return a3 - b1 - b2, a2 - c1 - c2 - b1 * b2, a1 - b1 * c2 - b2 * c1, a0 - c1 * c2


def roots(b: Floats, c: Floats) -> Pairs:
    """Return real and imaginary parts of the roots of ``z^2 + b z + c``, the upper one first.

    That is the one with positive imaginary part, or the larger one of two real roots.
    """
    half = -b / 2
    inside = half * half - c
    root, real = np.sqrt(np.abs(inside)), inside >= 0
    far = half + np.copysign(root, half)
    near = c / np.where(far != 0, far, 1.0)
    upper = np.where(real, np.maximum(far, near), half)
    lower = np.where(real, np.minimum(far, near), half)
    frequency = np.where(real, 0.0, root)
    return (upper, frequency), (lower, -frequency)


def symmetric_eigenvalues(matrix: list[list[Floats]]) -> list[Floats]:
    """Return the eigenvalues of symmetric matrices, given by rows, in no order.

    By Jacobi's rotations (Golub and Van Loan, Matrix Computations, 4th ed., sec. 8.5.2).
    """
    a = [list(row) for row in matrix]
    places = range(len(a))
    for i, j in JACOBI_SWEEPS * [(i, j) for i in places for j in places if i < j]:
        twice = 2 * a[i][j]
        apart = a[j][j] - a[i][i]
        below = np.abs(apart) + np.sqrt(apart * apart + twice * twice)
        t = np.copysign(1.0, apart) * twice / np.where(below > 0, below, 1.0)
        cos = 1 / np.sqrt(1 + t * t)
        sin = t * cos
        shift = t * a[i][j]
        a[i][i], a[j][j] = a[i][i] - shift, a[j][j] + shift
        a[i][j] = a[j][i] = np.zeros_like(t)
        for k in places:
            if k not in (i, j):
                one, other = a[i][k], a[j][k]
                a[i][k] = a[k][i] = cos * one - sin * other
                a[j][k] = a[k][j] = sin * one + cos * other
    return [a[i][i] for i in places]
