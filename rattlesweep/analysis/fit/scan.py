"""The best fit to times of reversals, which are a jagged function of the parameters.

The spin swings around zero before it turns, and a small change of a parameter moves a
reversal by a whole swing.  So runs are spread over all values that come into question.
Around those that meet the first reversal best, the first two and so on, more and more
closely spaced ones follow; the best of all begin searches by slopes.
"""

from __future__ import annotations

import numpy as np

from rattlesweep.analysis.fit.estimate import Searched, minimise
from rattlesweep.analysis.fit.problem import FITTABLE, FitProblem
from rattlesweep.analysis.fit.starts import Span
from rattlesweep.arrays import Floats

# Runs of the first round, by the number of unknowns; more for more unknowns.
_RUNS = {1: 1024, 2: 2048}
_MOST_RUNS = 4096
# In the first rounds, runs are kept for each number of reversals met; in the last ones,
# only those that meet all of them best.
FIRST_ROUNDS = 5
_ROUNDS = 9
CLOSER = 0.4  # spacing of a round over that of the round before
_KEPT = 8
_AROUND = (0, 12, 14)  # new runs around each that is kept, by the number of unknowns
MOST_AROUND = 20
# Searches from the best runs, and from the best ones that are far apart, which tell of
# other valleys; the latter are this share of the first spacing apart.
SEARCHES = 8
_APART = 0.16
_MOST_STEPS = 40  # of a search
_SEED = 2017


def searches_of_times(problem: FitProblem, spans: dict[str, Span]) -> list[Searched]:
    """Return searches that begin in the best valleys of the sum of squares.

    There are none if no run succeeds.
    """
    from scipy.stats import qmc

    unknowns = len(spans)
    count = _RUNS.get(unknowns, _MOST_RUNS)
    generator = np.random.default_rng(_SEED)
    shares = qmc.Halton(unknowns, seed=generator).random(count)
    first_spacing = count ** (-1 / unknowns)
    spacing = first_spacing
    pool = np.zeros((0, unknowns))
    squares = np.zeros((0, len(problem.film.t)))
    around = MOST_AROUND
    if unknowns < len(_AROUND):
        around = _AROUND[unknowns]
    for number_of_round in range(_ROUNDS):
        pool = np.concatenate([pool, shares])
        squares = np.concatenate([squares, _squares_of(problem, spans, shares)])
        kept: set[int] = set()
        numbers = range(squares.shape[1])
        if number_of_round > FIRST_ROUNDS:
            numbers = numbers[-1:]
        for number in numbers:
            kept.update(_apart(pool, squares[:, number], spacing, _KEPT))
        centres = np.repeat(pool[sorted(kept)], around, axis=0)
        shares = centres + spacing * generator.uniform(-1, 1, centres.shape)
        spacing *= CLOSER
    searches = []
    best = _apart(pool, squares[:, -1], spacing, SEARCHES)
    others = _apart(pool, squares[:, -1], _APART * first_spacing, SEARCHES)
    for row in dict.fromkeys([*best, *others]):
        x = _placed(problem, spans, pool[row])
        searches.append(minimise(problem, x, 1e-10, _MOST_STEPS))
    return sorted(searches, key=lambda search: search.squares)


def _placed(problem: FitProblem, spans: dict[str, Span], shares: Floats) -> Floats:
    """Return the ``x`` at shares of the spans."""
    values = {}
    for (name, span), share in zip(spans.items(), shares.tolist(), strict=True):
        parameter = FITTABLE[name]
        values[name] = min(max(span.at(share), parameter.low), parameter.high)
    return problem.scaled(values)


def _squares_of(problem: FitProblem, spans: dict[str, Span], shares: Floats) -> Floats:
    """Return the sums of squares of the first residual, the first two and so on."""
    places = [_placed(problem, spans, row) for row in shares]
    residuals = np.array(problem.residuals_at(places)) ** 2
    sums = np.cumsum(residuals[:, : problem.rows], axis=1)
    of_priors = residuals[:, problem.rows :].sum(axis=1)
    return np.asarray(sums + of_priors[:, None])


def _apart(pool: Floats, squares: Floats, spacing: float, most: int) -> list[int]:
    """Return the rows with the least squares that are a spacing apart, best first."""
    chosen: list[int] = []
    for row in np.argsort(squares, kind="stable").tolist():
        if len(chosen) == most or not np.isfinite(squares[row]):
            break
        distances = np.abs(pool[chosen] - pool[row]).max(axis=1)
        if (distances > spacing).all():
            chosen.append(row)
    return chosen
