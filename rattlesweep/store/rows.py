"""An output directory, and the rows in it.

A sweep is a set of runs with keys ``(case, sample)``.  The folder ``runs`` holds
Parquet files. Each contains any set of rows in the order of their keys, none of which
is in another file.  Its metadata name the sweep, the thresholds by which its rows were
typed, and the cases of its rows, so that files can be copied between directories.
A file in the folder ``merging`` stands for the files that its metadata name, until it
has taken their place in ``runs``; see :mod:`rattlesweep.store.merging`.
``manifest.json`` describes the sweep but not its progress, and is written when a sweep
begins or grows.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import Field, field_validator

from rattlesweep.arrays import Flags, Integers
from rattlesweep.config.read import parse_config
from rattlesweep.config.schema import Classify
from rattlesweep.design.cases import MAX_RUNS, Case, Design
from rattlesweep.rows.arrow import floats, same_schema
from rattlesweep.rows.types import TYPES, codes
from rattlesweep.store.checked import Checked, load_checked
from rattlesweep.store.locks import FOLDER
from rattlesweep.store.parquet import read_parquet, write_parquet
from rattlesweep.system.files import (
    check_place,
    explained,
    move,
    read_regular,
    reason,
    replace_file,
)
from rattlesweep.words.errors import (
    ConfigError,
    DamagedError,
    GoneError,
    OutputError,
    TwiceError,
    one_line,
)
from rattlesweep.words.names import REGIMES

MANIFEST = "manifest.json"
SUMMARY = "summary.parquet"
DAMAGED = "damaged"  # folder of the files that were damaged
MERGING = "merging"  # folder of files that are about to replace others
FORMAT = 3
# Metadata of a file of rows: hash of the sweep, thresholds of its types, its cases.
SWEEP = "rattlesweep.sweep"
TYPED = "rattlesweep.classify"
CASES = "rattlesweep.cases"
# Of a file in `merging`: names and checksums of the files that it stands for, as JSON.
REPLACES = "rattlesweep.replaces"
KEY = ("case", "sample")
CODE_MISSING = -1  # code of a run that is not stored
CODE_FAILED = len(TYPES)  # code of a stored run without a type
BATCH_ROWS = 1 << 18  # rows sorted at a time
# Rows, and bytes in memory, that no file of this program has.
_MOST_ROWS = 1 << 22
_MOST_BYTES = 1 << 30
LOOKS = 100  # at files that others replace meanwhile
TWICE = "holds runs that are stored twice"
_T = TypeVar("_T")
IS_DAMAGED = "{} is damaged; `rattlesweep run` does its runs again"


def open_stored(directory: Path | str) -> Stored:
    """Open an output directory; raise a ConfigError if it is none."""
    directory = Path(directory)
    path = directory / MANIFEST
    try:
        return _load(directory, load_checked(Manifest, read_regular(path)))
    except (FileNotFoundError, NotADirectoryError):
        what = "there is no such directory"
        if directory.is_dir():
            what = "it has no manifest.json"
        raise ConfigError(f"{directory} is not an output directory: {what}") from None
    except OSError as error:
        raise OutputError(f"cannot read {path}: {reason(error)}") from error
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        why = one_line(reason(error), 100)
        raise DamagedError(
            f"{path} is damaged or of another version ({why}); move it away, and "
            "`rattlesweep run` with the same config writes a new one"
        ) from error


class Manifest(Checked):
    """Keys of a manifest."""

    format: int
    name: str
    config: dict[str, Any]  # checked as any config is
    config_hash: str
    base: str | None
    cases: list[dict[str, int | float | str]]
    samples: Annotated[int, Field(ge=1, le=MAX_RUNS)]
    # Of a further column: name, type, whether it may be null, unit, meaning.
    columns: list[tuple[str, str, bool, str, str]]
    versions: dict[str, str]
    machine: dict[str, int | str]
    command: list[str]
    started: str
    written: str

    @field_validator("config")
    @classmethod
    def _is_plain(cls, config: dict[str, Any]) -> dict[str, Any]:
        json.dumps(config, allow_nan=False)
        return config


def _load(directory: Path, manifest: dict[str, Any]) -> Stored:
    """Return the sweep that a manifest describes."""
    if manifest["format"] != FORMAT:
        raise ValueError(
            f"its format is {manifest['format']}, and this version reads {FORMAT}"
        )
    extra = []
    for name, kind, nullable, unit, description in manifest["columns"]:
        meaning = {"unit": unit, "description": description}
        extra.append(pa.field(name, pa.type_for_alias(kind), nullable, meaning))
    cases = tuple(map(Case.load, manifest["cases"]))
    if not cases or [case.index for case in cases] != list(range(len(cases))):
        raise ValueError("its cases are not numbered from 0")
    config = manifest["config"]
    if "dissipation" in config:
        # Without the key, the rows are older than creep.
        losses = {"creep": [0], **config["dissipation"]}
        config = {**config, "dissipation": losses}
    stored = Stored(
        config=parse_config(config),
        cases=cases,
        samples=manifest["samples"],
        extra=tuple(extra),
        directory=directory,
        manifest=manifest,
        hash=manifest["config_hash"],
    )
    if stored.runs > MAX_RUNS:
        raise ValueError(f"it has {stored.runs:.3g} runs, more than any sweep")
    if len(set(stored.schema.names)) < len(stored.schema.names):
        raise ValueError("a column is named twice")
    return stored


def _useless(path: Path, fault: str) -> OutputError:
    """Return the error about a file whose rows cannot belong to a sweep."""
    return OutputError(f"{path} {fault}; move it away, or use another output")


def refuse_again(path: Path, rows: pa.Table) -> None:
    """Raise the TwiceError about a file with rows that another one has."""
    raise TwiceError(
        f"{path} {TWICE}; move it away, or let `rattlesweep run` without --shard drop "
        "equal ones"
    )


@dataclass(frozen=True)
class Stored(Design):
    """An output directory."""

    directory: Path
    manifest: dict[str, Any]  # contents of `manifest.json`
    hash: str  # of everything that determines the row of a key

    @property
    def thresholds(self) -> Classify:
        """Thresholds of the types on disk, which `classify` may have changed."""
        return self.steadily(self._thresholds_of)

    def _thresholds_of(self, files: list[Path]) -> Classify:
        for path in files:
            with contextlib.suppress(
                DamagedError, ValueError, TypeError, RecursionError
            ):
                thresholds = json.loads(typed_by(path) or "{}")
                before = self.config.classify.model_dump()
                return Classify.model_validate(before | thresholds)
        return self.config.classify

    @property
    def folder(self) -> Path:
        """Folder of the files of rows."""
        return self.directory / FOLDER

    def write_manifest(self) -> None:
        """Write ``manifest.json``, whole or not at all."""
        text = json.dumps(self.manifest, indent=2, allow_nan=False) + "\n"
        replace_file(self.directory / MANIFEST, text.encode())

    def drop_summary(self) -> None:
        """Remove the summary, if there is one, before the rows change."""
        path = self.directory / SUMMARY
        check_place(path)
        with explained(f"cannot remove {path}"):
            path.unlink(missing_ok=True)

    def files(self) -> list[Path]:
        """Return the files of rows, sorted by name."""
        for _ in range(LOOKS):
            # Each step of a merge changes its folder, so the list is of one moment.
            before = _changed(self.merging)
            with contextlib.suppress(GoneError):
                files = self._list()
                if _changed(self.merging) == before:
                    return files
        raise OutputError(f"the files of {self.folder} are merged without end")

    def _list(self) -> list[Path]:
        merged = _visible(self.merging, ".parquet")
        files = {path.name: path for path in _visible(self.folder, ".parquet")}
        for path in merged:
            with contextlib.suppress(DamagedError):
                for name in replaced_by(path, files):
                    del files[name]
            files.setdefault(path.name, path)
        return [files[name] for name in sorted(files)]

    @property
    def merging(self) -> Path:
        """Folder of files that are about to replace others."""
        return self.directory / MERGING

    def steadily(self, look: Callable[[list[Path]], _T]) -> _T:
        """Return what a function finds in the files, none of which was gone."""
        for _ in range(LOOKS):
            with contextlib.suppress(GoneError):
                return look(self.files())
        return look(self.files())

    def damaged_files(self) -> list[Path]:
        """Return the files that were damaged and have been set aside."""
        return _visible(self.directory / DAMAGED, ".damaged")

    def set_aside(self, paths: Sequence[Path]) -> list[Path]:
        """Move damaged files out of the way of readers; return their new paths.

        A file that turns out to be whole stays, and an OutputError is raised.
        """
        folder = self.directory / DAMAGED
        moved = []
        if paths and self.folder.is_symlink():
            # What looks damaged may be another program's file.
            raise OutputError(
                f"{paths[0]} is damaged, and {self.folder} leads to another folder; "
                "move it away yourself if it is of this sweep"
            )
        check_place(folder)
        for path in paths:
            try:
                read_parquet(path)
            except GoneError:  # another shard has set it aside
                continue
            except DamagedError:
                pass
            else:
                raise OutputError(
                    f"{path} could not be read at first, but is not damaged; run the "
                    "same command again"
                )
            with explained(f"cannot move {path} to {folder}"):
                folder.mkdir(exist_ok=True)
                target = free_path(folder / f"{path.name}.damaged")
                move(path, target)
            moved.append(target)
        return moved

    def new_path(self, table: pa.Table) -> Path:
        """Return the path of a new file of rows, which no other file ever had.

        So whoever still writes or removes a file of before cannot harm a later one.
        """
        case, sample = keys_of(table.slice(0, 1))
        name = f"case{case[0]:05d}-sample{sample[0]:09d}-{secrets.token_hex(6)}.parquet"
        return self.folder / name

    def append(self, table: pa.Table, typed: str) -> Path:
        """Write rows, none of which is on disk, to a new file; return its path."""
        path = self.new_path(table)
        self.write(path, table, typed, new=True)
        return path

    def write(
        self,
        path: Path,
        table: pa.Table,
        typed: str,
        replaces: str | None = None,
        new: bool = False,
    ) -> None:
        """Write rows to a file, in one step."""
        labels = {
            SWEEP: self.hash,
            TYPED: typed,
            CASES: "\n".join(self._cases_of(table)),
        }
        if replaces is not None:
            labels[REPLACES] = replaces
        write_parquet(table, path, labels, self.directory, new)

    def find(
        self,
        files: Iterable[Path] | None = None,
        seen: Callable[[Path, pa.Table], None] = lambda path, rows: None,
        again: Callable[[Path, pa.Table], None] = refuse_again,
    ) -> Found:
        """Read all files, or these; raise an OutputError for rows of no use.

        `seen` is called with each file and its rows, and `again` with the rows of a
        file that an earlier one has, which do not count twice.
        """
        if files is None:
            return self.steadily(self.find)
        found = nothing_found(self)
        for path in files:
            try:
                rows = read_parquet(path, check=partial(self._check_footer, path))
            except DamagedError:
                found.damaged.append(path)
                continue
            fault = self._fault(rows)
            if fault is not None:
                raise _useless(path, fault)
            is_new = found.code[keys_of(rows)] == CODE_MISSING
            added = rows
            if not is_new.all():
                again(path, rows.filter(~is_new))
                added = rows.filter(is_new)
            found.add(added)
            found.typed.setdefault(metadata(rows).get(TYPED, ""), []).append(path)
            seen(path, rows)
        return found

    def _check_footer(
        self, path: Path, schema: pa.Schema, footer: pq.FileMetaData
    ) -> None:
        """Raise an OutputError for a file of no use, before its rows take memory."""
        rows = footer.num_rows
        groups = map(footer.row_group, range(footer.num_row_groups))
        size = sum(group.total_byte_size for group in groups)
        most = min(self.runs, _MOST_ROWS)
        fault = None
        if labels_of(schema).get(SWEEP) != self.hash:
            fault = "holds runs of another sweep"
        elif not same_schema(schema, self.schema):
            fault = "has the columns of another version of rattlesweep"
        elif not rows:
            fault = "holds no runs"
        elif rows > most:
            fault = f"holds {rows:,} runs, more than the {most:,} that are possible"
        elif size > _MOST_BYTES:
            fault = f"would take {size / 1e9:.1f} GB of memory"
        if fault is not None:
            raise _useless(path, fault)

    def _fault(self, rows: pa.Table) -> str | None:
        """Return why the rows of a file cannot be added to those of others."""
        labels = metadata(rows)
        if self._is_beyond(rows):
            return f"holds runs beyond {self._size}"
        if not set(self._cases_of(rows)) <= {*labels.get(CASES, "").split("\n")}:
            return "numbers its cases differently"
        if len(np.unique(_order(rows))) < len(rows):
            return TWICE
        return None

    @property
    def _size(self) -> str:
        return f"{len(self.cases)} cases of {self.samples} samples"

    def _is_beyond(self, rows: pa.Table) -> bool:
        """Return whether a key is none of this sweep."""
        case, sample = keys_of(rows)
        # A negative key would count from the end.
        is_inside = (case >= 0) & (case < len(self.cases))
        is_inside &= (sample >= 0) & (sample < self.samples)
        return not is_inside.all()

    def rows_of(self, path: Path, names: Sequence[str] | None = None) -> pa.Table:
        """Return the rows of a file; raise an OutputError for those of no use.

        `names` are the columns to read, the keys among them.
        """
        rows = read_parquet(path, names)
        read = rows.schema.names
        fault = None
        if sorted(read) != sorted(names or self.schema.names):
            fault = "lacks columns, or has further ones"
        elif not rows.schema.equals(pa.schema([self.schema.field(n) for n in read])):
            fault = "has columns of other types than its sweep"
        elif not len(rows):
            fault = "holds no runs"
        elif self._is_beyond(rows):
            fault = f"holds runs beyond {self._size}"
        elif "t_r" in read and (floats(rows["t_r"]) < 0).any():
            fault = "holds negative reversal times"
        if fault is not None:
            raise OutputError(f"{path} {fault}; move it away, and repeat its runs")
        return rows

    def _cases_of(self, rows: pa.Table) -> list[str]:
        """Return the cases of rows as they are in the metadata of a file."""
        numbers = pc.unique(rows["case"]).to_pylist()
        return [json.dumps(self.cases[number].dump()) for number in numbers]

    def count(self) -> int:
        """Return the number of rows on disk."""

        def total(files: list[Path]) -> int:
            return sum(len(self.rows_of(path, KEY)) for path in files)

        return self.steadily(total)

    def read(self, names: Sequence[str] | None = None) -> pa.Table:
        """Return all rows, or some of their columns, in the order of their keys."""
        chosen = self.schema.names if names is None else names
        schema = pa.schema([self.schema.field(name) for name in chosen])
        batches = self.batches(chosen)
        return pa.Table.from_batches(batches, schema.remove_metadata()).cast(schema)

    def batches(self, names: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Yield the same rows in the same order, in pieces that fit into memory.

        Rows that are written meanwhile may be left out.
        """
        names = self.schema.names if names is None else list(names)
        last = -1  # key of the last row, after which reading goes on
        for _ in range(LOOKS):
            try:
                for rows in self._pieces(names, last):
                    last = _order(rows.slice(len(rows) - 1))[0]
                    yield from rows.select(names).to_batches()
                return
            except GoneError:  # the files have been merged
                continue
        raise OutputError(f"the files of {self.folder} are merged without end")

    def _pieces(self, names: Sequence[str], last: int) -> Iterator[pa.Table]:
        """Yield the rows after the one with the key `last`, in order."""
        needed = list(dict.fromkeys([*names, *KEY]))
        first = {
            path: int(_order(self.rows_of(path, KEY)).min()) for path in self.files()
        }
        paths = sorted(first, key=first.__getitem__)
        held: list[pa.Table] = []  # rows that later files may have rows between
        for path, following in zip_longest(paths, paths[1:]):
            rows = in_order(self.rows_of(path, needed)).replace_schema_metadata(None)
            # Rows may have been added to the file before its first one.
            begin = max(first[path], last + 1)
            held.append(rows.slice(int(np.searchsorted(_order(rows), begin))))
            if following is not None and sum(map(len, held)) < BATCH_ROWS:
                continue
            table = in_order(pa.concat_tables(held))
            ready = len(table)
            if following is not None:
                # No later file has rows before the first row of the next file.
                ready = int(np.searchsorted(_order(table), first[following]))
            held = [table.slice(ready)]
            if ready:
                yield table.slice(0, ready)


