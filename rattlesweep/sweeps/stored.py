"""An output directory: the manifest of a sweep, and its rows.

A sweep is a set of runs with keys ``(case, sample)``.  The folder ``runs`` holds
Parquet files. Each contains any set of rows in the order of their keys, none of which
is in another file.  Its metadata name the sweep, the thresholds by which its rows were
typed, and the cases of its rows, so that files can be copied between directories.
``manifest.json`` describes the sweep but not its progress, and is written when a sweep
begins or grows.
"""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, count, zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.arrays import Flags, Integers
from rattlesweep.errors import ConfigError, DamagedError, OutputError
from rattlesweep.sweeps.columns import (
    floats,
    read_parquet,
    runs_schema,
    same_schema,
    write_parquet,
)
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.config.schema import Classify, Config
from rattlesweep.sweeps.files import explained, reason, replace_file
from rattlesweep.sweeps.types import TYPES, codes
from rattlesweep.units import Quantity

MANIFEST, SUMMARY, FOLDER = "manifest.json", "summary.parquet", "runs"
FORMAT = 3
# Metadata of a file of rows: hash of the sweep, thresholds of the types, cases of the
# rows.
SWEEP, TYPED, CASES = "rattlesweep.sweep", "rattlesweep.classify", "rattlesweep.cases"
KEY = ("case", "sample")
MISSING, FAILED = (
    -1,
    len(TYPES),
)  # codes of runs that are not stored, and of those without a type
BATCH_ROWS = 1_000_000  # rows sorted at a time
VARIES = {
    "n_i": "spin",
    "omega_xy0": "spin",
    "sigma": "torque per spin",
    "rolling": "length",
}


def open_stored(directory: Path | str) -> Stored:
    """Open an output directory; raise a ConfigError if it is none."""
    path = (directory := Path(directory)) / MANIFEST
    try:
        data = json.loads(path.read_bytes())
        if data["format"] != FORMAT:
            raise ValueError(
                f"its format is {data['format']}, and this version reads {FORMAT}"
            )
        extra = tuple(
            pa.field(
                name,
                pa.type_for_alias(kind),
                nullable,
                {"unit": unit, "description": words},
            )
            for name, kind, nullable, unit, words in data["columns"]
        )
        cases, samples = tuple(map(Case.load, data["cases"])), int(data["samples"])
        if [case.index for case in cases] != list(range(len(cases))) or samples < 1:
            raise ValueError("its cases are not numbered from 0, or have no samples")
        config, key = parse_config(data["config"]), str(data["config_hash"])
        return Stored(config, cases, samples, extra, directory, data, key)
    except (FileNotFoundError, NotADirectoryError):
        what = (
            "it has no manifest.json"
            if directory.is_dir()
            else "there is no such directory"
        )
        raise ConfigError(f"{directory} is not an output directory: {what}") from None
    except OSError as error:
        raise OutputError(f"cannot read {path}: {reason(error)}") from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise DamagedError(
            f"{path} is damaged or of another version ({reason(error)[:100]}); move it away, and "
            "`rattlesweep run` with the same config writes a new one"
        ) from error


