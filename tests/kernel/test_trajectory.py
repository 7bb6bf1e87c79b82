"""One run as a time series: the sweep's own steps and reversals, states at any
times.
"""

import tracemalloc
from dataclasses import replace

import kernels
import numpy as np
import oracle
import pytest
from natural import natural
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from sweeping import invoke, sweep

import rattlesweep as rs
from rattlesweep.analysis.onerun.channels import CHANNELS
from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.design.launch import Launch
from rattlesweep.kernel import abreast as abreast_module
from rattlesweep.kernel import follow as follow_module
from rattlesweep.kernel.abreast import follow_abreast
from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.follow import Follower
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.kernel.state.status import Status
from rattlesweep.motion.model import FULL, FULL_ELLIPSOID

GH = rs.Rattleback.gh()
DOP853 = METHODS["dop853"]
RK4 = METHODS["rk4"]
every_method = kernels.methods("dop853", "rk4")


def follow(batch, method=DOP853, model=FULL, **options):
    """Return the follower at its end, and times and states of all accepted steps."""
    follower = Follower(batch, method, model, **options)
    parts = [follower.launch()]
    while not follower.ended:
        parts.append(follower.steps())
    return follower, *(
        np.concatenate([getattr(p, name) for p in parts]) for name in "ty"
    )


@every_method
@pytest.mark.parametrize(("n_i", "t_end"), [(0.1, 900.0), (-0.1, 7.3)])
def test_reversal_and_last_step_are_those_of_the_sweep_bit_for_bit(method, n_i, t_end):
    batch = kernels.full_batch(oracle.GH, [n_i], 0.01, psi=1.1, t_end=t_end)
    out = integrate(batch, method, FULL, dt=0.01, tol=1e-8)
    follower, t, y = follow(batch, method, dt=0.01, tol=1e-8)
    assert (follower.status, t[-1]) == (Status.OK, t_end)
    assert np.all(np.diff(t) > 0)
    if np.isnan(out.t_r[0]):
        assert (follower.zeros, follower.n_steps) == ([], out.n_steps[0])
        assert y[-1].tobytes() == out.y_end[0].tobytes()
    else:
        assert out.t_r[0] == follower.zeros[0]


