"""Rows on disk: the one truth about what has been done of a sweep.

A sweep is a set of runs with keys ``(case, sample)``.  The folder ``runs`` holds Parquet files,
each with any set of rows, ascending by key, and no key of another file.  A file is named after its
first row.  What is left to do is what is wanted, minus the keys of these rows.

The metadata of a file say to which sweep it belongs, by which thresholds its rows were typed, and
what the cases of its rows are, so that files can be copied between directories of a sweep.
"""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.arrays import Flags, Integers
from rattlesweep.errors import DamagedError, OutputError
from rattlesweep.sweeps.cases import Case
from rattlesweep.sweeps.columns import parquet_file, read_parquet, same_schema, write_parquet
from rattlesweep.sweeps.files import explained

FOLDER = "runs"
# Keys of a file's metadata: hash of the sweep, thresholds behind the types, cases of the rows.
SWEEP, TYPED, CASES = "rattlesweep.sweep", "rattlesweep.classify", "rattlesweep.cases"
PIECE = 1_000_000  # rows that are put in order at a time


@dataclass
class Found:
    """What the files of a directory hold."""

    done: Flags  # which runs there are; shape (cases, samples)
    status: Counter[str] = field(default_factory=Counter)  # runs by status
    typed: dict[str, list[Path]] = field(default_factory=dict)  # files by thresholds, as JSON
    damaged: list[Path] = field(default_factory=list)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.status.total()

    def add(self, rows: pa.Table) -> None:
        """Count rows."""
        self.done[keys_of(rows)] = True
        for entry in rows.column("status").value_counts().to_pylist():
            self.status[entry["values"]] += entry["counts"]


class Runs:
    """The files of a sweep, in the folder ``runs`` of its output directory."""

    def __init__(self, directory: Path) -> None:
        self.folder = directory / FOLDER

    def files(self) -> list[Path]:
        """Return the files in the order of their names; none where there is no folder."""
        with explained(f"cannot read {self.folder}"), contextlib.suppress(FileNotFoundError):
            paths = sorted(self.folder.iterdir())
            return [p for p in paths if p.suffix == ".parquet" and not p.name.startswith(".")]
        return []

    def append(self, table: pa.Table, sweep: str, typed: str, cases: Sequence[Case]) -> None:
        """Write rows, of which none may be on disk, as a file of their own."""
        case, sample = keys_of(table.slice(0, 1))
        path = free_path(self.folder / f"case{case[0]:05d}-sample{sample[0]:09d}.parquet")
        words = {SWEEP: sweep, TYPED: typed, CASES: "\n".join(_told(table, cases))}
        write_parquet(table, path, words)

    def rewrite(self, path: Path, table: pa.Table, typed: str | None = None) -> None:
        """Put other rows in the place of those of a file; a file without rows goes."""
        if len(table):
            words = self.metadata(path) | ({} if typed is None else {TYPED: typed})
            write_parquet(table, path, words)
        else:
            with explained(f"cannot remove {path}"):
                path.unlink()

    def find(
        self,
        cases: Sequence[Case],
        samples: int,
        sweep: str,
        schema: pa.Schema,
        files: Iterable[Path] | None = None,
    ) -> Found:
        """Read all of every file, or of `files`, and return what there is.

        Raise an OutputError if a file is not of this sweep, or if a run is there twice.
        """
        found = Found(np.zeros((len(cases), samples), dtype=bool))
        for path in self.files() if files is None else files:
            try:
                rows = read_parquet(path)
            except DamagedError:
                found.damaged.append(path)
                continue
            words = _words(rows.schema)
            wrong: str | None = "holds runs of another sweep"
            if words.get(SWEEP) == sweep:
                wrong = "has the columns of another version of rattlesweep"
                if same_schema(rows.schema, schema):
                    wrong = _wrong_keys(rows, words, cases, found.done)
            if wrong:
                raise OutputError(f"{path} {wrong}; move it away, or use another output")
            found.add(rows)
            found.typed.setdefault(words.get(TYPED, ""), []).append(path)
        return found

    def metadata(self, path: Path) -> dict[str, str]:
        """Return the words beside the schema of a file."""
        with parquet_file(path) as file:
            return _words(file.schema_arrow)

    def table(self, path: Path, columns: Sequence[str] | None = None) -> pa.Table:
        """Return the rows of one file, without metadata of the whole."""
        return read_parquet(path, columns).replace_schema_metadata(None)

    def batches(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield all rows in the order of their keys, however they lie in files, some at a time.

        Memory goes with :data:`PIECE`, or with the largest file where that is more.
        """
        first = {}
        for path in self.files():
            case, sample = keys_of(self.table(path, ["case", "sample"]))
            first[path] = case[0], sample[0]
        paths = sorted(first, key=first.__getitem__)
        wanted = None if columns is None else list(dict.fromkeys([*columns, "case", "sample"]))
        held: list[pa.Table] = []
        for path, following in zip_longest(paths, paths[1:]):
            held.append(self.table(path, wanted))
            if following is not None and sum(map(len, held)) < PIECE:
                continue
            table = pa.concat_tables(held)
            case, sample = keys_of(table)
            order = np.lexsort((sample, case))
            if (np.diff(order) != 1).any():
                table, case, sample = table.take(pa.array(order)), case[order], sample[order]
            ready = len(table)
            if following is not None:  # what comes before its first row is in its place now
                ends = first[following]
                ready = int(((case < ends[0]) | ((case == ends[0]) & (sample < ends[1]))).sum())
            held = [table.slice(ready)]
            if ready:
                piece = table.slice(0, ready)
                yield piece if columns is None else piece.select(list(columns))


def keys_of(rows: pa.Table) -> tuple[Integers, Integers]:
    """Return case and sample of each row."""
    case, sample = (rows.column(name).to_numpy().astype(np.int64) for name in ("case", "sample"))
    return case, sample


def free_path(path: Path) -> Path:
    """Return this path, or the same with the first number behind it that no file has."""
    stem, again = path.stem, 1
    while path.exists():
        again += 1
        path = path.with_stem(f"{stem}-{again}")
    return path


def _wrong_keys(
    rows: pa.Table, words: dict[str, str], cases: Sequence[Case], done: Flags
) -> str | None:
    """Return why the rows of a file cannot be among those of a sweep."""
    case, sample = keys_of(rows)
    samples = done.shape[1]
    if not len(rows) or case.max() >= len(cases) or sample.max() >= samples:
        return f"holds no runs, or others than of {len(cases)} cases of {samples} samples"
    if not set(_told(rows, cases)) <= {*words.get(CASES, "").split("\n")}:
        return "numbers its cases in another way"
    if done[case, sample].any() or len(np.unique(case * samples + sample)) < len(case):
        return "holds runs that are there twice"
    return None


def _told(rows: pa.Table, cases: Sequence[Case]) -> list[str]:
    """Return the cases of some rows, each as JSON."""
    return [json.dumps(cases[n].dump()) for n in pc.unique(rows.column("case")).to_pylist()]


def _words(schema: pa.Schema) -> dict[str, str]:
    words = schema.metadata or {}
    return {k.decode(errors="replace"): v.decode(errors="replace") for k, v in words.items()}
