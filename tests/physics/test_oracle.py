"""The oracles checked against each other and against the paper's own numbers."""

import math
from types import SimpleNamespace

import numpy as np
import oracle
import pytest
import theory_mp
from mpmath import mp
from scipy.integrate import solve_ivp

NAMES = ("alpha", "beta", "gamma", "theta", "phi", "xi")
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
def test_contact_point_lies_on_the_surface_with_its_normal_along_u(body):
    for y in states(5):
        x, yy, z = r = oracle.contact_point(y[:3], body)
        c = oracle.curvature(body)
        assert z - 1 + 0.5 * r[:2] @ c @ r[:2] == pytest.approx(0, abs=1e-14)
        normal = np.append(c @ np.array([x, yy]), 1.0)
        assert np.allclose(np.cross(normal, y[:3]), 0, atol=1e-14)


@pytest.mark.parametrize("body", BODIES)
def test_equations_keep_energy_and_norm_and_balance_the_torque(body):
    h = 1e-5
    for y in states(5):
        dy = oracle.rhs(0.0, y, body)
        slope = (oracle.energy(y + h * dy, body) - oracle.energy(y - h * dy, body)) / (2 * h)
        # E is extended off |u| = 1, but dy is tangent to it
        assert slope == pytest.approx(0, abs=1e-8)
        assert y[:3] @ dy[:3] == pytest.approx(0, abs=1e-15)
        inert, w = oracle.inertia(body), y[3:]
        change = inert @ dy[3:] + np.cross(w, inert @ w)  # Eq. em-2
        torque = np.cross(oracle.contact_point(y[:3], body), oracle.contact_force(y, body))
        assert np.allclose(change, torque, atol=1e-12)
        spins = [oracle.spin(y + s * h * dy) for s in (1, -1)]
        assert oracle.spin_rate(y, body) == pytest.approx((spins[0] - spins[1]) / (2 * h), abs=1e-8)


def test_force_is_the_weight_at_rest_and_in_steady_spin():
    for n in (0.0, 0.7, -0.7):
        y = oracle.launch(oracle.GH, n, 0.0, 0.0)
        assert oracle.force_components(y, oracle.GH) == pytest.approx((1.0, 0.0), abs=1e-15)
        assert np.allclose(oracle.rhs(0.0, y, oracle.GH), 0)


def test_launch_energy_is_equation_def_n0():
    ref = theory_mp.reference(*values(oracle.GH), 0.1, 0.01)
    y = oracle.launch(oracle.GH, 0.1, 0.01, float(ref["psi_p"]))
    assert oracle.spin(y) == 0.1
    assert oracle.energy(y, oracle.GH) == pytest.approx(12.28 / 2 * float(ref["n_0"]) ** 2)


def test_energy_drift_over_the_reversal_is_at_rounding():
    y0 = oracle.launch(oracle.GH, 0.1, 0.01, oracle.relevant_psi(oracle.GH, 0.1))
    sol = solve_ivp(oracle.rhs, (0, 112.1), y0, "DOP853", args=(oracle.GH,), rtol=1e-12, atol=1e-15)
    e = np.array([oracle.energy(y, oracle.GH) for y in sol.y.T])
    assert np.abs(e / e[0] - 1).max() < 1e-10
    assert np.abs(np.sum(sol.y[:3] ** 2, axis=0) - 1).max() < 1e-11


def test_body_may_be_an_object():
    y = next(states(1))
    assert np.array_equal(
        oracle.rhs(0.0, y, oracle.GH), oracle.rhs(0.0, y, SimpleNamespace(**oracle.GH))
    )


# --- modes and torque coefficients --------------------------------------------------------------


def test_gh_numbers_of_the_paper():
    m = oracle.modes(oracle.GH)
    assert m["K_p"] == pytest.approx(0.553, abs=5e-4)
    assert m["K_r"] == pytest.approx(0.0967, abs=1e-4)  # 0.09676, which the paper cuts
    assert m["omega_p"] == pytest.approx(1.44, abs=5e-3)
    assert m["omega_r"] == pytest.approx(0.602, abs=5e-4)
    assert math.degrees(m["psi_p"]) == pytest.approx(-17, abs=0.5)
    assert math.degrees(m["psi_r"]) == pytest.approx(88, abs=0.5)