@pytest.mark.parametrize(("most_ahead", "begun"), [(100, 1), (1, 2)])
def test_an_ellipsoid_is_followed_once_unless_the_run_is_long(
    most_ahead, begun, monkeypatch
):
    flat = kernels.full_batch(oracle.GH, [0.1], t_end=60.0)
    batch = replace(flat, constants=np.append(flat.constants, [[0.3]], axis=1))
    monkeypatch.setattr(follow_module, "STEPS_PER_CALL", 50)
    monkeypatch.setattr(follow_module, "CALLS_AHEAD", most_ahead)
    begins = []
    call = Follower._call

    def counted(self, rows, **options):
        begins.append(options["begins"])
        return call(self, rows, **options)

    monkeypatch.setattr(Follower, "_call", counted)
    follower, t, y = follow(batch, model=FULL_ELLIPSOID)
    stretches = -(-follower.n_steps // 50)
    assert stretches > 2
    assert begins.count(True) == begun
    assert begins.count(False) == begun * stretches
    out = integrate(batch, DOP853, FULL_ELLIPSOID)
    assert np.isnan(out.t_r[0])
    assert t[-1] == out.t_end[0]
    assert y[-1].tobytes() == out.y_end[0].tobytes()


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
    # The last grid was that of the steps, whose size is known up to the rounding of t.
    assert found.y == pytest.approx(y, abs=1e-13)


def test_runs_abreast_have_the_bits_of_runs_followed_alone(monkeypatch):
    spins = [0.4, -0.2, 0.1, 0.3, -0.1, 0.25, 0.15, 0.35, 0.05, 0.2]
    batch = kernels.full_batch(oracle.GH, spins, t_end=150.0)
    batch = replace(batch, t_end=np.linspace(20.0, 150.0, len(spins)))
    times = [np.linspace(0, 1.2 * end, 40) for end in batch.t_end]
    options = {"tol": 1e-9, "max_steps": 10**6, "attitude": True}
    runs = follow_abreast(batch, DOP853, FULL, times, **options)
    for row, run in enumerate(runs):
        alone = Follower(kernels.take(batch, [row]), DOP853, FULL, **options)
        found = alone.at(times[row])
        assert 30 < len(found.t) < 40
        for name in ("t", "y", "slip", "sense", "extra"):
            abreast = getattr(run.samples, name)
            assert abreast.tobytes() == getattr(found, name).tobytes()
        assert run.observe(found).tobytes() == alone.observe(found).tobytes()
        assert run.energy_0 == alone.energy_0
    # One that is longer than the tables is followed alone.
    monkeypatch.setattr(abreast_module, "STEPS_PER_CALL", 100)
    [short, long] = follow_abreast(
        kernels.take(batch, [0, 9]), DOP853, FULL, [times[0], times[9]], **options
    )
    assert short is not None
    assert long is None


def everything(**options):
    return rs.trajectory(GH, channels=list(CHANNELS), **options).table


def test_channels_of_the_state_agree_with_the_oracle():
    table = everything(n_i=-0.3, omega_xy0=0.1, t_end=60.0, points=61)
    modes = rs.modes(GH)
    assert list(table) == list(CHANNELS)
    assert table.drop(columns=["C_I", "slip_angle"]).notna().all(axis=None)
    for row in table.itertuples():
        u = np.array([row.u_x, row.u_y, row.u_z])
        y = np.concatenate([u, [row.omega_x, row.omega_y, row.omega_z]])
        assert row.n == pytest.approx(oracle.spin(y), abs=1e-15)
        assert row.energy == pytest.approx(oracle.energy(y, oracle.GH), rel=1e-12)
        r = oracle.contact_point(u, oracle.GH)
        assert [row.contact_x, row.contact_y, row.contact_z] == pytest.approx(
            r, abs=1e-14
        )
        force = oracle.force_components(y, oracle.GH)
        assert (row.F_normal, row.F_tangential) == pytest.approx(force, abs=1e-12)
        casimir = oracle.reduced_C_I([0, row.E_p, row.E_r], modes.K_p, modes.K_r)
        assert abs(row.C_I / casimir - 1) < 1e-12


def test_attitude_and_trace_agree_with_rigid_body_kinematics():
    """SciPy integrates a quaternion by omega, and the velocity of the contact point."""
    t_end = 15.0

    def rhs(t, y):
        state = y[:6]
        q = y[6:10]
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
        rhs,
        (0, t_end),
        np.concatenate([start, q0, [0, 0, 0]]),
        method="DOP853",
        t_eval=table["t"],
        rtol=1e-11,
        atol=1e-13,
    ).y
    state = ["u_x", "u_y", "u_z", "omega_x", "omega_y", "omega_z"]
    assert table[state].to_numpy() == pytest.approx(found[:6].T, abs=1e-8)
    quaternions = table[["q0", "q1", "q2", "q3"]].to_numpy()
    assert quaternions == pytest.approx(found[6:10].T, abs=1e-8)
    assert table[["trace_x", "trace_y"]].to_numpy() == pytest.approx(
        found[10:12].T, abs=1e-8
    )
    assert np.abs(found[12]).max() < 1e-9
    # The heading is that of the x axis in the plane.
    ahead = Rotation.from_quat(quaternions, scalar_first=True).apply([1, 0, 0])
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    assert table["yaw"].to_numpy() == pytest.approx(heading, abs=1e-12)


