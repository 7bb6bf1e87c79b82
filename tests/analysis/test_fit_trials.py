"""Trial runs of fits: side by side, and none of them twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import rattlesweep as rs
from rattlesweep.analysis.fit import trials
from rattlesweep.analysis.fit.film import read_film
from rattlesweep.analysis.fit.problem import FitProblem
from rattlesweep.analysis.fit.synthetic import synthetic_film
from rattlesweep.analysis.fit.trials import Trials
from rattlesweep.api.single import launch_of

BODY = rs.Rattleback.half_ellipsoid(
    length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg"
)
FREE = ["n_i", "omega_xy0", "sigma", "skew", "theta"]


@pytest.fixture
def film():
    """A short film of a stone."""
    run = launch_of(BODY, n_i="100 rpm", omega_xy0="10 rpm", sigma="5e-7 N m s")
    return synthetic_film(run, "0.7 s", 60, "0.5 deg")


@pytest.fixture
def asked(monkeypatch):
    """The launches and numbers of times of each call for runs."""
    calls = []
    follow = Trials.follow

    def noted(self, launches, kind, times):
        calls.append(list(zip(launches, map(len, times), strict=True)))
        return follow(self, launches, kind, times)

    monkeypatch.setattr(Trials, "follow", noted)
    return calls


def problem_of(film):
    """Return the problem of a film, and where its parameters begin."""
    measured = read_film(film, BODY.units)
    launch = launch_of(BODY, n_i="99 rpm", omega_xy0="9 rpm", sigma="4e-7 N m s")
    launch = replace(launch, t_end=float(measured.t[-1]))
    values = {
        "n_i": launch.n_i,
        "omega_xy0": launch.omega_xy0,
        "sigma": launch.losses["sigma"],
        "skew": -BODY.xi,
        "theta": BODY.theta,
    }
    problem = FitProblem(launch, measured, {name: values[name] for name in FREE})
    return problem, problem.scaled(values)


def test_slopes_of_runs_side_by_side_are_those_of_single_runs(film, asked):
    problem, x = problem_of(film)
    slopes = problem.slopes(x)
    # Two runs a parameter, all in one call.
    assert [len(call) for call in asked] == [2 * len(FREE)]
    alone = replace(problem, trials=Trials())
    for place, column in enumerate(slopes.T):
        step = np.zeros(len(x))
        step[place] = 3e-6
        high = alone.residuals(x + step)
        low = alone.residuals(x - step)
        width = ((x + step) - (x - step)).sum()
        assert_array_equal(column, (high - low) / width)
    assert [len(call) for call in asked[1:]] == [1] * 2 * len(FREE)


def test_first_runs_of_searches_are_known_to_them(film, asked):
    problem, x = problem_of(film)
    far = x.copy()
    far[FREE.index("theta")] = 3.0
    # No body has such a curvature.
    starts = problem.look_ahead([x, far])
    assert [start.tolist() for start in starts] == [x.tolist()]
    assert [len(call) for call in asked] == [1, len(FREE)]
    here = problem.residuals(x)
    slopes = problem.rough_slopes(x, here, range(len(x)))
    assert sum(map(len, asked)) == 1 + len(FREE)
    assert_allclose(slopes, problem.slopes(x), rtol=1e-3, atol=1e-2 * abs(slopes).max())


def test_a_fit_makes_no_run_twice_and_hardly_any_alone(film, asked, monkeypatch):
    alone = []
    follower = trials._follower

    def noted(config, batch, has_attitude):
        alone.append(batch)
        return follower(config, batch, has_attitude)

    monkeypatch.setattr(trials, "_follower", noted)
    fit = rs.fit(BODY, film, free=["n_i", "omega_xy0", "sigma"])
    fit.profile("sigma")
    assert fit.intervals["sigma"][0] < fit.values["sigma"] < fit.intervals["sigma"][1]
    runs = [repr(run) for call in asked for run in call]
    assert len(runs) == len(set(runs))
    # A push that is far too large throws the stone over.
    assert len(alone) < len(runs) / 20
    assert sum(len(call) for call in asked if len(call) > 1) > len(runs) / 3
