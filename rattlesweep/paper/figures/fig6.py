"""Fig. 6: fractions of the types R, SS and SW in the steady direction."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.paper.claims.claim import wilson
from rattlesweep.paper.figures import examples, steady_checks
from rattlesweep.paper.style import TYPES, decade_ticks, frame, new_figure
from rattlesweep.paper.sweeps import part
from rattlesweep.study.style import BLUE
from rattlesweep.sweeps.tables.columns import RATE

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rattlesweep.paper.sweeps import Place, Report, Sweep

KINDS = tuple(TYPES)
BONDI = r"$|n_{c1}| < |n_i|$ (Bondi)"


def schema() -> pa.Schema:
    """Columns of the table ``fractions``."""

    def column(name: str, words: str, *, whole: bool = False, unit: str = "1") -> pa.Field:
        kind = pa.int64() if whole else pa.float64()
        return pa.field(name, kind, metadata={"unit": unit, "description": words})

    fields = [
        column("K_r", "target of the torque coefficient"),
        column("n_i", "initial spin", unit=RATE),
        column("omega_xy0", "initial rate of the oscillation", unit=RATE),
        column("runs", "runs with status ok", whole=True),
        column("bondi", "bodies with abs(n_c1) < abs(n_i)", whole=True),
        column("ss_only", "runs of type SS without abs(n_c1) < abs(n_i)", whole=True),
        column("bondi_only", "bodies with abs(n_c1) < abs(n_i) that are not SS", whole=True),
        column("fraction_bondi", "share with abs(n_c1) < abs(n_i)"),
    ]
    for name in KINDS:
        fields += [
            column(name, f"runs of type {name}", whole=True),
            column(f"fraction_{name}", f"share of type {name}"),
            column(f"low_{name}", "its 95 % confidence interval (Wilson), lower end"),
            column(f"high_{name}", "the same, upper end"),
        ]
    return pa.schema(fields)


def compute(place: Place, report: Report) -> dict[str, pa.Table]:
    """Data of the figure, and what its claims need.

    Returns
    -------
    dict
        ``fractions``: one row a point. ``rk4``, ``definitions``, ``basin``: see
        :mod:`rattlesweep.paper.figures.steady_checks`. ``chaos``, ``examples``, ``forces`` and the
        spins of part (b): see :mod:`rattlesweep.paper.figures.examples`.
    """
    sweep = place.sweep("steady", part(report, 0.0, 0.1))
    tables = {"fractions": fractions(sweep), "definitions": steady_checks.definitions(sweep)}
    tables["basin"] = steady_checks.basin(place, sweep, part(report, 0.1, 0.15))
    tables |= examples.compute(place, sweep, part(report, 0.15, 0.6))
    tables["rk4"] = steady_checks.rk4(place, sweep, part(report, 0.6, 1.0))
    return tables


def fractions(sweep: Sweep) -> pa.Table:
    """Count the types of every case."""
    rows = []
    for case, runs in sweep.cases(("n_c1", "n_i", "type")):
        total = len(runs)
        past = (runs["n_c1"].abs() < runs["n_i"].abs()).to_numpy()
        steady = (runs["type"] == "SS").to_numpy()
        row: dict[str, Any] = {
            "K_r": case.target,
            "n_i": case.n_i,
            "omega_xy0": case.omega_xy0,
            "runs": total,
            "bondi": int(past.sum()),
            "ss_only": int((steady & ~past).sum()),
            "bondi_only": int((past & ~steady).sum()),
            "fraction_bondi": float(past.mean()) if total else None,
        }
        for name in KINDS:
            hits = int((runs["type"] == name).sum())
            low, high = wilson(hits, total) if total else (None, None)
            row |= {
                name: hits,
                f"fraction_{name}": hits / total if total else None,
                f"low_{name}": low,
                f"high_{name}": high,
            }
        rows.append(row)
    return pa.Table.from_pylist(rows, schema=schema())


# ---------------------------------------------------------------------------- the picture


def draw(tables: Mapping[str, pa.Table]) -> Any:
    """Part (a): a column a spin, a row an oscillation; part (b) if there are tables of spins.

    These are ``spin_ss``, ``spin_sw`` and ``spin_chaotic``, with columns ``t`` and ``n`` each.
    """
    data = tables["fractions"].to_pandas()
    spins = sorted(data["n_i"].unique(), key=abs)
    sizes = sorted(data["omega_xy0"].unique())
    traces = [(n, tables[n]) for n in ("spin_ss", "spin_sw", "spin_chaotic") if n in tables]
    height = 1.75 * len(sizes) + 0.7
    figure: Any = new_figure(2.1 * len(spins) + 0.6, height + (2.4 if traces else 0.0))
    upper = figure
    if traces:
        upper, lower = figure.subfigures(2, 1, height_ratios=(height, 2.4))
        rows = tables["examples"].to_pylist() if "examples" in tables else []
        _traces(lower, traces, {row["example"]: row for row in rows})
    axes = upper.subplots(len(sizes), len(spins), sharex=True, sharey=True, squeeze=False)
    for row, size in zip(axes, sizes, strict=True):
        for axis, spin in zip(row, spins, strict=True):
            own = data[(data["n_i"] == spin) & (data["omega_xy0"] == size)].sort_values("K_r")
            _panel(axis, own)
        row[0].set_ylabel(rf"$|\omega_{{xy0}}| = {size:g}$" + "\nfraction")
    for axis, spin in zip(axes[0], spins, strict=True):
        axis.set_title(rf"$n_i = {spin:g}$", fontsize=10, pad=4)
    if traces:
        axes[0, 0].set_title("(a)", loc="left", fontsize=10, pad=4)
    for axis in axes[-1]:
        axis.set_xlabel("$K_r$")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    marks = dict(zip(labels, handles, strict=True))
    marks[BONDI] = marks.pop(BONDI)
    upper.legend(marks.values(), marks, loc="outside upper center", ncols=len(marks),
                 frameon=False, fontsize=9.5)  # fmt: skip
    return figure


def _panel(axis: Any, rows: pd.DataFrame) -> None:
    x = rows["K_r"].to_numpy()
    for name, (colour, shape, label) in TYPES.items():
        share = rows[f"fraction_{name}"].to_numpy()
        bars = np.array([share - rows[f"low_{name}"], rows[f"high_{name}"] - share])
        axis.errorbar(
            x, share, yerr=np.maximum(bars, 0), color=colour, marker=shape, markersize=5,
            markerfacecolor="white" if shape != "x" else colour, markeredgewidth=1.1,
            linewidth=0.9, elinewidth=0.8, label=label, zorder=3,
        )  # fmt: skip
    axis.plot(x, rows["fraction_bondi"], color="black", marker="^", markersize=3.4,
              linestyle="none", label=BONDI, zorder=4)  # fmt: skip
    axis.set(xscale="log", ylim=(-0.04, 1.04), yticks=[0, 0.5, 1])
    axis.set_xlim(rows["K_r"].min() / 1.3, rows["K_r"].max() * 1.3)
    decade_ticks(axis.xaxis)
    axis.grid(visible=True, axis="y", color="#e3e3e3", linewidth=0.6)
    frame(axis)


def _traces(
    figure: Any, traces: list[tuple[str, pa.Table]], runs: Mapping[str, dict[str, Any]]
) -> None:
    titles = {"spin_ss": "(b-1) SS", "spin_sw": "(b-2) SW", "spin_chaotic": "(b-3) SW, chaotic"}
    axes = figure.subplots(1, len(traces), squeeze=False)[0]
    for axis, (name, table) in zip(axes, traces, strict=True):
        axis.plot(table["t"].to_numpy(), table["n"].to_numpy(), color=BLUE, linewidth=0.7)
        title = titles[name]
        if name in runs:
            run = runs[name]
            launch = rf"$n_i = {run['n_i']:g}$, $|\omega_{{xy0}}| = {run['omega_xy0']:g}$"
            title += f"\n{launch}, $K_r = {run['K_r']:g}$"
        axis.set_title(title, fontsize=9.5, pad=4)
        axis.set_xlabel(r"$t$ / $\tilde t$")
        axis.locator_params(axis="x", nbins=5)
        frame(axis)
    axes[0].set_ylabel(r"$n$ / $\tilde\omega$")
