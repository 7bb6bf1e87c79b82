"""Creep: a patch that pivots gives way to the force that rolls the body."""

import contact_mechanics
import creeping_patch
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import rattlesweep as rs
from rattlesweep.config.read import parse_config
from rattlesweep.motion.model import find_model
from rattlesweep.physics import full
from rattlesweep.physics.friction.creep import drift, drift_of_patch, share_of_torque
from rattlesweep.physics.theory import creeping_coefficients

GH = rs.Rattleback.gh()

# First reversals by a program in vectors that integrates the velocity of the contact
# point under the law of the whole patch (Radau at 1e-7): n_i, push, lever, mu, t_r.
WHOLE_PATCH = (
    (-0.2, 0.1, 0.006, 0.5, 224.682),
    (-0.2, 0.1, 0.006, 0.3, 255.724),
    (-0.3, 0.01, 0.006, 0.5, 463.177),
)


# Of the time of a reversal, where the foot slides outright before it.
SLIDING_ERROR = 0.003


def launched(n_i, push):
    """Return ``(u, omega)`` of a launch of GH in the steady direction."""
    psi = rs.modes(GH).psi_r
    return (0.0, 0.0, -1.0, push * np.cos(psi), push * np.sin(psi), -n_i)


def under_the_whole_patch(n_i, push, lever, mu, t_end):
    """Return what becomes of such a launch under the whole law of the patch."""
    state = launched(n_i, push)
    patch = 16 * lever / (3 * np.pi * mu)
    return creeping_patch.crept(
        GH, state[:3], state[3:], t_end, mu, patch, rtol=1e-7, method="LSODA"
    )


def growth_of_model(n_i, lever, mu):
    """Return the growth rates of roll and pitch by the equations of sweeps."""
    model = find_model("full_pivoting_creep")
    body = full.constants(GH.alpha, GH.beta, GH.gamma, GH.theta, GH.phi, GH.xi)
    values = dict(zip(full.CONSTANTS, body, strict=True))
    values |= {"k": 0.0, "sigma": 0.0, "pivot": lever, "creep": mu}
    values["sense"] = np.sign(n_i)
    constants = tuple(float(values[name]) for name in model.constants)
    upright = np.zeros(model.n_state)
    upright[4] = -n_i
    columns = []
    for place in range(4):
        step = np.zeros(model.n_state)
        step[place] = 1e-6
        ahead = np.array(model.rhs(tuple(upright + step), constants))
        behind = np.array(model.rhs(tuple(upright - step), constants))
        columns.append((ahead - behind)[:4] / 2e-6)
    swings = np.linalg.eigvals(np.transpose(columns))
    swings = swings[swings.imag > 0]
    return swings[np.argsort(swings.imag)].real


@pytest.fixture(scope="module")
def creeping():
    """Return runs of GH with creep, one for each line of `WHOLE_PATCH`."""
    n_i, push, lever, mu, _ = np.transpose(WHOLE_PATCH)
    return rs.simulate(
        GH, n_i=n_i, omega_xy0=push, pivot=lever, creep=mu, t_end=600.0, tol=1e-10
    )


@pytest.mark.slow
def test_reversals_are_those_of_the_whole_patch(creeping):
    assert_allclose(creeping.t_r, [t_r for *_, t_r in WHOLE_PATCH], rtol=1e-5)


@pytest.mark.slow
def test_a_foot_that_slides_and_creeps_follows_the_whole_patch():
    """The body needs a friction of 0.38 and has 0.3; it ended as jammed."""
    n_i, push, lever, mu = -0.3, 0.05, 0.006, 0.3
    whole = under_the_whole_patch(n_i, push, lever, mu, 400.0)
    assert whole.t_r == pytest.approx(329.968, rel=1e-4)
    losses = {"pivot": lever, "mu": mu, "creep": mu}
    run = rs.simulate(GH, n_i=n_i, omega_xy0=push, **losses, t_end=400.0, tol=1e-10)
    assert run.status == "ok"
    assert run.n_slides > 0
    assert abs(run.energy_drift) < 1e-8
    assert run.t_r == pytest.approx(whole.t_r, rel=SLIDING_ERROR)


