"""The full dynamics in slopes against the paper's six variables, in doubles and at 60 digits."""

import itertools
import math

import numpy as np
import oracle
import pytest
import reference
from exact import exactly
from mpmath import mp
from samples import GH, any_body, mapping, table_one

from rattlesweep.physics import full

EPS = np.finfo(float).eps
DIGITS = 60


mp_rhs = exactly(full.rhs)
mp_energy = exactly(full.energy)
mp_spin = exactly(full.spin)
mp_spin_rate = exactly(full.spin_rate)
mp_force = exactly(full.contact_force, rhs=mp_rhs)
mp_oscillation = exactly(full.oscillation)


# --- the paper's equations at 60 digits ---------------------------------------------------------


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


class Paper:
    """Eqs. diff-u, diff-omega and em-1 for a body and a state, as `reference` has them."""

    def __init__(self, body, state):
        self.q = q = reference.constants([body], exact=True)[:, 0]
        # What the code keeps of the body: inertia and B - 1.
        self.constants = [*q[:3], q[3] - 1, q[4], q[5] - 1]
        p, q_, *omega = (mp.mpf(x) for x in state)
        upright = -1 / mp.sqrt(1 + p * p + q_ * q_)
        self.u, self.omega = (p * upright, q_ * upright, upright), omega
        d = reference.rhs(np.array([*self.u, *omega]), q)
        self.du, self.domega = d[:3], d[3:]
        self.r, self.dr = reference.contact(self.u, self.du, q)
        # p = u_x/u_z, q = u_y/u_z
        slopes = [(self.du[i] - x * self.du[2]) / upright for i, x in enumerate((p, q_))]
        self.rates = [*slopes, *self.domega]

    def energy(self):
        v, w = reference.cross(self.r, self.omega), self.omega
        inertia = [i * x for i, x in zip(self.q[:3], w, strict=True)]
        return (dot(v, v) + dot(w, inertia)) / 2 - dot(self.r, self.u) - 1

    def force(self):
        w, r, cross = self.omega, self.r, reference.cross
        f = reference.add(cross(self.dr, w), cross(r, self.domega), cross(w, cross(r, w)), self.u)
        along = dot(f, self.u)
        return along, mp.norm([x - along * y for x, y in zip(f, self.u, strict=True)])


# --- bodies and states --------------------------------------------------------------------------


def states(size, seed):
    """Slopes from 1e-8 to 1, horizontal rates alike, spins up to 5."""
    rng = np.random.default_rng(seed)
    for _ in range(size):
        slope, rate = 10 ** rng.uniform(-8, 0, 2)
        yield np.concatenate(
            [slope * rng.normal(size=2), rate * rng.normal(size=2), rng.uniform(-5, 5, 1)]
        )


BODIES = [*any_body(30, 11).T.tolist(), *table_one(30, 11).T.tolist()]
CASES = list(zip(BODIES, states(60, 12), strict=True))

# theta and phi at their ends, slopes of 1e-150 to steep, with and without spin.
EXTREMES = [
    ((*inertia, *surface), np.array([0.3 * slope, -1.1 * slope, 0.7 * rate, 0.9 * rate, n]))
    for inertia in [(13.04, 1.522, 12.28), (1.3 + 3e-9, 1.3, 0.5)]
    for surface in itertools.product((0.7, 1 - 1e-9), (0.05, 1e-4), (-1e-6, -0.03, -1.2))
    for slope, rate, n in [
        (1e-150, 1e-150, -0.2),
        (1e-150, 1e-2, 0.2),
        (1e-2, 1e-150, 1e-150),
        (1e-8, 1e-6, 3.0),
        (0.2, 0.7, -40.0),
    ]
]


def six(state):
    """The oracle's u and omega."""
    u, omega = full.to_vectors(np.asarray(state))
    return np.concatenate([u, omega])


# --- formulas, free of rounding -----------------------------------------------------------------


@pytest.mark.parametrize("cases", [CASES[::2], EXTREMES[::3]], ids=["random", "extreme"])
def test_formulas_are_the_papers(cases):
    """At 60 digits the compiled formulas and the paper's six variables agree to 50."""
    for parameters, state in cases:
        with mp.workdps(3 * DIGITS):  # the potential of a slope of 1e-150 has to show
            paper = Paper(parameters, state)
            arguments = [*(mp.mpf(float(x)) for x in state), *paper.constants]
            small = mp.mpf(10) ** -50
            for one, two in zip(mp_rhs(*arguments), paper.rates, strict=True):
                assert abs(one - two) <= small * abs(two)
            assert abs(mp_spin(*arguments[:5]) / dot(paper.u, paper.omega) - 1) < small
            rate = dot(paper.u, paper.domega)
            assert abs(mp_spin_rate(*arguments[:2], *paper.domega) - rate) <= small * abs(rate)
            normal, tangential = mp_force(*arguments)
            normal_p, tangential_p = paper.force()
            assert abs(normal - normal_p) <= small * (1 + abs(normal_p))
            assert abs(tangential - tangential_p) <= small * (abs(tangential_p) + small)
        with mp.workdps(6 * DIGITS):
            paper = Paper(parameters, state)
            arguments[5:] = paper.constants
            energy = paper.energy()
            assert abs(mp_energy(*arguments) - energy) <= small * energy


