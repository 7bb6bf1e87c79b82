"""Rows on disk: the one truth about what has been done of a sweep.

A sweep is a set of runs with keys ``(case, sample)``.  The folder ``runs`` holds Parquet files;
each file holds any set of rows, ascending by key, and shares no key with another file.  It is named
after its first row and is there whole or not at all. What is left to do is what is wanted, minus
the keys of these rows; nothing else is remembered.

Each file says in its metadata to which sweep it belongs, by which thresholds its rows were typed,
and what the cases of its rows are, so that files can be copied between directories and a lost
manifest be made again.
"""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from rattlesweep.arrays import Integers
from rattlesweep.errors import DamagedError, OutputError
from rattlesweep.sweeps.arrow import parquet_file, same_schema, write_parquet
from rattlesweep.sweeps.cases import Case
from rattlesweep.sweeps.files import explained

FOLDER = "runs"
SWEEP, TYPED, CASES = "rattlesweep.sweep", "rattlesweep.classify", "rattlesweep.cases"
"""Keys of a file's metadata: hash of the sweep, thresholds behind the types, cases of the rows."""
PIECE = 1_000_000
"""Rows that are put in order at a time."""


@dataclass
class Found:
    """What the files of a directory hold.

    Attributes
    ----------
    done : ndarray of bool, shape (cases, samples)
        Which runs there are.
    rows : int
        How many.
    status : Counter
        Runs by status.
    failed : list of Path
        Files with rows whose status is not ``ok``.
    typed : dict
        Files by the thresholds behind the types of their rows, as JSON.
    aside : list of Path
        Damaged files; where they were put aside, by their new names.
    """

    done: Any
    rows: int = 0
    status: Counter[str] = field(default_factory=Counter)
    failed: list[Path] = field(default_factory=list)
    typed: dict[str, list[Path]] = field(default_factory=dict)
    aside: list[Path] = field(default_factory=list)


