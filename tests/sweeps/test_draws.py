"""Bodies drawn by a scrambled Sobol' sequence: each by its number alone, and evenly."""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.cases.quasi import APART, Sequence
from rattlesweep.sweeps.config.load import parse_config, physics_hash

CONFIG = {
    "seed": 7,
    "bodies": {"source": "sd", "samples": 20_000, "draw": "sobol"},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
    "model": "gh",
}


def unit(samples: list[int], seed: int = 7) -> np.ndarray:
    """Points of the unit cube behind the bodies of some samples."""
    plan = make_plan(parse_config(CONFIG | {"seed": seed}))
    b = plan.source.bodies(0, np.array(samples, dtype=np.int64))
    values = np.stack([b.gamma, b.f_sd, b.theta, b.phi, -np.degrees(b.xi)])
    low, high = np.array(plan.config.bodies.ranges.ends()).T[:, :, None]
    points = (values - low) / (high - low)
    points[4] = (high[4] - values[4]) / (high[4] - low[4])
    return points


def test_are_the_points_of_scipy():
    points = qmc.Sobol(5, rng=np.random.default_rng((7, 0))).random(64).T
    np.testing.assert_allclose(unit(list(range(64))), points, atol=1e-12)


def test_depend_on_their_number_alone():
    every = unit(list(range(2 * APART + 50)))
    for samples in ([5], [0, 1, 9], [APART + 3, 3, 2 * APART + 10], [8000, 8001, 0, 1]):
        assert np.array_equal(unit(samples), every[:, samples])
    one = Sequence(5, 7)
    late, early = one.points(np.array([8000])), one.points(np.array([8]))
    assert np.array_equal(np.hstack([late, early]), Sequence(5, 7).points(np.array([8000, 8])))


def test_depend_on_the_seed():
    assert not np.array_equal(unit([0, 1]), unit([0, 1], seed=8))


def test_fill_every_cell_of_a_range_equally():
    """2^k points have one in each of 2^k equal parts of every range, which random ones do not."""
    points = unit(list(range(256)))
    assert np.array_equal(np.sort(np.floor(256 * points), axis=1), np.tile(np.arange(256), (5, 1)))


def test_the_default_is_no_part_of_the_hash():
    plain = CONFIG | {"bodies": {"source": "sd", "samples": 20_000}}
    random = CONFIG | {"bodies": {"source": "sd", "samples": 20_000, "draw": "random"}}
    hashes = [physics_hash(parse_config(config)) for config in (plain, random, CONFIG)]
    assert hashes[0] == hashes[1] != hashes[2]
