"""Ellipsoids and friction against an independent formulation of the mechanics.

The equations are executed by Python; compiled, they are those of runs in other tests.
"""

from math import sqrt

import kernels
import numpy as np
import pytest
import stone_oracle
from exact import exactly
from mpmath import mp
from stones import constants_of, of_model, random_bodies

from rattlesweep.motion.equations import generic_equations
from rattlesweep.motion.model import FULL_ELLIPSOID
from rattlesweep.physics import full, stone

# The equations with pivoting are in test_pivoting.
SMOOTH = [model for model in kernels.DAMPED if model.pivot is None]
MODELS = [FULL_ELLIPSOID, *SMOOTH]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_equations_are_those_of_mechanics(model):
    rhs = exactly(model.rhs, sqrt)
    contact_of = exactly(model.contact, sqrt)
    energy = exactly(model.energy, sqrt)
    surface = exactly(model.surface.contact, sqrt)
    placed = exactly(full.contact_point, sqrt)
    for body, u, omega, sigma, rolling in random_bodies(100, 1):
        body, sigma, rolling = of_model(model, body, sigma, rolling)
        y = np.concatenate([u, omega, [0.0]])
        state = [*full.from_vectors(u, omega), 0.3][: model.n_state]
        q = constants_of(model, body, sigma, rolling)
        wanted, force, power = stone_oracle.forces(y, body, sigma, rolling)
        got = rhs(tuple(state), tuple(q))
        scale = 1 + np.abs(wanted).max()
        np.testing.assert_allclose(got[2:5], wanted, rtol=0, atol=2e-12 * scale)
        p, q_slope = state[:2]
        du = np.cross(u, omega)
        slope = (du[:2] * u[2] - u[:2] * du[2]) / u[2] ** 2
        np.testing.assert_allclose(
            got[:2], slope, rtol=0, atol=1e-13 * (1 + abs(slope).max())
        )
        normal, tangential = contact_of(tuple(state), tuple(q))
        assert normal == pytest.approx(force @ u, abs=1e-11 * scale)
        across = np.linalg.norm(force - (force @ u) * u)
        assert tangential == pytest.approx(across, abs=1e-11 * scale)
        work = 0.3 if model.n_state == 6 else 0.0
        total = stone_oracle.energy(y, body) - work
        assert energy(tuple(state), tuple(q)) == pytest.approx(
            total, abs=1e-13 * (1 + abs(total))
        )
        if model.n_state == 6:
            assert got[5] == pytest.approx(power, rel=1e-10, abs=1e-13)
        twist = p * omega[1] - q_slope * omega[0]
        touch = surface(tuple(state), (*got[:2], twist), tuple(map(float, q[3:7])))
        r, _ = stone_oracle.contact(u, du, body)
        np.testing.assert_allclose(placed(tuple(state), touch), r, atol=1e-12)


def test_the_adjugate_is_the_inverse_times_the_determinant():
    """In whole numbers, where nothing is rounded."""
    r = np.array([3, -5, 2])
    inertia = np.array([7, 2, 11])
    (xx, yy, zz, yz, zx, xy), det = stone.adjugate.py_func(r, inertia)
    left = np.diag(inertia + r @ r) - np.outer(r, r)
    adjugate = np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
    np.testing.assert_array_equal(adjugate @ left, det * np.eye(3))
    columns = left @ [4, -1, 6]
    solved = stone.multiplied.py_func((xx, yy, zz, yz, zx, xy), tuple(columns))
    np.testing.assert_array_equal(solved, det * np.array([4, -1, 6]))


@pytest.mark.parametrize("model", SMOOTH, ids=lambda model: model.name)
def test_cheaper_equations_are_those_of_a_sum_of_actions(model):
    summed, _ = generic_equations(model.chart, model.actions, model.layout)
    cheaper = exactly(model.rhs, sqrt)
    summed = exactly(summed, sqrt)
    contact = exactly(model.surface.contact, sqrt)
    for body, u, omega, sigma, rolling in random_bodies(40, 3):
        body, sigma, rolling = of_model(model, body, sigma, rolling)
        state = *map(float, full.from_vectors(u, omega)), 0.3
        q = [float(x) for x in constants_of(model, body, sigma, rolling)]
        wanted = cheaper(tuple(state), tuple(q))
        got = summed(
            contact,
            state,
            tuple(q[:3]),
            tuple(q[3:7]),
            tuple(q[7:]),
        )
        scale = 1 + np.abs(wanted).max()
        np.testing.assert_allclose(got, wanted, rtol=0, atol=2e-12 * scale)


@pytest.mark.parametrize(
    "model", [m for m in MODELS if m.n_carried], ids=lambda model: model.name
)
def test_carried_functions_of_a_step(model):
    """Start and rate are those of the contact point, at 60 digits."""
    assert model.n_carried == 1
    start, carried, plain = map(
        exactly, (model.carried_start, model.carried_rhs, model.rhs)
    )
    for body, u, omega, sigma, rolling in random_bodies(12, 6):
        body, sigma, rolling = of_model(model, body, sigma, rolling)
        with mp.workdps(60):
            numbers = [*full.from_vectors(u, omega), 0.3][: model.n_state]
            y = tuple(map(mp.mpf, numbers))
            constants = map(float, constants_of(model, body, sigma, rolling))
            q = tuple(map(mp.mpf, constants))
            (rise,) = start(y, q)
            wanted = plain(y, q)
            *got, rate = carried(y, (rise,), q)
            assert max(abs(a - b) for a, b in zip(got, wanted, strict=True)) < 1e-50
            h = mp.mpf(10) ** -25
            ahead, behind = (
                start(tuple(a + s * b for a, b in zip(y, wanted, strict=True)), q)[0]
                for s in (h, -h)
            )
            assert abs((ahead - behind) / (2 * h) - rate) < 1e-30
            # An error of the rise enters squared.
            off = rise * (1 + mp.mpf(10) ** -8)
            nearly = carried(y, (off,), q)
            assert (
                max(abs(a - b) for a, b in zip(nearly, (*got, rate), strict=True))
                < 1e-12
            )
