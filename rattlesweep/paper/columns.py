"""Columns of the figures' tables; those of several tables are written once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd
import pyarrow as pa

from rattlesweep.sweeps.columns import F64, I64, RATE, TEXT, TIME, field

COMMON = {
    column.name: column
    for column in (
        field("probability", F64, "1", "share of the bodies at or below the values of this row"),
        field("K_p", F64, "1", "target of the torque coefficient"),
        field("K_r", F64, "1", "target of the torque coefficient"),
        field("n_i", F64, RATE, "initial spin"),
        field("omega_xy0", F64, RATE, "initial rate of the oscillation"),
        field("sample", I64, "1", "number of the run within its case"),
        field("runs", I64, "1", "runs with status ok"),
        field("reversed", I64, "1", "of them, runs that reverse (type R)"),
        field("theta", F64, "1", "curvature of the body"),
        field("model", TEXT, "1", "full or reduced"),
        field("tol", F64, "1", "tolerance of the integration"),
        field("t", F64, TIME, "time"),
        field("n", F64, RATE, "spin u . omega"),
        field("omega_x", F64, RATE, "angular velocity, body's x"),
        field("omega_y", F64, RATE, "angular velocity, body's y"),
        field("t_end", F64, TIME, "time reached"),
    )
}


def schema(names: str, *own: pa.Field, more: str = "") -> pa.Schema:
    """Schema of a table: common columns by their names, then its own, then common ones again."""
    return pa.schema(
        [*(COMMON[name] for name in names.split()), *own, *(COMMON[n] for n in more.split())]
    )


def number(name: str, words: str, unit: str = "1") -> pa.Field:
    """A column of floating-point numbers."""
    return field(name, F64, unit, words)


def count(name: str, words: str) -> pa.Field:
    """A column of whole numbers."""
    return field(name, I64, "1", words)


def word(name: str, words: str) -> pa.Field:
    """A column of words."""
    return field(name, TEXT, "1", words)


def table(rows: pd.DataFrame | Mapping[str, Any] | Sequence[Any], wanted: pa.Schema) -> pa.Table:
    """A table of rows or columns; what a row lacks is null, and so is what is not a number."""
    frame = pd.DataFrame(rows).reindex(columns=wanted.names)
    return pa.Table.from_pandas(frame, schema=wanted, preserve_index=False).cast(wanted)