def test_oscillation_is_twice_the_energy_of_small_motion_without_spin():
    for parameters, state in CASES[:20]:
        with mp.workdps(DIGITS):
            ix, iy, iz, *surface = Paper(parameters, state).constants
            p, q, a, b = (mp.mpf(float(x)) * mp.mpf(10) ** -20 for x in state[:4])
            twice = mp_oscillation(p, q, a, b, ix, iy, *surface)
            ratio = 2 * mp_energy(p, q, a, b, mp.mpf(0), ix, iy, iz, *surface) / twice
            assert abs(ratio - 1) < mp.mpf(10) ** -30


# --- doubles --------------------------------------------------------------------------------------


def test_pointwise_against_the_oracle():
    for parameters, state in CASES:
        body, y = mapping(parameters), six(state)
        constants = full.constants(*parameters)
        got = np.array(full.rhs(*state, *constants))
        dy = oracle.rhs(0.0, y, body)
        u, du = y[:3], dy[:3]
        slopes = du[:2] / u[2] - u[:2] * du[2] / u[2] ** 2
        np.testing.assert_allclose(got[:2], slopes, rtol=1e-12, atol=1e-14 * np.linalg.norm(y[3:]))
        # The oracle's rounding errors: its torques' magnitudes over the smallest inertia.
        r = oracle.contact_point(u, body)
        dr = oracle.contact_point_dot(u, du, body)
        size, w = np.linalg.norm(r), np.linalg.norm(y[3:])
        inertia = oracle.matrices(body)[2]
        left = inertia + r @ r * np.eye(3) - np.outer(r, r)
        torque = inertia.max() * w**2 + size * (np.linalg.norm(dr) * w + size * w**2 + 1)
        scale = torque / np.linalg.eigvalsh(left)[0]
        assert np.abs(got[2:] - dy[3:]).max() < 1e-14 * scale
        assert full.energy(*state, *constants) == pytest.approx(
            oracle.energy(y, body), rel=1e-12, abs=1e-14 * (1 + w**2)
        )
        assert full.spin(*state) == pytest.approx(oracle.spin(y), rel=1e-12, abs=1e-15 * w)
        assert full.spin_rate(*state[:2], *dy[3:]) == pytest.approx(
            oracle.spin_rate(y, body), rel=1e-12, abs=1e-14 * np.linalg.norm(dy[3:])
        )
        force = size * (scale + w**2) + np.linalg.norm(dr) * w + 1
        np.testing.assert_allclose(
            full.contact_force(*state, *constants),
            oracle.force_components(y, body),
            rtol=1e-12,
            atol=1e-14 * force,
        )


def condition(function, arguments):
    """Change of a function's results when each argument in turn grows by a rounding error."""
    base = function(*arguments)
    total = [mp.mpf(0)] * len(base)
    for i, x in enumerate(arguments):
        moved = [*arguments]
        moved[i] = x * (1 + mp.mpf(EPS))
        total = [t + abs(n - b) for t, n, b in zip(total, function(*moved), base, strict=True)]
    return total


def errors(parameters, state):
    """Relative errors of the rates, and as multiples of what the arguments' rounding does."""
    got = full.rhs(*map(float, state), *full.constants(*parameters))
    with mp.workdps(DIGITS):
        paper = Paper(parameters, state)
        wanted = paper.rates
        inherent = condition(mp_rhs, [*(mp.mpf(float(x)) for x in state), *paper.constants])
        error = [abs(mp.mpf(g) - w) for g, w in zip(got, wanted, strict=True)]
        relative = [float(e / abs(w)) for e, w in zip(error, wanted, strict=True)]
        multiple = [float(e / i) for e, i in zip(error, inherent, strict=True)]
    return relative, multiple


@pytest.mark.parametrize("cases", [CASES, EXTREMES], ids=["random", "extreme"])
def test_every_rate_is_as_accurate_as_its_arguments(cases):
    """Up to the reach, which is of order one unless slope and phi are both extreme."""
    found = np.array([errors(*case)[1] for case in cases])
    assert np.all(found < 10)


