"""The closed forms against 50-digit arithmetic, and the paper's limits."""

import numpy as np
import pytest
import theory_mp
from mpmath import mp
from samples import dumbbells, far_outside, log_uniform, rows, table_one

from rattlesweep.physics import theory

EPS = np.finfo(float).eps


def launches(rng, size):
    sign = np.where(np.arange(size) % 2, 1.0, -1.0)
    return sign * log_uniform(rng, 1e-6, 50, size), log_uniform(rng, 1e-12, 1, size)


SETS = {"table I": table_one(60, 1), "far outside": far_outside(300, 2)}


class Case:
    """Bodies and launches, the package's results, and the exact values by name."""

    def __init__(self, bodies):
        self.bodies = bodies
        self.alpha, self.beta, self.gamma, self.theta, self.phi, self.xi = bodies
        self.n, self.w = launches(np.random.default_rng(5), bodies.shape[1])
        self.modes = theory.modes(self.alpha, self.beta, self.theta, self.phi, self.xi)
        self.exact = [
            theory_mp.reference(*row) for row in rows([*bodies, self.n, self.w])
        ]
        # Ratio of the squared frequencies to their difference: a relative change of the
        # parameters by epsilon changes K and psi by this times epsilon.
        h11, h12, h22 = theory.hessian(
            self.alpha, self.beta, self.theta, self.phi, self.xi
        )
        self.condition = (h11 + h22) / np.hypot(h11 - h22, 2 * h12)

    def error(self, name, got=None):
        """Relative errors of a quantity by name."""
        got = getattr(self.modes, name) if got is None else got
        return relative_error(got, [exact[name] for exact in self.exact])


@pytest.fixture(scope="module", params=SETS)
def case(request):
    return Case(SETS[request.param])


def relative_error(got, exact):
    """Relative errors of doubles against mpf."""
    with mp.workdps(50):
        both = zip(np.broadcast_to(got, len(exact)).tolist(), exact, strict=True)
        return np.array([float(abs(mp.mpf(g) / r - 1)) for g, r in both])


def test_modes(case):
    for name in ("omega_p", "omega_r", "omega_p0", "omega_r0"):
        assert case.error(name).max() < 10 * EPS, name
    for name in ("K_p", "K_r"):
        assert case.error(name).max() < 1e-12
        assert (case.error(name) / case.condition).max() < 10 * EPS, name
    for name in ("psi_p", "psi_r"):
        got = getattr(case.modes, name)
        assert np.all((-np.pi / 2 < got) & (got <= np.pi / 2))
        with mp.workdps(50):
            both = zip(got.tolist(), case.exact, strict=True)
            turn = np.array([float(abs(mp.sin(mp.mpf(g) - r[name]))) for g, r in both])
        assert max(turn) < 1e-12
        assert (turn / case.condition).max() < 10 * EPS, name


def test_launches(case):
    unsteady = case.n > 0
    grows = np.where(unsteady, case.modes.K_p, case.modes.K_r)
    psi = np.where(unsteady, case.modes.psi_p, case.modes.psi_r)
    speed = theory.oscillation_speed(case.alpha, case.beta, case.gamma, case.w, psi)
    with mp.workdps(90):
        wanted = []
        columns = rows([case.alpha, case.beta, case.gamma, case.n, case.w])
        for row, exact in zip(columns, case.exact, strict=True):
            a, b, c, n_i, omega = map(mp.mpf, row)
            psi = exact["psi_p"] if n_i > 0 else exact["psi_r"]
            wanted.append(
                mp.sqrt((a * mp.cos(psi) ** 2 + b * mp.sin(psi) ** 2) / c) * omega
            )
            # n_0^2 = n_i^2 + speed^2 is the paper's n_0 to 50 digits.
            assert abs(mp.hypot(n_i, wanted[-1]) / exact["n_0"] - 1) < mp.mpf(10) ** -48
    assert relative_error(speed, wanted).max() < 1e-12
    gh = theory.GarciaHubbard(grows, case.n, speed)
    assert case.error("t_rgh", gh.t_rgh).max() < 1e-12
    pitch, roll = theory.growth_rates(case.modes.K_p, case.modes.K_r, case.n)
    assert case.error("growth_pitch", pitch).max() < 1e-12
    assert case.error("growth_roll", roll).max() < 1e-12


