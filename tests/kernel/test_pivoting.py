"""Equations of pivoting friction, and what lanes do where the spin is zero."""

import dataclasses
import math
from math import sqrt

import kernels
import numpy as np
import oracle
import pytest
from exact import exactly

from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.look import inside
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.kernel.state.fields import Point
from rattlesweep.kernel.state.status import Status
from rattlesweep.motion.anywhere import from_slopes
from rattlesweep.motion.model import FULL, find_model
from rattlesweep.physics.friction import pivoting

GH = oracle.GH
DOP853 = METHODS["dop853"]
SMOOTHING = 1e-4
PIVOTING = find_model("full_pivoting")


def pivoting_batch(n_i, push, lever, t_end, sigma=0.0):
    """Return runs of GH with pivoting friction."""
    runs = kernels.full_batch(GH, n_i, push, t_end=t_end)
    count = len(runs)
    loss = sigma, lever, 1.0
    constants = [runs.constants, np.zeros((count, 1)), np.tile(loss, (count, 1))]
    y0 = np.hstack([runs.y0, np.zeros((count, 2))])
    return dataclasses.replace(runs, y0=y0, constants=np.hstack(constants))


@pytest.mark.parametrize("sense", [1.0, -1.0, 0.0])
@pytest.mark.parametrize("law", ["pivoting", "rolling_pivoting"])
def test_equations_in_slopes_are_those_in_any_position(law, sense):
    model = find_model(f"ellipsoid_{law}")
    anywhere, rhs, pivot, contact, spin, spin_rate = (
        exactly(formula, sqrt)
        for formula in (
            *(model.anywhere.rhs, model.rhs, model.pivot, model.contact),
            *(model.spin, model.spin_rate),
        )
    )
    rng = np.random.default_rng(3)
    for _ in range(30):
        y = rng.normal(scale=0.2, size=5)
        shape = 2.0, 3.0, 4.0, 0.2, 0.03, 5.0, 0.3
        rolling = (0.01, SMOOTHING) if law == "rolling_pivoting" else ()
        q = np.array([*shape, 0.02, *rolling, 0.05, sense])
        state = np.array([[*y, -0.1, -0.05]])
        (there,), (constants,) = from_slopes(model, state, q[None])
        got = anywhere(tuple(there), tuple(constants))
        wanted = rhs(tuple(state[0]), tuple(q))
        np.testing.assert_allclose(got[3:], wanted[2:], rtol=1e-10, atol=1e-12)
        torque, normal, _ = pivot(tuple(state[0]), tuple(q))
        # F.u of the contact force that the motion needs is the normal force used.
        needed, _ = contact(tuple(state[0]), tuple(q))
        assert normal == pytest.approx(needed, rel=1e-10)
        if sense != 0.0:
            assert torque == pytest.approx(-0.05 * sense * normal, rel=1e-12)
        else:
            n = spin(tuple(state[0]))
            rate = spin_rate(tuple(state[0]), wanted)
            assert rate == pytest.approx(-pivoting.RETURN * n, abs=1e-12)


def test_a_vertical_spin_stops_after_gamma_n_over_the_lever():
    n_i = np.array([0.1, 0.5, 2.0])
    lever = 0.003
    stop = GH["gamma"] * n_i / lever
    runs = pivoting_batch(n_i, 0.0, lever, 1.5 * stop)
    out = integrate(runs, DOP853, PIVOTING)
    assert (out.status == Status.OK).all()
    assert out.t_held == pytest.approx(stop, rel=1e-12)
    assert out.held_time == pytest.approx(0.5 * stop, rel=1e-12)
    assert out.pivot_work == pytest.approx(1.0, rel=1e-12)
    assert abs(out.n_end).max() < 1e-15
    assert np.isnan(out.t_r).all()


