"""One run as a time series: the sweep's own steps and reversals, states at any times."""

import math
import tracemalloc

import kernels
import numpy as np
import oracle
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import rattlesweep as rs
from rattlesweep.analysis.onerun.channels import CHANNELS
from rattlesweep.analysis.onerun.course import CHUNK, Course
from rattlesweep.analysis.onerun.rows import Rows
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import integrate
from rattlesweep.integrate.follow import Follower
from rattlesweep.integrate.model import FULL, REDUCED
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.sweeps.single import Launch

GH = rs.Rattleback.gh()
DOP853, RK4 = METHODS["dop853"], METHODS["rk4"]
every_method = kernels.methods("dop853")


def follow(batch, method=DOP853, model=FULL, **options):
    """All accepted steps: the follower at its end, times and states."""
    follower = Follower(batch, method, model, **options)
    parts = [follower.launch()]
    while not follower.ended:
        parts.append(follower.steps())
    return (
        follower,
        np.concatenate([p.t for p in parts]),
        np.concatenate([p.y for p in parts]),
    )


# --- the steps are the sweep's -------------------------------------------------------------------


LAUNCHES = [(0.1, 0.01, 900.0), (-0.1, 0.1, 900.0), (0.5, 0.01, 900.0), (0.3, 0.001, 7.3)]


@every_method
@pytest.mark.parametrize(("n_i", "omega", "t_end"), LAUNCHES)
def test_reversal_and_last_step_are_those_of_the_sweep_bit_for_bit(method, n_i, omega, t_end):
    batch = kernels.full_batch(oracle.GH, [n_i], omega, psi=1.1, t_end=t_end)
    out = integrate(batch, method, FULL, dt=0.01, tol=1e-8)
    follower, t, y = follow(batch, method, dt=0.01, tol=1e-8)
    assert follower.status == Status.OK
    assert t[-1] == t_end
    assert np.all(np.diff(t) > 0)
    assert np.isnan(out.t_r[0]) == (t_end < 10)
    if t_end < 10:
        assert follower.zeros == []
        assert follower.n_steps == out.n_steps[0]
        assert y[-1].tobytes() == out.y_end[0].tobytes()
    else:
        assert out.t_r[0] == follower.zeros[0]


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_reduced_runs_are_the_sweeps_too(method):
    batch = kernels.reduced_batch(oracle.GH, [0.1], 6e-4, 3e-5, 3000.0)
    out = integrate(batch, method, REDUCED, dt=0.5)
    follower, _, y = follow(batch, method, REDUCED, dt=0.5)
    assert out.t_r[0] == follower.zeros[0]
    assert len(follower.zeros) == 3
    assert follower.energy_0 == pytest.approx(REDUCED.energy(*y[-1], *batch.constants[0]))


def test_rows_do_not_change_the_steps_nor_pieces_of_a_grid_the_rows():
    batch = kernels.full_batch(oracle.GH, [0.4], t_end=150.0)
    plain, t, y = follow(batch)
    random = np.sort(np.random.default_rng(3).uniform(0, 150, 2000))
    for times in (np.linspace(0, 150, 7), random, t):
        whole, pieces = (Follower(batch, DOP853, FULL, attitude=True) for _ in range(2))
        found = whole.at(times)
        parts = [pieces.at(part) for part in np.array_split(times, 37)]
        for name in ("y", "extra"):
            joined = np.concatenate([getattr(part, name) for part in parts])
            assert joined.tobytes() == getattr(found, name).tobytes()
        while not whole.ended:
            whole.steps()
        assert (whole.zeros, whole.n_steps) == (plain.zeros, plain.n_steps)
        assert len(found.t) == len(times)
    # The last grid was the steps themselves; h is known but for the rounding of t.
    assert found.y == pytest.approx(y, abs=1e-13)


# --- against others ------------------------------------------------------------------------------


def test_states_and_all_reversals_agree_with_scipy():
    """SciPy from the paper's equations."""
    times = np.linspace(0, 20, 81)
    start = oracle.launch(oracle.GH, 0.2, 0.5, oracle.relevant_psi(oracle.GH, 0.2))
    other = solve_ivp(
        oracle.rhs, (0, 20), start, "DOP853", times, args=(oracle.GH,), rtol=1e-11, atol=1e-13,
        max_step=0.2, events=lambda t, y, body: oracle.spin(y),
    )  # fmt: skip
    channels = ["t", "n", "u_x", "u_y", "u_z", "omega_x", "omega_y", "omega_z"]
    options = {"times": times, "t_end": 20, "tol": 1e-12, "channels": channels}
    run = rs.trajectory(GH, n_i=0.2, omega_xy0=0.5, **options)
    assert run.table.iloc[:, 2:].to_numpy() == pytest.approx(other.y.T, abs=1e-8)
    assert len(run.zeros) == 7
    assert run.zeros == pytest.approx(other.t_events[0], abs=1e-8)