def threshold_errors(*body):
    """Check where the threshold is NaN, and return the relative errors elsewhere."""
    got = theory.bondi_threshold(*body)
    squares = [theory_mp.n_c1_squared(*row) for row in rows(body)]
    exists = np.array([s is not None and s > 0 for s in squares])
    assert np.array_equal(np.isfinite(got), exists)
    assert np.all(got[exists] < 0)
    with mp.workdps(50):
        wanted = [-mp.sqrt(s) for s, e in zip(squares, exists, strict=True) if e]
    return relative_error(got[exists], wanted)


def test_bondi_threshold(case):
    error = threshold_errors(*case.bodies[:5])
    assert error.size > 20
    assert error.max() < 10 * EPS


@pytest.mark.parametrize("kind", ["general", "shell-dumbbell"])
def test_bondi_threshold_where_its_denominator_vanishes(kind):
    # The last parameter solves for a zero, and is then moved by some of its rounding
    # errors.
    rng = np.random.default_rng(3)
    size = 300
    steps = np.round(np.sign(rng.normal(size=size)) * log_uniform(rng, 1, 1e12, size))
    steps[: size // 3] = rng.integers(-2, 3, size // 3)
    if kind == "general":
        theta = rng.uniform(0.3, 0.6, size)
        phi = rng.uniform(0.01, 0.29, size)
        beta = rng.uniform(1.5, 5, size)
        alpha = beta + rng.uniform(0.1, 3, size)
        s = theta + phi
        m = theta * phi
        gamma = alpha + beta - (2 - s) / (s - 2 * m)
        gamma += steps * np.spacing(gamma)
    else:
        alpha, beta, gamma = dumbbells(
            rng.uniform(5, 15, size), rng.uniform(0.05, 0.15, size)
        )
        theta = rng.uniform(0.55, 0.66, size)
        phi = (2 - 3 * theta) / (3 - 4 * theta)
        phi += steps * np.spacing(phi)
    got = theory.bondi_threshold(alpha, beta, gamma, theta, phi)
    assert 0.1 < np.mean(np.isnan(got)) < 0.9
    assert np.nanmin(got) < -1e6
    assert threshold_errors(alpha, beta, gamma, theta, phi).max() < 1e-12


def paper_spin(t, k, n_i, speed):
    """Return the spin by Eqs. 55 and 57."""
    with mp.workdps(120):
        t, k, n_i, speed = (mp.mpf(x) for x in (t, k, n_i, speed))
        n = abs(n_i)
        n_0 = mp.sqrt(n_i**2 + speed**2)
        fall = (n_0 + n) * mp.exp(-n_0 * k * t)
        rest = speed**2 / (n_0 + n)
        return mp.sign(n_i) * n_0 * (fall - rest) / (fall + rest)


def test_gh_solution_is_the_papers():
    rng = np.random.default_rng(6)
    n, speed = launches(rng, 80)
    k = log_uniform(rng, 1e-6, 1e3, 80)
    n_0 = np.hypot(n, speed)
    gh = theory.GarciaHubbard(k, n, speed)
    for share in (0.0, 1e-3, 0.3, 0.9, 0.999, 1.001, 1.1, 2.0, 5.0):
        t = share * gh.t_rgh
        got = gh.spin(t)
        wanted = [paper_spin(*row) for row in rows([t, k, n, speed])]
        error = np.array(
            [float(abs(g - r)) for g, r in zip(got.tolist(), wanted, strict=True)]
        )
        # A rounding error of t changes the spin by its rate.
        rate = 0.5 * k * (n_0 + abs(got)) * (n_0 - abs(got))
        late = np.maximum(t, gh.t_rgh)
        assert np.all(error < 40 * EPS * (np.abs(got) + rate * late)), share
        assert np.all(error < 1e-12 * n_0), share
