"""Rates of losses against eigenvalues, quadrature, and bodies in a mirror."""

import numpy as np
import pytest

import rattlesweep as rs
from rattlesweep.analysis.derived import derived
from rattlesweep.physics import full, steady, theory
from rattlesweep.physics.friction.rolling_mean import rolling_losses

GH = rs.Rattleback.gh()
MODES = theory.modes(GH.alpha, GH.beta, GH.theta, GH.phi, GH.xi)


def contact(u):
    """Return the contact point of GH under the vertical ``u``, and its derivative."""
    c, s = np.cos(GH.xi), np.sin(GH.xi)
    axes = np.array([[c, -s], [s, c]])
    curvature = axes @ np.diag([GH.theta, GH.phi]) @ axes.T
    inverse = np.linalg.inv(curvature)
    slope = u[:2] / u[2]
    x = inverse @ slope
    point = np.array([*x, 1 - 0.5 * slope @ x])
    slope_by_u = np.array(
        [[1 / u[2], 0, -slope[0] / u[2]], [0, 1 / u[2], -slope[1] / u[2]]]
    )
    x_by_u = inverse @ slope_by_u
    return point, np.vstack([x_by_u, -slope @ x_by_u])


def slipping_rates(y, resistance):
    """Return d(u, omega, v)/dt of a body that slips under ``F_t = -k v_c``.

    ``resistance(n, N)`` is ``k``.
    """
    u, omega, v = y[:3], y[3:6], y[6:]
    inertia = np.array([GH.alpha - 1, GH.beta - 1, GH.gamma])
    r, r_by_u = contact(u)
    u_rate = np.cross(u, omega)
    r_rate = r_by_u @ u_rate
    slip = v + np.cross(omega, r)
    slip -= (u @ slip) * u

    def rates(normal):
        force = normal * u - resistance(u @ omega, normal) * slip
        turned = np.cross(r, force) - np.cross(omega, inertia * omega)
        turned = turned / inertia
        moved = force - u - np.cross(omega, v)
        return turned, moved

    def lift(normal):
        # d/dt (u . v_c), which is zero on the plane.
        turned, moved = rates(normal)
        full_slip = v + np.cross(omega, r)
        rate = moved + np.cross(turned, r) + np.cross(omega, r_rate)
        return u @ (rate + np.cross(omega, full_slip))

    normal = 1.0
    for _ in range(4):
        # Linear in N, or nearly so.
        slope = lift(normal + 0.5) - lift(normal - 0.5)
        normal -= lift(normal) / slope
    turned, moved = rates(normal)
    return np.concatenate([u_rate, turned, moved])


def eigenvalue_rates(n, resistance):
    """Return the growth rates of pitch and roll about a steady spin."""
    steady_state = np.array([0, 0, -1.0, 0, 0, -n, 0, 0, 0])
    step = 1e-6
    columns = [
        slipping_rates(steady_state + step * e, resistance)
        - slipping_rates(steady_state - step * e, resistance)
        for e in np.eye(9)
    ]
    values = np.linalg.eigvals(np.array(columns).T / (2 * step))
    rates = []
    for frequency in (MODES.omega_p, MODES.omega_r):
        nearest = np.argmin(abs(values.imag - frequency) + 0.1 * abs(values.real))
        rates.append(values[nearest].real)
    return np.array(rates)


@pytest.mark.parametrize("n", [0.005, -0.005])
def test_viscous_slip_takes_what_eigenvalues_say(n):
    k = 200.0
    without = steady.growth(
        full.constants(GH.alpha, GH.beta, GH.gamma, GH.theta, GH.phi, GH.xi), n
    )
    lost = np.array(without) - eigenvalue_rates(n, lambda n, N: k)
    plain = rs.growth_rates(GH, n)
    slipping = rs.growth_rates(GH, n, viscous=k)
    assert np.subtract(plain, slipping) == pytest.approx(lost, rel=5e-3)


@pytest.mark.parametrize(
    ("n", "pivot", "mu", "roll", "pitch"),
    [
        # By another program in vectors; one of both grows.
        (-0.1, 0.002, 0.5, 0.004632, None),
        (-0.1, 0.006, 0.3, 0.003638, None),
        (-0.2, 0.006, 0.3, 0.006884, None),
        (0.1, 0.006, 0.3, None, 0.026837),
    ],
)
def test_creep_takes_what_eigenvalues_say(n, pivot, mu, roll, pitch):
    def resistance(n, normal):
        return 9 * np.pi**2 * mu**2 * normal / (128 * pivot * abs(n))

    rates = eigenvalue_rates(n, resistance)
    for rate, known in zip(rates, (pitch, roll), strict=True):
        if known is not None:
            assert rate == pytest.approx(known, abs=2e-6)
    without = steady.growth(
        full.constants(GH.alpha, GH.beta, GH.gamma, GH.theta, GH.phi, GH.xi), n
    )
    plain = rs.growth_rates(GH, n)
    creeping = rs.growth_rates(GH, n, pivot=pivot, creep=mu)
    expected = np.array(without) - np.subtract(plain, creeping)
    assert rates == pytest.approx(expected, rel=1e-2)