class Runs:
    """The files of a sweep.

    Parameters
    ----------
    directory : Path
        Output directory; the files lie in its folder ``runs``.
    """

    def __init__(self, directory: Path) -> None:
        self.folder = directory / FOLDER

    def files(self) -> list[Path]:
        """Return the files in the order of their names; none where there is no folder."""
        with explained(f"cannot read {self.folder}", folder=True):
            try:
                return sorted(path for path in self.folder.iterdir() if _is_ours(path))
            except FileNotFoundError:
                return []

    # ---------------------------------------------------------------- write

    def append(self, table: pa.Table, sweep: str, typed: str, cases: Sequence[Case]) -> Path:
        """Write rows, of which none may be on disk, as a file of their own.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        case, sample = (table.column(name)[0].as_py() for name in ("case", "sample"))
        path = self.free(f"case{case:05d}-sample{sample:09d}")
        here = pc.unique(table.column("case")).to_pylist()
        told = json.dumps([cases[number].dump() for number in here])
        write_parquet(table, path, {SWEEP: sweep, TYPED: typed, CASES: told})
        return path

    def free(self, stem: str) -> Path:
        """Return a path that no file has: a file whose first row is gone keeps its name."""
        path, again = self.folder / f"{stem}.parquet", 1
        while path.exists():
            again += 1
            path = self.folder / f"{stem}-{again}.parquet"
        return path

    def rewrite(self, path: Path, table: pa.Table, typed: str | None = None) -> None:
        """Put other rows in the place of those of a file; a file without rows goes."""
        if not len(table):
            with explained(f"cannot remove {path}"):
                path.unlink()
            return
        with parquet_file(path) as file:
            metadata = _metadata(file)
        write_parquet(table, path, metadata if typed is None else metadata | {TYPED: typed})

    def rewrite_if(self, path: Path, table: pa.Table, typed: str) -> bool:
        """Rewrite a file unless its rows were typed by these thresholds; return whether it was."""
        with parquet_file(path) as file:
            if _metadata(file).get(TYPED) == typed:
                return False
        self.rewrite(path, table, typed)
        return True

    def drop_failed(self, path: Path) -> int:
        """Take the rows that are not ok out of a file; return how many there were."""
        table = self.table(path)
        kept = table.filter(pc.equal(table.column("status"), "ok"))
        self.rewrite(path, kept)
        return len(table) - len(kept)

    # ----------------------------------------------------------------- read

    def find(
        self,
        cases: Sequence[Case],
        samples: int,
        sweep: str,
        schema: pa.Schema,
        skip: Collection[Path] = (),
        *,
        put_aside: bool = True,
    ) -> Found:
        """Read all of every file, but for those to `skip`, put damaged ones aside, and return what
        there is.

        Raises
        ------
        OutputError
            If a file cannot be read, is of another sweep or of another version, or if a run stands
            in two files.
        """
        found = Found(np.zeros((len(cases), samples), dtype=bool))
        owner: dict[str, Integers] = {}
        for path in self.files():
            if path in skip:
                continue
            try:
                with parquet_file(path) as file:
                    self._check(path, file, cases, sweep, schema)
                    typed = _metadata(file).get(TYPED, "")
                    table = _read_all(file)
            except DamagedError:
                found.aside.append(_put_aside(path) if put_aside else path)
                continue
            except OutputError:
                if path.exists():
                    raise
                continue  # damaged, and put aside by another share meanwhile
            place = self._places(path, table, found.done.shape)
            if found.done.ravel()[place].any() or len(np.unique(place)) < len(place):
                self._refuse_twice(path, place, owner, samples)
            found.done.ravel()[place] = True
            owner[path.name] = place[[0, -1]]
            found.rows += len(place)
            counts = table.column("status").value_counts().to_pylist()
            found.status.update({entry["values"]: entry["counts"] for entry in counts})
            if any(entry["values"] != "ok" for entry in counts):
                found.failed.append(path)
            found.typed.setdefault(typed, []).append(path)
        return found

    def _check(
        self, path: Path, file: pq.ParquetFile, cases: Sequence[Case], sweep: str, schema: pa.Schema
    ) -> None:
        metadata = _metadata(file)
        _check_sweep(path, metadata, sweep)
        if not same_schema(file.schema_arrow, schema):
            raise OutputError(
                f"{path} has the columns of another version of rattlesweep; use another output"
            )
        for case in _cases(metadata, path):
            if case.index >= len(cases) or cases[case.index] != case:
                raise OutputError(
                    f"{path} numbers its cases in another way: case {case.index} is {case} there; "
                    "move it away, or use another output"
                )

    @staticmethod
    def _places(path: Path, table: pa.Table, shape: tuple[int, int]) -> Integers:
        case, sample = (
            table.column(name).to_numpy().astype(np.int64) for name in ("case", "sample")
        )
        if not len(case) or min(case.min(), sample.min()) < 0:
            raise OutputError(f"{path} holds no runs; move it away")
        if case.max() >= shape[0] or sample.max() >= shape[1]:
            raise OutputError(
                f"{path} holds runs up to case {case.max()} and sample {sample.max()}; the sweep "
                f"has {shape[0]} cases of {shape[1]} samples"
            )
        places: Integers = case * shape[1] + sample
        return places

    def _refuse_twice(
        self, path: Path, place: Integers, owner: Mapping[str, Integers], samples: int
    ) -> None:
        others = [n for n, ends in owner.items() if ends[0] <= place[-1] and place[0] <= ends[1]]
        for name in others:
            with parquet_file(self.folder / name) as file:
                theirs = file.read(["case", "sample"])
            both = np.intersect1d(
                place,
                theirs["case"].to_numpy().astype(np.int64) * samples + theirs["sample"].to_numpy(),
            )
            if len(both):
                case, sample = divmod(int(both[0]), samples)
                raise OutputError(
                    f"{len(both)} runs, such as case {case} sample {sample}, stand both in {name} "
                    f"and in {path}; move one of these files away"
                )
        raise OutputError(f"{path} holds a run twice; move it away, and it will be done again")

    def cases(self, sweep: str) -> dict[int, Case]:
        """Return the cases that the files tell of, by their numbers.

        Raises
        ------
        OutputError
            If files do not agree, or are not of this sweep.
        """
        found: dict[int, Case] = {}
        for path in self.files():
            try:
                with parquet_file(path) as file:
                    metadata = _metadata(file)
                    cases = _cases(metadata, path)
            except DamagedError:
                continue
            _check_sweep(path, metadata, sweep)
            for case in cases:
                if found.setdefault(case.index, case).key != case.key:
                    raise OutputError(
                        f"{path} numbers its cases unlike other files: case {case.index} is {case} "
                        f"there and {found[case.index]} elsewhere; move one of them away"
                    )
        return found

    def count(self) -> int:
        """Return how many rows there are, by the files' own account."""
        rows = 0
        for path in self.files():
            with parquet_file(path) as file:
                rows += file.metadata.num_rows
        return rows

    def table(self, path: Path, columns: Sequence[str] | None = None) -> pa.Table:
        """Return the rows of one file, without metadata of the whole."""
        with parquet_file(path) as file:
            return _read_all(file, columns)

    def read(self, columns: Sequence[str] | None = None) -> pa.Table | None:
        """Return all rows in the order of their keys; None where there are no files."""
        batches = list(self.batches(columns))
        return pa.concat_tables(batches) if batches else None

    def batches(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield all rows in the order of their keys, some at a time.

        However the rows lie in files, the same pieces follow each other in the same order: sums
        over them are equal to the last bit.  Memory goes with :data:`PIECE`, or with the largest
        file where that is more.
        """
        spans = [(path, *_span(path)) for path in self.files()]
        spans.sort(key=lambda span: span[1])
        keys = ["case", "sample"]
        wanted = None if columns is None else list(dict.fromkeys([*columns, *keys]))
        waiting: list[pa.Table] = []
        held = 0
        for number, (path, _, _) in enumerate(spans):
            waiting.append(self.table(path, wanted))
            held += len(waiting[-1])
            following = spans[number + 1][1] if number + 1 < len(spans) else None
            if following is not None and held < PIECE:
                continue
            table = pa.concat_tables(waiting)
            order = np.lexsort((table["sample"].to_numpy(), table["case"].to_numpy()))
            if (np.diff(order) != 1).any():
                table = table.take(pa.array(order))
            # What comes before the next file's first row is in its place now.
            ready = len(table)
            if following is not None:
                case, sample = table["case"].to_numpy(), table["sample"].to_numpy()
                ready = int(
                    (
                        (case < following[0]) | ((case == following[0]) & (sample < following[1]))
                    ).sum()
                )
            waiting, held = [table.slice(ready)], len(table) - ready
            if ready:
                piece = table.slice(0, ready)
                yield piece if columns is None else piece.select(list(columns))


def _is_ours(path: Path) -> bool:
    return path.suffix == ".parquet" and not path.name.startswith(".")


def _metadata(file: pq.ParquetFile) -> dict[str, str]:
    return {k.decode(): v.decode() for k, v in (file.schema_arrow.metadata or {}).items()}


def is_of_a_sweep(path: Path) -> bool:
    """Return whether a file holds rows of some sweep, as far as can be told: it may be damaged."""
    try:
        with parquet_file(path) as file:
            return SWEEP in _metadata(file)
    except DamagedError:
        return path.name.startswith("case")


def _check_sweep(path: Path, metadata: Mapping[str, str], sweep: str) -> None:
    """Raise an OutputError unless a file is of this sweep."""
    if SWEEP not in metadata or CASES not in metadata:
        raise OutputError(
            f"{path} was not written by rattlesweep; move it out of the output directory"
        )
    if metadata[SWEEP] != sweep:
        raise OutputError(
            f"{path} holds runs of another sweep; move it away, or use another output"
        )


def _cases(metadata: Mapping[str, str], path: Path) -> list[Case]:
    try:
        return [Case.load(data) for data in json.loads(metadata.get(CASES, "[]"))]
    except (ValueError, TypeError, KeyError) as error:
        raise DamagedError(f"{path} is damaged: its cases cannot be read") from error


def _read_all(file: pq.ParquetFile, columns: Sequence[str] | None = None) -> pa.Table:
    rows = file.read(None if columns is None else list(columns))
    return rows.replace_schema_metadata(None)


def _span(path: Path) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the first and the last key of a file, whose rows ascend."""
    with parquet_file(path) as file:
        keys = file.read(["case", "sample"])
    case, sample = keys["case"].to_numpy(), keys["sample"].to_numpy()
    return (int(case[0]), int(sample[0])), (int(case[-1]), int(sample[-1]))


def _put_aside(path: Path) -> Path:
    aside, again = path.with_suffix(".damaged"), 1
    while aside.exists():
        again += 1
        aside = path.with_suffix(f".damaged-{again}")
    with explained(f"cannot rename {path}"), contextlib.suppress(FileNotFoundError):
        path.rename(aside)  # unless another share was quicker
    return aside
