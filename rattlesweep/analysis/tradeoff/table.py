"""The table of the trade: its columns, advice from it, and all of it as text."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import pandas as pd
import pyarrow as pa

from rattlesweep.sweeps.provenance import machine, package_version
from rattlesweep.sweeps.columns import F64, I64, TEXT, TIME, field, required
from rattlesweep.text import align

if TYPE_CHECKING:
    from rattlesweep.analysis.tradeoff.measure import Study

# Errors of t_r for which the cheapest setting is named, and by which of the runs' errors.
WANTED = (1e-3, 1e-6, 1e-9, 1e-12)
QUANTILES = {"median": "error_median", "p99": "error_p99"}
_MISSED = "; a run without t_r counts as infinite, and null is infinite"

# One row a setting.
SCHEMA = pa.schema(
    [
        required("model", TEXT, "1", "full, reduced or gh"),
        required("method", TEXT, "1", "integrator; plain: scalar RK4, one run after another"),
        required("setting", TEXT, "1", "tol, dt, accuracy (of t_r), or none"),
        field("value", F64, "1", "value of the setting; dt in sqrt(a/g)"),
        required("runs", I64, "1", "runs integrated for the errors"),
        required("reversing", I64, "1", "runs among them whose reference reverses"),
        required("us_per_unit", F64, "us", f"cost on one thread for one run over one {TIME}"),
        required("us_per_run", F64, "us",
                "cost on one thread for one run, cut at the timing horizon"),
        field("speedup", F64, "1", "cost per unit of plain over that of this row"),
        field("error_median", F64, "1", "median of abs(t_r/t_ref - 1)" + _MISSED),
        field("error_p90", F64, "1", "90th percentile of the same" + _MISSED),
        field("error_p99", F64, "1", "99th percentile of the same" + _MISSED),
        field("error_max", F64, "1", "largest error of the runs that have a t_r"),
        field("share_above_1e_6", F64, "1", "share of runs off by more than 1e-6, or without t_r"),
        required("missed", I64, "1", "runs with a reversal in the reference and none here"),
        required("false", I64, "1", "runs with a reversal here and none in the reference"),
        field("kept", F64, "1", "share of runs within the accuracy that is promised, of those "
              "that are not marked; null: none is"),
        field("marked", F64, "1", "share of runs that say that they may not be within it"),
        field("type_flips", F64, "1", "share of runs with another type"),
        field("energy_drift_median", F64, "1", "median change of energy, relative"),
        field("energy_drift_max", F64, "1", "largest change of energy, relative"),
        required("failed", I64, "1", "runs with a status other than ok"),
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
    """The row of the cheapest setting whose ``error_median`` or ``error_p99`` is small enough."""
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


def as_text(study: Study) -> str:
    """Everything that was measured, to be read."""
    f = study.facts
    here = machine()
    within = f["confirmed_within"]
    confirmed = "no run" if within is None else f"within {within:.1e}"
    return "\n".join(
        [
            f"{here['cpu']}, {here['processors']} processors, {here['system']}, Python "
            f"{platform.python_version()}, rattlesweep {package_version()}",
            f"{f['runs']} runs, {f['reversing_in_both']} with a reversal in both references; "
            f"{f['compared']} of them agree to 1e-8",
            f"{f['dropped']} runs are left out: the references do not agree on what becomes of "
            "them",
            f"the references differ by {f['references_differ_median']:.1e} (median), "
            f"{f['references_differ_p99']:.1e} (99 %)",
            f"an independent integrator confirms {f['confirmed_runs']} runs: {confirmed}, "
            f"{f['confirmed_missed']} without a reversal",
            f"costs on one thread, of runs cut at t = {f['timing_horizon']:g}",
            "",
            _settings(study.rows),
            "",
            "cheapest setting",
            _advice(study.rows),
        ]
    )


# Two lines of heading, and the cell of a row.
COLUMNS: tuple[tuple[str, str, Callable[[Any], str]], ...] = (
    ("", "setting", row_name),
    ("us a unit", "and run", lambda row: f"{row.us_per_unit:.3g}"),
    ("over", "plain", lambda row: f"{row.speedup:.3g}x"),
    ("error of", "median", lambda row: number(row.error_median)),
    ("t_r", "99 %", lambda row: number(row.error_p99)),
    ("share", "> 1e-6", lambda row: f"{100 * row.share_above_1e_6:.2f} %"),
    ("promise", "kept",
     lambda row: "-" if math.isnan(row.kept) else f"{100 * row.kept:.2f} %"),
    ("", "missed", lambda row: str(row.missed)),
    ("", "false", lambda row: str(row.false)),
    ("other", "type",
     lambda row: "-" if math.isnan(row.type_flips) else f"{100 * row.type_flips:.2f} %"),
    ("energy drift", "median", lambda row: number(row.energy_drift_median)),
    ("", "max", lambda row: number(row.energy_drift_max)),
    ("not", "ok", lambda row: str(row.failed)),
    ("", "runs", lambda row: str(row.runs)),
)  # fmt: skip


def _settings(rows: pd.DataFrame) -> str:
    lines = [[first for first, _, _ in COLUMNS], [second for _, second, _ in COLUMNS]]
    lines += [[cell(row) for _, _, cell in COLUMNS] for row in rows.itertuples()]
    return align(lines, "<>")


def _advice(rows: pd.DataFrame) -> str:
    lines: list[Sequence[str]] = [
        ("error of t_r", "median", "us a unit", "99 % of runs", "us a unit")
    ]
    for entry in advice(rows):
        cells = [number(entry["error"])]
        for word in QUANTILES:
            cost = entry[f"{word}_us_per_unit"]
            cells += [entry[word] or "none", "-" if cost is None else f"{cost:.3g}"]
        lines.append(cells)
    return align(lines, "<")


def as_data(study: Study) -> dict[str, Any]:
    """The same as JSON can hold it."""
    return {
        "machine": machine() | {"python": platform.python_version()},
        "rattlesweep": package_version(),
        "facts": study.facts,
        "rows": [
            {k: None if isinstance(v, float) and not math.isfinite(v) else v
             for k, v in row.items()}
            for row in study.rows.to_dict("records")
        ],
        "cheapest": advice(study.rows),
    }  # fmt: skip
