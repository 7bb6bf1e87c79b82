"""Two directories of the same runs, row by row: how far reversal times and types differ."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as pq

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps import columns
from rattlesweep.sweeps.columns import F64, I32, I64, TEXT, TIME
from rattlesweep.sweeps.config.read import differences, fixed_part, resolved
from rattlesweep.sweeps.files import streamed_file
from rattlesweep.sweeps.old.stored import Stored, open_stored

LOWEST, HIGHEST = -17, 1
"""Powers of ten between which relative differences lie."""
COARSE, FINE = 10, 200
"""Bins a decade of what is drawn, and of what tells quantiles, to 1 %."""
MOST_LISTED = 10
# What makes runs the same; another machine may draw it with other last digits.
_RUN = ("alpha", "beta", "gamma", "theta", "phi", "xi", "n_i", "omega_xy0")
_KEYS, _OPTIONAL = ["case", "sample"], ["t_r_error", "type_sure"]
_COLUMNS = [*_KEYS, *_RUN, "t_r", "type", "status", *_OPTIONAL]
# All; those that reverse in both, of these equal to the last bit of t_r, and beyond both errors;
# types that differ, of these sure in both; not ok in one of them or both.
_COUNTS = ("runs", "reversing", "equal", "beyond", "types", "types_sure", "not_ok")

_SIDES = [("a", "the first directory"), ("b", "the second")]
DATA = pa.schema(
    [
        columns.required("case", I32, "1", "number of the case, from 0"),
        columns.required("sample", I64, "1", "number of the run within its case"),
        *(columns.field(f"type_{x}", TEXT, "1", f"type in {words}") for x, words in _SIDES),
        *(columns.field(f"t_r_{x}", F64, TIME, f"t_r in {words}") for x, words in _SIDES),
        columns.field("dt_r", F64, TIME, "t_r_b - t_r_a; null: does not reverse in both"),
        columns.field("relative", F64, "1", "abs(dt_r) over the mean of both t_r"),
        *(columns.field(f"t_r_error_{x}", F64, TIME, f"t_r_error in {w}") for x, w in _SIDES),
        columns.field("over_errors", F64, "1", "abs(dt_r) over the root of the sum of the squares "
                      "of both errors"),
        *(columns.field(f"type_sure_{x}", pa.bool_(), "1", f"type_sure in {w}") for x, w in _SIDES),
    ]
)  # fmt: skip
"""Columns of the differences, one row for each run that both directories have."""


class Tally:
    """Runs that both directories have, counted."""

    def __init__(self) -> None:
        self.counts = dict.fromkeys(_COUNTS, 0)
        self.worst = 0.0  # largest relative difference of t_r
        # Runs by relative difference, if it is not 0, FINE bins a decade.
        self.histogram = np.zeros((HIGHEST - LOWEST) * FINE, np.int64)

    def add(self, rows: pd.DataFrame) -> None:
        """Count more runs."""
        relative = rows.relative.dropna().to_numpy()
        new = (len(rows), len(relative), relative == 0, rows.over_errors > 1, rows.differs,
               rows.differs & rows.sure, rows.not_ok)  # fmt: skip
        for name, count in zip(_COUNTS, new, strict=True):
            self.counts[name] += int(np.sum(count))
        self.worst = float(np.max(relative, initial=self.worst))
        np.add.at(self.histogram, place(relative[relative > 0], FINE), 1)

    def quantile(self, share: float) -> float | None:
        """Relative difference that this share of the runs that reverse in both do not exceed."""
        if not (reversing := self.counts["reversing"]):
            return None
        if (rank := np.ceil(share * reversing) - self.counts["equal"]) <= 0:
            return 0.0
        at = int(np.searchsorted(np.cumsum(self.histogram), rank))
        return float(min(10 ** (LOWEST + (at + 0.5) / FINE), self.worst))


def place(values: Floats, bins: int) -> Integers:
    """Which of so many bins a decade each positive value is in; the outer ones have no end."""
    at = np.floor((np.log10(values) - LOWEST) * bins)
    inside: Integers = np.clip(at, 0, (HIGHEST - LOWEST) * bins - 1).astype(np.int64)
    return inside


@dataclass
class Comparison:
    """How two directories of the same runs differ."""

    directories: list[Path]
    differ: list[str]  # in what else: settings, versions and processors
    planned: int  # runs of their sweep
    errors: list[bool]  # whether each of them has t_r_error
    sure: list[bool]  # and type_sure
    rows: list[int] = field(default_factory=lambda: [0, 0])  # runs that each of them has
    total: Tally = field(default_factory=Tally)
    # A row for each case of which both have runs.
    cases: list[dict[str, Any]] = field(default_factory=list)
    # Rows of DATA: of the runs that differ most in t_r, in terms of their errors where these are
    # stored, and else relatively; and of the first runs that differ in type, those that both
    # directories are sure of before others.
    times: list[dict[str, Any]] = field(default_factory=list)
    types: list[dict[str, Any]] = field(default_factory=list)
    # Runs by both errors together over t_r, and by relative difference if it is not 0; COARSE bins
    # a decade.
    plane: Integers = field(
        default_factory=lambda: np.zeros(((HIGHEST - LOWEST) * COARSE,) * 2, np.int64)
    )

    def row(self, tally: Tally) -> dict[str, Any]:
        """A row of the table; None for what is not known."""
        unknown = {} if all(self.errors) else {"beyond": None}
        unknown |= {} if all(self.sure) else {"types_sure": None}
        median, p99 = tally.quantile(0.5), tally.quantile(0.99)
        worst = None if median is None else tally.worst
        return tally.counts | {"median": median, "p99": p99, "worst": worst} | unknown

    def disagree(self, allowed: float) -> bool:
        """Whether more than this share lie beyond both errors, or types that are sure differ."""
        counts = self.total.counts
        return counts["beyond"] > allowed * counts["reversing"] or counts["types_sure"] > 0

    def data(self) -> dict[str, Any]:
        """All of it as JSON can hold it."""
        return {
            "directories": [str(directory) for directory in self.directories],
            "differ": self.differ,
            "runs": self.planned,
            "missing": [self.planned - rows for rows in self.rows],
            "errors_stored": self.errors,
            "total": self.row(self.total),
            "cases": self.cases,
            "differing_times": self.times,
            "differing_types": self.types,
        }

    def add(self, rows: pd.DataFrame) -> None:
        """Count more runs, and keep those that are to be listed."""
        self.total.add(rows)
        drawn = rows[(rows.relative > 0) & np.isfinite(rows.over_errors)]
        relative, over = drawn.relative.to_numpy(), drawn.over_errors.to_numpy()
        np.add.at(self.plane, (place(relative / over, COARSE), place(relative, COARSE)), 1)
        by = "over_errors" if all(self.errors) else "relative"
        most = rows[rows[by] > 0].nlargest(MOST_LISTED, by)
        # Infinity, beyond errors of 0, is null. Among equals the order stays.
        times = [*self.times, *_table(most).to_pylist()]
        times.sort(key=lambda row: -np.inf if row[by] is None else -row[by])
        self.times = times[:MOST_LISTED]
        other = rows[rows.differs].sort_values("sure", ascending=False, kind="stable")
        types = [*self.types, *_table(other.head(MOST_LISTED)).to_pylist()]
        types.sort(key=lambda row: not (row["type_sure_a"] and row["type_sure_b"]))
        self.types = types[:MOST_LISTED]


def _table(rows: pd.DataFrame) -> pa.Table:
    finite = rows.assign(over_errors=rows.over_errors.where(np.isfinite(rows.over_errors)))
    return pa.Table.from_pandas(finite[DATA.names], DATA, preserve_index=False)


class _Side:
    """The rows of a directory in their order, taken off the front; in memory is a row group."""

    def __init__(self, stored: Stored) -> None:
        self._stored, self.rows, self.last = stored, 0, -1
        if not (present := stored.present()):
            raise OutputError(f"{stored.directory} holds no runs yet")
        names = stored.store.read_block(present[0]).schema.names
        self.errors, self.sure = (name in names for name in _OPTIONAL)
        self._batches = stored.store.iter_batches(
            [name for name in _COLUMNS if name in names or name not in _OPTIONAL]
        )
        self._front = pd.DataFrame()

    def fill(self) -> bool:
        """Have rows in memory, up to the number `last`; whether there are any left."""
        while not len(self._front):
            batch = next(self._batches, None)
            if batch is None:
                return False
            self._front = batch.to_pandas().reindex(columns=_COLUMNS)
            self._front.index = pd.Index(self._numbers())
        return True

    def _numbers(self) -> Integers:
        """Numbers of the rows in memory, which must ascend."""
        manifest, rows = self._stored.manifest, self._front
        case, sample = (rows[name].to_numpy(np.int64) for name in _KEYS)
        numbers: Integers = case * manifest.samples + sample
        if np.any(np.diff(numbers, prepend=self.last) <= 0) or np.any(numbers >= manifest.runs):
            raise OutputError(
                f"{self._stored.store.runs} holds runs that are double, out of order or of another "
                f"sweep; `rattlesweep verify {self._stored.directory}` says which"
            )
        self.last = int(numbers.max(initial=self.last))
        return numbers

    def take(self, last: int) -> pd.DataFrame:
        """Take the rows up to this number."""
        count = int(self._front.index.searchsorted(last, "right"))
        taken, self._front = self._front.iloc[:count], self._front.iloc[count:]
        self.rows += count
        return taken


def compare(
    a: Path,
    b: Path,
    *,
    write: Callable[[pa.Table], object] = lambda rows: None,
    report: Callable[[float], None] = lambda fraction: None,
) -> Comparison:
    """Compare the runs that two directories both have; memory does not grow with them.

    They are of one sweep, apart from how it was integrated and what was recorded. `write` is called
    with the differences of the next runs, of the schema `DATA`, and `report` with the fraction of
    the runs that is done. A ConfigError says in what their runs are not the same.
    """
    one, other = open_stored(a), open_stored(b)
    for stored in (one, other):
        stored.refuse_stages("another directory has others")
    if changes := differences(_runs(one), _runs(other)):
        raise _not_same(one, other, "; ".join(changes[:3]))
    left, right = _Side(one), _Side(other)
    result = Comparison(
        directories=[a, b],
        differ=differences(_settings(one), _settings(other)),
        planned=one.manifest.runs,
        errors=[left.errors, right.errors],
        sure=[left.sure, right.sure],
    )
    # Runs come case by case, so that of one case alone there are counts in memory.
    cases: dict[int, dict[str, Any]] = {}
    tally = Tally()
    while left.fill() and right.fill():
        last = min(left.last, right.last)
        rows = _differing(left.take(last), right.take(last), one, other)
        result.add(rows)
        write(_table(rows))
        for _, own in rows.groupby("case"):
            case = int(own["case"].iloc[0])
            tally = tally if case in cases else Tally()
            tally.add(own)
            of_case = one.manifest.cases[case].model_dump(exclude_none=True)
            cases[case] = of_case | result.row(tally)
        report(last / result.planned)
    result.cases = [*cases.values()]
    for side in (left, right):
        while side.fill():
            side.take(side.last)
    result.rows = [left.rows, right.rows]
    return result


def _runs(stored: Stored) -> dict[str, Any]:
    """What determines which runs there are, however they are integrated."""
    config, manifest = stored.config, stored.manifest
    data = fixed_part(resolved(config))
    how = ("integrator", "record", "classify")
    data = {key: value for key, value in data.items() if key not in how}
    # A table may have moved; what it says is compared row by row.
    data["bodies"] = {key: value for key, value in data["bodies"].items() if key != "path"}
    return data | {"cases": len(manifest.cases), "samples": manifest.samples}


def _settings(stored: Stored) -> dict[str, Any]:
    """What else can make a difference."""
    config, manifest = resolved(stored.config), stored.manifest
    settings = {key: config[key] for key in ("integrator", "record", "classify")}
    return settings | {"versions": manifest.versions, "cpu": manifest.machine.get("cpu")}


def _not_same(one: Stored, other: Stored, what: str) -> ConfigError:
    return ConfigError(
        f"{other.directory}: its runs are not those of {one.directory} ({what}); only directories "
        "of the same runs can be compared"
    )


def _differing(a: pd.DataFrame, b: pd.DataFrame, one: Stored, other: Stored) -> pd.DataFrame:
    """The runs that are in both, with the columns of `DATA` and those that are counted."""
    rows = a.merge(b, on=_KEYS, suffixes=("_a", "_b"))
    for name in _RUN:
        x, y = rows[f"{name}_a"].to_numpy(float), rows[f"{name}_b"].to_numpy(float)
        if len(wrong := np.flatnonzero(~np.isclose(x, y, rtol=1e-9, atol=1e-12, equal_nan=True))):
            k = int(wrong[0])
            where = f"case {rows['case'][k]}, sample {rows['sample'][k]}"
            raise _not_same(one, other, f"{where}: {name}: {x[k]:.10g} against {y[k]:.10g}")
    ok = (rows.status_a == "ok") & (rows.status_b == "ok")
    dt_r = (rows.t_r_b - rows.t_r_a).where(ok)
    error = np.hypot(rows.t_r_error_a, rows.t_r_error_b)
    return rows.assign(
        dt_r=dt_r,
        relative=dt_r.abs() / ((rows.t_r_a + rows.t_r_b) / 2),
        # Beyond errors of 0 is any difference, but not none.
        over_errors=(dt_r.abs() / error).mask((error == 0) & (dt_r == 0), 0.0),
        differs=ok & (rows.type_a != rows.type_b),
        sure=rows.type_sure_a.eq(True) & rows.type_sure_b.eq(True),
        not_ok=~ok,
    )


@contextmanager
def rows_file(path: Path) -> Iterator[Callable[[pa.Table], None]]:
    """What writes differences to a .csv or .parquet file, which appears whole or not at all."""
    kind = csv.CSVWriter if path.suffix.lower() == ".csv" else pq.ParquetWriter
    with streamed_file(path) as file, kind(file, DATA) as writer:
        yield writer.write_table
