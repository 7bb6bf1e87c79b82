"""The largest Lyapunov exponent: tangents against 50 digits, exact rates, other integrators."""

import dataclasses

import kernels
import numpy as np
import oracle
import pandas as pd
import pytest
from mpmath import mp
from scipy.integrate import solve_ivp
from test_full import mp_rhs

import rattlesweep as rs
from rattlesweep.integrate.batch import exponents, integrate
from rattlesweep.integrate.model import FULL, REDUCED
from rattlesweep.integrate.tableau import DOP853, METHODS
from rattlesweep.physics import full, steady, tangent, theory
from rattlesweep.sweeps.types import is_chaotic

GH = oracle.GH
LYAPUNOV = frozenset(["lyapunov"])


def launch(n_i, omega_xy0, **changes):
    """Constants and initial state of GH with other parameters."""
    runs = kernels.full_batch({**GH, **changes}, n_i, omega_xy0)
    return runs.constants[0], runs.y0[0]


# --- the tangent's rate ---------------------------------------------------------------------------


def bodies_and_states(size, seed):
    """Constants, states and tangents, ordinary and extreme."""
    rng = np.random.default_rng(seed)
    for k in range(size):
        theta = (rng.uniform(0.3, 0.99), 1 - 1e-9)[k % 2]
        phi = (rng.uniform(0.01, 0.1), 1e-3, 1e-4)[k % 3]
        body = (rng.uniform(3, 15), rng.uniform(1.1, 2.5), rng.uniform(3, 15), theta, phi,
                rng.uniform(-0.1, 0.1))  # fmt: skip
        scale = (1e-6, 1e-2, 0.3, 3.0)[k % 4]
        state = rng.standard_normal(5) * [scale, scale, scale, scale, 1.0]
        yield full.constants(*body), state, rng.standard_normal(5)


def derivative(function, at, along, *constants):
    """Of a function of mpmath numbers, along a direction, to about 40 digits."""
    h = mp.mpf(10) ** -20
    ends = [
        function(*(mp.mpf(y) + s * h * mp.mpf(v) for y, v in zip(at, along, strict=True)),
                 *map(mp.mpf, constants))
        for s in (1, -1)
    ]  # fmt: skip
    return [(a - b) / (2 * h) for a, b in zip(*ends, strict=True)]


def test_rate_is_the_derivative_of_the_right_hand_side():
    worst = 0.0
    with mp.workdps(60):
        for constants, y, v in bodies_and_states(96, 1):
            exact = np.array(derivative(mp_rhs, y, v, *constants), dtype=float)
            got = tangent.rate(*y, *full.rhs(*y, *constants), *v, *constants)
            worst = max(worst, np.abs(got - exact).max() / np.abs(exact).max())
    assert worst < 1e-13


def test_transverse_is_in_the_energy_surface_and_normal_to_the_flow():
    for constants, y, v in bodies_and_states(48, 4):
        f = full.rhs(*y, *constants)
        got = np.array(tangent.transverse(*y, *f, *v, *constants))
        gradient = np.array(tangent.gradient(*y, *constants))

        # The norm as a matrix.
        pairs = [[tangent.square(*(a + b), *constants) for a in np.eye(5)] for b in np.eye(5)]
        one = np.diag(pairs) / 4
        metric = (np.array(pairs) - one[:, None] - one) / 2
        speed = f @ metric @ f
        # The scale of the parts that cancel.
        across = np.abs(gradient) @ (np.abs(v) + np.abs(got))
        assert abs(gradient @ got) < 1e-13 * across
        assert abs(f @ metric @ got) < 1e-12 * (
            np.abs(f) @ np.abs(metric) @ (np.abs(v) + np.abs(got))
        )
        # What is transverse stays as it is; the flow itself vanishes.
        again = tangent.transverse(*y, *f, *got, *constants)
        assert again == pytest.approx(got, rel=1e-9, abs=1e-9 * np.abs(got).max())
        nothing = tangent.transverse(*y, *f, *f, *constants)
        assert tangent.square(*nothing, *constants) < 1e-20 * speed


# --- known exponents ------------------------------------------------------------------------------


