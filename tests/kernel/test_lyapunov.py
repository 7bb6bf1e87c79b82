"""The largest Lyapunov exponent: tangents against 60 digits, exponents against growth
rates.
"""

from dataclasses import replace
from math import sqrt

import kernels
import numpy as np
import oracle
import pytest
from exact import exactly
from mpmath import mp

from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.growths import exponents
from rattlesweep.kernel.method.tableau import DOP853
from rattlesweep.motion.model import FULL, FULL_ELLIPSOID
from rattlesweep.physics import full, steady, tangent

mp_rhs = exactly(full.rhs)

GH = oracle.GH
LYAPUNOV = frozenset(["lyapunov"])


def bodies_and_states(size, seed):
    """Constants, states and tangents, ordinary and extreme."""
    rng = np.random.default_rng(seed)
    for k in range(size):
        theta = (rng.uniform(0.3, 0.99), 1 - 1e-9)[k % 2]
        phi = (rng.uniform(0.01, 0.1), 1e-3, 1e-4)[k % 3]
        body = (
            rng.uniform(3, 15),
            rng.uniform(1.1, 2.5),
            rng.uniform(3, 15),
            theta,
            phi,
            rng.uniform(-0.1, 0.1),
        )
        scale = (1e-6, 1e-2, 0.3, 3.0)[k % 4]
        state = rng.standard_normal(5) * [scale, scale, scale, scale, 1.0]
        yield full.constants(*body), state, rng.standard_normal(5)


def derivative(function, at, along, *constants):
    """Return the derivative of a function along a direction, to about 40 digits."""
    h = mp.mpf(10) ** -20
    ends = [
        function(
            tuple(
                mp.mpf(y) + s * h * mp.mpf(v) for y, v in zip(at, along, strict=True)
            ),
            tuple(map(mp.mpf, constants)),
        )
        for s in (1, -1)
    ]
    return [(a - b) / (2 * h) for a, b in zip(*ends, strict=True)]


def test_rate_is_the_derivative_of_the_right_hand_side():
    worst = 0.0
    rate = exactly(tangent.rate, sqrt)
    rhs = exactly(full.rhs, sqrt)
    with mp.workdps(60):
        for constants, y, v in bodies_and_states(96, 1):
            exact = np.array(derivative(mp_rhs, y, v, *constants), dtype=float)
            got = rate(y, rhs(y, constants), v, constants)
            worst = max(worst, np.abs(got - exact).max() / np.abs(exact).max())
    assert worst < 1e-13


@pytest.mark.parametrize("n_i", [-0.3, -0.1, 0.1, 0.3])
def test_exponent_of_linear_growth_is_the_growth_rate(n_i):
    rate = max(float(x) for x in steady.growth(full.constants(**GH), n_i))
    runs = kernels.full_batch(GH, n_i, 1e-12, t_end=25 / rate)
    t, log = integrate(runs, DOP853, FULL, tol=1e-11, record=LYAPUNOV).lyapunov[0].T
    # After the other mode has become negligible, and before nonlinear terms matter.
    late = np.isfinite(t) & (t > 10 / rate)
    assert np.polyfit(t[late], log[late], 1)[0] == pytest.approx(rate, rel=0.02)


@pytest.mark.slow
def test_a_very_long_tangent_stays_a_number():
    runs = kernels.full_batch(GH, -0.5, 0.3, t_end=20_000.0)
    growth = integrate(runs, DOP853, FULL, record=LYAPUNOV | {"reversals"}).lyapunov
    # The growth is e^1400; the range of doubles ends at e^709.
    assert np.nanmax(growth[0, :, 1]) > 1400


@pytest.mark.parametrize("word", ["lyapunov", "spectrum"])
def test_tangents_of_other_models_are_refused(word):
    """An ellipsoid is not silently taken for a paraboloid."""
    runs = kernels.full_batch(GH, 0.1)
    runs = replace(runs, constants=np.append(runs.constants, [[0.4]], axis=1))
    with pytest.raises(ValueError, match="tangents of ellipsoid are not known"):
        integrate(runs, DOP853, FULL_ELLIPSOID, record={word})


def test_tolerance_and_threads():
    n_i = [-0.1, -0.1, -0.05, 0.1, -0.5]
    omega = [0.01, 0.003, 0.01, 0.001, 0.3]
    runs = kernels.full_batch(GH, n_i, omega, t_end=[700.0, 900, 1000, 150, 100])
    runs = kernels.join(*[runs] * 8)
    fine, rough = (
        integrate(runs, DOP853, FULL, tol=t, record=LYAPUNOV) for t in (1e-11, 1e-8)
    )
    whole, late = exponents(fine.lyapunov)
    assert np.isfinite(late).all()
    assert exponents(rough.lyapunov)[0] == pytest.approx(whole, abs=2e-5)
    one, two = (
        integrate(runs, DOP853, FULL, tol=1e-11, record=LYAPUNOV, threads=k)
        for k in (1, 2)
    )
    kernels.assert_same(one, two)
    kernels.assert_same(one, fine)


def test_exponents_are_the_slopes_of_the_growth():
    growth = np.full((5, 8, 2), np.nan)
    growth[0, :, 0] = np.arange(1, 9)
    growth[0, :, 1] = [1, 2, 3, 4, 6, 8, 10, 12]
    growth[1, :3] = [[2, 1], [4, 2], [5, 5.0]]  # half time between two borders
    growth[2, :1] = [[3, 6]]
    growth[3, :2] = [[1, 0], [2, np.nan]]
    growth[4, ::3] = [[1, 1], [4, 4], [6, 8]]  # steps longer than a window
    whole, late = exponents(growth)
    assert whole == pytest.approx([1.5, 1, 2, np.nan, 8 / 6], nan_ok=True)
    assert late == pytest.approx(
        [2, (5 - 1.25) / 2.5, np.nan, np.nan, 5 / 3], nan_ok=True
    )
