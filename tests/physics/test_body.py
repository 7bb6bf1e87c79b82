"""Bodies and their rules, the reduced dynamics, launches."""

import dataclasses
import math
import re

import numpy as np
import oracle
import pytest
import theory_mp
from mpmath import mp
from samples import mapping, table_one

from rattlesweep.physics import full, launch, reduced, theory
from rattlesweep.physics.body import PARAMETERS, Rattleback, shell_dumbbell, violations

EPS = np.finfo(float).eps
GH = oracle.GH


# --- bodies ---------------------------------------------------------------------------------------


def test_gh_is_table_one():
    body = Rattleback.gh()
    assert dataclasses.asdict(body) == GH | {"c": None, "units": None}
    assert tuple(GH) == PARAMETERS
    with pytest.raises(AttributeError):
        body.theta = 0.5


RULES = """
alpha=nan: a parameter is not a finite number
gamma=inf: a parameter is not a finite number
xi=-inf: a parameter is not a finite number
phi=0: phi is 0; 0 < phi < theta < 1 is needed
phi=-0.1: phi is -0.1; 0 < phi < theta < 1 is needed
theta=1: theta is 1; 0 < phi < theta < 1 is needed
theta=1.5: theta is 1.5; 0 < phi < theta < 1 is needed
phi=0.7: phi 0.7 is not below theta 0.6429; 0 < phi < theta < 1 is needed
phi=0.6429: phi 0.6429 is not below theta 0.6429; 0 < phi < theta < 1 is needed
beta=1: beta is 1; alpha > beta > 1 is needed
beta=0.5: beta is 0.5; alpha > beta > 1 is needed
alpha=1.4: alpha 1.4 is not above beta 1.522; alpha > beta > 1 is needed
alpha=1.522: alpha 1.522 is not above beta 1.522; alpha > beta > 1 is needed
gamma=0: gamma is 0; it must be positive
gamma=-3: gamma is -3; it must be positive
xi=0: xi is 0 rad; -pi/2 < xi < 0 is needed, or xi > 0 for a mirror image
xi=-1.5707963267948966: xi is -1.5708 rad; -pi/2 < xi < 0 is needed, or xi > 0 for a mirror image
xi=2: xi is 2 rad; -pi/2 < xi < 0 is needed, or xi > 0 for a mirror image
gamma=11: no body has this inertia: I_xx = alpha - 1 = 12.04 exceeds I_yy + I_zz = 11.522
gamma=12.6: no body has this inertia: I_zz = gamma = 12.6 exceeds I_xx + I_yy = 12.562
"""


@pytest.mark.parametrize("rule", RULES.strip().splitlines())
def test_each_rule_has_its_sentence(rule):
    name, value, sentence = re.fullmatch(r"(\w+)=(\S+): (.*)", rule).groups()
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}$"):
        Rattleback(**(GH | {name: float(value)}))


def test_violations_name_the_first_offender_of_every_rule():
    columns = {name: np.full(6, value) for name, value in GH.items()}
    assert list(violations(**columns)) == []
    columns["phi"][[3, 4]] = -0.2, -0.3
    columns["theta"][2] = 1.25
    columns["xi"][[1, 5]] = 0.0
    assert [place for place, _ in violations(**columns)] == [3, 2, 1]
    assert [sentence.split(";")[0] for _, sentence in violations(**columns)] == [
        "phi is -0.2",
        "theta is 1.25",
        "xi is 0 rad",
    ]


@pytest.mark.parametrize("xi", [-1e-300, 1e-300, math.nextafter(math.pi / 2, 0), -1.57])
def test_what_is_just_inside_is_a_body(xi):
    assert Rattleback(**(GH | {"xi": xi})).xi == xi
    Rattleback(**(GH | {"theta": math.nextafter(1, 0), "phi": 5e-324}))
    Rattleback(**(GH | {"phi": math.nextafter(GH["theta"], 0)}))
    Rattleback(1 + 2e-9, 1 + 1e-9, 2e-9, 0.5, 0.1, -0.1)


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e4])
def test_shell_dumbbells_are_bodies_all_of_them(scale):
    """They sit on I_zz = I_xx + I_yy; rounding puts half of them past it."""
    rng = np.random.default_rng(32)
    *_, theta, phi, xi = table_one(10_000, 31)
    gamma = scale * rng.uniform(5, 15, theta.size)
    f_sd = 0.5 * rng.uniform(1e-6, 1 - 1e-6, theta.size)
    alpha, beta = shell_dumbbell(gamma, f_sd)
    past = gamma > (alpha - 1) + (beta - 1)
    assert 0.05 < past.mean() < 0.95
    assert list(violations(alpha, beta, gamma, theta, phi, xi)) == []
    for k in np.flatnonzero(past)[:100]:
        body = Rattleback.shell_dumbbell(
            gamma=gamma[k], f_sd=f_sd[k], theta=theta[k], phi=phi[k], xi=xi[k]
        )
        assert (body.alpha, body.beta, body.gamma) == (alpha[k], beta[k], gamma[k])


