"""Random bodies without a sweep."""

import numpy as np
import pytest

import rattlesweep as rs

PARAMETERS = ["alpha", "beta", "gamma", "theta", "phi", "xi"]


def test_drawn_bodies_are_those_of_a_sweep(tmp_path):
    config = {
        "seed": 5,
        "bodies": {"source": "sd", "samples": 6, "ranges": {"theta": [0.7, 0.8]}},
        "spin": {"n_i": 0.1, "omega_xy0": 0.01},
        "horizon": {"t": 1.0},
    }
    runs = rs.sweep(config, output=tmp_path / "out").read()
    drawn = rs.draw_bodies(6, seed=5, ranges={"theta": [0.7, 0.8]})
    assert np.array_equal(drawn[PARAMETERS], runs[PARAMETERS])


@pytest.mark.parametrize("draw", ["random", "sobol"])
def test_many_bodies_can_be_drawn_in_parts(draw):
    whole = rs.draw_bodies(10, seed=3, draw=draw)
    last = rs.draw_bodies(4, seed=3, first=6, draw=draw)
    assert np.array_equal(whole[6:], last)


def test_what_cannot_be_drawn_is_refused():
    with pytest.raises(rs.ConfigError, match=r"bodies\.ranges\.theta"):
        rs.draw_bodies(3, ranges={"theta": [0.8, 1.2]})
    with pytest.raises(rs.ConfigError, match=r"^samples: 0 is given; a whole number"):
        rs.draw_bodies(0)
