"""Tables and files of rows: files are whole, and what is read is what was written."""

from __future__ import annotations

import os
import random
import shutil
import stat
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from editing import replaced
from random_rows import SCHEMA, random_columns
from sweeping import sweep

from rattlesweep.config.read import parse_config
from rattlesweep.design.cases import Case
from rattlesweep.rows import columns as tables
from rattlesweep.rows.arrow import build_table
from rattlesweep.rows.columns import runs_schema
from rattlesweep.store import rows as stored_module
from rattlesweep.store import summary
from rattlesweep.store.parquet import read_parquet, write_parquet
from rattlesweep.store.rows import Stored, metadata, open_stored, same_bits
from rattlesweep.system.files import replace_file, streamed_file
from rattlesweep.words import quantities as units
from rattlesweep.words.errors import DamagedError, OutputError

CASES = tuple(Case(k, None, None, -0.1 * (k + 1), 0.01) for k in range(5))
CONFIG: dict[str, Any] = {
    "name": "rows",
    "bodies": {"source": "sd", "samples": 30},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
    "model": "gh",
    "horizon": {"t": 1000},
}


def random_rows(cases: int, samples: int) -> pa.Table:
    """Rows of a whole sweep in the order of their keys."""
    case, sample = np.divmod(np.arange(cases * samples), samples)
    return build_table(random_columns(case, sample), SCHEMA)


def scatter(directory: Path, table: pa.Table, files: Any) -> Stored:
    """Write rows to files; ``files`` has the number of the file of each row."""
    config = parse_config(
        {**CONFIG, "model": "full", "record": ["energy", "contact", "windows"]}
    )
    stored = Stored(config, CASES, 400, (), directory, {}, "sweep")
    (directory / "runs").mkdir(parents=True)
    for number in np.unique(files):
        stored.append(table.filter(pa.array(files == number)), "{}")
    return stored


def test_every_column_says_what_it_is() -> None:
    rates = (units.TIME, units.RATE, units.ENERGY, units.FORCE)
    for column in (*runs_schema(tables.RECORD_PARTS), *summary.SCHEMA):
        unit = column.metadata[b"unit"].decode()
        in_si = {"s", "rpm", "N m s", "m", "N s/m", "Hz"}
        assert unit in {
            "1",
            "rad",
            "a",
            "M a^2 sqrt(g/a)",
            "M sqrt(g/a)",
            *rates,
            *in_si,
        }, column.name
        assert len(column.metadata[b"description"]) > 5, column.name


def test_a_file_is_whole_or_not_there(tmp_path, monkeypatch):
    path = tmp_path / "a"

    def refuse() -> None:
        raise PermissionError("a folder")

    replace_file(path, b"one")

    def broken() -> None:
        with streamed_file(path) as file:
            file.write(b"two")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        broken()
    assert path.read_bytes() == b"one"
    assert os.listdir(tmp_path) == ["a"]
    # Windows cannot open a folder.
    honest = os.open
    monkeypatch.setattr(
        os, "open", lambda path, *a: refuse() if path == tmp_path else honest(path, *a)
    )
    replace_file(path, b"three")
    assert path.read_bytes() == b"three"
    with pytest.raises(OutputError, match=r"cannot write .*: No such file"):
        replace_file(tmp_path / "none" / "a", b"")


def test_equal_tables_give_equal_files_that_anybody_may_read(tmp_path):
    table = random_rows(2, 300)
    halves = pa.concat_tables([table.slice(0, 100), table.slice(100)])
    write_parquet(table, tmp_path / "one", {"key": "words"})
    write_parquet(halves, tmp_path / "two", {"key": "words"})
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    assert same_bits(read_parquet(tmp_path / "one"), table)
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE((tmp_path / "one").stat().st_mode) == 0o666 & ~mask


@pytest.mark.parametrize("piece", [50, 10**6])
@pytest.mark.parametrize("files", [1, 7, 90])
def test_rows_come_back_in_order_however_they_lie_in_files(
    files, piece, tmp_path, monkeypatch
):
    monkeypatch.setattr(stored_module, "BATCH_ROWS", piece)
    table = random_rows(5, 400)
    numbers = np.random.default_rng(files).integers(0, files, len(table))
    stored = scatter(tmp_path, table, numbers)
    assert len(stored.files()) == len(np.unique(numbers))
    assert same_bits(stored.read(), table)
    assert same_bits(stored.read(["t_r", "case"]), table.select(["t_r", "case"]))