def test_relative_accuracy_in_the_extremes():
    """Every component, however small, to a few dozen units of its own last place."""
    body = (13.04, 1.522, 12.28, 1 - 1e-9, 1e-4, -0.03)
    # At 1e-150 the spin's rate, of second order, is near the smallest of doubles.
    for slope in (1e-5, 1e-75, 1e-150):
        for n in (0.1, -0.1, 3.0):
            state = np.array([0.3 * slope, -1.1 * slope, 0.7 * slope, 0.9 * slope, -n])
            relative, _ = errors(body, state)
            assert max(relative) < 100 * EPS, (slope, n)


@pytest.mark.parametrize("theta", [0.7, 1 - 1e-9])
@pytest.mark.parametrize("phi", [0.5, 1e-4])
@pytest.mark.parametrize("xi", [-1e-8, -0.03, 1.2])
def test_constants_keep_their_digits(theta, phi, xi):
    body = (13.04, 1.522, 12.28, theta, phi, xi)
    with mp.workdps(DIGITS):
        wanted = Paper(body, [0] * 5).constants
        for got, exact in zip(full.constants(*body).tolist(), wanted, strict=True):
            # alpha - 1 and beta - 1 are exact here but for one rounding
            assert abs(mp.mpf(got) / exact - 1) < 6 * EPS


def test_mirrored_bodies_move_in_mirror_images():
    """The x-z plane reflects polar u to (u_x, -u_y, u_z), axial omega to (-w_x, w_y, -w_z)."""
    image = np.array([1, -1, -1, 1, -1])
    for parameters, state in CASES:
        one = full.constants(*parameters)
        two = full.constants(*parameters[:5], -parameters[5])
        assert not np.array_equal(one, two)
        rates = np.array(full.rhs(*state, *one))
        assert np.array_equal(full.rhs(*(image * state), *two), image * rates)
        assert full.energy(*(image * state), *two) == full.energy(*state, *one)
        assert full.spin(*(image * state)) == -full.spin(*state)
        assert full.contact_force(*(image * state), *two) == full.contact_force(*state, *one)
        # and without the reflection it moves otherwise
        assert not np.array_equal(full.rhs(*state, *two), rates)


def test_steady_spin_is_a_solution():
    constants = full.constants(*GH)
    for n in (0.0, 0.3, -5.0):
        state = (0.0, 0.0, 0.0, 0.0, -n)
        assert full.rhs(*state, *constants) == (0, 0, 0, 0, 0)
        assert full.spin(*state) == n
        assert full.energy(*state, *constants) == pytest.approx(12.28 * n**2 / 2, rel=1e-15)
        assert full.contact_force(*state, *constants) == (1.0, 0.0)


def test_a_state_that_is_not_finite_stays_so():
    constants = full.constants(*GH)
    for bad in (np.nan, np.inf):
        state = (0.1, bad, 0.0, 0.0, 0.1)
        assert not np.all(np.isfinite(full.rhs(*state, *constants)))
        assert not math.isfinite(full.energy(*state, *constants))


def test_constants_broadcast():
    assert full.constants(*GH).shape == (full.N_CONSTANTS,)
    gamma, theta = np.array([9.0, 10.0, 11.0])[:, None], np.array([0.6, 0.7, 0.8, 0.9])
    many = full.constants(13.0, 1.5, gamma, theta, 0.05, -0.03)
    assert many.shape == (full.N_CONSTANTS, 3, 4)
    assert many.dtype == np.float64
    for i, j in itertools.product(range(3), range(4)):
        one = full.constants(13.0, 1.5, gamma[i, 0], theta[j], 0.05, -0.03)
        np.testing.assert_allclose(many[:, i, j], one, rtol=4 * EPS)
    assert full.constants(2, 1.5, 2, 0.5, 0.25, -1).dtype == np.float64


def test_vectors_there_and_back():
    state = np.stack([s for _, s in CASES], axis=1)
    u, omega = full.to_vectors(state)
    assert u.shape == omega.shape == (3, len(CASES))
    assert np.all(u[2] < 0)
    np.testing.assert_allclose(np.linalg.norm(u, axis=0), 1, rtol=4 * EPS)
    np.testing.assert_allclose(full.from_vectors(u, omega), state, rtol=8 * EPS)
    assert full.from_vectors(u[:, 0], omega[:, 0]).shape == (full.N_STATE,)
    # p = u_x/u_z: of any length
    np.testing.assert_allclose(full.from_vectors(7 * u, omega), state, rtol=8 * EPS)
    # omega is a copy
    omega[0, 0] += 1
    assert state[2, 0] != omega[0, 0]


@pytest.mark.parametrize("u_z", [0.0, 0.5, np.nan])
def test_only_bodies_on_their_lower_surface_have_slopes(u_z):
    u = np.array([[0.1, 0.1], [0.0, 0.2], [-1.0, u_z]])
    with pytest.raises(ValueError, match="u_z must be negative"):
        full.from_vectors(u, np.zeros((3, 2)))
    assert full.from_vectors(u[:, 0], np.zeros(3))[0] == -0.1