def mean_of_resistance(x, y, overlap):
    """Return the mean over both phases of the speed in the plane, and what each loses.

    The nodes are dense where the speed is zero.
    """
    nodes, weights = np.polynomial.legendre.leggauss(200)
    share = (nodes + 1) / 2
    angle = np.pi / 2 * share**3
    weight = weights / 2 * 3 * share**2
    a = x * np.sin(angle)[:, None]
    b = y * np.sin(angle)[None, :]
    taken = np.zeros(2)
    for sign in (1, -1):
        both = sign * np.sqrt(overlap) * a * b
        speed = np.sqrt(a * a + b * b + 2 * both)
        for mode, own in enumerate((a * a + both, b * b + both)):
            taken[mode] += 0.5 * weight @ (own / speed) @ weight
    return taken


@pytest.mark.parametrize("overlap", [0.0, 0.07, 0.3, 0.6])
@pytest.mark.parametrize("amplitudes", [(1, 1), (0.3, 0.4), (1, 0.1), (0.02, 1)])
def test_rolling_resistance_takes_its_mean_over_both_phases(amplitudes, overlap):
    wanted = mean_of_resistance(*amplitudes, overlap)
    got = rolling_losses(*amplitudes, overlap, 0.0)
    assert got == pytest.approx(wanted, rel=3e-3)


def test_rolling_resistance_of_one_mode_and_below_the_smoothing():
    alone, nothing = rolling_losses(0.1, 0.0, 0.1, 1e-4)
    assert alone == pytest.approx(2 / np.pi * 0.1, rel=1e-3)
    assert nothing == 0.0
    # There the resistance is viscous: h^2 / eps, whose mean is half the square.
    tiny = rolling_losses(1e-7, 2e-7, 0.0, 1e-4)
    assert tiny == pytest.approx([0.5e-10, 2e-10], rel=1e-3)


def quantities(body, n_i, **given):
    """Return derived quantities by name."""
    return {each.name: each.value for each in derived(body, n_i, 0.01, **given)}


def test_thresholds_are_where_nothing_grows():
    given = {"sigma": 0.002, "pivot": 0.006, "creep": 0.3}
    found = quantities(GH, -0.2, **given)
    at_pitch = rs.growth_rates(GH, found["n_growth_pitch"], **given)
    at_roll = rs.growth_rates(GH, found["n_growth_roll"], **given)
    assert found["n_growth_roll"] < 0 < found["n_growth_pitch"]
    assert at_pitch.pitch == pytest.approx(0, abs=1e-16)
    assert at_roll.roll == pytest.approx(0, abs=1e-16)
    # The lever at which creep takes all of K_r.
    lever = found["lever_critical"]
    beyond = quantities(GH, -0.2, pivot=1.001 * lever, creep=0.3)
    assert beyond["K_r_creep"] < 0
    assert beyond["n_growth_roll"] is None
    assert quantities(GH, -0.2, pivot=0.999 * lever, creep=0.3)["K_r_creep"] > 0
    # c_r of GH is .33948.
    assert lever == pytest.approx(0.09676165 * 0.09 / 0.33948, rel=1e-4)


def test_an_oscillation_outgrows_rolling_resistance_above_a_size():
    found = quantities(GH, -0.2, rolling=1e-4)
    assert found["growth_roll"] is None
    assert found["least_pitch"] is None
    size = found["least_roll"]
    moment = theory.inertia_along(GH.alpha, GH.beta, MODES.psi_r)
    energy = 0.5 * moment * size**2
    gained = 0.2 * MODES.K_r * energy
    assert gained == pytest.approx(1e-4 * 2 / np.pi * size, rel=1e-12)


def test_creep_takes_of_mirrored_bodies_what_it_takes_of_others():
    given = {"sigma": 0.002, "pivot": 0.006, "creep": 0.3}
    found = quantities(GH, -0.2, **given)
    mirrored = quantities(GH.mirrored(), 0.2, **given)
    for name in ("n_growth_pitch", "n_growth_roll", "K_p_creep", "K_r_creep"):
        assert mirrored[name] == pytest.approx(-found[name], rel=1e-12)
    for name in ("growth_pitch", "growth_roll", "lever_critical"):
        assert mirrored[name] == pytest.approx(found[name], rel=1e-12)
    other = GH.mirrored()
    both = theory.modes(other.alpha, other.beta, other.theta, other.phi, other.xi)
    reduced_p, reduced_r = theory.creeping_coefficients(
        other.alpha, other.beta, both, 0.006, 0.3
    )
    assert reduced_p == pytest.approx(mirrored["K_p_creep"], rel=1e-12)
    assert reduced_r == pytest.approx(mirrored["K_r_creep"], rel=1e-12)


def test_losses_without_a_growth_rate_are_refused():
    with pytest.raises(rs.ConfigError, match="rolling: no growth rate is known"):
        rs.growth_rates(GH, 0.1, rolling=1e-3)
    with pytest.raises(rs.ConfigError, match="pivot: no eigenvalue is known"):
        rs.growth_rates(GH, 0.1, exact=True, pivot=1e-3)