@pytest.mark.slow
def test_attitude_of_an_ellipsoid_that_rolls_onto_its_side(tmp_path):
    """SciPy integrates a quaternion by omega, and the path by the contact point."""
    config = {
        "seed": 1,
        "bodies": {"source": "sd", "samples": 10, "c": 2},
        "spin": {"n_i": -0.5, "omega_xy0": 0.1},
        "horizon": {"t_rgh": 5},
    }
    output = tmp_path / "out"
    sweep(output, config)
    names = ["t", "u_x", "u_y", "u_z", "omega_x", "omega_y", "omega_z", "yaw"]
    names += ["contact_x", "contact_y", "contact_z", "q0", "q1", "q2", "q3"]
    run = rs.replay(output, 0, 8, channels=[*names, "trace_x", "trace_y"], dt=0.005)
    assert run.status == "ok"
    table = run.table
    t, u, omega, r, q, trace = (
        table[[name for name in table if name.startswith(start)]].to_numpy()
        for start in ("t", "u_", "omega", "contact", "q", "trace")
    )
    t = t[:, 0]
    assert u[:, 2].min() < 0 < u[:, 2].max()
    turning = CubicSpline(t, omega)
    moving = CubicSpline(t, r).derivative()

    def rhs(t, y):
        q, w = y[:4], turning(t)
        dq = 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])
        turn = Rotation.from_quat(q, scalar_first=True)
        return np.concatenate([dq, turn.apply(moving(t))[:2]])

    start = np.concatenate([q[0], trace[0]])
    span = (0, t[-1])
    found = solve_ivp(
        rhs, span, start, "DOP853", t_eval=t[::200], rtol=1e-9, atol=1e-11
    ).y
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() < 1e-12
    turns = Rotation.from_quat(q, scalar_first=True)
    wanted = Rotation.from_quat(found[:4].T, scalar_first=True)
    assert np.abs(turns.as_matrix()[::200] - wanted.as_matrix()).max() < 1e-6
    assert np.abs(trace[::200] - found[4:].T).max() < 1e-5
    # Where the vertical is in the axes of the body, and the heading of the x axis.
    up = turns.inv().apply([0, 0, 1])
    assert np.abs(up - u).max() < 1e-12
    ahead = turns.apply([1, 0, 0])
    heading = np.arctan2(ahead[:, 1], ahead[:, 0])
    off = np.angle(np.exp(1j * (table["yaw"].to_numpy() - heading)))
    assert np.abs(off).max() < 1e-9
    page = tmp_path / "side.html"
    shown = invoke("show", output, "--case", 0, "--sample", 8, "--output", page)
    assert (shown.exit_code, page.exists()) == (0, True)


def test_requested_rows():
    long = rs.trajectory(GH, n_i=-0.1, omega_xy0=0.01, t_end=3000).table["t"]
    assert long.diff().max() <= 2 * np.pi / rs.modes(GH).omega_p / 20
    options = {"n_i": 0.1, "omega_xy0": 0.01, "t_end": 10.0}
    for rows, last in ({}, 2001), ({"points": 3}, 3), ({"dt": 0.1}, 101):
        t = rs.trajectory(GH, **rows, **options)["t"].to_numpy()
        assert (len(t), t[-1]) == (last, 10.0)
    steps = rs.trajectory(GH, steps=True, **options)
    assert steps.table["t"].iloc[[0, -1]].tolist() == [0, 10]
    assert len(steps.table) == 1 + steps.n_steps
    assert steps.units == {"t": "sqrt(a/g)", "n": "sqrt(g/a)"}


def test_a_million_points_in_bounded_memory():
    channels = ("t", "n", "F_normal")
    run = PreparedRun.of(Launch(GH, 0.1, 0.01, 2e4))
    course = Course(run, channels, points=1_000_000)
    rows = 0
    t = 0.0
    tracemalloc.start()
    for chunk in course:
        assert (chunk["t"] >= t).all()
        t = chunk["t"][-1]
        rows = rows + len(chunk["n"])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (rows, t) == (1_000_000, 2e4)
    # Three columns of a million numbers would be 24 MB; the times are 8 MB.
    assert peak < 1.4e7


def test_a_failed_run_says_so_and_keeps_its_good_steps():
    batch = kernels.full_batch(oracle.GH, [0.1], t_end=100.0)
    follower, t, y = follow(batch, max_steps=50)
    assert follower.status == Status.STEP_LIMIT
    assert 0 < t[-1] < 100
    assert np.isfinite(y).all()
    found = Follower(batch, DOP853, FULL, max_steps=50).at(np.linspace(0, 100, 201))
    assert 0 < len(found.t) < 201


