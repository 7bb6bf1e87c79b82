"""Tables and files of rows: what is written is whole, and what is read is what was written."""

from __future__ import annotations

import os
import random
import shutil
import stat
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from sweeping import sweep

from rattlesweep.errors import ConfigError, DamagedError, OutputError
from rattlesweep.sweeps import columns as units
from rattlesweep.sweeps import rows as rows_module
from rattlesweep.sweeps.cases import Case
from rattlesweep.sweeps.columns import (
    RECORD_PARTS,
    build_table,
    ragged,
    read_parquet,
    runs_schema,
    summary_schema,
    write_parquet,
)
from rattlesweep.sweeps.files import replace_file, streamed_file
from rattlesweep.sweeps.memory import same_bits
from rattlesweep.sweeps.rows import Found, Runs
from rattlesweep.sweeps.stored import open_stored

SCHEMA = runs_schema(("energy", "contact", "windows"))
CASES = tuple(Case(k, None, None, -0.1 * (k + 1), 0.01) for k in range(5))
CONFIG: dict[str, Any] = {
    "name": "rows",
    "bodies": {"source": "sd", "samples": 30},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
    "model": "gh",
    "horizon": {"t": 1000},
}


def random_columns(case: np.ndarray, sample: np.ndarray, seed: int = 1) -> dict[str, Any]:
    """Columns of every kind, with nulls wherever the schema lets them be."""
    rng = np.random.default_rng(seed)
    n = len(case)
    columns: dict[str, Any] = {"case": case, "sample": sample}
    for field in SCHEMA:
        if field.name in columns:
            continue
        if pa.types.is_floating(field.type):
            values = rng.normal(size=n) * 10.0 ** rng.integers(-8, 8, n)
            if field.nullable:
                values[rng.random(n) < 0.2] = np.nan
                values[rng.random(n) < 0.05] = np.inf
            columns[field.name] = values
        elif pa.types.is_integer(field.type):
            columns[field.name] = rng.integers(0, 3, n)
        elif pa.types.is_list(field.type):
            columns[field.name] = ragged(rng.normal(size=(n, 5)), rng.integers(-1, 6, n))
    status = (rng.random(n) < 0.1).astype(np.int8)
    columns["status"] = (status, ["ok", "diverged"])
    columns["type"] = (np.where(status == 0, rng.integers(0, 2, n), -1), ["R", "SS"])
    return columns


def random_rows(cases: int, samples: int, seed: int = 1) -> pa.Table:
    """Rows of a whole sweep in the order of their keys."""
    case, sample = np.divmod(np.arange(cases * samples), samples)
    return build_table(random_columns(case, sample, seed), SCHEMA)


def scatter(directory: Path, table: pa.Table, parts: Any) -> Runs:
    """Write rows into files; ``parts`` says for each row in which."""
    runs = Runs(directory)
    runs.folder.mkdir(parents=True)
    for part in np.unique(parts):
        runs.append(table.filter(pa.array(parts == part)), "sweep", "{}", CASES)
    return runs


def find(runs: Runs) -> Found:
    return runs.find(CASES, 400, "sweep", SCHEMA)


# -- tables and files ------------------------------------------------------------------------------


def test_every_column_says_what_it_is() -> None:
    rates = (units.TIME, units.RATE, units.ENERGY, units.FORCE)
    for column in (*runs_schema(RECORD_PARTS), *summary_schema()):
        unit = column.metadata[b"unit"].decode()
        assert unit in {"1", "rad", "a", "M a^2 sqrt(g/a)", *rates}, column.name
        assert len(column.metadata[b"description"]) > 5, column.name


def test_what_is_not_finite_becomes_null_and_lists_are_as_long_as_counted() -> None:
    columns = random_columns(np.zeros(50, int), np.arange(50))
    table = build_table(columns, SCHEMA)
    for field in SCHEMA:
        if pa.types.is_floating(field.type):
            null = ~np.isfinite(columns[field.name])
            assert np.array_equal(table[field.name].is_null().to_numpy(), null), field.name
    lists = ragged(np.arange(6.0).reshape(2, 3), np.array([2, -1])).to_pylist()
    assert lists == [[0.0, 1.0], None]


def test_a_file_is_whole_or_not_there(tmp_path):
    path = tmp_path / "a"
    replace_file(path, b"one")

    def broken() -> None:
        with streamed_file(path) as file:
            file.write(b"two")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        broken()
    assert path.read_bytes() == b"one"
    assert os.listdir(tmp_path) == ["a"]
    with pytest.raises(OutputError, match=r"cannot write .*: No such file"):
        replace_file(tmp_path / "none" / "a", b"")


def test_equal_tables_give_equal_files_that_anybody_may_read(tmp_path):
    table = random_rows(2, 300)
    pieces = pa.concat_tables([table.slice(0, 100), table.slice(100)])
    write_parquet(table, tmp_path / "one", {"key": "words"})
    write_parquet(pieces, tmp_path / "two", {"key": "words"})
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    assert same_bits(read_parquet(tmp_path / "one").replace_schema_metadata(None), table)
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE((tmp_path / "one").stat().st_mode) == 0o666 & ~mask


# -- the folder ------------------------------------------------------------------------------------


