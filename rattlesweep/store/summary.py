"""The summary, with one row a case, and the counts by cell from which it is made.

A cell is a case, or a pixel of a map.  Rows are added one by one in the order of their
keys, so that sums do not depend on how rows are spread over files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.design.cases import VARIES, Case
from rattlesweep.physics.theory import unsteady
from rattlesweep.rows import arrow
from rattlesweep.rows.arrow import F64, I32, I64, TEXT, Values
from rattlesweep.rows.types import CODE_DEAD, CODE_R, TYPES, codes
from rattlesweep.statistics.intervals import share
from rattlesweep.statistics.tails import LEAST_INDEX, tail_index
from rattlesweep.store.decide import nearest_rows
from rattlesweep.store.parquet import read_parquet, write_parquet
from rattlesweep.store.rows import SUMMARY, Stored
from rattlesweep.store.skipped import estimate
from rattlesweep.system.console import align
from rattlesweep.words.errors import OutputError, one_line
from rattlesweep.words.names import REGIMES
from rattlesweep.words.quantities import ACTING, COUPLE_CONSTANTS, MEASURES, RATE, TIME

# Columns of the runs that are counted or averaged; not all runs have the later ones.
READ = (
    "n_i",
    "K_p",
    "omega_p",
    "n_c1",
    "t_rgh",
    "t_r",
    "type",
    "status",
    "near_tangencies",
    *ACTING,
    "t_slide",
    "t_r_error",
    "type_sure",
    "contact_ratio_max",
    "contact_normal_min",
    "t_r_s",
    "n_i_rpm",
    "regime",
)
# Launches and losses by their names, with name and size of their units in SI units.
SI: dict[str, tuple[str, float]] = {
    definition.name: (measure.name, measure.size)
    for definition, measure in MEASURES.values()
    if definition.name in VARIES
}
# Shares of runs that need a coefficient of friction above these.
_FRICTION = {
    f"share_friction_above_{friction:g}".replace(".", "_"): friction
    for friction in (0.1, 0.2, 0.3, 0.5, 0.6)
}
# Times that are interpolated at the points that a refined sweep skips.
INTERPOLATED_TIMES = ("t_r", "t_r_s", "t_rgh", "t_r_error")
# Reversal times of a case from which its median and tail are found.
MOST_KEPT = 65_536
SENSITIVE = 1e-6  # relative error of t_r above which a run is sensitive


def read_summary(stored: Stored) -> pa.Table:
    """Return ``summary.parquet``, or where it is missing, a summary of the rows."""
    path = stored.directory / SUMMARY
    return read_parquet(path) if path.exists() else summarise(stored)


def write_summary(stored: Stored) -> pa.Table:
    """Write ``summary.parquet`` from the rows, and return it.

    A file that is right already stays as it is, with its time.
    """
    table = summarise(stored)
    if not is_summary_right(stored, table):
        write_parquet(table, stored.directory / SUMMARY)
    return table


def is_summary_right(stored: Stored, expected: pa.Table) -> bool:
    """Return whether ``summary.parquet`` is there and holds what is expected."""
    try:
        summary = read_parquet(stored.directory / SUMMARY)
    except OutputError:
        return False
    return bool(summary.equals(expected))


def summarise(stored: Stored) -> pa.Table:
    """Return the summary of the rows on disk; cases without rows have 0 runs."""
    return summary_table(stored.cases, count_cases(stored))


def count_cases(stored: Stored) -> Counts:
    """Count runs by case; in a refined sweep, count all points of its grid.

    A skipped point counts as the nearest run, with interpolated times.
    """
    cases = len(stored.cases)
    names = ("case", *columns_for(stored.schema))
    counts = Counts(cases, keeps_times=True)
    for rows in stored.batches(names):
        counts.add(rows, rows.column("case").to_numpy().astype(np.int64))
    if stored.config.deciding_key != "bodies.refine":
        return counts
    runs = stored.read(names)
    nearest = np.stack([rows for _, rows in nearest_rows(stored)])
    estimates = {
        name: estimate(stored, arrow.floats(runs.column(name)), nearest)
        for name in INTERPOLATED_TIMES
        if name in names
    }
    points = Counts(cases, keeps_times=True)
    for case, rows in enumerate(nearest):
        has_run = rows >= 0
        copies = runs.take(pa.array(rows[has_run]))
        for name, values in estimates.items():
            column = copies.column(name)
            # The nearest run decides whether there is a time at all.
            times = pa.array(values[case, has_run], mask=column.is_null().to_numpy())
            copies = copies.set_column(copies.schema.get_field_index(name), name, times)
        points.add(copies, np.full(len(copies), case))
    points |= {name: counts[name] for name in ("runs", "failed")}
    return points


def columns_for(schema: pa.Schema) -> list[str]:
    """Return the columns of a sweep's runs that :meth:`Counts.add` reads."""
    return [name for name in READ if name in schema.names]


