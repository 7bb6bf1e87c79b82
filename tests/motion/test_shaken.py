"""A plane that shakes: against an oracle in vectors, its work, its growth, lift-off."""

import math

import numpy as np
import oracle
import pandas as pd
import pytest
import shaken_oracle
import stone_oracle
import sweeping
from numpy.testing import assert_allclose, assert_array_equal
from shaken_oracle import Shaken

import rattlesweep as rs
from rattlesweep.physics.shaking import cosine
from rattlesweep.work.dask import make_executor
from rattlesweep.work.run import Shard

GH = rs.Rattleback.gh()
OMEGA_P = rs.modes(GH).omega_p
K_P = rs.modes(GH).K_p
UP = (0.0, 0.0, -1.0)
TIGHT = {"tol": 1e-11}
TAP = {"n_i": 0, "omega_xy0": 1e-5}


def ran(omega, t_end, drive, body=GH, **others):
    """Return the run of a drive of the oracle's, to its horizon."""
    base = {
        "frequency": drive.frequency,
        "acceleration": drive.acceleration,
        "phase_deg": math.degrees(drive.phase),
    }
    losses = {
        name: getattr(drive, name)
        for name in ("sigma", "rolling", "pivot")
        if getattr(drive, name)
    }
    launch = {"omega": omega, "u": UP, "t_end": t_end, "base": base}
    return rs.simulate(body, **launch, **losses, **(TIGHT | others))


def parameters(body):
    """Return a body as the oracle has it."""
    names = ("alpha", "beta", "gamma", "theta", "phi", "xi", "c")
    return {name: getattr(body, name) for name in names}


def assert_as_the_oracle_says(run, omega, t_end, drive, body=GH, rtol=1e-7):
    known = parameters(body)
    found = shaken_oracle.follow(known, np.array(UP), np.array(omega), t_end, drive)
    y = found.y[:, -1]
    energy_0 = stone_oracle.energy(found.y[:, 0], known)
    assert stone_oracle.energy(y, known) - y[6] == pytest.approx(energy_0, rel=1e-9)
    assert run.t_end == pytest.approx(found.t[-1])
    assert run.n_end == pytest.approx(y[:3] @ y[3:6], rel=rtol)
    assert run.base_work == pytest.approx(y[7] / energy_0, rel=rtol)


def test_the_cosine_of_a_phase_in_turns():
    turns = np.linspace(-3.0, 3.0, 1001)
    values = [cosine.py_func(float(x)) for x in turns]
    assert_allclose(values, np.cos(2 * np.pi * turns), atol=1e-14)
    assert cosine.py_func(1e9 + 0.25) == pytest.approx(0.0, abs=1e-15)


def test_a_run_is_that_of_an_oracle_in_vectors():
    omega = (0.01, 0.02, -0.1)
    drive = Shaken(frequency=2.9, acceleration=0.3, phase=0.7)
    run = ran(omega, 12.0, drive)
    assert run.status == "ok"
    assert_as_the_oracle_says(run, omega, 12.0, drive)
    assert abs(run.energy_drift) < 1e-9


def test_the_body_lifts_off_where_the_oracle_does():
    omega = (0.01, 0.02, -0.1)
    drive = Shaken(frequency=2.9, acceleration=1.2, phase=0.7)
    run = ran(omega, 12.0, drive)
    found = shaken_oracle.follow(
        parameters(GH), np.array(UP), np.array(omega), 12.0, drive
    )
    assert found.status == 1
    assert run.status == "lifts_off"
    assert run.t_end == pytest.approx(found.t[-1], rel=1e-8)
    # The plane does not touch a body that it leaves at launch.
    at_once = ran(omega, 12.0, Shaken(2.9, 1.2, math.pi))
    assert at_once.status == "lifts_off"
    assert at_once.t_end == 0.0


def test_a_short_dip_of_the_normal_force_is_found_between_the_ends_of_steps():
    """In the oracle it is below zero for 0.0009 in the sixth period, by 1e-4."""
    omega = (0.01, 0.02, -0.1)
    drive = Shaken(30.0, 1.0001, math.pi / 2)
    run = ran(omega, 12.0, drive)
    assert run.status == "lifts_off"
    assert run.t_end == pytest.approx(1.099085, abs=3e-5)


def test_a_mirrored_body_does_the_same():
    other = rs.Rattleback(GH.alpha, GH.beta, GH.gamma, GH.theta, GH.phi, -GH.xi)
    drive = Shaken(frequency=2 * OMEGA_P, acceleration=0.1)
    run = ran((0.01, 0.02, -0.1), 80.0, drive)
    same = ran((-0.01, 0.02, 0.1), 80.0, drive, body=other)
    assert same.n_end == -run.n_end
    assert same.base_work == run.base_work


