"""Whether the bodies of a target can be found in the ranges, and how long that takes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.sweeps.config.bodies import SdSource, Target
from rattlesweep.sweeps.sense.sample import DRAWN, coefficient, draw

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# Bodies by which the density near a target is judged.
ENOUGH = 32
# The sampler draws some 1e7 bodies a second and thread.
TOO_MANY, MANY = 1e10, 1e11


def target_problems(source: SdSource) -> Iterator[tuple[str, bool]]:
    """Sentences about targets: those out of reach (True) and those that will take long (False)."""
    target = source.target
    if target is None:
        return
    found = coefficient(draw(source.ranges), target.name)
    low, high = float(np.nanmin(found)), float(np.nanmax(found))
    for value in target.values:
        # What lies beyond all of these takes millions of draws a body, if there is any.
        if not low <= (1 + target.rel_tol) * value or not (1 - target.rel_tol) * value <= high:
            yield (
                f"{value:g} is out of reach: in {DRAWN} bodies drawn from the ranges {target.name} "
                f"lies between {low:.4g} and {high:.4g}; give a target in between or other ranges",
                True,
            )
        else:
            yield from _patience(source, target, value, found)


def _patience(
    source: SdSource, target: Target, value: float, found: Floats
) -> Iterator[tuple[str, bool]]:
    chance, most = _chance(found, value, target.rel_tol)
    draws = 1 / chance if chance else np.inf
    words = (
        f"{value:g} takes {'at least' if most else 'about'} {draws:.1e} draws a body, by {DRAWN} "
        "bodies drawn from the ranges"
    )
    wayout = "give other ranges, a larger rel_tol or another target"
    if draws > TOO_MANY:
        yield f"{words}: hours for each; {wayout}", True
        return
    missed = float(np.exp(-chance * target.max_draws))
    if missed > 0.99:
        yield f"{words}, but max_draws is {target.max_draws}; {wayout}, or more max_draws", True
    elif missed * source.samples > 0.01:
        yield (
            f"{words}: in max_draws = {target.max_draws} of them each of the {source.samples} "
            f"samples is missed with probability {missed:.1g}, and one miss ends the sweep; "
            f"{wayout}, or more max_draws",
            False,
        )
    elif draws * source.samples > MANY:
        yield f"{words}, {draws * source.samples:.1e} in all: hours; {wayout}", False


def _chance(found: Floats, value: float, rel_tol: float) -> tuple[float, bool]:
    """Probability that a draw meets `value`, and whether it is only an upper limit."""
    off = np.sort(np.abs(found - value))
    inside = int(np.searchsorted(off, rel_tol * value, side="right"))
    if inside >= ENOUGH:
        return inside / len(off), False
    # The nearest bodies stand for the neighbourhood, if they are not more than half as far away.
    count = int(np.searchsorted(off, value / 2))
    place = (min(count, ENOUGH) or ENOUGH) - 1
    share = rel_tol * value / max(float(off[place]), rel_tol * value)
    return (place + 1) / len(off) * share, count == 0
