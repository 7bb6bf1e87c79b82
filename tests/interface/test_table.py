"""`table`: the runs of a sweep for other programs."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from random_rows import SCHEMA, random_columns
from refusal import assert_refused
from sweeping import ROOT, invoke, sweep

import rattlesweep as rs
from rattlesweep.analysis import one_table
from rattlesweep.rows.arrow import build_table

STEADY = {
    "name": "steady",
    "model": "gh",
    "bodies": {"source": "sd", "samples": 20},
    "spin": {"n_i": [-0.1, -0.3, 0.3], "omega_xy0": 0.01},
}


@pytest.fixture(scope="module")
def steady(tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("table") / "steady"
    sweep(output, STEADY)
    return output


def test_every_kind_of_file_holds_the_runs(steady, tmp_path):
    runs = rs.load(steady).read()
    for ending in ("csv", "parquet", "arrow"):
        done = invoke("table", steady, "--output", tmp_path / f"runs.{ending}")
        assert (done.exit_code, done.stdout) == (0, f"{tmp_path / f'runs.{ending}'}\n")
        assert done.stderr == "60 runs\n"
    stored = (
        pd.read_parquet(tmp_path / "runs.parquet"),
        pd.read_feather(tmp_path / "runs.arrow"),
        pl.read_csv(tmp_path / "runs.csv").to_pandas(),
        pl.read_ipc(tmp_path / "runs.arrow").to_pandas(),
        duckdb.read_csv(str(tmp_path / "runs.csv")).df(),
    )
    for frame in stored:
        # A null is empty, and not a text or NaN that counts.
        assert frame["t_end"].isna().sum() == runs["t_end"].isna().sum()
        pd.testing.assert_frame_equal(frame, runs, check_dtype=False, check_exact=True)


def test_files_of_columns_keep_units_and_meanings(steady, tmp_path):
    schema = rs.load(steady)._stored.schema
    for ending in ("parquet", "arrow"):
        path = tmp_path / f"runs.{ending}"
        invoke("table", steady, "--output", path)
        read = (
            pq.read_schema(path)
            if ending == "parquet"
            else pa.ipc.open_file(path).schema
        )
        assert read.equals(schema)
        assert all(
            read.field(name).metadata[key] == schema.field(name).metadata[key]
            for name in schema.names
            for key in (b"unit", b"description")
        )


def test_csv_goes_to_standard_output_with_chosen_columns_rows_and_units(steady):
    chosen = ("--columns", "t_rgh,n_i,case", "--where", "n_i < 0 and t_rgh > 3000")
    runs = rs.load(steady).read(["t_rgh", "n_i"], where="n_i < 0 and t_rgh > 3000")
    assert 0 < len(runs) < 40
    done = invoke("table", steady, *chosen, "--units")
    head, *lines = done.stdout.splitlines()
    assert head == "t_rgh [sqrt(a/g)],n_i [sqrt(g/a)],case"
    assert [float(line.split(",")[0]) for line in lines] == list(runs["t_rgh"])
    assert invoke("table", steady, *chosen).stdout.splitlines()[1:] == lines
    none = invoke("table", steady, "--where", "n_i > 1", "--columns", "n_i")
    assert (none.stdout, none.stderr) == ("n_i\n", "0 runs\n")


def test_lists_are_texts_and_nulls_empty_cells_in_csv():
    count = 200
    case = np.zeros(count, np.int64)
    rows = build_table(random_columns(case, np.arange(count)), SCHEMA)
    stream = io.BytesIO()
    written = one_table.write_rows(iter(rows.to_batches()), SCHEMA, None, stream)
    assert written == count
    cells = list(csv.DictReader(io.StringIO(stream.getvalue().decode())))
    lists = [field.name for field in SCHEMA if pa.types.is_list(field.type)]
    assert lists
    nulls = 0
    for row, wanted in zip(cells, rows.to_pylist(), strict=True):
        for name, value in wanted.items():
            nulls += value is None
            if value is None:
                assert row[name] == ""
            elif name in lists:
                assert json.loads(row[name]) == value
            elif isinstance(value, float):
                assert float(row[name]) == value
            else:
                assert row[name] == str(value)
    assert nulls > count


def test_rows_are_written_in_groups_and_a_file_is_whole_or_not_there(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(one_table, "ROW_GROUP", 50)
    count = 220
    rows = build_table(
        random_columns(np.zeros(count, np.int64), np.arange(count)), SCHEMA
    )
    taken = []

    def batches(last: int):
        for begin in range(0, last, 20):
            # No more than a group and a batch have come before they are written.
            taken.append(begin)
            yield from rows.slice(begin, 20).to_batches()
        if last < count:
            raise rs.OutputError("a file is damaged")

    path = tmp_path / "runs.parquet"
    one_table.write_rows(batches(count), SCHEMA, path, io.BytesIO())
    footer = pq.read_metadata(path)
    groups = [footer.row_group(k).num_rows for k in range(footer.num_row_groups)]
    assert sum(groups) == count
    assert max(groups) == 50
    assert pq.read_table(path).equals(rows)
    for ending in ("csv", "arrow"):
        with pytest.raises(rs.OutputError, match="damaged"):
            one_table.write_rows(
                batches(100), SCHEMA, tmp_path / f"cut.{ending}", io.BytesIO()
            )
    assert [each.name for each in tmp_path.iterdir()] == ["runs.parquet"]


def test_a_table_is_a_source_of_bodies(steady, tmp_path):
    invoke("table", steady, "--where", "n_i == -0.3", "-o", tmp_path / "runs.csv")
    source = {"source": "table", "path": str(tmp_path / "runs.csv")}
    again = {"name": "again", "model": "gh", "bodies": source}
    sweep(tmp_path / "again", again)
    wanted = rs.load(steady).read(["theta", "n_i", "t_rgh"], where="n_i == -0.3")
    found = rs.load(tmp_path / "again").read(["theta", "n_i", "t_rgh"])
    pd.testing.assert_frame_equal(found, wanted)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--columns", "n_ii"], '"n_ii" is not one of case, sample'),
        (["--columns", "n_i,n_i"], "columns: n_i is named twice"),
        (["--columns", ","], "columns: none is named"),
        (["--where", "n_i = 1"], "compare with =="),
        (["--units", "--output", "runs.arrow"], "leave --units out"),
        (["--output", "runs.xlsx"], "must end in .csv or .parquet or .arrow"),
    ],
)
def test_wrong_wishes_are_refused(arguments, message, steady, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(invoke("table", steady, *arguments), 2, message)
    assert list(tmp_path.iterdir()) == []


def test_the_lines_of_the_page(steady, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "steady").symlink_to(steady)
    text = (ROOT / "docs" / "tables.md").read_text()
    for line in text.split("```sh\n")[1].split("```")[0].splitlines():
        command = line.replace("'", "").removeprefix("rattlesweep ")
        before, condition, after = command.partition("t_r > 2 * t_rgh")
        words = [*before.split(), *filter(None, [condition]), *after.split()]
        assert invoke(*words).exit_code == 0
    blocks = [part.split("```")[0] for part in text.split("```python\n")[1:]]
    assert len(blocks) == 3
    for block in blocks:
        exec(block, {})
        assert "-0.3" in capsys.readouterr().out