@pytest.mark.parametrize("piece", [50, 10**6])
@pytest.mark.parametrize("files", [1, 7, 90])
def test_rows_come_back_in_order_however_they_lie_in_files(files, piece, tmp_path, monkeypatch):
    monkeypatch.setattr(rows_module, "PIECE", piece)
    table = random_rows(5, 60)
    parts = np.random.default_rng(files).integers(0, files, len(table))
    runs = scatter(tmp_path, table, parts)
    assert len(runs.files()) == len(np.unique(parts))
    assert same_bits(pa.concat_tables(runs.batches()), table)
    some = pa.concat_tables(runs.batches(["t_r", "case"]))
    assert same_bits(some, table.select(["t_r", "case"]))


def test_pieces_are_bounded_where_files_follow_each_other(tmp_path, monkeypatch):
    monkeypatch.setattr(rows_module, "PIECE", 100)
    runs = scatter(tmp_path, random_rows(5, 400), np.arange(2000) // 40)
    assert max(len(piece) for piece in runs.batches(["case"])) <= 140


def test_what_is_there_is_found(tmp_path):
    assert (Runs(tmp_path).files(), find(Runs(tmp_path)).rows) == ([], 0)
    table = random_rows(5, 400)
    there = np.random.default_rng(1).random(len(table)) < 0.3
    found = find(scatter(tmp_path, table.filter(pa.array(there)), np.arange(there.sum()) // 100))
    assert np.array_equal(found.done.ravel(), there)
    assert found.status["ok"] < found.rows == there.sum()
    assert [*found.typed] == ["{}"]


@pytest.fixture
def runs(tmp_path: Path) -> Runs:
    return scatter(tmp_path / "out", random_rows(5, 400), np.arange(2000) // 700)


@pytest.mark.parametrize(
    "harm",
    [
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(b"no Parquet"),
        lambda path: path.write_bytes(path.read_bytes()[:-9]),
        lambda path: flip(path, "sample"),
        lambda path: flip(path, "t_r"),
    ],
    ids=["empty", "foreign", "cut", "a bit of a key", "a bit of a number"],
)
def test_the_runs_of_a_damaged_file_are_to_do(harm, runs):
    path = runs.files()[1]
    harm(path)
    with pytest.raises(DamagedError, match="is damaged"):
        list(runs.batches())
    found = find(runs)
    assert found.damaged == [path]
    assert np.array_equal(np.flatnonzero(~found.done.ravel()), np.arange(700, 1400))


def flip(path: Path, column: str) -> None:
    """Change a bit in the last page of a column."""
    group = pq.read_metadata(path).row_group(0)
    chunk = group.column(next(k for k in range(99) if group.column(k).path_in_schema == column))
    data = bytearray(path.read_bytes())
    first = chunk.dictionary_page_offset or chunk.data_page_offset
    data[first + chunk.total_compressed_size - 3] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("count", [60, pytest.param(4000, marks=pytest.mark.slow)])
def test_no_flipped_bit_changes_a_number_or_loses_a_row(count, tmp_path):
    sweep(tmp_path, CONFIG)
    stored, before = open_stored(tmp_path), open_stored(tmp_path).read()
    (path,), dice = stored.files(), random.Random(count)
    data, told = path.read_bytes(), 0
    for _ in range(count):
        changed = bytearray(data)
        # Half of them in the footer, which has no checksum.
        place = dice.randrange(dice.choice([0, len(data) // 2]), len(data))
        changed[place] ^= 1 << dice.randrange(8)
        path.write_bytes(changed)
        try:
            args = stored.cases, stored.samples, stored.hash, stored.schema
            if not stored.runs.find(*args).damaged:
                assert same_bits(open_stored(tmp_path).read(), before)
                continue
        except OutputError:
            pass
        told += 1
    assert told > count / 4


@pytest.mark.parametrize(
    "error", [pa.ArrowMemoryError("malloc of size 64 failed"), OSError(5, "I/O error")]
)
def test_out_of_memory_or_unreadable_is_not_damaged(error, runs, monkeypatch):
    def fail(*args: Any, **options: Any) -> None:
        raise error

    monkeypatch.setattr(pq.ParquetFile, "read", fail)
    with pytest.raises((MemoryError, OutputError)) as raised:
        find(runs)
    assert not isinstance(raised.value, DamagedError)


def test_what_is_no_part_of_the_sweep_is_refused(runs):
    first, *_, last = runs.files()
    some = runs.table(first).slice(0, 2)
    more = runs.folder / "zz.parquet"
    other = tuple(Case(k, None, None, 0.5, 0.01) for k in range(5))

    def refused(words: str) -> None:
        (new,) = {*runs.files()} - {*before}
        with pytest.raises(OutputError, match=rf"\.parquet {words}"):
            find(runs)
        new.unlink()

    before = runs.files()
    shutil.copy(last, more)
    refused("holds runs that are there twice; move it away")
    runs.append(some, "sweep", "{}", CASES)
    refused("holds runs that are there twice")
    runs.append(some, "another", "{}", CASES)
    refused("holds runs of another sweep")
    runs.append(some.drop_columns("t_r"), "sweep", "{}", CASES)
    refused("has the columns of another version")
    runs.append(some, "sweep", "{}", other)
    refused("numbers its cases in another way")
    pq.write_table(pa.table({"x": [1]}), more)
    refused("holds runs of another sweep")
    with pytest.raises(OutputError, match=r"holds no runs, or others than of 5 cases of 300 samp"):
        runs.find(CASES, 300, "sweep", SCHEMA)


def test_columns_that_are_not_there(tmp_path):
    sweep(tmp_path, CONFIG)
    assert open_stored(tmp_path).read(["t_r"]).schema.names == ["t_r"]
    with pytest.raises(ConfigError, match="its runs have no column t_R; they have case, sample"):
        open_stored(tmp_path).read(["t_R"])
