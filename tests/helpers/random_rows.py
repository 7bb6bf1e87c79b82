"""Columns of random rows, with all kinds of values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.rows import arrow
from rattlesweep.rows.columns import runs_schema

SCHEMA = runs_schema(("energy", "contact", "windows"))


def random_columns(
    case: np.ndarray, sample: np.ndarray, seed: int = 1
) -> dict[str, Any]:
    """Columns of every kind, with nulls wherever the schema allows them."""
    rng = np.random.default_rng(seed)
    n = len(case)
    columns: dict[str, Any] = {"case": case, "sample": sample}
    for field in SCHEMA:
        if field.name in columns:
            continue
        if pa.types.is_floating(field.type):
            values = rng.normal(size=n) * 10.0 ** rng.integers(-8, 8, n)
            if field.nullable:
                values[rng.random(n) < 0.2] = np.nan
                values[rng.random(n) < 0.05] = np.inf
            columns[field.name] = values
        elif pa.types.is_integer(field.type):
            columns[field.name] = rng.integers(0, 3, n)
        elif pa.types.is_list(field.type):
            columns[field.name] = arrow.ragged(
                rng.normal(size=(n, 5)), rng.integers(-1, 6, n)
            )
    columns["t_r"] = np.abs(columns["t_r"])  # a time
    status = (rng.random(n) < 0.1).astype(np.int8)
    columns["status"] = (status, ["ok", "diverged"])
    columns["type"] = (np.where(status == 0, rng.integers(0, 2, n), -1), ["R", "SS"])
    return columns