@pytest.mark.parametrize("rule", ["I_zz", "I_xx"])
def test_inertia_past_its_limit_is_refused(rule):
    rng = np.random.default_rng(33)
    for _ in range(100):
        i_yy = rng.uniform(0.1, 3)
        i_xx = i_yy + rng.uniform(0.1, 9)
        limit = i_xx + i_yy if rule == "I_zz" else i_xx - i_yy
        past = 1 if rule == "I_zz" else -1
        rest = (0.7, 0.05, -0.03)
        Rattleback(i_xx + 1, i_yy + 1, limit * (1 - past * 1e-9), *rest)
        Rattleback(i_xx + 1, i_yy + 1, limit, *rest)
        with pytest.raises(ValueError, match=f"no body has this inertia: {rule} "):
            Rattleback(i_xx + 1, i_yy + 1, limit + past * 1e-9 * (i_xx + 1), *rest)


def test_shell_dumbbell_map_is_two_dumbbells():
    """m_x/2 at (+-r_x, 0, 0) and m_y/2 at (0, +-r_y, 0), M = 1."""
    rng = np.random.default_rng(34)
    m_x = rng.uniform(0.1, 0.9, 50)
    r_x, r_y = rng.uniform(0.3, 1, 50), rng.uniform(4, 6, 50)
    i_xx, i_yy = (1 - m_x) * r_y**2, m_x * r_x**2
    i_zz = i_xx + i_yy
    alpha, beta = shell_dumbbell(i_zz, i_yy / i_zz)
    np.testing.assert_allclose(alpha, i_xx + 1, rtol=4 * EPS)
    np.testing.assert_allclose(beta, i_yy + 1, rtol=4 * EPS)
    assert [float(x) for x in shell_dumbbell(10, 0.1)] == [10.0, 2.0]
    assert shell_dumbbell(np.ones((3, 1)), np.full(4, 0.2))[0].shape == (3, 4)


@pytest.mark.parametrize("f_sd", [0.0, 0.5, -0.1, 0.7, math.nan])
def test_shell_dumbbell_share_is_below_one_half(f_sd):
    with pytest.raises(ValueError, match=f"f_sd is {f_sd:g}; it must lie between 0 and 0.5"):
        Rattleback.shell_dumbbell(gamma=10, f_sd=f_sd, theta=0.7, phi=0.05, xi=-0.03)


def test_mirror_image():
    body = Rattleback.gh()
    image = body.mirrored()
    assert image == Rattleback(**(GH | {"xi": -GH["xi"]}))
    assert image.xi > 0
    assert image.mirrored() == body
    # R Theta R^-1 of the image is the reflection of the body's.
    reflect = np.diag([1.0, -1.0])
    np.testing.assert_allclose(
        oracle.matrices(image)[0], reflect @ oracle.matrices(body)[0] @ reflect, atol=1e-16
    )


# --- the reduced dynamics -------------------------------------------------------------------------


def reduced_cases(size=60):
    rng = np.random.default_rng(35)
    for _ in range(size):
        n, k_p, k_r = rng.uniform(-1, 1), *(10 ** rng.uniform(-3, 1, 2))
        state = (n, *(10 ** rng.uniform(-8, 0, 2)))
        yield state, (k_p * rng.choice([-1, 1]), k_r, rng.uniform(1, 15))


def test_reduced_rhs_is_the_papers():
    for state, constants in reduced_cases():
        np.testing.assert_allclose(
            reduced.rhs(*state, *constants),
            oracle.reduced_rhs(0.0, state, *constants),
            rtol=4 * EPS,
            atol=4 * EPS * max(map(abs, state)),
        )
        assert reduced.energy(*state, *constants) == pytest.approx(
            0.5 * constants[2] * state[0] ** 2 + state[1] + state[2], rel=4 * EPS
        )
        assert float(reduced.casimir(*state[1:], *constants[:2])) == pytest.approx(
            oracle.reduced_C_I(state, *constants[:2]), rel=1e-13, abs=1e-12
        )


def test_casimir_without_one_mode_is_minus_infinity():
    got = reduced.casimir([1e-4, 0.0, 1e-4], [1e-4, 1e-4, 0.0], 0.5, 0.1)
    assert np.isfinite(got[0])
    assert np.all(np.isneginf(got[1:]))


