"""Fit parameters of one run to measured data by least squares."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import count, product
from types import MappingProxyType
from typing import Any

import numpy as np

from rattlesweep.analysis.fit import doubts
from rattlesweep.analysis.fit.estimate import (
    LEAST_NOISE,
    Estimate,
    Searched,
    minimise,
    polish,
    rises_of,
    rivals_of,
    settle_noise,
)
from rattlesweep.analysis.fit.film import Film
from rattlesweep.analysis.fit.measured import MeasuredBody, Prior, of_body
from rattlesweep.analysis.fit.problem import FITTABLE, SIZES, FitProblem
from rattlesweep.analysis.fit.profile import ends_by_profile, ranges_along
from rattlesweep.analysis.fit.result import Fit, in_words, unit_for_people
from rattlesweep.analysis.fit.scan import searches_of_times
from rattlesweep.analysis.fit.series import FILM_STEPS, searches_of_series
from rattlesweep.analysis.fit.starts import first_values, given, scales_of, spans
from rattlesweep.arrays import Floats
from rattlesweep.design.launch import Launch
from rattlesweep.physics.si import Units
from rattlesweep.system.console import counted
from rattlesweep.words.errors import ConfigError, not_one_of
from rattlesweep.words.quantities import ACTING, DRIVES, LOSSES

# Times of reversals are fitted to a run that is longer than the last of them.
_LONGER = 1.5
# Searches that go on where the end of an interval is lower, as a share of its rise.
MOST_DESCENTS = 3
LOWER = -0.02
BENT = 2.5  # factor by which chi squared rises more or less than a parabola
# Standard errors by which the other parameters of a flat valley change along it.
FLAT_VALLEY = 3.0
# Half widths of intervals beyond which a valley along a flat direction is another one.
FAR_VALLEY = 10.0
# A push that the data hardly tell, as a share of the spin, and its standard error: most
# hands push less than a fifth of the spin.
USUAL_PUSH = Prior(0.1, 0.05)


def check_free(
    launch: Launch, free: Iterable[str], stone: MeasuredBody | None = None
) -> list[str]:
    """Return the names of free parameters; raise a ConfigError if they do not fit."""
    names = list(free)
    if not names:
        raise ConfigError(
            f"free: no parameter is given; choose from {', '.join(FITTABLE)}"
        )
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"free: {name} is listed twice; keep one")
        if name not in FITTABLE:
            raise ConfigError(f"free: {not_one_of(name, FITTABLE)}")
        if name in SIZES:
            if stone is None or not stone.keys:
                raise ConfigError(
                    f"free: {name} needs a body given by a mapping, such as "
                    "{shape: half_ellipsoid, length: 12 cm, ...}"
                )
            stone.size(name)
        if name in DRIVES and not launch.losses.get("base_acceleration"):
            raise ConfigError(f"free: {name} is of a plane that shakes; give base")
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
    report: Callable[[int], None] = lambda runs: None,
    stone: MeasuredBody | None = None,
    priors: Mapping[str, Prior] = MappingProxyType({}),
    robust: bool = False,
) -> Fit:
    """Fit parameters to the beginning of the data first, and then to all of them.

    `report` is called with the number of runs that have been tried.  `stone` is the
    body of the launch if it can be remade, and `priors` are those of all parameters
    that have one, in the units of this body.  A `robust` fit leaves out rows that are
    far off all others.
    """
    units = launch.body.units
    t_end = float(film.t[-1])
    if film.kind == "reversal":
        t_end *= _LONGER
    launch = replace(launch, t_end=t_end)
    trials = count(1)
    # The number of values is checked before any of them is used.
    problem = FitProblem(
        launch,
        film,
        dict.fromkeys(free, 1.0),
        lambda: report(next(trials)),
        stone,
        priors,
    )
    if problem.freedom < int(film.error is None):
        values = counted(int(film.known.sum()), "value")
        raise ConfigError(
            f"{values} cannot determine {counted(len(free), 'parameter')} and the "
            "noise; give more rows or free fewer parameters"
        )
    for name, value in (("n_i", launch.n_i), ("omega_xy0", launch.omega_xy0)):
        if value is None and launch.omega is None and name not in free:
            raise ConfigError(
                f"launch: {name} is missing; give its value, or list it under free"
            )
    doubts.check_film(film, launch.n_i, units)
    if priors and film.error is None:
        problem = replace(problem, noise=film.rough_noise)
    firsts = first_values(problem)
    problem = replace(problem, scales=scales_of(problem, firsts))
    best, searches = _best_search(problem, firsts)
    left_out: list[str] = []
    if robust:
        kept, left_out = _without_outliers(problem, best)
        if left_out:
            problem = kept
            film = problem.film
            best, searches = _best_search(problem, firsts)
    estimate = settle_noise(problem, best, FILM_STEPS)
    rises, ends = rises_of(estimate)
    for _ in range(MOST_DESCENTS):
        lowest = int(np.argmin(rises))
        if not rises[lowest] < LOWER:
            break
        # The valley goes on beyond the interval, or another one is lower.
        again = minimise(problem, ends[lowest], 1e-8, FILM_STEPS, again=2)
        if not again.squares < best.squares:
            break
        best = polish(problem, again)
        estimate = settle_noise(problem, best, FILM_STEPS)
        rises, ends = rises_of(estimate)
    other = _of_another_push(estimate)
    if other is not None:
        estimate = settle_noise(estimate.problem, other, FILM_STEPS)
        rises, ends = rises_of(estimate)
    residuals = estimate.search.residuals[: problem.rows]
    off = residuals * estimate.problem.errors
    places = doubts.outliers_of(film, off)
    remarks = [
        *doubts.doubts_of_data(film, units, launch.n_i),
        *left_out,
        *doubts.doubts_of_outliers(film, off[places], places, are_left_out=False),
    ]
    # A fit that is pulled by single rows says nothing more of the others, and one that
    # does not follow the data nothing of the parameters.
    if len(places):
        return _result(estimate, remarks)
    misfits = doubts.doubts_of_residuals(film, residuals, estimate.noise)
    if misfits and estimate.noise > film.rough_noise:
        return _result(estimate, [*remarks, *misfits], follows=False)
    # Where no valley has been found, none is compared with others.
    remarks += misfits or _doubts_of_valley(estimate, searches, rises)
    return _result(estimate, remarks)


def _of_another_push(estimate: Estimate) -> Searched | None:
    """Return a better search from a push of usual size, if the data hardly tell it.

    A search may go on to smaller and smaller pushes, where chi squared is flat.
    """
    problem = estimate.problem
    push = advised_push(estimate)
    if "omega_xy0" not in problem.scales or push is None:
        return None
    place = list(problem.scales).index("omega_xy0")
    if estimate.half_widths[place] <= doubts.VAGUE:
        return None
    x = estimate.x.copy()
    x[place] = math.log(push.value)
    search = minimise(problem, x, 1e-8, FILM_STEPS, again=2)
    if not search.squares < estimate.search.squares:
        return None
    return polish(problem, search)


def planned_fit(
    launch: Launch,
    film: Film,
    free: list[str],
    stone: MeasuredBody | None,
    priors: Mapping[str, Prior],
) -> Fit:
    """Return the fit of a film that the given values have made, without a search.

    Its intervals are those to expect of films with such errors.
    """
    launch = replace(launch, t_end=float(film.t[-1]))
    problem = FitProblem(
        launch, film, dict.fromkeys(free, 1.0), stone=stone, priors=priors
    )
    values: dict[str, float] = {}
    for name in free:
        value = given(problem, name)
        if value is None:
            raise ConfigError(f"free: a plan needs a value of {name} other than zero")
        values[name] = value
    problem = replace(problem, scales={name: abs(values[name]) for name in free})
    x = problem.scaled(values)
    search = Searched(x, problem.residuals(x), problem.slopes(x), settled=True)
    estimate = Estimate.of(problem, search)
    return _result(estimate, [], is_planned=True)


def _without_outliers(
    problem: FitProblem, best: Searched
) -> tuple[FitProblem, list[str]]:
    """Return the problem without rows that are far off, and the remark on them.

    They are far off the run that most rows are near, since it is found by a loss that
    grows with the size of large residuals only.
    """
    film = problem.film
    softened = 1.0
    if film.error is None:
        softened = film.rough_noise / problem.noise
    search = minimise(problem, best.x, 1e-8, FILM_STEPS, softened=softened)
    off = search.residuals[: problem.rows] * problem.errors
    places = doubts.outliers_of(film, off)
    remarks = doubts.doubts_of_outliers(film, off[places], places, are_left_out=True)
    value = film.value.copy()
    value[np.flatnonzero(film.known)[places]] = np.nan
    return replace(problem, film=replace(film, value=value)), remarks


def _doubts_of_valley(
    estimate: Estimate, searches: list[Searched], rises: Floats
) -> list[str]:
    """Return remarks on other valleys, and on one that is no parabola."""
    remarks = []
    problem = estimate.problem
    names = list(problem.scales)
    alike, vague = doubts.untold(
        problem, estimate.x, estimate.half_widths, estimate.jacobian
    )
    # Along these, chi squared is flat, of which another remark tells; it does not tell
    # of valleys far beyond their intervals.
    flat = np.array([name in (*alike, *vague) for name in names])
    near = np.where(
        flat,
        FAR_VALLEY * estimate.half_widths,
        FLAT_VALLEY * estimate.standard_errors,
    )
    rivals = [
        rival
        for rival in rivals_of(estimate, searches)
        if (np.abs(rival.x - estimate.x) > near).any()
    ]
    if rivals:
        rival = rivals[0]
        values = estimate.values(rival.x)
        listed = ", ".join(
            in_words(name, value, estimate.units) for name, value in values.items()
        )
        remarks.append(
            f"the sum of squares is nearly as small at {listed}: this may be a worse "
            "valley than the true one; give more data, or what is known otherwise with "
            "its error"
        )
    elif problem.film.kind == "reversal":
        remarks += doubts.doubts_of_exact_times(problem.film, estimate.noise)
    noise_counts = estimate.noise > LEAST_NOISE * problem.film.size
    bent = (rises < 1 / BENT) | (rises > BENT)
    curved = [
        name
        for j, name in enumerate(names)
        if bent[2 * j : 2 * j + 2].any() and not flat[j]
    ]
    if curved and noise_counts:
        remarks.append(
            f"chi squared is no parabola along {' and '.join(curved)}, so the "
            f"intervals are rough: see the profile (--profile {curved[0]})"
        )
    return remarks


def _best_search(
    problem: FitProblem, firsts: dict[str, list[float]]
) -> tuple[Searched, list[Searched]]:
    """Return the best of searches, and all of them; raise if no run can be made."""
    starts = [
        problem.scaled(dict(zip(firsts, combination, strict=True)))
        for combination in product(*firsts.values())
    ]
    if problem.film.kind == "reversal":
        doubts.check_first_reversal(problem, starts[len(starts) // 2])
        searches = searches_of_times(problem, spans(problem, firsts))
    else:
        searches = [*searches_of_series(problem, starts)]
    if not searches:
        problem.expected(starts[0])  # tells what is wrong with body or launch
    best = min(searches, key=lambda search: search.squares)
    return polish(problem, best), searches


def _result(
    estimate: Estimate,
    remarks: list[str],
    is_planned: bool = False,
    follows: bool = True,
) -> Fit:
    """Return the fit of an estimate, with intervals and remarks.

    Of a run that does not follow the data, the parameters are not remarked on.
    """
    problem = estimate.problem
    best = estimate.search
    film = problem.film
    names = list(problem.scales)
    half_width = estimate.half_widths
    limits = problem.limits()
    low = estimate.values(np.clip(best.x - half_width, *limits))
    high = estimate.values(np.clip(best.x + half_width, *limits))
    alike, vague = doubts.untold(problem, best.x, half_width, estimate.jacobian)
    push = None
    if follows and not is_planned:
        is_cut = (best.x - half_width < limits[0]) | (best.x + half_width > limits[1])
        is_given = np.array([name in problem.priors for name in names])
        # A parabola that a limit cuts off tells little of the other end either.
        by_profile = {names[i] for i in np.flatnonzero(is_cut & ~is_given)}
        if "omega_xy0" in (*alike, *vague):
            # Its logarithm is fitted, and a parabola of it ends anywhere.
            by_profile.add("omega_xy0")
            push = advised_push(estimate)
        for name in sorted(by_profile):
            ends = ends_by_profile(estimate, names.index(name))
            low[name], high[name] = (estimate.values(end)[name] for end in ends)
        if "omega_xy0" in by_profile:
            # Other values go with other pushes, and the parabola at one does not know.
            ends = ranges_along(estimate, names.index("omega_xy0"))
            lows, highs = (estimate.values(np.clip(end, *limits)) for end in ends)
            for name in names:
                if name != "omega_xy0":
                    low[name] = min(low[name], lows[name])
                    high[name] = max(high[name], highs[name])
        spin = abs(estimate.values(best.x).get("n_i", problem.launch.n_i or math.inf))
        if "omega_xy0" in by_profile and high["omega_xy0"] > spin:
            # Any push fits, which is no interval.
            low["omega_xy0"] = high["omega_xy0"] = math.nan
    advised = None
    if push is not None:
        advised = _with_push(estimate, push)
    if follows:
        remarks = [
            *remarks,
            *doubts.doubts_of_parameters(
                problem,
                best.x,
                half_width,
                estimate.jacobian,
                _push_text(push, estimate.units),
            ),
            *doubts.doubts_of_priors(problem, best.residuals[problem.rows :]),
        ]
    # The residuals of a plan are zero.
    if film.error is not None and follows and not is_planned:
        remarks += doubts.doubts_of_errors(best.squares, problem.freedom)
    if not best.settled and follows:
        remarks.append("the search did not settle; give a better launch")
    final = problem.launched(best.x)
    launch: dict[str, Any] = {}
    for name in ("n_i", "omega_xy0", "psi", "omega", "u"):
        value = getattr(final, name)
        if value is not None:
            launch[name] = of_body(name, value)
    given = {name: loss.default for name, loss in LOSSES.items()} | {**final.losses}
    for name in ACTING:
        value = given.get(name)
        if value is not None:
            launch[name] = of_body(name, value)
    unit = film.value_column.unit
    return Fit(
        values={
            name: of_body(name, value)
            for name, value in estimate.values(best.x).items()
        },
        intervals={
            name: (of_body(name, low[name]), of_body(name, high[name]))
            for name in names
        },
        body=final.body,
        launch=launch,
        noise=estimate.noise / unit.size,
        noise_unit=unit.name,
        rows=problem.rows,
        remarks=remarks,
        advised=advised,
        push=_push_text(push, estimate.units),
        _estimate=estimate,
        _expected=problem.expected(best.x),
    )


def advised_push(estimate: Estimate) -> Prior | None:
    """Return the push that is advised where the data hardly tell it, with its error.

    It is in the units of the problem; None if it is given, or if there is no spin to
    compare with.
    """
    problem = estimate.problem
    spin = abs(problem.values(estimate.x).get("n_i", problem.launch.n_i or 0.0))
    if not spin or "omega_xy0" in problem.priors:
        return None
    return Prior(USUAL_PUSH.value * spin, USUAL_PUSH.error * spin)


def _push_text(push: Prior | None, units: Units | None) -> str | None:
    """Return a push with its error as a stone file has it."""
    if push is None:
        return None
    size, unit = unit_for_people("omega_xy0", units)
    return f"{size * push.value:.2g} +- {size * push.error:.2g} {unit}"


def _with_push(estimate: Estimate, push: Prior) -> Fit:
    """Return the fit that the data give with a push that is known with an error."""
    problem = estimate.problem
    told = replace(problem, priors={**problem.priors, "omega_xy0": push})
    x = estimate.x.copy()
    x[list(problem.scales).index("omega_xy0")] = math.log(push.value)
    search = polish(told, minimise(told, x, 1e-8, FILM_STEPS))
    return _result(settle_noise(told, search, FILM_STEPS), [])