def test_no_reversal_is_missed_on_a_fine_grid():
    course = rs.trajectory(GH, n_i=0.5, omega_xy0=0.01, t_end=600.0, points=60_001)
    n, t = course.table["n"].to_numpy(), course.table["t"].to_numpy()
    crossings = np.flatnonzero(n[:-1] * n[1:] < 0)
    assert len(course.zeros) > 60
    assert np.all(np.diff(course.zeros) > 0)
    # A pair of zeros between two rows is found by the search alone.
    inside = np.searchsorted(course.zeros, t)
    counted = np.diff(inside)
    assert np.all(counted[crossings] % 2 == 1)
    assert np.all(np.delete(counted, crossings) % 2 == 0)
    spin = rs.trajectory(GH, n_i=0.5, omega_xy0=0.01, t_end=600.0, times=course.zeros)
    assert np.abs(spin.table["n"]).max() < 1e-13


@pytest.mark.slow  # rk4 compiles kernels of its own
def test_pairs_of_zeros_inside_one_step_are_found():
    """Steps of eight dt, each time in other places, against zeros 0.2 and 0.8 apart."""
    batch = kernels.full_batch(oracle.GH, [0.2], 0.3, t_end=25.0)
    fine, _, _ = follow(batch, tol=1e-12)
    gaps = np.diff(fine.zeros)
    assert len(gaps) == 4
    assert gaps.min() < 0.25
    pairs = 0
    for dt in np.linspace(0.02, 0.1, 41):
        rough, t, _ = follow(batch, RK4, dt=dt)
        assert rough.zeros == pytest.approx(fine.zeros, abs=0.02), dt
        pairs += (np.diff(np.searchsorted(rough.zeros, t)) == 2).sum()
    assert pairs > 10


@pytest.mark.slow  # likewise
def test_rows_between_steps_converge_at_the_methods_order():
    times = np.linspace(0, 19.97, 400)
    batch = kernels.full_batch(oracle.GH, [0.2], 0.1, t_end=20.0)
    truth = Follower(batch, DOP853, FULL, tol=1e-13).at(times).y
    errors = [
        np.abs(Follower(batch, RK4, FULL, dt=dt).at(times).y - truth).max() for dt in (0.04, 0.02)
    ]
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.15)
    # Of the eighth order: what a step aside adds is no more than what the steps have.
    _, t, y = follow(batch, tol=1e-5)
    at_steps = np.abs(y - Follower(batch, DOP853, FULL, tol=1e-13).at(t).y).max()
    between = np.abs(Follower(batch, DOP853, FULL, tol=1e-5).at(times).y - truth).max()
    assert 1e-12 < between < 2 * at_steps


# --- channels ------------------------------------------------------------------------------------


def everything(**options):
    return rs.trajectory(GH, channels=list(CHANNELS), **options).table


def test_channels_of_the_state_agree_with_the_oracle():
    table = everything(n_i=-0.3, omega_xy0=0.1, t_end=60.0, points=61)
    modes = rs.modes(GH)
    assert list(table) == list(CHANNELS)
    assert table.drop(columns="C_I").notna().all(axis=None)
    for row in table.itertuples():
        u = np.array([row.u_x, row.u_y, row.u_z])
        y = np.concatenate([u, [row.omega_x, row.omega_y, row.omega_z]])
        assert row.n == pytest.approx(oracle.spin(y), abs=1e-15)
        assert row.energy == pytest.approx(oracle.energy(y, oracle.GH), rel=1e-12)
        r = oracle.contact_point(u, oracle.GH)
        assert [row.contact_x, row.contact_y, row.contact_z] == pytest.approx(r, abs=1e-14)
        force = oracle.force_components(y, oracle.GH)
        assert (row.F_normal, row.F_tangential) == pytest.approx(force, abs=1e-12)
        casimir = oracle.reduced_C_I([0, row.E_p, row.E_r], modes.K_p, modes.K_r)
        assert abs(row.C_I / casimir - 1) < 1e-12


