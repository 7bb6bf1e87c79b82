"""Whether the bodies of a target can be found in the ranges, and how long that takes."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.physics import theory
from rattlesweep.sweeps.config.load import SdRanges, SdSource, Target
from rattlesweep.sweeps.sense.sample import POOL, body_of, coefficient, limits, pool

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# Extremes are looked for by halving a box around each of the best bodies; they come out to
# seven digits, and a target is refused only if it lies beyond them by this.
SEEDS, TRIES, ROUNDS = 16, 64, 24
MARGIN = 0.01
# Bodies by which the density near a target is judged.
ENOUGH = 32
# The sampler draws some 1e7 bodies a second and thread.
TOO_MANY, MANY = 1e10, 1e11


def target_problems(source: SdSource) -> Iterator[tuple[str, bool]]:
    """Sentences about targets: those out of reach (True) and those that will take long (False)."""
    target = source.target
    if target is None:
        return
    points = pool(source.ranges)
    found = coefficient(points, target.name)
    low, high = extremes(source.ranges, target.name, points)
    for value in target.values:
        margin = (1 - MARGIN) * (1 - target.rel_tol), (1 + MARGIN) * (1 + target.rel_tol)
        if not low / margin[1] <= value <= high / margin[0]:
            yield (
                f"{value:g} is out of reach: of {POOL} bodies drawn from the ranges, the best "
                f"refined, {target.name} lies between {low:.4g} and {high:.4g}; give a target "
                "in between or other ranges",
                True,
            )
            continue
        yield from _patience(source, target, value, found)


def _patience(
    source: SdSource, target: Target, value: float, found: Floats
) -> Iterator[tuple[str, bool]]:
    chance, most = _chance(found, value, target.rel_tol)
    draws = 1 / chance if chance else np.inf
    words = (
        f"{value:g} takes {'at least' if most else 'about'} {draws:.1e} draws a body, by {POOL} "
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


def extremes(ranges: SdRanges, name: str, points: Floats) -> tuple[float, float]:
    """Smallest and largest coefficient `name` of bodies in the ranges.

    Parameters
    ----------
    ranges, name
        Where, and K_p or K_r.
    points : ndarray, shape (5, n)
        Bodies drawn from the ranges, to start from.

    Notes
    -----
    Found by search, not bounded, except where the modes may cross (``H_11 = H_22``): there a small
    skew angle makes a ridge that no search is sure to find, and the upper end is the bound
    ``(alpha - beta) / (2 sqrt(alpha beta)) omega^2``, from ``split >= 2 abs(H_12)``.
    """
    ends = limits(ranges)
    corners = np.array(list(product(*ends))).T
    start = np.concatenate([points, corners], axis=1)
    # At a skew angle of exactly 0, which is never drawn, K is 0.
    low = -_climb(start, ends, name, -1.0)
    high = _climb(start, ends, name, 1.0)
    return max(0.0, low), max(high, _ridge(ends, name))


def _climb(points: Floats, ends: Floats, name: str, sign: float) -> float:
    rng = np.random.default_rng(0)
    low, high = ends.T[:, :, None]
    best = points
    for step in range(ROUNDS):
        values = sign * coefficient(best, name)
        values = np.where(np.isnan(values), -np.inf, values)
        best = best[:, np.argsort(values)[-SEEDS:]]
        shifts = (rng.random((5, SEEDS, TRIES)) - 0.5) * ((high - low) * 0.5**step)[:, :, None]
        near = np.clip((best[:, :, None] + shifts).reshape(5, -1), low, high)
        best = np.concatenate([best, near], axis=1)
    return float(np.nanmax(sign * coefficient(best, name)))


def _ridge(ends: Floats, name: str) -> float:
    """Upper bound of the coefficient if the modes may cross in the ranges, else 0."""
    b = body_of(np.array(list(product(*ends))).T)
    # Times alpha beta, H_11 - H_22 is linear in each of gamma, f_sd, the bottom's two curvature
    # terms and sin^2 xi, so its sign in the corners is its sign everywhere.
    h11, _, h22 = theory.hessian(b.alpha, b.beta, b.theta, b.phi, b.xi)
    if np.all(h11 > h22) or np.all(h11 < h22):
        return 0.0
    # The squares fall with alpha, beta, theta and phi and are monotonic in sin^2 xi.
    spread = (b.alpha.min(), b.beta.min(), ends[2, 0], ends[3, 0], -np.radians(ends[4]))
    with np.errstate(all="ignore"):
        squares = theory.torque_coefficients(*spread)
    ratio = np.sqrt(np.max(b.alpha / b.beta))
    return float((ratio - 1 / ratio) / 2 * np.nanmax(squares[0 if name == "K_p" else 1]))