@dataclass(frozen=True)
class Design:
    """The runs of a sweep: a number of samples of each case."""

    config: Config  # with all defaults filled in
    cases: tuple[
        Case, ...
    ]  # in a directory that has grown, not in the order of the config
    samples: int  # of each case
    extra: tuple[
        pa.Field, ...
    ]  # columns that bodies and launches add to the usual ones

    @cached_property
    def schema(self) -> pa.Schema:
        """Arrow schema of the runs, with `unit` and `description` in each field's
        metadata.
        """
        return runs_schema(self.config.parts, self.config.model, self.extra)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cases, and of samples of each."""
        return len(self.cases), self.samples

    @property
    def runs(self) -> int:
        """Number of runs, if none is left out."""
        return len(self.cases) * self.samples

    def nothing_found(self) -> Found:
        """Return the record of an empty directory."""
        return Found(self.shape, self.config.deciding_column)


@dataclass(frozen=True)
class Stored(Design):
    """An output directory."""

    directory: Path
    manifest: dict[str, Any]  # contents of `manifest.json`
    hash: str  # of everything that determines the row of a key

    @property
    def thresholds(self) -> Classify:
        """Thresholds of the types on disk, which ``rattlesweep classify`` may have
        changed.
        """
        for path in self.files():
            with contextlib.suppress(DamagedError, ValueError):
                return self.config.classify.model_copy(
                    update=json.loads(typed_by(path) or "{}")
                )
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
        with explained(f"cannot remove {path}"):
            path.unlink(missing_ok=True)

    def files(self) -> list[Path]:
        """Return the files of rows, sorted by name."""
        with (
            explained(f"cannot read {self.folder}"),
            contextlib.suppress(FileNotFoundError),
        ):
            paths = sorted(self.folder.iterdir())
            return [
                p
                for p in paths
                if p.suffix == ".parquet" and not p.name.startswith(".")
            ]
        return []

    def append(self, table: pa.Table, typed: str) -> None:
        """Write rows, none of which is on disk, to a new file."""
        case, sample = keys_of(table.slice(0, 1))
        name = f"case{case[0]:05d}-sample{sample[0]:09d}.parquet"
        words = {
            SWEEP: self.hash,
            TYPED: typed,
            CASES: "\n".join(self._cases_of(table)),
        }
        write_parquet(table, free_path(self.folder / name), words)

    def find(self, files: Iterable[Path] | None = None) -> Found:
        """Read all files, or these; raise an OutputError for rows that are no part of
        the sweep.
        """
        found = self.nothing_found()
        for path in self.files() if files is None else files:
            try:
                rows = read_parquet(path)
            except DamagedError:
                found.damaged.append(path)
                continue
            if fault := self._fault(rows, found):
                raise OutputError(
                    f"{path} {fault}; move it away, or use another output"
                )
            found.add(rows)
            found.typed.setdefault(metadata(rows).get(TYPED, ""), []).append(path)
        return found

    def _fault(self, rows: pa.Table, found: Found) -> str | None:
        """Return why the rows of a file cannot be added to those that were found
        before.
        """
        words = metadata(rows)
        if words.get(SWEEP) != self.hash:
            return "holds runs of another sweep"
        if not same_schema(rows.schema, self.schema):
            return "has the columns of another version of rattlesweep"
        case, sample = keys_of(rows)
        if not len(rows):
            return "holds no runs"
        if case.max() >= len(self.cases) or sample.max() >= self.samples:
            return (
                f"holds runs beyond {len(self.cases)} cases of {self.samples} samples"
            )
        if not set(self._cases_of(rows)) <= {*words.get(CASES, "").split("\n")}:
            return "numbers its cases differently"
        stored = found.code[case, sample] != MISSING
        if stored.any() or len(np.unique(_order(rows))) < len(rows):
            return "holds runs that are stored twice"
        return None

    def _cases_of(self, rows: pa.Table) -> list[str]:
        return [
            json.dumps(self.cases[n].dump())
            for n in pc.unique(rows["case"]).to_pylist()
        ]

    def count(self) -> int:
        """Return the number of rows on disk."""
        return sum(len(read_parquet(path, KEY)) for path in self.files())

    def read(self, names: Sequence[str] | None = None) -> pa.Table:
        """Return all rows, or some of their columns, in the order of their keys."""
        chosen = self.schema.names if names is None else names
        schema = pa.schema([self.schema.field(name) for name in chosen])
        return pa.Table.from_batches(
            self.batches(chosen), schema.remove_metadata()
        ).cast(schema)

    def batches(self, names: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Yield the same rows in the same order, about `BATCH_ROWS` or one file at a
        time.
        """
        names = self.schema.names if names is None else list(names)
        first = {path: _order(read_parquet(path, KEY))[0] for path in self.files()}
        paths = sorted(first, key=first.__getitem__)
        held: list[pa.Table] = []
        for path, following in zip_longest(paths, paths[1:]):
            rows = read_parquet(path, list(dict.fromkeys([*names, *KEY])))
            held.append(rows.replace_schema_metadata(None))
            if following is not None and sum(map(len, held)) < BATCH_ROWS:
                continue
            table = pa.concat_tables(held)
            order = _order(table)
            if (np.diff(order) < 0).any():
                index = np.argsort(order)
                table, order = table.take(index), order[index]
            # No later file has rows before the first row of the next file.
            ready = (
                len(table)
                if following is None
                else np.searchsorted(order, first[following])
            )
            held = [table.slice(ready)]
            yield from table.slice(0, ready).select(names).to_batches()


