"""Fig. 7: fractions of the types R, SS and SW in the steady direction, and examples of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from rattlesweep.analysis.style import BLUE, TYPE_STYLE, new_figure
from rattlesweep.paper.figures.chaos import exponents
from rattlesweep.paper.figures.frames import ABOVE, N_AXIS, T_AXIS, decade_ticks, frame, launch
from rattlesweep.paper.figures.single import FORCES, body_of, follow, forces, thinned
from rattlesweep.paper.workspace import Tables, Workspace, at, records
from rattlesweep.sweeps.counts import wilson

# In the order of the legend.
SHOWN = ("R", "SW", "SS", "unclassified")
BONDI = r"$|n_{c1}| < |n_i|$ (Bondi)"
EXAMPLES = {"spin_ss": "(b-1) SS", "spin_sw": "(b-2) SW", "spin_chaotic": "(b-3) SW, chaotic"}
# Launches of the examples.  The paper says of the chaotic run only where it lies.
SS_AT = {"n_i": -0.5, "omega_xy0": 0.1}
SW_AT = {"n_i": -0.4, "omega_xy0": 0.01}
CHAOTIC_AT = {"K_r": 0.0041, "n_i": -0.5}
# Most runs that are tried for the chaotic example.
TRIED = 600
# Longest time of an example, in sqrt(a/g), and stretches of its curve.
LONGEST, BINS = 20_000.0, 1100


def data(ws: Workspace) -> Tables:
    """Return the tables of the figure and of what its claims need.

    ``fractions``: one row a point.  ``definitions``: other readings of SS.  ``settled``: where the
    spin of SS ends.  ``examples``, ``forces``, ``spin_ss``, ``spin_sw``, ``spin_chaotic``: part
    (b), as far as the sweep has such runs.
    """
    runs = ws.sweep("steady")
    return {
        "fractions": fractions(runs),
        "definitions": readings(runs),
        "settled": settled(runs),
        **examples(ws, runs),
    }


def fractions(runs: pd.DataFrame) -> pd.DataFrame:
    """Count the types of every case, with 95 % intervals of their shares (Wilson)."""
    past, steady = runs["n_c1"].abs() < runs["n_i"].abs(), runs["type"] == "SS"
    found = runs[["K_r", "n_i", "omega_xy0"]].assign(
        runs=1, bondi=past, ss_only=steady & ~past, bondi_only=past & ~steady,
        **{name: runs["type"] == name for name in SHOWN},
    )  # fmt: skip
    rows = found.groupby(["K_r", "n_i", "omega_xy0"], sort=False).sum().reset_index()
    for name in ("bondi", *SHOWN):
        rows[f"fraction_{name}"] = rows[name] / rows["runs"]
    for name in SHOWN:
        rows[f"low_{name}"], rows[f"high_{name}"] = wilson(rows[name], rows["runs"])
    return rows


def readings(runs: pd.DataFrame) -> pd.DataFrame:
    """Count the runs that are SS by several readings of "decays monotonously"."""
    stays = runs["t_r"].isna()
    found = {"type SS (amplitude never grows by more than the threshold)": runs["type"] == "SS"}
    for limit in (0.01, 0.1, 0.3):
        words = f"amplitude never grows by more than {limit:.0%}"
        found[words] = stays & (runs["amp_growth"] <= limit)
    for limit in (0.01, 0.02, 0.05):
        words = f"no reversal, spin never falls by more than {limit:.0%}"
        found[words] = stays & (runs["n_departure"] <= limit)
    past = runs["n_c1"].abs() < runs["n_i"].abs()
    found["no reversal, past Bondi's threshold"] = stays & past
    rows = [
        {"n_i": n_i, "omega_xy0": size, "definition": words, "count": counted[own.index].sum(),
         "runs": len(own)}
        for (n_i, size), own in runs.groupby(["n_i", "omega_xy0"], sort=False)
        for words, counted in found.items()
    ]  # fmt: skip
    return pd.DataFrame(rows)


def settled(runs: pd.DataFrame) -> pd.DataFrame:
    """Return where the runs of type SS end, by spin and oscillation.

    ``gain`` is ``(n_end - n_i)/(-n_0 - n_i)``: 1 if all energy of the oscillation has gone into the
    spin, 0 if the spin ends as it was launched.  Runs within 1 % of Bondi's threshold are counted
    as ``near`` and otherwise left out: their oscillation is still there at the horizon.
    """
    steady = runs[runs["type"] == "SS"]
    near = steady["n_c1"].abs() > 0.99 * steady["n_i"].abs()
    own = steady.assign(near=near.groupby([steady["n_i"], steady["omega_xy0"]]).transform("sum"))
    own = own[~near]
    beyond = own["n_end"] / own["n_i"] - 1
    gain = (own["n_end"] - own["n_i"]) / (-own["n_0"] - own["n_i"])
    groups = own.assign(beyond=beyond, gain=gain, faster=beyond > 0).groupby(
        ["n_i", "omega_xy0"], sort=False
    )
    return groups.agg(
        SS=("gain", "size"), near=("near", "first"), faster=("faster", "sum"),
        gain_median=("gain", "median"),
        beyond_median=("beyond", "median"), beyond_max=("beyond", "max"),
    ).reset_index()  # fmt: skip


def examples(ws: Workspace, runs: pd.DataFrame) -> Tables:
    """Return the table ``examples``, the forces in these runs, and the spin of each, thinned."""
    fast = runs[(runs["type"] == "SW") & at(runs, CHAOTIC_AT)]
    rows = choose(runs, exponents(ws, "chaotic-example", fast, TRIED))
    tables, presses = {}, []
    for row in rows:
        key = ("K_r", "n_i", "omega_xy0", "sample")
        run = runs[at(runs, {name: row[name] for name in key})].iloc[0]
        row["shown"] = min(LONGEST, row["t_end"])
        found = follow(body_of(run), f"Fig. 7(b), {row['example']}", "n", *FORCES, n_i=row["n_i"],
                       omega_xy0=row["omega_xy0"], t_end=row["shown"])  # fmt: skip
        tables[row["example"]] = thinned(found.table, n=BINS)
        name = row["example"].removeprefix("spin_").replace("chaotic", "chaotic SW")
        presses.append(forces(f"Fig. 7(b), {name}", found.table))
    names = ["example", *key, "t_end", "n_departure", "lyapunov_late", "shown"] if rows else None
    chosen = pd.DataFrame(rows).reindex(columns=names) if rows else pd.DataFrame()
    return tables | {"examples": chosen, "forces": pd.DataFrame(presses)}


def choose(runs: pd.DataFrame, fast: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the examples, as far as there are such runs.

    SS: of this launch, the run with the median spin at its end.  SW: of this launch, the run with
    the median loss of spin.  Chaotic: of the runs with exponents, the one with the largest exponent
    over its second half.
    """
    last = [*SS_AT, "K_r", "sample"]
    ordered = {
        "spin_ss": runs[(runs["type"] == "SS") & at(runs, SS_AT)].sort_values(["n_end", *last]),
        "spin_sw": runs[(runs["type"] == "SW") & at(runs, SW_AT)].sort_values(
            ["n_departure", *last]
        ),
        "spin_chaotic": fast[fast["chaotic"].astype(bool)].nlargest(1, "lyapunov_late"),
    }
    # The one in the middle, the lower one of two.
    return [
        {"example": name, **{str(k): v for k, v in own.iloc[(len(own) - 1) // 2].items()}}
        for name, own in ordered.items() if len(own)
    ]  # fmt: skip


def draw(tables: Tables) -> Drawing:
    """Draw (a), a column a spin and a row an oscillation, and (b) examples, if there are any."""
    values = tables["fractions"]
    spins, sizes = sorted(values["n_i"].unique(), key=abs), sorted(values["omega_xy0"].unique())
    shown = records(tables["examples"])
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
    # Bondi's marks have no bars and would come first.
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
        spin = tables[row["example"]]
        axis.plot(spin["t"], spin["n"], color=BLUE, linewidth=0.7)
        axis.set_xlabel(T_AXIS)
        axis.locator_params(axis="x", nbins=5)
        frame(axis, EXAMPLES[row["example"]] + "\n" + launch(row, "n_i", "omega_xy0", "K_r"))
        axis.title.set_fontsize(9.5)
    axes[0].set_ylabel(N_AXIS)