def test_mode_energies_are_the_launchs():
    alpha, beta, gamma, theta, phi, xi = table_one(200, 36)
    rng = np.random.default_rng(37)
    found = theory.modes(alpha, beta, theta, phi, xi)
    w, psi = 10 ** rng.uniform(-12, 0, 200), rng.uniform(-np.pi, np.pi, 200)
    kinetic = 0.5 * (alpha * (w * np.cos(psi)) ** 2 + beta * (w * np.sin(psi)) ** 2)
    e_p, e_r = reduced.mode_energies(alpha, beta, found.psi_p, found.psi_r, w, psi)
    assert np.all(e_p >= 0)
    assert np.all(e_r >= 0)
    np.testing.assert_allclose(e_p + e_r, kinetic, rtol=1e-13)
    # Each is its own part of omega: along psi_p and psi_r, by solving for the components.
    for k in range(0, 200, 9):
        axes = np.array([[math.cos(a), math.sin(a)] for a in (found.psi_p[k], found.psi_r[k])]).T
        parts = axes * np.linalg.solve(axes, w[k] * np.array([np.cos(psi[k]), np.sin(psi[k])]))
        own = 0.5 * np.array([alpha[k], beta[k]]) @ parts**2
        np.testing.assert_allclose([e_p[k], e_r[k]], own, rtol=1e-9, atol=1e-14 * kinetic[k])
    # A launch along a mode has nothing of the other.
    for own, other, psi in ((0, 1, found.psi_p), (1, 0, found.psi_r)):
        parts = reduced.mode_energies(alpha, beta, found.psi_p, found.psi_r, w, psi)
        kinetic = 0.5 * w**2 * (alpha * np.cos(psi) ** 2 + beta * np.sin(psi) ** 2)
        np.testing.assert_allclose(parts[own], kinetic, rtol=1e-14)
        assert np.all(parts[other] == 0)
        speed = theory.oscillation_speed(alpha, beta, gamma, w, psi)
        np.testing.assert_allclose(parts[own], gamma * speed**2 / 2, rtol=1e-13)


# --- launches -------------------------------------------------------------------------------------


def test_direction_of_every_word():
    alpha, beta, _, theta, phi, xi = bodies = table_one(40, 38)
    n = np.where(np.arange(40) % 2, 0.1, -0.1)
    found = theory.modes(alpha, beta, theta, phi, xi)
    assert np.array_equal(launch.direction(found, n, "pitch"), found.psi_p)
    assert np.array_equal(launch.direction(found, n, "roll"), found.psi_r)
    relevant = launch.direction(found, n, "relevant")
    assert np.array_equal(relevant, np.where(n > 0, found.psi_p, found.psi_r))
    for k in (0, 1, 2, 3):
        body = mapping(bodies[:, k])
        assert relevant[k] == pytest.approx(oracle.relevant_psi(body, n[k]), abs=1e-13)
    # In the mirror image the other spin is unsteady.
    image = theory.modes(alpha, beta, theta, phi, -xi)
    assert np.array_equal(
        launch.direction(image, n, "relevant"), np.where(n < 0, image.psi_p, image.psi_r)
    )
    for degrees in (0.0, 30.0, -90, 180.0):
        got = launch.direction(found, n, degrees)
        assert got.shape == (40,)
        assert np.all(got == math.radians(degrees))
    with pytest.raises(ValueError, match="sideways"):
        launch.direction(found, n, "sideways")


@pytest.mark.parametrize("psi", ["relevant", "pitch", "roll", 30.0])
def test_direction_broadcasts_bodies_and_spins(psi):
    alpha, beta, _, theta, phi, xi = table_one(3, 39)[:, :, None]
    found = theory.modes(alpha, beta, theta, phi, xi)
    assert launch.direction(found, np.array([0.1, -0.1, 0.2, -0.5]), psi).shape == (3, 4)
    one = theory.modes(*(GH[x] for x in ("alpha", "beta", "theta", "phi", "xi")))
    assert launch.direction(one, 0.1, psi).shape == ()
    exact = theory_mp.reference(*GH.values(), 0.1, 0.01)
    wanted = {"relevant": exact["psi_p"], "pitch": exact["psi_p"], "roll": exact["psi_r"]}
    with mp.workdps(30):
        assert float(launch.direction(one, 0.1, psi)) == pytest.approx(
            float(wanted.get(psi, mp.pi / 6)), abs=4 * EPS
        )


def test_full_state_is_the_papers_launch():
    rng = np.random.default_rng(40)
    n, w = rng.uniform(-1, 1, (4, 1)), 10 ** rng.uniform(-12, 0, 5)
    psi = rng.uniform(-np.pi, np.pi, 5)
    states = launch.full_state(n, w, psi)
    assert states.shape == (4, 5, full.N_STATE)
    u, omega = full.to_vectors(np.moveaxis(states, -1, 0))
    for i in range(4):
        for j in range(5):
            wanted = oracle.launch(GH, n[i, 0], w[j], psi[j])
            assert np.array_equal(u[:, i, j], wanted[:3])
            np.testing.assert_allclose(omega[:, i, j], wanted[3:], rtol=4 * EPS)
            assert full.spin(*states[i, j]) == n[i, 0]
    assert launch.full_state(0.1, 0.01, 0.3).shape == (5,)
    assert launch.full_state(1, 1, 0)[4] == -1.0
