"""The Casimir invariant: its bracket, the reduced model, averages in the full one."""

import itertools

import numpy as np
import pandas as pd
import pytest

import rattlesweep as rs
from rattlesweep.physics import reduced, theory

GH = rs.Rattleback.gh()
MODES = theory.modes(GH.alpha, GH.beta, GH.theta, GH.phi, GH.xi)
K_P = float(MODES.K_p)
K_R = float(MODES.K_r)
LAUNCH = {"n_i": 0.1, "omega_xy0": 0.01, "psi": 20.0}
TURNS = ["casimir", "reversals"]


def test_it_commutes_with_everything():
    """The bracket that makes the reduced model Hamiltonian annihilates its gradient."""
    gamma = 12.28
    for n, e_p, e_r in np.random.default_rng(1).uniform(0.1, 2.0, (20, 3)):
        bracket = np.zeros((3, 3))
        bracket[0, 1] = -K_P * e_p / gamma
        bracket[0, 2] = K_R * e_r / gamma
        bracket -= bracket.T
        energy_gradient = np.array([gamma * n, 1.0, 1.0])
        rates = reduced.rhs.py_func((n, e_p, e_r), (K_P, K_R, gamma))
        assert bracket @ energy_gradient == pytest.approx(rates, rel=1e-14)
        step = 1e-5
        slopes = [
            reduced.casimir(e_p + step * p, e_r + step * r, K_P, K_R)
            - reduced.casimir(e_p - step * p, e_r - step * r, K_P, K_R)
            for p, r in ((1, 0), (0, 1))
        ]
        gradient = np.array([0.0, *slopes]) / (2 * step)
        assert np.abs(bracket @ gradient).max() < 1e-8


def test_the_reduced_model_keeps_it():
    run = rs.simulate(GH, **LAUNCH, model="reduced", t_end=6000.0, record=TURNS)
    course = rs.trajectory(
        GH, **LAUNCH, model="reduced", t_end=1.0, channels=["casimir", "C_I"]
    )
    at_launch = course.table.casimir[0]
    assert at_launch == course.table.C_I[0]
    assert run.casimir_min == pytest.approx(at_launch, rel=1e-9)
    assert run.casimir_max == pytest.approx(at_launch, rel=1e-9)
    assert len(run.casimir_jumps) == run.n_turns == 6
    assert np.abs(run.casimir_jumps).max() < 1e-7


def test_damping_lowers_it_at_a_constant_rate():
    sigma = 0.001
    run = rs.simulate(
        GH, **LAUNCH, sigma=sigma, model="reduced", t_end=90.0, record=["casimir"]
    )
    moments = theory.mode_moments(GH.alpha, GH.beta, MODES)
    rate = sigma * (1 / (K_P * moments[0]) + 1 / (K_R * moments[1]))
    assert run.casimir_max - run.casimir_min == pytest.approx(90.0 * rate, rel=1e-7)
    assert not hasattr(run, "casimir_jumps")


def test_a_mode_without_energy_has_none():
    run = rs.simulate(GH, n_i=0.1, omega_xy0=0.01, model="reduced", record=["casimir"])
    assert run.casimir_min is None
    assert run.casimir_max is None


@pytest.fixture(scope="module")
def turned():
    """A run of the full model past two reversals."""
    return rs.simulate(GH, **LAUNCH, t_end=2500.0, record=TURNS)


def averages(table):
    """Return times at the ends of periods of the roll, and the invariant of each."""
    period = 2 * np.pi / float(MODES.omega_r)
    t, e_p, e_r = (table[name].to_numpy() for name in ("t", "E_p", "E_r"))
    begin = 0
    ends, values = [], []
    for k in range(1, len(t)):
        if t[k] - t[begin] >= period:
            rows = slice(begin, k + 1)
            length = t[k] - t[begin]
            pitch = np.trapezoid(e_p[rows], t[rows]) / length
            roll = np.trapezoid(e_r[rows], t[rows]) / length
            ends.append(t[k])
            values.append(np.log(pitch) / K_P + np.log(roll) / K_R)
            begin = k
    return np.array(ends), np.array(values)


def test_energies_are_averaged_over_a_period_of_the_roll(turned):
    course = rs.trajectory(
        GH, **LAUNCH, t_end=2500.0, steps=True, channels=["t", "E_p", "E_r"]
    )
    ends, values = averages(course.table)
    assert turned.casimir_min == pytest.approx(values.min(), rel=1e-5)
    assert turned.casimir_max == pytest.approx(values.max(), rel=1e-5)
    times = [0.0, *turned.turn_times, np.inf]
    means = [
        values[(ends > begin) & (ends <= end)].mean()
        for begin, end in itertools.pairwise(times)
    ]
    # A period that contains a zero may count on either side.
    assert turned.casimir_jumps == pytest.approx(np.diff(means), abs=2.0)
    # It is no invariant of the full dynamics.
    assert turned.casimir_max - turned.casimir_min > 50


def test_that_of_a_mirrored_body_has_the_other_sign(turned):
    other = rs.simulate(
        GH.mirrored(), n_i=-0.1, omega_xy0=0.01, psi=-20.0, t_end=2500.0, record=TURNS
    )
    assert other.casimir_min == pytest.approx(-turned.casimir_max, rel=1e-9)
    assert other.casimir_max == pytest.approx(-turned.casimir_min, rel=1e-9)
    jumps = -np.array(turned.casimir_jumps)
    assert other.casimir_jumps == pytest.approx(jumps, rel=1e-6)


def test_nothing_else_changes_with_it(turned):
    plain = rs.simulate(GH, **LAUNCH, t_end=2500.0, record=["reversals"])
    assert plain.t_r == turned.t_r
    assert plain.n_end == turned.n_end
    assert plain.n_steps == turned.n_steps


def test_sweeps_store_it(tmp_path):
    bodies = pd.DataFrame(
        {
            "alpha": [GH.alpha] * 3,
            "beta": [GH.beta] * 3,
            "gamma": [GH.gamma] * 3,
            "theta": [0.6429, 0.82, 0.9],
            "phi": [GH.phi] * 3,
            "xi": [GH.xi] * 3,
        }
    )
    sweep = rs.sweep(
        bodies,
        spin={"n_i": 0.1, "omega_xy0": 0.01},
        record=TURNS,
        horizon={"t": 400},
        output=tmp_path / "out",
    )
    runs = sweep.runs
    assert (runs.casimir_max > runs.casimir_min).all()
    assert [len(jumps) for jumps in runs.casimir_jumps] == runs.n_turns.tolist()