def test_attitude_and_trace_agree_with_rigid_body_kinematics():
    """SciPy turns a quaternion by omega and adds up the velocity of the contact point."""
    t_end = 15.0

    def rhs(t, y):
        state, q = y[:6], y[6:10]
        dy = oracle.rhs(t, state, oracle.GH)
        turn = Rotation.from_quat(q, scalar_first=True)
        w = state[3:]
        dq = 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])
        # The centre moves with r x omega; the contact point is r away from it.
        r = oracle.contact_point(state[:3], oracle.GH)
        dr = oracle.contact_point_dot(state[:3], dy[:3], oracle.GH)
        place = turn.apply(np.cross(r, w) + dr + np.cross(w, r))
        return np.concatenate([dy, dq, place])

    table = everything(n_i=0.3, omega_xy0=0.1, t_end=t_end, points=31, tol=1e-12)
    q0 = table.loc[0, ["q0", "q1", "q2", "q3"]].to_numpy()
    start = oracle.launch(oracle.GH, 0.3, 0.1, oracle.relevant_psi(oracle.GH, 0.3))
    found = solve_ivp(
        rhs, (0, t_end), np.concatenate([start, q0, [0, 0, 0]]), method="DOP853",
        t_eval=table["t"], rtol=1e-11, atol=1e-13,
    ).y  # fmt: skip
    quaternions = table[["q0", "q1", "q2", "q3"]].to_numpy()
    assert quaternions == pytest.approx(found[6:10].T, abs=1e-8)
    assert table[["trace_x", "trace_y"]].to_numpy() == pytest.approx(found[10:12].T, abs=1e-8)
    assert np.abs(found[12]).max() < 1e-9
    assert np.linalg.norm(quaternions, axis=1) == pytest.approx(1, abs=1e-14)
    # The vertical, taken back into the body's frame, is u.
    turns = Rotation.from_quat(quaternions, scalar_first=True)
    up = turns.apply([0, 0, 1], inverse=True)
    assert up == pytest.approx(table[["u_x", "u_y", "u_z"]].to_numpy(), abs=1e-14)
    # The heading is that of the x axis in the plane.
    ahead = turns.apply([1, 0, 0])
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    assert table["yaw"].to_numpy() == pytest.approx(heading, abs=1e-12)


def test_attitude_does_not_depend_on_the_rows():
    options = {"n_i": 0.5, "omega_xy0": 0.01, "t_end": 400.0, "channels": ["t", "yaw", "trace_x"]}
    steps = rs.trajectory(GH, steps=True, **options).table
    assert len(steps) > 3000  # more than one table of steps
    rows = rs.trajectory(GH, times=steps["t"], **options).table
    assert rows.to_numpy() == pytest.approx(steps.to_numpy(), abs=1e-10)


def test_mode_energies_are_those_of_the_launch_and_nearly_those_of_the_reduced_model():
    table = everything(n_i=0.02, omega_xy0=0.01, t_end=50.0, points=501)
    assert table["E_p"].iloc[0] == pytest.approx(table["E_p_reduced"].iloc[0], rel=1e-12)
    assert table["E_p"].to_numpy() == pytest.approx(table["E_p_reduced"].to_numpy(), rel=0.02)
    # The modes of a spinning body are not quite those without spin.
    assert table["E_r"].max() < 0.03 * table["E_p"].min()
    assert table["n"].to_numpy() == pytest.approx(table["n_reduced"].to_numpy(), abs=2e-4)
    assert table["n_gh"].to_numpy() == pytest.approx(table["n_reduced"].to_numpy(), abs=1e-10)


def test_closed_solution():
    run = rs.trajectory(GH, n_i=0.1, omega_xy0=0.01, model="gh", channels=["t", "n", "n_gh"])
    assert run.zeros == [rs.reversal_time_gh(GH, 0.1, 0.01)]
    assert run.table["n"].equals(run.table["n_gh"])
    zero = rs.trajectory(GH, n_i=0.1, omega_xy0=0.01, model="gh", times=run.zeros)
    assert zero.table["n"].item() == pytest.approx(0, abs=1e-16)
    assert run.table["n"][0] == pytest.approx(0.1)


# --- rows, chunks, memory ------------------------------------------------------------------------


