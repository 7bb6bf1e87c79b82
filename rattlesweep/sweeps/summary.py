"""One row a case: what the runs of a case have in common."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Floats, Integers
from rattlesweep.sweeps.arrow import build_table, read_parquet, write_parquet
from rattlesweep.sweeps.cases import Case
from rattlesweep.sweeps.columns import summary_schema
from rattlesweep.sweeps.counts import FRICTION, Counts, columns_for
from rattlesweep.sweeps.decide import decides, filled
from rattlesweep.text import align

if TYPE_CHECKING:
    from rattlesweep.sweeps.stored import Stored


def count_cases(stored: Stored) -> Counts:
    """Return the runs of a sweep on disk, counted by case.

    In a refined sweep each run counts for all points of the finest grid that it is the nearest one
    to, in the case of the point: runs lie close where types differ, so that plain shares would be
    those of the boundaries.  ``runs`` and ``failed`` count what was done.
    """
    counts = Counts(len(stored.cases))
    names = ("case", *columns_for(stored.config))
    for rows in stored.batches(names):
        counts.add(rows, _case(rows))
    if decides(stored.config) != "bodies.refine":
        return counts
    over_grid = Counts(len(stored.cases))
    for table in filled(stored, names):
        over_grid.add(table, _case(table))
    over_grid.runs, over_grid.stored_failed = counts.runs, counts.failed
    return over_grid


def summarise(stored: Stored) -> pa.Table:
    """Return one row a case, of :func:`summary_schema`; a case of which nothing is stored has 0
    runs.

    Memory does not grow with the runs, unless the sweep is refined.
    """
    return summary_table(stored.cases, count_cases(stored))


def summary_table(cases: Sequence[Case], counts: Counts) -> pa.Table:
    """Return the summary of cases whose runs are counted."""
    columns = {
        "case": np.arange(len(cases)),
        **{
            name: _values(case.target if case.target_name == name else None for case in cases)
            for name in ("K_p", "K_r")
        },
        **{
            name: _values(getattr(case, name) for case in cases)
            for name in ("n_i", "omega_xy0", "sigma", "rolling")
        },
        **counts.columns(),
    }
    return build_table(columns, summary_schema())


def read_summary(stored: Stored) -> pa.Table:
    """Return one row a case: ``summary.parquet``, or what the rows so far come to."""
    path = stored.directory / "summary.parquet"
    return read_parquet(path) if path.exists() else summarise(stored)


def write_summary(stored: Stored, table: pa.Table) -> Path:
    """Write ``summary.parquet``, whole or not at all."""
    path = stored.directory / "summary.parquet"
    write_parquet(table, path)
    return path


def _case(rows: pa.RecordBatch | pa.Table) -> Integers:
    cases: Integers = rows.column("case").to_numpy().astype(np.int64)
    return cases


def same_summary(one: pa.Table, other: pa.Table) -> bool:
    """Return whether two summaries say the same, but for the last digits of their means."""

    def alike(a: pa.ChunkedArray, b: pa.ChunkedArray) -> bool:
        x, y = (c.to_numpy().astype(float) for c in (a, b))
        return np.allclose(x, y, rtol=1e-9, atol=0, equal_nan=True)

    return one.schema.names == other.schema.names and all(
        alike(a, b) for a, b in zip(one.columns, other.columns, strict=True)
    )


def _values(values: Iterable[float | None]) -> Floats:
    return np.array([np.nan if value is None else value for value in values], float)


# -------------------------------------------------------------------- for the terminal


# Columns of the summary, with their headings and formats.
_SHOWN = {
    "n_i": ("n_i", ".4g"),
    "omega_xy0": ("omega_xy0", ".4g"),
    "sigma": ("sigma", ".4g"),
    "rolling": ("rolling", ".4g"),
    "runs": ("runs", "d"),
    "fraction_R": ("R", ".3f"),
    "fraction_SS": ("SS", ".3f"),
    "fraction_SW": ("SW", ".3f"),
    "fraction_unclassified": ("unclassified", ".3f"),
    "fraction_D": ("D", ".3f"),
    "fraction_bondi": ("beyond Bondi", ".3f"),
    "t_r_mean": ("mean t_r", ".5g"),
    "t_r_over_t_rgh_mean": ("mean t_r/t_rGH", ".4f"),
    "sensitive": ("sensitive", "d"),
    "unsure": ("type unsure", "d"),
    "share_friction_above_0_3": ("friction > 0.3", ".3f"),
    "share_friction_above_0_6": ("friction > 0.6", ".3f"),
    "share_lift_off": ("lift-off", ".3f"),
    "failed": ("failed", "d"),
}


def absent_columns(summary: pa.Table) -> set[str]:
    """Return the columns that say nothing of these cases, as none or all have it."""
    cases = len(summary)
    optional = ("sensitive", "unsure", "fraction_D", "share_lift_off", *FRICTION)
    return {n for n in optional if summary.column(n).null_count == cases} | {
        n for n in ("sigma", "rolling") if len(summary.column(n).unique()) < 2
    }


def closing_table(summary: pa.Table) -> str:
    """Lay a summary out as an aligned text table about 120 characters wide.

    The means are over type R, the second of the ratio of each run. "beyond Bondi" is the share of
    runs whose spin is beyond Bondi's threshold. What a case has nothing of is "-". Sensitive runs
    and unsure types are shown where errors are recorded, type D where there is dissipation, and
    the dissipation where cases differ in it. Where contact is recorded, "friction > 0.3" is the
    share of runs that need a larger coefficient of friction to roll.
    """
    shown_columns = {
        name: how for name, how in _SHOWN.items() if name not in absent_columns(summary)
    }
    lines = [["case", "target", *(heading for heading, _ in shown_columns.values())]]
    for row in summary.to_pylist():
        targets = [f"{k}={row[k]:.4g}" for k in ("K_p", "K_r") if row[k] is not None]
        shown = [
            "-" if row[name] is None else format(row[name], form)
            for name, (_, form) in shown_columns.items()
        ]
        lines.append([str(row["case"]), *(targets or ["-"]), *shown])
    return align(lines)
