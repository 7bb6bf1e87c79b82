"""`record: [reversals]`: every reversal up to the horizon, as a trajectory counts them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import sweeping
from refusal import assert_refused
from sweeping import invoke, proved

import rattlesweep as rs
from rattlesweep.analysis.plots.kinds import choose_picture
from rattlesweep.analysis.plots.layout import read_layout

CONFIG: dict[str, Any] = {
    "bodies": {"source": "grid", "base": {"preset": "GH"}, "axes": {"theta": [0.64, 0.8, 0.9]}},
    "spin": {"n_i": [0.2, -0.2, 0, 0.5], "omega_xy0": 0.1, "psi": "pitch"},
    "horizon": {"t": 900},
}
NEW = ["n_turns", "turn_times", "spin_after_turn"]


@pytest.fixture(scope="module")
def sweep(tmp_path_factory) -> Path:
    directory = tmp_path_factory.mktemp("reversals") / "out"
    rs.sweep(CONFIG | {"record": ["reversals", "windows"]}, output=directory)
    return directory


def test_they_are_those_of_the_trajectory(sweep):
    """Every run, bit for bit; the largest spin at the accepted steps in between."""
    runs = rs.load(sweep).runs
    assert runs.n_turns.max() > 8
    assert (runs.n_turns == 0).any()
    for run in runs.itertuples():
        path = rs.replay(sweep, int(run.case), int(run.sample), steps=True)
        assert run.n_turns == len(path.reversals)
        assert run.turn_times.tolist() == path.reversals[:8].tolist()
        ends = [*path.reversals, np.inf]
        steps, size = path.table.t.to_numpy(), path.table.n.abs().to_numpy()
        for k, largest in enumerate(run.spin_after_turn):
            between = (steps > ends[k]) & (steps < ends[k + 1])
            assert largest == pytest.approx(size[between].max(), rel=1e-12)
        if run.n_turns:
            assert run.t_r <= run.turn_times[0]
        assert run.t_end == 900


def test_the_first_one_and_the_type_are_as_without(sweep, tmp_path):
    runs, plain = rs.load(sweep).runs, rs.sweep(CONFIG, output=tmp_path).runs
    pd.testing.assert_frame_equal(runs[["t_r", "type"]], plain[["t_r", "type"]], check_exact=True)
    assert not set(NEW) & set(plain)
    # What does not reverse is the same to the last bit.
    still = plain.t_r.isna()
    assert still.any()
    pd.testing.assert_frame_equal(runs[plain.columns][still], plain[still], check_exact=True)
    # Without the record there is no such picture.
    assert_refused(invoke("plot", tmp_path, "--kind", "reversals"), 2, "does not fit")


def test_commands_know_the_columns(sweep):
    proved(sweep, recompute=12)
    found = invoke("replay", sweep, "--where", "n_turns > 8", "--points", "2")
    assert found.exit_code == 0
    assert "reversals at" in found.stderr
    lists = invoke("replay", sweep, "--where", "spin_after_turn > 8", "--points", "2")
    assert_refused(lists, 2, "spin_after_turn holds several numbers a run")
    table = pq.read_table(sweep / "runs")
    assert table.schema.field("n_turns").type == "int32"
    for name in NEW[1:]:
        assert table[name].to_pylist()[0] is not None
        assert max(map(len, table[name].to_pylist())) == 8


def test_failed_runs_have_no_count_and_keep_their_first_zero(tmp_path):
    config = CONFIG | {"record": ["reversals"], "integrator": {"max_steps": 500}}
    runs = rs.sweep(config, output=tmp_path).runs
    failed = runs.status != "ok"
    assert failed.any()
    assert runs[[*NEW, "type"]][failed].isna().all(axis=None)
    assert (runs.t_r <= runs.t_end)[failed & runs.t_r.notna()].all()


@pytest.mark.slow
@pytest.mark.parametrize("model", ["reduced", "full"])
def test_with_a_fixed_step_and_the_reduced_model(model, tmp_path):
    config = CONFIG | {
        "record": ["reversals"], "model": model, "horizon": {"t": 300},
        "integrator": {"method": "rk4", "dt": 0.01}, "spin": {"n_i": [0.2, -0.2], "omega_xy0": 0.1},
    }  # fmt: skip
    runs = rs.sweep(config, output=tmp_path).runs
    assert runs.n_turns.max() > 0
    for run in runs.itertuples():
        path = rs.replay(tmp_path, int(run.case), int(run.sample), points=2)
        assert run.turn_times.tolist() == path.reversals[:8].tolist()


# -- a map -------------------------------------------------------------------------------------


def test_a_map_of_the_shipped_config(tmp_path):
    out, data = tmp_path / "out", tmp_path / "d.csv"
    small = ("bodies.axes.minus_xi_deg={logspace: [0.3, 5, 8]}",
             "spin.n_i={linspace: [-0.3, 0.3, 8]}", "horizon.t=600")  # fmt: skip
    assert sweeping.run("reversals.yaml", out, *small, options=("-q",)).exit_code == 0
    result = invoke("plot", out, "--output", tmp_path / "p.svg", "--data", data)
    assert result.exit_code == 0, result.stderr
    assert result.stderr == "reversals: 64 runs\n"
    counts = rs.load(out).runs.n_turns
    assert sorted(pd.read_csv(data).n_turns_mean) == sorted(counts)
    assert counts.max() > 1
    shown = choose_picture(read_layout(out), "reversals")
    figure = shown.figure()
    mesh = figure.axes[0].collections[-1].get_array()
    assert np.array_equal(np.sort(mesh.ravel()), np.sort(counts))
    labels = [text.get_text() for text in figure.axes[-1].get_yticklabels()]
    assert labels[:3] == ["0", "1", "2"]
    # Cells without runs are seen.
    shown.cells.runs[0] = 0
    assert "not run yet" in [text.get_text() for text in shown.figure().legends[0].get_texts()]
    # Numbers up to 5 have a colour each, larger ones may share one, and every number has one.
    for most in (6, 300):
        means = shown.layout.count(shown.more)[1]
        means["n_turns"] = np.append([0.0, most], np.full(62, np.nan))
        labels = [text.get_text() for text in shown.figure().axes[-1].get_yticklabels()]
        spans = [[int(end) for end in label.split(" to ")] for label in labels]
        assert [span[0] for span in spans[1:]] == [span[-1] + 1 for span in spans[:-1]]
        assert (spans[0][0], spans[-1][-1]) == (0, most)