@pytest.mark.parametrize("body", BODIES)
def test_closed_forms_of_the_torque_coefficients(body):
    m = oracle.modes(body)
    a, b, _, th, ph, xi = values(body)
    diff = -0.5 * math.sin(2 * xi) * (1 / b - 1 / a) * (1 / ph - 1 / th)
    p2, r2 = m["omega_p"] ** 2, m["omega_r"] ** 2
    assert m["K_p"] / m["K_r"] == pytest.approx(p2 / r2, rel=1e-10)  # Eq. k-rat
    assert m["K_p"] - m["K_r"] == pytest.approx(diff, rel=1e-12)  # Eq. k-diff
    assert m["K_p"] == pytest.approx(diff * p2 / (p2 - r2), rel=1e-10)  # Eq. Kp
    assert m["K_r"] == pytest.approx(diff * r2 / (p2 - r2), rel=1e-10)  # Eq. Kr


@pytest.mark.parametrize("body", BODIES)
def test_torque_coefficients_are_the_mean_torques(body):
    m = oracle.modes(body)
    for mode, k in (("p", -m["K_p"]), ("r", m["K_r"])):
        got = oracle.mean_torque_over_energy(body, mode, samples=64)
        assert got == pytest.approx(k, rel=1e-5)


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


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("n", [1e-4, 0.2, -0.6, -3.0])
def test_two_linearisations_agree(body, n):
    exact = np.array([complex(v) for v in theory_mp.growth_exact(*values(body), n)])
    assert np.allclose(oracle.linear_growth(body, n), exact, rtol=0, atol=1e-12)
    # and the complex step against a central difference
    y0, h = np.array([0, 0, -1.0, 0, 0, -n]), 1e-6
    which = [0, 1, 3, 4]
    jac = [
        (oracle.rhs(0, y0 + h * e, body) - oracle.rhs(0, y0 - h * e, body))[which] / (2 * h)
        for e in np.eye(6)[which]
    ]
    assert np.allclose(np.array(jac).T, oracle.jacobian_spin(body, n), atol=1e-6)


@pytest.mark.parametrize("n", [1e-3, 1e-2, -1e-2])
@pytest.mark.parametrize("body", BODIES[:2])
def test_small_spin_growth_tends_to_half_k(body, n):
    m, lam = oracle.modes(body), oracle.linear_growth(body, n)
    assert lam[0].real == pytest.approx(n * m["K_p"] / 2, rel=10 * n * n)
    assert lam[1].real == pytest.approx(-n * m["K_r"] / 2, rel=10 * n * n)
    assert lam[:2].imag == pytest.approx([m["omega_p"], m["omega_r"]], rel=10 * n * n)


@pytest.mark.parametrize("body", BODIES)
def test_growth_rates_sum_to_n_times_k_p_minus_k_r_at_any_spin(body):
    m = oracle.modes(body)
    for n in (0.01, -0.7, 5.0):
        total = np.trace(oracle.jacobian_spin(body, n))
        assert total == pytest.approx(n * (m["K_p"] - m["K_r"]), rel=1e-9)


@pytest.mark.parametrize("body", BODIES)
def test_threshold_is_where_the_roll_stops_growing(body):
    n_c1 = theory_mp.reference(*values(body), -0.1, 0.01)["n_c1"]
    if n_c1 is None:
        for n in (-0.1, -1.0, -30.0):
            assert oracle.linear_growth(body, n).real.max() > 0
        return
    with mp.workdps(50):
        at = theory_mp.growth_exact(*values(body), n_c1)
        above = theory_mp.growth_exact(*values(body), n_c1 * (1 - mp.mpf("1e-6")))
        below = theory_mp.growth_exact(*values(body), n_c1 * (1 + mp.mpf("1e-6")))
        hopf = min(at, key=lambda v: abs(v - 1j * abs(n_c1)))
        assert abs(hopf - 1j * abs(n_c1)) < mp.mpf("1e-40")  # its frequency is |n_c1| itself
    assert max(v.real for v in above) > 0 > max(v.real for v in below)


def test_both_kinds_of_threshold_are_tested():
    found = {theory_mp.n_c1_squared(*values(b)[:5]) > 0 for b in BODIES}
    assert found == {True, False}


def test_stability_beyond_n_c1_has_a_second_end_when_gamma_is_small():
    # Not in the paper: det[(B - 1) + n^2 (B - diag(alpha - gamma, beta - gamma))] must stay > 0.
    body = {
        "alpha": 11.85,
        "beta": 11.33,
        "gamma": 0.672,
        "theta": 0.9632,
        "phi": 0.29,
        "xi": -1.15,
    }
    n_c1 = float(theory_mp.reference(*values(body), -0.1, 0.01)["n_c1"])
    growth = [oracle.linear_growth(body, n_c1 * f).real.max() for f in (0.9, 1.1, 3.0)]
    assert growth[0] > 0 > growth[1]
    assert growth[2] > 0