@pytest.mark.parametrize("n_i", [-0.3, -0.1, 0.1, 0.3])
def test_exponent_of_linear_growth_is_the_growth_rate(n_i):
    rate = max(float(x) for x in steady.growth(launch(n_i, 1e-12)[0], n_i))
    runs = kernels.full_batch(GH, n_i, 1e-12, t_end=25 / rate)
    t, log = integrate(runs, DOP853, FULL, tol=1e-11, record=LYAPUNOV).growth[0].T
    # Once the other mode is hidden, before anything is nonlinear; both swing within a period.
    late = np.isfinite(t) & (t > 10 / rate)
    assert np.polyfit(t[late], log[late], 1)[0] == pytest.approx(rate, rel=0.02)


def test_exponent_of_a_stable_spin_is_the_slower_decay():
    n_c1 = theory.bondi_threshold(*(GH[k] for k in ("alpha", "beta", "gamma", "theta", "phi")))
    n_i = 1.2 * float(n_c1)
    constants, _ = launch(n_i, 1e-3)
    slower = max(float(x) for x in steady.growth(constants, n_i))
    assert n_i < 0
    assert slower < 0
    # Half times some windows into the run; the spin hardly changes.
    runs = kernels.full_batch(GH, n_i, 1e-3, t_end=60 / abs(slower))
    out = integrate(runs, DOP853, FULL, record=LYAPUNOV)
    whole, late = exponents(out.growth)
    assert late == pytest.approx(slower, rel=0.02)
    assert whole == pytest.approx(slower, rel=0.1)
    assert not is_chaotic(late, out.t_end).any()


@pytest.mark.slow  # SciPy, 36 times
def test_growth_is_that_of_two_runs_nearby():
    """Benettin's two trajectories, by SciPy and the paper's six variables, of a chaotic run."""
    constants, y0 = launch(0.5, 0.3)
    runs = kernels.full_batch(GH, 0.5, 0.3, t_end=60.0)
    runs = dataclasses.replace(runs, window=np.array([5.0]))
    out = integrate(runs, DOP853, FULL, tol=1e-12, record=LYAPUNOV | {"reversals"}).growth[0]
    times, growth = out[np.isfinite(out[:, 0])].T
    assert growth[-1] > 4

    def ahead(y, t):
        u, w = full.to_vectors(y)
        run = solve_ivp(oracle.rhs, (0, t), np.concatenate([u, w]), "DOP853", args=(GH,),
                        rtol=1e-10, atol=1e-13)  # fmt: skip
        return full.from_vectors(run.y[:3, -1], run.y[3:, -1])

    def transverse(y, v):
        v = np.array(tangent.transverse(*y, *full.rhs(*y, *constants), *v, *constants))
        return v, np.sqrt(tangent.square(*v, *constants))

    y, far, total, expected = y0, 1e-5, 0.0, []
    v, norm = transverse(y, np.array(tangent.seed(*y, *constants)))
    for step in np.diff(times, prepend=0.0):
        # Differences on both sides of the run, or their curvature would show.
        ends = [ahead(y + s * far * v / norm, step) for s in (1, -1)]
        y = ahead(y, step)
        v, norm = transverse(y, (ends[0] - ends[1]) / (2 * far))
        total += np.log(norm)
        expected.append(total)
    assert growth == pytest.approx(expected, abs=1e-5)


# --- what it may not depend on --------------------------------------------------------------------


def test_a_very_long_tangent_stays_a_number():
    runs = kernels.full_batch(GH, -0.5, 0.3, t_end=20_000.0)
    growth = integrate(runs, DOP853, FULL, record=LYAPUNOV | {"reversals"}).growth
    # e^1400: the double's range ends at e^709.
    assert np.nanmax(growth[0, :, 1]) > 1400


