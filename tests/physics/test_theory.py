"""The closed forms against 50-digit arithmetic, and the paper's limits."""

import numpy as np
import pytest
import theory_mp
from mpmath import mp

from rattlesweep.physics import theory

EPS = np.finfo(float).eps
GH = (13.04, 1.522, 12.28, 0.6429, 0.0360, -np.radians(1.72))


def log_uniform(rng, low, high, size):
    return 10 ** rng.uniform(np.log10(low), np.log10(high), size)


def shell_dumbbells(gamma, f_sd):
    return (1 - f_sd) * gamma + 1, f_sd * gamma + 1


def launches(rng, size):
    sign = np.where(np.arange(size) % 2, 1.0, -1.0)
    return sign * log_uniform(rng, 1e-6, 50, size), log_uniform(rng, 1e-12, 1, size)


def table_one(size, seed=1):
    """Bodies of the paper's set SD."""
    rng = np.random.default_rng(seed)
    gamma = rng.uniform(5, 15, size)
    alpha, beta = shell_dumbbells(gamma, rng.uniform(0.05, 0.15, size))
    theta, phi = rng.uniform(0.6, 0.95, size), rng.uniform(0.01, 0.1, size)
    xi = -np.radians(6 * (1 - rng.uniform(0, 1, size)))
    return (alpha, beta, gamma, theta, phi, xi, *launches(rng, size))


def far_outside(size, seed=2):
    """Bodies at the ends of every range, ends combined at random."""
    rng = np.random.default_rng(seed)
    gamma = log_uniform(rng, 1e-2, 1e3, size)
    f_sd = np.choose(
        rng.integers(0, 3, size),
        [
            log_uniform(rng, 1e-9, 0.5, size),
            0.5 - log_uniform(rng, 1e-9, 0.5, size) / 2,
            rng.uniform(0.05, 0.45, size),
        ],
    )
    alpha, beta = shell_dumbbells(gamma, f_sd)
    # Every third has alpha within 1e-9..1e-1 of beta, and any gamma that a body can have.
    near = np.arange(size) % 3 == 0
    alpha = np.where(near, beta * (1 + log_uniform(rng, 1e-9, 1e-1, size)), alpha)
    low, high = alpha - beta, alpha + beta - 2
    gamma = np.where(near, low + (high - low) * rng.uniform(0, 1, size), gamma)
    theta = np.where(
        rng.uniform(size=size) < 0.6,
        1 - log_uniform(rng, 1e-9, 0.5, size),
        rng.uniform(0.05, 0.99, size),
    )
    phi = theta * log_uniform(rng, 1e-4, 0.9, size)
    deep = rng.uniform(size=size) < 0.3
    xi = -np.radians(np.where(deep, rng.uniform(1, 89, size), log_uniform(rng, 1e-8, 89, size)))
    return (alpha, beta, gamma, theta, phi, xi, *launches(rng, size))


SETS = {"table I": table_one(200), "far outside": far_outside(600)}


@pytest.fixture(scope="module", params=SETS)
def case(request):
    """Columns of a set of launches and the reference for each."""
    columns = SETS[request.param]
    rows = np.stack(columns, -1).tolist()
    return columns, [theory_mp.reference(*row) for row in rows]


def relative_error(got, reference):
    """Relative errors of doubles against mpf."""
    got = np.broadcast_to(got, (len(reference),)).tolist()
    with mp.workdps(50):
        return np.array(
            [float(abs(mp.mpf(g) / r - 1)) for g, r in zip(got, reference, strict=True)]
        )


def degeneracy(alpha, beta, theta, phi, xi):
    """How much larger the squared frequencies are than their difference.

    A relative change of the parameters by epsilon changes K and psi by this times epsilon.
    """
    h11, h12, h22 = theory.hessian(alpha, beta, theta, phi, xi)
    return (h11 + h22) / np.hypot(h11 - h22, 2 * h12)


def of(references, name):
    return [reference[name] for reference in references]


@pytest.mark.parametrize("name", ["omega_p", "omega_r", "omega_p0", "omega_r0"])
def test_frequencies(case, name):
    (alpha, beta, _, theta, phi, xi, *_), reference = case
    got = getattr(theory.modes(alpha, beta, theta, phi, xi), name)
    assert relative_error(got, of(reference, name)).max() < 10 * EPS


@pytest.mark.parametrize("name", ["K_p", "K_r"])
def test_torque_coefficients(case, name):
    (alpha, beta, _, theta, phi, xi, *_), reference = case
    got = getattr(theory.modes(alpha, beta, theta, phi, xi), name)
    error = relative_error(got, of(reference, name))
    assert error.max() < 1e-12
    assert (error / degeneracy(alpha, beta, theta, phi, xi)).max() < 10 * EPS


