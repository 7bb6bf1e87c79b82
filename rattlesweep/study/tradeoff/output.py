"""Write and say what the trade came to."""

from __future__ import annotations

import platform
from typing import TYPE_CHECKING, Any

from rattlesweep.study import style as plot_style
from rattlesweep.study.tradeoff import figure as tradeoff_figure
from rattlesweep.study.tradeoff.table import advice, advice_text, columns_of, schema, text
from rattlesweep.sweeps.store.atomic import probe_directory, replace_file
from rattlesweep.sweeps.store.provenance import machine, package_version
from rattlesweep.sweeps.tables.arrow import build_table, encode

if TYPE_CHECKING:
    from pathlib import Path

    from rattlesweep.study.tradeoff.measure import Study

NAME = "tradeoff"


def save(study: Study, directory: Path) -> list[Path]:
    """Write the table and the figure, each file in one step.

    Returns
    -------
    list of Path
        ``tradeoff.parquet``, ``tradeoff.svg``, ``tradeoff.png``.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    probe_directory(directory)
    contents = {"parquet": encode(build_table(columns_of(study.rows), schema()))}
    with plot_style.styled():
        figure = tradeoff_figure.draw(study.rows, caption(study))
        for kind in ("svg", "png"):
            contents[kind] = plot_style.encode(figure, kind, tradeoff_figure.DPI)
    paths = []
    for kind, data in contents.items():
        paths.append(directory / f"{NAME}.{kind}")
        replace_file(paths[-1], data)
    return paths


def caption(study: Study) -> str:
    """Which runs, which machine: one line."""
    return (
        f"{len(study.work)} runs of {study.work.config.name}, "
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
            text(study.rows),
            "",
            "cheapest setting",
            advice_text(study.rows),
        ]
    )


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.1e}"


def as_data(study: Study) -> dict[str, Any]:
    """The same as JSON can hold it."""
    return {
        "machine": machine() | {"python": platform.python_version()},
        "rattlesweep": package_version(),
        "facts": study.facts,
        "rows": [row.plain_data() for row in study.rows],
        "cheapest": advice(study.rows),
    }