class Counts(dict[str, Integers]):
    """Numbers of runs with some property, by its name, in arrays of shape (cells,).

    Names are ``runs ok failed``, the types of runs that are ok, ``steady`` (runs in the
    steady direction with a theory and without dissipation), ``bondi`` (those of them
    beyond Bondi's threshold), ``near_tangencies`` (their sum), and, where the rows have
    the columns, ``sensitive unsure``, the names of shares in the summary, and regimes
    after ``regime_``.
    """

    def __init__(self, cells: int, keeps_times: bool = False) -> None:
        super().__init__()
        self._cells = cells
        # Reversal times themselves, for medians and tails, where they are asked for.
        self.times = Sample(cells) if keeps_times else None
        # Of runs of type R; the ratio t_r / t_rgh is taken run by run.
        self.t_r = Moments(cells)
        self.t_r_error = Moments(cells)
        self.ratio = Moments(cells)
        # Of all runs.
        self.t_rgh = Moments(cells)
        # In SI units, where the size of the bodies is known.
        self.t_r_s = Moments(cells)
        self.n_i_rpm = Moments(cells)

    def __missing__(self, name: str) -> Integers:
        # Sums of a number of each run may be larger than that of the runs.
        kind = np.int64 if name == "near_tangencies" else np.int32
        return np.zeros(self._cells, kind)

    @property
    def types(self) -> dict[str, Integers]:
        """Runs by type; D only with dissipation."""
        return {
            name: self[name]
            for name in TYPES
            if name != TYPES[CODE_DEAD] or name in self
        }

    def add(self, rows: pa.Table, cell: Integers) -> None:
        """Add runs to cells; a negative cell leaves a run out."""
        names = {*columns_for(rows.schema)} - {"type", "status", "regime"}
        columns = {name: arrow.floats(rows.column(name)) for name in names}
        type_codes = codes(rows.column("type"))
        is_ok = codes(rows.column("status"), ("ok",)) == 0
        is_counted = cell >= 0
        numbers = _numbers(columns, type_codes, is_ok)
        if "regime" in rows.schema.names:
            regime_codes = codes(rows.column("regime"), REGIMES)
            for code, regime in enumerate(REGIMES):
                numbers[f"regime_{regime}"] = is_ok & (regime_codes == code)
        for name, number in numbers.items():
            sums = self[name]
            self[name] = sums
            # Adding no zeros leaves arrays of zeros without memory of their own.
            is_added = is_counted & (number != 0)
            np.add.at(sums, cell[is_added], number[is_added].astype(sums.dtype))
        reverses = is_ok & (type_codes == CODE_R)
        for values_of_cells, values in self._averaged(columns, reverses):
            has_value = is_counted & np.isfinite(values)
            values_of_cells.add(cell[has_value], values[has_value])

    def _averaged(
        self, columns: dict[str, Floats], reverses: Flags
    ) -> Iterator[tuple[Moments | Sample, Floats]]:
        """Yield what takes values of runs, and these values; NaN does not count."""
        of_reversals: list[tuple[str, Moments | Sample]] = [
            ("t_r", self.t_r),
            ("t_r_error", self.t_r_error),
            ("t_r_s", self.t_r_s),
        ]
        if self.times is not None:
            of_reversals.append(("t_r", self.times))
        for name, values_of_cells in of_reversals:
            if name in columns:
                yield values_of_cells, np.where(reverses, columns[name], np.nan)
        ratio = share(columns["t_r"], columns["t_rgh"])
        yield self.ratio, np.where(reverses, ratio, np.nan)
        yield self.t_rgh, columns["t_rgh"]
        if "n_i_rpm" in columns:
            yield self.n_i_rpm, columns["n_i_rpm"]