@pytest.mark.parametrize("name", ["psi_p", "psi_r"])
def test_directions(case, name):
    (alpha, beta, _, theta, phi, xi, *_), reference = case
    got = getattr(theory.modes(alpha, beta, theta, phi, xi), name)
    assert np.all((-np.pi / 2 < got) & (got <= np.pi / 2))
    with mp.workdps(50):
        turn = [
            float(abs(mp.sin(mp.mpf(g) - r)))
            for g, r in zip(got.tolist(), of(reference, name), strict=True)
        ]
    assert max(turn) < 1e-12
    assert (turn / degeneracy(alpha, beta, theta, phi, xi)).max() < 10 * EPS


def test_modes_keep_their_digits_where_the_frequencies_cross():
    # alpha (1/theta - 1) = beta (1/phi - 1) and xi small: H_11 - H_22 and H_12 both small.
    rng = np.random.default_rng(8)
    size = 60
    alpha, theta = rng.uniform(4, 10, size), rng.uniform(0.3, 0.6, size)
    beta = rng.uniform(1.2, 3, size)
    phi = 1 / (1 + alpha / beta * (1 / theta - 1)) * (1 + log_uniform(rng, 1e-7, 1e-2, size))
    xi = -log_uniform(rng, 1e-8, 1e-2, size)
    columns = (alpha, beta, alpha, theta, phi, xi, 0.1 + 0 * xi, 0.01 + 0 * xi)
    reference = [theory_mp.reference(*row) for row in np.stack(columns, -1).tolist()]
    found = theory.modes(alpha, beta, theta, phi, xi)
    condition = degeneracy(alpha, beta, theta, phi, xi)
    assert condition.max() > 1e6
    for name in ("K_p", "K_r"):
        error = relative_error(getattr(found, name), of(reference, name))
        assert (error / condition).max() < 10 * EPS
    for name in ("omega_p", "omega_r"):
        assert relative_error(getattr(found, name), of(reference, name)).max() < 10 * EPS


def own_coefficient(found, n):
    return np.where(n > 0, found.K_p, found.K_r)


def own_speed(found, alpha, beta, gamma, n, w):
    psi = np.where(n > 0, found.psi_p, found.psi_r)
    return theory.oscillation_speed(alpha, beta, gamma, w, psi)


def test_oscillation_speed(case):
    (alpha, beta, gamma, theta, phi, xi, n, w), reference = case
    found = theory.modes(alpha, beta, theta, phi, xi)
    speed = own_speed(found, alpha, beta, gamma, n, w)
    with mp.workdps(90):
        wanted = []
        for row, r in zip(
            np.stack([alpha, beta, gamma, n, w], -1).tolist(), reference, strict=True
        ):
            a, b, c, n_i, omega = map(mp.mpf, row)
            psi = r["psi_p"] if n_i > 0 else r["psi_r"]
            wanted.append(mp.sqrt((a * mp.cos(psi) ** 2 + b * mp.sin(psi) ** 2) / c) * omega)
            # n_0^2 = n_i^2 + speed^2 is the paper's n_0, as far as 50 digits of it tell.
            assert abs(mp.hypot(n_i, wanted[-1]) / r["n_0"] - 1) < mp.mpf(10) ** -48
    assert relative_error(speed, wanted).max() < 1e-12


def test_reversal_time(case):
    (alpha, beta, gamma, theta, phi, xi, n, w), reference = case
    found = theory.modes(alpha, beta, theta, phi, xi)
    speed = own_speed(found, alpha, beta, gamma, n, w)
    got = theory.reversal_time(own_coefficient(found, n), n, speed)
    assert relative_error(got, of(reference, "t_rgh")).max() < 1e-12


def test_growth_rates(case):
    (alpha, beta, _, theta, phi, xi, n, _), reference = case
    found = theory.modes(alpha, beta, theta, phi, xi)
    pitch, roll = theory.growth_rates(found.K_p, found.K_r, n)
    assert relative_error(pitch, of(reference, "growth_pitch")).max() < 1e-12
    assert relative_error(roll, of(reference, "growth_roll")).max() < 1e-12


def threshold_errors(*body):
    """Relative errors of the threshold where there is one; NaN exactly where there is none."""
    got = theory.bondi_threshold(*body)
    squares = [theory_mp.n_c1_squared(*row) for row in np.stack(body, -1).tolist()]
    exists = np.array([s is not None and s > 0 for s in squares])
    assert np.array_equal(np.isfinite(got), exists)
    assert np.all(got[exists] < 0)
    with mp.workdps(50):
        wanted = [-mp.sqrt(s) for s, e in zip(squares, exists, strict=True) if e]
    return relative_error(got[exists], wanted)