@pytest.mark.slow
def test_a_spin_that_the_whole_patch_holds_is_held():
    """A program of the whole patch passes zero when this spin is held.

    The whole law smoothed over a spin of ``s`` lets it through zero, and then keeps it
    at a multiple of ``s``.
    """
    n_i, push, lever, mu = -0.3, 0.01, 0.006, 0.2
    whole = under_the_whole_patch(n_i, push, lever, mu, 700.0)
    assert whole.t_r == pytest.approx(604.708, rel=1e-4)
    run = rs.simulate(GH, n_i=n_i, omega_xy0=push, pivot=lever, creep=mu, t_end=700.0)
    assert run.t_r is None
    assert run.t_held == pytest.approx(whole.t_r, rel=1e-4)
    assert run.type == "D"
    spins = []
    for smoothest in (1e-4, 3e-5):
        rates = creeping_patch.patch_rates(
            contact_mechanics.stone_of(GH, mu, pivot=lever), smoothest
        )
        start = [*launched(n_i, push), 0, 0, 0, 0]
        followed = solve_ivp(rates, (0, 680), start, "LSODA", rtol=1e-7, atol=1e-10)
        late = followed.y[:, followed.t > 640]
        spins.append(np.abs(np.sum(late[:3] * late[3:6], axis=0)).max() / smoothest)
    assert max(spins) < 0.5
    assert spins[0] == pytest.approx(spins[1], rel=0.1)


@pytest.mark.parametrize(
    ("n_i", "lever", "mu", "seen"),
    [
        (-0.1, 0.002, 0.5, 0.004632),
        (-0.1, 0.006, 0.3, 0.003638),
        (-0.2, 0.006, 0.3, 0.006884),
        (0.1, 0.006, 0.3, 0.026837),
    ],
)
def test_growth_rates_are_those_of_the_whole_patch(n_i, lever, mu, seen):
    """Those that were seen are of creep alone; the torque itself changes them, too."""
    relevant = 1 if n_i > 0 else 0
    creep = creeping_patch.growth_under_patch(GH, n_i, lever, mu, has_torque=False)
    assert creep[relevant] == pytest.approx(seen, rel=2e-4)
    both = creeping_patch.growth_under_patch(GH, n_i, lever, mu)
    torque = both[relevant] - creep[relevant]
    # For the roll this is up to 7 % of the growth, for the pitch 1 %.
    assert torque / (lever * n_i) == pytest.approx(-0.386, rel=0.02)
    assert_allclose(growth_of_model(n_i, lever, mu), both, rtol=3e-4)


@pytest.mark.slow
def test_energy_less_work_is_conserved(creeping):
    assert np.all(np.abs(creeping.energy_drift) < 1e-9)
    assert np.all(creeping.creep_work > 0)
    assert np.all((creeping.creep_doubtful > 0) & (creeping.creep_doubtful < 1))


@pytest.mark.slow
def test_a_mirrored_body_does_the_same(creeping):
    n_i, push, lever, mu, _ = np.transpose(WHOLE_PATCH)
    mirrored = rs.Rattleback(
        alpha=GH.alpha,
        beta=GH.beta,
        gamma=GH.gamma,
        theta=GH.theta,
        phi=GH.phi,
        xi=-GH.xi,
    )
    psi = np.full(len(n_i), rs.modes(GH).psi_r)
    same = rs.simulate(
        mirrored,
        omega=np.stack([-push * np.cos(psi), push * np.sin(psi), n_i], axis=1),
        u=(0.0, 0.0, -1.0),
        pivot=lever,
        creep=mu,
        t_end=600.0,
        tol=1e-10,
    )
    assert_allclose(same.t_r, creeping.t_r, rtol=1e-8)


