"""Bodies, the rules that they must satisfy, and the energies of a launch."""

import re

import numpy as np
import oracle
import pytest
from samples import table_one

from rattlesweep.physics import reduced, theory
from rattlesweep.physics.body import Rattleback, shell_dumbbell, violations

EPS = np.finfo(float).eps
GH = oracle.GH


RULES = """
alpha=nan: alpha is not a finite number
alpha=1e7: a moment of inertia is out of range; at most 1e+06 M a^2 is allowed
phi=0: theta is 0.6429 and phi 0; 0 < phi < theta < 1 is needed, or it tips over
theta=1: theta is 1 and phi 0.036; 0 < phi < theta < 1 is needed, or it tips over
phi=0.6429: phi 0.6429 is not below theta 0.6429; 0 < phi < theta < 1 is needed
beta=1: beta is 1; alpha > beta > 1 is needed
alpha=1.522: alpha 1.522 is not above beta 1.522; alpha > beta > 1 is needed
gamma=-3: gamma is -3; it must be positive
xi=0: the skew angle xi is 0 rad; -pi/2 < xi < 0 is needed, or xi > 0 for a mirror image
xi=2: the skew angle xi is 2 rad (114.592 deg); above -90 deg and below 90 deg is needed; at 90 deg, the radii of curvature may be exchanged
gamma=12.5620001: no body has this inertia: I_zz = gamma = 12.5620001 exceeds I_xx + I_yy = 12.562
gamma=11: no body has this inertia: I_xx = alpha - 1 = 12.04 exceeds I_yy + I_zz = 11.522
gamma=12.6: no body has this inertia: I_zz = gamma = 12.6 exceeds I_xx + I_yy = 12.562
"""  # noqa: E501


@pytest.mark.parametrize("rule", RULES.strip().splitlines())
def test_each_rule_has_its_message(rule):
    name, value, sentence = re.fullmatch(r"(\w+)=(\S+): (.*)", rule).groups()
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}$"):
        Rattleback(**(GH | {name: float(value)}))


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e4])
def test_all_shell_dumbbells_are_bodies(scale):
    """They satisfy I_zz = I_xx + I_yy, which many of them exceed by rounding."""
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


def test_mode_energies_add_up_to_that_of_the_launch():
    alpha, beta, gamma, theta, phi, xi = table_one(200, 36)
    rng = np.random.default_rng(37)
    modes = theory.modes(alpha, beta, theta, phi, xi)
    w = 10 ** rng.uniform(-12, 0, 200)
    psi = rng.uniform(-np.pi, np.pi, 200)
    kinetic = 0.5 * (alpha * (w * np.cos(psi)) ** 2 + beta * (w * np.sin(psi)) ** 2)
    e_p, e_r = reduced.launch_energies(alpha, beta, modes.psi_p, modes.psi_r, w, psi)
    assert np.all(e_p >= 0)
    assert np.all(e_r >= 0)
    np.testing.assert_allclose(e_p + e_r, kinetic, rtol=1e-13)
    # A launch along one mode has no energy in the other.
    for launched, still, psi in ((0, 1, modes.psi_p), (1, 0, modes.psi_r)):
        energies = reduced.launch_energies(
            alpha, beta, modes.psi_p, modes.psi_r, w, psi
        )
        kinetic = 0.5 * w**2 * (alpha * np.cos(psi) ** 2 + beta * np.sin(psi) ** 2)
        np.testing.assert_allclose(energies[launched], kinetic, rtol=1e-14)
        assert np.all(energies[still] == 0)
        speed = theory.oscillation_speed(alpha, beta, gamma, w, psi)
        np.testing.assert_allclose(energies[launched], gamma * speed**2 / 2, rtol=1e-13)
