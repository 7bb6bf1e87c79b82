"""The summary, with one row a case, and the counts by cell from which it is made.

A cell is a case, or a pixel of a map.  Rows are added one by one in the order of their keys, so
that sums do not depend on how rows are spread over files.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.physics.theory import unsteady
from rattlesweep.sweeps import columns as tables
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.decide import nearest_rows
from rattlesweep.sweeps.stored import SUMMARY, VARIES, Case, Stored
from rattlesweep.sweeps.types import DEAD, TYPES, R, codes, share
from rattlesweep.text import align

COLUMNS = ("n_i", "K_p", "omega_p", "n_c1", "t_rgh", "t_r", "type", "status", "near_tangencies")
# Shares of runs that need a coefficient of friction above these.
FRICTION = {"share_friction_above_0_3": 0.3, "share_friction_above_0_6": 0.6}
SENSITIVE = 1e-6  # relative error of t_r above which a run is sensitive


def read_summary(stored: Stored) -> pa.Table:
    """Return ``summary.parquet``, or a summary of the rows so far if there is no such file."""
    path = stored.directory / SUMMARY
    return tables.read_parquet(path) if path.exists() else summarise(stored)


def write_summary(stored: Stored) -> pa.Table:
    """Write ``summary.parquet`` from the rows, and return it."""
    table = summarise(stored)
    tables.write_parquet(table, stored.directory / SUMMARY)
    return table


def summarise(stored: Stored) -> pa.Table:
    """Return the summary of the rows on disk; cases without rows have 0 runs."""
    return summary_table(stored.cases, count_cases(stored))


def count_cases(stored: Stored) -> Counts:
    """Count runs by case; in a refined sweep, each weighs as many points as it is nearest to."""
    cases, names = len(stored.cases), ("case", *columns_for(stored.config))
    counts = Counts(cases)
    for rows in stored.batches(names):
        counts.add(rows, rows.column("case").to_numpy().astype(np.int64))
    if stored.config.deciding_key != "bodies.refine":
        return counts
    weighted, runs = Counts(cases), stored.read(names)
    for case, nearest in nearest_rows(stored):
        row, weight = np.unique(nearest[nearest >= 0], return_counts=True)
        weighted.add(runs.take(pa.array(row)), np.full(len(row), case), weight)
    weighted.runs, weighted.failed = counts.runs, counts.failed
    return weighted


def columns_for(config: Config) -> tuple[str, ...]:
    """Return the columns of a sweep's runs that :meth:`Counts.add` reads."""
    losses = ("energy_left", "sigma", "rolling") if config.dissipation else ()
    errors = ("t_r_error", "type_sure") if "error" in config.record else ()
    contact = ("contact_ratio_max", "contact_normal_min") if "contact" in config.record else ()
    return (*COLUMNS, *errors, *losses, *contact)


