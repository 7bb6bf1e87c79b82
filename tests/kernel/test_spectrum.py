"""All Lyapunov exponents: frames, their growth, sums, an independent program."""

import kernels
import numpy as np
import oracle
import pytest
import spectrum_oracle

import rattlesweep as rs
from rattlesweep.kernel.batch import integrate, longest_frame_steps
from rattlesweep.kernel.growths import exponents
from rattlesweep.kernel.method.tableau import DOP853
from rattlesweep.motion.model import FULL
from rattlesweep.physics import frame, full, steady, tangent

GH = oracle.GH
# A body whose roll goes on long after its pitch has decayed, and one that is stable
# beyond n = -0.25.
ROLLING = {
    "alpha": 8.895,
    "beta": 1.92,
    "gamma": 8.815,
    "theta": 0.9256,
    "phi": 0.01087,
    "xi": -0.06332,
}
STABLE = {
    "alpha": 14.29,
    "beta": 1.8886,
    "gamma": 14.18,
    "theta": 0.9473,
    "phi": 0.01988,
    "xi": -0.03646,
}
SPECTRUM = frozenset(["spectrum", "volume"])


def random_motion(size, seed):
    """Return states, their derivatives, frames and constants."""
    rng = np.random.default_rng(seed)
    for _ in range(size):
        theta = rng.uniform(0.3, 0.95)
        q = full.constants(12.0, 1.6, 11.0, theta, rng.uniform(0.01, 0.2), -0.05)
        y = tuple(rng.standard_normal(5) * [0.3, 0.3, 0.3, 0.3, 1.0])
        q = tuple(map(float, q))
        yield y, full.rhs(y, q), tuple(rng.standard_normal(15)), q


def norm_of(v, q):
    return np.sqrt(tangent.square(v, q))


def test_a_frame_is_factored_into_orthonormal_tangents_and_a_triangle():
    for _, _, v, q in random_motion(20, 1):
        triangle = frame.factor(v, q)
        r11, r22, r33, r12, r13, r23 = triangle
        e = np.reshape(frame.solve(v, triangle), (3, 5))
        r = np.array([[r11, r12, r13], [0, r22, r23], [0, 0, r33]])
        assert r.T @ e == pytest.approx(np.reshape(v, (3, 5)), rel=1e-12)
        for i in range(3):
            assert norm_of(e[i], q) == pytest.approx(1.0)
            for k in range(i):
                # Of an orthonormal pair, the sum is sqrt(2) long.
                assert norm_of(e[i] + e[k], q) == pytest.approx(np.sqrt(2.0))


def test_flow_and_gradient_are_normal_to_transverse_tangents():
    for y, dy, v, q in random_motion(20, 2):
        flow, steep = frame.trivial(y, dy, q)
        assert np.sqrt(flow) == pytest.approx(norm_of(dy, q))
        gradient = np.array(tangent.gradient(y, q))
        # The norm of a gradient is the largest change of energy by a unit tangent.
        random = np.random.default_rng(3).standard_normal((2000, 5))
        changes = [abs(gradient @ w) / norm_of(w, q) for w in random]
        assert 0.8 * np.sqrt(steep) < max(changes) <= np.sqrt(steep)
        for w in np.reshape(frame.transverse(y, dy, v, q), (3, 5)):
            assert gradient @ w == pytest.approx(0.0, abs=1e-12 * np.sqrt(steep))
            square = norm_of(w + np.array(dy), q) ** 2
            assert square == pytest.approx(norm_of(w, q) ** 2 + flow)


def tilt(y):
    """Return the logarithm of an area of slopes over the same area of ``u``."""
    return 1.5 * np.log1p(y[:, 0] ** 2 + y[:, 1] ** 2)


@pytest.fixture(scope="module")
def runs():
    """Runs that reverse, swing, wobble and settle."""
    n_i = [-0.1, 0.1, -0.05, -0.5]
    omega = [0.01, 0.003, 0.1, 0.3]
    return kernels.join(
        kernels.full_batch(GH, n_i, omega, t_end=1000.0),
        kernels.full_batch(ROLLING, 0.0733, 0.034, t_end=1000.0),
        kernels.full_batch(STABLE, -0.4, 0.01, t_end=1000.0),
    )


