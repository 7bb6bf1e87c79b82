"""Roots of quartics with real coefficients, as those of two real quadratics.

All arithmetic is on real numbers and rounds in one way only, as IEEE 754 prescribes.
"""

import numpy as np

from rattlesweep.arrays import Flags, Floats

# Real and imaginary parts, or the coefficients b, c of a quadratic z^2 + b z + c.
Pair = tuple[Floats, Floats]
Pairs = tuple[Pair, Pair]
Coefficients = tuple[Floats, Floats, Floats, Floats]

EPS = np.finfo(float).eps
# Newton's method converges in a few steps to a simple root, but only linearly to a
# double root.
MAX_NEWTON_STEPS = 100
POLISHING_STEPS = 2


def quadratics(a3: Floats, a2: Floats, a1: Floats, a0: Floats) -> Pairs:
    """Factor a quartic, ``z^4 + a3 z^3 + ... + a0``, into two real quadratics.

    The result is ``(b1, c1), (b2, c2)`` with ``|c1| >= |c2|``.  Newton's method finds
    the sum ``s`` of the constant terms as a root of Ferrari's resolvent cubic.  Two of
    its steps for all four coefficients then remove the rounding errors of the small
    ones.
    """
    s = _resolvent_root(a3, a2, a1, a0)
    # Squared differences of b and of c, and the product of the differences.  The square
    # that is larger relative to its rounding error gives one difference; division gives
    # the other.
    apart_b = a3 * a3 - 4 * (a2 - s)
    size_b = a3 * a3 + 4 * (np.abs(a2) + np.abs(s))
    apart_c = s * s - 4 * a0
    size_c = s * s + 4 * np.abs(a0)
    product = a3 * s - 2 * a1
    by_c = apart_c * size_b >= apart_b * size_c
    apart = np.where(by_c, apart_c, apart_b)
    size = np.where(by_c, size_c, size_b)
    apart = np.where(apart > 4 * EPS * size, apart, 0.0)
    root = np.sqrt(apart)
    quotient = np.where(apart > 0, product, 0.0) / np.where(apart > 0, root, 1.0)
    difference_b = np.where(by_c, quotient, root)
    difference_c = np.where(by_c, root, quotient)
    # The first quadratic has the larger constant term.
    turn = np.where(s * difference_c < 0, -1.0, 1.0)
    difference_b = turn * difference_b
    difference_c = turn * difference_c
    b1 = (a3 + difference_b) / 2
    b2 = (a3 - difference_b) / 2
    c1 = (s + difference_c) / 2
    c2 = a0 / np.where(c1 != 0, c1, 1.0)
    pairs = (b1, c1), (b2, c2)
    for _ in range(POLISHING_STEPS):
        pairs = _polish(pairs, (a3, a2, a1, a0))
    return pairs


def _resolvent_root(a3: Floats, a2: Floats, a1: Floats, a0: Floats) -> Floats:
    linear = a1 * a3
    constant = a1 * a1 + a3 * a3 * a0

    def cubic(s: Floats) -> Floats:
        return np.asarray((s - a2) * (s * s - 4 * a0) + (linear * s - constant))

    bend = a2 * a2 - 3 * (linear - 4 * a0)
    radius = np.maximum(np.sqrt(np.abs(bend)), (np.abs(a2) + np.sqrt(np.abs(a0))) / 10)
    # Where the cubic is positive both at its inflection and at its minimum, its only
    # root lies below; otherwise the largest root lies above the minimum.  Steps from
    # beyond the root, such as from a2/3 + 2/3 radius if all three roots are real, all
    # go the same way.
    least = (a2 + np.sqrt(np.maximum(bend, 0.0))) / 3
    size = (np.abs(least) + np.abs(a2)) * (least * least + 4 * np.abs(a0))
    noise = (
        8
        * EPS
        * (size + np.abs(linear * least) + np.abs(a1 * a1) + np.abs(a3 * a3 * a0))
    )
    side = np.where((cubic(a2 / 3) > 0) & (cubic(least) > noise), -1.0, 1.0)
    s: Floats = (a2 + 2 * side * radius) / 3
    for step in range(MAX_NEWTON_STEPS):
        slope = (3 * s - 2 * a2) * s + (linear - 4 * a0)
        s_next = s - cubic(s) / np.where(slope != 0, slope, 1.0)
        s_next = np.where(side > 0, np.maximum(s_next, least), s_next)
        # Only the first step may go outwards; an iteration that has ended stays where
        # it is.
        inward = side * s_next < side * s
        s_next = np.where(inward | (step == 0), s_next, s)
        if np.array_equal(s_next, s):
            break
        s = s_next
    return s


def _polish(pairs: Pairs, quartic: Coefficients) -> Pairs:
    """Take a step of Newton's method for all coefficients (Bairstow)."""
    (b1, c1), (b2, c2) = pairs
    residuals = _residuals(pairs, quartic)
    r3, r2, r1, r0 = residuals
    b = b1 - b2
    c = c1 - c2
    rest = r2 - b1 * r3
    e0 = r0 - c1 * rest
    e1 = r1 - c1 * r3 - b1 * rest
    # The resultant is zero where the quadratics have a common root; they then stay as
    # they are.
    resultant = c * c - b1 * b * c + c1 * b * b
    inverse = np.where(resultant != 0, 1.0, 0.0) / np.where(
        resultant != 0, resultant, 1.0
    )
    db1 = (b * e0 - c * e1) * inverse
    dc1 = ((b1 * b - c) * e0 - c1 * b * e1) * inverse
    step = (b1 + db1, c1 + dc1), (b2 + (r3 - db1), c2 + (rest - dc1 + b * db1))
    # Near a common root a step may consist of rounding errors; one that leads away is
    # not taken.
    scale = np.sqrt(np.abs(c1) + b1 * b1 + b2 * b2)

    def size(residuals: Coefficients) -> Floats:
        r3, r2, r1, r0 = (np.abs(r) for r in residuals)
        return np.asarray(((r3 * scale + r2) * scale + r1) * scale + r0)

    noise = 16 * EPS * np.square(scale * scale)
    good = size(_residuals(step, quartic)) <= size(residuals) + noise
    return choose(good, step[0], pairs[0]), choose(good, step[1], pairs[1])


def choose(where: Flags, x: Pair, y: Pair) -> Pair:
    """Return ``x`` where a condition is true and ``y`` elsewhere."""
    return np.where(where, x[0], y[0]), np.where(where, x[1], y[1])


def _residuals(pairs: Pairs, quartic: Coefficients) -> Coefficients:
    (b1, c1), (b2, c2) = pairs
    a3, a2, a1, a0 = quartic
    return a3 - b1 - b2, a2 - c1 - c2 - b1 * b2, a1 - b1 * c2 - b2 * c1, a0 - c1 * c2


def roots(b: Floats, c: Floats) -> Pairs:
    """Return real and imaginary parts of the two roots of ``z^2 + b z + c``.

    The first has the positive imaginary part, or is the larger of two real roots.
    """
    half = -b / 2
    inside = half * half - c
    root = np.sqrt(np.abs(inside))
    real = inside >= 0
    far = half + np.copysign(root, half)
    near = c / np.where(far != 0, far, 1.0)
    upper = np.where(real, np.maximum(far, near), half)
    lower = np.where(real, np.minimum(far, near), half)
    frequency = np.where(real, 0.0, root)
    return (upper, frequency), (lower, -frequency)
