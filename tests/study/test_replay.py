"""Stored runs again: found by number or condition, equal bit for bit, followed past reversals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pyarrow.compute as pc
import pyarrow.csv as pcsv
import pyarrow.parquet as pq
import pytest
from test_run import handlers, invoke, rows, run

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.study.onerun.course import Course
from rattlesweep.study.onerun.replay import Replay, StoredRun, targets
from rattlesweep.study.onerun.rows import Rows
from rattlesweep.study.where import parse_condition
from rattlesweep.sweeps.store.provenance import read_manifest
from rattlesweep.sweeps.store.receipts import Note
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.tables.columns import runs_schema

__all__ = ["handlers"]


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small sweep with runs that reverse and runs that do not."""
    output = tmp_path_factory.mktemp("replay") / "out"
    result = run(
        "quickstart.yaml", output, "bodies.samples=8", "block_size=5", "record=[windows]",
        "bodies.target={K_r: [0.05], rel_tol: 0.1}", "spin.n_i=[-0.1, -0.5]",
    )  # fmt: skip
    assert result.exit_code == 0
    return output


def bits(value: float) -> bytes:
    return np.float64(value).tobytes()


def test_every_run_is_the_stored_one_bit_for_bit(sweep: Path):
    source, table = Replay(sweep), rows(sweep)
    assert 2 <= table["t_r"].notna().sum() < len(table)
    for stored in table.itertuples():
        one = source.find(stored.case, stored.sample)
        source.prove(one)
        course = Course(source.prepare(one), rows=Rows(steps=True))
        last = list(course)[-1]
        one.check(course)
        assert course.status.label == stored.status
        if np.isnan(stored.t_r):
            assert course.zeros == []
            assert bits(course.t) == bits(stored.t_end)
            assert bits(last["n"][-1]) == bits(stored.n_end)
            assert course.n_steps == stored.n_steps
        else:
            assert bits(course.zeros[0]) == bits(stored.t_r)
            assert course.t > stored.t_end


def test_a_run_can_be_followed_beyond_the_horizon_or_less_far(sweep: Path):
    source = Replay(sweep)
    one = source.where("type = 'R'", 1)[0]
    horizon = Course(source.prepare(one)).t_end
    far = Course(source.prepare(one, 2 * horizon), rows=Rows(2))
    near = Course(source.prepare(one, 0.5 * one.t_end), rows=Rows(2))
    assert (len(list(far)), len(list(near))) == (1, 1)
    assert one.t_r is not None
    assert bits(far.zeros[0]) == bits(one.t_r)
    assert near.zeros == []
    one.check(far)
    one.check(near)
    with pytest.raises(OutputError, match="reverses at"):
        replace(one, t_r=np.nextafter(one.t_r, 0)).check(far)


def test_command_prints_the_series_and_says_what_is_proved(sweep: Path):
    one = Replay(sweep).where("t_r is not null", 1)[0]
    result = invoke("replay", sweep, "--case", one.case, "--sample", one.sample, "--points", 5)
    assert result.exit_code == 0
    assert len(result.stdout.splitlines()) == 6
    said = f"case {one.case}, sample {one.sample}: t_r {one.t_r!r} and type R as stored"
    assert result.stderr.startswith(f"{said}, bit for bit\n")


def test_several_runs_go_to_files_named_by_run(sweep: Path, tmp_path: Path):
    wanted = rows(sweep).query("n_i == -0.5").iloc[:3]
    result = invoke(
        "replay", sweep, "--where", "n_i = -0.5", "--first", 3, "--points", 4,
        "--output", tmp_path / "run-{case}-{sample}.parquet", "--figure",
        tmp_path / "{sample}.svg", "--channels", "t,n,E_r", "-q",
    )  # fmt: skip
    assert (result.exit_code, result.output) == (0, "")
    names = [f"run-{r.case}-{r.sample}.parquet" for r in wanted.itertuples()]
    drawn = [f"{r.sample}.svg" for r in wanted.itertuples()]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names + drawn)
    first = pq.read_table(tmp_path / names[0]).to_pandas()
    assert list(first.columns) == ["t", "n", "E_r"]
    assert first["n"][0] == pytest.approx(-0.5, rel=1e-12)