def _numbers(
    columns: dict[str, Floats], type_codes: Integers, is_ok: Flags
) -> dict[str, Flags | Integers]:
    """Return what :class:`Counts` adds up, by run."""
    n_i = columns["n_i"]
    is_steady = np.isfinite(columns["omega_p"]) & ~unsteady(columns["K_p"], n_i)
    types = TYPES[:CODE_DEAD]
    for name in COUPLE_CONSTANTS & columns.keys():
        types = TYPES
        is_steady &= columns[name] == 0
    numbers: dict[str, Flags | Integers] = {
        "runs": np.ones(len(is_ok), bool),
        "ok": is_ok,
        "failed": ~is_ok,
        "steady": is_steady,
        "bondi": is_steady & (np.abs(columns["n_c1"]) < np.abs(n_i)),
        "near_tangencies": np.nan_to_num(columns["near_tangencies"]).astype(np.int64),
    }
    for code, name in enumerate(types):
        numbers[name] = is_ok & (type_codes == code)
    if "t_r_error" in columns:
        is_sensitive = columns["t_r_error"] > SENSITIVE * columns["t_r"]
        numbers["sensitive"] = is_ok & (type_codes == CODE_R) & is_sensitive
        numbers["unsure"] = (type_codes >= 0) & (columns["type_sure"] == 0)
    if "contact_ratio_max" in columns:
        for name, friction in _FRICTION.items():
            numbers[name] = is_ok & (columns["contact_ratio_max"] > friction)
        numbers["share_lift_off"] = is_ok & (columns["contact_normal_min"] < 0)
    if "t_slide" in columns:
        numbers["share_slid"] = is_ok & np.isfinite(columns["t_slide"])
    return numbers


class Moments:
    """Number, mean and deviation by cell.

    Differences from the first value are summed, so that a large mean costs no digits.
    Where each cell has one run, all of them are zero and take no memory.
    """

    def __init__(self, cells: int) -> None:
        self.count = np.zeros(cells, np.int32)  # a sweep has at most 10^9 runs
        self._first = np.zeros(cells)
        self._sum = np.zeros(cells)
        self._squares = np.zeros(cells)

    def add(self, cell: Integers, values: Floats) -> None:
        """Add values to cells."""
        in_new_cell = np.flatnonzero(self.count[cell] == 0)
        cells, place = np.unique(cell[in_new_cell], return_index=True)
        self._first[cells] = values[in_new_cell[place]]
        step = values - self._first[cell]
        # One by one and in order; np.bincount would sum each batch separately.
        np.add.at(self.count, cell, 1)
        differs = step != 0
        cell = cell[differs]
        step = step[differs]
        np.add.at(self._sum, cell, step)
        # An infinite deviation is stored as null.
        with np.errstate(over="ignore"):
            np.add.at(self._squares, cell, step**2)

    def means(self) -> Floats:
        """Return the means, NaN without values."""
        return self._first + share(self._sum, self.count)

    def deviations(self) -> Floats:
        """Return the sample standard deviations (n - 1), NaN for fewer than two."""
        with np.errstate(over="ignore", invalid="ignore"):
            squares = self._squares - share(self._sum**2, np.maximum(self.count, 1))
            return np.sqrt(share(np.maximum(squares, 0), self.count - 1))

    def common(self) -> Floats:
        """Return the value that all runs of a cell share to rounding, or NaN."""
        mean = self.means()
        deviation = np.nan_to_num(self.deviations())
        return np.where(deviation <= 1e-12 * np.abs(mean), mean, np.nan)

    def errors(self) -> Floats:
        """Return the standard errors of the means, NaN for fewer than two."""
        return share(self.deviations(), np.sqrt(self.count))


class Sample:
    """The first values of each cell, at most `MOST_KEPT` of them."""

    def __init__(self, cells: int) -> None:
        self._count = np.zeros(cells, np.int64)
        self._cells: list[Integers] = []
        self._values: list[Floats] = []

    def add(self, cell: Integers, values: Floats) -> None:
        """Add values to cells that are not full."""
        has_room = self._count[cell] < MOST_KEPT
        self._cells.append(cell[has_room])
        self._values.append(values[has_room])
        self._count += np.bincount(cell[has_room], minlength=len(self._count))

    def each(self, function: Callable[[Floats], float]) -> Floats:
        """Return a function of the values of each cell, NaN without values."""
        results = np.full(len(self._count), np.nan)
        if not self._count.any():
            return results
        cell = np.concatenate(self._cells)
        order = np.argsort(cell, kind="stable")
        values = np.concatenate(self._values)[order]
        ends = np.cumsum(self._count)
        for number in np.flatnonzero(self._count):
            first = ends[number] - self._count[number]
            results[number] = function(values[first : ends[number]][:MOST_KEPT])
        return results


