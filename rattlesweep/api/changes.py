"""What would make a stone turn back: its spin, skew, weights, or the plane's lever.

Every answer is a run that was made, and made again at a tighter tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.analysis.advice import weights_for_skew, with_weights
from rattlesweep.analysis.contact import patch_under
from rattlesweep.analysis.verdict import CLOCKWISE, COUNTERCLOCKWISE, SIGN_OF_DIRECTION
from rattlesweep.arrays import Floats
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.friction.materials import MATERIALS
from rattlesweep.words.defaults import PATCH_FRICTION

if TYPE_CHECKING:
    import pandas as pd

_LEAST_SPIN = 5.0  # rpm, of the spins that are tried
_MOST_SKEW = 30.0  # degrees
_LEAST_LEVER = 0.02  # of the lever that is given
TRIED = 16  # values of a first search
REFINED = 6  # values between the two that enclose an answer
MICRO = 1e-6


@dataclass(frozen=True)
class Trial:
    """A launch of a body with losses in SI units."""

    body: Rattleback
    losses: Mapping[str, float]
    n_i_rpm: float


# The outcomes of trials at a tolerance: whether they turn back, and their times in s.
Tries = Callable[[Sequence[Trial], bool], "pd.DataFrame"]


@dataclass(frozen=True)
class Change:
    """What makes a launch turn back, as a row of the table of advice."""

    change: str  # spin, skew, lever or weights
    value: float
    unit: str
    before: float | None
    words: str
    trial: Trial  # the launch with the change

    @property
    def direction(self) -> str:
        """The direction of the launch."""
        return COUNTERCLOCKWISE if self.trial.n_i_rpm > 0 else CLOCKWISE

    @property
    def spin_rpm(self) -> float:
        """The spin of the launch without its sign."""
        return abs(self.trial.n_i_rpm)


def smallest_spin(trial: Trial, tries: Tries) -> Change | None:
    """Return the smallest spin found, up to that of a trial, that turns back."""
    most = abs(trial.n_i_rpm)

    def at(spin: float) -> Trial:
        return replace(trial, n_i_rpm=math.copysign(spin, trial.n_i_rpm))

    low = min(_LEAST_SPIN, most)
    spin = _first(np.geomspace(low, most, TRIED), at, tries)
    if spin is None:
        return None
    words = f"{spin:g} rpm is the smallest spin found that turns back"
    if spin <= low:
        words = f"already {spin:g} rpm turns back"
    return Change("spin", spin, "rpm", None, words, at(spin))


def larger_skew(trial: Trial, tries: Tries) -> Change | None:
    """Return the smallest larger skew found with which a launch turns back."""
    before = math.degrees(abs(trial.body.xi))
    if before >= _MOST_SKEW:
        return None

    def at(skew: float) -> Trial:
        xi = math.copysign(math.radians(skew), trial.body.xi)
        return replace(trial, body=trial.body.replace(xi=xi))

    skew = _first(np.geomspace(before, _MOST_SKEW, TRIED)[1:], at, tries, before)
    if skew is None:
        return None
    words = f"a skew of {skew:g} deg instead of {before:.3g}"
    return Change("skew", skew, "deg", before, words, at(skew))


def shorter_lever(trial: Trial, tries: Tries) -> Change | None:
    """Return the longest shorter lever found with which a launch turns back.

    The words name materials on which the stone would have such a lever.
    """
    pivot = trial.losses.get("pivot", 0.0)
    if not pivot:
        return None
    before = pivot / MICRO

    def at(lever: float) -> Trial:
        return replace(trial, losses={**trial.losses, "pivot": lever * MICRO})

    shorter = np.geomspace(before, _LEAST_LEVER * before, TRIED)[1:]
    lever = _first(shorter, at, tries, before)
    if lever is None:
        return None
    words = f"a lever of {lever:g} um instead of {before:.3g}"
    material = _material_of(trial.body, lever)
    if material is not None:
        words += f" ({material})"
    return Change("lever", lever, "um", before, words, at(lever))


def two_weights(trial: Trial, tries: Tries) -> Change | None:
    """Return two light weights with which a launch turns back."""
    units = trial.body.units
    if units is None or not math.isfinite(units.mass):
        return None
    weights = weights_for_skew(trial.body)
    if weights is None:
        return None
    try:
        heavier = replace(trial, body=with_weights(trial.body, weights))
    except ValueError:  # no body has this inertia
        return None
    if not tries([heavier], False)["turns"].iloc[0]:
        return None
    _, _, words = weights.sentence.partition(": ")
    grams = 1e3 * weights.mass
    words = words.replace(" make it ", ", for a skew of ").replace(
        " deg instead of ", " instead of "
    )
    return Change("weights", grams, "g", None, words, heavier)


def _first(
    values: Floats,
    at: Callable[[float], Trial],
    tries: Tries,
    before: float | None = None,
) -> float | None:
    """Return the first of some values with which a trial turns back, refined once.

    `before` is a value in front of them that does not turn back.
    """
    tried = _rounded(values)
    found = _first_place([*map(at, tried)], tries)
    if found is None:
        return None
    last = tried[found]
    if found:
        before = tried[found - 1]
    if before is None:
        return last
    between = _rounded(np.linspace(before, last, REFINED + 2)[1:-1])
    finer = _first_place([*map(at, between)], tries)
    return last if finer is None else between[finer]


def _first_place(trials: Sequence[Trial], tries: Tries) -> int | None:
    """Return the place of the first trial that turns back, None if there is none."""
    turning = np.flatnonzero(tries(trials, False)["turns"])
    return int(turning[0]) if len(turning) else None


def _rounded(values: Floats) -> list[float]:
    """Return values of three digits, as they are told."""
    return [float(f"{value:.3g}") for value in values.tolist()]


def _material_of(body: Rattleback, lever: float) -> str | None:
    """Return which materials of stone and plane have at most a lever in um, in words.

    Of those, the pair with the longest one, of the friction of a usual table.
    """
    if body.units is None or not math.isfinite(body.units.mass):
        return None
    levers = {}
    for (stone, first), (plane, second) in product(MATERIALS.items(), repeat=2):
        patch = patch_under(body, (first, second), PATCH_FRICTION, 1.0)
        levers[f"{stone} on {plane}"] = patch.lever / MICRO
    possible = {pair: size for pair, size in levers.items() if size <= lever}
    if not possible:
        return None
    pair = max(possible, key=possible.__getitem__)
    return f"{pair} has {possible[pair]:.2g} um"


def changes(
    failing: Mapping[str, Sequence[float]],
    body: Rattleback,
    losses: Mapping[str, float],
    most: float,
    tries: Tries,
) -> Iterator[Change]:
    """Yield what makes launches turn back, by direction.

    `failing` has signed spins of launches that do not, of which the middle one is
    changed; it may be empty.
    """
    for direction, spins in failing.items():
        trial = Trial(body, losses, SIGN_OF_DIRECTION[direction] * most)
        found = [smallest_spin(trial, tries)]
        if len(spins):
            launch = replace(trial, n_i_rpm=sorted(spins, key=abs)[len(spins) // 2])
            searches = (larger_skew, shorter_lever, two_weights)
            found += [search(launch, tries) for search in searches]
        yield from (each for each in found if each is not None)
