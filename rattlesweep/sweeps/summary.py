"""One row a case: what the runs of a case have in common."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Floats
from rattlesweep.errors import OutputError
from rattlesweep.sweeps.old.manifest import StoredCase
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.arrow import build_table
from rattlesweep.sweeps.counts import COLUMNS, Cells
from rattlesweep.sweeps.columns import summary_schema
from rattlesweep.text import align

if TYPE_CHECKING:
    from rattlesweep.sweeps.plan import Case


class Summary:
    """The runs of a sweep by case, to be fed with all of its rows.

    `cases` are in the order of their numbers, and each has a cell in `cells`; `where` is the
    directory of the runs, for complaints.
    """

    def __init__(
        self, cases: Sequence[Case | StoredCase], where: object, columns: Sequence[str] = COLUMNS
    ) -> None:
        self.columns = ("case", *columns)
        self._cases, self._where = cases, where
        self.cells = Cells(len(cases))

    def add(self, rows: pa.RecordBatch) -> None:
        """Count more runs."""
        case = rows.column("case").to_numpy().astype(np.int64)
        if len(case) and (most := int(case.max())) >= len(self._cases):
            raise OutputError(f"{self._where} holds runs of case {most}, which the sweep has not")
        self.cells.add(rows, case)

    def add_table(self, rows: pa.Table) -> None:
        """Count the runs of a table."""
        for batch in rows.to_batches():
            self.add(batch)

    def table(self) -> pa.Table:
        """One row a case, of `summary_schema`; a case of which nothing is stored has 0 runs."""
        columns = {
            "case": np.arange(len(self._cases)),
            **{
                name: _values(case.target if case.target_name == name else None
                              for case in self._cases)
                for name in ("K_p", "K_r")
            },
            "n_i": _values(case.n_i for case in self._cases),
            **{name: _values(getattr(case, name) for case in self._cases)
               for name in ("omega_xy0", "sigma", "rolling")},
            **self.cells.columns(),
        }  # fmt: skip
        return build_table(columns, summary_schema())


def summarise(
    store: Store, cases: Sequence[Case | StoredCase], columns: Sequence[str] = COLUMNS
) -> pa.Table:
    """Summarise the stored runs, one row a case in the order of `cases`.

    The runs of complete blocks count: what a stopped session has left of another block are the runs
    that were first to end, which are not like the rest. Memory does not grow with the runs.
    `columns` are those of `cells.columns_for`.
    """
    summary = Summary(cases, store.runs, columns)
    for rows in store.iter_batches(summary.columns, complete=True):
        summary.add(rows)
    return summary.table()


def same_summary(one: pa.Table, other: pa.Table) -> bool:
    """Whether two summaries say the same, but for the last digits of their means."""

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
    "fraction_unclassified": ("uncl.", ".3f"),
    "fraction_D": ("D", ".3f"),
    "fraction_bondi": ("Bondi", ".3f"),
    "t_r_mean": ("t_r", ".5g"),
    "t_r_over_t_rgh_mean": ("t_r/t_rGH", ".4f"),
    "sensitive": ("sens.", "d"),
    "unsure": ("unsure", "d"),
    "failed": ("fail", "d"),
}


def absent_columns(summary: pa.Table) -> set[str]:
    """Columns that say nothing of these cases: of what they do not have, or all share."""
    cases = len(summary)
    optional = ("sensitive", "unsure", "fraction_D")
    return {n for n in optional if summary.column(n).null_count == cases} | {
        n for n in ("sigma", "rolling") if len(summary.column(n).unique()) < 2
    }


def closing_table(summary: pa.Table) -> str:
    """Lay a summary out as an aligned text table about 100 characters wide.

    ``t_r`` and ``t_r/t_rGH`` are means over type R, the latter of the ratio of each run; what there
    is nothing of is "-". Sensitive runs and unsure types are shown where errors are recorded, type
    D where there is dissipation, and what this is where cases differ in it.
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
