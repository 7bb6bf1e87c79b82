"""Sentences on a solid at rest: what may make it another than the real one."""

from __future__ import annotations

import math

from rattlesweep.physics.mesh.standing import Standing

DOUBTED_TILT = math.radians(0.5)
MOST_CHANGE = 0.05  # of a radius with the range that is fitted
DOUBTED_FLAT = 0.15  # of the fitted slope, on a flat facet
LEAST_SKEW = math.radians(0.05)
NEARLY_EQUAL = 1.2  # ratio of radii
DOUBTED_TURN = math.radians(30)  # from the direction that is up


def doubts_of(standing: Standing) -> list[str]:
    """Return sentences on what may make the body another than the real one."""
    doubts = list(standing.remarks)
    smaller, larger = standing.surface.radii * 1e3
    if standing.change > MOST_CHANGE:
        ranges = []
        for other in (standing.others[0], standing.surface, standing.others[1]):
            if other is not None:
                slope = math.degrees(math.sqrt(2 * other.reach / other.radii[0]))
                first, second = other.radii * 1e3
                ranges.append(f"{first:.4g} and {second:.4g} mm to {slope:.2g} deg")
        doubts.append(
            f"the radii change by {100 * standing.change:.2g} % with the range that is "
            f"fitted ({'; '.join(ranges)}), so times depend on how far it swings"
        )
    if standing.flat > DOUBTED_FLAT:
        doubts.append(
            f"the body stands on a flat facet over {100 * standing.flat:.2g} % of the "
            "slope that is fitted; polish it there, or export a finer mesh"
        )
    if standing.tilt > DOUBTED_TILT:
        doubts.append(
            f"the third principal axis leans by {math.degrees(standing.tilt):.2g} deg, "
            f"and is taken as vertical; to mend it, {standing.remedy}"
        )
    if abs(standing.parameters["xi"]) < LEAST_SKEW:
        skew = math.degrees(standing.parameters["xi"])
        doubts.append(
            f"the skew is {skew:.2g} deg, so both directions are nearly alike"
        )
    if larger < NEARLY_EQUAL * smaller:
        doubts.append(
            f"the radii {smaller:.4g} and {larger:.4g} mm are nearly equal, so "
            "their axes are badly known"
        )
    if standing.turned > DOUBTED_TURN:
        doubts.append(
            f"it comes to rest {math.degrees(standing.turned):.3g} deg from the "
            "direction taken as up; give `up` if another side is meant"
        )
    return doubts