@pytest.fixture(scope="module")
def outcome(runs):
    return integrate(runs, DOP853, FULL, tol=1e-11, record=SPECTRUM)


@pytest.mark.slow
def test_exponents_add_up_to_the_rate_of_volume(runs, outcome):
    whole, _ = exponents(outcome.lyapunov)
    change = (tilt(outcome.y_end) - tilt(runs.y0)) / 1000.0
    assert whole.sum(axis=1) == pytest.approx(outcome.volume_rate + change, abs=1e-9)
    assert np.abs(outcome.volume_rate).max() > 0.1


@pytest.mark.slow
def test_runs_go_on_and_tell_their_first_reversal(runs, outcome):
    steps = longest_frame_steps(runs, DOP853, 1e-11)
    settings = {"tol": 1e-11, "longest_step": steps}
    plain = integrate(runs, DOP853, FULL, **settings)
    assert np.isfinite(plain.t_r).sum() == 5
    assert outcome.t_r.tobytes() == plain.t_r.tobytes()
    assert (outcome.t_end == 1000.0).all()
    one = integrate(
        runs, DOP853, FULL, record=frozenset(["lyapunov", "reversals"]), **settings
    )
    assert outcome.y_end.tobytes() == one.y_end.tobytes()
    first, _ = exponents(one.lyapunov)
    whole, _ = exponents(outcome.lyapunov)
    assert whole[:, :1] == pytest.approx(first, abs=1e-9)


@pytest.mark.slow
def test_short_steps_keep_tangents_from_being_damped():
    # With long steps, the method damps tangents along the pitch.
    runs = kernels.full_batch(ROLLING, 0.0733, 0.034, t_end=1000.0)
    long = integrate(
        runs, DOP853, FULL, record=SPECTRUM, longest_step=np.full(len(runs), np.inf)
    )
    short = integrate(runs, DOP853, FULL, record=SPECTRUM)
    error = []
    for outcome in (long, short):
        whole, _ = exponents(outcome.lyapunov)
        change = (tilt(outcome.y_end) - tilt(runs.y0)) / 1000.0
        error.append(np.abs(whole.sum(axis=1) - outcome.volume_rate - change).max())
    assert error[0] > 1e-6
    assert error[1] < 1e-7


def test_a_looser_tolerance_allows_longer_steps(runs):
    tolerances = (1e-13, 1e-11, 1e-9, 1e-6, 1e-5, 1e-4, 1e-3)
    angles = [
        float(longest_frame_steps(runs, DOP853, tol)[0] * runs.swing[0] / 2)
        for tol in tolerances
    ]
    assert angles == sorted(angles)
    assert angles[0] == pytest.approx(0.25, abs=0.06)
    assert angles[-1] == pytest.approx(2.0)


@pytest.mark.parametrize("n_i", [-0.4, -0.1, 0.2])
def test_exponents_of_a_steady_spin_are_real_parts_of_eigenvalues(n_i):
    runs = kernels.full_batch(GH, n_i, 1e-100, t_end=600.0)
    outcome = integrate(runs, DOP853, FULL, tol=1e-11, record={"spectrum"})
    _, late = exponents(outcome.lyapunov)
    pitch, roll = (float(x) for x in steady.growth(full.constants(**GH), n_i))
    expected = sorted([pitch, pitch, roll, roll, 0.0])
    assert sorted(late[0]) == pytest.approx(expected, abs=2e-3)


@pytest.mark.slow
def test_rows_end_where_the_flow_has_decayed():
    runs = kernels.full_batch(STABLE, -0.75, 1e-3, t_end=40_000.0)
    outcome = integrate(runs, DOP853, FULL, record=SPECTRUM)
    last = np.nanmax(outcome.lyapunov[0, :, 0])
    assert 20_000 < last < 30_000
    whole, _ = exponents(outcome.lyapunov)
    pitch, roll = (float(x) for x in steady.growth(full.constants(**STABLE), -0.75))
    expected = sorted([pitch, pitch, roll, roll, 0.0])
    assert sorted(whole[0]) == pytest.approx(expected, abs=1e-3)


