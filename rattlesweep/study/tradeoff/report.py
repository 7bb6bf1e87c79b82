"""What was measured, written and said."""

from __future__ import annotations

import math
import platform
from typing import TYPE_CHECKING, Any

from rattlesweep.study.style import encode, styled
from rattlesweep.study.tradeoff import figure
from rattlesweep.study.tradeoff.table import QUANTILES, SCHEMA, advice, number, row_name
from rattlesweep.sweeps.store.atomic import probe_directory, replace_file
from rattlesweep.sweeps.store.provenance import machine, package_version
from rattlesweep.sweeps.tables import arrow
from rattlesweep.text import align

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pandas as pd

    from rattlesweep.study.tradeoff.measure import Study

NAME = "tradeoff"
HEADS = (
    ("", "us a unit", "over", "error of", "t_r", "share", "", "", "other", "energy drift", "",
     "not", ""),
    ("setting", "and run", "plain", "median", "99 %", "> 1e-6", "missed", "false", "type",
     "median", "max", "ok", "runs"),
)  # fmt: skip


def save(study: Study, directory: Path) -> list[Path]:
    """Write the table and the figure, each file in one step.

    Returns
    -------
    list of Path
        ``tradeoff.parquet``, ``tradeoff.svg``, ``tradeoff.png``.
    """
    probe_directory(directory)
    columns = {name: study.rows[name].to_numpy() for name in SCHEMA.names}
    contents = {"parquet": arrow.encode(arrow.build_table(columns, SCHEMA))}
    with styled():
        drawn = figure.draw(study.rows, caption(study))
        contents |= {kind: encode(drawn, kind, figure.DPI) for kind in ("svg", "png")}
    paths = [directory / f"{NAME}.{kind}" for kind in contents]
    for path, data in zip(paths, contents.values(), strict=True):
        replace_file(path, data)
    return paths


def caption(study: Study) -> str:
    """Which runs, which machine: one line."""
    return (
        f"{len(study.runs)} runs of {study.runs.config.name}, "
        f"{int(study.reference.both.sum())} with a sure reversal; {machine()['cpu']}, "
        f"rattlesweep {package_version()}"
    )


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
            f"the references differ by {_short(f['references_differ_median'])} (median), "
            f"{_short(f['references_differ_p99'])} (99 %)",
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


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.1e}"


def _settings(rows: pd.DataFrame) -> str:
    lines: list[Sequence[str]] = [*HEADS]
    for row in rows.itertuples():
        r: Any = row
        lines.append(
            [
                row_name(r), f"{r.us_per_unit:.3g}", f"{r.speedup:.3g}x", number(r.error_median),
                number(r.error_p99), f"{100 * r.share_above_1e_6:.2f} %", str(r.missed),
                str(r.false), "-" if math.isnan(r.type_flips) else f"{100 * r.type_flips:.2f} %",
                number(r.energy_drift_median), number(r.energy_drift_max), str(r.failed),
                str(r.runs),
            ]
        )  # fmt: skip
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