def test_what_is_there_is_found(tmp_path):
    table = random_rows(5, 400)
    is_done = np.random.default_rng(1).random(len(table)) < 0.3
    rows = table.filter(pa.array(is_done))
    stored = scatter(tmp_path, rows, np.arange(len(rows)) // 100)
    on_disk = stored.find()
    assert np.array_equal(on_disk.done.ravel(), is_done)
    assert on_disk.status["ok"] == on_disk.types.total()
    assert on_disk.types.total() < on_disk.rows == len(rows)
    assert [*on_disk.typed] == ["{}"]
    shutil.rmtree(tmp_path / "runs")
    assert (stored.files(), stored.find().rows) == ([], 0)


@pytest.fixture
def stored(tmp_path: Path) -> Stored:
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
def test_the_runs_of_a_damaged_file_are_to_do(harm, stored):
    path = stored.files()[1]
    harm(path)
    with pytest.raises(DamagedError, match="is damaged"):
        stored.read()
    on_disk = stored.find()
    assert on_disk.damaged == [path]
    assert np.array_equal(np.flatnonzero(~on_disk.done.ravel()), np.arange(700, 1400))


def flip(path: Path, column: str) -> None:
    """Change a bit in the last page of a column."""
    group = pq.read_metadata(path).row_group(0)
    chunk = group.column(
        next(k for k in range(99) if group.column(k).path_in_schema == column)
    )
    data = bytearray(path.read_bytes())
    first = chunk.dictionary_page_offset or chunk.data_page_offset
    data[first + chunk.total_compressed_size - 3] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("count", [60, pytest.param(4000, marks=pytest.mark.slow)])
def test_no_flipped_bit_changes_a_number_or_loses_a_row(count, tmp_path):
    sweep(tmp_path, CONFIG)
    stored = open_stored(tmp_path)
    before = stored.read()
    (path,) = stored.files()
    data = path.read_bytes()
    dice = random.Random(count)
    damaged = 0
    for _ in range(count):
        changed = bytearray(data)
        # Half of them in the second half, where the footer is.
        place = dice.randrange(dice.choice([0, len(data) // 2]), len(data))
        changed[place] ^= 1 << dice.randrange(8)
        path.write_bytes(changed)
        # What is damaged is told apart from what is foreign, so that `run` mends it.
        if stored.find().damaged:
            damaged += 1
        else:
            assert same_bits(stored.read(), before)
    assert damaged > count / 4


@pytest.mark.parametrize(
    "error", [pa.ArrowMemoryError("malloc of size 64 failed"), OSError(5, "I/O error")]
)
def test_out_of_memory_or_unreadable_is_not_damaged(error, stored, monkeypatch):
    def fail(*args: Any, **options: Any) -> None:
        raise error

    monkeypatch.setattr(pq.ParquetFile, "read", fail)
    with pytest.raises((MemoryError, OutputError)) as raised:
        stored.find()
    assert not isinstance(raised.value, DamagedError)


def test_what_is_no_part_of_the_sweep_is_refused(stored):
    before = stored.files()
    some = read_parquet(before[0]).slice(0, 2)
    renumbered = tuple(Case(k, None, None, 0.5, 0.01) for k in range(5))
    for writer, rows, problem in (
        (stored, some, "holds runs that are stored twice; move it away"),
        (replace(stored, hash="another"), some, "holds runs of another sweep"),
        (stored, some.drop_columns("t_r"), "has the columns of another version"),
        (replace(stored, cases=renumbered), some, "numbers its cases differently"),
    ):
        writer.append(rows, "{}")
        (new,) = {*stored.files()} - {*before}
        with pytest.raises(OutputError, match=rf"\.parquet {problem}"):
            stored.find()
        new.unlink()
    for name, value in (("case", -1), ("sample", -1), ("case", 5), ("sample", 400)):
        changed = replaced(some, name, [value] * len(some))
        write_parquet(changed, stored.folder / "zz.parquet", metadata(some))
        with pytest.raises(OutputError, match=r"zz.* beyond 5 cases of 400 samples"):
            stored.find()
        (stored.folder / "zz.parquet").unlink()
    with pytest.raises(OutputError, match=r"holds runs beyond 5 cases of 300 samples"):
        replace(stored, samples=300).find()
    shutil.copy(before[-1], before[-1].with_name("zz.parquet"))
    with pytest.raises(
        OutputError, match=r"zz\.parquet holds runs that are stored twice"
    ):
        stored.find()
