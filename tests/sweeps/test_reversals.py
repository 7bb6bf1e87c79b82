"""`record: [reversals]`: every reversal up to the horizon, as a trajectory counts them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from refusal import assert_refused
from test_run import CONFIGS, invoke

import rattlesweep as rs
from rattlesweep.study.plots.layout import read_layout
from rattlesweep.study.plots.registry import read_picture
from rattlesweep.study.plots.reversals import _borders

CONFIG: dict[str, Any] = {
    "bodies": {"source": "grid", "base": {"preset": "GH"}, "axes": {"theta": [0.64, 0.8, 0.9]}},
    "spin": {"n_i": [0.2, -0.2, 0, 0.5], "omega_xy0": 0.1, "psi": "pitch"},
    "horizon": {"t": 900},
}
NEW = ["n_reversals", "reversal_times", "spin_after"]


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("reversals") / "out"
    rs.sweep(CONFIG | {"record": ["reversals", "windows"]}, output=directory)
    return directory


def test_they_are_those_of_the_trajectory(sweep: Path):
    """Every run, bit for bit; the largest spin at the accepted steps in between."""
    runs = rs.load(sweep).runs
    assert runs.n_reversals.max() > 8
    assert (runs.n_reversals == 0).any()
    for run in runs.itertuples():
        path = rs.replay(sweep, int(run.case), int(run.sample), steps=True)
        assert run.n_reversals == len(path.reversals)
        assert run.reversal_times.tolist() == path.reversals[:8].tolist()
        ends = [*path.reversals, np.inf]
        steps, size = path.table.t.to_numpy(), path.table.n.abs().to_numpy()
        for k, largest in enumerate(run.spin_after):
            between = (steps > ends[k]) & (steps < ends[k + 1])
            assert largest == pytest.approx(size[between].max(), rel=1e-12)
        if run.n_reversals:
            assert run.t_r <= run.reversal_times[0]
        assert run.t_end == 900


def test_the_first_one_and_the_type_are_as_without(sweep: Path, tmp_path: Path):
    runs, plain = rs.load(sweep).runs, rs.sweep(CONFIG, output=tmp_path / "plain").runs
    pd.testing.assert_series_equal(runs.t_r, plain.t_r, check_exact=True)
    pd.testing.assert_series_equal(runs.type, plain.type)
    assert not set(NEW) & set(plain)
    # What does not reverse is the same to the last bit.
    still = plain.t_r.isna()
    assert still.any()
    pd.testing.assert_frame_equal(runs[plain.columns][still], plain[still], check_exact=True)


def test_commands_know_the_columns(sweep: Path, tmp_path: Path):
    assert invoke("verify", sweep, "--recompute", "12").exit_code == 0
    assert invoke("status", sweep).exit_code == 0
    assert invoke("classify", sweep, "--set", "classify.sw_departure=0.1").exit_code == 0
    assert invoke("compare", sweep, sweep).exit_code == 0
    found = invoke("replay", sweep, "--where", "n_reversals > 8", "--points", "2")
    assert found.exit_code == 0
    assert "reversals at" in found.stderr
    lists = invoke("replay", sweep, "--where", "spin_after > 8", "--points", "2")
    assert_refused(lists, 2, "spin_after holds several numbers a run")
    table = pq.read_table(sweep / "runs")
    assert table.schema.field("n_reversals").type == "int32"
    for name in NEW[1:]:
        assert table[name].to_pylist()[0] is not None
        assert max(map(len, table[name].to_pylist())) == 8


def test_failed_runs_have_none(tmp_path: Path):
    config = CONFIG | {"record": ["reversals"], "integrator": {"max_steps": 500}}
    runs = rs.sweep(config, output=tmp_path / "out").runs
    failed = runs.status != "ok"
    assert failed.any()
    assert runs[NEW][failed].isna().all().all()
    assert runs.t_r[failed].isna().all()


@pytest.mark.slow
@pytest.mark.parametrize("model", ["reduced", "full"])
def test_with_a_fixed_step_and_the_reduced_model(model, tmp_path: Path):
    rk4 = {"method": "rk4", "dt": 0.01}
    config = CONFIG | {
        "record": ["reversals"], "model": model, "horizon": {"t": 300}, "integrator": rk4,
        "spin": {"n_i": [0.2, -0.2], "omega_xy0": 0.1},
    }  # fmt: skip
    runs = rs.sweep(config, output=tmp_path / "out").runs
    assert runs.n_reversals.max() > 0
    for run in runs.itertuples():
        path = rs.replay(tmp_path / "out", int(run.case), int(run.sample), points=2)
        assert run.reversal_times.tolist() == path.reversals[:8].tolist()


# ------------------------------------------------------------------------------ a map


def test_a_map_of_the_shipped_config(tmp_path: Path):
    axis = "bodies.axes.minus_xi_deg={logspace: [0.3, 5, 8]}"
    spins = "spin.n_i={linspace: [-0.3, 0.3, 8]}"
    out = tmp_path / "out"
    small = ["--set", axis, "--set", spins, "--set", "horizon.t=600", "--output", out, "-q"]
    assert invoke("run", CONFIGS / "reversals.yaml", *small).exit_code == 0
    data = tmp_path / "d.csv"
    result = invoke("plot", out, "--output", tmp_path / "p.png", "--data", data)
    assert result.exit_code == 0, result.stderr
    assert result.stderr == "reversals: 64 runs\n"
    runs, cells = rs.load(out).runs, pd.read_csv(data)
    assert sorted(cells.n_reversals_mean) == sorted(runs.n_reversals)
    assert runs.n_reversals.max() > 1
    shown = read_picture(read_layout(out), "reversals")
    figure = shown.figure()
    mesh = figure.axes[0].collections[-1].get_array()
    assert np.array_equal(np.sort(mesh.ravel()), np.sort(runs.n_reversals))
    labels = [text.get_text() for text in figure.axes[-1].get_yticklabels()]
    assert labels[:3] == ["0", "1", "2"]
    # Without the record there is no such picture.
    config = {**CONFIG, "spin": {"n_i": [0.1, 0.2], "omega_xy0": 0.1}, "horizon": {"t": 9}}
    rs.sweep(config, output=tmp_path / "plain")
    assert_refused(invoke("plot", tmp_path / "plain", "--kind", "reversals"), 2, "does not fit")


def test_missing_cells_are_seen(sweep: Path):
    layout = read_layout(sweep)
    shown = read_picture(layout, "reversals")
    shown.cells.runs[0] = 0
    assert "not run yet" in [text.get_text() for text in shown.figure().legends[0].get_texts()]


@pytest.mark.parametrize("most", [0, 1, 5, 6, 7, 12, 300])
def test_colours_part_the_numbers(most):
    borders = _borders(np.array([0.0, most]))
    assert borders[0] == 0
    assert borders[-1] == most + 1
    assert (np.diff(borders) >= 1).all()
    assert borders[: min(most, 6) + 1] == list(range(min(most, 6) + 1))
