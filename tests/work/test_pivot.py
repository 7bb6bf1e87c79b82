"""Runs with `dissipation.pivot`; every way to ask for them is in `test_losses`."""

import numpy as np
import pytest

import rattlesweep as rs

LAUNCH = {"n_i": -0.1, "omega_xy0": 0.01}
CONFIG = {
    "bodies": {"source": "preset", "name": "GH"},
    "spin": LAUNCH,
    "dissipation": {"pivot": [0.0005, 0.002, 0.006]},
    "horizon": {"t": 900},
}
GAMMA = 12.28


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    return rs.sweep(CONFIG | {"output": str(tmp_path_factory.mktemp("pivot") / "out")})


def test_a_sweep_over_pivot(sweep):
    runs = sweep.read()
    assert (runs.status == "ok").all()
    assert runs.type.tolist() == ["R", "D", "D"]
    assert runs.t_r[0] == pytest.approx(882.3714980358568, rel=1e-8)
    assert runs.t_held[1:].to_numpy() == pytest.approx([594.1213060, 204.1801268])
    assert np.isnan(runs.t_held[0])
    assert runs.held_time[0] == 0
    assert (runs.n_end[1:] == 0).all()
    np.testing.assert_allclose(runs.held_time[1:], 900 - runs.t_held[1:], rtol=1e-12)
    # More than dead_energy is left to one of them, which rocks on.
    assert runs.energy_left[1] > 0.02
    assert abs(runs.energy_drift).max() < 1e-9
    np.testing.assert_allclose(runs.energy_left, 1 - runs.pivot_work, rtol=1e-12)
    assert runs.growth.isna().all()
    assert sweep.summary.fraction_D.tolist() == [0, 1, 1]
    assert sweep.summary["pivot"].tolist() == CONFIG["dissipation"]["pivot"]


def test_a_lever_of_zero_is_none_to_the_last_bit():
    """Its run has the equations of a body without the torque."""
    with_others = rs.simulate("GH", **LAUNCH, t_end=900, pivot=[0.0, 0.002])
    plain = rs.simulate("GH", **LAUNCH, t_end=900)
    run = with_others.iloc[0]
    for name in ("t_r", "n_end", "energy_drift", "amp_growth", "n_steps"):
        assert run[name] == getattr(plain, name), name
    assert run.energy_left == 1
    assert np.isnan(run.t_held)
    assert run.held_time == run.pivot_work == 0


def test_types_follow_from_stored_columns(sweep):
    before = sweep.read().type.tolist()
    sweep.classify(ss_growth=1e-9, sw_departure=1e-6)
    assert sweep.read().type.tolist() == before
    sweep.classify()


def test_mirrored_bodies_do_the_same(sweep):
    gh = rs.Rattleback.gh()
    body = {
        name: getattr(gh, name) for name in ("alpha", "beta", "gamma", "theta", "phi")
    }
    mirrored = rs.Rattleback(**body, xi=-gh.xi)
    run = rs.simulate(mirrored, n_i=0.1, omega_xy0=0.01, t_end=900, pivot=0.002)
    stored = sweep.read().iloc[1]
    assert run.t_held == pytest.approx(stored.t_held, rel=1e-9)
    assert run.pivot_work == pytest.approx(stored.pivot_work, rel=1e-9)


@pytest.mark.parametrize("n_i", [0.3, -0.3])
def test_an_upright_spin_dies(n_i):
    """Its rate is -l/gamma, without any oscillation."""
    run = rs.simulate("GH", omega=(0, 0, -n_i), t_end=900, pivot=0.006)
    assert run.n_i == pytest.approx(n_i)
    assert run.t_held == pytest.approx(GAMMA * 0.3 / 0.006, rel=1e-12)
    assert run.held_time == pytest.approx(900 - run.t_held, rel=1e-12)
    assert run.type == "D"
    assert run.n_end == 0


def test_the_change_of_reversal_times_is_of_order_one():
    levers = np.array([1e-7, 1e-6])
    t_r = rs.simulate("GH", n_i=0.1, omega_xy0=0.01, pivot=levers, tol=1e-12).t_r
    exact = rs.simulate("GH", n_i=0.1, omega_xy0=0.01, tol=1e-12).t_r
    slopes = (t_r - exact) / levers
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-3)