# -- conditions ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "type = 'R' or type = 'SS'",
        "t_r > 0 and not K_r < 0.05",
        "not (t_r > 0) or sample = 2",
        "t_r is null or n_end <> n_i",
        "t_r IS NOT NULL AND sample IN (1, 3, 5)",
        "sample not in (0, 2) and case = 1",
        "not (t_r not in (1, 2)) or sample = 5",
        "n_i < -.3 and (sample >= 6 or sample <= 1)",
        "t_end = t_r",
        "t_r < t_rgh or n_c1 is null",
        "sample != 3 and sample != 4.0",
        "K_r > 4.9e-2 and -0.1 = n_i",
        "type in ('R') and status = 'ok'",
        "type != 'it''s'",
    ],
)
def test_conditions_mean_what_sql_means(sweep: Path, text: str):
    found = [(r.case, r.sample) for r in Replay(sweep).where(text, 1000)]
    query = f"SELECT \"case\", sample FROM '{sweep}/runs/*.parquet' WHERE "
    sql = text.replace("case = 1", '"case" = 1')
    wanted = duckdb.sql(f"{query} {sql} ORDER BY ALL").fetchall()
    assert found == wanted
    assert found


def test_two_equal_signs_and_double_quotes_are_equal_too(sweep: Path):
    source = Replay(sweep)
    assert source.where('type == "R"', 99) == source.where("type='R'", 99)
    assert len(source.where("type='R'", 2)) == 2


def test_the_columns_that_are_read_are_those_asked_for():
    found = parse_condition("K_r<1 and (type='R' or K_r>2)", runs_schema((), "full"))
    assert found.columns == ("K_r", "type")
    assert str(found.expression) == str(
        (pc.field("K_r") < 1) & ((pc.field("type") == "R") | (pc.field("K_r") > 2))
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("typ = 'R'", "typ is no column; did you mean type?"),
        ("k_R < 1", "did you mean K_r?"),
        ("type > 'R'", "words are = or !=, not >"),
        ("type = 3", "3 is a number and type a word"),
        ("K_r < 'R'", "K_r is a number and 'R' a word"),
        ("K_r in (1, 'R')", "cannot be compared"),
        ("K_r <", "ends where"),
        ("K_r", "is needed after K_r, not the end"),
        ("(K_r < 1", ") is needed to close the bracket"),
        ("K_r < 1)", "and or or is needed before )"),
        ("K_r < 1 K_p > 2", "and or or is needed before K_p"),
        ("K_r < 0.1x", "cannot read '0.1x'"),
        ("type = 'R", "cannot read"),
        ("K_r in 1", "( is needed after in"),
        ("K_r in ()", "is needed, not )"),
        ("K_r in (1, 2", ") is needed to end the list"),
        ("t_r is 3", "null is needed after is"),
        ("t_r not null", "in is needed after t_r"),
        ("and", "is needed, not and"),
        ("window_n_min > 0", "several numbers a run"),
        ("__import__ = 'os'", "__import__ is no column"),
        ("(" * 2000 + "K_r < 1" + ")" * 2000, "more than 50 brackets deep"),
        ("not " * 2000 + "K_r < 1", "more than 50 brackets deep"),
        ("K_r < 0", "no stored run"),
    ],
    ids=lambda text: text[:20],
)
def test_wrong_conditions_say_so_in_one_line(sweep: Path, text: str, words: str):
    result = invoke("replay", sweep, "--where", text)
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in result.stderr
    assert result.stderr.startswith("error: --where")
    assert result.stderr.count("\n") == 1


# -- what is not there, or not as it was ---------------------------------------------------------


