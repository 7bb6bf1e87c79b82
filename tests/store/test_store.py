"""Tables, files and the manifest: what is written is whole, and equal to what was meant."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rattlesweep.errors import ConfigError, DamagedError, OutputError
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.config.schema import Classify
from rattlesweep.sweeps.old.content_hash import content_hash
from rattlesweep.sweeps import files
from rattlesweep.sweeps.old import sealed
from rattlesweep.sweeps.old.blockfile import Note
from rattlesweep.sweeps.old.manifest import Manifest, Receipt
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.old.stored import open_stored
from rattlesweep.sweeps import columns as units
from rattlesweep.sweeps.arrow import (
    build_table,
    encode,
    encode_hashed,
    open_sealed,
    ragged,
    same_schema,
)
from rattlesweep.sweeps.columns import RECORD_PARTS, runs_schema, summary_schema

SCHEMA = runs_schema(("energy", "contact", "windows"))
TYPES = ["R", "SS", "SW", "unclassified"]


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
    columns["type"] = (np.where(status == 0, rng.integers(0, 4, n), -1), TYPES)
    return columns


def fill(directory: Path, size: int, rows: int = 1000, cases: int = 3, seed: int = 1) -> Store:
    """Write the same rows in blocks of `size`."""
    store = Store(directory)
    store.prepare()
    case = np.sort(np.random.default_rng(seed).integers(0, cases, rows))
    sample = np.arange(rows) - np.searchsorted(case, case)
    table = build_table(random_columns(case, sample, seed), SCHEMA)
    for index, start in enumerate(range(0, rows, size)):
        store.write_block(index, table[start : start + size])
    return store


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return fill(tmp_path / "out", 400)


def whole(store: Store, index: int, schema: pa.Schema, rows: int) -> bool:
    """Whether a block is undamaged, and has these columns and rows."""
    try:
        found = store.read_block(index)
    except DamagedError:
        return False
    return found.receipt.rows == rows and same_schema(found.schema, schema)


def everything(directory: Path) -> dict[Path, bytes]:
    return {p: p.read_bytes() for p in directory.rglob("*") if p.is_file()}


# -- tables (the net has each column's type, unit and words) ---------------------------------------


def test_every_column_says_what_it_is() -> None:
    rates = (units.TIME, units.RATE, units.ENERGY, units.FORCE)
    for column in (*runs_schema(RECORD_PARTS), *summary_schema()):
        unit = column.metadata[b"unit"].decode()
        assert unit in {"1", "rad", "a", "M a^2 sqrt(g/a)", *rates}, column.name
        assert len(column.metadata[b"description"]) > 5, column.name


def test_unknown_or_impossible_record_is_an_error() -> None:
    with pytest.raises(ConfigError, match="none of energy, contact, windows"):
        runs_schema(["forces"])
    with pytest.raises(ConfigError, match="reduced"):
        runs_schema(["contact"], model="reduced")


SMALL = pa.schema(
    [
        pa.field("k", pa.int32(), nullable=False),
        pa.field("x", pa.float64()),
        pa.field("s", pa.string()),
        pa.field("w", pa.list_(pa.field("element", pa.float64()))),
    ]
)


def test_not_finite_becomes_null() -> None:
    x = np.array([1.0, np.nan, -np.inf, -0.0])
    w = ragged(np.array([[1, np.nan], [3, 4], [5, np.inf], [7, 8.0]]), np.array([2, -1, 2, 0]))
    table = build_table({"k": np.arange(4), "x": x, "s": ["a", None, "b", "a"], "w": w}, SMALL)
    assert table.column("x").to_pylist() == [1.0, None, None, 0.0]
    assert np.signbit(table.column("x")[3].as_py())
    assert table.column("w").to_pylist() == [[1.0, None], None, [5.0, None], []]
    arrow = {"k": pa.array(range(4)), "x": pa.array(x), "w": pa.chunked_array([w[:1], w[1:]])}
    codes = (np.array([0, -1, 1, 0], dtype=np.int8), ["a", "b"])
    assert build_table({**arrow, "s": codes}, SMALL).equals(table)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"k": None}, r"columns \['x', 's', 'w'\] for a schema of \['k', 'x'"),
        ({"z": np.zeros(2)}, r"columns \['k', 'x', 's', 'w', 'z'\] for a schema"),
        ({"k": pa.array([1, None])}, "column k has 1 rows without"),
        ({"k": np.array([1.5, 2.0])}, "truncated"),
        ({"k": np.array([0, 2**40])}, "1099511627776 not in range"),
        ({"x": np.zeros(3)}, "x expected length 2 but got length 3"),
        ({"s": (np.array([0, 7]), ["a"])}, "7"),
    ],
)
def test_wrong_columns_are_internal_errors(change: dict[str, Any], words: str) -> None:
    columns = {"k": np.arange(2), "x": np.zeros(2), "s": ["a", "b"], "w": [[1.0], None], **change}
    columns = {name: values for name, values in columns.items() if values is not None}
    with pytest.raises((ValueError, IndexError), match=words):
        build_table(columns, SMALL)


# -- files -----------------------------------------------------------------------------------------


def test_equal_data_equal_bytes(store: Store) -> None:
    before, table = store.block_path(1).read_bytes(), store.read_block(1).table()
    store.write_block(1, pa.concat_tables([table[:7], table[7:]]))
    assert store.block_path(1).read_bytes() == before


def test_seal_of_text_that_looks_like_one() -> None:
    words = ["rattlesweep.sha256\x18\x40" + "0" * 64, "PAR1"]
    table = pa.table({"s": words})
    assert open_sealed(encode(table)).read().column("s").to_pylist() == words


@pytest.mark.parametrize("call", ["open", "fsync", "replace"])
def test_writing_fails(store: Store, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    """A new block, one in the place of another, a summary; and Ctrl-C in the midst of it."""

    def write(error: BaseException, how: Any, *args: Any) -> pytest.ExceptionInfo[BaseException]:
        def fail(*_: Any, **__: Any) -> Any:
            raise error

        with monkeypatch.context() as patch:
            patch.setattr(files.os, call, fail)
            with pytest.raises((OutputError, KeyboardInterrupt)) as caught:
                how(*args)
        return caught

    before, table = everything(store.directory), store.read_block(0).table()
    for how, *args in (
        (store.write_block, 1, table[:5]),
        (store.write_block, 7, table),
        (store.write_summary, table),
    ):
        caught = write(OSError(errno.EROFS, "Read-only file system"), how, *args)
        assert caught.match("cannot write .*: Read-only file system$")
        assert write(KeyboardInterrupt(), how, *args).type is KeyboardInterrupt
    assert everything(store.directory) == before


def test_a_disk_that_lies(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """What has not come onto it is noticed before it takes the place of what is there."""
    before, table = everything(store.directory), store.read_block(0).table()
    monkeypatch.setattr(os, "fsync", lambda file: os.ftruncate(file, os.fstat(file).st_size - 9))
    with pytest.raises(OutputError, match="does not read back"):
        store.write_block(1, table)
    assert everything(store.directory) == before


def test_whole_but_not_what_was_asked(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    described = SCHEMA.set(2, SCHEMA.field(2).with_metadata({"unit": "1", "description": "new"}))
    assert whole(store, 1, described, 400)
    assert not whole(store, 1, SCHEMA, 401)
    assert not whole(store, 1, runs_schema(), 400)
    assert not whole(store, 8, SCHEMA, 400)
    store.write_block(100, store.read_block(0).table()[:0])
    assert whole(store, 100, SCHEMA, 0)
    pq.write_table(store.read_block(1).table(), store.block_path(1))  # without a seal
    assert not whole(store, 1, SCHEMA, 400)

    def refuse(*_: Any, **__: Any) -> int:
        raise PermissionError(errno.EACCES, "Permission denied")

    # What cannot be read is not damaged for that.
    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(OutputError, match="Permission denied"):
        whole(store, 1, SCHEMA, 400)


def test_blocks_come_in_order_and_foreign_files_do_not(store: Store) -> None:
    (store.runs / "notes.txt").write_text("mine")
    (store.runs / "block-0000.parquet").write_text("mine")
    store.write_block(1_000_000, store.read_block(2).table())  # a digit more than names have
    assert store.block_indices() == [0, 1, 2, 1_000_000]
    batches = list(store.iter_batches(["sample", "case"]))
    assert batches[0].schema.names == ["sample", "case"]
    assert sum(batch.num_rows for batch in batches) == 1200
    with pytest.raises(OutputError, match="no column nonsense"):
        list(store.iter_batches(["nonsense"]))
    assert Store(store.directory / "absent").block_indices() == []
    # A page that is damaged is noticed where it is read.
    path = store.block_path(1)
    chunk = pq.ParquetFile(path).metadata.row_group(0).column(2)
    data = bytearray(path.read_bytes())
    data[chunk.data_page_offset + chunk.total_compressed_size // 2] ^= 4
    path.write_bytes(data)
    with pytest.raises(OutputError, match="block-000001"):
        list(store.iter_batches(["alpha"]))
    assert sum(batch.num_rows for batch in store.iter_batches(["case"])) == 1200


def test_what_killed_processes_leave_is_removed(store: Store) -> None:
    names = [".mine.tmp", ".manifest.json.0123abcd.tmp", "runs/.block-000007.parquet.0123abcd.tmp"]
    for name in names:
        (store.directory / name).write_bytes(b"half")
    assert store.remove_stale_temporaries(alone=False) == 0
    assert store.remove_stale_temporaries(alone=True) == 2
    assert [p.name for p in store.directory.rglob("*.tmp")] == names[:1]


# -- content hash ----------------------------------------------------------------------------------


def changed(value: Any) -> Any:
    """Something of the same type that differs in the last place."""
    if isinstance(value, list):
        return [*value[:-1], changed(value[-1])]
    if isinstance(value, str):
        return "SS" if value != "SS" else "SW"
    return value + 1 if isinstance(value, int) else float(np.nextafter(value, 1e300))


def test_content_hash_sees_every_bit_and_no_blocks(tmp_path: Path) -> None:
    store = fill(tmp_path / "few", 80, rows=200)
    table, before = store.read_block(1).table(), content_hash(store.directory)
    for size in (200, 7):
        assert content_hash(fill(tmp_path / str(size), size, rows=200).directory) == before
    for place, field in [*enumerate(table.schema)][2:]:
        rows = table.column(place).to_pylist()
        spot = next(i for i, value in enumerate(rows) if value)
        values = [changed(rows[spot]), *([None] if field.nullable else [])]
        values += [0.0, -0.0] if field.name == "t_r" else []
        seen = {before}
        for value in values:
            column = pa.array([*rows[:spot], value, *rows[spot + 1 :]], field.type)
            store.write_block(1, table.set_column(place, field, column))
            seen.add(content_hash(store.directory))
        assert len(seen) == 1 + len(values), field.name


def test_content_hash_wants_order_and_one_schema(store: Store) -> None:
    table = store.read_block(2).table()
    for block, words in (
        (table[-1:], "not in the order"),
        (table.drop_columns(["energy_0"]), "differ in their columns"),
    ):
        store.write_block(3, block)
        with pytest.raises(OutputError, match=words):
            content_hash(store.directory)


# -- manifest and notes ----------------------------------------------------------------------------


def test_json_comes_back_to_the_bit() -> None:
    data = {"z": 0.1 + 0.2, "a": {"tol": np.float64(1e-9), "n": 3, "é": None}}
    found = sealed.load(sealed.dump(data))
    assert found == data
    assert list(found) == ["z", "a"]
    with pytest.raises(ValueError, match="JSON compliant"):
        sealed.dump({"x": float("nan")})


def test_a_later_versions_keys_are_kept(tmp_path: Path) -> None:
    plan = make_plan(parse_config({"bodies": {"source": "preset", "name": "GH"},
                                   "spin": {"n_i": -0.1, "omega_xy0": 0.01}}))  # fmt: skip
    manifest = Manifest.begin(plan, "0" * 64, tmp_path)
    manifest.receipts = {k: Receipt(sha256="1" * 64, rows=1, bytes=2) for k in (10, 9)}
    said = manifest.dump() | {"later": {"a": 1}}
    assert list(said["receipts"]) == ["9", "10"]
    assert said["receipts"]["9"] == {"sha256": "1" * 64, "rows": 1, "bytes": 2}
    assert "finished" not in said
    said["receipts"]["9"]["later"] = 2
    again = Manifest.parse(json.loads(json.dumps(said)))
    assert again.dump() == said
    store = Store(tmp_path)
    store.write_manifest(again)
    store.update_manifest(lambda m: setattr(m, "base", None))
    del said["base"]
    assert store.read_manifest().dump() == said


def test_a_threshold_younger_than_a_block_had_its_default(store: Store) -> None:
    note = {"sweep": "x", "first": 0, "stop": 4, "classify": {"ss_growth": 0.5}, "max_steps": 9}
    rows = store.read_block(0).table()

    def loaded(**changes: object) -> Note | None:
        data, _ = encode_hashed(rows, json.dumps(note | changes).encode())
        return Note.load(open_sealed(data))

    found = loaded()
    assert found is not None
    assert found.classify == Classify(ss_growth=0.5).thresholds
    assert loaded(classify=None) is None


def test_manifest_missing_or_broken(tmp_path: Path) -> None:
    for directory in (tmp_path, tmp_path / "absent"):
        with pytest.raises(ConfigError, match=r"is not an output directory: it has no manifest"):
            open_stored(directory)
    unsealed = json.dumps({"ok": 1}).encode()
    for text in (b"\xff", b"", b"[1]", b"[" * 100_000, sealed.dump({"ok": 1}), unsealed):
        (tmp_path / "manifest.json").write_bytes(text)
        with pytest.raises(OutputError, match=r"manifest\.json is damaged: [^\n]*$") as caught:
            open_stored(tmp_path)
    assert "its checksum does not match" in str(caught.value)
    (tmp_path / "manifest.json").write_bytes(sealed.dump({"format": 1}))
    with pytest.raises(ConfigError, match="it was written in format 1"):
        open_stored(tmp_path)