def test_tolerance_and_threads():
    n_i, omega = [-0.1, -0.1, -0.05, 0.1, -0.5], [0.01, 0.003, 0.01, 0.001, 0.3]
    runs = kernels.full_batch(GH, n_i, omega, t_end=[700.0, 900, 1000, 150, 100])
    runs = kernels.join(*[runs] * 8)
    fine, rough = (integrate(runs, DOP853, FULL, tol=t, record=LYAPUNOV) for t in (1e-11, 1e-8))
    whole, late = exponents(fine.growth)
    assert np.isfinite(late).all()
    assert exponents(rough.growth)[0] == pytest.approx(whole, abs=2e-5)
    one, two = (
        integrate(runs, DOP853, FULL, tol=1e-11, record=LYAPUNOV, threads=k) for k in (1, 2)
    )
    kernels.assert_same(one, two)
    kernels.assert_same(one, fine)


PAIRS = [pytest.param(m, model, marks=[] if (m, model) == ("dop853", FULL) else [pytest.mark.slow])
         for m in METHODS for model in (FULL, REDUCED)]  # fmt: skip


@pytest.mark.parametrize(("method", "model"), PAIRS)
def test_all_else_is_the_same_bit_for_bit(method, model):
    rng = np.random.default_rng(6)
    n_i = rng.uniform(0.02, 0.5, 70) * rng.choice([-1, 1], 70)
    if model is FULL:
        runs = kernels.full_batch(GH, n_i, rng.uniform(0.001, 0.2, 70), t_end=120.0)
    else:
        runs = kernels.reduced_batch(GH, n_i, *rng.uniform(1e-5, 1e-2, (2, 70)), t_end=120.0)
    every = ["energy", "windows"] if model is REDUCED else ["energy", "contact", "windows"]
    for record in ([], every):
        plain, carried = (
            integrate(runs, METHODS[method], model, dt=0.01, record=frozenset([*record, *more]))
            for more in ([], ["lyapunov"])
        )
        if (method, model) == ("verner98", REDUCED):
            # The one pair that LLVM compiles otherwise within the kernel (the generated step alone
            # has the same bits): a few runs differ by rounding.
            assert (carried.n_steps == plain.n_steps).all()
            assert carried.t_end == pytest.approx(plain.t_end, rel=1e-13)
            assert carried.y_end == pytest.approx(plain.y_end, rel=1e-12, abs=1e-14)
        else:
            kernels.assert_same(plain, carried, skip=["growth"])
        assert plain.growth.shape == (0, 64, 2)
        assert np.isfinite(plain.t_r).sum() > 5
        whole, _ = exponents(carried.growth)
        assert np.isfinite(whole).all()
        assert (np.nanmax(carried.growth[:, :, 0], axis=1) == carried.t_end).all()


# --- exponents of windows, the criterion, the config ----------------------------------------------


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
    assert late == pytest.approx([2, (5 - 1.25) / 2.5, np.nan, np.nan, 5 / 3], nan_ok=True)


def test_chaotic_and_almost_periodic_runs_of_a_sweep(tmp_path):
    """Runs as in the paper's example of a chaotic SW (Fig. 7b); benchmarks/README.md has all."""
    config = {
        "seed": 2017,
        "bodies": {"source": "sd", "samples": 150, "target": {"K_r": [0.0041], "rel_tol": 0.1}},
        "spin": {"n_i": [-0.5], "omega_xy0": [0.1]},
        "record": ["lyapunov"],
    }
    runs = rs.sweep(config, output=tmp_path / "out").runs
    wobbling = runs[runs.type == "SW"]
    chaotic = is_chaotic(wobbling.lyapunov_late, wobbling.t_end)
    assert wobbling.chaotic.tolist() == chaotic.tolist()
    assert 0.05 < chaotic.mean() < 0.6
    assert wobbling.lyapunov_late[chaotic].between(1e-4, 0.1).all()
    assert not is_chaotic(runs.lyapunov_late, runs.t_end)[runs.type == "SS"].any()


def test_a_sweep_records_it_when_asked(tmp_path):
    config = {
        "bodies": {"source": "preset", "name": "GH"},
        "spin": {"n_i": [-0.1, 0.1], "omega_xy0": [0.01]},
    }
    runs = rs.sweep({**config, "record": ["lyapunov"]}, output=tmp_path / "asked").runs
    plain = rs.sweep(config, output=tmp_path / "plain").runs
    assert [c for c in runs if c not in plain] == ["lyapunov", "lyapunov_late", "chaotic"]
    pd.testing.assert_frame_equal(runs[list(plain)], plain)