def test_a_plane_at_rest_changes_no_bit():
    launch = {"n_i": np.array([-0.2, 0.1]), "omega_xy0": 0.01, "t_end": 40.0}
    plain = rs.simulate(GH, **launch)
    still = rs.simulate(GH, base=(5.0, np.array([0.0, 0.0])), **launch)
    mixed = rs.simulate(GH, base=(5.0, np.array([0.0, 0.1])), **launch)
    for name in ("t_end", "n_end", "n_steps", "energy_drift"):
        assert_array_equal(still[name], plain[name])
        assert mixed[name][0] == plain[name][0]
    assert mixed.n_end[1] != plain.n_end[1]
    assert mixed.base_work[0] == 0
    assert mixed.base_acceleration.tolist() == [0.0, 0.1]


def growth(acceleration, detuning, times):
    """Return the growth rate of the oscillation of GH without skew, from rest."""
    body = rs.Rattleback(GH.alpha, GH.beta, GH.gamma, GH.theta, GH.phi, -1e-9)
    omega = rs.modes(body).omega_p
    frequency = 2 * (omega + detuning)
    # Whole periods, after which the growing oscillation has the same phase.
    ends = np.round(np.array(times) * frequency / (2 * np.pi)) * 2 * np.pi / frequency
    tap = {"n_i": 0, "omega_xy0": 1e-7}
    runs = rs.simulate(body, t_end=ends, base=(frequency, acceleration), **tap)
    energy = 1 + runs.base_work.to_numpy()
    return math.log(energy[1] / energy[0]) / 2 / (ends[1] - ends[0]), omega


@pytest.mark.parametrize(
    ("acceleration", "detuning", "seen"),
    [(0.02, 0.0, 0.0071650), (0.05, 0.0, 0.0179126), (0.05, 0.01, None)],
)
def test_a_drive_at_twice_the_frequency_grows_from_rest(acceleration, detuning, seen):
    rate, omega = growth(acceleration, detuning, (300.0, 450.0))
    formula = math.sqrt((acceleration * omega / 4) ** 2 - detuning**2)
    assert rate == pytest.approx(formula, rel=5e-3)
    if seen is not None:
        assert rate == pytest.approx(seen, rel=5e-4)


@pytest.fixture(scope="module")
def late():
    """Return runs of GH from rest, with some loss, at several drives of the pitch."""
    ratios = np.array([1, 1.5, 1.8, 1.9, 1.95, 2, 2.05, 2.1, 2.2, 2.5, 3])
    return rs.simulate(
        GH,
        t_end=10_000.0,
        base=(ratios * OMEGA_P, 0.02),
        sigma=0.01,
        record="late",
        threads=1,
        **TAP,
    )


def test_only_twice_the_frequency_of_the_pitch_spins_the_body_up(late):
    assert (late.status == "ok").all()
    assert late.t_end.tolist() == [10_000.0] * 11
    settled = -(2 / K_P) * (0.02 * OMEGA_P / 4 - 0.01 / 2 / 12.054362)
    assert settled == pytest.approx(-0.024504, abs=1e-6)
    assert late.n_late_mean[5] == pytest.approx(settled, rel=0.01)
    assert late.n_late_std[5] < 1e-3
    others = late.drop(5)
    assert (others.n_late_mean.abs() < 2e-5).all()
    assert (others.n_late_std < 2e-5).all()


@pytest.mark.slow
def test_late_values_are_those_of_the_rows_of_a_trajectory(late):
    path = rs.trajectory(
        GH,
        t_end=600.0,
        base=(2 * OMEGA_P, 0.1),
        sigma=0.03,
        times=np.linspace(450.0, 600.0, 20_001),
        channels=["t", "n"],
        **TAP,
    )
    run = rs.simulate(
        GH, t_end=600.0, base=(2 * OMEGA_P, 0.1), sigma=0.03, record="late", **TAP
    )
    n = path["n"].to_numpy()
    mean = np.trapezoid(n) / 20_000
    deviation = math.sqrt(np.trapezoid((n - mean) ** 2) / 20_000)
    assert deviation > 1e-3
    assert run.n_late_mean == pytest.approx(mean, rel=1e-6)
    assert run.n_late_std == pytest.approx(deviation, rel=1e-5)
    assert late.n_late_std.notna().all()


def test_without_losses_the_spin_swings_once():
    """From 0 to about twice the spin at which losses would balance the drive."""
    runs = rs.simulate(
        GH,
        n_i=0,
        omega_xy0=1e-3,
        t_end=np.linspace(2000.0, 5000.0, 151),
        base=(2 * OMEGA_P, 0.01),
        record="late",
    )
    assert runs.n_end.min() == pytest.approx(-0.02522, rel=2e-3)


