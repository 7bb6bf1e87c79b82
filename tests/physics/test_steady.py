"""The linear system about the steady spin against dynamics and 50-digit eigenvalues."""

import os
import subprocess
import sys
from itertools import accumulate, repeat

import numpy as np
import oracle
import pytest
import theory_mp
from exact import exactly
from mpmath import mp
from samples import GH, any_body, far_outside, log_uniform, mapping, table_one
from scipy.linalg import expm

from rattlesweep.physics import full, steady, theory

EPS = np.finfo(float).eps
SPINS = (-0.8, -0.5, -0.1, -1e-3, 1e-3, 0.1, 0.5, 0.8)


SD = table_one(30, 21)
WIDE = any_body(30, 22)
BODIES = [GH, *SD.T[:5].tolist(), *WIDE.T[:5].tolist()]


@pytest.mark.parametrize("n", SPINS)
def test_matrix_is_the_jacobian_of_the_full_dynamics_of_the_oracle_and_of_the_paper(n):
    """Differences at 60 digits are free of rounding and truncation."""
    rhs = exactly(full.rhs)
    # (u_x, u_y) = -(p, q) to first order.
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    for body in BODIES:
        constants = full.constants(*body)
        got = steady.matrix(constants, n)
        h = mp.mpf(10) ** -20
        jacobian = np.empty((5, 4))
        with mp.workdps(60):
            exact = [mp.mpf(x) for x in constants.tolist()]
            for column in range(4):
                ends = []
                for sign in (1, -1):
                    state = [mp.mpf(0)] * 4 + [-mp.mpf(n)]
                    state[column] = sign * h
                    ends.append(rhs(tuple(state), tuple(exact)))
                for row, (after, before) in enumerate(zip(*ends, strict=True)):
                    jacobian[row, column] = float((after - before) / (2 * h))
        # Entry by entry, including the zeros; the spin does not change.
        size = np.abs(jacobian).max()
        np.testing.assert_allclose(got, jacobian[:4], rtol=1e-13, atol=4 * EPS * size)
        assert np.abs(jacobian[4]).max() < 1e-15
        got = turn @ got @ turn
        paper = np.array(theory_mp.spin_matrix(*body, n).tolist(), dtype=float)
        for expected in (oracle.jacobian_spin(mapping(body), n), paper):
            np.testing.assert_allclose(got, expected, atol=1e-13 * size)


