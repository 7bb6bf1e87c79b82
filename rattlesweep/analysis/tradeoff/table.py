"""The table of the trade: its columns, the cheapest settings, all of it as text and as a figure."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib.figure import Figure

from rattlesweep.analysis import style
from rattlesweep.analysis.tradeoff.measure import Study
from rattlesweep.sweeps.arrow import build_table, write_parquet
from rattlesweep.sweeps.columns import F64, I64, TEXT, TIME, field, required
from rattlesweep.sweeps.files import probe_directory
from rattlesweep.sweeps.provenance import machine, package_version
from rattlesweep.text import align

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
    """Return method and setting of a row, or the model where that says all."""
    if row.model != "full":
        return str(row.model)
    word = "plain rk4" if row.method == "plain" else row.method
    return f"{word} {row.setting} {number(row.value)}"


def number(value: float) -> str:
    """Return the short form of a setting or an error, two digits: ``1e-9``, ``0.05``."""
    if not math.isfinite(value):
        return "-"
    if value >= 1e-3:
        return f"{value:.2g}"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def cheapest(rows: pd.DataFrame, error: float, quantile: str) -> Any:
    """Return the row of the cheapest setting whose `quantile` of errors is small enough."""
    good = rows[rows[quantile] <= error].nsmallest(1, "us_per_unit")
    return next(good.itertuples(), None)


def advice(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the cheapest settings at some errors, by median and for 99 % of the runs."""
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
    """Return everything that was measured, to be read."""
    f = study.facts
    here, rows = machine(), study.rows.itertuples()
    heads = [[one for one, _, _ in COLUMNS], [two for _, two, _ in COLUMNS]]
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
            f"costs on one thread, of runs cut at t = {f['timing_horizon']:g}",
            "",
            align([*heads, *([cell(row) for *_, cell in COLUMNS] for row in rows)], "<>"),
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
    ("goal", "kept",
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


def _advice(rows: pd.DataFrame) -> str:
    lines = [["error of t_r", "median", "us a unit", "99 % of runs", "us a unit"]]
    for entry in advice(rows):
        lines.append([number(entry["error"])])
        for word in QUANTILES:
            cost = entry[f"{word}_us_per_unit"]
            lines[-1] += [entry[word] or "none", "-" if cost is None else f"{cost:.3g}"]
    return align(lines, "<")


def as_data(study: Study) -> dict[str, Any]:
    """Return the same as JSON can hold it."""
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


# -- the figure ----------------------------------------------------------------------------------

WIDTH, HEIGHT, DPI = 8.4, 5.6, 150
# Settings that stand alone: plain RK4, models without the full dynamics, an error asked for.
SINGLES = {"plain": "plain scalar rk4, dt 0.002", "reduced": "reduced", "gh": "gh",
           "accuracy": "accuracy {t_r: 1e-6}"}  # fmt: skip


def save(study: Study, directory: Path) -> list[Path]:
    """Write ``tradeoff.parquet``, ``.svg`` and ``.png``, each in one step; return their paths."""
    probe_directory(directory)
    table, *pictures = (directory / f"tradeoff.{kind}" for kind in ("parquet", "svg", "png"))
    columns = {name: study.rows[name].to_numpy() for name in SCHEMA.names}
    write_parquet(build_table(columns, SCHEMA), table)
    caption = (
        f"{study.facts['runs']} runs of {study.name}, {study.facts['compared']} with a sure "
        f"reversal; {machine()['cpu']}, rattlesweep {package_version()}"
    )
    with style.styled():
        style.save(draw(study.rows, caption), pictures, DPI)
    return [table, *pictures]


def draw(rows: pd.DataFrame, caption: str = "") -> Figure:
    """Draw cost against error: the median as markers, and a line to the 99th percentile."""
    figure = style.new_figure(WIDTH, HEIGHT)
    axes = figure.subplots()
    alone = np.where(rows.setting == "accuracy", "accuracy", rows.model)
    looks = iter(style.SERIES * len(rows))
    for series, own in rows.groupby(rows.method.where(alone == "full", alone), sort=False):
        word = SINGLES.get(str(series))
        own = own[np.isfinite(own.error_median) & (own.error_median > 0)]
        if own.empty:
            continue
        colour, marker = (style.GREY, "o") if word else next(looks)
        axes.plot(own.error_median, own.us_per_unit, color=colour, marker=marker, zorder=3,
                  linestyle="none" if word else "-", label=None if word else series)  # fmt: skip
        far = own[np.isfinite(own.error_p99)]
        axes.hlines(far.us_per_unit, far.error_median, far.error_p99, color=colour, alpha=0.35)
        above = bool(word) or marker != "o"
        for row in own.itertuples():
            value = f"{'' if row.setting == 'tol' else 'dt '}{number(row.value)}"
            axes.annotate(word or value, (row.error_median, row.us_per_unit), color=colour,
                          xytext=(5, 5) if above else (-5, -12), fontsize=7.5, zorder=4,
                          textcoords="offset points", ha="left" if above else "right",
                          )  # fmt: skip
    axes.set(xscale="log", yscale="log", ylabel="cost (µs for a run and a unit of time)",
             xlabel="relative error of $t_r$: median of the runs, and a line to 99 %")  # fmt: skip
    style.light_grid(axes)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="upper right")
    if caption:
        figure.supxlabel(caption, fontsize=7.5, color=style.GREY)
    return figure