def test_bondi_threshold(case):
    (alpha, beta, gamma, theta, phi, *_), _ = case
    error = threshold_errors(alpha, beta, gamma, theta, phi)
    assert error.size > 20
    assert error.max() < 10 * EPS


@pytest.mark.parametrize("kind", ["general", "shell-dumbbell"])
def test_bondi_threshold_where_its_denominator_vanishes(kind):
    # The last parameter is solved for, then moved by a few of its own rounding errors.
    rng = np.random.default_rng(3)
    size = 300
    steps = np.round(np.sign(rng.normal(size=size)) * log_uniform(rng, 1, 1e12, size))
    steps[: size // 3] = rng.integers(-2, 3, size // 3)
    if kind == "general":
        theta, phi = rng.uniform(0.3, 0.6, size), rng.uniform(0.01, 0.29, size)
        beta = rng.uniform(1.5, 5, size)
        alpha = beta + rng.uniform(0.1, 3, size)
        s, m = theta + phi, theta * phi
        gamma = alpha + beta - (2 - s) / (s - 2 * m)
        gamma += steps * np.spacing(gamma)
    else:
        gamma = rng.uniform(5, 15, size)
        alpha, beta = shell_dumbbells(gamma, rng.uniform(0.05, 0.15, size))
        theta = rng.uniform(0.55, 0.66, size)
        phi = (2 - 3 * theta) / (3 - 4 * theta)
        phi += steps * np.spacing(phi)
    got = theory.bondi_threshold(alpha, beta, gamma, theta, phi)
    assert 0.1 < np.mean(np.isnan(got)) < 0.9
    assert np.nanmin(got) < -1e6
    assert threshold_errors(alpha, beta, gamma, theta, phi).max() < 1e-12


def test_bondi_threshold_is_none_where_the_denominator_is_zero():
    # 2 - 3/4 - 2.5 (3/4 - 1/4) = 0 exactly.
    assert np.isnan(theory.bondi_threshold(4.0, 3.0, 4.5, 0.5, 0.25))
    assert theory_mp.n_c1_squared(4.0, 3.0, 4.5, 0.5, 0.25) is None


# --- the paper's identities and limits ----------------------------------------------------------


def test_identities_of_the_torque_coefficients(case):
    (alpha, beta, _, theta, phi, xi, *_), _ = case
    found = theory.modes(alpha, beta, theta, phi, xi)
    assert np.all(found.K_p * found.K_r > 0)
    assert np.all(found.K_p > 0)
    assert np.all(found.omega_p >= found.omega_r)
    np.testing.assert_allclose(
        found.K_p / found.K_r, (found.omega_p / found.omega_r) ** 2, rtol=10 * EPS
    )
    # Eq. k-diff, with what cancels between reciprocals taken out.
    difference = (
        -np.sin(2 * xi) / 2 * (alpha - beta) / (alpha * beta) * (theta - phi) / (theta * phi)
    )
    condition = degeneracy(alpha, beta, theta, phi, xi)
    assert np.all(abs(found.K_p - found.K_r - difference) < 20 * EPS * condition * found.K_p)


def test_gh_numbers_of_the_paper():
    alpha, beta, _, theta, phi, xi = GH
    found = theory.modes(alpha, beta, theta, phi, xi)
    assert round(float(found.K_p), 3) == 0.553
    # 0.09676: the paper cuts where it would round to 0.0968.
    assert int(found.K_r * 1e4) == 967
    assert round(float(found.omega_p), 2) == 1.44
    assert round(float(found.omega_r), 3) == 0.602
    assert round(float(np.degrees(found.psi_p))) == -17
    assert round(float(np.degrees(found.psi_r))) == 88


def test_mirror_images(case):
    (alpha, beta, _, theta, phi, xi, n, w), _ = case
    one = theory.modes(alpha, beta, theta, phi, xi)
    two = theory.modes(alpha, beta, theta, phi, -xi)
    for name in ("omega_p", "omega_r", "omega_p0", "omega_r0"):
        assert np.array_equal(getattr(one, name), getattr(two, name))
    assert np.array_equal(one.K_p, -two.K_p)
    assert np.array_equal(one.K_r, -two.K_r)
    for name in ("psi_p", "psi_r"):
        assert np.all((-np.pi / 2 < getattr(two, name)) & (getattr(two, name) <= np.pi / 2))
        assert np.abs(np.sin(getattr(one, name) + getattr(two, name))).max() < 4 * EPS
    # The mirrored launch: the other spin, the same time.
    assert np.array_equal(theory.unsteady(one.K_p, n), theory.unsteady(two.K_p, -n))
    assert np.array_equal(theory.unsteady(one.K_p, n), n > 0)
    for one_k, two_k in ((one.K_p, two.K_p), (one.K_r, two.K_r)):
        time = theory.reversal_time(one_k, n, w)
        assert np.array_equal(time, theory.reversal_time(two_k, -n, w))
        assert np.array_equal(
            theory.spin_gh(time / 3, one_k, n, w), -theory.spin_gh(time / 3, two_k, -n, w)
        )
    np.testing.assert_array_equal(
        theory.growth_rates(one.K_p, one.K_r, n), theory.growth_rates(two.K_p, two.K_r, -n)
    )


# --- Garcia and Hubbard's solution --------------------------------------------------------------


def paper_spin(t, k, n_i, speed):
    """Eqs. gh-solution-p and gh-solution-m."""
    with mp.workdps(120):
        t, k, n_i, speed = (mp.mpf(x) for x in (t, k, n_i, speed))
        n, n_0 = abs(n_i), mp.sqrt(n_i**2 + speed**2)
        fall = (n_0 + n) * mp.exp(-n_0 * k * t)
        rest = speed**2 / (n_0 + n)
        return mp.sign(n_i) * n_0 * (fall - rest) / (fall + rest)


def gh_launches(size=80, seed=6):
    rng = np.random.default_rng(seed)
    n, speed = launches(rng, size)
    return log_uniform(rng, 1e-6, 1e3, size), n, speed


def test_gh_solution_is_the_papers():
    k, n, speed = gh_launches()
    n_0 = np.hypot(n, speed)
    time = theory.reversal_time(k, n, speed)
    for part in (0.0, 1e-3, 0.3, 0.9, 0.999, 1.001, 1.1, 2.0, 5.0):
        t = part * time
        got = theory.spin_gh(t, k, n, speed)
        wanted = [paper_spin(*row) for row in np.stack([t, k, n, speed], -1).tolist()]
        error = np.array([float(abs(g - r)) for g, r in zip(got.tolist(), wanted, strict=True)])
        # A rounding error of t moves the spin by its rate.
        rate = 0.5 * k * (n_0 + abs(got)) * (n_0 - abs(got))
        assert np.all(error < 40 * EPS * (np.abs(got) + rate * np.maximum(t, time))), part
        assert np.all(error < 1e-12 * n_0), part


def test_gh_solution_begins_at_the_launch_and_reverses_at_the_reversal_time():
    k, n, speed = gh_launches(400)
    time = theory.reversal_time(k, n, speed)
    np.testing.assert_allclose(theory.spin_gh(0.0, k, n, speed), n, rtol=1e-14)
    assert np.all(theory.spin_gh(time, k, n, speed) == 0)
    for part, sign in ((0.9999, 1), (1.0001, -1)):
        assert np.array_equal(np.sign(theory.spin_gh(part * time, k, n, speed)), sign * np.sign(n))
    # By the symmetry of the solution about the reversal.
    np.testing.assert_allclose(theory.spin_gh(2 * time, k, n, speed), -n, rtol=1e-14)


def test_no_oscillation_no_reversal():
    n = np.array([0.3, -0.3])
    assert np.all(np.isposinf(theory.reversal_time(0.5, n, 0.0)))
    for t in (0.0, 1e6):
        assert np.array_equal(theory.spin_gh(t, 0.5, n, 0.0), n)
    assert np.all(theory.reversal_time(0.5, 0.0, np.array([1e-12, 1.0])) == 0)


# --- growth at small spin (Case and Jalal) ------------------------------------------------------


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("n", [1e-30, -1e-30])
def test_growth_rates_are_the_limit_of_the_exact_ones(name, n):
    columns = [column[:40] for column in SETS[name][:6]]
    alpha, beta, _, theta, phi, xi = columns
    found = theory.modes(alpha, beta, theta, phi, xi)
    pitch, roll = theory.growth_rates(found.K_p, found.K_r, n)
    for i, row in enumerate(np.stack(columns, -1).tolist()):
        exact = theory_mp.growth_exact(*row, n)
        assert float(exact[0].real / pitch[i]) == pytest.approx(1, abs=1e-11)
        assert float(exact[1].real / roll[i]) == pytest.approx(1, abs=1e-11)
        assert float(exact[0].imag) == pytest.approx(found.omega_p[i], rel=1e-11)
        assert float(exact[1].imag) == pytest.approx(found.omega_r[i], rel=1e-11)
