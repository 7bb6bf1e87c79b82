"""Basin entropy and uncertainty exponent, of maps for which they are known."""

from __future__ import annotations

import numpy as np
import pytest

from rattlesweep.analysis.grids import boundaries


def plane(n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.meshgrid(np.arange(n), np.arange(n), indexing="ij")


def test_a_straight_line_is_smooth():
    x, y = plane(800)
    found = boundaries((x + 0.37 * y > 500).astype(int))
    assert found.exponent == pytest.approx(1.0, abs=0.05)
    assert abs(found.exponent - 1) < 4 * found.exponent_error + 0.02
    assert found.boundary_entropy < np.log(2)
    # Boxes on the line: 5 of 800 points wide each.
    assert found.entropy == pytest.approx(found.boundary_entropy * 1.2 * 5 / 800, rel=0.2)


@pytest.mark.parametrize("turn", [0.1, 0.9, 2.3])
def test_smooth_lines_that_meet_and_thin_strips_stay_smooth(turn):
    """Three types that meet in a point, and a strip of one point between two of them."""
    x, y = plane(800)
    u, v = x - 400, y - 380
    angle = np.arctan2(v, u)
    sectors = (np.floor((angle + turn) / (2 * np.pi / 3)) % 3).astype(int)
    found = boundaries(sectors)
    assert found.exponent == pytest.approx(1.0, abs=0.06)
    strip = np.where(np.abs(u) <= 0, 2, (u > 0).astype(int))
    assert not boundaries(strip).boundary_entropy > np.log(2)


def test_noise_is_as_fractal_as_can_be():
    found = boundaries(np.random.default_rng(0).integers(0, 2, (400, 400)))
    assert found.exponent == pytest.approx(0.0, abs=0.05)
    # The entropy of 25 tosses of a coin falls short of ln 2 by 1/50 or so.
    assert found.entropy == pytest.approx(np.log(2) - 1 / 50, abs=2e-3)


def test_the_bands_of_cantors_set():
    """Boundaries at the points of a set of dimension ln 2 / ln 3."""
    n = 3**7
    x = np.arange(n)
    band, inside = np.zeros(n, dtype=int), np.ones(n, dtype=bool)
    for level in range(7):
        middle = inside & ((x // 3 ** (6 - level)) % 3 == 1)
        band[middle] = 1 + level % 2
        inside &= ~middle
    found = boundaries(np.repeat(band[:, None], 120, axis=1))
    assert found.exponent == pytest.approx(1 - np.log(2) / np.log(3), abs=0.06)


def test_without_a_boundary_there_is_no_exponent():
    found = boundaries(np.zeros((100, 100), dtype=int))
    assert found.entropy == 0
    assert np.isnan(found.exponent)
    assert np.isnan(found.boundary_entropy)
