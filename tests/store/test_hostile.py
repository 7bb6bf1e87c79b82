"""Directories that others may have changed: links, names, values, and moves."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from hardship import check_equal, files_of
from refusal import assert_refused
from sweeping import changed, invoke, sweep, tree

import rattlesweep as rs
from rattlesweep.store.parquet import read_parquet, write_parquet
from rattlesweep.store.rows import Stored, metadata
from rattlesweep.words.errors import ConfigError, OutputError
from rattlesweep.work import error_fit, job

CONFIG: dict[str, Any] = {
    "name": "open",
    "bodies": {"source": "sd", "samples": 12},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
    "model": "gh",
}
GRID: dict[str, Any] = {
    "source": "grid",
    "base": {"preset": "GH"},
    "axes": {"theta": {"linspace": [0.6, 0.99, 9]}},
}
ESCAPES = "\x1b]0;title\x07\x1b[2J\u202e"
FORGED = f"x{ESCAPES}\nno problem found\n"


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("whole") / "out"
    sweep(output, CONFIG)
    return output


@pytest.fixture
def output(whole, tmp_path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "out"))


def looks(output: Path) -> list[Any]:
    """Return the results of commands that read a directory."""
    copy = output.with_name("copy")
    return [
        invoke("status", output),
        invoke("status", output, "--json"),
        invoke("verify", output),
        invoke("compare", output, output),
        invoke("classify", output),
        invoke("merge", output, "--output", copy),
    ]


# Links.


def test_half_written_files_are_removed_in_the_directory_alone(output, whole):
    mine = output.with_name("mine")
    mine.mkdir()
    draft = ".case00000-sample000000000.parquet.0123abcd.tmp"
    (mine / draft).write_text("precious")
    (output / "notes").symlink_to(mine)
    shutil.rmtree(output / "sessions")
    (output / "sessions").symlink_to(mine)
    (output / draft).write_text("half")
    (output / ".own.tmp").write_text("not ours")
    assert invoke("classify", output).exit_code == 0
    assert [path.name for path in mine.iterdir()] == [draft]
    assert not (output / draft).exists()
    assert (output / ".own.tmp").exists()


def test_no_file_is_moved_out_of_a_folder_that_a_link_leads_to(output):
    mine = output.with_name("mine")
    (output / "runs").rename(mine)
    (mine / "thesis.parquet").write_text("precious")
    (output / "runs").symlink_to(mine)
    before = tree(mine)
    with pytest.raises(OutputError, match="leads to another folder; move it away"):
        sweep(output, CONFIG)
    assert tree(mine) == before


# Moves.


@pytest.mark.parametrize(
    "replaced", [True, pytest.param(False, marks=pytest.mark.slow)]
)
def test_a_writer_stops_when_its_directory_has_moved(
    replaced, whole, tmp_path, monkeypatch
):
    output = tmp_path / "out"
    moved = tmp_path / "moved"
    append = Stored.append

    def move(*args: Any) -> None:
        append(*args)
        monkeypatch.setattr(Stored, "append", append)
        output.rename(moved)
        if replaced:
            shutil.copytree(whole, output)

    monkeypatch.setattr(job, "MAX_BLOCK_RUNS", 6)
    monkeypatch.setattr(Stored, "append", move)
    with pytest.raises(
        OutputError, match="was moved or replaced while this command wrote there"
    ):
        sweep(output, CONFIG)
    if replaced:
        check_equal(output, whole)
        assert len(list((output / "sessions").iterdir())) == 1
    else:
        assert not output.exists()
    assert len(files_of(moved)) == 1
    sweep(moved, CONFIG)
    monkeypatch.undo()
    check_equal(moved, whole)


# Values.

NUMBERS = ["NaN", "Infinity", "-1", "1e10", "9" * 4300, '"\\ud800"', "[" * 2000]
CHANGES = [
    *(("samples", text) for text in NUMBERS),
    *((f"cases.0.{key}", text) for key in ("n_i", "case") for text in NUMBERS[4:]),
    ("cases.0.n_i", "NaN"),
    ("cases.0.n_i", f"1{'0' * 400}"),
    ("cases.0.n_i", '"fast"'),
    ("cases.0.case", '"0"'),
    ("cases", "[]"),
    ("name", None),
    ("name", "3"),
    ("base", None),
    ("base", "[1]"),
    ("config_hash", "7"),
    ("versions", "[]"),
    ("machine", '"x"'),
    ("command", "{}"),
    ("started", "0"),
    ("columns", '[["n_i", "double", true, "1", "x"]]'),
    ("columns", '[["x", "nothing", true, "1", "x"]]'),
    ("config.seed", "NaN"),
]


def set_raw(path: Path, key: str, text: str | None) -> None:
    """Put a text of JSON at a key of a file, or remove the key."""
    data = json.loads(path.read_text())
    *parents, last = key.split(".")
    place = data
    for parent in parents:
        place = place[int(parent) if parent.isdigit() else parent]
    if text is None:
        del place[last]
    else:
        place[last] = "@@"
    path.write_text(json.dumps(data).replace('"@@"', text or ""))


@pytest.mark.parametrize(("key", "text"), CHANGES)
def test_a_manifest_with_values_of_other_types_is_refused(key, text, output):
    set_raw(output / "manifest.json", key, text)
    words = "manifest.json is damaged or of another version ("
    assert_refused(invoke("status", output), 1, words)


@pytest.mark.parametrize("key", ["seconds", "pid", "host", "machine", "further"])
@pytest.mark.parametrize("text", NUMBERS[:1] + NUMBERS[4:])
def test_a_record_with_such_values_is_left_out(key, text, output):
    (path,) = (output / "sessions").iterdir()
    set_raw(path, key, text)
    result = invoke("status", output, "--json")
    assert result.exit_code == 0
    last = json.loads(result.stdout)["last"]
    assert last is None or (key == "further" and key not in last)


def change_rows(output: Path, function: Any, **labels: str) -> None:
    (path,) = files_of(output)
    rows = read_parquet(path)
    names = metadata(rows) | {f"rattlesweep.{key}": v for key, v in labels.items()}
    write_parquet(function(rows), path, names)


def retyped(rows: pa.Table) -> pa.Table:
    fields = [field.with_type(_larger(field.type)) for field in rows.schema]
    return rows.cast(pa.schema(fields))


def _larger(kind: pa.DataType) -> pa.DataType:
    return pa.large_string() if pa.types.is_string(kind) else kind


def with_value(rows: pa.Table, name: str, value: object) -> pa.Table:
    place = rows.schema.get_field_index(name)
    field = rows.schema.field(place)
    return rows.set_column(place, field, pa.array([value] * len(rows), field.type))


ROWS = {
    "other types": retyped,
    "a column less": lambda rows: rows.drop_columns(["t_r"]),
    "a column twice": lambda rows: rows.append_column("t_r", rows["t_r"]),
    "keys beyond": lambda rows: with_value(rows, "case", 2),
    "negative keys": lambda rows: with_value(rows, "sample", -1),
    "no rows": lambda rows: rows.slice(0, 0),
}


@pytest.mark.parametrize("harm", ROWS)
def test_rows_of_other_columns_are_refused_by_every_reader(harm, output):
    change_rows(output, ROWS[harm], classify='{"sw_departure": 0.1}')
    for result in looks(output):
        assert_refused(result, 1, str(files_of(output)[0]))
    with pytest.raises(OutputError):
        _ = rs.load(output).runs
    picture = output.with_name("p.svg")
    assert_refused(invoke("plot", output, "--output", picture), 1)


@pytest.mark.parametrize(
    "text", ["[1]", "[" * 5000, '{"sw_departure": "x"}', '{"sw_departure": -1}', "\x1b"]
)
def test_thresholds_in_a_file_are_checked(text, output, whole):
    change_rows(output, lambda rows: rows, classify=text)
    result = invoke("verify", output)
    assert (result.exit_code, result.stderr) == (1, "")
    assert "typed by other thresholds" in result.stdout
    sweep(output, CONFIG)
    check_equal(output, whole)


@pytest.mark.parametrize("kind", ["times", "scatter"])
def test_negative_times_are_a_problem_and_no_traceback(kind, output):
    change_rows(output, lambda rows: with_value(rows, "t_r", -1.0))
    assert "t_r is negative" in invoke("verify", output).stdout
    picture = output / "p.svg"
    result = invoke("plot", output, "--kind", kind, "--x", "n_i", "-o", picture)
    assert_refused(result, 1, "holds negative reversal times")


# Texts that are stored, and printed.


def test_stored_texts_cannot_change_what_a_terminal_shows(output):
    for path, keys in (
        (output / "manifest.json", ("name", "started")),
        (next((output / "sessions").iterdir()), ("command", "how", "host")),
    ):
        for key in keys:
            set_raw(path, key, json.dumps(FORGED))
    change_rows(output, lambda rows: with_value(rows, "status", FORGED))
    (path,) = files_of(output)
    path.rename(path.with_name(f"{FORGED}.parquet"))
    damaged = output / "damaged" / f"{FORGED}.damaged"
    damaged.parent.mkdir()
    damaged.touch()
    results = looks(output)
    (path,) = files_of(output)
    path.write_bytes(b"damaged")
    results += looks(output)
    assert r"x\x1b]0;title\x07\x1b[2J\u202e\nno problem found\n" in results[0].stdout
    for result in results:
        lines = result.output.splitlines()
        assert all(line.isprintable() for line in lines)
        assert not [line for line in lines if line == "no problem found"][1:]
    # The rows contradict themselves, so that it may be found nowhere in these.
    for result in (results[2], *results[6:]):
        assert "no problem found" not in result.output.splitlines()


# What is missing.


def test_missing_runs_are_said_and_may_be_a_problem(tmp_path):
    output = tmp_path / "out"
    config = tmp_path / "open.yaml"
    config.write_text(json.dumps(CONFIG))
    run = ("run", config, "--output", output, "-q")
    assert invoke(*run, "--shard", "0/2").exit_code == 0
    result = invoke("verify", output)
    assert result.exit_code == 0
    assert result.stdout.splitlines() == [
        "12 runs in 1 file",
        "missing: 12 of 24 runs",
        "no problem found in the runs that are there",
    ]
    result = invoke("verify", output, "--complete")
    assert result.exit_code == 1
    assert "problem: 12 of 24 runs are missing; `rattlesweep run`" in result.stdout
    assert len(rs.load(output).verify(complete=True).problems) == 1
    assert invoke(*run).exit_code == 0
    result = invoke("verify", output, "--complete")
    assert (result.exit_code, result.stdout.splitlines()[1:]) == (
        0,
        ["no problem found"],
    )


# What `run` would refuse.


def refused_by_plan(config: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(json.dumps(config))
    output = tmp_path / "refused"
    for command in (("plan", "--check"), ("plan",), ("run", "--dry-run"), ("run",)):
        result = invoke(*command, path, "--output", output)
        assert_refused(result, 2, words)
    with pytest.raises(ConfigError, match=words):
        sweep(output, config)
    assert not output.exists()


def test_a_column_to_refine_by_must_be_recorded(tmp_path):
    bodies = GRID | {"refine": {"levels": 2, "by": "regime"}}
    config = changed(CONFIG, model="full", horizon={"t": 50}) | {"bodies": bodies}
    refused_by_plan(config, "bodies.refine.by: there is no column regime", tmp_path)


def test_errors_of_a_law_need_its_constants(tmp_path, monkeypatch):
    monkeypatch.delitem(error_fit.MOTION_FITS, ("paraboloid", "rolling"))
    config = changed(CONFIG, model="full", dissipation={"rolling": 1e-3})
    words = "record: errors are not calibrated for paraboloid with rolling"
    refused_by_plan(config | {"record": ["error"]}, words, tmp_path)


def test_an_output_of_another_sweep_is_refused_by_plan(output, tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(json.dumps(CONFIG | {"seed": 3}))
    result = invoke("plan", "--check", path, "--output", output)
    assert_refused(result, 2, "holds another sweep (seed: ")


# Threads.

COUNT = """
import os, pathlib, sys
from rattlesweep.store.parquet import read_parquet
before = len(os.listdir("/proc/self/task"))
read_parquet(pathlib.Path(sys.argv[1]))
print(len(os.listdir("/proc/self/task")) - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc of Linux")
def test_reading_rows_starts_no_thread(whole):
    """A thread that destroyed a Python file late would abort the process."""
    (path,) = files_of(whole)
    command = [sys.executable, "-c", COUNT, str(path)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env=os.environ
    )
    assert done.stdout == "0\n"