@pytest.mark.slow
def test_a_sweep_is_the_same_in_shards_and_its_rows_are_an_input(tmp_path):
    config = {
        "bodies": {"source": "preset", "name": "GH"},
        "spin": {"n_i": 0, "omega_xy0": 1e-3},
        "horizon": {"t": 60},
        "base": {
            "frequency": [2.8, 2.9],
            "acceleration": [0.0, 0.1],
            "phase_deg": [0, 30],
        },
        "record": "late",
    }
    whole = sweeping.sweep(tmp_path / "whole", config)
    assert whole is not None
    rows = sweeping.rows(tmp_path / "whole")
    assert len(rows) == 8
    for index in range(2):
        sweeping.sweep(tmp_path / "parts", config, shard=Shard(index, 2))
    pd.testing.assert_frame_equal(sweeping.rows(tmp_path / "parts"), rows)
    sweeping.proved(tmp_path / "whole", recompute=8)
    again = rs.simulate(rows.drop(columns=["t_end"]), t_end=60.0, record="late")
    for name in ("n_end", "base_work", "n_late_mean"):
        assert_array_equal(again[name].to_numpy(), rows[name].to_numpy())
    path = rs.replay(tmp_path / "whole", 7, 0, channels=["t", "n"], points=2)
    assert path["n"].iloc[-1] == pytest.approx(rows.n_end[7], rel=1e-12)


# With every loss beside it.

ELLIPSOID = rs.Rattleback(
    alpha=GH.alpha,
    beta=GH.beta,
    gamma=GH.gamma,
    theta=GH.theta,
    phi=GH.phi,
    xi=GH.xi,
    c=2.0,
)


@pytest.mark.slow
@pytest.mark.parametrize("body", [GH, ELLIPSOID], ids=["paraboloid", "ellipsoid"])
def test_all_losses_act_with_the_normal_force_of_the_shaken_plane(body):
    omega = (0.05, 0.04, -0.3)
    drive = Shaken(2.9, 0.5, 0.7, sigma=0.01, rolling=2e-3, pivot=2e-3)
    run = ran(omega, 8.0, drive, body=body)
    assert_as_the_oracle_says(run, omega, 8.0, drive, body=body, rtol=1e-6)
    assert abs(run.energy_drift) < 1e-9
    assert run.pivot_work > 0


@pytest.mark.slow
def test_a_patch_that_creeps_on_a_shaken_plane_conserves_energy_less_work():
    launch = {"n_i": -0.2, "omega_xy0": 0.1, "t_end": 300.0, "record": "late"}
    launch |= {"pivot": 0.006, "creep": 0.3, "tol": 1e-11}
    plain = rs.simulate(GH, **launch)
    weak = rs.simulate(GH, base=(2.9, 1e-9), **launch)
    strong = rs.simulate(GH, base=(2.9, 0.1), **launch)
    assert weak.t_r == pytest.approx(plain.t_r, rel=1e-6)
    assert weak.creep_work == pytest.approx(plain.creep_work, rel=1e-6)
    assert abs(strong.energy_drift) < 1e-9
    assert abs(strong.base_work) > 1e-3
    assert strong.creep_work > 0


@pytest.mark.slow
def test_a_foot_slides_earlier_where_the_weight_fades():
    launch = {"n_i": 0.3, "omega_xy0": 0.02, "mu": 0.1, "t_end": 100.0, "tol": 1e-10}
    still = rs.simulate(GH, **launch)
    shaken = rs.simulate(GH, base=(2.9, 0.5), **launch)
    assert still.n_slides > 0
    assert shaken.n_slides > 0
    assert shaken.t_slide < still.t_slide
    assert abs(shaken.energy_drift) < 1e-9
    leaves = rs.simulate(GH, base=(2.9, 1.5), **launch)
    assert leaves.status == "lifts_off"


@pytest.mark.slow
def test_dask_has_the_rows_of_one_computer(tmp_path):
    distributed = pytest.importorskip("distributed")
    config = {
        "bodies": {"source": "sd", "samples": 4},
        "spin": {"n_i": 0, "omega_xy0": 1e-3},
        "horizon": {"t": 60},
        "base": {"frequency": 2.9, "acceleration": 0.1},
        "record": "late",
    }
    sweeping.sweep(tmp_path / "here", config)
    with distributed.LocalCluster(1, processes=False, dashboard_address=None) as found:
        executor = make_executor(found.scheduler_address)
        sweeping.sweep(tmp_path / "there", config, executor=executor)
    pd.testing.assert_frame_equal(
        sweeping.rows(tmp_path / "there"), sweeping.rows(tmp_path / "here")
    )


def test_the_oracle_at_rest_is_the_other_oracle():
    """With the plane at rest the forces are those of `stone_oracle`."""
    u = np.array([0.05, 0.02, -math.sqrt(1 - 0.0029)])
    y = shaken_oracle.launched(u, np.array([0.1, 0.2, 0.3]))
    drive = Shaken(2.0, 0.0, sigma=0.1, rolling=1e-3)
    ours = shaken_oracle.motion(0.0, y, oracle.GH, drive)
    others = stone_oracle.forces(y, oracle.GH, sigma=0.1, rolling=1e-3)
    assert_allclose(ours[0], others[0], rtol=1e-12)
    assert_allclose(ours[1], others[1], rtol=1e-12)
    assert ours[2][0] == pytest.approx(others[2])
