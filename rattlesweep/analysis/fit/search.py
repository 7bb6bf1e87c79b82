"""Fit parameters of one run to measured data by least squares."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import product
from types import MappingProxyType
from typing import Any

import numpy as np

from rattlesweep.analysis.fit import doubts
from rattlesweep.analysis.fit.estimate import Estimate, Search, minimise, settle_noise
from rattlesweep.analysis.fit.film import Film
from rattlesweep.analysis.fit.measured import MeasuredBody, Prior
from rattlesweep.analysis.fit.problem import PARAMETERS, SIZES, Problem
from rattlesweep.analysis.fit.result import Fit
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.physics.theory import modes
from rattlesweep.quantities import DAMPING, LOSSES
from rattlesweep.sweeps.config import not_one_of
from rattlesweep.sweeps.launches import Launch
from rattlesweep.text import counted

# Fractions of the data, from their beginning, that are fitted before the whole; the
# fine ones are tried if the coarse ones end in a wrong minimum.
COARSE = (0.15, 0.3, 0.6, 0.8)
FINE = tuple(np.arange(0.1, 1.0, 0.05))
MOST_STEPS = 60  # of a search over the whole data
FIRST_STEPS = 10  # of one over their beginning
# First values from which searches begin, in the order of their residuals.
SERIES_STARTS = 2
REVERSAL_STARTS = 6
# Times of reversals are fitted to a run that is longer than the last of them.
LONGER = 1.5


def check_free(
    launch: Launch, free: Iterable[str], stone: MeasuredBody | None = None
) -> list[str]:
    """Return the names of free parameters; raise a ConfigError if they do not fit."""
    names = list(dict.fromkeys(free))
    if not names:
        raise ConfigError(
            f"free: no parameter is given; choose from {', '.join(PARAMETERS)}"
        )
    for name in names:
        if name not in PARAMETERS:
            raise ConfigError(f"free: {not_one_of(name, PARAMETERS)}")
        if name in SIZES:
            if stone is None or not stone.keys:
                raise ConfigError(
                    f"free: {name} needs a body given by a mapping, such as "
                    "{shape: half_ellipsoid, length: 12 cm, ...}"
                )
            stone.size(name)
    if {"skew", "xi"} <= {*names}:
        raise ConfigError("free: skew is -xi; keep one of them")
    if "c" in names and launch.body.c is None:
        raise ConfigError("free: only an ellipsoid has c, and the body is a paraboloid")
    if launch.omega is not None and {"n_i", "omega_xy0", "psi_deg"} & {*names}:
        raise ConfigError("free: a full state has no n_i, omega_xy0 and psi_deg")
    return names


def fit_run(
    launch: Launch,
    film: Film,
    free: list[str],
    report: Callable[[float], None] = lambda fraction: None,
    stone: MeasuredBody | None = None,
    priors: Mapping[str, Prior] = MappingProxyType({}),
) -> Fit:
    """Fit parameters to the beginning of the data first, and then to all of them.

    `report` is called with the fraction of the work that is done, at most.  `stone` is
    the body of the launch if it can be remade, and `priors` are those of all parameters
    that have one, in the units of this body.
    """
    units = launch.body.units
    t_end = float(film.t[-1])
    if film.kind == "reversal":
        t_end *= LONGER
    launch = replace(launch, t_end=t_end)
    progress = Progress(report, len(free))
    # The number of values is checked before any of them is used.
    problem = Problem(
        launch, film, dict.fromkeys(free, 1.0), progress.trial, stone, priors
    )
    if problem.freedom < int(film.error is None):
        values = counted(int(film.known.sum()), "value")
        raise ConfigError(
            f"{values} cannot determine {counted(len(free), 'parameter')} and the "
            "noise; give more rows or free fewer parameters"
        )
    doubts.check_film(film, launch.n_i, units)
    if priors and film.error is None:
        problem = replace(problem, noise=film.rough_noise)
    first_values = _first_values(problem)
    scales = {name: max(map(abs, values)) for name, values in first_values.items()}
    problem = replace(problem, scales=scales)
    starts = [
        problem.scaled(dict(zip(first_values, combination, strict=True)))
        for combination in product(*first_values.values())
    ]
    if film.kind == "reversal":
        doubts.check_first_reversal(problem, starts[len(starts) // 2])
    best = _best_search(problem, starts, progress)
    estimate = settle_noise(problem, best, MOST_STEPS)
    return _result(estimate, doubts.doubts_of_data(film, units))


class Progress:
    """Fraction of the searches that are done, if all that are planned are needed."""

    def __init__(self, report: Callable[[float], None], free: int) -> None:
        self._report = report
        # Trial runs of a step: the residuals, and the slope of each parameter.
        self._trials_a_step = 1 + 2 * free
        self._stage = 0
        self._stages = 1
        self._trials = 0
        self._most_trials = math.inf  # before the first search

    def plan(self, stages: int) -> None:
        """Set the number of searches."""
        self._stages = stages

    def begin(self, stage: int, steps: int) -> None:
        """Begin a search of at most so many steps."""
        self._stage = stage
        self._trials = 0
        self._most_trials = steps * self._trials_a_step

    def trial(self) -> None:
        """Count a trial run."""
        self._trials += 1
        of_search = min(1.0, self._trials / self._most_trials)
        self._report(min(1.0, (self._stage + of_search) / self._stages))


def _best_search(problem: Problem, starts: list[Floats], progress: Progress) -> Search:
    """Return the best of searches from several starts; raise if no run can be made."""
    film = problem.film
    series = film.kind != "reversal"
    if series:
        first_part = problem.until(COARSE[0])
        # First values that are good are best left alone.
        ladders: tuple[tuple[float, ...], ...] = (COARSE, FINE, ())
        most_starts = SERIES_STARTS
    else:
        first_part = problem
        ladders = ((),)
        most_starts = REVERSAL_STARTS
    starts = sorted(starts, key=lambda x: float((first_part.residuals(x) ** 2).sum()))
    stages_a_start = sum(len(shares) + 1 for shares in ladders)
    progress.plan(stages_a_start * min(most_starts, len(starts)))
    unmeasured = []
    if problem.priors:
        names = enumerate(problem.scales)
        unmeasured = [place for place, name in names if name not in problem.priors]
    searches: list[Search] = []
    stage = 0
    for number, (start, shares) in enumerate(product(starts, ladders)):
        # Starts whose runs fail are replaced by the next ones.
        if number >= most_starts * len(ladders) and searches:
            break
        x = start
        for share in shares:
            progress.begin(stage, FIRST_STEPS)
            stage += 1
            beginning = problem.until(share)
            if beginning.freedom > 10 * len(x) and beginning.succeeds(x):
                x = minimise(beginning, x, 1e-3, FIRST_STEPS).x
        progress.begin(stage, MOST_STEPS)
        stage += 1
        if not problem.succeeds(x):
            continue
        if unmeasured and not shares:
            # Measured values are nearly right, so the others are fitted to them first.
            x = minimise(problem, x, 1e-3, FIRST_STEPS, unmeasured).x
        search = minimise(problem, x, 1e-8, MOST_STEPS)
        searches.append(search)
        if series and _is_noise(problem, search):
            break
    if not searches:
        problem.expected(starts[0])  # tells what is wrong with body or launch
    return min(searches, key=lambda search: search.squares)


def _is_noise(problem: Problem, search: Search) -> bool:
    """Return whether the residuals of a series look like noise of the right size."""
    # One standard deviation above its mean, chi squared may have a lower minimum.
    usual = problem.freedom + math.sqrt(2 * problem.freedom)
    if problem.film.error is not None and search.squares > usual:
        return False
    residuals = search.residuals[: problem.rows]
    return doubts.correlation(residuals) < doubts.noise_limit(problem.film)


def _result(estimate: Estimate, remarks: list[str]) -> Fit:
    """Return the fit of an estimate, with intervals and remarks."""
    problem = estimate.problem
    best = estimate.search
    film = problem.film
    names = list(problem.scales)
    half_width = estimate.standard_errors * estimate.quantiles
    limits = problem.limits()
    low = estimate.values(np.clip(best.x - half_width, *limits))
    high = estimate.values(np.clip(best.x + half_width, *limits))
    residuals = best.residuals[: problem.rows]
    remarks = [
        *remarks,
        *doubts.doubts_of_residuals(film, residuals, estimate.noise),
        *doubts.doubts_of_parameters(problem, best.x, half_width, estimate.jacobian),
        *doubts.doubts_of_priors(problem, best.residuals[problem.rows :]),
    ]
    if film.error is not None:
        remarks += doubts.doubts_of_errors(best.squares, problem.freedom)
    if not best.settled:
        remarks.append(
            f"the search did not settle within {MOST_STEPS} steps; give a better launch"
        )
    final = problem.launched(best.x)
    launch: dict[str, Any] = {}
    for name in ("n_i", "omega_xy0", "psi", "omega", "u"):
        value = getattr(final, name)
        if value is not None:
            launch[name] = value
    for name, loss in LOSSES.items():
        value = final.losses.get(name, loss.default)
        if value is not None:
            launch[name] = value
    unit = film.value_column.unit
    return Fit(
        values=estimate.values(best.x),
        intervals={name: (low[name], high[name]) for name in names},
        body=final.body,
        launch=launch,
        noise=estimate.noise / unit.size,
        noise_unit=unit.name,
        rows=problem.rows,
        remarks=remarks,
        _estimate=estimate,
        _expected=problem.expected(best.x),
    )


def _first_values(problem: Problem) -> dict[str, list[float]]:
    """Return values of each free parameter from which the search may begin."""
    launch = problem.launch
    film = problem.film
    body = launch.body
    spin = launch.n_i or 0.1
    if film.kind != "reversal":
        spin = film.first_spin
    decay = body.gamma / float(film.t[-1])
    oscillations = modes(body.alpha, body.beta, body.theta, body.phi, body.xi)
    psi = oscillations.psi_p
    if launch.psi == "roll":
        psi = oscillations.psi_r
    psi_deg = math.degrees(psi)
    if isinstance(launch.psi, float):
        psi_deg = launch.psi
    guesses = {
        "n_i": [spin],
        "omega_xy0": [share * abs(spin) for share in (0.01, 0.03, 0.1, 0.3)],
        "psi_deg": [psi_deg],
        "skew": [-body.xi],
    }
    for name, loss in LOSSES.items():
        size = decay if loss.unit == DAMPING else 1.0
        guesses[name] = [size * value for value in loss.first_values]
    first_values = {}
    for name in problem.scales:
        value = launch.losses.get(name) or getattr(launch, name, None)
        value = value or getattr(body, name, None)
        if name in problem.priors:
            # A quantity that was measured as zero is not larger than its error.
            value = problem.priors[name].value or problem.priors[name].error
        elif name in SIZES and problem.stone is not None:
            value = problem.stone.size(name)
        if value:
            first_values[name] = [value]
        else:
            first_values[name] = guesses[name]
    return first_values