def summary_table(cases: Sequence[Case], counts: Counts) -> pa.Table:
    """Return the summary of cases whose runs are counted."""
    columns = {column.name: column.value(cases, counts) for column in _COLUMNS}
    return arrow.build_table(columns, SCHEMA)


_Value = Callable[[Sequence[Case], Counts], Values]


@dataclass(frozen=True)
class SummaryColumn:
    """A column of `summary`, and where its value comes from."""

    name: str
    value: _Value
    meaning: str
    unit: str = "1"
    type: pa.DataType = F64
    nullable: bool = True

    @property
    def field(self) -> pa.Field:
        """The column of the Arrow schema."""
        return arrow.field(self.name, self.type, self.unit, self.meaning, self.nullable)


def _target(name: str) -> _Value:
    """Return the target of a coefficient, where the case has one."""

    def value(cases: Sequence[Case], counts: Counts) -> Floats:
        targets = [case.target if case.target_name == name else None for case in cases]
        return np.array(targets, float)

    return value


def _held(name: str) -> _Value:
    """Return a launch or loss in units of the bodies, NaN where it is in SI units."""
    return lambda cases, counts: np.array([case.value(name) for case in cases], float)


def _held_in_si(name: str) -> _Value:
    """Return a launch or loss in SI units, NaN where it is in units of the bodies."""
    return lambda cases, counts: _in_si(cases, name)


def _spin_in_rpm(cases: Sequence[Case], counts: Counts) -> Floats:
    """Return the spin in rpm, which is known too where all bodies have one size."""
    of_cases = _in_si(cases, "n_i")
    return np.where(np.isnan(of_cases), counts.n_i_rpm.common(), of_cases)


def _in_si(cases: Sequence[Case], name: str) -> Floats:
    return np.array([case.setting(name).si for case in cases], float) / SI[name][1]


def _number(name: str) -> _Value:
    """Return a number of runs, null if nothing of the kind is counted."""

    def value(cases: Sequence[Case], counts: Counts) -> Values:
        if name in counts or name in ALWAYS_COUNTED:
            return counts[name]
        return pa.nulls(len(cases), I64)

    return value


def _share(name: str, whole: str = "ok") -> _Value:
    """Return a share of runs, null if nothing of the kind is counted."""

    def value(cases: Sequence[Case], counts: Counts) -> Values:
        if name in counts:
            return share(counts[name], counts[whole])
        return pa.nulls(len(cases), F64)

    return value


def _moment(name: str, of_cells: Callable[[Moments], Floats]) -> _Value:
    """Return means, deviations or errors of a quantity of the runs."""
    return lambda cases, counts: of_cells(getattr(counts, name))


def _of_times(function: Callable[[Floats], float]) -> _Value:
    """Return a function of the reversal times, null where they were not kept."""

    def value(cases: Sequence[Case], counts: Counts) -> Values:
        if counts.times is None:
            return pa.nulls(len(cases), F64)
        return counts.times.each(function)

    return value


def _median(values: Floats) -> float:
    return float(np.median(values))


ALWAYS_COUNTED = ("runs", "failed", "near_tangencies")
_must = partial(SummaryColumn, nullable=False)