class Counts:
    """Runs by cell; each array has the shape (cells,)."""

    def __init__(self, cells: int) -> None:
        def zeros(count: int) -> list[Integers]:
            return [*np.zeros((count, cells), np.int64)]

        self.runs, self.ok, self.failed, self.near_tangencies, self.sensitive = zeros(5)
        # Runs in the steady direction with a theory and without dissipation, and those of them
        # beyond Bondi's threshold: abs(n_c1) < abs(n_i).
        self.steady, self.bondi = zeros(2)
        # Runs that are ok by type (D only with dissipation), those of them whose type is not sure,
        # and those that need more friction or lift off.
        self.types = dict(zip(TYPES[:DEAD], zeros(DEAD), strict=True))
        self.unsure_types = dict(zip(TYPES[:DEAD], zeros(DEAD), strict=True))
        self.contact = dict(zip((*FRICTION, "share_lift_off"), zeros(3), strict=True))
        # Of type R, with the ratio t_r / t_rgh taken run by run; but t_rgh of all runs.
        self.t_r, self.t_r_error, self.ratio, self.t_rgh = (Moments(cells) for _ in range(4))
        self.has_errors = self.has_contact = False  # whether the rows have these columns

    def add(self, rows: pa.Table, cell: Integers, weight: Integers | None = None) -> None:
        """Add runs to cells, each as often as its weight; a negative cell leaves a run out."""
        kept, names = cell >= 0, rows.schema.names
        cell = cell[kept]
        weight = np.ones(len(cell), np.int64) if weight is None else weight[kept]

        def column(name: str) -> Floats:
            return tables.floats(rows.column(name))[kept]

        def count(into: Integers, which: Flags) -> None:
            np.add.at(into, cell[which], weight[which])

        def average(into: Moments, values: Floats, which: Flags) -> None:
            into.add(cell[which], values[which], weight[which])

        n_i, t_r, t_rgh = column("n_i"), column("t_r"), column("t_rgh")
        kind = codes(rows.column("type"))[kept]
        ok = codes(rows.column("status"), ("ok",))[kept] == 0
        steady = np.isfinite(column("omega_p")) & ~unsteady(column("K_p"), n_i)
        if "energy_left" in names:
            for types in (self.types, self.unsure_types):
                types.setdefault("D", np.zeros(len(self.runs), np.int64))
            steady &= (column("sigma") == 0) & (column("rolling") == 0)
        count(self.runs, np.ones(len(cell), bool))
        count(self.ok, ok)
        count(self.failed, ~ok)
        for name, into in self.types.items():
            count(into, ok & (kind == TYPES.index(name)))
        near = np.nan_to_num(column("near_tangencies")).astype(np.int64)
        np.add.at(self.near_tangencies, cell, weight * near)
        count(self.steady, steady)
        count(self.bondi, steady & (np.abs(column("n_c1")) < np.abs(n_i)))
        reverses = ok & (kind == R) & np.isfinite(t_r)
        average(self.t_r, t_r, reverses)
        average(self.t_rgh, t_rgh, np.isfinite(t_rgh))
        ratio = share(t_r, t_rgh)
        average(self.ratio, ratio, reverses & np.isfinite(ratio))
        if "t_r_error" in names:
            self.has_errors, error = True, column("t_r_error")
            average(self.t_r_error, error, reverses & np.isfinite(error))
            count(self.sensitive, reverses & (error > SENSITIVE * t_r))
            for name, into in self.unsure_types.items():
                count(into, (column("type_sure") == 0) & (kind == TYPES.index(name)))
        if "contact_ratio_max" in names:
            self.has_contact, friction = True, column("contact_ratio_max")
            for name, most in FRICTION.items():
                count(self.contact[name], ok & (friction > most))
            count(self.contact["share_lift_off"], ok & (column("contact_normal_min") < 0))

    @property
    def unsure(self) -> Integers:
        """Runs whose type is not sure."""
        return np.asarray(sum(self.unsure_types.values()))


class Moments:
    """Number, mean and deviation by cell, by differences, so that a large mean costs no digits."""

    def __init__(self, cells: int) -> None:
        self.count = np.zeros(cells, np.int64)
        self._first, self._sum, self._squares = np.zeros((3, cells))

    def add(self, cell: Integers, values: Floats, weight: Integers | int = 1) -> None:
        """Add values to cells, each as often as its weight."""
        new = np.flatnonzero(self.count[cell] == 0)
        cells, place = np.unique(cell[new], return_index=True)
        self._first[cells] = values[new[place]]
        step = values - self._first[cell]
        # One by one and in order; np.bincount would sum each batch separately.
        np.add.at(self.count, cell, weight)
        np.add.at(self._sum, cell, weight * step)
        with np.errstate(over="ignore"):  # the deviation is then infinite, and stored as null
            np.add.at(self._squares, cell, weight * step**2)

    def means(self) -> Floats:
        """Return the means, NaN without values."""
        return self._first + share(self._sum, self.count)

    def deviations(self) -> Floats:
        """Return the sample standard deviations (divisor n - 1), NaN for fewer than two."""
        with np.errstate(over="ignore", invalid="ignore"):
            squares = self._squares - share(self._sum**2, np.maximum(self.count, 1))
            return np.sqrt(share(np.maximum(squares, 0), self.count - 1))

    def errors(self) -> Floats:
        """Return the standard errors of the means, NaN for fewer than two."""
        return share(self.deviations(), np.sqrt(self.count))


