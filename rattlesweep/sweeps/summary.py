"""The summary, with one row a case, and the counts by cell from which it is made.

A cell is a case, or a pixel of a map.  Rows are added one by one in the order of their
keys, so that sums do not depend on how rows are spread over files.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.physics.theory import unsteady
from rattlesweep.sweeps import columns as tables
from rattlesweep.sweeps.bodies.table import WITH_UNITS
from rattlesweep.sweeps.decide import nearest_rows
from rattlesweep.sweeps.parquet import read_parquet, write_parquet
from rattlesweep.sweeps.skipped import estimate
from rattlesweep.sweeps.stored import SUMMARY, VARIES, Case, Stored
from rattlesweep.sweeps.types import DEAD, TYPES, R, codes, share
from rattlesweep.text import align
from rattlesweep.units import Quantity

# Columns that the counts are made of; not all runs have the later ones.
COLUMNS = (
    "n_i",
    "K_p",
    "omega_p",
    "n_c1",
    "t_rgh",
    "t_r",
    "type",
    "status",
    "near_tangencies",
    "sigma",
    "rolling",
    "t_r_error",
    "type_sure",
    "contact_ratio_max",
    "contact_normal_min",
    "t_r_s",
    "n_i_rpm",
)
# Launches and losses by their names: the name and the size of the unit of the column in
# SI units.
SI = {name: (si, size) for si, (name, size, _) in WITH_UNITS.items() if name in VARIES}
# Shares of runs that need a coefficient of friction above these.
FRICTION = {"share_friction_above_0_3": 0.3, "share_friction_above_0_6": 0.6}
# Times that are interpolated at the points that a refined sweep skips.
INTERPOLATED = ("t_r", "t_r_s", "t_rgh", "t_r_error")
SENSITIVE = 1e-6  # relative error of t_r above which a run is sensitive


def read_summary(stored: Stored) -> pa.Table:
    """Return ``summary.parquet``, or a summary of the rows so far if there is no such
    file.
    """
    path = stored.directory / SUMMARY
    return read_parquet(path) if path.exists() else summarise(stored)


def write_summary(stored: Stored) -> pa.Table:
    """Write ``summary.parquet`` from the rows, and return it."""
    table = summarise(stored)
    write_parquet(table, stored.directory / SUMMARY)
    return table


def summarise(stored: Stored) -> pa.Table:
    """Return the summary of the rows on disk; cases without rows have 0 runs."""
    return summary_table(stored.cases, count_cases(stored))


def count_cases(stored: Stored) -> Counts:
    """Count runs by case; in a refined sweep, count all points of its grid.

    A skipped point counts as the nearest run, with interpolated times.
    """
    cases = len(stored.cases)
    names = ("case", *columns_for(stored.schema))
    counts = Counts(cases)
    for rows in stored.batches(names):
        counts.add(rows, rows.column("case").to_numpy().astype(np.int64))
    if stored.config.deciding_key != "bodies.refine":
        return counts
    runs = stored.read(names)
    nearest = np.stack([rows for _, rows in nearest_rows(stored)])
    estimates = {
        name: estimate(stored, tables.floats(runs.column(name)), nearest)
        for name in INTERPOLATED
        if name in names
    }
    points = Counts(cases)
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
    return [name for name in COLUMNS if name in schema.names]


class Counts(dict[str, Integers]):
    """Numbers of runs with some property, by its name, in arrays of shape (cells,).

    Names are ``runs ok failed``, the types of runs that are ok, ``steady`` (runs in the
    steady direction with a theory and without dissipation), ``bondi`` (those of them
    beyond Bondi's threshold), ``near_tangencies`` (their sum), and, where the rows have
    the columns, ``sensitive unsure`` and the names of shares in the summary.
    """

    def __init__(self, cells: int) -> None:
        super().__init__()
        self._cells = cells
        # Of type R, with the ratio t_r / t_rgh taken run by run; but t_rgh of all runs.
        self.t_r, self.t_r_error, self.ratio, self.t_rgh = (
            Moments(cells) for _ in range(4)
        )
        # In SI units, where the size of the bodies is known.
        self.t_r_s, self.n_i_rpm = Moments(cells), Moments(cells)

    def __missing__(self, name: str) -> Integers:
        return np.zeros(self._cells, np.int64)

    @property
    def types(self) -> dict[str, Integers]:
        """Runs by type; D only with dissipation."""
        return {
            name: self[name] for name in TYPES if name != TYPES[DEAD] or name in self
        }

    def add(self, rows: pa.Table, cell: Integers) -> None:
        """Add runs to cells; a negative cell leaves a run out."""
        numbers, values = _measured(rows)
        for name, number in numbers.items():
            into = self.setdefault(name, self[name])
            np.add.at(into, cell[cell >= 0], number[cell >= 0])
        for name, own in values.items():
            kept = (cell >= 0) & np.isfinite(own)
            moments: Moments = getattr(self, name)
            moments.add(cell[kept], own[kept])


def _measured(rows: pa.Table) -> tuple[dict[str, Flags | Integers], dict[str, Floats]]:
    """Return the numbers that :class:`Counts` adds up, and the values that it averages,
    by run.
    """
    names = {*columns_for(rows.schema)} - {"type", "status"}
    x = {name: tables.floats(rows.column(name)) for name in names}
    n_i, t_r, t_rgh, kind = x["n_i"], x["t_r"], x["t_rgh"], codes(rows.column("type"))
    ok = codes(rows.column("status"), ("ok",)) == 0
    steady = np.isfinite(x["omega_p"]) & ~unsteady(x["K_p"], n_i)
    types = TYPES[:DEAD]
    if "sigma" in names:
        types, steady = TYPES, steady & (x["sigma"] == 0) & (x["rolling"] == 0)
    reverses = ok & (kind == R) & np.isfinite(t_r)
    numbers: dict[str, Flags | Integers] = {
        "runs": np.ones(len(ok), bool),
        "ok": ok,
        "failed": ~ok,
        "steady": steady,
        "bondi": steady & (np.abs(x["n_c1"]) < np.abs(n_i)),
        "near_tangencies": np.nan_to_num(x["near_tangencies"]).astype(np.int64),
    }
    numbers |= {name: ok & (kind == code) for code, name in enumerate(types)}
    values = {"t_r": t_r, "ratio": share(t_r, t_rgh)}
    if "t_r_error" in names:
        values["t_r_error"] = error = x["t_r_error"]
        numbers["sensitive"] = reverses & (error > SENSITIVE * t_r)
        numbers["unsure"] = (kind >= 0) & (x["type_sure"] == 0)
    if "contact_ratio_max" in names:
        for name, most in FRICTION.items():
            numbers[name] = ok & (x["contact_ratio_max"] > most)
        numbers["share_lift_off"] = ok & (x["contact_normal_min"] < 0)
    values |= {name: x[name] for name in ("t_r_s",) if name in names}
    reversing = {name: np.where(reverses, own, np.nan) for name, own in values.items()}
    return numbers, reversing | {
        name: x[name] for name in ("t_rgh", "n_i_rpm") if name in names
    }


class Moments:
    """Number, mean and deviation by cell, by differences, so that a large mean costs no
    digits.
    """

    def __init__(self, cells: int) -> None:
        self.count = np.zeros(cells, np.int64)
        self._first, self._sum, self._squares = np.zeros((3, cells))

    def add(self, cell: Integers, values: Floats) -> None:
        """Add values to cells."""
        new = np.flatnonzero(self.count[cell] == 0)
        cells, place = np.unique(cell[new], return_index=True)
        self._first[cells] = values[new[place]]
        step = values - self._first[cell]
        # One by one and in order; np.bincount would sum each batch separately.
        np.add.at(self.count, cell, 1)
        np.add.at(self._sum, cell, step)
        with np.errstate(
            over="ignore"
        ):  # the deviation is then infinite, and stored as null
            np.add.at(self._squares, cell, step**2)

    def means(self) -> Floats:
        """Return the means, NaN without values."""
        return self._first + share(self._sum, self.count)

    def deviations(self) -> Floats:
        """Return the sample standard deviations (divisor n - 1), NaN for fewer than
        two.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            squares = self._squares - share(self._sum**2, np.maximum(self.count, 1))
            return np.sqrt(share(np.maximum(squares, 0), self.count - 1))

    def common(self) -> Floats:
        """Return the value that all runs of a cell share to rounding, NaN without
        one.
        """
        mean, apart = self.means(), np.nan_to_num(self.deviations())
        return np.where(apart <= 1e-12 * np.abs(mean), mean, np.nan)

    def errors(self) -> Floats:
        """Return the standard errors of the means, NaN for fewer than two."""
        return share(self.deviations(), np.sqrt(self.count))


def summary_table(cases: Sequence[Case], counts: Counts) -> pa.Table:
    """Return the summary of cases whose runs are counted."""
    schema, ok = tables.SUMMARY, counts["ok"]
    columns: dict[str, Any] = {
        field.name: pa.nulls(len(cases), field.type) for field in schema
    }
    for name in ("K_p", "K_r"):
        targets = [case.target if case.target_name == name else None for case in cases]
        columns[name] = np.array(targets, float)
    for name, (si, size) in SI.items():
        values = np.array([getattr(case, name) for case in cases], float)
        in_si = np.array([isinstance(getattr(case, name), Quantity) for case in cases])
        columns[name] = np.where(in_si, np.nan, values)
        columns[si] = np.where(in_si, values / size, np.nan)
    columns |= {
        f"fraction_{name}": share(part, ok) for name, part in counts.types.items()
    }
    columns |= {name: counts[name] for name in ("runs", "failed", "near_tangencies")}
    columns |= {
        "case": np.arange(len(cases)),
        "fraction_bondi": share(counts["bondi"], counts["steady"]),
        "t_r_mean": counts.t_r.means(),
        "t_r_std": counts.t_r.deviations(),
        "t_rgh_mean": counts.t_rgh.means(),
        "t_r_mean_error": counts.t_r_error.means(),
        "t_r_over_t_rgh_mean": counts.ratio.means(),
        "t_r_over_t_rgh_sem": counts.ratio.errors(),
        "t_r_s_mean": counts.t_r_s.means(),
    }
    exact = columns["n_i_rpm"]
    columns["n_i_rpm"] = np.where(np.isnan(exact), counts.n_i_rpm.common(), exact)
    columns |= {
        name: counts[name] for name in ("sensitive", "unsure") if name in counts
    }
    contact = (name for name in (*FRICTION, "share_lift_off") if name in counts)
    columns |= {name: share(counts[name], ok) for name in contact}
    return tables.build_table(columns, schema)


# Columns of the summary that are printed, with their headings and formats.
_SHOWN = {
    "n_i": ("n_i", ".4g"),
    "n_i_rpm": ("n_i (rpm)", ".4g"),
    "omega_xy0": ("omega_xy0", ".4g"),
    "omega_xy0_rpm": ("omega_xy0 (rpm)", ".4g"),
    "sigma": ("sigma", ".4g"),
    "sigma_N_m_s": ("sigma (N m s)", ".4g"),
    "rolling": ("rolling", ".4g"),
    "rolling_m": ("rolling (m)", ".4g"),
    "runs": ("runs", "d"),
    "fraction_R": ("R", ".3f"),
    "fraction_SS": ("SS", ".3f"),
    "fraction_SW": ("SW", ".3f"),
    "fraction_unclassified": ("unclassified", ".3f"),
    "fraction_D": ("D", ".3f"),
    "fraction_bondi": ("beyond Bondi", ".3f"),
    "t_r_mean": ("mean t_r", ".5g"),
    "t_r_s_mean": ("mean t_r (s)", ".5g"),
    "t_r_over_t_rgh_mean": ("mean t_r/t_rGH", ".4f"),
    "sensitive": ("sensitive", "d"),
    "unsure": ("type unsure", "d"),
    "share_friction_above_0_3": ("friction > 0.3", ".3f"),
    "share_friction_above_0_6": ("friction > 0.6", ".3f"),
    "share_lift_off": ("lift-off", ".3f"),
    "failed": ("failed", "d"),
}


def closing_table(summary: pa.Table) -> str:
    """Return the summary as aligned text, with "-" for null."""
    absent = absent_columns(summary)
    shown = {name: how for name, how in _SHOWN.items() if name not in absent}
    lines = [["case", "target", *(heading for heading, _ in shown.values())]]
    for row in summary.to_pylist():
        targets = [f"{k}={row[k]:.4g}" for k in ("K_p", "K_r") if row[k] is not None]
        values = ((row[name], form) for name, (_, form) in shown.items())
        cells = (
            "-" if value is None else format(value, form) for value, form in values
        )
        lines.append([str(row["case"]), *(targets or ["-"]), *cells])
    return align(lines)


def absent_columns(summary: pa.Table) -> set[str]:
    """Return the columns to leave out, which are null or the same in all cases."""
    in_si = {"t_r_mean": "t_r_s_mean"} | {name: si for name, (si, _) in SI.items()}
    optional = ("sensitive", "unsure", "fraction_D", "share_lift_off", *FRICTION)
    empty = {
        n: summary.column(n).null_count == len(summary)
        for n in (*optional, *in_si.values())
    }
    # Of a quantity in both systems, SI units are shown.
    absent = {n for n in empty if empty[n]} | {
        n for n, si in in_si.items() if not empty[si]
    }
    losses = ("sigma", "rolling", "sigma_N_m_s", "rolling_m")
    return absent | {n for n in losses if len(summary.column(n).unique()) < 2}