def test_energy_minus_work_is_conserved_and_mirrored_runs_are_mirrored():
    n_i = np.array([0.1, -0.1, -0.2, 0.3])
    push = [0.01, 0.01, 0.1, 0.2]
    out = integrate(pivoting_batch(n_i, push, 0.002, 700.0), DOP853, PIVOTING)
    assert abs(out.energy_drift).max() < 1e-9
    mirror = GH | {"xi": -GH["xi"]}
    runs = kernels.full_batch(mirror, -n_i, push, t_end=700.0)
    given = pivoting_batch(n_i, push, 0.002, 700.0)
    constants = np.hstack([runs.constants, given.constants[:, 6:]])
    y0 = np.hstack([runs.y0, np.zeros((4, 2))])
    runs = dataclasses.replace(runs, y0=y0, constants=constants)
    reflected = integrate(runs, DOP853, PIVOTING)
    for name in ("t_r", "t_held", "held_time", "pivot_work"):
        np.testing.assert_allclose(
            getattr(reflected, name), getattr(out, name), rtol=1e-8, atol=1e-12
        )


def test_a_vanishing_lever_is_rolling_at_order_one():
    (free,) = integrate(kernels.full_batch(GH, 0.1, 0.01), DOP853, FULL, tol=1e-12).t_r
    levers = np.array([1e-7, 1e-6, 1e-5])
    times = [
        integrate(
            pivoting_batch(0.1, 0.01, lever, 1000.0), DOP853, PIVOTING, tol=1e-12
        ).t_r[0]
        for lever in levers
    ]
    slopes = (np.array(times) - free) / levers
    assert slopes == pytest.approx(slopes[0], rel=0.01)


@pytest.mark.parametrize("x", [0.0, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 29.0, 31.0, 1e4])
def test_share_of_the_lever_of_a_sliding_patch(x):
    """The integral of Coulomb's law over Hertz's pressure, in polar coordinates."""
    rho = np.polynomial.legendre.leggauss(400)
    phi = np.linspace(0, 2 * math.pi, 4000, endpoint=False)
    # rho = sqrt(1 - s^2) takes the root out of the pressure.
    s = 0.5 * (rho[0] + 1)
    radius = np.sqrt(1 - s * s)[:, None]
    u = x - radius * np.sin(phi)
    v = radius * np.cos(phi)
    size = np.sqrt(u * u + v * v) + 1e-300
    torque = radius * (np.cos(phi) * v - np.sin(phi) * u) / size
    weight = (1.5 * s * s * 0.5 * rho[1])[:, None] / math.pi
    whole = 2 * (weight * torque).sum() * math.pi / len(phi)
    near = 1e-4 if x <= 1.0 else 1e-9
    assert pivoting.share_of_lever(x) == pytest.approx(
        whole * 16 / (3 * math.pi), rel=near
    )


@pytest.mark.parametrize("spin", [1e-8, -3e-6, 0.1])
def test_a_foot_that_begins_to_slide_has_the_torque_it_had(spin):
    lever = 0.002
    least = pivoting.least_creep(spin, lever)
    vertical = 0.0, 0.0, 1.0
    _, _, torque = pivoting.sliding_drag(vertical, spin, lever, 0.0, least)
    assert torque == pytest.approx(-math.copysign(lever, spin), rel=2e-10)
    # A speed of sliding that is not small counts as it is.
    _, _, slid = pivoting.sliding_drag(vertical, spin, lever, 1e-4, least)
    _, _, wanted = pivoting.sliding_drag(vertical, spin, lever, 1e-4, 0.0)
    assert slid == pytest.approx(wanted, rel=1e-12)


def test_a_combined_limit_is_positive_only_where_both_are():
    values = np.linspace(-1.0, 1.0, 41)
    first, second = np.meshgrid(values, values)
    combined = np.vectorize(inside.both)(first, second)
    inner = (first > 0) & (second > 0)
    np.testing.assert_array_equal(combined[inner], (first * second)[inner])
    border = ((first == 0) & (second >= 0)) | ((second == 0) & (first >= 0))
    assert (combined[border] == 0).all()
    assert (combined[~inner & ~border] < 0).all()


def test_rate_of_a_combined_limit():
    """It is the derivative, on both sides of each zero."""
    ahead = 1e-6
    for first in (-0.3, 0.2):
        for second in (-0.1, 0.4):
            points = Point(0.0, first, 0.7), Point(0.0, second, -0.5)
            before = inside.both(first - 0.7 * ahead, second + 0.5 * ahead)
            after = inside.both(first + 0.7 * ahead, second - 0.5 * ahead)
            slope = (after - before) / (2 * ahead)
            assert inside.both_of(*points).rate == pytest.approx(slope, rel=1e-8)
