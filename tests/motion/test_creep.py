"""Creep: a patch that pivots gives way to the force that rolls the body."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import rattlesweep as rs
from rattlesweep.physics.creep import drift_of_patch, share_of_torque
from rattlesweep.physics.theory import creeping_coefficients

GH = rs.Rattleback.gh()

# First reversals by a program in vectors that integrates the velocity of the contact
# point under the law of the whole patch (Radau at 1e-7): n_i, push, lever, mu, t_r.
WHOLE_PATCH = (
    (-0.2, 0.1, 0.006, 0.5, 224.682),
    (-0.2, 0.1, 0.006, 0.3, 255.724),
    (-0.3, 0.01, 0.006, 0.5, 463.177),
)


@pytest.fixture(scope="module")
def creeping():
    """Return runs of GH with creep, one for each line of `WHOLE_PATCH`."""
    n_i, push, lever, mu, _ = np.transpose(WHOLE_PATCH)
    return rs.simulate(
        GH, n_i=n_i, omega_xy0=push, pivot=lever, creep=mu, t_end=600.0, tol=1e-10
    )


def test_reversals_are_those_of_the_whole_patch(creeping):
    assert_allclose(creeping.t_r, [t_r for *_, t_r in WHOLE_PATCH], rtol=1e-5)


def test_energy_less_work_is_conserved(creeping):
    assert np.all(np.abs(creeping.energy_drift) < 1e-9)
    assert np.all(creeping.creep_work > 0)
    assert np.all((creeping.creep_doubtful > 0) & (creeping.creep_doubtful < 1))


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


def test_what_creep_takes_from_the_coefficients():
    modes = rs.modes(GH)
    lever, mu = 0.006, 0.3
    pitch, roll = creeping_coefficients(GH.alpha, GH.beta, modes, lever, mu)
    strength = lever / mu**2
    assert_allclose((modes.K_p - pitch) / strength, 0.24747, rtol=1e-4)
    assert_allclose((modes.K_r - roll) / strength, 0.33948, rtol=1e-4)
    assert np.isnan(creeping_coefficients(GH.alpha, GH.beta, modes, lever, 0.0)).all()


def test_creep_needs_pivoting():
    with pytest.raises(rs.ConfigError, match=r"dissipation\.creep.*dissipation\.pivot"):
        rs.simulate(GH, n_i=-0.2, omega_xy0=0.1, creep=0.3, t_end=1.0)