class Found:
    """What the files of a directory contain, and the rows that a session adds to
    them.
    """

    def __init__(self, shape: tuple[int, int], column: str | None = None) -> None:
        self.code = np.full(
            shape, MISSING, np.int8
        )  # index in TYPES, FAILED or MISSING
        self.value = np.full(
            shape if column else (0, 0), np.nan
        )  # of the column, if there is one
        self.column = column
        self.status: Counter[str] = Counter()  # runs by status
        self.typed: dict[str, list[Path]] = {}  # files by thresholds, as JSON
        self.damaged: list[Path] = []

    @property
    def done(self) -> Flags:
        """Runs that are stored; shape (cases, samples)."""
        return np.asarray(self.code != MISSING)

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
        keys, kind = keys_of(rows), codes(rows.column("type"))
        self.code[keys] = np.where(kind < 0, FAILED, kind)
        if self.column in rows.schema.names:
            self.value[keys] = floats(rows.column(self.column))
        for entry in rows.column("status").value_counts().to_pylist():
            self.status[entry["values"]] += entry["counts"]


@dataclass(frozen=True)
class Case:
    """Target, launch and dissipation that the runs of a case share; None where they
    differ.

    Values in SI units are a :class:`Quantity` if they differ in the units of the
    bodies.
    """

    index: int = field(compare=False)
    target_name: str | None
    target: float | None
    n_i: float | None
    omega_xy0: float | None
    sigma: float | None = None
    rolling: float | None = None

    def dump(self) -> dict[str, Any]:
        """Return the case as JSON data, without what is None."""
        data = {"case": self.index, self.target_name: self.target}
        values = ((name, getattr(self, name)) for name in VARIES)
        data |= {name: getattr(value, "text", value) for name, value in values}
        return {str(name): value for name, value in data.items() if value is not None}

    @classmethod
    def load(cls, data: Mapping[str, Any]) -> Case:
        """Return the case of such data."""
        name = next((name for name in ("K_p", "K_r") if name in data), None)
        kinds = {name or "": "", **VARIES}
        given = ((data.get(key), kind) for key, kind in kinds.items())
        found = (Quantity(x, kind) if isinstance(x, str) else x for x, kind in given)
        return cls(int(data["case"]), name, *found)

    def __str__(self) -> str:
        values = list(self.dump().items())[1:]
        return ", ".join(
            f"{k} {x if isinstance(x, str) else f'{x:g}'}" for k, x in values
        )


def rewrite(path: Path, rows: pa.Table, typed: str) -> None:
    """Replace the rows of a file by others with its metadata; remove it if there are
    none.
    """
    if len(rows):
        write_parquet(rows, path, metadata(rows) | {TYPED: typed})
    else:
        with explained(f"cannot remove {path}"):
            path.unlink()


def typed_by(path: Path) -> str:
    """Return the thresholds, as JSON, by which the rows of a file were typed."""
    return metadata(read_parquet(path, [])).get(TYPED, "")


def metadata(rows: pa.Table) -> dict[str, str]:
    """Return the metadata of the file that rows were read from."""
    words = rows.schema.metadata or {}
    return {
        k.decode(errors="replace"): v.decode(errors="replace") for k, v in words.items()
    }


def keys_of(rows: pa.Table) -> tuple[Integers, Integers]:
    """Return case and sample of each row."""
    case, sample = (rows.column(name).to_numpy().astype(np.int64) for name in KEY)
    return case, sample


def _order(rows: pa.Table) -> Integers:
    """Return numbers in the order of the keys."""
    case, sample = keys_of(rows)
    return (case << 32) + sample  # there are fewer than 2^32 samples


def free_path(path: Path) -> Path:
    """Return the path if no file has it, otherwise with a number appended to its
    stem.
    """
    numbered = (path.with_stem(f"{path.stem}-{again}") for again in count(2))
    return next(free for free in chain([path], numbered) if not free.exists())
