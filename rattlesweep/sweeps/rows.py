"""Rows on disk: the one truth about what has been done of a sweep.

A sweep is a set of runs with keys ``(case, sample)``.  The folder ``runs`` holds Parquet files,
each with any set of rows, ascending by key, and no key of another file.  A file is named after its
first row.  What is left to do is what is wanted, minus the keys of these rows.

The metadata of a file say to which sweep it belongs, by which thresholds its rows were typed, and
what the cases of its rows are: files can be copied between directories, and a lost manifest made
again.
"""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from rattlesweep.arrays import Flags
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

    done: Flags
    rows: int = 0
    status: Counter[str] = field(default_factory=Counter)
    failed: list[Path] = field(default_factory=list)
    typed: dict[str, list[Path]] = field(default_factory=dict)
    aside: list[Path] = field(default_factory=list)


class Runs:
    """The files of a sweep, in the folder ``runs`` of its output directory."""

    def __init__(self, directory: Path) -> None:
        self.folder = directory / FOLDER

    def files(self) -> list[Path]:
        """Return the files in the order of their names; none where there is no folder."""
        with explained(f"cannot read {self.folder}", folder=True):
            try:
                paths = sorted(self.folder.iterdir())
            except FileNotFoundError:
                return []
        return [p for p in paths if p.suffix == ".parquet" and not p.name.startswith(".")]

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
        here = [cases[number].dump() for number in pc.unique(table.column("case")).to_pylist()]
        write_parquet(table, path, {SWEEP: sweep, TYPED: typed, CASES: json.dumps(here)})
        return path

    def free(self, stem: str) -> Path:
        """Return a path that no file has: a file whose first row is gone keeps its name."""
        return _free(self.folder / f"{stem}.parquet")

    def rewrite(self, path: Path, table: pa.Table, typed: str | None = None) -> None:
        """Put other rows in the place of those of a file; a file without rows goes."""
        if not len(table):
            with explained(f"cannot remove {path}"):
                path.unlink()
            return
        metadata = _metadata_of(path)
        write_parquet(table, path, metadata if typed is None else metadata | {TYPED: typed})

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
            If a file cannot be read, is not of this sweep or version, or if a run stands in two
            files.
        """
        found = Found(np.zeros((len(cases), samples), dtype=bool))
        for path in self.files():
            if path in skip:
                continue
            try:
                with parquet_file(path) as file:
                    metadata = _metadata(file)
                    _check(path, file.schema_arrow, metadata, cases, sweep, schema)
                    table = file.read()
            except DamagedError:
                found.aside.append(_put_aside(path) if put_aside else path)
                continue
            except OutputError:
                if path.exists():
                    raise
                continue  # damaged, and put aside by another shard meanwhile
            _add(path, table, found)
            found.typed.setdefault(metadata.get(TYPED, ""), []).append(path)
        return found

    def cases(self, sweep: str) -> dict[int, Case]:
        """Return the cases of which the files tell, by their numbers.

        Raises
        ------
        OutputError
            If a file is not of this sweep.
        """
        found: dict[int, Case] = {}
        for path in self.files():
            with contextlib.suppress(DamagedError):
                metadata = _metadata_of(path)
                _check_sweep(path, metadata, sweep)
                found |= {case.index: case for case in _cases(path, metadata)}
        return found

    def typed(self, path: Path) -> str:
        """Return the thresholds behind the types of a file's rows, as JSON."""
        return _metadata_of(path).get(TYPED, "")

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
            rows = file.read(None if columns is None else list(columns))
        return rows.replace_schema_metadata(None)

    def batches(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield all rows in the order of their keys, however they lie in files, some at a time.

        Memory goes with :data:`PIECE`, or with the largest file where that is more.
        """
        first = {path: self._first_key(path) for path in self.files()}
        paths = sorted(first, key=first.__getitem__)
        wanted = None if columns is None else list(dict.fromkeys([*columns, "case", "sample"]))
        held: list[pa.Table] = []
        for path, following in zip_longest(paths, paths[1:]):
            held.append(self.table(path, wanted))
            if following is not None and sum(map(len, held)) < PIECE:
                continue
            table = pa.concat_tables(held)
            order = np.lexsort((table["sample"].to_numpy(), table["case"].to_numpy()))
            if (np.diff(order) != 1).any():
                table = table.take(pa.array(order))
            ready = len(table)
            if following is not None:  # what comes before its first row is in its place now
                case, sample = first[following]
                here, there = table["case"].to_numpy(), table["sample"].to_numpy()
                ready = int(((here < case) | ((here == case) & (there < sample))).sum())
            held = [table.slice(ready)]
            if ready:
                piece = table.slice(0, ready)
                yield piece if columns is None else piece.select(list(columns))

    def _first_key(self, path: Path) -> tuple[int, int]:
        keys = self.table(path, ["case", "sample"])
        return keys["case"][0].as_py(), keys["sample"][0].as_py()


def _metadata(file: pq.ParquetFile) -> dict[str, str]:
    return {k.decode(): v.decode() for k, v in (file.schema_arrow.metadata or {}).items()}


def _metadata_of(path: Path) -> dict[str, str]:
    with parquet_file(path) as file:
        return _metadata(file)


def _cases(path: Path, metadata: dict[str, str]) -> list[Case]:
    try:
        return [Case.load(data) for data in json.loads(metadata.get(CASES, "[]"))]
    except (ValueError, TypeError, KeyError) as error:
        raise DamagedError(f"{path} is damaged: its cases cannot be read") from error


def _check_sweep(path: Path, metadata: dict[str, str], sweep: str) -> None:
    if SWEEP not in metadata:
        raise OutputError(f"{path} was not written by rattlesweep; move it away")
    if metadata[SWEEP] != sweep:
        raise OutputError(
            f"{path} holds runs of another sweep; move it away, or use another output"
        )


def _check(
    path: Path,
    columns: pa.Schema,
    metadata: dict[str, str],
    cases: Sequence[Case],
    sweep: str,
    schema: pa.Schema,
) -> None:
    """Raise an OutputError unless a file is one of this sweep and this version."""
    _check_sweep(path, metadata, sweep)
    if not same_schema(columns, schema):
        raise OutputError(
            f"{path} has the columns of another version of rattlesweep; use another output"
        )
    for case in _cases(path, metadata):
        if case.index >= len(cases) or cases[case.index] != case:
            raise OutputError(
                f"{path} numbers its cases in another way: case {case.index} is {case} there; "
                "move it away, or use another output"
            )


def _add(path: Path, table: pa.Table, found: Found) -> None:
    """Mark the rows of a file as found; raise an OutputError if they cannot belong to the sweep."""
    case, sample = (table.column(name).to_numpy().astype(np.int64) for name in ("case", "sample"))
    cases, samples = found.done.shape
    if not len(case) or case.max() >= cases or sample.max() >= samples:
        most = f"runs up to case {case.max()} and sample {sample.max()}" if len(case) else "no runs"
        raise OutputError(
            f"{path} holds {most}; the sweep has {cases} cases of {samples} samples; move it away"
        )
    if found.done[case, sample].any() or len(np.unique(case * samples + sample)) < len(case):
        raise OutputError(
            f"{path} holds runs that are there twice; move it away, and what is then missing is "
            "done again"
        )
    found.done[case, sample] = True
    found.rows += len(case)
    for entry in table.column("status").value_counts().to_pylist():
        found.status[entry["values"]] += entry["counts"]
    if not pc.all(pc.equal(table.column("status"), "ok")).as_py():
        found.failed.append(path)


def _put_aside(path: Path) -> Path:
    aside = _free(path.with_suffix(".damaged"))
    with explained(f"cannot rename {path}"), contextlib.suppress(FileNotFoundError):
        path.rename(aside)  # unless another shard was quicker
    return aside


def _free(path: Path) -> Path:
    """Return this path, or the same with the first number behind it that no file has."""
    stem, suffix, again = path.stem, path.suffix, 1
    while path.exists():
        again += 1
        path = path.with_name(f"{stem}-{again}{suffix}")
    return path