def test_a_body_at_rest_in_its_steady_spin_has_no_exponents():
    runs = kernels.full_batch(GH, -0.5, 0.0, t_end=100.0)
    outcome = integrate(runs, DOP853, FULL, record={"spectrum"})
    assert np.isnan(exponents(outcome.lyapunov)[0]).all()


@pytest.mark.slow
def test_threads_and_neighbours_do_not_matter(runs, outcome):
    many = kernels.join(*[runs] * 8)
    one = integrate(many, DOP853, FULL, tol=1e-11, record=SPECTRUM, threads=1)
    two = integrate(many, DOP853, FULL, tol=1e-11, record=SPECTRUM, threads=2)
    kernels.assert_same(one, two)
    kernels.assert_same(kernels.take(one, slice(0, 6)), outcome)


def kernel_frame(body, omega, u):
    """Return the kernel's directions at a launch, orthonormal, in columns.

    They are the flow, three tangents at constant energy, and the gradient of energy.
    """
    norm = spectrum_oracle.energy_norm(*body)
    root = np.linalg.cholesky(norm).T
    q = tuple(map(float, full.constants(*body)))
    y = (u[0] / u[2], u[1] / u[2], *omega)
    flow = full.rhs(y, q)
    gradient = np.linalg.solve(norm, tangent.gradient(y, q))
    unit = gradient / np.sqrt(gradient @ norm @ gradient)
    seeds = np.reshape(frame.seed(y, q), (3, 5))
    level = np.array([flow, *seeds]).T
    level -= np.outer(unit, unit @ norm @ level)
    columns = np.column_stack([level, unit])
    orthonormal, _ = np.linalg.qr(root @ columns)
    return np.linalg.solve(root, orthonormal)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "omega", "u", "t_end"),
    [
        ((7, 3, 7, 0.25, 1 / 9, -0.485), (0.24, -1.22, 0.83), (0.19, -0.2, -0.96), 60),
        ((7, 6, 7, 0.25, 1 / 9, -0.2), (0.3, -0.4, 0.6), (0.4, -0.3, -0.83), 100),
        (tuple(GH.values()), (0.02, 0.01, -0.3), (0.01, -0.02, -1.0), 100),
    ],
)
def test_an_independent_program_has_the_same_exponents(body, omega, u, t_end):
    u = np.array(u) / np.linalg.norm(u)
    stone = rs.Rattleback(*body)
    record = ["spectrum", "volume"]
    run = rs.simulate(
        stone, omega=omega, u=list(u), t_end=t_end, tol=1e-13, record=record
    )
    theirs = spectrum_oracle.spectrum(
        body, omega, u, t_end, frame=kernel_frame(body, omega, u)
    )
    expected = -np.sort(-theirs.exponents)
    assert run.lyapunov_spectrum == pytest.approx(expected, abs=3e-9)
    assert sum(run.lyapunov_spectrum) == pytest.approx(theirs.divergence, abs=1e-9)


@pytest.mark.slow
def test_exponents_do_not_depend_on_the_first_frame():
    # The five exponents of a generic frame, none of them set to zero.
    body = (7, 3, 7, 0.25, 1 / 9, -0.485)
    omega = np.array([0.239443, -1.22271, 0.825371])
    u = (0.188817, -0.19839, -0.961764)
    # Means over chaotic runs differ as much as those of launches next to each other.
    nearby = omega * (1 + 1e-6 * np.arange(24))[:, None]
    runs = rs.simulate(
        rs.Rattleback(*body), omega=nearby, u=u, t_end=3000, record="spectrum"
    )
    ours = np.array(runs["lyapunov_spectrum"].tolist())
    theirs = spectrum_oracle.spectrum(body, omega, u, 3000)
    expected = -np.sort(-theirs.exponents)
    # The two zeros decay as log(t)/t.
    assert sorted(np.abs(expected))[:2] == pytest.approx([0, 0], abs=5e-3)
    scatter = ours.std(axis=0, ddof=1)
    assert np.all(np.abs(expected - ours.mean(axis=0)) < 4 * scatter + 5e-3)
