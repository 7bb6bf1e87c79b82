"""A plane that shakes along itself: against an oracle at rest, its work, its limits."""

import math
from math import cos, sin, sqrt

import numpy as np
import oracle
import pandas as pd
import pytest
import shaken_oracle
import stone_oracle
import sweeping
from exact import exactly, followed
from numpy.testing import assert_allclose, assert_array_equal
from shaken_oracle import Shaken

import rattlesweep as rs
from rattlesweep.motion.anywhere import from_slopes
from rattlesweep.motion.model import find_model
from rattlesweep.physics import full
from rattlesweep.work.run import Shard

GH = rs.Rattleback.gh()
UP = np.array([0.0, 0.0, -1.0])
OMEGA = np.array([0.01, 0.02, -0.1])
TIGHT = {"tol": 1e-11}
ELLIPSOID = {**oracle.GH, "c": 2.0}
EVERY_LOSS = {"sigma": 0.01, "rolling": 2e-3, "pivot": 2e-3}


def along(drive):
    """Return a drive of the oracle's as the keys of a config."""
    return {
        "frequency": drive.frequency,
        "acceleration": drive.acceleration,
        "phase_deg": math.degrees(drive.phase),
        "direction": "horizontal",
        "azimuth_deg": math.degrees(drive.azimuth),
    }


def ran(drive, t_end, body=GH, omega=OMEGA, **others):
    """Return the run of a drive of the oracle's, to its horizon."""
    launch = {"omega": tuple(omega), "u": tuple(UP), "t_end": t_end}
    return rs.simulate(body, base=along(drive), **launch, **(TIGHT | others))


def parameters(body):
    """Return a body as the oracle has it."""
    names = ("alpha", "beta", "gamma", "theta", "phi", "xi", "c")
    return {name: getattr(body, name) for name in names}


def launched(model, u, omega, body, drive):
    """Return state and constants of a model in slopes at a launch."""
    known = [oracle.get(body, name) for name in oracle.PARAMETERS]
    values = dict(zip(full.CONSTANTS, full.constants(*known), strict=True))
    values |= {"k": 1 / body["c"] if body.get("c") else 0.0, **model.fixed}
    values |= {name: getattr(drive, name) for name in EVERY_LOSS}
    values["base_acceleration"] = drive.acceleration
    values["base_frequency"] = drive.frequency
    values["base_phase"] = drive.phase
    values["base_azimuth"] = drive.azimuth
    values |= {"sense": np.sign(u @ omega), "creep": 0.3, "viscous": 50.0}
    place = full.from_vectors(u, omega)
    y = model.at_launch(
        place[None], {name: np.array([x]) for name, x in values.items()}
    )
    return y, np.array([[values[name] for name in model.constants]])


def tilted(rng):
    """Return a tilted vertical and an angular velocity."""
    u = np.array([*rng.uniform(-0.2, 0.2, 2), -1.0])
    return u / np.linalg.norm(u), rng.uniform(-0.5, 0.5, 3)


@pytest.mark.parametrize(
    ("name", "body", "losses"),
    [
        ("full_swayed", oracle.GH, {"sigma": 0.01}),
        ("ellipsoid_swayed", ELLIPSOID, {"sigma": 0.01}),
        ("full_rolling_swayed_pivoting", oracle.GH, EVERY_LOSS),
        ("ellipsoid_rolling_swayed_pivoting", ELLIPSOID, EVERY_LOSS),
    ],
)
def test_rates_and_force_are_those_of_newton_and_euler_at_rest(name, body, losses):
    """In slopes, and in the variables of any position."""
    model = find_model(name)
    rng = np.random.default_rng(57)
    for phase, azimuth in rng.uniform(-3.0, 3.0, (5, 2)):
        u, omega = tilted(rng)
        drive = Shaken(1.3, 0.4, phase, azimuth=azimuth, **losses)
        y, q = launched(model, u, omega, body, drive)
        states = [(model, y, q)]
        if model.anywhere is not None:
            states.append((model.anywhere, *from_slopes(model, y, q)))
        start = shaken_oracle.launched(u, omega)
        turned, force, powers = shaken_oracle.motion(0.0, start, body, drive)
        for own, state, constants in states:
            rates = exactly(own.rhs, sqrt)(tuple(state[0]), tuple(constants[0]))
            place = len(own.chart.place)
            named = dict(zip(own.components, rates, strict=True))
            assert_allclose(rates[place - 3 : place], turned, rtol=1e-11, atol=1e-13)
            assert named["work"] == pytest.approx(powers[0], rel=1e-10)
            assert named["base work"] == pytest.approx(powers[1], rel=1e-10)
            assert named["turns of the base"] == pytest.approx(1.3 / (2 * math.pi))
            found = exactly(own.force, sqrt)(
                tuple(state[0]), rates, tuple(constants[0])
            )
            normal = force @ u
            assert found == pytest.approx((normal, force @ force - normal**2))