def summary_table(cases: Sequence[Case], counts: Counts) -> pa.Table:
    """Return the summary of cases whose runs are counted."""
    schema, ok = tables.SUMMARY, counts.ok
    columns: dict[str, Any] = {field.name: pa.nulls(len(cases), field.type) for field in schema}
    for name in ("K_p", "K_r"):
        targets = [case.target if case.target_name == name else None for case in cases]
        columns[name] = np.array(targets, float)
    for name in VARIES:
        columns[name] = np.array([getattr(case, name) for case in cases], float)
    columns |= {f"fraction_{name}": share(part, ok) for name, part in counts.types.items()}
    columns |= {name: getattr(counts, name) for name in ("runs", "failed", "near_tangencies")}
    columns |= {
        "case": np.arange(len(cases)),
        "fraction_bondi": share(counts.bondi, counts.steady),
        "t_r_mean": counts.t_r.means(), "t_r_std": counts.t_r.deviations(),
        "t_rgh_mean": counts.t_rgh.means(), "t_r_mean_error": counts.t_r_error.means(),
        "t_r_over_t_rgh_mean": counts.ratio.means(), "t_r_over_t_rgh_sem": counts.ratio.errors(),
    }  # fmt: skip
    if counts.has_errors:
        columns |= {"sensitive": counts.sensitive, "unsure": counts.unsure}
    if counts.has_contact:
        columns |= {name: share(part, ok) for name, part in counts.contact.items()}
    return tables.build_table(columns, schema)


# Columns of the summary that are printed, with their headings and formats.
_SHOWN = {
    "n_i": ("n_i", ".4g"), "omega_xy0": ("omega_xy0", ".4g"),
    "sigma": ("sigma", ".4g"), "rolling": ("rolling", ".4g"), "runs": ("runs", "d"),
    "fraction_R": ("R", ".3f"), "fraction_SS": ("SS", ".3f"), "fraction_SW": ("SW", ".3f"),
    "fraction_unclassified": ("unclassified", ".3f"), "fraction_D": ("D", ".3f"),
    "fraction_bondi": ("beyond Bondi", ".3f"), "t_r_mean": ("mean t_r", ".5g"),
    "t_r_over_t_rgh_mean": ("mean t_r/t_rGH", ".4f"), "sensitive": ("sensitive", "d"),
    "unsure": ("type unsure", "d"), "share_friction_above_0_3": ("friction > 0.3", ".3f"),
    "share_friction_above_0_6": ("friction > 0.6", ".3f"), "share_lift_off": ("lift-off", ".3f"),
    "failed": ("failed", "d"),
}  # fmt: skip


def closing_table(summary: pa.Table) -> str:
    """Return the summary as aligned text, with "-" for null."""
    absent = absent_columns(summary)
    shown = {name: how for name, how in _SHOWN.items() if name not in absent}
    lines = [["case", "target", *(heading for heading, _ in shown.values())]]
    for row in summary.to_pylist():
        targets = [f"{k}={row[k]:.4g}" for k in ("K_p", "K_r") if row[k] is not None]
        values = ((row[name], form) for name, (_, form) in shown.items())
        cells = ("-" if value is None else format(value, form) for value, form in values)
        lines.append([str(row["case"]), *(targets or ["-"]), *cells])
    return align(lines)


def absent_columns(summary: pa.Table) -> set[str]:
    """Return the columns to leave out, which are null or the same in all cases."""
    optional = ("sensitive", "unsure", "fraction_D", "share_lift_off", *FRICTION)
    absent = {n for n in optional if summary.column(n).null_count == len(summary)}
    return absent | {n for n in ("sigma", "rolling") if len(summary.column(n).unique()) < 2}
