"""The reference program for rubbing in pivoting against closed forms and limits."""

import math

import contact_mechanics
import creeping_patch
import friction_oracle
import hertz_patch
import numpy as np
import oracle
import pytest
from contact_mechanics import Body
from scipy.integrate import quad

GH = Body(**oracle.GH)


def start(n_i, push, psi=None):
    """Return ``u`` and ``omega`` of a launch of Garcia and Hubbard's body."""
    if psi is None:
        psi = oracle.relevant_psi(GH, n_i)
    y = oracle.launch(GH, n_i, push, psi)
    return y[:3], y[3:]


def launched(n_i, push, t_end, pivot, psi=None, **options):
    return friction_oracle.run(GH, *start(n_i, push, psi), t_end, pivot, **options)


def quadrature(x):
    """Return force and moment of Coulomb's law over Hertz's pressure on a circle.

    Radius, spin, and ``mu N`` are one.  The points turn about one at the distance x
    from the centre; on a chord through it the friction has one direction, and changes
    its sign with the distance.  Chebyshev's nodes are exact on a chord.
    """
    nodes = 24
    angles = np.arange(1, nodes + 1) * math.pi / (nodes + 1)
    weights = math.pi / (nodes + 1) * np.sin(angles) ** 2

    def chord(angle, turning):
        # The chord through (x, 0): distances from there are middle + half cos.
        middle = -x * math.cos(angle)
        half = math.sqrt(max(0.0, 1 - (x * math.sin(angle)) ** 2))
        distance = middle + half * np.cos(angles)
        arm = x * math.cos(angle) + distance if turning else math.cos(angle)
        pressure = 3 / (2 * math.pi) * half**2
        return float(pressure * np.sum(weights * distance * arm))

    widest = math.asin(1 / x) if x > 1 else math.pi / 2
    accuracy = {"epsabs": 1e-13, "epsrel": 1e-12, "limit": 200}
    force, _ = quad(chord, -widest, widest, args=(False,), **accuracy)
    moment, _ = quad(chord, -widest, widest, args=(True,), **accuracy)
    return -force, moment


@pytest.mark.parametrize("x", [0.1, 0.5, 0.999, 1, 1.001, 1.5, 2, 2.001, 5, 10, 40])
def test_closed_form_of_the_patch(x):
    force, moment = quadrature(x)
    assert hertz_patch.sliding_share(x) == pytest.approx(force, abs=1e-10)
    assert hertz_patch.turning_share(x) == pytest.approx(moment, abs=1e-10)


def test_table_of_the_patch():
    x = [0.1, 0.5, 1, 2, 5, 10]
    force = [0.1175, 0.5522, 0.8836, 0.9743, 0.9960, 0.9990]
    moment = [0.5832, 0.4556, 0.2209, 0.1019, 0.0401, 0.0200]
    np.testing.assert_allclose(
        list(map(hertz_patch.sliding_share, x)), force, atol=6e-5
    )
    np.testing.assert_allclose(
        list(map(hertz_patch.turning_share, x)), moment, atol=6e-5
    )


def test_zhuravlevs_first_approximation():
    """It has the slopes of both limits, and is up to 39 % and 48 % low."""
    x = np.geomspace(0.01, 100, 4001)
    force = x / (x + 8 / (3 * math.pi))
    moment = 3 * math.pi / 16 / (1 + 15 * math.pi / 16 * x)
    exact_force = np.array(list(map(hertz_patch.sliding_share, x)))
    exact_moment = np.array(list(map(hertz_patch.turning_share, x)))
    assert 1 - np.min(force / exact_force) == pytest.approx(0.39, abs=0.005)
    assert 1 - np.min(moment / exact_moment) == pytest.approx(0.48, abs=0.005)


