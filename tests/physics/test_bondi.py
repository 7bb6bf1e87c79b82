"""At small oscillations type SS is where the spin exceeds Bondi's threshold, run by run."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import rattlesweep as rs

STEADY = Path(__file__).parents[2] / "configs" / "steady.yaml"


def compare(runs: pd.DataFrame) -> str:
    """The runs in which the two disagree, by name; empty if there are none."""
    assert (runs.status == "ok").all()
    assert (runs.omega_xy0 == 0.001).all()
    threshold = runs.n_c1.abs() < runs.n_i.abs()  # a null threshold is below nothing
    differ = runs[(runs.type == "SS") != threshold]
    if differ.empty:
        return ""
    names = ["case", "sample", "n_i", "K_r", "n_c1", "type", "amp_growth", "n_departure"]
    return f"{len(differ)} of {len(runs)} runs differ:\n{differ[names].to_string()}"


def sweep(bodies: dict[str, Any], output: Path, capsys: Any) -> rs.Sweep:
    began = time.perf_counter()
    config = {
        "seed": 2017,
        "bodies": {"source": "sd", **bodies},
        "spin": {"n_i": [-0.3, -0.4, -0.5], "omega_xy0": 0.001},
        "horizon": {"t_rgh": 5},
    }
    done = rs.sweep(config, output=output)
    with capsys.disabled():
        print(f"\n{len(done.runs)} runs in {time.perf_counter() - began:.1f} s")
    return done


def test_three_targets(tmp_path, capsys):
    bodies = {"samples": 560, "target": {"K_r": [0.01, 0.03, 0.1]}}
    done = sweep(bodies, tmp_path / "out", capsys)
    assert len(done.runs) >= 5000
    assert (done.runs.type == "SS").sum() > 100
    assert compare(done.runs) == ""
    assert (done.summary.fraction_SS == done.summary.fraction_bondi).all()


@pytest.mark.slow
def test_without_a_target(tmp_path, capsys):
    # Bodies with a skew angle near zero take horizons up to a million units of time.
    runs = sweep({"samples": 1700}, tmp_path / "out", capsys).runs
    assert len(runs) >= 5000
    assert (runs.type == "SS").sum() > 100
    assert compare(runs) == ""


@pytest.mark.slow
def test_the_papers_own_runs(tmp_path, capsys):
    from rattlesweep.sweeps.config.load import load_config, resolved

    began = time.perf_counter()
    config = resolved(load_config(STEADY))
    config["spin"] |= {"omega_xy0": [0.001], "n_i": [-0.3, -0.4, -0.5]}
    done = rs.sweep(config, output=tmp_path / "out")
    runs = done.runs
    with capsys.disabled():
        print(f"\n{len(runs)} runs in {time.perf_counter() - began:.1f} s")
    assert len(runs) == 24_000
    assert compare(runs) == ""
    share = done.summary
    assert (share.fraction_SS == share.fraction_bondi).all()