def _changed(folder: Path) -> int:
    """Return when names in a folder changed; 0 if there is none."""
    try:
        return os.stat(folder).st_mtime_ns
    except OSError:
        return 0


def checksum(path: Path) -> int:
    """Return a checksum of a file."""
    try:
        return zlib.crc32(path.read_bytes())
    except FileNotFoundError:
        raise GoneError(f"{path} is gone") from None
    except OSError as error:
        raise OutputError(f"cannot read {path}: {reason(error)}") from error


def replaced_by(merged: Path, files: Mapping[str, Path]) -> list[str]:
    """Return which files, by name, a file in `merging` stands for."""
    labels = metadata(read_parquet(merged, []))
    try:
        replaces = {**json.loads(labels[REPLACES])}
    except (KeyError, TypeError, ValueError) as error:
        raise DamagedError(f"{merged} does not name the files it replaces") from error
    names = replaces.keys() & files.keys()
    # Names are used again, contents are not.
    return [name for name in names if checksum(files[name]) == replaces[name]]


def nothing_found(design: Design) -> Found:
    """Return the record of an empty directory."""
    return Found(design.shape, design.config.deciding_column)


def _visible(folder: Path, suffix: str) -> list[Path]:
    """Return the files of a folder with a suffix, sorted; none if it is missing."""
    paths: list[Path] = []
    with explained(f"cannot read {folder}"), contextlib.suppress(FileNotFoundError):
        paths = sorted(folder.iterdir())
    return [
        path
        for path in paths
        if path.suffix == suffix and not path.name.startswith(".")
    ]


