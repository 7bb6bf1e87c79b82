"""Dissipation that varies from run to run: by case, and row by row of a table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from refusal import assert_refused
from sweeping import HEAD, ROW, invoke, plan_of, prepared, proved

import rattlesweep as rs
from rattlesweep.design.models import model_of
from rattlesweep.physics import full, steady
from rattlesweep.physics.theory import bondi_threshold
from rattlesweep.store.classify import classify_stored
from rattlesweep.words.errors import ConfigError

SIGMA = [0.0, 0.05, 0.2]
ROLLING = [0.0, 1e-3]
# The kernel that knows all of it, as in test_stones.
CONFIG: dict[str, Any] = {
    "bodies": {
        "source": "grid",
        "base": {"preset": "GH"},
        "c": 3,
        "axes": {"minus_xi_deg": [1, 2, 4], "theta": [0.64, 0.8]},
    },
    "spin": {"n_i": [0.3, -0.3], "omega_xy0": 0.05},
    "dissipation": {"sigma": SIGMA, "rolling": ROLLING},
    "horizon": {"t": 300},
    "record": ["reversals"],
}
GH = {
    "bodies": {"source": "preset", "name": "GH"},
    "spin": {"n_i": 0.2, "omega_xy0": 0.05},
}


@pytest.fixture(scope="module")
def swept(tmp_path_factory) -> Any:
    return rs.sweep(CONFIG, output=tmp_path_factory.mktemp("dissipation") / "out")


def table(folder: Path, *lines: str, **source: Any) -> dict[str, Any]:
    """A config of a table of bodies."""
    path = folder / "b.csv"
    path.write_text("\n".join(lines) + "\n")
    return GH | {"bodies": {"source": "table", "path": str(path)} | source}


def test_a_horizon_in_units_of_the_decay():
    def ends(sigma: list[float], **horizon: float) -> Any:
        plan = plan_of(GH, dissipation={"sigma": sigma}, horizon=horizon)
        return pytest.approx(prepared(plan)[0].horizon.tolist())

    gamma = rs.Rattleback.gh().gamma
    assert ends([0.01, 0.1], t_decay=5) == [500 * gamma, 50 * gamma]
    assert ends([0.01, 0.1], t_decay=5, t=1000) == [1000, 50 * gamma]
    assert ends([0, 1], t_decay=1, t=99) == [99, gamma]


@pytest.mark.slow
def test_columns_are_those_of_each_run(swept, tmp_path):
    runs = swept.runs
    sigma = runs.sigma
    rolling = runs["rolling"]
    assert runs.status.eq("ok").all()
    assert sorted(set(zip(sigma, rolling, strict=True))) == [
        (s, r) for s in SIGMA for r in ROLLING
    ]
    free = (sigma == 0) & (rolling == 0)
    assert (runs.energy_left[free] == 1).all()
    assert (runs.energy_left[~free] < 1).all()
    assert (runs.energy_drift.abs() < 1e-7).all()
    # Growth by linear theory is known without a lever, the threshold without any loss.
    assert (runs.growth.notna() == (rolling == 0)).all()
    assert (runs.n_growth.notna() == (rolling == 0)).all()
    b = rs.Rattleback.gh()
    n_c1 = bondi_threshold(b.alpha, b.beta, b.gamma, runs.theta, b.phi)
    np.testing.assert_array_equal(runs.n_c1, np.where(free, n_c1, np.nan))
    assert free.sum() == runs.n_c1.notna().sum() > 0
    for run in runs[rolling == 0].itertuples():
        constants = full.constants(b.alpha, b.beta, b.gamma, run.theta, b.phi, run.xi)
        pitch, roll = steady.growth(np.array(constants), run.n_i, run.sigma)
        assert run.growth == (pitch if run.n_i > 0 else roll)
    assert not (runs[free].type == "D").any()
    assert (runs[sigma == 0.2].type == "D").any()
    # A run is what it is alone: the same kernel gives the same bits.
    own = CONFIG | {"dissipation": {"sigma": 0.2, "rolling": 1e-3}}
    one = rs.sweep(own, output=tmp_path).runs.drop(columns="case")
    same = runs[(sigma == 0.2) & (rolling == 1e-3)].reset_index(drop=True)
    pd.testing.assert_frame_equal(one, same[list(one)], check_exact=True)


DYING = {
    "bodies": {"source": "preset", "name": "GH"},
    "spin": {"n_i": 0.1, "omega_xy0": 0.01},
    "dissipation": {"sigma": [0.3, 3.0, 10.0]},
    "horizon": {"t": 2000},
    "record": ["reversals", "error"],
}


@pytest.mark.parametrize("sigma", [0.3, 1e6])
def test_a_single_dying_body(sigma):
    """The spin of each passes through zero, at sizes of 1e-26 to 0."""
    launch = {"n_i": 0.1, "omega_xy0": 0.01, "sigma": sigma, "t_end": 2000}
    run = rs.simulate("GH", **launch)
    assert (run.type, run.t_r, run.status) == ("D", None, "ok")
    if sigma < 1:  # a trajectory of the other takes 1e8 steps
        path = rs.trajectory("GH", **launch, points=2)
        assert (path.status, len(path.zeros), len(path.reversals)) == ("ok", 0, 0)


def test_a_dying_sweep_and_its_threshold(tmp_path):
    runs = rs.sweep(DYING, output=tmp_path).runs
    assert runs.type.tolist() == ["D"] * 3
    assert runs.n_turns.tolist() == [0] * 3
    assert runs[["t_r", "t_r_error"]].isna().all(axis=None)
    assert (runs.energy_left.abs() < 0.01).all()
    assert len(rs.replay(tmp_path, 1, 0, points=2).zeros) == 0
    with pytest.raises(ConfigError, match="needs a new sweep"):
        classify_stored(tmp_path, ["classify.dead_energy=0.5"])
    with pytest.raises(ConfigError, match="holds another sweep"):
        rs.sweep(DYING | {"classify": {"dead_energy": 0.5}}, output=tmp_path)


def test_a_larger_share_kills_earlier(tmp_path):
    """The same zero is a reversal while the body lives."""
    one = DYING | {"dissipation": {"sigma": 0.01}, "record": []}
    alive = rs.sweep(one, output=tmp_path / "alive").runs.iloc[0]
    assert alive.type == "R"
    share = min(0.99, 1.001 * alive.energy_left)
    dead = rs.sweep(
        one | {"classify": {"dead_energy": share}}, output=tmp_path / "dead"
    ).runs
    assert (dead.type[0], dead.t_end[0]) == ("D", alive.t_end)
    assert np.isnan(dead.t_r[0])


@pytest.mark.slow
def test_the_runs_of_a_sweep_are_a_table_that_says_it_row_by_row(tmp_path, swept):
    source = {
        "source": "table",
        "path": str(swept.directory / "runs"),
        "surface": "ellipsoid",
    }
    config = {"bodies": source, "horizon": {"t": 300}, "record": ["reversals"]}
    losses = plan_of(config).config.dissipation
    assert losses.sigma == losses.rolling == ["table"]
    again = rs.sweep(config, output=tmp_path / "out")
    names = ["sigma", "rolling", "t_r", "n_turns", "growth", "type", "energy_left"]
    pd.testing.assert_frame_equal(
        swept.runs[names], again.runs[names], check_exact=True
    )
    assert again.summary.sigma.isna().all()
    proved(again.directory, recompute=5)


def test_what_all_rows_share_is_that_of_the_config(tmp_path):
    same = plan_of(
        table(tmp_path, f"{HEAD},sigma,rolling", f"{ROW},0.1,0", f"{ROW},0.1,0")
    ).config
    assert (same.dissipation.sigma, same.dissipation.rolling) == ([0.1], [0])
    assert model_of(same).name == "full_viscous"
    # A column counts in the place of the config's number, and another key with it.
    two = table(tmp_path, f"{HEAD},sigma", f"{ROW},0.1", f"{ROW},0.2")
    both = plan_of(two, dissipation={"sigma": 7, "rolling": [0, 0.01]})
    launches, _ = prepared(both)
    assert launches.losses["sigma"].tolist() == [0.1, 0.2, 0.1, 0.2]
    assert launches.losses["rolling"].tolist() == [0, 0, 0.01, 0.01]


# name: (column and value of a table, its config, words)
REFUSED_TABLES: dict[str, tuple[str, str, dict[str, Any], str]] = {
    "long lever": ("rolling", "2", {}, "row 1: rolling is 2; from 0 to 1 a is allowed"),
    "several too": (
        "sigma",
        "0.1",
        {"dissipation": {"sigma": [0, 1]}},
        "dissipation.sigma: there are several values, and the table has a column ",
    ),
    "closed form": (
        "sigma",
        "0.1",
        {"model": "gh"},
        "bodies.path: with sigma of the table: dissipation: the model gh conserves",
    ),
    "reduced": (
        "mu",
        "0.1",
        {"model": "reduced"},
        "bodies.path: with mu of the table: dissipation.mu: the reduced model has no "
        "contact force",
    ),
    "no decay": (
        "sigma",
        "0",
        {"horizon": {"t_decay": 1}},
        "bodies.path: with sigma of the table: horizon.t_decay: it is in units of "
        "gamma/sigma, and sigma is 0",
    ),
}


@pytest.mark.parametrize("name", REFUSED_TABLES)
def test_what_makes_no_sense_is_refused_in_a_sentence(name, tmp_path):
    column, cell, rest, words = REFUSED_TABLES[name]
    config = table(tmp_path, f"{HEAD},{column}", f"{ROW},{cell}") | rest
    (tmp_path / "c.yaml").write_text(json.dumps(config))
    done = invoke("run", tmp_path / "c.yaml", "--output", tmp_path / "out")
    assert_refused(done, 2, words)
    assert not (tmp_path / "out").exists()