# The columns of `summary` in order; fractions are of the runs with status ok. What
# differs between the rows of a case is null.
_COLUMNS = (
    _must(
        "case",
        lambda cases, counts: np.arange(len(cases)),
        "number of the case, from 0",
        type=I32,
    ),
    SummaryColumn(
        "mesh",
        lambda cases, counts: pa.array([case.mesh for case in cases], TEXT),
        "file of the body; null: bodies are no meshes",
        type=TEXT,
    ),
    SummaryColumn("K_p", _target("K_p"), "target of K_p; null: none"),
    SummaryColumn("K_r", _target("K_r"), "target of K_r; null: none"),
    SummaryColumn("n_i", _held("n_i"), "initial spin", RATE),
    SummaryColumn("omega_xy0", _held("omega_xy0"), "initial oscillation", RATE),
    _must("runs", _number("runs"), "number of stored runs", type=I64),
    # Null unless the size of the bodies is known.
    SummaryColumn("n_i_rpm", _spin_in_rpm, "initial spin", "rpm"),
    # Null unless given in these units, and the sizes of the bodies differ.
    SummaryColumn(
        "omega_xy0_rpm", _held_in_si("omega_xy0"), "initial oscillation", "rpm"
    ),
    *(
        SummaryColumn(
            each.measure.name, _held_in_si(name), each.meaning, each.measure.unit
        )
        for name, each in ACTING.items()
        if each.measure is not None
    ),
    SummaryColumn("fraction_R", _share("R"), "fraction that reverses (type R)"),
    SummaryColumn("fraction_SS", _share("SS"), "fraction that spins steadily (SS)"),
    SummaryColumn("fraction_SW", _share("SW"), "fraction that wobbles (SW)"),
    SummaryColumn(
        "fraction_unclassified", _share("unclassified"), "fraction of unclassified runs"
    ),
    SummaryColumn(
        "fraction_bondi",
        _share("bondi", "steady"),
        "fraction beyond Bondi's threshold; null: unsteady spins",
    ),
    SummaryColumn(
        "t_r_mean", _moment("t_r", Moments.means), "mean reversal time (type R)", TIME
    ),
    SummaryColumn(
        "t_r_s_mean",
        _moment("t_r_s", Moments.means),
        "mean reversal time, if sizes are known",
        "s",
    ),
    SummaryColumn(
        "t_r_std",
        _moment("t_r", Moments.deviations),
        "standard deviation (n - 1) of the reversal times",
        TIME,
    ),
    SummaryColumn(
        "t_rgh_mean",
        _moment("t_rgh", Moments.means),
        "mean reversal time of theory",
        TIME,
    ),
    SummaryColumn(
        "t_r_over_t_rgh_mean", _moment("ratio", Moments.means), "mean of t_r / t_rgh"
    ),
    SummaryColumn(
        "t_r_over_t_rgh_sem",
        _moment("ratio", Moments.errors),
        "standard error of this mean",
    ),
    _must(
        "failed",
        _number("failed"),
        "number of runs with a status other than ok",
        type=I64,
    ),
    _must(
        "near_tangencies",
        _number("near_tangencies"),
        "sum of near_tangencies over the runs",
        type=I64,
    ),
    SummaryColumn(
        "t_r_median",
        _of_times(_median),
        f"median reversal time (type R), of the first {MOST_KEPT:,} runs",
        TIME,
    ),
    SummaryColumn(
        "t_r_tail",
        _of_times(tail_index),
        "tail index of the reversal times (Hill); below 2, the mean may not exist and "
        "its error means nothing; null: fewer than 100 of type R",
    ),
    # Null unless errors are recorded.
    SummaryColumn(
        "sensitive",
        _number("sensitive"),
        "number of runs of type R with t_r_error > 1e-6 t_r",
        type=I64,
    ),
    SummaryColumn(
        "unsure", _number("unsure"), "number of runs whose type is not sure", type=I64
    ),
    SummaryColumn(
        "t_r_mean_error", _moment("t_r_error", Moments.means), "mean of t_r_error", TIME
    ),
    # Null without dissipation.
    SummaryColumn("fraction_D", _share("D"), "fraction that dies (type D)"),
    *(
        SummaryColumn(name, _held(name), f"{each.meaning}; null: none", each.unit)
        for name, each in ACTING.items()
    ),
    # Null unless contact is recorded.
    *(
        SummaryColumn(
            name,
            _share(name),
            f"fraction that needs friction > {friction} to roll, by contact_ratio_max",
        )
        for name, friction in _FRICTION.items()
    ),
    SummaryColumn(
        "share_lift_off",
        _share("share_lift_off"),
        "fraction that would lift off, with contact_normal_min < 0",
    ),
    # Null without dissipation.mu.
    SummaryColumn("share_slid", _share("share_slid"), "fraction that slides"),
)
SCHEMA = pa.schema([column.field for column in _COLUMNS])


@dataclass(frozen=True)
class Printed:
    """A column of the table that is printed."""

    name: str
    heading: str
    form: str = ".3f"
    # Whether it is left out where it is null in all cases.
    optional: bool = False
    # Whether it is left out where it is the same in all cases.
    varies: bool = False
    # The column in SI units that stands in its place where that is known.
    si: str = ""
    # From the unit of the column to that of the heading.
    factor: float = 1.0


