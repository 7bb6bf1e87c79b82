"""The table of the trade: its columns, and what it says of an error one wants."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from rattlesweep.sweeps.tables.columns import F64, I64, TEXT, TIME, field

if TYPE_CHECKING:
    import pandas as pd

# Errors of t_r for which the cheapest setting is named, and by which of the runs' errors.
WANTED = (1e-3, 1e-6, 1e-9, 1e-12)
QUANTILES = {"median": "error_median", "p99": "error_p99"}
_MISSED = "; a run without t_r counts as infinite, and null is infinite"


def _always(name: str, kind: pa.DataType, unit: str, words: str) -> pa.Field:
    return field(name, kind, unit, words, nullable=False)


# One row a setting.
SCHEMA = pa.schema(
    [
        _always("model", TEXT, "1", "full, reduced or gh"),
        _always("method", TEXT, "1", "integrator; plain: scalar RK4, one run after another"),
        _always("setting", TEXT, "1", "tol, dt, or none"),
        field("value", F64, "1", "value of the setting; dt in sqrt(a/g)"),
        _always("runs", I64, "1", "runs integrated for the errors"),
        _always("reversing", I64, "1", "runs among them whose reference reverses"),
        _always("us_per_unit", F64, "us", f"cost on one thread for one run over one {TIME}"),
        _always("us_per_run", F64, "us",
                "cost on one thread for one run, cut at the timing horizon"),
        field("speedup", F64, "1", "cost per unit of plain over that of this row"),
        field("error_median", F64, "1", "median of abs(t_r/t_ref - 1)" + _MISSED),
        field("error_p90", F64, "1", "90th percentile of the same" + _MISSED),
        field("error_p99", F64, "1", "99th percentile of the same" + _MISSED),
        field("error_max", F64, "1", "largest error of the runs that have a t_r"),
        field("share_above_1e_6", F64, "1", "share of runs off by more than 1e-6, or without t_r"),
        _always("missed", I64, "1", "runs with a reversal in the reference and none here"),
        _always("false", I64, "1", "runs with a reversal here and none in the reference"),
        field("type_flips", F64, "1", "share of runs with another type"),
        field("energy_drift_median", F64, "1", "median change of energy, relative"),
        field("energy_drift_max", F64, "1", "largest change of energy, relative"),
        _always("failed", I64, "1", "runs with a status other than ok"),
    ]
)  # fmt: skip


def row_name(row: Any) -> str:
    """Method and setting of a row, or the model where that says all."""
    if row.model != "full":
        return str(row.model)
    word = "plain rk4" if row.method == "plain" else row.method
    return f"{word} {row.setting} {number(row.value)}"


def number(value: float) -> str:
    """Short form of a setting or an error, two digits: ``1e-9``, ``0.05``."""
    if not math.isfinite(value):
        return "-"
    if value >= 1e-3:
        return f"{value:.2g}"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def cheapest(rows: pd.DataFrame, error: float, quantile: str) -> Any:
    """The row of the cheapest setting whose error is small enough; None if none is.

    Parameters
    ----------
    rows : DataFrame
        With the columns of :data:`SCHEMA`.
    error : float
    quantile : str
        ``error_median`` or ``error_p99``.
    """
    good = rows[rows[quantile] <= error].nsmallest(1, "us_per_unit")
    return next(good.itertuples(), None)


def advice(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Cheapest settings at the errors one may want, by median and for 99 % of the runs."""
    found = []
    for error in WANTED:
        entry: dict[str, Any] = {"error": error}
        for word, quantile in QUANTILES.items():
            row = cheapest(rows, error, quantile)
            entry[word] = None if row is None else row_name(row)
            entry[f"{word}_us_per_unit"] = None if row is None else row.us_per_unit
        found.append(entry)
    return found