# --- reversal times -----------------------------------------------------------------------------


def test_gh_unsteady_reversal():
    psi = oracle.modes(oracle.GH)["psi_p"]
    t_r, y = oracle.first_reversal(oracle.GH, 0.1, 0.01, psi, 130.0)
    assert t_r == pytest.approx(112.093877963873, abs=1e-9)
    assert oracle.spin(y) == pytest.approx(0, abs=1e-14)


@pytest.mark.slow
def test_gh_steady_reversal():
    psi = oracle.modes(oracle.GH)["psi_r"]
    t_r, _ = oracle.first_reversal(oracle.GH, -0.1, 0.01, psi, 900.0)
    assert t_r == pytest.approx(809.857417847725, abs=5e-9)


def test_no_reversal_gives_none_and_the_end_state():
    t_r, y = oracle.first_reversal(oracle.GH, 0.1, 0.01, -0.3, 2.0)
    t_k, z = oracle.naive_rk4(oracle.GH, oracle.launch(oracle.GH, 0.1, 0.01, -0.3), 0.01, 2.0)
    assert t_r is None
    assert t_k is None
    assert np.allclose(y, z, atol=1e-9)


# With |omega_xy0| = 0.1 GH's spin just touches zero at t = 1.967 when n_i is this.
TOUCH = 0.00663381740279008


@pytest.mark.parametrize(
    ("offset", "expected"),
    [(-1e-4, 1.85117222647), (-1e-7, 1.96356847665), (-1e-11, 1.967217), (1e-11, 3.13791070912)],
)
def test_grazing_zeros(offset, expected):
    psi = oracle.modes(oracle.GH)["psi_p"]
    t_r, _ = oracle.first_reversal(oracle.GH, TOUCH + offset, 0.1, psi, 6.0)
    assert t_r == pytest.approx(expected, abs=1e-6 if offset == -1e-11 else 1e-10)
    t_k, _ = oracle.naive_rk4(
        oracle.GH, oracle.launch(oracle.GH, TOUCH + offset, 0.1, psi), 0.01, 6.0
    )
    assert t_k == pytest.approx(t_r, abs=2e-5)


def test_launch_sign_does_not_matter():
    psi = oracle.modes(oracle.GH)["psi_p"]
    a, _ = oracle.first_reversal(oracle.GH, 0.02, 0.2, psi, 4.0)
    b, _ = oracle.first_reversal(oracle.GH, 0.02, 0.2, psi + math.pi, 4.0)
    assert a == pytest.approx(b, abs=1e-10)


def test_rk4_is_fourth_order_and_tends_to_the_oracle():
    y0 = oracle.launch(oracle.GH, 0.02, 0.2, -0.3)
    t_r, _ = oracle.first_zero(oracle.GH, y0, 4.0)
    errors = [abs(oracle.naive_rk4(oracle.GH, y0, dt, 4.0)[0] - t_r) for dt in (0.04, 0.02, 0.01)]
    assert errors[2] < 1e-8
    assert 10 < errors[0] / errors[1] < 24
    assert 10 < errors[1] / errors[2] < 24


# --- reduced dynamics ---------------------------------------------------------------------------


def test_reduced_dynamics_keeps_both_invariants_and_gives_the_formula():
    ref = theory_mp.reference(*values(oracle.GH), 0.1, 0.01)
    k_p, k_r, n_0 = (float(ref[name]) for name in ("K_p", "K_r", "n_0"))
    i_eff, e_p = 12.28, 0.5 * 12.28 * (n_0**2 - 0.1**2)

    def crossing(t, y, *args):
        return y[0]

    crossing.terminal = True
    y0 = [0.1, e_p, 1e-30]
    sol = solve_ivp(
        oracle.reduced_rhs,
        (0, 300),
        y0,
        "DOP853",
        args=(k_p, k_r, i_eff),
        rtol=1e-12,
        atol=1e-40,
        events=crossing,
    )
    assert sol.t[-1] == pytest.approx(float(ref["t_rgh"]), rel=1e-9)
    end = sol.y[:, -1]
    e_tot, c_i = oracle.reduced_E_tot(y0, i_eff), oracle.reduced_C_I(y0, k_p, k_r)
    assert oracle.reduced_E_tot(end, i_eff) == pytest.approx(e_tot, rel=1e-10)
    assert oracle.reduced_C_I(end, k_p, k_r) == pytest.approx(c_i, rel=1e-10)
