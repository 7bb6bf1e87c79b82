"""The lane kernel: reversal times, first zeros, identical bits, statuses,
observations.
"""

import dataclasses
import time

import kernels
import numpy as np
import oracle
import pytest
from samples import dumbbells, mapping
from scipy.integrate import solve_ivp

from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.follow import Follower
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.kernel.recipes import RECORDINGS
from rattlesweep.kernel.runs import MAX_ENERGY_DRIFT
from rattlesweep.kernel.state.fields import LANES
from rattlesweep.kernel.state.status import Status
from rattlesweep.kernel.step.explicit import SUBSTEPS
from rattlesweep.kernel.task import Task
from rattlesweep.motion.model import FULL, MODELS, REDUCED, find_model
from rattlesweep.physics import full, theory
from rattlesweep.physics.full import scalar

GH = oracle.GH
DOP853 = METHODS["dop853"]
RK4 = METHODS["rk4"]
# By `oracle.first_reversal`.
T_UNSTEADY = 112.093877963873
T_STEADY = 809.857417847725
every_method = kernels.methods("dop853", "rk4")
both_kinds = pytest.mark.parametrize("method", [DOP853, RK4], ids=["dop853", "rk4"])
also_dopri5 = pytest.mark.parametrize(
    "name", ["dop853", pytest.param("dopri5", marks=pytest.mark.slow)]
)


def assert_status(outcome, status):
    assert [Status(s) for s in outcome.status] == [status] * len(outcome.status)


def shell_dumbbells(count, seed):
    """Random bodies as a mapping of arrays, with spins and oscillations at launch."""
    rng = np.random.default_rng(seed)
    inertia = dumbbells(rng.uniform(5, 15, count), rng.uniform(0.05, 0.15, count))
    theta = rng.uniform(0.6, 0.95, count)
    phi = rng.uniform(0.01, 0.1, count)
    body = mapping((*inertia, theta, phi, -np.radians(rng.uniform(0.5, 10, count))))
    n_i = rng.choice([-1, 1], count) * rng.uniform(0.1, 0.5, count)
    return body, n_i, rng.choice([0.01, 0.1], count)


def mixed(count, seed=7, t_end=40.0):
    """Runs of different bodies and lengths, some with a reversal."""
    rng = np.random.default_rng(seed)
    return kernels.full_batch(
        *shell_dumbbells(count, seed), t_end=rng.uniform(2, t_end, count)
    )


@every_method
def test_gh_reversal_times_at_defaults(method):
    runs = kernels.full_batch(GH, [0.1, -0.1])
    out = integrate(runs, method, FULL)
    assert_status(out, Status.OK)
    assert out.t_r == pytest.approx([T_UNSTEADY, T_STEADY], rel=1e-6)
    assert np.array_equal(out.t_r, out.t_end)
    assert out.n_end == pytest.approx([0, 0], abs=1e-14)
    assert np.abs(out.energy_drift).max() < 1e-7
    after = [
        full.energy(tuple(y), tuple(q))
        for y, q in zip(out.y_end, runs.constants, strict=True)
    ]
    assert out.energy_drift == pytest.approx(after / out.energy_0 - 1, abs=1e-14)
    assert out.n_departure == pytest.approx([1, 1])
    assert (out.amp_growth > 1).all()


