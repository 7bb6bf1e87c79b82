"""The rate of phase volume: the trace of the derivative, and its mean over runs."""

import kernels
import numpy as np
import pytest
from exact import exactly
from mpmath import mp
from samples import GH, mapping
from test_stone import constants_of, of_model, random_bodies

import rattlesweep as rs
from rattlesweep.integrate.batch import integrate
from rattlesweep.integrate.model import ELLIPSOID, FRICTION, FULL, VECTORS
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.physics import full, vectors

DOP853, RK4 = METHODS["dop853"], METHODS["rk4"]
VOLUME = frozenset(["volume"])


@pytest.mark.parametrize("model", [FULL, ELLIPSOID, *FRICTION.values()], ids=lambda m: m.name)
def test_rate_is_the_trace_of_the_derivative_over_omega(model):
    rhs, h = exactly(model.rhs), mp.mpf(10) ** -20
    for body, u, omega, sigma, rolling in random_bodies(24, 7):
        body, sigma, rolling = of_model(model, body, sigma, rolling)
        state = [*full.from_vectors(u, omega), 0.3][: model.n_state]
        q = constants_of(model, body, sigma, rolling)
        got = model.volume(*state, *q)
        with mp.workdps(50):
            y, wanted = [mp.mpf(float(x)) for x in state], mp.mpf(0)
            for i in (2, 3, 4):
                ends = [rhs(*y[:i], y[i] + s * h, *y[i + 1 :], *map(mp.mpf, map(float, q)))[i]
                        for s in (1, -1)]  # fmt: skip
                wanted += (ends[0] - ends[1]) / (2 * h)
        assert got == pytest.approx(float(wanted), rel=1e-10, abs=1e-13)
        if body["c"] is not None and model.name.endswith("rolling"):
            there = vectors.from_slopes(np.array([state]), np.array([q]))
            other = VECTORS.volume(*(3 * there[0][0, :3]), *there[0][0, 3:], *there[1][0])
            assert other == pytest.approx(got, rel=1e-9, abs=1e-12)


def test_rate_near_a_steady_spin():
    body = rs.Rattleback.gh().replace(theta=0.82)
    modes = rs.modes(body)
    run = rs.simulate(body, n_i=-0.1, omega_xy0=1e-5, t_end=300, record=["volume", "lyapunov"])
    assert run.volume_rate == pytest.approx(-0.1 * (modes.K_p - modes.K_r), rel=1e-8)


def test_accuracy_is_that_of_the_method():
    runs = kernels.full_batch(mapping(GH), [0.3, -0.3], 0.1, t_end=30.0)
    rates = [integrate(runs, DOP853, FULL, tol=t, record=VOLUME).volume_rate
             for t in (1e-13, 1e-9)]  # fmt: skip
    assert rates[1] == pytest.approx(rates[0], rel=1e-7)
    off = [abs(integrate(runs, RK4, FULL, dt=dt, record=VOLUME).volume_rate[1] - rates[0][1])
           for dt in (0.1, 0.05)]  # fmt: skip
    assert off[0] / off[1] == pytest.approx(16, rel=0.4)
    # Of a run that fails there is none, nor of one that does not record it.
    assert np.isnan(integrate(runs, DOP853, FULL, record=VOLUME, max_steps=9).volume_rate).all()
    assert np.isnan(integrate(runs, DOP853, FULL).volume_rate).all()