def test_slope_and_inverse_of_the_torque():
    for y in (-3.0, -0.9, 0.2, 0.499, 0.7, 1.2):
        step = 1e-6
        ahead, behind = (hertz_patch.rubbing(y + k * step)[0] for k in (1, -1))
        slope = (ahead - behind) / (2 * step)
        assert hertz_patch.rubbing(y)[1] == pytest.approx(slope, abs=1e-9)
        share = hertz_patch.rubbing(y)[0]
        assert hertz_patch.ratio_of(share) == pytest.approx(y, rel=1e-10)


@pytest.mark.parametrize("mu", [math.inf, 0.3])
def test_vertical_spin(mu):
    """It loses l / gamma a unit of time, is dead at gamma n / l, and stays dead."""
    u, omega = np.array([0, 0, -1.0]), np.array([0, 0, -0.1])
    lever = 6e-3
    dead = GH.gamma * 0.1 / lever
    half = friction_oracle.run(GH, u, omega, dead / 2, lever, mu)
    assert half.at_end.y[5] == pytest.approx(-0.05, abs=1e-14)
    run = friction_oracle.run(GH, u, omega, dead + 10, lever, mu)
    assert run.t_r is None
    assert run.at_end.t_held == pytest.approx(dead, rel=1e-12)
    assert run.at_end.held_time == pytest.approx(10, rel=1e-9)
    assert run.at_end.pivot_work == pytest.approx(1, abs=1e-12)


def test_torque_of_a_held_spin_is_that_of_its_lever():
    """With the lever of the holding torque, rolling has the same forces."""
    rng = np.random.default_rng(3)
    stone = contact_mechanics.stone_of(GH, pivot=2e-3, rolling=1e-3, sigma=1e-3)
    for _ in range(10):
        u = np.append(rng.uniform(-0.3, 0.3, 2), -1)
        u = tuple(u / np.linalg.norm(u))
        omega = tuple(rng.uniform(-0.3, 0.3, 3))
        held = contact_mechanics.holding_torque(stone, u, omega)
        lever = held.torque / held.normal
        rolling = contact_mechanics.rolling_forces(stone, u, omega, lever)
        assert np.dot(u, held.turn) == pytest.approx(0, abs=1e-14)
        np.testing.assert_allclose(rolling.turn, held.turn, atol=1e-13)
        np.testing.assert_allclose(rolling.force, held.force, atol=1e-13)


@pytest.mark.slow
def test_without_a_lever_it_is_rolling():
    run = launched(0.3, 0.1, 45, 0.0, rtol=1e-11)
    psi = oracle.relevant_psi(GH, 0.3)
    t_r, y = oracle.first_reversal(GH, 0.3, 0.1, psi, 45)
    assert run.t_r == pytest.approx(t_r, abs=1e-9)
    np.testing.assert_allclose(run.at_reversal.y, y, atol=1e-9)


@pytest.mark.slow
def test_without_a_lever_it_slides_as_before():
    u, omega = start(0.3, 0.1)
    before = friction_oracle.run(GH, u, omega, 30, mu=0.3, rtol=1e-10)
    run = launched(0.3, 0.1, 30, 1e-12, mu=0.3, rtol=1e-10)
    assert run.at_end.n_slides == len(before.slides)
    assert run.at_end.slide_time == pytest.approx(before.at_end.slide_time, abs=1e-8)
    assert run.at_end.slide_work == pytest.approx(before.at_end.slide_work, abs=1e-9)