@pytest.mark.parametrize(
    ("count", "seed"), [(9, 23), pytest.param(40, 11, marks=pytest.mark.slow)]
)
def test_random_bodies_reverse_when_the_oracle_says(count, seed):
    body, n_i, omega = shell_dumbbells(count, seed=seed)
    omega[: count // 2] = 0.1
    e_p, e_r = kernels.mode_energies(body, n_i, omega)
    modes = theory.modes(*(body[x] for x in ("alpha", "beta", "theta", "phi", "xi")))
    speed = np.sqrt(2 * (e_p + e_r) / body["gamma"])
    t_gh = theory.GarciaHubbard(
        np.where(n_i > 0, modes.K_p, modes.K_r), n_i, speed
    ).t_rgh
    # Early reversals are awaited; other runs only show that none comes early.
    t_end = np.where(t_gh < 40, 1.3 * t_gh, 10.0)
    out = integrate(kernels.full_batch(body, n_i, omega, t_end=t_end), DOP853, FULL)
    expected = np.full(count, np.nan)
    for k in range(count):
        one = {name: float(value[k]) for name, value in body.items()}
        t_r, y = oracle.first_reversal(
            one,
            n_i[k],
            omega[k],
            oracle.relevant_psi(one, n_i[k]),
            t_end[k],
            1e-10,
            samples=12,
        )
        expected[k] = np.nan if t_r is None else t_r
        assert out.y_end[k] == pytest.approx(full.from_vectors(y[:3], y[3:]), abs=1e-7)
    assert_status(out, Status.OK)
    assert 2 < np.isfinite(expected).sum() < count - 2
    assert out.t_r == pytest.approx(expected, rel=1e-6, nan_ok=True)
    assert np.array_equal(out.t_end[np.isnan(expected)], t_end[np.isnan(expected)])


@both_kinds
def test_threads_order_and_other_runs_do_not_matter(method):
    runs = mixed(75)
    whole = integrate(runs, method, FULL, threads=1, dt=0.01)
    assert np.isfinite(whole.t_r).any()
    assert np.isnan(whole.t_r).any()
    kernels.assert_same(integrate(runs, method, FULL, threads=2, dt=0.01), whole)
    shuffled = np.random.default_rng(3).permutation(75)
    mixed_up = integrate(kernels.take(runs, shuffled), method, FULL, dt=0.01)
    kernels.assert_same(mixed_up, kernels.pick(whole, shuffled))
    for k in (0, 37, 74):
        alone = integrate(kernels.take(runs, [k]), method, FULL, dt=0.01)
        kernels.assert_same(alone, kernels.pick(whole, [k]))


# GH launched with 0.1 along the pitch: the spin just touches zero
# (`oracle.first_reversal`).
TOUCH = 0.00663381740279008
T_TOUCH = 1.967217
T_NEXT = 3.13791070912


@also_dopri5
@pytest.mark.parametrize("tol", [1e-6, 1e-8, 1e-9, 1e-12])
def test_no_first_zero_is_missed_around_the_touch(name, tol):
    # Launches on both sides on a logarithmic scale, with dips from 1e-4 to 1e-15 deep.
    away = np.logspace(-13, -2, 100) * TOUCH
    n_i = np.concatenate([TOUCH - away, TOUCH + away])
    out = integrate(
        kernels.full_batch(GH, n_i, 0.1, t_end=6.0), METHODS[name], FULL, tol=tol
    )
    assert_status(out, Status.OK)
    late = out.t_r > 2.5
    wrong = late != (n_i > TOUCH)
    # If the method's own error decides, the run must be counted as doubtful.
    assert (out.near_tangencies[wrong] > 0).all()
    assert np.abs(n_i - TOUCH)[wrong].max(initial=0) < 10 * tol
    assert min(late.sum(), (~late).sum()) > 30
    # Clear cases are not counted.
    assert tol > 1e-9 or not out.near_tangencies[np.abs(n_i - TOUCH) > 1e-5].any()


def test_energy_that_is_off_by_more_than_a_hundredth_has_a_status():
    dt = np.array([0.05, 0.2, 0.3, 0.4, 0.5])
    runs = kernels.full_batch(GH, 0.5, 0.3, t_end=400.0)
    found = [integrate(runs, RK4, FULL, dt=x) for x in dt]
    for out in found:
        off = abs(out.energy_drift[0])
        if out.status[0] == Status.OK:
            assert off <= MAX_ENERGY_DRIFT
        elif out.status[0] == Status.ENERGY:
            assert off > MAX_ENERGY_DRIFT
            assert np.isnan(out.t_r[0])
    assert {int(out.status[0]) for out in found} >= {int(Status.OK), int(Status.ENERGY)}


@both_kinds
def test_runs_end_at_the_most_steps(method):
    out = integrate(kernels.full_batch(GH, [0.1, -0.1]), method, FULL, max_steps=80)
    assert_status(out, Status.STEP_LIMIT)
    assert np.isnan(out.t_r).all()
    assert (out.n_steps + out.n_rejected <= 80 + SUBSTEPS).all()
    assert (out.t_end < 100).all()


@both_kinds
def test_nonfinite_states_end_at_once_and_leave_the_neighbours_alone(method):
    runs = mixed(LANES)
    alone = integrate(runs, method, FULL, dt=0.01)
    y0 = runs.y0.copy()
    y0[5, 2] = np.nan
    y0[9, 4] = np.inf
    y0[11, 0] = 1e200
    out = integrate(dataclasses.replace(runs, y0=y0), method, FULL, dt=0.01)
    assert [Status(int(s)) for s in out.status[[5, 9, 11]]] == [Status.NONFINITE] * 3
    assert np.isnan(out.t_r[[5, 9, 11]]).all()
    rest = np.delete(np.arange(LANES), [5, 9, 11])
    kernels.assert_same(kernels.pick(out, rest), kernels.pick(alone, rest))


# Methods and what is recorded; with tangents, the model is another one.
WITHOUT_TANGENTS = [name for name in RECORDINGS if name != "lyapunov"]
records = pytest.mark.parametrize(
    ("method", "recorded"),
    [
        pytest.param(DOP853, WITHOUT_TANGENTS, id="dop853"),
        pytest.param(RK4, WITHOUT_TANGENTS, id="rk4"),
        pytest.param(DOP853, RECORDINGS, id="tangents", marks=pytest.mark.slow),
    ],
)


@records
def test_recording_changes_nothing_else(method, recorded):
    runs = mixed(70)
    # With reversals or late recorded, runs continue after the first reversal.
    whole = ("reversals", "late")
    others = tuple(name for name in recorded if name not in whole)
    plain = integrate(runs, method, FULL, dt=0.01)
    # What is recorded has no rows without a record.
    extra = tuple(name for name, rows in vars(plain).items() if np.size(rows) == 0)
    for record in (*((name,) for name in others), others):
        out = integrate(runs, method, FULL, dt=0.01, record=frozenset(record))
        kernels.assert_same(out, plain, skip=extra)
        recorded_runs = 70 if "windows" in record else 0
        assert out.windows.shape == (recorded_runs, kernels.N_WINDOWS, 3)


@records
def test_records_are_those_of_the_trajectory(method, recorded):
    t_end = 12.8
    n_windows = 8
    launches = [(0.5, 0.03), (-0.3, 0.03), (0.3, 0.02), (0.1, 0.01)]
    n_i, omega = np.array(launches).T
    runs = kernels.full_batch(GH, n_i, omega, t_end=t_end)
    runs = dataclasses.replace(runs, window=runs.t_end / n_windows)
    out = integrate(runs, method, FULL, record=frozenset(recorded))
    assert_status(out, Status.OK)
    assert (out.t_end == t_end).all()
    # In windows, only the ends of steps are observed, and adaptive steps are a large
    # part of a swing long.
    amplitude, spin = (0.005, 0.02) if method is RK4 else (0.08, 0.2)
    t = np.linspace(0, t_end, 1601)
    for k in range(len(launches)):
        y0 = oracle.launch(GH, n_i[k], omega[k], oracle.relevant_psi(GH, n_i[k]))
        y = solve_ivp(
            oracle.rhs,
            (0, t_end),
            y0,
            "DOP853",
            args=(GH,),
            rtol=1e-11,
            atol=1e-14,
            t_eval=t,
        ).y
        normal, tangential = np.array([oracle.force_components(x, GH) for x in y.T]).T
        ratio = (tangential / normal).max()
        assert out.extreme("contact_ratio_max")[k] == pytest.approx(ratio, rel=1e-4)
        assert out.extreme("contact_normal_min")[k] == pytest.approx(
            normal.min(), rel=1e-4
        )
        n = np.sum(y[:3] * y[3:], axis=0)
        small = np.concatenate([y[:2] / y[2], y[3:5]])
        size = np.hypot(runs.probe[k, :4] @ small, runs.probe[k, 4:] @ small)
        seen = out.windows[k]
        assert np.isfinite(seen[:n_windows]).all()
        assert np.isnan(seen[n_windows:]).all()
        for i in range(n_windows):
            inside = slice(i * 200, (i + 1) * 200 + 1)
            near = spin * np.ptp(n)
            assert seen[i, 0] == pytest.approx(size[inside].max(), rel=amplitude)
            assert seen[i, 1] == pytest.approx(n[inside].min(), abs=near)
            assert seen[i, 2] == pytest.approx(n[inside].max(), abs=near)
    assert (out.energy_drift_max >= np.abs(out.energy_drift)).all()
    assert out.energy_drift_max.max() < 1e-8
    assert out.energy_0 == pytest.approx(
        [
            oracle.energy(oracle.launch(GH, n, w, oracle.relevant_psi(GH, n)), GH)
            for n, w in launches
        ],
        rel=1e-12,
    )


# Largest ratio of the contact forces and least normal force of twelve bodies, by
# `oracle.extremes_of_contact`.
CONTACT = [
    (0.21366948985083498, 0.786732941783116),
    (0.5947067048512402, 0.33722573186338733),
    (0.8106553921553702, 0.19984514108157575),
    (0.03856697581589371, 0.9968976591521371),
    (0.544351452238443, 0.4417768485627544),
    (0.8131778354236818, 0.422237696493317),
    (0.04146042207278618, 0.9964330380224985),
    (1.053644656308319, 0.24328171119185762),
    (0.6056155339415964, 0.44045647470496085),
    (0.060949404412910045, 0.9902625852156783),
    (0.0898593190453024, 0.9697529260361583),
    (1.2582439868043687, 0.17399525063834534),
]


@pytest.mark.slow
def test_the_extremes_of_the_contact_are_those_of_scipy():
    body, n_i, _ = shell_dumbbells(12, seed=5)
    for k, expected in enumerate(CONTACT):
        one = {name: value[k] for name, value in body.items()}
        y0 = oracle.launch(one, n_i[k], 0.1, oracle.relevant_psi(one, n_i[k]))
        found = oracle.extremes_of_contact(one, y0, 60.0)
        assert found == pytest.approx(expected, rel=1e-10)


@every_method
def test_extremes_between_the_steps_are_found(method):
    """Forces are compared with SciPy's, the spin of each turn with that at many times.

    The times are so close that the largest spin is missed by less than 2e-6.
    """
    body, n_i, _ = shell_dumbbells(12, seed=5)
    t_end = 60.0
    runs = kernels.full_batch(body, n_i, 0.1, t_end=t_end)
    record = frozenset(["contact", "reversals"])
    out = integrate(runs, method, FULL, record=record)
    assert_status(out, Status.OK)
    ratio, normal = np.transpose(CONTACT)
    assert out.extreme("contact_ratio_max") == pytest.approx(ratio, rel=1e-7)
    assert out.extreme("contact_normal_min") == pytest.approx(normal, rel=1e-7)
    t = np.linspace(0, t_end, 30_001)
    turns = 0
    for k in range(len(n_i)):
        exact = Follower(kernels.take(runs, [k]), DOP853, FULL, tol=1e-12)
        spin, *_ = exact.observe(exact.at(t))
        for i in range(out.n_turns[k]):
            start, largest = out.reversals[k, i]
            end = out.reversals[k, i + 1, 0] if i + 1 < out.n_turns[k] else t_end
            inside = (t >= start) & (t <= end)
            assert largest == pytest.approx(np.abs(spin[inside]).max(), rel=2e-6)
            turns += 1
    assert turns > 5


@pytest.mark.parametrize("tol", [1e-6, 1e-7])
def test_long_steps_hide_no_extreme_of_the_contact(tol):
    """What is missing is an error of the integration: it falls with the tolerance."""
    body, n_i, _ = shell_dumbbells(12, seed=5)
    runs = kernels.full_batch(body, n_i, 0.1, t_end=60.0)
    record = frozenset(["contact", "reversals"])
    out = integrate(runs, DOP853, FULL, tol=tol, record=record)
    ratio, normal = np.transpose(CONTACT)
    assert out.extreme("contact_ratio_max") == pytest.approx(ratio, rel=20 * tol)
    assert out.extreme("contact_normal_min") == pytest.approx(normal, rel=20 * tol)


@scalar
def _half_spin(y, constants):
    """Return a function of the state that is zero where the spin is 0.05."""
    return full.spin(y) - 0.05


@pytest.mark.slow
def test_a_run_ends_at_the_limit_of_its_model(monkeypatch):
    model = dataclasses.replace(FULL, name="full_to_half", limit=_half_spin)
    monkeypatch.setitem(MODELS, model.name, model)
    # The second run reaches its horizon first, and the third one does not last.
    runs = kernels.full_batch(GH, 0.1, 0.01, t_end=[300.0, 20.0, 300.0])
    runs.y0[2] *= 1.001
    out = integrate(runs, DOP853, model)
    assert out.status.tolist() == [Status.LIMIT, Status.OK, Status.LIMIT]
    assert out.t_end[1] == 20
    follower = Follower(kernels.take(runs, [0]), DOP853, FULL, tol=1e-12)
    (state,) = follower.at(out.t_end[:1]).y
    assert out.y_end[0] == pytest.approx(state, abs=1e-9)
    assert out.n_end[[0, 2]] == pytest.approx([0.05, 0.05], abs=1e-14)
    # No zero comes before, and a run that starts at the limit goes on from there.
    t = np.linspace(0, out.t_end[0], 20_001)[:-1]
    again = Follower(kernels.take(runs, [0]), DOP853, FULL)
    spin, *_ = follower.observe(again.at(t))
    assert (spin > 0.05).all()
    rest = dataclasses.replace(kernels.take(runs, [0]), y0=out.y_end[:1])
    (t_r,) = integrate(rest, DOP853, FULL, tol=1e-12).t_r
    assert out.t_end[0] + t_r == pytest.approx(T_UNSTEADY, rel=1e-8)


@both_kinds
def test_stop_ends_a_long_batch_soon_and_keeps_what_was_done(method):
    # Stable in its steady direction, so there is no reversal.  The longest runs start
    # first.
    t_end = np.where(np.arange(LANES + 8) < 3, 1e7, 5.0)
    runs = kernels.full_batch(GH, -1.5, 0.001, t_end=t_end)
    job = Task(lambda control: integrate(runs, method, FULL, control=control))
    while job.control.runs_done < LANES + 5 and job.is_alive():
        time.sleep(0.01)
    assert job.is_alive()
    assert not job.control.stopping
    asked = time.monotonic()
    job.stop(10)
    assert time.monotonic() - asked < 1
    out = job.value()
    assert out.stopped
    assert [Status(s) for s in out.status] == [Status.STOPPED] * 3 + [Status.OK] * (
        LANES + 5
    )
    assert np.isnan(out.t_end[:3]).all()
    assert np.isnan(out.t_r).all()
    assert (out.t_end[3:] == 5).all()


@pytest.mark.parametrize(
    "method", [DOP853, pytest.param(RK4, marks=pytest.mark.slow)], ids=["dop853", "rk4"]
)
def test_reduced_model_with_one_mode_is_the_formula(method):
    body, n_i, omega = shell_dumbbells(60, seed=31)
    e_p, e_r = kernels.mode_energies(body, n_i, omega)
    modes = theory.modes(*(body[x] for x in ("alpha", "beta", "theta", "phi", "xi")))
    speed = np.sqrt(2 * (e_p + e_r) / body["gamma"])
    expected = theory.GarciaHubbard(
        np.where(n_i > 0, modes.K_p, modes.K_r), n_i, speed
    ).t_rgh
    runs = kernels.reduced_batch(body, n_i, e_p, e_r, t_end=2 * expected)
    out = integrate(runs, method, REDUCED, dt=0.02)
    assert_status(out, Status.OK)
    assert out.t_r == pytest.approx(expected, rel=1e-9)
    assert np.abs(out.energy_drift).max() < 1e-9


def test_a_decayed_oscillation_leaves_no_subnormal_numbers():
    """Processors take many times as long for these.

    Products of four small numbers, which steps have, must be normal.
    """
    rolling = find_model("full_rolling")
    plain = kernels.full_batch(GH, [-0.2], t_end=3000.0)
    named = dict(zip(FULL.constants, plain.constants[0], strict=True))
    named |= {"k": 0.0, "sigma": 0.0, "rolling": 1e-3, "smoothing": 1e-4}
    batch = dataclasses.replace(
        plain,
        y0=np.append(plain.y0, [[0.0]], axis=1),
        constants=np.array([[named[name] for name in rolling.constants]]),
    )
    outcome = integrate(batch, DOP853, rolling)
    assert_status(outcome, Status.OK)
    moving = np.abs(outcome.y_end[0, :4])
    assert moving.max() < 1e-55
    assert moving.max() ** 4 > np.finfo(float).tiny
