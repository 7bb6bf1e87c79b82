"""Bodies of simple shapes: half an ellipsoid, as stones are carved and toys are moulded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.physics import si
from rattlesweep.units import quantities

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from rattlesweep.arrays import Floats


def half_ellipsoid(
    length: ArrayLike,
    width: ArrayLike,
    height: ArrayLike,
    mass: ArrayLike,
    skew: ArrayLike = 0.0,
    *,
    weights: ArrayLike = 0.0,
    x: ArrayLike = 0.0,
    y: ArrayLike = 0.0,
) -> dict[str, Floats]:
    """Return the parameters of solid half ellipsoids that lie with their flat side up.

    Parameters
    ----------
    length, width : array_like
        Of the flat side, in m: twice the horizontal semi-axes.
    height : array_like
        From the lowest point to the flat side, in m: the vertical semi-axis.
    mass : array_like
        Of the half ellipsoid without weights, in kg; its density is uniform.
    skew : array_like
        Angle in radians by which the inertia of the half ellipsoid is turned against its surface,
        clockwise seen from above: of a body whose base is cut at this angle.  Without weights,
        ``xi = -skew``.
    weights : array_like
        Mass in kg of each of two points on the flat side, at ``(x, y)`` and ``(-x, -y)``.
    x, y : array_like
        Along the length and across it, in m, seen from above: `x` to the right, `y` away.

    Returns
    -------
    dict
        ``alpha, beta, gamma, theta, phi, xi, c`` as :class:`rattlesweep.physics.body.Rattleback`
        has them; ``mass`` in kg and ``height`` of the centre of mass over the lowest point in m,
        both with the weights, which are its units of mass and length.

    Notes
    -----
    The centre of mass of the half ellipsoid alone lies ``3/8`` of its height below the flat side.
    The surface touches the plane like the whole ellipsoid, at any tilt.
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
    inertia = [
        mean + half,
        mean - half,
        mass * (p**2 + q**2) / 5 + both * (x**2 + y**2),
        own * np.sin(2 * skew) + both * x * y,
    ]
    radii = np.stack([p**2 / height, q**2 / height], axis=-1)
    found = si.parameters(total, np.stack(inertia, axis=-1), a, radii, np.zeros(a.shape))
    return {**found, "c": height / a, "mass": total, "height": a}


def measured(
    *,
    length: float | str,
    width: float | str,
    height: float | str,
    mass: float | str,
    skew: float | str = 0.0,
    weights: float | str | None = None,
    at: Sequence[float | str] | str | None = None,
    gravity: float | str = si.GRAVITY,
) -> tuple[dict[str, float], si.Units]:
    """Return the parameters and the units of one half ellipsoid, given as numbers or text."""
    sizes = {
        name: si.number(value, kind, name)
        for name, value, kind in (
            ("length", length, "length"),
            ("width", width, "length"),
            ("height", height, "length"),
            ("mass", mass, "mass"),
            ("gravity", gravity, "acceleration"),
            *([] if weights is None else [("weights", weights, "mass")]),
        )
    }
    for name, value in sizes.items():
        if not 0 < value < np.inf:
            raise ValueError(f"{name} is {value:g}; it must be positive")
    if (weights is None) != (at is None):
        raise ValueError("weights and at belong together: the mass of each weight, and the place "
                         "(x, y) of one from the middle of the flat side")  # fmt: skip
    if at is not None:
        try:
            places = quantities(at, "length", 2) if isinstance(at, str) else at
        except ValueError as error:
            raise ValueError(f"at: {at!r} {error}") from None
        if len(places) != 2:
            raise ValueError(f"at: two lengths are needed, and not {len(places)}")
        x, y = (si.number(place, "length", "at") for place in places)
        inside = (2 * x / sizes["length"]) ** 2 + (2 * y / sizes["width"]) ** 2
        if not inside <= 1:
            raise ValueError(f"at: ({x:g} m, {y:g} m) is beyond the edge of the flat side")
        sizes |= {"x": x, "y": y}
    acceleration = sizes.pop("gravity")
    angle = si.number(skew, "angle", "skew")
    found = {k: float(v) for k, v in half_ellipsoid(**sizes, skew=angle).items()}
    return found, si.Units(found.pop("mass"), found.pop("height"), acceleration)