def test_a_dead_body_is_followed_to_the_horizon():
    launch = {"n_i": 0.3, "omega_xy0": 0.1, "t_end": 800.0, "sigma": 0.02}
    found = rs.trajectory(GH, points=801, **launch)
    run = rs.simulate(GH, record=["reversals"], **launch)
    assert (found.status, found.t_end, len(found.table)) == ("ok", 800, 801)
    # What is left of the spin decays; its zeros then are no reversals.
    assert found.table.n.iloc[-1] == pytest.approx(run.n_end, abs=1e-16)
    assert 0 < abs(found.table.n.iloc[-1]) < 1e-2
    assert found.zeros.max() < 100


@pytest.mark.slow
def test_the_contact_point_of_a_body_that_may_slide():
    omega = (0.1, -0.05, -0.3)
    u = np.array([0.06, 0.08, -np.sqrt(0.99)])
    names = ["contact_x", "contact_y", "contact_z"]
    for losses in ({}, {"mu": 5.0}, {"mu": 5.0, "sigma": 1e-3}):
        found = rs.trajectory(
            GH, omega=omega, u=u, t_end=1.0, points=2, channels=names, **losses
        )
        point = oracle.contact_point(u, oracle.GH)
        assert found.table.loc[0].to_numpy() == pytest.approx(point, abs=1e-12)


LOW = {
    "alpha": 10.035408776710417,
    "beta": 1.5949252516116899,
    "gamma": 9.630334028322107,
    "theta": 0.6553645686412248,
    "phi": 0.06132069405832485,
    "xi": -0.09841503537328168,
    "c": 2.0,
}


def test_a_body_that_rolls_onto_its_side_goes_on_as_in_a_sweep():
    """The launch of a low ellipsoid whose roll grows until it lies on its side."""
    body = rs.Rattleback(**LOW)
    launch = {"n_i": -0.5, "omega_xy0": 0.01, "t_end": 605.0}
    run = rs.simulate(body, **launch)
    channels = [
        "t",
        "n",
        "energy",
        "u_x",
        "u_y",
        "u_z",
        "F_normal",
        "contact_x",
        "contact_y",
        "contact_z",
    ]
    found = rs.trajectory(body, channels=channels, points=4001, **launch)
    assert (found.status, run.status) == ("ok", "ok")
    assert found.t_end == 605
    assert found.zeros[0] == run.t_r
    table = found.table
    assert table.u_z.max() > 0
    assert np.linalg.norm(table[["u_x", "u_y", "u_z"]], axis=1) == pytest.approx(1)
    assert table.energy.to_numpy() == pytest.approx(table.energy[0], rel=1e-6)
    # The contact point is the lowest point of the body, on its ellipsoid.
    u = table[["u_x", "u_y", "u_z"]].to_numpy()
    r = table[["contact_x", "contact_y", "contact_z"]].to_numpy()
    centre = np.array([0, 0, 1 - LOW["c"]])
    assert (np.sum((r - centre) * u, axis=1) < 0).all()


def test_the_angle_of_the_long_axis_is_that_of_the_attitude_with_its_turns():
    stone = rs.Rattleback.half_ellipsoid(
        length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="20 deg"
    )
    names = ["q0", "q1", "q2", "q3", "yaw", "angle_deg"]
    launch = natural(n_i=0.3, omega_xy0=0.1, t_end=60)
    run = rs.trajectory(stone, **launch, points=601, channels=names)
    turn = Rotation.from_quat(run.table[names[:4]].to_numpy(), scalar_first=True)
    along = turn.apply([-np.sin(stone.xi), np.cos(stone.xi), 0])
    expected = np.degrees(np.unwrap(np.arctan2(along[:, 1], along[:, 0])))
    angle = run.table["angle_deg"].to_numpy()
    assert np.ptp(angle) > 360
    assert angle - angle[0] == pytest.approx(expected - expected[0], abs=1e-9)
    behind = np.degrees(run.table["yaw"].to_numpy()) - angle
    # A tilt lets the axis deviate from the heading of the x axis.
    assert behind == pytest.approx(90 + np.degrees(stone.xi), abs=40)
    assert np.ptp(behind) > 1
