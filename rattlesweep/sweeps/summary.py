"""One row a case: what the runs of a case have in common."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.sweeps.arrow import build_table, read_parquet, write_parquet
from rattlesweep.sweeps.columns import summary_schema
from rattlesweep.sweeps.counts import FRICTION, Counts, columns_for, share
from rattlesweep.sweeps.decide import decides, nearest_rows
from rattlesweep.sweeps.stored import Case
from rattlesweep.text import align

if TYPE_CHECKING:
    from rattlesweep.sweeps.stored import Stored


def count_cases(stored: Stored) -> Counts:
    """Return the runs of a sweep on disk, counted by case.

    In a refined sweep each run counts for all points of the finest grid that it is the nearest one
    to, in the case of the point: plain shares would be those of the boundaries.  ``runs`` and
    ``failed`` count what was done.
    """
    cases, names = len(stored.cases), ("case", *columns_for(stored.config))
    counts = Counts(cases)
    for rows in stored.batches(names):
        counts.add(rows, rows.column("case").to_numpy().astype(np.int64))
    if decides(stored.config) != "bodies.refine":
        return counts
    weighted, runs = Counts(cases), stored.read(names)
    for case, nearest in nearest_rows(stored):
        place, weight = np.unique(nearest[nearest >= 0], return_counts=True)
        weighted.add(runs.take(pa.array(place)), np.full(len(place), case), weight)
    weighted.runs, weighted.failed = counts.runs, counts.failed
    return weighted


def summarise(stored: Stored) -> pa.Table:
    """Return one row a case, of :func:`summary_schema`; of nothing stored, with 0 runs."""
    return summary_table(stored.cases, count_cases(stored))


def summary_table(cases: Sequence[Case], counts: Counts) -> pa.Table:
    """Return the summary of cases whose runs are counted."""
    schema, ok = summary_schema(), counts.ok
    columns: dict[str, Any] = {
        name: pa.array([c.target if c.target_name == name else None for c in cases], pa.float64())
        for name in ("K_p", "K_r")
    }
    for name in ("n_i", "omega_xy0", "sigma", "rolling"):
        columns[name] = pa.array([getattr(case, name) for case in cases], pa.float64())
    columns |= {f"fraction_{name}": share(part, ok) for name, part in counts.types.items()}
    columns |= {
        "case": np.arange(len(cases)),
        "runs": counts.runs,
        "fraction_bondi": share(counts.bondi, counts.steady),
        "t_r_mean": counts.t_r.means(),
        "t_r_std": counts.t_r.deviations(),
        "t_rgh_mean": counts.t_rgh.means(),
        "t_r_over_t_rgh_mean": counts.ratio.means(),
        "t_r_over_t_rgh_sem": counts.ratio.errors(),
        "failed": counts.failed,
        "near_tangencies": counts.near_tangencies,
        "t_r_mean_error": counts.t_r_error.means(),
    }
    if counts.has_errors:
        columns |= {"sensitive": counts.sensitive, "unsure": counts.unsure}
    if counts.has_contact:
        columns |= {name: share(part, ok) for name, part in counts.contact.items()}
    for field in schema:  # what the sweep does not record
        columns.setdefault(field.name, pa.nulls(len(cases), field.type))
    return build_table(columns, schema)


def read_summary(stored: Stored) -> pa.Table:
    """Return one row a case: ``summary.parquet``, or what the rows so far come to."""
    path = stored.directory / "summary.parquet"
    return read_parquet(path) if path.exists() else summarise(stored)


def write_summary(stored: Stored, table: pa.Table) -> Path:
    """Write ``summary.parquet``, whole or not at all."""
    path = stored.directory / "summary.parquet"
    write_parquet(table, path)
    return path


def same_summary(one: pa.Table, other: pa.Table) -> bool:
    """Return whether two summaries say the same, but for the last digits of their means."""
    return one.schema.names == other.schema.names and all(
        np.allclose(a.to_numpy().astype(float), b.to_numpy().astype(float), 1e-9, 0, equal_nan=True)
        for a, b in zip(one.columns, other.columns, strict=True)
    )


# Columns of the summary, with their headings and formats for the terminal.
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


def absent_columns(summary: pa.Table) -> set[str]:
    """Return the columns that say nothing of these cases, as none or all have it."""
    optional = ("sensitive", "unsure", "fraction_D", "share_lift_off", *FRICTION)
    absent = {n for n in optional if summary.column(n).null_count == len(summary)}
    return absent | {n for n in ("sigma", "rolling") if len(summary.column(n).unique()) < 2}


def closing_table(summary: pa.Table) -> str:
    """Lay a summary out as an aligned text table; what a case has nothing of is "-"."""
    absent = absent_columns(summary)
    shown = {name: how for name, how in _SHOWN.items() if name not in absent}
    lines = [["case", "target", *(heading for heading, _ in shown.values())]]
    for row in summary.to_pylist():
        targets = [f"{k}={row[k]:.4g}" for k in ("K_p", "K_r") if row[k] is not None]
        values = ((row[name], form) for name, (_, form) in shown.items())
        cells = ("-" if value is None else format(value, form) for value, form in values)
        lines.append([str(row["case"]), *(targets or ["-"]), *cells])
    return align(lines)
