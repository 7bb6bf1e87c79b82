"""The oracles checked against each other and against the paper's own numbers."""

import math

import numpy as np
import oracle
import pytest
import theory_mp

NAMES = tuple(oracle.GH)
OTHERS = [
    {"alpha": 9.3, "beta": 2.1, "gamma": 9.4, "theta": 0.81, "phi": 0.07, "xi": -0.02},
    {"alpha": 5.0, "beta": 1.4, "gamma": 4.4, "theta": 0.62, "phi": 0.25, "xi": -0.9},
    # the paper's footnote: the pitch slower than the roll
    {"alpha": 8.0, "beta": 1.3, "gamma": 7.3, "theta": 0.5, "phi": 0.35, "xi": -0.05},
]
BODIES = [oracle.GH, *OTHERS]


def values(body):
    return [body[name] for name in NAMES]


def states(count, seed=5):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        u = np.array([*rng.uniform(-0.1, 0.1, 2), -1.0])
        yield np.concatenate([u / np.linalg.norm(u), rng.uniform(-0.5, 0.5, 3)])


# --- the full equations ------------------------------------------------------------------------


@pytest.mark.parametrize("body", BODIES)
def test_equations_keep_energy_and_norm_and_balance_the_torque(body):
    h = 1e-5
    for y in states(5):
        dy = oracle.rhs(0.0, y, body)
        slope = (oracle.energy(y + h * dy, body) - oracle.energy(y - h * dy, body)) / (2 * h)
        # E is extended off |u| = 1, but dy is tangent to it
        assert slope == pytest.approx(0, abs=1e-8)
        assert y[:3] @ dy[:3] == pytest.approx(0, abs=1e-15)
        inert, w = oracle.matrices(body)[2], y[3:]
        change = inert @ dy[3:] + np.cross(w, inert @ w)  # Eq. em-2
        torque = np.cross(oracle.contact_point(y[:3], body), oracle.contact_force(y, body))
        assert np.allclose(change, torque, atol=1e-12)
        spins = [oracle.spin(y + s * h * dy) for s in (1, -1)]
        assert oracle.spin_rate(y, body) == pytest.approx((spins[0] - spins[1]) / (2 * h), abs=1e-8)


# --- modes and torque coefficients --------------------------------------------------------------


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("n_i", [0.1, -0.1])
def test_double_and_50_digit_theory_agree(body, n_i):
    m, ref = oracle.modes(body), theory_mp.reference(*values(body), n_i, 0.01)
    for name, value in m.items():
        assert value == pytest.approx(float(ref[name]), rel=1e-11), name
    own = "p" if n_i > 0 else "r"
    k, psi = m["K_" + own], m["psi_" + own]
    y = oracle.launch(body, n_i, 0.01, psi)
    n_0 = math.sqrt(2 * oracle.energy(y, body) / body["gamma"])
    assert float(ref["n_0"]) == pytest.approx(n_0, rel=1e-13)
    t = math.log((n_0 + abs(n_i)) / (n_0 - abs(n_i))) / (n_0 * k)
    assert float(ref["t_rgh"]) == pytest.approx(t, rel=1e-9)


# --- growth about steady spin -------------------------------------------------------------------


# --- reversal times -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("n_i", "name", "wanted", "off"),
    [(0.1, "psi_p", 112.093877963873, 1e-9), (-0.1, "psi_r", 809.857417847725, 5e-9)],
)
def test_gh_reversals(n_i, name, wanted, off):
    psi = oracle.modes(oracle.GH)[name]
    t_r, y = oracle.first_reversal(oracle.GH, n_i, 0.01, psi, 900.0)
    assert t_r == pytest.approx(wanted, abs=off)
    assert oracle.spin(y) == pytest.approx(0, abs=1e-14)