def _printed_losses() -> Iterator[Printed]:
    """Yield the columns of each constant of an action, also in SI units."""
    for name, constant in ACTING.items():
        measure = constant.measure
        if measure is None:
            yield Printed(name, name, ".4g", optional=True, varies=True)
            continue
        yield Printed(name, name, ".4g", varies=True, si=measure.name)
        unit = measure.unit
        factor = 1.0
        if unit == "m":  # levers are far below 1 mm
            unit = "um"
            factor = 1e6
        heading = f"{name} ({unit})"
        yield Printed(
            measure.name, heading, ".4g", optional=True, varies=True, factor=factor
        )


PRINTED = (
    Printed("n_i", "n_i", ".4g", si="n_i_rpm"),
    Printed("n_i_rpm", "n_i (rpm)", ".4g", optional=True),
    Printed("omega_xy0", "omega_xy0", ".4g", si="omega_xy0_rpm"),
    Printed("omega_xy0_rpm", "omega_xy0 (rpm)", ".4g", optional=True),
    *_printed_losses(),
    Printed("runs", "runs", "d"),
    Printed("fraction_R", "R"),
    Printed("fraction_SS", "SS"),
    Printed("fraction_SW", "SW"),
    Printed("fraction_unclassified", "uncl."),
    Printed("fraction_D", "D", optional=True),
    Printed("fraction_bondi", "Bondi"),
    Printed("t_r_mean", "mean t_r", ".5g", si="t_r_s_mean"),
    Printed("t_r_s_mean", "mean t_r (s)", ".5g", optional=True),
    Printed("t_r_over_t_rgh_mean", "t_r/t_rGH", ".4f"),
    Printed("sensitive", "sensitive", "d", optional=True),
    Printed("unsure", "unsure", "d", optional=True),
    Printed("share_friction_above_0_3", "friction>0.3", optional=True),
    Printed("share_friction_above_0_6", "friction>0.6", optional=True),
    Printed("share_lift_off", "lift-off", optional=True),
    Printed("share_slid", "slid", optional=True),
    Printed("failed", "failed", "d"),
)


def closing_table(summary: pa.Table) -> str:
    """Return the summary as aligned text, with "-" for null."""
    absent = absent_columns(summary)
    printed = [column for column in PRINTED if column.name not in absent]
    lines = [["case", "target", *(column.heading for column in printed)]]
    for row in summary.to_pylist():
        targets = [f"{k}={row[k]:.4g}" for k in ("K_p", "K_r") if row[k] is not None]
        if row.get("mesh") is not None:
            targets = [one_line(row["mesh"])]
        line = [str(row["case"]), *(targets or ["-"])]
        for column in printed:
            value = row[column.name]
            text = "-"
            if value is not None:
                if column.factor != 1.0:
                    value *= column.factor
                text = format(value, column.form)
            line.append(text)
        lines.append(line)
    return align(lines)


def doubts_of_means(summary: pa.Table) -> str | None:
    """Return a sentence on cases whose mean reversal time may not exist, or None."""
    if "t_r_tail" not in summary.schema.names:  # an older version wrote it
        return None
    tails = arrow.floats(summary.column("t_r_tail"))
    is_heavy = tails < LEAST_INDEX
    if not is_heavy.any():
        return None
    first = int(np.argmax(is_heavy))
    which = f"case {first}"
    if is_heavy.sum() > 1:
        which = f"{is_heavy.sum()} cases, of which {first} is the first"
    median = arrow.floats(summary.column("t_r_median"))[first]
    return (
        f"the mean reversal time of {which} depends on the few longest runs and may "
        f"not exist (tail index {tails[first]:.2g}, below {LEAST_INDEX:g}); the median "
        f"of case {first} is {median:.5g} (column t_r_median)"
    )


def absent_columns(summary: pa.Table) -> set[str]:
    """Return the columns to leave out, which are null or the same in all cases."""

    def is_empty(name: str) -> bool:
        return bool(summary.column(name).null_count == len(summary))

    absent: set[str] = set()
    for column in PRINTED:
        is_constant = len(summary.column(column.name).unique()) < 2
        # Of a quantity in both systems, SI units are shown.
        has_si = bool(column.si) and not is_empty(column.si)
        if (
            (column.optional and is_empty(column.name))
            or (column.varies and is_constant)
            or has_si
        ):
            absent.add(column.name)
    return absent
