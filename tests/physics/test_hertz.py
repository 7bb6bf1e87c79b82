"""Hertz's patch of contact: against 50 digits, limits, quadrature, and what it does."""

import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import dblquad, quad

from rattlesweep.physics.friction.hertz import ellipse
from rattlesweep.physics.friction.materials import MATERIALS, contact_modulus

FORCE, RADIUS, MODULUS = 0.6, 0.01, 3.8e9
RATIOS = [1 + 2.0**-52, 1 + 1e-9, 1.00001, 1.01, 1.5, 16, 1e2, 1e4, 1e10]


def exact(ratio: float) -> list[mp.mpf]:
    """Hertz's formulas at 50 digits, with the radii ``ratio * RADIUS`` and RADIUS."""
    with mp.workdps(50):
        radius = mp.mpf(RADIUS * ratio)
        log_ratio = mp.log(radius / mp.mpf(RADIUS))

        def integrals(log_k):
            m = 1 - mp.exp(2 * log_k)
            return m, mp.ellipk(m), mp.ellipe(m)

        def excess(log_k):
            m, k, e = integrals(log_k)
            return mp.log((e / (1 - m) - k) / (k - e)) - log_ratio

        start = (-log_ratio * 0.5, -log_ratio * 0.66)
        log_k = mp.findroot(excess, start, tol=1e-40)
        m, k, e = integrals(log_k)
        a = mp.cbrt(3 * FORCE * (k - e) * radius / (mp.pi * MODULUS * m))
        b = a * mp.exp(log_k)
        pressure = 1.5 * FORCE / (mp.pi * a * b)
        approach = 1.5 * FORCE * k / (mp.pi * MODULUS * a)
        return [a, b, pressure, approach, 3 * a * e / 8]


@pytest.mark.parametrize("ratio", RATIOS)
def test_fifty_digits(ratio):
    got = ellipse(FORCE, (RADIUS, RADIUS * ratio), MODULUS)
    for value, truth in zip(got, exact(ratio), strict=True):
        assert abs(value / truth - 1) < 4e-15


def test_the_circle():
    got = ellipse(FORCE, (RADIUS, RADIUS), MODULUS)
    a = np.cbrt(3 * FORCE * RADIUS / (4 * MODULUS))
    pressure = 1.5 * FORCE / (np.pi * a**2)
    truth = (a, a, pressure, a**2 / RADIUS, 3 * np.pi * a / 16)
    assert got == pytest.approx(truth, rel=1e-15)


@pytest.mark.parametrize("ratio", [1.0, 3.0, 16.0, 300.0])
def test_quadrature_of_the_pressure(ratio):
    """Its integral is the force, and its mean distance from the middle is <r>."""
    a, b, pressure, _, mean_radius = ellipse(FORCE, (ratio * RADIUS, RADIUS), MODULUS)

    # With x = a cos(s) cos(t), y = b cos(s) sin(t), nothing is singular.
    def share(s, t):
        return pressure * a * b * np.sin(s) ** 2 * np.cos(s)

    def moment(s, t):
        return share(s, t) * np.cos(s) * np.hypot(a * np.cos(t), b * np.sin(t))

    area = (0, np.pi / 2, 0, np.pi / 2)
    force = 4 * dblquad(share, *area, epsabs=0, epsrel=1e-12)[0]
    turning = 4 * dblquad(moment, *area, epsabs=0, epsrel=1e-12)[0]
    assert force == pytest.approx(FORCE, rel=1e-12)
    assert turning / force == pytest.approx(mean_radius, rel=1e-10)


@pytest.mark.parametrize("ratio", [1.5, 16.0])
def test_the_pressure_lifts_the_surfaces_apart_as_they_are_curved(ratio):
    """Boussinesq's displacement under it is ``approach - A x^2 - B y^2`` within."""
    a, b, pressure, approach, _ = ellipse(FORCE, (ratio * RADIUS, RADIUS), MODULUS)

    def displacement(x, y):
        # Polar coordinates about the point; along a chord the pressure is the root of
        # a quadratic, and its integral over the whole line is that of half a circle.
        def chord(angle):
            c, s = np.cos(angle), np.sin(angle)
            square = (c / a) ** 2 + (s / b) ** 2
            linear = x * c / a**2 + y * s / b**2
            rest = 1 - (x / a) ** 2 - (y / b) ** 2
            return np.pi / 2 * (rest + linear**2 / square) / np.sqrt(square)

        integral = quad(chord, 0, np.pi, epsrel=1e-11, limit=200)[0]
        return pressure * integral / (np.pi * MODULUS)

    for u, v in ((0, 0), (0.7, 0), (0, 0.6), (0.4, -0.5)):
        x, y = u * a, v * b
        gap = x**2 / (2 * ratio * RADIUS) + y**2 / (2 * RADIUS)
        assert displacement(x, y) == pytest.approx(approach - gap, rel=1e-9)


def test_scaling():
    radii = (RADIUS, 16 * RADIUS)
    one = np.array(ellipse(FORCE, radii, MODULUS))
    harder = np.array(ellipse(8 * FORCE, radii, MODULUS))
    np.testing.assert_allclose(harder / one, [2, 2, 2, 4, 2], rtol=1e-14)
    stiffer = np.array(ellipse(FORCE, radii, 8 * MODULUS))
    np.testing.assert_allclose(stiffer / one, [0.5, 0.5, 4, 0.25, 0.5], rtol=1e-14)
    larger = (8 * RADIUS, 128 * RADIUS)
    rounder = np.array(ellipse(FORCE, larger, MODULUS))
    np.testing.assert_allclose(rounder / one, [2, 2, 0.25, 0.5, 2], rtol=1e-14)


def test_the_modulus_of_two_materials():
    steel, glass = MATERIALS["steel"], MATERIALS["glass"]
    assert contact_modulus(steel, steel) == pytest.approx(210e9 / (2 * 0.91), rel=1e-15)
    assert contact_modulus(steel, glass) == contact_modulus(glass, steel)
    assert len(MATERIALS) == 10
    assert all(each.source for each in MATERIALS.values())
