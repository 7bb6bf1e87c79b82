"""Bodies of simple shapes: half an ellipsoid, as stones are carved and toys are moulded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.physics import si

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rattlesweep.arrays import Floats


def half_ellipsoid(
    length: ArrayLike, width: ArrayLike, height: ArrayLike, mass: ArrayLike,
    skew: ArrayLike = 0.0, *, weights: ArrayLike = 0.0, x: ArrayLike = 0.0, y: ArrayLike = 0.0,
) -> dict[str, Floats]:  # fmt: skip
    """Return the parameters of solid half ellipsoids that lie with their flat side up.

    Arguments as for :meth:`rattlesweep.physics.body.Rattleback.half_ellipsoid`, in m, kg and
    radians, with ``at = (x, y)``.  The density is uniform: without weights the centre of mass lies
    ``3/8`` of the height below the flat side.  Returned are ``alpha, beta, gamma, theta, phi, xi,
    c``, and the units: ``mass`` in kg and ``height`` of the centre of mass in m, with the weights.
    """
    length, width, height, mass, skew, weights, x, y = np.broadcast_arrays(
        *(np.asarray(v, float) for v in (length, width, height, mass, skew, weights, x, y))
    )
    p, q = length / 2, width / 2
    both = 2 * weights
    total = mass + both
    a = height * (5 / 8 * mass + both) / total
    # About the centre of mass of all, along axes to the right and towards the observer.
    flat = 19 / 320 * height**2 + (a - 5 / 8 * height) ** 2
    mean = mass * ((p**2 + q**2) / 10 + flat) + both * ((x**2 + y**2) / 2 + (height - a) ** 2)
    own, added = mass * (q**2 - p**2) / 10, both * (y**2 - x**2) / 2
    half = own * np.cos(2 * skew) + added
    vertical = mass * (p**2 + q**2) / 5 + both * (x**2 + y**2)
    inertia = [mean + half, mean - half, vertical, own * np.sin(2 * skew) + both * x * y]
    radii = np.stack([p**2 / height, q**2 / height], axis=-1)
    found = si.parameters(total, np.stack(inertia, axis=-1), a, radii, np.zeros(a.shape))
    return {**found, "c": height / a, "mass": total, "height": a}
