"""The table of the trade: its columns, its text, and what it says of an error one wants."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from rattlesweep.sweeps.tables.columns import TIME, Column

if TYPE_CHECKING:
    from collections.abc import Sequence

WANTED = (1e-3, 1e-6, 1e-9, 1e-12)

_F64, _I64, _TEXT = pa.float64(), pa.int64(), pa.string()
_MISSED = "; a run without t_r counts as infinite, and null is infinite"

COLUMNS: tuple[Column, ...] = (
    Column("model", _TEXT, "1", "full, reduced or gh"),
    Column("method", _TEXT, "1", "integrator; plain: scalar RK4, one run after another"),
    Column("setting", _TEXT, "1", "tol, dt, or none"),
    Column("value", _F64, "1", "value of the setting; dt in sqrt(a/g)", nullable=True),
    Column("runs", _I64, "1", "runs integrated for the errors"),
    Column("reversing", _I64, "1", "runs among them whose reference reverses"),
    Column("us_per_unit", _F64, "us", f"cost on one thread for one run over one {TIME}"),
    Column("us_per_run", _F64, "us", "cost on one thread for one run, cut at the timing horizon"),
    Column("speedup", _F64, "1", "cost per unit of plain over that of this row", nullable=True),
    Column("error_median", _F64, "1", "median of abs(t_r/t_ref - 1)" + _MISSED, nullable=True),
    Column("error_p90", _F64, "1", "90th percentile of the same" + _MISSED, nullable=True),
    Column("error_p99", _F64, "1", "99th percentile of the same" + _MISSED, nullable=True),
    Column("error_max", _F64, "1", "largest error of the runs that have a t_r", nullable=True),
    Column(
        "share_above_1e_6",
        _F64,
        "1",
        "share of runs off by more than 1e-6, or without t_r",
        nullable=True,
    ),
    Column("missed", _I64, "1", "runs with a reversal in the reference and none here"),
    Column("false", _I64, "1", "runs with a reversal here and none in the reference"),
    Column("type_flips", _F64, "1", "share of runs with another type", nullable=True),
    Column("energy_drift_median", _F64, "1", "median change of energy, relative", nullable=True),
    Column("energy_drift_max", _F64, "1", "largest change of energy, relative", nullable=True),
    Column("failed", _I64, "1", "runs with a status other than ok"),
)


@dataclass(frozen=True)
class Row:
    """One setting; the fields are the columns of the table, NaN where there is nothing."""

    model: str
    method: str
    setting: str
    value: float
    runs: int
    reversing: int
    us_per_unit: float
    us_per_run: float
    speedup: float
    error_median: float
    error_p90: float
    error_p99: float
    error_max: float
    share_above_1e_6: float
    missed: int
    false: int
    type_flips: float
    energy_drift_median: float
    energy_drift_max: float
    failed: int

    @property
    def name(self) -> str:
        """Method and setting, or the model where that says all."""
        if self.model != "full":
            return self.model
        word = "plain rk4" if self.method == "plain" else self.method
        return f"{word} {self.setting} {number(self.value)}"

    def plain_data(self) -> dict[str, Any]:
        """The row as JSON can hold it."""
        return {
            name: None if isinstance(v, float) and not math.isfinite(v) else v
            for name, v in asdict(self).items()
        }


def number(value: float) -> str:
    """Short form of a setting or an error, two digits: ``1e-9``, ``0.05``."""
    if not math.isfinite(value):
        return "-"
    if value >= 1e-3:
        return f"{value:.2g}"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def schema() -> pa.Schema:
    """Arrow schema of the table, with `unit` and `description` in each field's metadata."""
    return pa.schema([column.field for column in COLUMNS])


def columns_of(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """Rows turned into columns."""
    return {column.name: [getattr(row, column.name) for row in rows] for column in COLUMNS}


def text(rows: Sequence[Row]) -> str:
    """The table as it is printed."""
    heads = (
        ("", "us a unit", "over", "error of", "t_r", "share", "", "", "other", "energy drift", "",
         "not", ""),
        ("setting", "and run", "plain", "median", "99 %", "> 1e-6", "missed", "false", "type",
         "median", "max", "ok", "runs"),
    )  # fmt: skip
    lines = [list(head) for head in heads]
    for row in rows:
        flips = "-" if math.isnan(row.type_flips) else f"{100 * row.type_flips:.2f} %"
        lines.append(
            [
                row.name,
                f"{row.us_per_unit:.3g}",
                f"{row.speedup:.3g}x",
                number(row.error_median),
                number(row.error_p99),
                f"{100 * row.share_above_1e_6:.2f} %",
                str(row.missed),
                str(row.false),
                flips,
                number(row.energy_drift_median),
                number(row.energy_drift_max),
                str(row.failed),
                str(row.runs),
            ]
        )
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if place == 0 else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def cheapest(rows: Sequence[Row], error: float, quantile: str) -> Row | None:
    """Cheapest setting whose error is small enough; None if none is.

    Parameters
    ----------
    rows : sequence of Row
    error : float
    quantile : str
        ``error_median`` or ``error_p99``.
    """
    good = [row for row in rows if getattr(row, quantile) <= error]
    return min(good, key=lambda row: row.us_per_unit, default=None)


def advice(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Cheapest settings at the errors one may want, by median and for 99 % of the runs."""
    found = []
    for error in WANTED:
        entry: dict[str, Any] = {"error": error}
        for word, quantile in (("median", "error_median"), ("p99", "error_p99")):
            row = cheapest(rows, error, quantile)
            entry[word] = None if row is None else row.name
            entry[f"{word}_us_per_unit"] = None if row is None else row.us_per_unit
        found.append(entry)
    return found


def advice_text(rows: Sequence[Row]) -> str:
    """The same as it is printed."""
    lines = [("error of t_r", "median", "us a unit", "99 % of runs", "us a unit")]
    for entry in advice(rows):
        cells = [f"{number(entry['error'])}"]
        for word in ("median", "p99"):
            cost = entry[f"{word}_us_per_unit"]
            cells += [entry[word] or "none", "-" if cost is None else f"{cost:.3g}"]
        lines.append((cells[0], cells[1], cells[2], cells[3], cells[4]))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )
