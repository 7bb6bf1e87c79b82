"""Fig. 6: fractions of the types R, SS and SW in the steady direction, and examples of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from rattlesweep.analysis.style import BLUE, TYPE_STYLE, new_figure
from rattlesweep.paper.columns import count, number, schema, table, word
from rattlesweep.paper.figures.chaos import CHAOS, exponents, launch_of
from rattlesweep.paper.figures.follow import FORCE_CHANNELS, FORCES, SPIN, follow, forces, thinned
from rattlesweep.paper.figures.integrators import rk4
from rattlesweep.paper.figures.style import ABOVE, N_AXIS, T_AXIS, decade_ticks, frame, launch
from rattlesweep.paper.workspace import Progress, StoredRuns, Tables, Workspace, between
from rattlesweep.sweeps.columns import RATE, TIME
from rattlesweep.sweeps.counts import wilson

# In the order of the tables, and of the legend.
KINDS = ("R", "SS", "SW", "unclassified")
SHOWN = ("R", "SW", "SS", "unclassified")
BONDI = r"$|n_{c1}| < |n_i|$ (Bondi)"
EXAMPLES = {"spin_ss": "(b-1) SS", "spin_sw": "(b-2) SW", "spin_chaotic": "(b-3) SW, chaotic"}
FRACTIONS = schema(
    "K_r n_i omega_xy0 runs",
    count("bondi", "bodies with abs(n_c1) < abs(n_i)"),
    count("ss_only", "runs of type SS without abs(n_c1) < abs(n_i)"),
    count("bondi_only", "bodies with abs(n_c1) < abs(n_i) that are not SS"),
    number("fraction_bondi", "share with abs(n_c1) < abs(n_i)"),
    *(
        column
        for name in SHOWN
        for column in (
            count(name, f"runs of type {name}"),
            number(f"fraction_{name}", f"share of type {name}"),
            number(f"low_{name}", "its 95 % confidence interval (Wilson), lower end"),
            number(f"high_{name}", "the same, upper end"),
        )
    ),
)


def data(ws: Workspace, progress: Progress) -> Tables:
    """Data of the figure, and what its claims need.

    ``fractions``: one row a point.  ``definitions``, ``basin``: other readings of SS, larger
    oscillations.  ``chaos``: :mod:`rattlesweep.paper.figures.chaos`.  ``rk4``:
    :mod:`rattlesweep.paper.figures.integrators`.  ``examples``, ``forces``, ``spin_ss``,
    ``spin_sw``, ``spin_chaotic``: part (b), as far as the sweep has such runs.
    """
    sweep = ws.sweep("steady", progress)
    escaped = basin(ws, between(progress, 0.1, 0.15))
    wobbling = exponents(ws, between(progress, 0.15, 0.5))
    return {
        "fractions": fractions(sweep),
        "definitions": readings(sweep),
        "basin": escaped,
        "chaos": table(wobbling, CHAOS),
        **examples(sweep, wobbling, between(progress, 0.5, 0.6)),
        "rk4": rk4(ws, between(progress, 0.6, 1.0)),
    }


def fractions(sweep: StoredRuns) -> pa.Table:
    """Count the types of every case."""
    runs = sweep.runs
    past, steady = runs["n_c1"].abs() < runs["n_i"].abs(), runs["type"] == "SS"
    found = {"runs": runs["status"] == "ok", "bondi": past, "ss_only": steady & ~past,
             "bondi_only": past & ~steady}  # fmt: skip
    found |= {name: runs["type"] == name for name in SHOWN}
    counts = pd.DataFrame(found).groupby(runs["case"]).sum()
    rows = pd.DataFrame([point for point, _ in sweep.points()]).join(counts).fillna(0)
    for name in ("bondi", *SHOWN):
        rows[f"fraction_{name}"] = rows[name] / rows["runs"]
    for name in SHOWN:
        rows[f"low_{name}"], rows[f"high_{name}"] = wilson(rows[name], rows["runs"])
    return table(rows, FRACTIONS)


# ------------------------------------------------------------------ other readings of "SS"

DEFINITIONS = schema(
    "n_i omega_xy0",
    word("definition", "what is counted as SS"),
    count("count", "runs that it takes for SS"),
    more="runs",
)
GROWTHS = (0.01, 0.1, 0.3)
DEPARTURES = (0.01, 0.02, 0.05)


def readings(sweep: StoredRuns) -> pa.Table:
    """How many runs count as SS by several readings of "decays monotonously"."""
    runs = sweep.runs
    stays = runs["t_r"].isna()
    found = {
        "type SS (amplitude never grows by more than the threshold)": runs["type"] == "SS",
        **{
            f"amplitude never grows by more than {limit:.0%}": stays & (runs["amp_growth"] <= limit)
            for limit in GROWTHS
        },
        **{
            f"no reversal, spin never falls by more than {limit:.0%}": stays
            & (runs["n_departure"] <= limit)
            for limit in DEPARTURES
        },
        "no reversal, past Bondi's threshold": stays & (runs["n_c1"].abs() < runs["n_i"].abs()),
    }
    rows = [
        {"n_i": n_i, "omega_xy0": size, "definition": words, "runs": len(own),
         "count": counted[own.index].sum()}
        for (n_i, size), own in runs.groupby(["n_i", "omega_xy0"], sort=False)
        for words, counted in found.items()
    ]  # fmt: skip
    return table(rows, DEFINITIONS)


# Of a trial of how large an oscillation SS bears.
N_I, SIZES = -0.3, (0.05, 0.06, 0.07, 0.08, 0.09)
BASIN = schema(
    "n_i omega_xy0",
    count("runs", "bodies past Bondi's threshold at this spin"),
    *(count(name, f"of them, type {name}") for name in KINDS),
)


def basin(ws: Workspace, progress: Progress) -> pa.Table:
    """Types of the bodies past Bondi's threshold, launched with larger and larger oscillations.

    The bodies are those of the sweep; empty if none of them is past it.
    """
    runs = ws.sweep("steady", progress).runs
    # Cases of one target share their bodies.
    one = (runs["n_i"] == N_I) & (runs["omega_xy0"] == runs["omega_xy0"].min())
    bodies = runs[one & (runs["n_c1"].abs() < abs(N_I))]
    if bodies.empty:
        return table([], BASIN)
    launches = pd.concat([bodies.assign(omega_xy0=size) for size in SIZES], ignore_index=True)
    launches["type"] = ws.again("basin", launches, progress)["type"]
    counts = pd.crosstab(launches["omega_xy0"], launches["type"]).reindex(columns=KINDS)
    counts = counts.fillna(0).assign(n_i=N_I, runs=counts.sum(axis=1))
    return table(counts.reset_index(), BASIN)


# ------------------------------------------------------------------------------ examples

# The paper says of the chaotic run only where it lies.
SS_AT = {"n_i": -0.5, "omega_xy0": 0.1}
SW_AT = {"n_i": -0.4, "omega_xy0": 0.01}
CHAOTIC_AT = {"K_r": 0.0041, "n_i": -0.5}
# Longest that is shown, in sqrt(a/g).
LONGEST = 20_000.0
BINS = 1100
CHOSEN = schema(
    "",
    word("example", "spin_ss, spin_sw or spin_chaotic"),
    *list(CHAOS)[:6],
    number("lyapunov_late", "Lyapunov exponent over the second half of the run", RATE),
    number("shown", "time shown", TIME),
)


def examples(sweep: StoredRuns, wobbling: pd.DataFrame, progress: Progress) -> Tables:
    """Table ``examples``, the forces in these runs, and the spin of each, thinned."""
    runs = sweep.runs
    rows = choose(runs, wobbling)
    integrator = sweep.config.integrator.model_dump(exclude_none=True)
    tables, presses = {}, []
    for k, row in enumerate(rows):
        key = ("K_r", "n_i", "omega_xy0", "sample")
        run = runs[at(runs, {name: row[name] for name in key})].iloc[0]
        row["shown"] = min(LONGEST, float(run["t_end"]))
        chosen = replace(launch_of(run), t_end=row["shown"], integrator=integrator)
        words, part = f"Fig. 6(b), {row['example']}", between(progress, k / 3, (k + 1) / 3)
        found, _ = follow(chosen, ("t", "n", *FORCE_CHANNELS), words, part)
        tables[row["example"]] = thinned(found.table, SPIN, {"n": BINS})
        name = row["example"].removeprefix("spin_").replace("chaotic", "chaotic SW")
        presses.append(forces(f"Fig. 6(b), {name}", found.table))
    return tables | {"examples": table(rows, CHOSEN), "forces": table(presses, FORCES)}


def choose(runs: pd.DataFrame, wobbling: pd.DataFrame) -> list[dict[str, Any]]:
    """The examples, as far as there are such runs.

    SS: of this launch, the run with the median spin at its end.  SW: of this launch, the run with
    the median loss of spin among those that are not chaotic.  Chaotic: at this ``K_r`` and spin,
    the run with the largest exponent over its second half.
    """
    chaotic = wobbling["chaotic"].astype(bool)
    last = [*SS_AT, "K_r", "sample"]
    ordered = {
        "spin_ss": runs[(runs["type"] == "SS") & at(runs, SS_AT)].sort_values(["n_end", *last]),
        "spin_sw": wobbling[~chaotic & at(wobbling, SW_AT)].sort_values(["n_departure", *last]),
        "spin_chaotic": wobbling[chaotic & at(wobbling, CHAOTIC_AT)].nlargest(1, "lyapunov_late"),
    }
    # The one in the middle, the lower one of two.
    return [
        {"example": name, **{str(k): v for k, v in own.iloc[(len(own) - 1) // 2].items()}}
        for name, own in ordered.items() if len(own)
    ]  # fmt: skip


def at(runs: pd.DataFrame, values: dict[str, float]) -> pd.Series[bool]:
    """Which runs have these values."""
    return (runs[list(values)] == pd.Series(values)).all(axis=1)


# -------------------------------------------------------------------------------- picture


def draw(tables: Tables) -> Drawing:
    """(a) a column a spin, a row an oscillation; (b) examples, if there are any."""
    values = tables["fractions"].to_pandas()
    spins, sizes = sorted(values["n_i"].unique(), key=abs), sorted(values["omega_xy0"].unique())
    shown = tables["examples"].to_pylist()
    height = 1.75 * len(sizes) + 0.7
    figure = new_figure(2.1 * len(spins) + 0.6, height + (2.4 if shown else 0.0))
    upper: Any = figure
    if shown:
        parts: Any = figure.subfigures(2, 1, height_ratios=(height, 2.4))
        upper = parts[0]
        _examples(parts[1], shown, tables)
    axes = upper.subplots(len(sizes), len(spins), sharex=True, sharey=True, squeeze=False)
    for row, size in zip(axes, sizes, strict=True):
        for axis, spin in zip(row, spins, strict=True):
            own = values[(values["n_i"] == spin) & (values["omega_xy0"] == size)]
            _fractions(axis, own.sort_values("K_r"))
        row[0].set_ylabel(launch({"omega_xy0": size}, "omega_xy0") + "\nfraction")
    for axis, spin in zip(axes[0], spins, strict=True):
        frame(axis, launch({"n_i": spin}, "n_i"))
    if shown:
        frame(axes[0, 0], "(a)", loc="left")
    for axis in axes[-1]:
        axis.set_xlabel("$K_r$")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    marks = dict(zip(labels, handles, strict=True))
    # Its line comes first, as it has no bars.
    marks[BONDI] = marks.pop(BONDI)
    upper.legend(marks.values(), marks, ncols=len(marks), **ABOVE)
    return figure


def _fractions(axis: Axes, rows: pd.DataFrame) -> None:
    x = rows["K_r"].to_numpy()
    for name in SHOWN:
        mark, share = TYPE_STYLE[name], rows[f"fraction_{name}"].to_numpy()
        bars = np.array([share - rows[f"low_{name}"], rows[f"high_{name}"] - share])
        axis.errorbar(
            x, share, yerr=np.maximum(bars, 0), color=mark.colour, marker=mark.marker,
            markersize=5, markerfacecolor=mark.colour if mark.marker == "x" else "white",
            markeredgewidth=1.1, linewidth=0.9, elinewidth=0.8, label=mark.label, zorder=3,
        )  # fmt: skip
    axis.plot(x, rows["fraction_bondi"], color="black", marker="^", markersize=3.4,
              linestyle="none", label=BONDI, zorder=4)  # fmt: skip
    axis.set(xscale="log", ylim=(-0.04, 1.04), yticks=[0, 0.5, 1])
    axis.set_xlim(x.min() / 1.3, x.max() * 1.3)
    decade_ticks(axis.xaxis)
    frame(axis, grid="y")


def _examples(figure: Any, rows: list[dict[str, Any]], tables: Tables) -> None:
    axes = figure.subplots(1, len(rows), squeeze=False)[0]
    for axis, row in zip(axes, rows, strict=True):
        spin = tables[row["example"]].to_pandas()
        axis.plot(spin["t"], spin["n"], color=BLUE, linewidth=0.7)
        axis.set_xlabel(T_AXIS)
        axis.locator_params(axis="x", nbins=5)
        frame(axis, EXAMPLES[row["example"]] + "\n" + launch(row, "n_i", "omega_xy0", "K_r"))
        axis.title.set_fontsize(9.5)
    axes[0].set_ylabel(N_AXIS)
