"""Almost periodic or chaotic, told by how far a small difference grows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from rattlesweep.arrays import Flags, Floats
from rattlesweep.sweeps.columns import RUNS

# Between the growth that no chaos is needed for and that of chaos; evidence in docs/lyapunov.md.
LEAST_GROWTH = 10.0


def is_chaotic(lyapunov_late: ArrayLike, t_end: ArrayLike) -> Flags:
    """Whether differences grow exponentially in the second half of a run, by more than e^10.

    An almost periodic run doubles them there at most, or shrinks them; the instability by which
    wobbling sets in multiplies them by no more than the oscillation grows, some hundreds. Of the
    columns of ``runs``; False where ``lyapunov_late`` is not known.
    """
    growth = np.asarray(lyapunov_late, dtype=float) * np.asarray(t_end, dtype=float) / 2
    return np.asarray(growth > LEAST_GROWTH)


def chaotic_column(lyapunov_late: Floats, t_end: Floats) -> pa.Array:
    """The column ``chaotic`` of runs: null where ``lyapunov_late`` is not a number."""
    return pa.array(is_chaotic(lyapunov_late, t_end), mask=~np.isfinite(lyapunov_late))


NAME, OF = "chaotic", ("lyapunov_late", "t_end")
_FIELD = next(column for column in RUNS["lyapunov"] if column.name == NAME)


def lacks_chaotic(schema: pa.Schema) -> bool:
    """Whether the runs of a file are of before the column, and have what it is told by."""
    return NAME not in schema.names and set(OF) <= set(schema.names)


def with_chaotic_field(schema: pa.Schema) -> pa.Schema:
    """A schema in which it has its place, if it can be told."""
    return with_chaotic(schema.empty_table()).schema


def with_chaotic(rows: pa.Table) -> pa.Table:
    """Rows in which the column has its place, if it can be told."""
    if not lacks_chaotic(rows.schema):
        return rows
    late, t_end = (rows.column(name).to_numpy() for name in OF)
    place = rows.schema.get_field_index(OF[0]) + 1
    return rows.add_column(place, _FIELD, chaotic_column(late, t_end))


def columns_to_read(names: Sequence[str] | None, schema: pa.Schema) -> list[str] | None:
    """Columns of a file that :func:`with_chaotic` needs to give these; None: all."""
    if names is None or NAME not in names or not lacks_chaotic(schema):
        return None if names is None else list(names)
    return list(dict.fromkeys((*(name for name in names if name != NAME), *OF)))