def test_the_direction_rests_on_the_plane():
    """At launch it is the oracle's; its rate is that of a vector at rest."""
    model = find_model("full_swayed")
    u, omega = tilted(np.random.default_rng(58))
    drive = Shaken(1.3, 0.4, 0.2, azimuth=1.1)
    y, q = launched(model, u, omega, oracle.GH, drive)
    e = y[0, 8:11]
    first = np.array([1.0, 0.0, 0.0]) - u[0] * u
    first = first / np.linalg.norm(first)
    assert_allclose(e, cos(1.1) * first + sin(1.1) * np.cross(u, first), rtol=1e-14)
    rates = exactly(model.rhs, sqrt)(tuple(y[0]), tuple(q[0]))
    assert_allclose(rates[8:11], np.cross(e, omega), rtol=1e-13)


@pytest.mark.parametrize(
    "name",
    [
        "full_swayed",
        "ellipsoid_rolling_swayed_pivoting",
        "full_creep_swayed_pivoting",
        "full_slip_swayed",
        "vectors_slip_swayed",
    ],
)
def test_energy_minus_work_is_conserved_under_every_law(name):
    model = find_model(name)
    slopes = find_model(name.replace("vectors", "ellipsoid"))
    drive = Shaken(1.44, 0.2, 0.5, azimuth=0.7, **EVERY_LOSS)
    y, q = launched(slopes, UP, np.array([0.03, 0.04, -0.3]), ELLIPSOID, drive)
    if model is not slopes:
        y, q = from_slopes(slopes, y, q)
    rhs = exactly(model.rhs, sqrt)
    energy = exactly(model.energy, sqrt)
    constants = tuple(q[0])
    state = y[0]
    before = energy(tuple(state), constants)
    state = followed(rhs, state, constants, 0.005, 200)
    assert energy(tuple(state), constants) == pytest.approx(before, rel=1e-8)
    assert abs(state[model.column("base work")]) > 1e-3
    e = state[[model.column(f"base_{axis}") for axis in "xyz"]]
    assert np.linalg.norm(e) == pytest.approx(1.0, abs=1e-9)


def test_the_oracle_conserves_the_energy_in_the_frame_at_rest():
    """There the plane does work by the contact force."""
    drive = Shaken(1.44, 0.05, 0.7, azimuth=0.4)
    found = shaken_oracle.follow(oracle.GH, UP, OMEGA, 6.0, drive)

    def energy(t, y):
        attitude = shaken_oracle.Rotation.from_quat(y[9:])
        direction = attitude.inv().apply(drive.direction)
        moved = drive.velocity_at(t) * direction
        r, _ = stone_oracle.contact(y[:3], np.zeros(3), oracle.GH)
        v = np.cross(r, y[3:6])
        more = moved @ v + 0.5 * moved @ moved
        return stone_oracle.energy(y, oracle.GH) + more

    last = found.y[:, -1]
    gained = energy(6.0, last) - energy(0.0, found.y[:, 0])
    assert abs(gained) > 1e-4
    assert last[8] == pytest.approx(gained, rel=1e-9)


def test_the_rates_hold_where_the_body_lies_upside_down():
    model = find_model("ellipsoid_swayed").anywhere
    u = np.array([0.3, -0.6, 0.5])
    u = u / np.linalg.norm(u)
    omega = np.array([0.2, -0.3, 0.5])
    drive = Shaken(1.3, 0.4, 0.7, azimuth=1.1, sigma=0.01)
    start = shaken_oracle.launched(u, omega)
    turned, _, powers = shaken_oracle.motion(0.0, start, ELLIPSOID, drive)
    attitude = shaken_oracle.Rotation.from_quat(start[9:])
    e = attitude.inv().apply(drive.direction)
    known = [oracle.get(ELLIPSOID, name) for name in oracle.PARAMETERS]
    values = dict(zip(full.CONSTANTS, full.constants(*known), strict=True))
    values |= {"k": 0.5, "sigma": 0.01, "rolling": 0.0, **model.fixed}
    values |= {"base_acceleration": 0.4, "base_frequency": 1.3}
    values |= {"base_phase": 0.7, "base_azimuth": 1.1}
    state = {"turns of the base": 0.7 / (2 * math.pi)}
    state |= dict(zip(("base_x", "base_y", "base_z"), e, strict=True))
    place = len(model.chart.place)
    rest = [state.get(name, 0.0) for name in model.components[place:]]
    constants = tuple(values[name] for name in model.constants)
    rates = exactly(model.rhs, sqrt)((*u, *omega, *rest), constants)
    assert_allclose(rates[place - 3 : place], turned, rtol=1e-11)
    named = dict(zip(model.components, rates, strict=True))
    assert named["base work"] == pytest.approx(powers[1], rel=1e-10)
    found = [named[f"base_{axis}"] for axis in "xyz"]
    assert_allclose(found, np.cross(e, omega), rtol=1e-13)


