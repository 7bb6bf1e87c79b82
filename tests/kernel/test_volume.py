"""The rate of phase volume: the trace of the derivative, and its mean over runs."""

from math import sqrt

import kernels
import numpy as np
import oracle
import pytest
import reference
from exact import exactly
from mpmath import mp
from samples import GH, mapping, table_one
from stones import constants_of, of_model, random_bodies

import rattlesweep as rs
from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.motion.anywhere import from_slopes
from rattlesweep.motion.model import FULL
from rattlesweep.physics import full

DOP853 = METHODS["dop853"]
RK4 = METHODS["rk4"]
VOLUME = frozenset(["volume"])


@pytest.mark.parametrize(
    "model",
    [m for m in kernels.ROLLING if m.volume is not None],
    ids=lambda m: m.name,
)
def test_rate_is_the_trace_of_the_derivative_over_omega(model):
    rhs = exactly(model.rhs)
    volume = exactly(model.volume, sqrt)
    h = mp.mpf(10) ** -20
    for body, u, omega, sigma, rolling in random_bodies(24, 7):
        body, sigma, rolling = of_model(model, body, sigma, rolling)
        state = [*full.from_vectors(u, omega), 0.3][: model.n_state]
        q = constants_of(model, body, sigma, rolling)
        got = volume(tuple(state), tuple(q))
        with mp.workdps(50):
            y = [mp.mpf(float(x)) for x in state]
            wanted = mp.mpf(0)
            for i in (2, 3, 4):
                ends = [
                    rhs(
                        (*y[:i], y[i] + s * h, *y[i + 1 :]),
                        tuple(map(mp.mpf, map(float, q))),
                    )[i]
                    for s in (1, -1)
                ]
                wanted += (ends[0] - ends[1]) / (2 * h)
        assert got == pytest.approx(float(wanted), rel=1e-10, abs=1e-13)
        if body["c"] is not None and model.name.endswith("rolling"):
            there = from_slopes(model, np.array([state]), np.array([q]))
            other = exactly(model.anywhere.volume, sqrt)(
                (*(3 * there[0][0, :3]), *there[0][0, 3:]), tuple(there[1][0])
            )
            assert other == pytest.approx(got, rel=1e-9, abs=1e-12)


def logarithm_of_volume(body, y0, t_end, steps):
    """Return the logarithm of a small volume carried by the flow, at 30 digits."""
    h = mp.mpf(10) ** -15
    q = reference.constants([list(body.values())] * 11, exact=True)

    def frame(u):
        first = reference.cross(u, (mp.mpf(1), mp.mpf(0), mp.mpf(0)))
        first = [x / mp.norm(first) for x in first]
        return first, reference.cross(u, first)

    def directions(u):
        sphere = [[*axis, 0, 0, 0] for axis in frame(u)]
        return sphere + [[mp.mpf(i == k) for i in range(6)] for k in (3, 4, 5)]

    start = [mp.mpf(float(x)) for x in y0]
    columns = [start] + [
        [x + s * h * d for x, d in zip(start, axis, strict=True)]
        for axis in directions(start[:3])
        for s in (1, -1)
    ]
    y = np.array(columns, dtype=object).T
    step = np.array([mp.mpf(t_end) / steps] * 11)
    for _ in range(steps):
        y = reference.step(y, step, q)
    ends = directions(list(y[:3, 0]))
    rows = mp.matrix(5, 5)
    for j in range(5):
        moved = (y[:, 1 + 2 * j] - y[:, 2 + 2 * j]) / (2 * h)
        for i, axis in enumerate(ends):
            rows[i, j] = sum(a * b for a, b in zip(axis, moved, strict=True))
    return float(mp.log(abs(mp.det(rows))))


@pytest.mark.parametrize("count", [1, pytest.param(10, marks=pytest.mark.slow)])
def test_mean_rate_is_that_of_a_small_volume(count):
    rng = np.random.default_rng(4)
    t_end = 1.0
    for row in table_one(count, 44).T:
        body = mapping(row)
        n = rng.uniform(-0.5, 0.5)
        w = rng.uniform(0.1, 0.5)
        psi = 0.7
        run = rs.simulate(
            rs.Rattleback(**body),
            n_i=n,
            omega_xy0=w,
            psi=np.degrees(psi),
            t_end=t_end,
            tol=1e-12,
            record=["volume", "reversals"],
        )
        with mp.workdps(30):
            wanted = logarithm_of_volume(body, oracle.launch(body, n, w, psi), t_end, 6)
        assert run.volume_rate * t_end == pytest.approx(wanted, rel=1e-6)


@pytest.mark.slow
def test_rate_near_a_steady_spin():
    body = rs.Rattleback.gh().replace(theta=0.82)
    modes = rs.modes(body)
    run = rs.simulate(
        body, n_i=-0.1, omega_xy0=1e-5, t_end=300, record=["volume", "lyapunov"]
    )
    assert run.volume_rate == pytest.approx(-0.1 * (modes.K_p - modes.K_r), rel=1e-8)


def test_accuracy_is_that_of_the_method():
    runs = kernels.full_batch(mapping(GH), [0.3, -0.3], 0.1, t_end=30.0)
    rates = [
        integrate(runs, DOP853, FULL, tol=t, record=VOLUME).volume_rate
        for t in (1e-13, 1e-9)
    ]
    assert rates[1] == pytest.approx(rates[0], rel=1e-7)
    off = [
        abs(
            integrate(runs, RK4, FULL, dt=dt, record=VOLUME).volume_rate[1]
            - rates[0][1]
        )
        for dt in (0.1, 0.05)
    ]
    assert off[0] / off[1] == pytest.approx(16, rel=0.4)
    # There is no rate for a failed run, nor if it is not recorded.
    assert np.isnan(
        integrate(runs, DOP853, FULL, record=VOLUME, max_steps=9).volume_rate
    ).all()
    assert np.isnan(integrate(runs, DOP853, FULL).volume_rate).all()
