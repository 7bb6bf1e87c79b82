"""Types: what friction takes from any spin is no wobble."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import rattlesweep as rs
from rattlesweep.config.schema import Classify
from rattlesweep.rows.types import (
    CODE_SW,
    CODE_UNCLASSIFIED,
    classify,
    slowed_by_friction,
    sure_types,
)


@pytest.mark.parametrize(
    ("sigma", "pivot"), [(0.0, 0.002), (0.03, 0.0), (0.03, 0.002), (1e-12, 0.002)]
)
def test_the_loss_is_that_of_an_upright_spin(sigma, pivot):
    n_i, gamma, t_end = -0.3, 12.28, 120.0
    losses = {"sigma": np.array([sigma]), "pivot": np.array([pivot])}
    launch = (np.array([value]) for value in (t_end, n_i, gamma))
    (slowed,) = slowed_by_friction(*launch, losses)
    whole = solve_ivp(
        lambda t, n: -(sigma * n + pivot * np.sign(n)) / gamma,
        (0, t_end),
        [n_i],
        rtol=1e-10,
        atol=1e-13,
    )
    assert slowed == pytest.approx(1 - whole.y[0, -1] / n_i, rel=1e-7)


def test_a_loss_is_at_most_all_of_the_spin_and_a_tap_has_none():
    ones = np.ones(2)
    spins = np.array([0.1, 0.0])
    slowed = slowed_by_friction(1e6 * ones, spins, 12 * ones, {"pivot": 0.01 * ones})
    assert slowed[0] == 1.0
    assert np.isfinite(slowed).all()


def test_a_departure_by_friction_alone_is_no_wobble():
    ok = np.ones(3, bool)
    never = np.full(3, np.nan)
    growth = np.full(3, 5.0)
    departure = np.array([0.34, 0.34, 0.34])
    slowed = np.array([0.338, 0.28, 0.2])
    codes = classify(ok, never, growth, departure, Classify(), None, None, slowed)
    assert list(codes) == [CODE_UNCLASSIFIED, CODE_SW, CODE_SW]
    errors = (np.zeros(3), np.array([0.01, 0.02, 0.01]))
    sure = sure_types(codes, ok, (growth, departure), errors, Classify(), slowed)
    # 0.06 is above the threshold of 0.05 by less than the error.
    assert list(sure) == [True, False, True]
    assert list(classify(ok, never, growth, departure, Classify())) == [CODE_SW] * 3


@pytest.mark.slow
def test_a_spin_that_only_slows_down_does_not_wobble():
    launch = {"n_i": -0.3, "omega_xy0": 1e-4, "t_end": 150.0}
    run = rs.simulate("GH", **launch, pivot=0.002)
    lost = 0.002 * 150.0 / (rs.Rattleback.gh().gamma * 0.3)
    assert run.n_departure == pytest.approx(lost, rel=0.03)
    assert run.n_departure > 0.05
    assert run.amp_growth > 0.001
    assert run.type == "unclassified"
    # A long run whose roll takes the spin is of type SW or R, as without friction.
    pushed = rs.simulate("GH", n_i=-0.3, omega_xy0=0.01, t_end=400.0, pivot=1e-5)
    assert pushed.type in ("SW", "R")