@pytest.mark.slow
def test_creep_vanishes_as_the_patch_gets_rough():
    """It is a correction of order 1 / mu^2, and none at zero, to the bit."""
    mu = np.array([0.0, 10.0, 20.0, 40.0])
    runs = rs.simulate(GH, n_i=-0.2, omega_xy0=0.1, pivot=0.006, creep=mu, t_end=300.0)
    without = rs.simulate(GH, n_i=-0.2, omega_xy0=0.1, pivot=0.006, t_end=300.0)
    assert runs.t_r[0] == without.t_r
    later = runs.t_r.to_numpy()[1:] - without.t_r
    assert_allclose(later * mu[1:] ** 2, later[2] * mu[3] ** 2, rtol=2e-2)
    assert later[0] > 4 * later[1] > 16 * later[2] > 0


def test_the_drift_inverts_the_force():
    x = np.linspace(0.0, 0.999, 50)
    force = 3 * np.pi / 32 * (4 * x - x**3)
    assert_allclose([drift_of_patch(share) for share in force], x, atol=2e-6)
    # The torque and the force of one patch have a common potential at x = 1.
    assert share_of_torque(1.0) == 0.375


@pytest.mark.parametrize("normal", [1e-3, 0.0, -1e-3, -0.5])
def test_a_body_that_the_plane_would_have_to_pull_drifts_with_the_rim(normal):
    """Such a state made a run fail as nonfinite: the drift had no bound."""
    u = (0.0, 0.0, -1.0)
    omega = (0.4, 0.3, 0.3)
    r = (0.1, 0.2, 1.0)
    v, x, is_sure = drift(
        u, omega, (0.5, -0.3, 0.1), r, (0.1, 0.2, 0.0), normal, 0.006, 0.3
    )
    assert x == pytest.approx(1.0, abs=1e-6)
    assert np.linalg.norm(v) == pytest.approx(16 / (3 * np.pi) * 0.02 * 0.3, rel=1e-6)
    assert not is_sure


def test_what_creep_takes_from_the_coefficients():
    modes = rs.modes(GH)
    lever, mu = 0.006, 0.3
    pitch, roll = creeping_coefficients(GH.alpha, GH.beta, modes, lever, mu)
    strength = lever / mu**2
    assert_allclose((modes.K_p - pitch) / strength, 0.24747, rtol=1e-4)
    assert_allclose((modes.K_r - roll) / strength, 0.33948, rtol=1e-4)
    assert np.isnan(creeping_coefficients(GH.alpha, GH.beta, modes, lever, 0.0)).all()


def test_a_mirrored_body_loses_as_much_of_its_coefficients():
    modes = rs.modes(GH)
    mirrored = rs.modes(GH.replace(xi=-GH.xi))
    same = creeping_coefficients(GH.alpha, GH.beta, mirrored, 0.006, 0.3)
    wanted = creeping_coefficients(GH.alpha, GH.beta, modes, 0.006, 0.3)
    assert_allclose(same, np.negative(wanted), rtol=1e-12)


@pytest.mark.parametrize(
    ("losses", "creep"),
    [
        ({"pivot": 0.002, "mu": 0.3}, [0]),
        ({"pivot": 0.002, "mu": 0.3, "creep": "mu"}, ["mu"]),
        ({"pivot": 0.002, "mu": 0.3, "creep": 0.2}, [0.2]),
        ({"pivot": 0.002}, [0]),
        ({"mu": 0.3}, [0]),
    ],
)
def test_what_creeps_is_asked_for(losses, creep):
    bodies = {"source": "preset", "name": "GH"}
    spin = {"n_i": -0.2, "omega_xy0": 0.1}
    config = parse_config({"bodies": bodies, "spin": spin, "dissipation": losses})
    assert config.dissipation.creep == creep


def test_the_word_mu_needs_mu():
    with pytest.raises(rs.ConfigError, match=r"dissipation\.creep.*dissipation\.mu"):
        rs.sweep(
            {
                "bodies": {"source": "preset", "name": "GH"},
                "spin": {"n_i": -0.2, "omega_xy0": 0.1},
                "dissipation": {"pivot": 0.002, "creep": "mu"},
            }
        )


def test_creep_needs_pivoting():
    with pytest.raises(rs.ConfigError, match=r"^creep: .*give pivot, or leave creep"):
        rs.simulate(GH, n_i=-0.2, omega_xy0=0.1, creep=0.3, t_end=1.0)