@pytest.mark.parametrize(
    ("args", "words", "code"),
    [
        (["--case", 9, "--sample", 0], "has the cases 0 to 1", 2),
        (["--case", 0, "--sample", 8], "has the samples 0 to 7", 2),
        (["--case", -1, "--sample", 0], "has the cases 0 to 1", 2),
        (["--case", 0], "which run?", 2),
        (["--case", 0, "--sample", 1, "--where", "K_r<1"], "keep one way", 2),
        (["--case", 0, "--sample", 1, "--first", 2], "--first goes with --where", 2),
        (["--where", "K_r<1", "--first", 2], "2 runs do not go into one table", 2),
        (["--where", "K_r<1", "--first", 2, "--output", "a.csv"], "would be written there", 2),
        (["--case", 0, "--sample", 1, "--channels", "t,omga_x"], "omega_x is the nearest", 2),
        (["--case", 0, "--sample", 1, "--output", "a.xlsx"], ".parquet or .csv", 2),
        (["--case", 0, "--sample", 1, "--output", "/proc/no/a.csv"], "cannot write in", 1),
        (["--case", 0, "--sample", 1, "--t-end", "nan"], "finite, positive time", 2),
    ],
    ids=str,
)
def test_wrong_commands_say_so_in_one_line(
    sweep: Path, tmp_path: Path, monkeypatch: Any, args: list[Any], words: str, code: int
):
    monkeypatch.chdir(tmp_path)
    result = invoke("replay", sweep, *args)
    assert (result.exit_code, result.stdout) == (code, "")
    assert words in result.stderr
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_directory_that_is_no_sweep(tmp_path: Path):
    result = invoke("replay", tmp_path, "--case", 0, "--sample", 0)
    assert (result.exit_code, result.stdout) == (2, "")
    assert "is not an output directory" in result.stderr


def test_a_stored_number_that_is_not_what_comes_out_is_told(sweep: Path, tmp_path: Path):
    output = tmp_path / "out"
    (output / "runs").mkdir(parents=True)
    for path in sweep.rglob("*"):
        if path.is_file():
            (output / path.relative_to(sweep)).write_bytes(path.read_bytes())
    store = Store(output)
    one = Replay(output).where("type = 'R'", 1)[0]
    index, row = divmod(one.case * 8 + one.sample, 5)
    table, note = store.read_block(index), store.inspect_block(index).note
    assert isinstance(note, Note)
    t_r = table["t_r"].to_pylist()
    t_r[row] = float(np.nextafter(t_r[row], np.inf))
    place = table.schema.get_field_index("t_r")
    store.rewrite_block(index, table.set_column(place, table.schema.field("t_r"), [t_r]), note)
    result = invoke("replay", output, "--case", one.case, "--sample", one.sample)
    assert (result.exit_code, result.stdout) == (1, "")
    assert f"case {one.case}, sample {one.sample} comes out otherwise" in result.stderr
    assert "than stored, in t_r;" in result.stderr
    store.block_path(index).unlink()
    result = invoke("replay", output, "--case", one.case, "--sample", one.sample)
    assert result.exit_code == 1
    assert "is not stored yet" in result.stderr
    assert read_manifest(store)["runs"] == 16


def test_other_models_are_replayed_too(tmp_path: Path):
    for model in ("reduced", "gh"):
        output = tmp_path / model
        result = run("gh.yaml", output, f"model={model}", "spin.n_i=[0.1]", "record=[]")
        assert result.exit_code == 0
        t_r = float(rows(output)["t_r"].iloc[0])
        result = invoke("replay", output, "--case", 0, "--sample", 0, "--points", 3,
                        "--output", tmp_path / f"{model}.csv")  # fmt: skip
        assert result.exit_code == 0
        assert f"t_r {t_r!r} and type R" in result.stderr
        assert pcsv.read_csv(tmp_path / f"{model}.csv").num_rows == 3


def test_names_of_files(tmp_path: Path):
    two = [StoredRun(0, k, None, 1.0, "SS", "ok", 0.1, 5) for k in (1, 2)]
    assert targets(None, two, "--figure") == [None, None]
    assert targets("{case}/{sample}.csv", two, "--output") == [Path("0/1.csv"), Path("0/2.csv")]
    with pytest.raises(ConfigError, match="2 runs would be written there"):
        targets("{case}.csv", two, "--output")
