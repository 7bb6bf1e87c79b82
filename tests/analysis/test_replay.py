"""Stored runs again: found by number or condition, equal bit for bit, followed past
reversals.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from editing import edited, replaced
from refusal import assert_refused
from sweeping import invoke, rows, run

import rattlesweep as rs
from rattlesweep.analysis.onerun.course import Course
from rattlesweep.analysis.onerun.replay import find_run
from rattlesweep.words.errors import ConfigWarning


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("replay") / "out"
    result = run(
        "quickstart.yaml",
        output,
        "bodies.samples=8",
        "record=[windows]",
        "bodies.target={K_r: [0.05], rel_tol: 0.1}",
        "spin.n_i=[-0.1, -0.5]",
    )
    assert result.exit_code == 0
    return output


def bits(value: float) -> bytes:
    return np.float64(value).tobytes()


def test_every_run_is_the_stored_one_bit_for_bit(sweep):
    table = rows(sweep)
    assert 2 <= table["t_r"].notna().sum() < len(table)
    for stored in table.itertuples():
        one = find_run(sweep, stored.case, stored.sample)
        one.prove()
        course = Course(one.prepare(), steps=True)
        last = list(course)[-1]
        ended = course.follower
        assert ended.status.label == stored.status
        if np.isnan(stored.t_r):
            assert (ended.zeros, ended.n_steps) == ([], stored.n_steps)
            assert bits(ended.t) == bits(stored.t_end)
            assert bits(last["n"][-1]) == bits(stored.n_end)
        else:
            assert bits(ended.zeros[0]) == bits(stored.t_r)
            assert ended.t > stored.t_end


def test_a_run_is_chosen_by_a_condition_and_goes_to_files(sweep, tmp_path):
    text = "n_i == -0.5 and sample in (1, 3, 5)"
    stored = pd.read_parquet(sweep / "runs").query(text).iloc[0]
    table = tmp_path / "run.parquet"
    figure = tmp_path / "run.svg"
    result = invoke(
        "replay",
        sweep,
        "--where",
        text,
        "--points",
        4,
        "--output",
        table,
        "--figure",
        figure,
        "--channels",
        "t,n,E_r",
        "-q",
    )
    assert (result.exit_code, result.output) == (0, "")
    found = rs.replay(
        sweep,
        int(stored["case"]),
        int(stored["sample"]),
        points=4,
        channels=["t", "n", "E_r"],
    )
    pd.testing.assert_frame_equal(pd.read_parquet(table), found.table)
    assert figure.stat().st_size > 5000


def test_a_condition_that_several_runs_meet_is_told(sweep, tmp_path):
    count = len(pd.read_parquet(sweep / "runs").query("n_i == -0.5"))
    assert count > 1
    told = f", the first of {count} runs that meet the condition: "
    file = tmp_path / "run.csv"
    words = ("--where", "n_i == -0.5", "--points", 2, "--output", file)
    assert told in invoke("replay", sweep, *words).stderr
    with pytest.warns(ConfigWarning, match=told.rstrip(": ")):
        rs.load(sweep).show(where="n_i == -0.5", points=10)
    words = ("--case", 0, "--sample", 0, "--points", 2, "--output", file)
    assert "the first of" not in invoke("replay", sweep, *words).stderr


def test_a_stored_number_that_is_not_what_comes_out_is_told(sweep, tmp_path):
    one = find_run(sweep, where='type == "R"')
    key = case, sample = one.values["case"], one.values["sample"]

    def change(table):
        keys = zip(table["case"].to_pylist(), table["sample"].to_pylist(), strict=True)
        t_r = zip(keys, table["t_r"].to_pylist(), strict=True)
        return replaced(
            table, "t_r", [np.nextafter(t, np.inf) if k == key else t for k, t in t_r]
        )

    output = edited(sweep, tmp_path / "out", change)
    words = f"{one.name} differs from its stored row in t_r;"
    assert_refused(
        invoke("replay", output, "--case", case, "--sample", sample), 1, words
    )
    gone = edited(sweep, tmp_path / "gone", lambda table: table[:0])
    for directory, why in ((output, words), (gone, "is not stored yet")):
        with pytest.raises(rs.OutputError, match=why):
            rs.replay(directory, case, sample)


def test_rows_may_begin_late(sweep):
    which = ["replay", sweep, "--case", 0, "--sample", 1, "--t-end", 30]
    for rows_asked in (["--dt", 0.5], ["--steps"]):
        head, *whole = invoke(*which, *rows_asked).stdout.splitlines()
        kept = [line for line in whole if float(line.split(",")[0]) >= 20]
        assert 0 < len(kept) < len(whole)
        late = invoke(*which, *rows_asked, "--from-time", 20)
        assert late.stdout.splitlines() == [head, *kept]
    for bad in (-1, 30, "nan"):
        assert_refused(invoke(*which, "--from-time", bad), 2, f"from_time {bad}")