def test_eigenvalues_of_extreme_bodies_at_any_spin_and_any_loss():
    """A hundred digits give growth rates down to 1e-20 of the frequency exactly."""
    size = 60
    rng = np.random.default_rng(31)
    bodies = np.concatenate(
        [far_outside(size // 2, 32), any_body(size // 2, 33)], axis=1
    )
    constants = full.constants(*bodies)
    n = rng.choice([-1, 1], size) * log_uniform(rng, 1e-6, 10, size)
    sigma = np.where(rng.random(size) < 0.5, log_uniform(rng, 1e-6, 100, size), 0.0)
    n[:5] = 0.0
    modes = steady.steady_modes(constants, n, sigma)
    errors = []
    overdamped = 0
    for k in range(size):
        pitch, roll, *conjugates = theory_mp.steady_eigenvalues(
            constants[:, k], n[k], sigma[k]
        )
        for got, exact in ((modes.pitch[k], pitch), (modes.roll[k], roll)):
            overdamped += exact.imag == 0
            # Two eigenvalues that are close are less well conditioned.
            near = min(abs(exact - z) for z in (pitch, roll, *conjugates) if z != exact)
            slack = 2e-14 * abs(exact) * max(1, abs(exact) / near)
            assert abs(complex(got) - exact) < slack, (k, got, exact)
            if exact.real != 0:
                errors.append(float(abs(got.real / exact.real - 1)))
    assert overdamped > 5
    assert np.median(errors) < 1e-15
    assert np.quantile(errors, 0.98) < 1e-11


def test_probes_are_left_eigenvectors_of_extreme_bodies():
    size = 20_000
    rng = np.random.default_rng(34)
    bodies = far_outside(size, 35)
    bodies[5, ::7] = 0.0
    constants = full.constants(*bodies)
    for n in (np.zeros(size), rng.uniform(-10, 10, size)):
        for sigma in (0.0, 0.1, 100.0):
            matrix = steady.matrix(constants, n, sigma)
            modes = steady.steady_modes(constants, n, sigma)
            scale = np.abs(matrix).max(axis=(1, 2))[:, None]
            for value, probe in (
                (modes.pitch, modes.pitch_probe),
                (modes.roll, modes.roll_probe),
            ):
                rest = (probe[:, None, :] @ matrix)[:, 0] - value[:, None] * probe
                assert np.all(np.abs(rest) < 2e-10 * scale)
                assert np.median(np.abs(rest) / scale) < 1e-16
                np.testing.assert_allclose(np.linalg.norm(probe, axis=1), 1, rtol=1e-14)


BITS = """
import hashlib
import numpy as np
from rattlesweep.physics import steady

rng = np.random.default_rng(1)
low, high = [6, 0.1, 5, 0.1, 0, 10, -1, 0], [12, 1, 12, 0.6, 0.2, 50, 1, 0.3]
*constants, n, sigma = rng.uniform(low, high, (2000, 8)).T
constants = np.stack(constants)
modes = steady.steady_modes(constants, n, sigma)
n_0, slow = -2 * np.abs(n), np.full(len(n), 1e-12)
settled = steady.settled_oscillation(constants, n_0, n_0 / 6, slow)
found = (modes.pitch, modes.roll, modes.pitch_probe, modes.roll_probe,
         steady.transient_growth(constants, n), settled)
assert np.count_nonzero(settled) > 100
print(hashlib.sha256(b"".join(part.tobytes() for part in found)).hexdigest())
"""


def test_bits_depend_neither_on_the_linear_algebra_library_nor_on_the_processor():
    """OpenBLAS with other processors' kernels, NumPy without those for this one."""
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    hashes = set()
    for change in (
        {"OPENBLAS_CORETYPE": "Haswell"},
        {"OPENBLAS_CORETYPE": "Prescott"},
        {"NPY_DISABLE_CPU_FEATURES": " ".join(extensions)},
    ):
        done = subprocess.run(
            [sys.executable, "-c", BITS],
            env={**os.environ, **change},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        hashes.add(done.stdout)
    assert len(hashes) == 1


def energy_norm(constants):
    """Return the Cholesky factor of the matrix of `full.oscillation`, for one body."""
    ix, iy, _, cxx, cxy, cyy = constants
    norm = np.diag([cxx, cyy, ix + 1, iy + 1])
    norm[0, 1] = norm[1, 0] = cxy
    for start in np.random.default_rng(1).normal(size=(3, 4)):
        assert start @ norm @ start == pytest.approx(
            full.oscillation.py_func(start, constants), rel=1e-14
        )
    return np.linalg.cholesky(norm).T


def test_no_decaying_oscillation_rises_above_its_bound():
    """The largest possible gain is the norm of the exponential of the matrix."""
    n_c1 = theory.bondi_threshold(*SD[:5])
    gains = []
    for body, n in zip(SD.T, 1.2 * n_c1, strict=True):
        if np.isnan(n):
            continue
        constants = full.constants(*body)
        root = energy_norm(constants)
        bound = float(steady.transient_growth(constants, n))
        matrix = root @ steady.matrix(constants, n) @ np.linalg.inv(root)
        powers = list(accumulate(repeat(expm(0.1 * matrix), 600), np.matmul))
        gains.append(np.linalg.norm(powers, 2, axis=(1, 2)).max() ** 2 / bound)
    assert len(gains) > 10
    # The bound holds, and is not so loose that it says nothing.
    assert 0.1 < max(gains) < 1


def test_oscillations_settle_if_every_spin_that_they_may_reach_is_stable():
    constants = full.constants(*SD)
    n_c1 = theory.bondi_threshold(*SD[:5])
    slow = np.full(SD.shape[1], 1e-12)
    stable = np.isfinite(n_c1)
    assert 10 < stable.sum() < len(stable)
    # The unsteady direction, below the threshold, at it.
    for factor in (-1.5, 0.5, 1.0):
        assert np.all(
            steady.settled_oscillation(constants, factor * n_c1, n_c1, slow) == 0
        )
    settled = steady.settled_oscillation(constants, 1.5 * n_c1, n_c1, slow)
    assert np.array_equal(settled > 0, stable)
    # The largest rise takes the spin half-way to the threshold, or tilts the body to a
    # slope of sqrt(1/2) in the direction of the least curvature; the present slope is
    # at most 0.1.
    rise = steady.transient_growth(constants[:, stable], 1.5 * n_c1[stable])
    way = constants[2, stable] * 1.25 * n_c1[stable] ** 2
    lean = (1 - SD[3, stable]) / SD[3, stable]
    most = np.minimum(np.minimum(way, lean) / 2 / rise, lean / 100)
    np.testing.assert_allclose(settled[stable], most, rtol=1e-9)
    # A decay below the rate does not count.
    constants = constants[:, stable]
    n_c1 = n_c1[stable]
    rates = -np.maximum(*steady.growth(constants, np.sqrt(1.625) * n_c1))  # half-way
    for factor in (0.99, 1.01):
        fast = steady.settled_oscillation(constants, 1.5 * n_c1, n_c1, factor * rates)
        assert np.all((fast > 0) == (factor < 1))
