"""`verify`, `status` and `classify` of whole, damaged and half-changed directories."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
import sweeping
from hardship import check_equal, files_of, rows_of

import rattlesweep as rs
from rattlesweep.store import merging
from rattlesweep.store.classify import classify_stored
from rattlesweep.store.parquet import read_parquet, write_parquet
from rattlesweep.store.progress import status
from rattlesweep.store.rows import open_stored, rewrite, same_bits
from rattlesweep.words.errors import ConfigError, DamagedError, OutputError
from rattlesweep.work import job as jobs
from rattlesweep.work.run import Shard
from rattlesweep.work.verify import verify

CONFIG: dict[str, Any] = {
    "name": "checked",
    "bodies": {"source": "sd", "samples": 30},
    "spin": {"n_i": [-0.1, -0.3], "omega_xy0": 0.01},
    "horizon": {"t_rgh": 3, "t": 2000},
    "record": ["error"],
}
RUNS = 60
OTHER = "classify.sw_departure=1e-6"


def sweep(output: Path, config: dict[str, Any] = CONFIG, **options: Any) -> Any:
    return sweeping.sweep(output, config, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("whole") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jobs, "MAX_BLOCK_RUNS", 20)
        patch.setattr(merging, "FILE_BYTES", 1)
        sweep(output)
    return output


@pytest.fixture
def output(whole, tmp_path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "out"))


def change(output: Path, column: str, function: Any) -> Path:
    """Replace a column of a file, with valid checksums; return its path."""
    path = files_of(output)[1]
    table = read_parquet(path)
    place = table.schema.get_field_index(column)
    values = pa.array(
        function(table[column].to_pylist()), table.schema.field(place).type
    )
    changed = table.set_column(place, table.schema.field(place), values)
    rewrite(path, changed, open_stored(output).thresholds.as_text)
    return path


def test_what_is_whole_has_no_problems(whole):
    before = sweeping.tree(whole)
    result = verify(whole, recompute=25, seed=3)
    assert (result.problems, result.runs, result.missing, result.recomputed) == (
        [],
        RUNS,
        0,
        25,
    )
    assert result.words.splitlines()[-1] == "no problem found"
    assert verify(whole, recompute=10**6).recomputed == RUNS
    assert sweeping.tree(whole) == before


@pytest.mark.parametrize(
    ("column", "function", "words"),
    [
        (
            "type",
            lambda v: ["SS"] * len(v),
            "type contradicts the columns it follows from",
        ),
        (
            "type_sure",
            lambda v: [not x for x in v],
            "type_sure contradicts the columns",
        ),
        ("sample", lambda v: [v[1], v[0], *v[2:]], "its rows are not in order"),
    ],
)
def test_columns_that_contradict_each_other(column, function, words, output):
    path = change(output, column, function)
    problems = verify(output).problems
    assert any(text.startswith(str(path)) and words in text for text in problems), (
        problems
    )


@pytest.mark.parametrize(
    ("column", "function", "problem"),
    [
        ("n_end", lambda v: [float("inf"), *v[1:]], "n_end is not finite"),
        ("t_end", lambda v: [0.5 * v[0], *v[1:]], "t_end contradicts t_r or the"),
        ("t_end", lambda v: [2.0 * v[0], *v[1:]], "t_end contradicts t_r or the"),
    ],
)
def test_values_that_no_run_can_have(column, function, problem, output):
    path = change(output, column, function)
    (sentence,) = [text for text in verify(output).problems if column in text]
    sample = read_parquet(path)["sample"][0]
    where = f"{path}: 1 run, such as case 0 sample {sample}"
    assert sentence.startswith(f"{where}: {problem}")


def test_rows_that_are_gone_are_a_problem(output, whole):
    shutil.rmtree(output / "runs")
    (problem,) = verify(output).problems
    assert (
        problem == f"{output / 'runs'} is gone; `rattlesweep run` does its runs again"
    )
    sweep(output)
    check_equal(output, whole)


def test_a_last_bit_is_found_by_computing_again(output):
    change(output, "n_end", lambda v: [float(np.nextafter(x, 9)) for x in v])
    assert verify(output).problems == []
    result = verify(output, recompute=RUNS)
    assert len(result.problems) == 20
    assert "differs when computed again: n_end" in result.problems[0]
    assert f"and {20 - 10} more problems" in result.words


def test_what_is_lost_or_damaged(output, whole):
    first, second, *_ = files_of(output)
    first.unlink()
    result = verify(output)
    (problem,) = result.problems
    assert result.missing == 20
    assert (
        f"{output / 'summary.parquet'} is of all runs, 20 runs of them lost" in problem
    )
    second.write_bytes(second.read_bytes()[:-5])
    assert verify(output).problems == [
        f"{second} is damaged; `rattlesweep run` does its runs again"
    ]
    assert second.exists()  # it only looks
    sweep(output)
    (output / "damaged" / f"{second.name}.damaged").unlink()
    check_equal(output, whole)
    summary = output / "summary.parquet"
    table = read_parquet(summary)
    (counted, *_) = (field for field in table.schema if field.type == pa.int64())
    place = table.schema.get_field_index(counted.name)
    wrong = table.set_column(place, counted, [pa.array([1, 2])])
    for harm in (
        lambda: write_parquet(wrong, summary),
        lambda: summary.write_bytes(b""),
        lambda: summary.unlink(),
    ):
        harm()
        (problem,) = verify(output).problems
        assert problem.startswith(
            f"{summary} is missing, damaged or contradicts the runs"
        )
    sweep(output)
    check_equal(output, whole)


def test_the_body_table_that_is_gone_or_has_changed(tmp_path):
    table = tmp_path / "bodies.csv"
    table.write_text(
        "alpha,beta,gamma,theta,phi,xi\n13.04,1.522,12.28,0.6429,0.036,-0.03\n"
    )
    config = {
        "bodies": {"source": "table", "path": str(table)},
        "spin": CONFIG["spin"],
        "model": "gh",
    }
    sweep(tmp_path / "out", config)
    assert verify(tmp_path / "out", recompute=2).problems == []
    table.write_text(table.read_text().replace("0.6429", "0.65"))
    assert "has changed" in verify(tmp_path / "out", recompute=2).problems[0]
    with pytest.raises(ConfigError, match="the table of bodies has changed"):
        sweep(tmp_path / "out", config)
    table.unlink()  # all the rest can be read
    assert verify(tmp_path / "out").problems == []


WRONG_CASES = [
    {"case": 0, "n_i": [-0.1], "omega_xy0": 0.01},
    {"case": 0, "n_i": {"a": 1}, "omega_xy0": 0.01},
    {"case": [0], "n_i": -0.1, "omega_xy0": 0.01},
    {"case": 0, "n_i": True, "omega_xy0": 0.01},
]


@pytest.mark.parametrize("case", WRONG_CASES)
def test_a_case_of_a_manifest_has_numbers(case, output):
    path = output / "manifest.json"
    data = json.loads(path.read_bytes())
    path.write_text(json.dumps(data | {"cases": [case, data["cases"][1]]}))
    for look in (open_stored, verify, status, sweep):
        with pytest.raises(DamagedError, match=r"manifest\.json is damaged "):
            look(output)


@pytest.mark.parametrize("name", ["manifest.json", "runs/x.parquet"])
def test_what_is_no_file_is_refused_at_once(name, output):
    path = output / name
    path.unlink(missing_ok=True)
    os.mkfifo(path)  # to open it would wait for a writer
    with pytest.raises(OutputError, match="it is not a regular file"):
        verify(output)
    path.unlink()
    path.symlink_to("/dev/zero")  # it never ends
    with pytest.raises(OutputError, match="it is not a regular file"):
        verify(output)


def test_a_file_may_be_too_large(output):
    with open(output / "manifest.json", "ab") as file:
        file.truncate(1 << 40)  # of which the disk holds nothing
    with pytest.raises(
        OutputError, match=r"manifest\.json: it is larger than [\d.]+ MB"
    ):
        status(output)


def test_records_of_sessions_that_are_no_use_are_left_out(output):
    sessions = output / "sessions"
    (path,) = sessions.iterdir()
    data = json.loads(path.read_bytes())
    path.unlink()
    for changes in ({"shard": [1]}, {"seconds": []}, {"started": {}}, {"how": 3}):
        (name,) = changes
        (sessions / f"{name}.json").write_text(json.dumps(data | changes))
        assert status(output).data["last"] is None, changes
    os.mkfifo(sessions / "pipe.json")
    assert status(output).data["last"] is None
    assert rs.load(output).report(output / "report.html")
    assert sweep(output).done == 0


@pytest.mark.parametrize("key", ["samples", "columns", None])
def test_a_manifest_that_is_damaged_is_made_again(key, output, whole):
    path = output / "manifest.json"
    data = json.loads(path.read_bytes())
    path.write_text("" if key is None else json.dumps(data | {key: 0}))
    for look in (open_stored, verify, status, sweep):
        with pytest.raises(
            DamagedError,
            match=r"manifest\.json is damaged .*move it away, and `rattlesweep run`",
        ):
            look(output)
    path.unlink()
    with pytest.raises(
        ConfigError, match=r"is not an output directory: it has no manifest\.json"
    ):
        verify(output)
    assert sweep(output).done == 0
    check_equal(output, whole)


def test_rows_are_counted_and_the_last_session_is_told(output):
    now = status(output)
    assert now.data["runs"] == now.data["wanted"] == now.data["status"]["ok"] == RUNS
    assert now.data["bytes"] == sum(p.stat().st_size for p in files_of(output))
    assert "60 of 60 runs (100.0 %)" in now.words
    assert "no process is at work; the last session, `" in now.words
    assert now.words.endswith("ended: complete")
    shutil.rmtree(output / "sessions")
    assert status(output).data["last"] is None
    files_of(output)[0].write_bytes(b"")
    with pytest.raises(DamagedError):
        status(output)


def test_types_follow_their_thresholds_and_come_back(output, whole):
    before = rows_of(whole)
    result = classify_stored(output, [OTHER])
    after = rows_of(output)
    assert (
        result.changed
        == pc.sum(pc.not_equal(before["type"], after["type"])).as_py()
        > 0
    )
    assert result.files == len(files_of(whole))
    assert result.now["sw_departure"] == 1e-6
    names = [name for name in before.schema.names if name not in ("type", "type_sure")]
    assert same_bits(after.select(names), before.select(names))
    assert verify(output, recompute=RUNS).problems == []
    assert open_stored(output).thresholds.sw_departure == 1e-6
    assert open_stored(output).config.classify.sw_departure == 0.05
    again = classify_stored(output, [OTHER])  # has nothing to write
    assert (again.changed, again.files) == (0, 0)
    sweep(output)  # puts back those of the config
    check_equal(output, whole)


@pytest.mark.parametrize("then", ["run", "classify", "run by others"])
def test_a_killed_classify(then, output, whole):
    """Only the first file has types of other thresholds, as after a kill."""
    left = [*files_of(output)[1:], output / "manifest.json", output / "summary.parquet"]
    files = {path: path.read_bytes() for path in left}
    classify_stored(output, [OTHER])
    for path, data in files.items():
        path.write_bytes(data)
    (problem,) = verify(output).problems[:1]
    assert (
        "typed by other thresholds; run `rattlesweep classify` to type all alike"
        in problem
    )
    with pytest.raises(ConfigError, match="before its shards go on"):
        sweep(output, shard=Shard(0, 2))
    if then == "run":
        assert sweep(output).done == 0
    elif then == "classify":
        classify_stored(output)
    else:
        sweep(output, CONFIG | {"classify": {"sw_departure": 0.5}})
        assert verify(output).problems == []
        assert open_stored(output).thresholds.sw_departure == 0.5
        sweep(output)
    check_equal(output, whole)
