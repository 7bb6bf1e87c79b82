"""The output directory: what is written is whole, readable by all, and equal to what was meant."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rattlesweep.errors import ConfigError, DamagedError, OutputError
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.config.load import parse_config
from rattlesweep.sweeps.config.schema import Classify
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.store import atomic as files
from rattlesweep.sweeps.store import sealed
from rattlesweep.sweeps.store.blockfile import Note
from rattlesweep.sweeps.store.manifest import Manifest, Receipt
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.store.stored import open_stored
from rattlesweep.sweeps.tables.arrow import (
    build_table,
    encode,
    encode_hashed,
    open_sealed,
    ragged,
    same_schema,
)
from rattlesweep.sweeps.tables.columns import (
    ENERGY,
    FORCE,
    RATE,
    RECORD_PARTS,
    TIME,
    runs_schema,
    summary_schema,
)

RECORD = ("energy", "contact", "windows")
SCHEMA = runs_schema(RECORD)
STATUSES = ["ok", "diverged"]
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
    columns["status"] = (status, STATUSES)
    columns["type"] = (np.where(status == 0, rng.integers(0, 4, n), -1), TYPES)
    return columns


def whole(store: Store, index: int, schema: pa.Schema, rows: int) -> bool:
    """Whether a block is undamaged, and has these columns and rows."""
    try:
        found = store.read_block(index)
    except DamagedError:
        return False
    return found.receipt.rows == rows and same_schema(found.schema, schema)


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


def temporaries(directory: Path) -> list[Path]:
    return [p for p in directory.rglob("*") if p.name.endswith(".tmp")]


# --------------------------------------------------------------------------- schemas


def kept(names: str, schema: pa.Schema) -> bool:
    """Whether these columns are there in this order; others may have come."""
    return [name for name in schema.names if name in names.split()] == names.split()


def test_schema_is_the_contract() -> None:
    base = (
        "case sample alpha beta gamma theta phi xi f_sd n_i omega_xy0 psi omega_p omega_r K_p K_r "
        "n_c1 n_0 t_rgh t_end t_r type status n_end n_steps energy_drift amp_growth n_departure "
        "near_tangencies"
    )
    extra = " energy_0 energy_drift_max window_t window_amplitude window_n_min window_n_max"
    assert kept(base, runs_schema())
    assert kept(base + extra, runs_schema(["windows", "energy"]))
    summary = (
        "case K_p K_r n_i omega_xy0 runs fraction_R fraction_SS fraction_SW "
        "fraction_unclassified fraction_bondi t_r_mean t_r_std t_rgh_mean "
        "t_r_over_t_rgh_mean t_r_over_t_rgh_sem failed near_tangencies sensitive unsure "
        "t_r_mean_error"
    )
    assert kept(summary, summary_schema())
    kinds = {f.name: str(f.type) for f in runs_schema()}
    assert {kinds.pop(n) for n in ("case", "near_tangencies")} == {"int32"}
    assert {kinds.pop(n) for n in ("sample", "n_steps")} == {"int64"}
    assert {kinds.pop(n) for n in ("type", "status")} == {"string"}
    assert set(kinds.values()) == {"double"}


def test_every_column_says_what_it_is() -> None:
    for column in (*runs_schema(RECORD_PARTS), *summary_schema()):
        units = {"1", "rad", TIME, RATE, ENERGY, FORCE, "a", "M a^2 sqrt(g/a)"}
        assert column.metadata[b"unit"].decode() in units
        assert len(column.metadata[b"description"]) > 5, column.name


def test_unknown_or_impossible_record_is_an_error() -> None:
    with pytest.raises(ConfigError, match="none of energy, contact, windows"):
        runs_schema(["forces"])
    with pytest.raises(ConfigError, match="reduced"):
        runs_schema(["contact"], model="reduced")


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


# --------------------------------------------------------------------------- arrays to tables


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


def test_nan_where_a_value_must_be(tmp_path: Path) -> None:
    columns = random_columns(np.zeros(3, int), np.arange(3))
    columns["alpha"][1] = np.nan
    with pytest.raises(ValueError, match="internal error: column alpha has 1 rows without"):
        fill(tmp_path, 1000).write_block(1, build_table(columns, SCHEMA))
    assert Store(tmp_path).block_indices() == [0]


def test_equal_data_equal_bytes(tmp_path: Path) -> None:
    one, two = fill(tmp_path / "1", 400), fill(tmp_path / "2", 400)
    assert one.block_path(1).read_bytes() == two.block_path(1).read_bytes()
    whole = one.read_block(1).table()
    one.write_block(1, pa.concat_tables([whole[:7], whole[7:]]))
    assert one.block_path(1).read_bytes() == two.block_path(1).read_bytes()


# --------------------------------------------------------------------------- other readers


def test_pandas_duckdb_and_polars_agree(store: Store) -> None:
    # What a process was still writing is not read by anybody.
    (store.runs / ".block-000007.parquet.0123abcd.tmp").write_bytes(b"half")
    pattern = f"{store.runs}/*.parquet"
    by_pandas = pd.read_parquet(store.runs)
    frames = {
        "duckdb": duckdb.sql(f"select * from '{pattern}' order by \"case\", sample")
        .to_arrow_table()
        .cast(SCHEMA.remove_metadata()),
        "polars": pl.scan_parquet(pattern).collect().to_arrow(),
        "arrow": pa.concat_tables(store.read_block(k).table() for k in store.block_indices()),
    }
    for field in SCHEMA:
        lists = {name: t.column(field.name).to_pylist() for name, t in frames.items()}
        assert lists["duckdb"] == lists["arrow"], field.name
        assert lists["polars"] == lists["arrow"], field.name
        assert by_pandas[field.name].isna().tolist() == [v is None for v in lists["arrow"]]
        if not pa.types.is_list(field.type):
            seen = by_pandas[field.name].dropna().tolist()
            assert seen == [v for v in lists["arrow"] if v is not None]


# --------------------------------------------------------------------------- what may go wrong


def test_what_killed_processes_leave_is_removed(store: Store) -> None:
    names = [".mine.tmp", ".manifest.json.0123abcd.tmp", "runs/.block-000007.parquet.0123abcd.tmp"]
    for name in names:
        (store.directory / name).write_bytes(b"half")
    assert store.remove_stale_temporaries(alone=False) == 0
    assert store.remove_stale_temporaries(alone=True) == 2
    assert [p.name for p in temporaries(store.directory)] == names[:1]


def failing(number: int) -> Callable[..., Any]:
    def fail(*_: Any, **__: Any) -> Any:
        raise OSError(number, os.strerror(number))

    return fail


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EACCES, errno.EIO, errno.EROFS])
@pytest.mark.parametrize("call", ["open", "fsync", "replace"])
def test_writing_fails(
    store: Store, monkeypatch: pytest.MonkeyPatch, call: str, number: int
) -> None:
    before = {p: p.read_bytes() for p in store.directory.rglob("*") if p.is_file()}
    table = store.read_block(0).table()
    with monkeypatch.context() as patch:
        patch.setattr(files.os, call, failing(number))
        for write in (
            lambda: store.write_block(1, table[:5]),
            lambda: store.write_block(7, table),
            lambda: store.write_summary(table),
        ):
            with pytest.raises(OutputError, match=f"cannot write .*: {os.strerror(number)}$"):
                write()
    assert {p: p.read_bytes() for p in store.directory.rglob("*") if p.is_file()} == before


def test_a_disk_that_lies(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """What has not come onto it is noticed before it takes the place of what is there."""
    table = store.read_block(0).table()
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: os.ftruncate(file, os.fstat(file).st_size - 9))
        with pytest.raises(OutputError, match="does not read back"):
            store.write_block(1, table)
    assert not temporaries(store.directory)
    assert whole(store, 1, SCHEMA, 400)


def test_ctrl_c_leaves_nothing(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    table = store.read_block(0).table()
    monkeypatch.setattr(files.os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        store.write_block(1, table)
    assert not temporaries(store.directory)


def test_prepare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path / "a" / "b")
    store.prepare()
    store.prepare()
    assert [p.name for p in store.directory.rglob("*")] == ["runs"]
    in_the_way = tmp_path / "file"
    in_the_way.write_text("")
    for directory in (in_the_way, in_the_way / "below"):
        with pytest.raises(OutputError, match="a file is in the way"):
            Store(directory).prepare()
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "runs").write_text("")
    with pytest.raises(OutputError, match="runs: a file is in the way"):
        Store(tmp_path / "c").prepare()
    monkeypatch.setattr(files.os, "open", failing(errno.EROFS))
    with pytest.raises(OutputError, match="Read-only file system"):
        store.prepare()


# --------------------------------------------------------------------------- whole or not


def test_streaming_notices_damaged_pages(store: Store) -> None:
    path = store.block_path(1)
    chunk = pq.ParquetFile(path).metadata.row_group(0).column(2)
    data = bytearray(path.read_bytes())
    data[chunk.data_page_offset + chunk.total_compressed_size // 2] ^= 4
    path.write_bytes(data)
    with pytest.raises(OutputError, match="block-000001"):
        list(store.iter_batches(["alpha"]))
    assert sum(batch.num_rows for batch in store.iter_batches(["case"])) == 1000


def test_whole_but_not_what_was_asked(store: Store, tmp_path: Path) -> None:
    assert not whole(store, 1, SCHEMA, 401)
    assert not whole(store, 1, runs_schema(), 400)
    assert not whole(store, 8, SCHEMA, 400)
    described = SCHEMA.set(2, SCHEMA.field(2).with_metadata({"unit": "1", "description": "new"}))
    assert whole(store, 1, described, 400)
    foreign = store.read_block(1).table()
    pq.write_table(foreign, store.block_path(1))
    assert not whole(store, 1, SCHEMA, 400)


def test_unreadable_is_not_the_same_as_damaged(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "open", failing(errno.EACCES))
    with pytest.raises(OutputError, match="Permission denied"):
        whole(store, 1, SCHEMA, 400)


def test_seal_of_text_that_looks_like_one() -> None:
    words = ["rattlesweep.sha256\x18\x40" + "0" * 64, "PAR1"]
    table = pa.table({"s": words})
    assert open_sealed(encode(table)).read().column("s").to_pylist() == words


def test_empty_block(tmp_path: Path) -> None:
    store = fill(tmp_path, 10)
    store.write_block(100, store.read_block(0).table()[:0])
    assert whole(store, 100, SCHEMA, 0)
    assert content_hash(tmp_path)


# --------------------------------------------------------------------------- reading in order


def test_blocks_come_in_order_and_foreign_files_do_not(store: Store) -> None:
    (store.runs / "notes.txt").write_text("mine")
    (store.runs / "block-0000.parquet").write_text("mine")
    table = store.read_block(2).table()
    store.write_block(1_000_000, table)  # one digit more than the names were made for
    assert store.block_indices() == [0, 1, 2, 1_000_000]
    batches = list(store.iter_batches(["sample", "case"]))
    assert batches[0].schema.names == ["sample", "case"]
    assert sum(batch.num_rows for batch in batches) == 1200
    with pytest.raises(OutputError, match="no column nonsense"):
        list(store.iter_batches(["nonsense"]))
    assert Store(store.directory / "absent").block_indices() == []


# --------------------------------------------------------------------------- content hash


def test_content_hash_does_not_see_blocks(tmp_path: Path) -> None:
    hashes = {content_hash(fill(tmp_path / str(n), n).directory) for n in (1000, 999, 333, 70)}
    assert len(hashes) == 1


@pytest.mark.parametrize("name", SCHEMA.names[2:])
def test_content_hash_sees_every_bit(store: Store, name: str) -> None:
    table = store.read_block(1).table()
    field, rows = table.schema.field(name), table.column(name).to_pylist()
    spot = next(i for i, value in enumerate(rows) if value)
    last = rows[spot][-1] if isinstance(rows[spot], list) else rows[spot]
    other: Any = float(np.nextafter(last, 1e300)) if isinstance(last, float) else None
    if isinstance(last, str):
        other = "SS" if last != "SS" else "SW"
    elif isinstance(last, int):
        other = last + 1
    changes = [[*rows[spot][:-1], other] if isinstance(rows[spot], list) else other]
    if field.nullable:
        changes.append(None)
    if name == "t_r":
        changes += [0.0, -0.0]
    seen = {content_hash(store.directory)}
    for value in changes:
        column = pa.array([*rows[:spot], value, *rows[spot + 1 :]], field.type)
        store.write_block(1, table.set_column(table.schema.names.index(name), field, column))
        seen.add(content_hash(store.directory))
    assert len(seen) == 1 + len(changes)


def test_content_hash_wants_order_and_one_schema(store: Store) -> None:
    table = store.read_block(2).table()
    store.write_block(3, table[-1:])
    with pytest.raises(OutputError, match="not in the order"):
        content_hash(store.directory)
    store.write_block(3, table.drop_columns(["energy_0"]))
    with pytest.raises(OutputError, match="differ in their columns"):
        content_hash(store.directory)


# --------------------------------------------------------------------------- manifest


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


def test_manifest_missing_or_broken(tmp_path: Path) -> None:
    for directory in (tmp_path, tmp_path / "absent"):
        with pytest.raises(ConfigError, match=r"is not an output directory: it has no manifest"):
            open_stored(directory)
    broken = [b"{", b"[1]", b"\xff\xfe", b"", b"[" * 100_000, sealed.dump({"ok": 1})]
    for text in [*broken, json.dumps({"ok": 1}).encode()]:
        (tmp_path / "manifest.json").write_bytes(text)
        with pytest.raises(OutputError, match=r"manifest\.json is damaged") as caught:
            open_stored(tmp_path)
        assert "\n" not in str(caught.value)
    assert "its checksum does not match" in str(caught.value)
    (tmp_path / "manifest.json").write_bytes(sealed.dump({"format": 1}))
    with pytest.raises(ConfigError, match="it was written in format 1"):
        open_stored(tmp_path)