def test_rows_that_are_asked_for():
    long = rs.trajectory(GH, n_i=-0.1, omega_xy0=0.01, t_end=3000).table["t"]
    assert long.diff().max() <= 2 * np.pi / rs.modes(GH).omega_p / 20
    options = {"n_i": 0.1, "omega_xy0": 0.01, "t_end": 10.0}
    assert len(rs.trajectory(GH, **options).table) == 2001
    assert rs.trajectory(GH, points=3, **options).table["t"].tolist() == [0, 5, 10]
    by_dt = rs.trajectory(GH, dt=0.1, **options).table["t"].to_numpy()
    assert (len(by_dt), by_dt[-1]) == (101, 10.0)
    assert len(rs.trajectory(GH, dt=3, **options).table) == 4
    steps = rs.trajectory(GH, steps=True, **options)
    assert steps.table["t"].iloc[[0, -1]].tolist() == [0, 10]
    assert len(steps.table) == 1 + steps.n_steps
    assert steps.units == {"t": "sqrt(a/g)", "n": "sqrt(g/a)"}


def test_a_run_can_be_left_and_watched():
    shares = []
    course = Course(Launch(GH, 0.1, 0.01, 3000.0), rows=Rows(50_000), watch=shares.append)
    first = next(iter(course))
    assert len(first["n"]) == CHUNK
    assert 0 < course.t < 1500
    assert shares == sorted(shares)


def test_a_million_points_in_bounded_memory():
    channels = ("t", "n", "F_normal")
    course = Course(Launch(GH, 0.1, 0.01, 2e4), channels=channels, rows=Rows(1_000_000))
    rows, t = 0, 0.0
    tracemalloc.start()
    for chunk in course:
        assert (chunk["t"] >= t).all()
        t, rows = chunk["t"][-1], rows + len(chunk["n"])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (rows, t) == (1_000_000, 2e4)
    # One column of a million numbers alone would be 8 MB.
    assert peak < 6e6


def test_a_run_that_fails_says_so_and_keeps_what_was_good():
    batch = kernels.full_batch(oracle.GH, [0.1], t_end=100.0)
    follower, t, y = follow(batch, max_steps=50)
    assert follower.status == Status.STEP_LIMIT
    assert 0 < t[-1] < 100
    assert np.isfinite(y).all()
    found = Follower(batch, DOP853, FULL, max_steps=50).at(np.linspace(0, 100, 201))
    assert 0 < len(found.t) < 201


@pytest.mark.slow  # likewise
def test_a_step_that_is_too_long_says_so():
    coarse = rs.trajectory(GH, n_i=-0.1, omega_xy0=0.01, method="rk4", dt_step=1.0, t_end=600.0)
    sweep = integrate(kernels.full_batch(oracle.GH, [-0.1], t_end=600.0), RK4, FULL, dt=1.0)
    assert coarse.status == Status(sweep.status[0]).label != "ok"


BAD = [
    ({"channels": ["t", "omga_x"]}, "did you mean .omega_x"),
    ({"channels": ["n", "n"]}, "n is named 2 times"),
    ({"channels": []}, "none is named"),
    ({"channels": ["u_x"], "model": "reduced"}, "u_x is not of the model reduced"),
    ({"points": 1}, "from 2 on"),
    ({"points": 5, "dt": 0.1}, "points and dt are both given"),
    ({"dt": -1.0}, "must be positive"),
    ({"dt": math.nan}, "must be finite"),
    ({"times": [0, 2, 1]}, "they must increase"),
    ({"times": [0, 11]}, "t_end = 10"),
    ({"times": [[0, 1]]}, "a list of finite numbers"),
    ({"steps": True, "model": "gh"}, "the model gh takes none"),
    ({"e_r0": 1e-5}, "no channel asks for it"),
    ({"e_r0": -1.0, "model": "reduced"}, "from 0 to"),
    ({"n_i": 0.0, "t_end": None}, "t_end: missing; a launch without spin has no t_rGH"),
    ({"omega": (0, 0, 1)}, "n_i and omega_xy0 given with a full state"),
    ({"method": "euler"}, "euler"),
    ({"tol": -1.0}, "tol"),
    ({"t_end": -1.0}, "-1"),
    ({"psi": "sideways"}, "sideways"),
]


@pytest.mark.parametrize(("wrong", "words"), BAD, ids=str)
def test_bad_arguments(wrong, words):
    with pytest.raises(ConfigError, match=words):
        rs.trajectory(GH, **({"n_i": 0.1, "omega_xy0": 0.01, "t_end": 10.0} | wrong))


def test_more_than_one_run_is_refused():
    with pytest.raises(ValueError, match="2 runs"):
        Follower(kernels.full_batch(oracle.GH, [0.1, 0.2]), DOP853, FULL)