class Found:
    """What the files of a directory contain, and the rows that a session adds."""

    def __init__(self, shape: tuple[int, int], column: str | None = None) -> None:
        # Of each run, its index in TYPES, or CODE_FAILED or CODE_MISSING.
        self.code = np.full(shape, CODE_MISSING, np.int8)
        # Of each run, the value of the column that decides what runs are wanted; of
        # `regime`, its index.
        self.value = np.full(shape if column else (0, 0), np.nan)
        self.column = column
        self.status: Counter[str] = Counter()  # runs by status
        self.typed: dict[str, list[Path]] = {}  # files by thresholds, as JSON
        self.damaged: list[Path] = []

    @property
    def done(self) -> Flags:
        """Runs that are stored; shape (cases, samples)."""
        return self.code != CODE_MISSING

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.status.total()

    @property
    def types(self) -> Counter[str]:
        """Runs by type."""
        counts = ((name, int((self.code == k).sum())) for k, name in enumerate(TYPES))
        return Counter({name: count for name, count in counts if count})

    def add(self, rows: pa.Table) -> None:
        """Add rows."""
        keys = keys_of(rows)
        kind = codes(rows.column("type"))
        self.code[keys] = np.where(kind < 0, CODE_FAILED, kind)
        if self.column in rows.schema.names:
            column = rows.column(self.column)
            if pa.types.is_string(column.type):
                self.value[keys] = codes(column, REGIMES)
            else:
                self.value[keys] = floats(column)
        for entry in rows.column("status").value_counts().to_pylist():
            self.status[entry["values"]] += entry["counts"]


