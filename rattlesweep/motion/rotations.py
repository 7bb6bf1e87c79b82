"""The attitude of a body in any position, added up over the steps of a run.

Single steps add the rotation and the path since their start
(:func:`rattlesweep.physics.vectors.carried_on`).  The vertical of the state is more
exact than that of the rotations, so each attitude is tilted to it.  Near the vertical
the heading of the body's x axis turns by half a turn at once; elsewhere it follows the
spin, which tells turns of more than half a turn in a step.
"""

from __future__ import annotations

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics.full import quaternion

# Columns: heading, place on the plane, unit quaternion from the body to the plane.
HEADING = 0
PLACE = slice(1, 3)
QUATERNION = slice(3, 7)


def at_launch(u: Floats) -> Floats:
    """Return the attitude at launch, shape (1, 7)."""
    q = quaternion(u / np.linalg.norm(u), np.zeros(()))
    return np.concatenate([np.zeros(3), q])[None]


def after(begin: Floats, steps: Floats, v: Floats, turns: Floats) -> Floats:
    """Return attitudes (rows, 7) after a step from each of `begin`.

    `steps` are the rotations and paths of the steps, `v` vectors along the vertical at
    their ends, both in the axes of the body, `turns` about the changes of the heading.
    """
    q = _product(begin[:, QUATERNION].T, _rotation(steps))
    return _added(begin, begin[:, QUATERNION].T, _upright(q, v), steps, turns)


def added(begin: Floats, steps: Floats, v: Floats, turns: Floats) -> Floats:
    """Return attitudes (1 + steps, 7): `begin`, and after each of successive steps."""
    q = begin[QUATERNION]
    products = [q]
    for step in _rotation(steps).T:
        q = _product(q, step)
        products.append(q)
    ends = np.array(products).T
    ends[:, 1:] = _upright(ends[:, 1:], v)
    rows = np.zeros((len(steps), 7))
    rows = _added(rows, ends[:, :-1], ends[:, 1:], steps, turns)
    # These are changes; the first row is where they begin.
    rows[:, : PLACE.stop] = begin[: PLACE.stop] + np.cumsum(
        rows[:, : PLACE.stop], axis=0
    )
    return np.concatenate([begin[None], rows])


def _added(
    begin: Floats, q0: Floats, q1: Floats, steps: Floats, turns: Floats
) -> Floats:
    """Return attitudes after steps from `begin` that turn ``q0`` to ``q1``."""
    path = _rotated(q0, steps[:, 4:].T)
    change = _heading(q1) - _heading(q0) - turns
    change -= 2 * np.pi * np.round(change / (2 * np.pi))
    moved = np.stack([change + turns, path[0], path[1]], axis=1)
    return np.concatenate([begin[:, : PLACE.stop] + moved, q1.T], axis=1)


def _rotation(steps: Floats) -> Floats:
    """Return the unit quaternions of steps, shape (4, rows)."""
    q = steps[:, :4].T.copy()
    q[0] += 1.0
    rotation: Floats = q / np.linalg.norm(q, axis=0)
    return rotation


def _product(q: Floats, r: Floats) -> Floats:
    """Return the quaternion that rotates by `r` and then by `q`."""
    w, x, y, z = q
    a, b, c, d = r
    return np.array(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ]
    )


def _rotated(q: Floats, vector: Floats) -> Floats:
    """Return vectors (3, rows) rotated by quaternions."""
    axis = q[1:]
    across = np.cross(axis, vector, axis=0) + q[0] * vector
    rotated: Floats = vector + 2 * np.cross(axis, across, axis=0)
    return rotated


def _upright(q: Floats, v: Floats) -> Floats:
    """Return quaternions tilted a little, so that they bring `v` to the vertical."""
    x, y, z = _rotated(q, v.T / np.linalg.norm(v, axis=1))
    tilt = np.array([1 + z, y, -x, np.zeros_like(z)])
    return _product(tilt / np.linalg.norm(tilt, axis=0), q)


def _heading(q: Floats) -> Floats:
    """Return the direction on the plane of the body's x axis."""
    w, x, y, z = q
    heading: Floats = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return heading