@pytest.mark.parametrize(
    ("n_i", "push", "t_end", "free", "changes"),
    [
        (0.1, 0.01, 115, 112.09, {5e-4: 0.1, 2e-3: 0.2, 6e-3: -2.5}),
        pytest.param(
            *(-0.2, 0.1, 220, 212.35, {5e-4: 0.3, 2e-3: 1.1, 6e-3: -1.4}),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_reversal_times(n_i, push, t_end, free, changes):
    for lever, percent in changes.items():
        run = launched(n_i, push, t_end, lever, rtol=1e-10)
        assert 100 * (run.t_r / free - 1) == pytest.approx(percent, abs=0.06)
        assert abs(run.at_end.energy_error) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lever", "t_r", "t_held"),
    [(5e-4, 882.4, None), (2e-3, None, 594), (6e-3, None, 204)],
)
def test_steady_spin_dies_before_it_turns(lever, t_r, t_held):
    run = launched(-0.1, 0.01, 885, lever, rtol=1e-10)
    if t_r is None:
        assert run.t_r is None
        assert run.at_end.t_held == pytest.approx(t_held, abs=0.5)
    else:
        assert run.t_r == pytest.approx(t_r, abs=0.05)


@pytest.mark.slow
def test_mirrored_slides():
    image = Body(**(oracle.GH | {"xi": -oracle.GH["xi"]}))
    mirror = np.array([1, -1, 1, -1, 1, -1])
    u, omega = start(0.3, 0.1)
    options = {"mu": 0.3, "rtol": 1e-10}
    run = friction_oracle.run(GH, u, omega, 30, 6e-3, **options)
    other = friction_oracle.run(
        image, u * mirror[:3], omega * mirror[3:], 30, 6e-3, **options
    )
    assert run.at_end.n_slides == other.at_end.n_slides > 0
    assert other.at_end.pivot_work == pytest.approx(run.at_end.pivot_work, abs=1e-10)
    np.testing.assert_allclose(other.at_end.y, mirror * run.at_end.y, atol=1e-8)


def test_regularised_torque_converges():
    """The error falls about as eps (orders 0.70 and 0.75 here)."""
    psi = oracle.modes(oracle.GH)["psi_r"]
    u, omega = start(0.0, 0.1, psi)
    wanted = launched(0.0, 0.1, 8, 2e-3, psi).at_end.y
    errors = []
    for eps in (1e-5, 1e-6, 1e-7):
        _, y = creeping_patch.zeros_of_regularised(
            GH, u, omega, 8, 2e-3, eps, rtol=1e-9
        )
        errors.append(np.max(np.abs(y[:6] - wanted)))
    assert errors[-1] < 1e-6
    assert np.all(np.diff(np.log10(errors)) < -0.6), errors


@pytest.mark.slow
def test_how_far_the_torque_is_from_the_patch():
    """The law of sweeps is off by percents at most where the whole patch rubs.

    A run takes up to 6 s of processor time, nearly all of it under the whole law.
    """
    off = []
    for n_i, push in ((0.1, 0.01), (0.2, 0.1), (-0.2, 0.1)):
        for patch in (0.005, 0.01, 0.02, 0.05):
            lever = 3 * math.pi / 16 * 0.5 * patch
            u, omega = start(n_i, push)
            crept = creeping_patch.crept(GH, u, omega, 300, 0.5, patch)
            run = launched(n_i, push, 300, lever, rtol=1e-9)
            assert abs(crept.energy_error) < 1e-6
            if run.t_r is None:
                # No spin is held where nothing sticks: it creeps through zero.
                assert run.at_end.t_held == pytest.approx(crept.t_r, rel=0.01)
            else:
                off.append(100 * abs(run.t_r / crept.t_r - 1))
            print(n_i, push, patch, crept, run.t_r, run.at_end.t_held)
    assert len(off) == 11
    assert np.max(off) < 5.5
    assert np.median(off) < 1.5


def test_a_launch_that_slides_at_once_does_not_depend_on_its_first_moment():
    """Half of the moment gives the same to the errors of the steps, also with a torque.

    The foot leaves with the pull that it has from the start.
    """
    u, omega = start(0.3, 0.3)
    options = {"mu": 0.05, "rtol": 1e-11}
    ends = []
    for moment in (1e-6, 5e-7):
        run = friction_oracle.run(GH, u, omega, 1.0, 6e-3, first_time=moment, **options)
        assert run.slides[0].begin == 0
        ends.append(run.at_end.y)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-10)