# Whole runs


@pytest.mark.slow
def test_a_run_is_that_of_an_oracle_in_vectors():
    drive = Shaken(1.44, 0.05, 0.7, azimuth=0.4)
    run = ran(drive, 12.0)
    found = shaken_oracle.follow(parameters(GH), UP, OMEGA, 12.0, drive)
    y = found.y[:, -1]
    energy_0 = stone_oracle.energy(found.y[:, 0], parameters(GH))
    assert run.status == "ok"
    assert run.n_end == pytest.approx(y[:3] @ y[3:6], rel=1e-9)
    assert run.base_work == pytest.approx(y[7] / energy_0, rel=1e-8)
    assert abs(run.energy_drift) < 1e-9
    assert run.base_azimuth == pytest.approx(0.4)


@pytest.mark.slow
def test_the_body_lifts_off_where_the_oracle_does():
    drive = Shaken(1.44, 1.5, 0.7, azimuth=0.4)
    run = ran(drive, 20.0)
    found = shaken_oracle.follow(parameters(GH), UP, OMEGA, 20.0, drive)
    assert found.status == 1
    assert run.status == "lifts_off"
    assert run.t_end == pytest.approx(found.t[-1], rel=1e-8)


@pytest.mark.slow
def test_a_mirrored_body_does_the_same_under_the_mirrored_azimuth():
    other = rs.Rattleback(GH.alpha, GH.beta, GH.gamma, GH.theta, GH.phi, -GH.xi)
    run = ran(Shaken(1.44, 0.02, azimuth=0.4), 80.0)
    mirrored = OMEGA * [-1, 1, -1]
    same = ran(Shaken(1.44, 0.02, azimuth=-0.4), 80.0, body=other, omega=mirrored)
    assert same.n_end == -run.n_end
    assert same.base_work == run.base_work
    # A plane that shakes the other way is half a period ahead.
    ahead = ran(Shaken(1.44, 0.02, math.pi, azimuth=0.4 + math.pi), 80.0)
    assert ahead.n_end == pytest.approx(run.n_end, rel=1e-9)


@pytest.mark.slow
def test_a_plane_at_rest_changes_no_bit_and_a_calm_one_little():
    launch = {"n_i": np.array([-0.2, 0.1]), "omega_xy0": 0.01, "t_end": 40.0}
    plain = rs.simulate(GH, **launch)
    calm = np.array([0.0, 0.0])
    still = rs.simulate(GH, base=along(Shaken(1.44, calm, azimuth=0.4)), **launch)
    for name in ("t_end", "n_end", "n_steps", "energy_drift"):
        assert_array_equal(still[name], plain[name])
    ends = [
        ran(Shaken(1.44, eps, azimuth=0.4), 40.0).n_end for eps in (0.0, 1e-6, 2e-6)
    ]
    # To first order in the acceleration.
    assert ends[1] != ends[0]
    assert (ends[2] - ends[0]) / (ends[1] - ends[0]) == pytest.approx(2.0, rel=1e-3)


@pytest.mark.slow
def test_a_sweep_is_the_same_in_shards_and_its_rows_are_an_input(tmp_path):
    config = {
        "bodies": {"source": "preset", "name": "GH"},
        "spin": {"n_i": 0, "omega_xy0": 1e-3},
        "horizon": {"t": 60},
        "base": {
            "frequency": 1.44,
            "acceleration": [0.0, 0.05],
            "direction": "horizontal",
            "azimuth_deg": [0, 30],
        },
        "record": "late",
    }
    whole = sweeping.sweep(tmp_path / "whole", config)
    assert whole is not None
    rows = sweeping.rows(tmp_path / "whole")
    assert len(rows) == 4
    assert rows.n_end[2] != rows.n_end[3]
    assert rows.n_end[0] == rows.n_end[1]
    for index in range(2):
        sweeping.sweep(tmp_path / "parts", config, shard=Shard(index, 2))
    pd.testing.assert_frame_equal(sweeping.rows(tmp_path / "parts"), rows)
    sweeping.proved(tmp_path / "whole", recompute=4)
    bodies = rows.drop(columns=["t_end"])
    again = rs.simulate(bodies, t_end=60.0, record="late")
    for name in ("n_end", "base_work", "n_late_mean"):
        assert_array_equal(again[name].to_numpy(), rows[name].to_numpy())
    path = rs.replay(tmp_path / "whole", 3, 0, channels=["t", "n"], points=2)
    assert path["n"].iloc[-1] == pytest.approx(rows.n_end[3], rel=1e-12)