def rewrite(path: Path, rows: pa.Table, typed: str) -> None:
    """Replace the rows of a file by others with its metadata, or by none at all."""
    if len(rows):
        labels = metadata(rows) | {TYPED: typed}
        write_parquet(rows, path, labels, path.parent.parent)
    else:
        check_place(path)
        with explained(f"cannot remove {path}"):
            path.unlink()


def typed_by(path: Path) -> str:
    """Return the thresholds, as JSON, by which the rows of a file were typed."""
    return metadata(read_parquet(path, [])).get(TYPED, "")


def metadata(rows: pa.Table) -> dict[str, str]:
    """Return the metadata of the file that rows were read from."""
    return labels_of(rows.schema)


def labels_of(schema: pa.Schema) -> dict[str, str]:
    """Return the metadata of a schema as text."""
    labels = {}
    for name, value in (schema.metadata or {}).items():
        labels[name.decode(errors="replace")] = value.decode(errors="replace")
    return labels


def keys_of(rows: pa.Table) -> tuple[Integers, Integers]:
    """Return case and sample of each row."""
    case, sample = (rows.column(name).to_numpy().astype(np.int64) for name in KEY)
    return case, sample


def in_order(rows: pa.Table) -> pa.Table:
    """Return rows in the order of their keys."""
    order = _order(rows)
    if (np.diff(order) < 0).any():
        return rows.take(np.argsort(order))
    return rows


def _order(rows: pa.Table) -> Integers:
    """Return numbers in the order of the keys."""
    case, sample = keys_of(rows)
    return (case << 32) + sample  # there are fewer than 2^32 samples


def free_path(path: Path) -> Path:
    """Return the path, with a number appended to its stem if a file has it."""
    free = path
    again = 1
    while free.exists():
        again += 1
        free = path.with_stem(f"{path.stem}-{again}")
    return free


def same_bits(first: pa.Table, second: pa.Table) -> bool:
    """Return whether two tables have the same values, and zeros of the same sign."""
    if first.schema.names != second.schema.names:
        return False
    for column, twin in zip(first.columns, second.columns, strict=True):
        if not column.equals(twin) or not _bits(column).equals(_bits(twin)):
            return False
    return True


def _bits(column: pa.ChunkedArray) -> pa.Array:
    """Return floats, or the floats in lists, as integers: 0.0 and -0.0 then differ.

    Other columns stay as they are.
    """
    values = column.combine_chunks()
    if pa.types.is_list(values.type):
        values = values.flatten()
    if pa.types.is_float64(values.type):
        return values.view(pa.int64())
    return values
