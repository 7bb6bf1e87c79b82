"""The best fit to an angle or a spin over time, from the first frames on.

A run that is wrong by half a period of the oscillation is in another valley of the sum
of squares.  So parameters are fitted to the beginning of the film first, which few
periods long has few valleys, and then to longer and longer parts, as long as the
residuals look like the noise from frame to frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from rattlesweep.analysis.fit import doubts
from rattlesweep.analysis.fit.estimate import Searched, minimise
from rattlesweep.analysis.fit.problem import FitProblem
from rattlesweep.analysis.fit.starts import tethers
from rattlesweep.arrays import Floats

_FIRST = 0.15  # share of the film that is fitted first
# A part grows by this factor, by less where its fit fails, and by this at least.
_GROWTH = 2.0
_LEAST_GROWTH = 1.08
ROWS_AN_UNKNOWN = 5  # at least, of a part
_FIRST_STEPS = 12  # of a search over a part
FILM_STEPS = 60  # of a search over the whole film
EXACT = 0.02  # residuals over the noise from row to row of data without noise
# Bodies beside the best one, in units of how far a given one may be off; the steps of a
# first look at each, and the number of those that are looked at closely.
_BESIDE = (-1.8, -1.2, -0.6, 0.6, 1.2, 1.8)
BACK = 0.3  # share of the way beside, within which a search has come back
GLANCE = 7
LOOKED_AT_CLOSELY = 2
PROMISING = 3.0  # sum of squares of these over the least one, at most
CLOSE_STEPS = 15
MOST_MOVES = 2
SAME = 1e-4  # difference of two minima of one valley, as a share
# First values that are tried, by their residuals in the first part.
STARTS = 6


def searches_of_series(problem: FitProblem, starts: list[Floats]) -> Iterator[Searched]:
    """Yield searches over the whole film, until one leaves residuals like noise."""
    part = _part(problem, _first_share(problem))
    squares = [float((rows**2).sum()) for rows in part.residuals_at(starts)]
    order = np.argsort(squares, kind="stable")[:STARTS]
    for place in order.tolist():
        if not math.isfinite(squares[place]):
            continue
        for x in _beginnings(problem, starts[place]):
            if not problem.succeeds(x):
                continue
            search = minimise(problem, x, 1e-8, FILM_STEPS, again=2)
            yield search
            if looks_like_noise(problem, search):
                yield from _neighbours(problem, search, starts[place])
                return


def _neighbours(
    problem: FitProblem, best: Searched, given: Floats
) -> Iterator[Searched]:
    """Yield lower and lower searches from bodies that differ from the best one.

    One of them is the body at `given`, where the first search began.

    The oscillation of another body may be ahead by a period at the end of the film,
    with residuals that look like noise as well.
    """
    for _ in range(MOST_MOVES):
        values = problem.values(best.x)
        off = tethers(problem, best.x)
        bodies = [{name: problem.values(given)[name] for name in off}]
        for name, tether in off.items():
            bodies += [{name: values[name] + way * tether.error} for way in _BESIDE]
        searches = []
        starts = []
        if off:
            changed = [problem.scaled({**values, **body}) for body in bodies]
            starts = [np.clip(start, *problem.limits()) for start in changed]
        for start in problem.look_ahead(starts):
            search = minimise(problem, start, 1e-3, GLANCE)
            moved = np.abs(start - best.x).argmax()
            way = abs(search.x[moved] - best.x[moved])
            # Most searches come back to the best one.
            if way > BACK * abs(start[moved] - best.x[moved]):
                searches.append(search)
        searches.sort(key=lambda search: search.squares)
        found = [
            minimise(problem, search.x, 1e-5, CLOSE_STEPS)
            for search in searches[:LOOKED_AT_CLOSELY]
            if search.squares < PROMISING * best.squares
        ]
        yield from found
        lowest = min(found, key=lambda search: search.squares, default=best)
        # The same valley has the same minimum.
        if not lowest.squares < (1 - SAME) * best.squares:
            return
        best = lowest


def _beginnings(problem: FitProblem, start: Floats) -> Iterator[Floats]:
    """Yield where searches over the whole film begin, from one start."""
    yield _continued(problem, start)
    # First values that are good are best left alone.
    yield start


def _continued(problem: FitProblem, start: Floats) -> Floats:
    """Return the parameters fitted to longer and longer parts, from a start on."""
    x = start
    share = _first_share(problem)
    done = 0.0
    growth = _GROWTH
    while share < 1.0:
        part = _part(problem, share)
        if not part.succeeds(x):
            return x
        part = replace(part, priors={**part.priors, **tethers(problem, start)})
        search = minimise(part, x, 1e-3, _FIRST_STEPS)
        # After a first part that fails, the next one may tell more, and is fitted from
        # there.
        if is_close(part, search) or done == 0.0:
            x = search.x
            done = share
        else:
            growth = math.sqrt(growth)
            if growth < _LEAST_GROWTH:
                return search.x
        share = done * growth
    return x


def _first_share(problem: FitProblem) -> float:
    """Return the share of the film that is fitted first, which has enough rows."""
    share = _FIRST
    while share < 1.0:
        if problem.until(share).rows >= ROWS_AN_UNKNOWN * problem.unknowns:
            return share
        share *= _GROWTH
    return 1.0


def _part(problem: FitProblem, share: float) -> FitProblem:
    """Return the problem of a part, with the noise that a tether is weighed by."""
    part = problem.until(share)
    if part.film.error is None:
        part = replace(part, noise=problem.film.rough_noise)
    return part


def noise_ratio(problem: FitProblem, search: Searched) -> float:
    """Return the residuals over the noise from frame to frame, or over the errors."""
    film = problem.film
    rows = search.residuals[: problem.rows]
    if film.error is None:
        rows = rows * problem.errors
    size = math.sqrt(float((rows**2).sum()) / max(problem.freedom, 1))
    if film.error is not None:
        return size
    noise = film.rough_noise
    if noise == 0:  # nothing has moved in this part of a film
        return 0.0
    return size / noise


def is_close(problem: FitProblem, search: Searched) -> bool:
    """Return whether the residuals of a part are of the size of noise."""
    return noise_ratio(problem, search) < doubts.MUCH_NOISE


def looks_like_noise(problem: FitProblem, search: Searched) -> bool:
    """Return whether the residuals look like noise of the right size."""
    # One standard deviation above its mean, chi squared may have a lower minimum.
    usual = problem.freedom + math.sqrt(2 * problem.freedom)
    if problem.film.error is not None and search.squares > usual:
        return False
    residuals = search.residuals[: problem.rows]
    if noise_ratio(problem, search) < EXACT:
        # What is left of data without noise are rounding errors.
        return True
    return doubts.is_noise(residuals) and is_close(problem, search)
