"""Frames of three tangents, for all five Lyapunov exponents.

At each state there is an orthogonal basis: the flow, three directions that are
transverse (:func:`rattlesweep.physics.tangent.transverse`), and the gradient of the
energy.  The flow carries itself along, and tangents of constant energy stay such, so in
these bases the derivative ``Phi`` of the motion over a time is block triangular:

    det Phi = |f1|/|f0| * det(transverse part) * |grad E0|/|grad E1|.

The logarithms of the first and the last factor over the time are the exponents of the
flow and of the energy, which tend to zero.  The QR factors of the transverse part give
the other three (Benettin and others, Meccanica 15, 9, 1980).  All five add up to the
mean rate of the volume of the state.

A frame is a tuple of three tangents, one after the other.
"""

# mypy: disable-error-code="no-untyped-def"
from math import sqrt

from rattlesweep.physics import tangent
from rattlesweep.physics.full import TINY, scalar

N_TANGENTS = 3


@scalar
def _split(frame):
    return frame[:5], frame[5:10], frame[10:]


@scalar
def _of_each(formula, y, dy, frame, q):
    """Return a formula of `physics.tangent` for each tangent."""
    first, second, third = _split(frame)
    of_first = formula(y, dy, first, q)
    of_second = formula(y, dy, second, q)
    of_third = formula(y, dy, third, q)
    return of_first + of_second + of_third


@scalar
def rate(y, dy, frame, q):
    """Return the derivative of each tangent."""
    return _of_each(tangent.rate, y, dy, frame, q)


@scalar
def transverse(y, dy, frame, q):
    """Return the part of each tangent at constant energy and normal to the flow."""
    return _of_each(tangent.transverse, y, dy, frame, q)


@scalar
def seed(y, q):
    """Return a frame whose first tangent is that of `tangent.seed`."""
    first = tangent.seed(y, q)
    p, q1, a, b, _ = first
    second = p, -2.0 * q1, 0.5 * a, -b, 0.0
    third = -0.5 * p, q1, 2.0 * a, -b, 0.0
    return first + second + third


@scalar
def _inner(v, w, q):
    """Return the inner product of two tangents whose square is `tangent.square`."""
    p1, q1, a1, b1, c1 = v
    p2, q2, a2, b2, c2 = w
    ix, iy, iz, cxx, cxy, cyy = q
    return (
        (1.0 + cxx) * p1 * p2
        + cxy * (p1 * q2 + q1 * p2)
        + (1.0 + cyy) * q1 * q2
        + (ix + 1.0) * a1 * a2
        + (iy + 1.0) * b1 * b2
        + iz * c1 * c2
    )


@scalar
def factor(frame, q):
    """Return ``R`` of the factors ``QR``: its diagonal, then the elements above it.

    ``R`` is the Cholesky factor of the inner products.  A frame is orthonormal at the
    start of each step, and so nearly orthogonal at its end.
    """
    first, second, third = _split(frame)
    r11 = sqrt(_inner(first, first, q) + TINY)
    r12 = _inner(first, second, q) / r11
    r13 = _inner(first, third, q) / r11
    r22 = sqrt(_inner(second, second, q) - r12 * r12 + TINY)
    r23 = (_inner(second, third, q) - r12 * r13) / r22
    r33 = sqrt(_inner(third, third, q) - r13 * r13 - r23 * r23 + TINY)
    return r11, r22, r33, r12, r13, r23


@scalar
def _less(v, share, w):
    """Return ``v - share * w``."""
    p1, q1, a1, b1, c1 = v
    p2, q2, a2, b2, c2 = w
    return (
        p1 - share * p2,
        q1 - share * q2,
        a1 - share * a2,
        b1 - share * b2,
        c1 - share * c2,
    )


@scalar
def _shorter(v, length):
    """Return ``v / length``."""
    p, q, a, b, c = v
    inverse = 1.0 / length
    return p * inverse, q * inverse, a * inverse, b * inverse, c * inverse


@scalar
def solve(frame, triangle):
    """Return ``Q`` of the factors ``QR``; of derivatives, the derivatives of ``Q``."""
    r11, r22, r33, r12, r13, r23 = triangle
    first, second, third = _split(frame)
    first = _shorter(first, r11)
    second = _shorter(_less(second, r12, first), r22)
    third = _shorter(_less(_less(third, r13, first), r23, second), r33)
    return first + second + third


@scalar
def trivial(y, dy, q):
    """Return the squared norms of the flow and of the gradient of the energy."""
    ix, iy, iz, cxx, cxy, cyy = q
    ep, eq, ea, eb, ec = tangent.gradient(y, q)
    bxx = 1.0 + cxx
    byy = 1.0 + cyy
    # The norm of a gradient is that of the inverse matrix.
    slope = byy * ep * ep - 2.0 * cxy * ep * eq + bxx * eq * eq
    steep = (
        slope / (bxx * byy - cxy * cxy)
        + ea * ea / (ix + 1.0)
        + eb * eb / (iy + 1.0)
        + ec * ec / iz
    )
    return tangent.square(dy, q), steep
