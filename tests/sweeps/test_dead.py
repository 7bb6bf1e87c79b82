"""A body whose energy is gone does not reverse: by every door, type D and no t_r."""

import numpy as np
import pytest

import rattlesweep as rs
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.merge import classify_stored

GH = rs.Rattleback.gh()
SIGMA = [0.3, 3.0, 10.0, 1e6]
CONFIG = {
    "bodies": {"source": "preset", "name": "GH"},
    "spin": {"n_i": 0.1, "omega_xy0": 0.01},
    "dissipation": {"sigma": [0.3, 3.0, 10.0]},
    "horizon": {"t": 2000},
}


@pytest.mark.parametrize("sigma", SIGMA)
def test_a_single_run(sigma):
    """The spin of each passes through zero, at sizes of 1e-26 to 0."""
    run = rs.simulate(GH, n_i=0.1, omega_xy0=0.01, sigma=sigma, t_end=2000)
    assert (run.type, run.t_r, run.status) == ("D", None, "ok")


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return rs.sweep(CONFIG, output=tmp_path_factory.mktemp("dead"))


def test_a_sweep_and_its_thresholds(plain):
    assert plain.runs.type.tolist() == ["D"] * 3
    assert plain.runs.t_r.isna().all()
    assert (plain.runs.energy_left.abs() < 0.01).all()
    for value in ("0.5", "0.001"):
        with pytest.raises(ConfigError, match="needs a new sweep"):
            classify_stored(plain.directory, [f"classify.dead_energy={value}"])
        with pytest.raises(ConfigError, match="holds another sweep"):
            rs.sweep(CONFIG | {"classify": {"dead_energy": float(value)}}, output=plain.directory)


def test_recorded_reversals_and_errors(tmp_path):
    runs = rs.sweep(CONFIG | {"record": ["reversals"]}, output=tmp_path / "turns").runs
    assert runs.type.tolist() == ["D"] * 3
    assert runs.n_turns.tolist() == [0] * 3
    assert runs.t_r.isna().all()
    runs = rs.sweep(CONFIG | {"record": ["error"]}, output=tmp_path / "error").runs
    assert runs.type.tolist() == ["D"] * 3
    assert runs[["t_r", "t_r_error"]].isna().all(axis=None)


def test_a_trajectory_and_a_replay(plain):
    path = rs.trajectory(GH, n_i=0.1, omega_xy0=0.01, sigma=3.0, t_end=2000, points=2)
    assert (path.status, len(path.zeros), len(path.reversals)) == ("ok", 0, 0)
    assert len(rs.replay(plain.directory, 1, 0, points=2).zeros) == 0


def test_a_larger_share_kills_earlier(tmp_path):
    """The same zero is a reversal while the body lives."""
    one = CONFIG | {"dissipation": {"sigma": 0.01}}
    alive = rs.sweep(one, output=tmp_path / "alive").runs.iloc[0]
    assert alive.type == "R"
    share = min(0.99, 1.001 * alive.energy_left)
    dead = rs.sweep(one | {"classify": {"dead_energy": share}}, output=tmp_path / "dead").runs
    assert (dead.type[0], dead.t_end[0]) == ("D", alive.t_end)
    assert np.isnan(dead.t_r[0])
