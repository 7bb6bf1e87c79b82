"""Fig. 7: types in the steady direction (S1-S5, S9b); supplement: friction (C1)."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rattlesweep.api import is_chaotic, wilson
from rattlesweep.api.style import (
    SERIES,
    TYPE_STYLE,
    add_legend,
    value_text,
)
from rattlesweep.paper.claim import (
    Measured,
    Tally,
    every,
    extremes,
    rises,
    share_and_text,
)
from rattlesweep.paper.workspace import (
    Made,
    Tables,
    Workspace,
    draw_spin,
    follow_run,
    paper_figure,
    records,
    thinned,
)
from rattlesweep.physics.body import PARAMETERS, Rattleback

POINT = ["K_r", "n_i", "omega_xy0"]
# Types in the order of the legend.
_SHOWN = ("R", "SW", "SS", "unclassified")
# Examples of (b): the runs to choose from, the column to sort them by, and the title.
EXAMPLES = {
    "spin_ss": (
        "type == 'SS' and n_i == -0.5 and omega_xy0 == 0.1",
        "n_end",
        "(b-1) SS",
    ),
    "spin_sw": (
        "type == 'SW' and n_i == -0.4 and omega_xy0 == 0.01",
        "n_departure",
        "(b-2) SW",
    ),
    "spin_chaotic": (
        "chaotic and K_r == 0.0041 and n_i == -0.5",
        "lyapunov_late",
        "(b-3) SW, chaotic",
    ),
}
# Friction from which on most bodies that reverse do so in one direction only (C1).
LEAST_SIGMA = 0.008
LEAST_LEVER = 0.005
EXPONENTS = ("lyapunov", "lyapunov_late", "kaplan_yorke", "regime")
# Range for "only several Type SS samples out of 8000 samples".
SEVERAL = (1, 20)


def with_shares(rows: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
    """Add each count's share of the ``runs``, with its 95 % interval (Wilson)."""
    for name in names:
        share = f"fraction_{name}"
        rows[share] = rows[name] / rows["runs"]
        rows[f"{share}_low"], rows[f"{share}_high"] = wilson(rows[name], rows["runs"])
    return rows


def draw_share(axis: Axes, rows: pd.DataFrame, by: str, name: str, **look: Any) -> None:
    """Draw a share with its interval against a column."""
    value = rows[f"fraction_{name}"]
    bars = [value - rows[f"fraction_{name}_low"], rows[f"fraction_{name}_high"] - value]
    look = {"markerfacecolor": "white"} | look
    axis.errorbar(
        rows[by],
        value,
        yerr=np.maximum(bars, 0),
        markersize=5,
        linewidth=0.9,
        zorder=3,
        **look,
    )


def types(ws: Workspace) -> Tables:
    """Return the tables of Fig. 7 and of its claims."""
    runs = ws.sweep("steady")
    wobbling = runs[runs["type"] == "SW"]
    tested = ws.again(wobbling, ws.sizes.lyapunov, "lyapunov", "spectrum")
    runs = runs.join(tested.reindex(columns=[*EXPONENTS]))
    runs["chaotic"] = is_chaotic(runs["lyapunov_late"], runs["t_end"])
    return {
        "fractions": fractions(runs),
        "settled": _settled(runs[runs["type"] == "SS"]),
        "chaos": runs.loc[tested.index],
        **examples(runs),
    }


def fractions(runs: pd.DataFrame) -> pd.DataFrame:
    """Count the types of every case."""
    past = runs["n_c1"].abs() < runs["n_i"].abs()
    steady = runs["type"] == "SS"
    counts = runs[POINT].assign(
        runs=1,
        bondi=past,
        ss_only=steady & ~past,
        bondi_only=past & ~steady,
        **{name: runs["type"] == name for name in _SHOWN},
    )
    return with_shares(
        counts.groupby(POINT, sort=False).sum().reset_index(), ["bondi", *_SHOWN]
    )


def _settled(runs: pd.DataFrame) -> pd.DataFrame:
    """Return where spins of type SS end; ``gain`` is 1 if all energy became spin."""
    # Within 1 % of Bondi's threshold the oscillation has not decayed by the horizon.
    near = runs["n_c1"].abs() > 0.99 * runs["n_i"].abs()
    beyond = runs["n_end"] / runs["n_i"] - 1
    gain = (runs["n_end"] - runs["n_i"]) / (-runs["n_0"] - runs["n_i"])
    return runs[POINT].assign(near=near, beyond=beyond, gain=gain)


def examples(runs: pd.DataFrame) -> Tables:
    """Return the table ``examples`` and the thinned spin of each that the sweep has."""
    rows = []
    tables = {}
    for name, (condition, by, _) in EXAMPLES.items():
        chosen = runs.query(condition).sort_values([by, "K_r", "sample"])
        if chosen.empty:
            continue
        # The most chaotic run; for the other examples, the median run.
        place = (len(chosen) - 1) // 2
        if name == "spin_chaotic":
            place = -1
        run = chosen.iloc[place]
        shown = min(20_000.0, run["t_end"])
        series = follow_run(
            Rattleback(*map(float, run[list(PARAMETERS)])),
            "n",
            n_i=run["n_i"],
            omega_xy0=run["omega_xy0"],
            t_end=shown,
        )
        tables[name] = thinned(series.table, n=1100)
        numbers = run[[*POINT, "sample", "t_end", "lyapunov_late"]]
        rows.append({"example": name, **numbers, "shown": shown})
    return tables | {"examples": pd.DataFrame(rows)}


def pooled(
    frame: pd.DataFrame, *names: str, by: Sequence[str] = ("n_i", "omega_xy0")
) -> pd.DataFrame:
    """Count ``hits``, the runs of some types; ``half`` is 1 for the larger K_r."""
    middle = np.sqrt(frame["K_r"].min() * frame["K_r"].max())
    half = (frame["K_r"] >= middle).astype(int)
    frame = frame.assign(half=half, hits=frame[list(names)].sum(axis=1))
    return with_shares(
        frame.groupby(list(by))[["hits", "runs"]].sum().reset_index(), ["hits"]
    )


def steady_spin(made: Made) -> Measured:
    """Measure S1: slow spins reverse; SS appears at faster ones."""
    frame = made["fig7"]["fractions"]
    slowest = frame[frame["n_i"] == frame["n_i"].max()]
    beyond = frame.query("abs(n_i) >= 0.3")
    by_spin = pooled(frame, "SS")
    largest = by_spin.groupby("n_i")[["fraction_hits"]].max()
    halves = pooled(beyond, "SS", by=("n_i", "omega_xy0", "half"))
    each = pooled(beyond.query("omega_xy0 <= 0.01"), "SS")["hits"]
    top = records(frame.nlargest(1, "fraction_SS"))[0]
    most = share_and_text(int(slowest["R"].sum()), int(slowest["runs"].sum()))
    checks = [
        every([frame.query("abs(n_i) <= 0.2")["SS"].sum() == 0])
        + every(each > 0, True),
        every([most["value"] >= 0.99], most["high"] >= 0.99),
        rises(by_spin[by_spin["hits"] > 0], "fraction_hits", "n_i", ["omega_xy0"]),
        rises(by_spin, "fraction_hits", "omega_xy0", ["n_i"], sign=-1),
        rises(halves, "fraction_hits", "half", ["n_i", "omega_xy0"], sign=-1),
    ]
    return checks, {
        "value": top["fraction_SS"],
        "low": top["fraction_SS_low"],
        "high": top["fraction_SS_high"],
        "K_r": top["K_r"],
        "n_i": top["n_i"],
        "slowest": slowest["n_i"].iloc[0],
        "reversing": most["share"],
        "by_spin": records(largest.reset_index()),
    }


def wobbling(made: Made) -> Measured:
    """Measure S2: from which spin on SW appears, and its share."""
    frame = made["fig7"]["fractions"]
    slow = frame.query("abs(n_i) <= 0.3")
    beyond = frame.query("abs(n_i) >= 0.4")
    by_half = ("n_i", "omega_xy0", "half")
    halves = [pooled(cases, "SW", by=by_half) for cases in (slow, beyond)]
    around = pooled(beyond, "SW")
    both = pooled(beyond, "SW", "unclassified")["fraction_hits"]
    by_spin = pooled(frame, "SW").groupby("n_i")["fraction_hits"]
    checks = [
        every([frame.query("abs(n_i) <= 0.1")["SW"].sum() > 0], True),
        *(
            rises(counts, "fraction_hits", "half", ["n_i", "omega_xy0"], sign=-1)
            for counts in halves
        ),
        every(
            around["fraction_hits"].between(0.15, 0.25),
            (around["fraction_hits_high"] >= 0.15)
            & (around["fraction_hits_low"] <= 0.25),
        ),
    ]
    return checks, {
        **share_and_text(int(beyond["SW"].sum()), int(beyond["runs"].sum())),
        "single": extremes(beyond["fraction_SW"]),
        "both": extremes(both),
        "both_mean": both.mean(),
        "mean": around["fraction_hits"].mean(),
        "by_spin": records(by_spin.agg(["min", "max"]).reset_index()),
    }


def threshold(made: Made) -> Measured:
    """Measure S3: at the smallest oscillation, SS is just past Bondi's threshold."""
    cases = made["fig7"]["fractions"].query("omega_xy0 <= 0.001")
    wrong = int(cases[["ss_only", "bondi_only"]].sum().sum())
    runs = int(cases["runs"].sum())
    numbers = {"wrong": wrong, "runs": runs, "SS": int(cases["SS"].sum())}
    return [Tally(runs - wrong, runs)], share_and_text(wrong, runs) | numbers


def large_oscillation(made: Made) -> Measured:
    """Measure S4: at a large oscillation some bodies past the threshold are not SS."""
    frame = made["fig7"]["fractions"]
    size = frame["omega_xy0"].max()
    large = frame.query("omega_xy0 == @size")
    least = frame.query("omega_xy0 == omega_xy0.min()")
    hits, runs = map(int, large.query("n_i == -0.3")[["SS", "runs"]].sum())
    more = pooled(least.query("abs(n_i) >= 0.4"), "SS")
    fewer = pooled(large.query("abs(n_i) >= 0.4"), "SS")
    decided = share_and_text(hits, runs)
    past = int(large["bondi_only"].sum())
    checks = [
        past > 0,
        every(
            [SEVERAL[0] <= 8000 * decided["value"] <= SEVERAL[1]],
            8000 * decided["low"] <= SEVERAL[1]
            and 8000 * decided["high"] >= SEVERAL[0],
        ),
        every(
            fewer["fraction_hits"] < more["fraction_hits"],
            fewer["fraction_hits_low"] < more["fraction_hits_high"],
        ),
    ]
    return checks, {
        **decided,
        "bondi_only": past,
        "bondi": int(large["bondi"].sum()),
        "omega_xy0": size,
        "hits": hits,
        "runs": runs,
        "most": decided["high"] * runs,
    }


def wobbling_chaos(made: Made) -> Measured | None:
    """Measure S5: which wobbling runs are chaotic; None: no slow or no fast ones."""
    runs = made["fig7"]["chaos"]
    calm = runs.query("abs(n_i) <= 0.4")
    fast = runs.query("n_i == -0.5")
    if calm.empty or fast.empty:
        return None
    middle = np.sqrt(runs["K_r"].min() * runs["K_r"].max())
    least = fast["K_r"].min()
    below = fast.query("K_r < @middle")
    above = fast.query("K_r >= @middle")
    (hits, total), (many, small), (few, large), lowest = (
        (int(group["chaotic"].sum()), len(group))
        for group in (calm, below, above, fast.query("K_r == @least"))
    )
    chaotic = runs[runs["chaotic"]]
    attractors = int((chaotic["regime"] == "attractor").sum())
    overlap = wilson(many, small)[1] > wilson(few, large)[0]
    checks = [
        Tally(total - hits, total),
        every([many > 0], True),
        every([many * large > few * small], overlap),
    ]
    return checks, {
        **share_and_text(hits, total),
        "hits": hits,
        "runs": total,
        "middle": middle,
        "small": f"{many} of {small}",
        "large": f"{few} of {large}",
        "K_r": least,
        "least": f"{lowest[0]} of {lowest[1]}, {share_and_text(*lowest)['share']}",
        "attractors": f"{attractors} of {len(chaotic)}",
        "dimension": chaotic["kaplan_yorke"].median(),
        "periodic": int((runs["regime"] == "periodic").sum()),
    }


def settled_spins(made: Made) -> Measured | None:
    """Measure S9b: where spins of SS end and SW wobbles; None if a type is missing."""
    settled = made["fig7"]["settled"]
    wobbling = made["fig8"]["windows"].query("wobbling > 0")
    far = settled.query("not near")
    if far.empty or wobbling.empty:
        return None
    faster = every(far["beyond"] > 0)
    between = Tally(
        int(wobbling["centre_between"].sum()), int(wobbling["wobbling"].sum())
    )
    medians = far.groupby(["n_i", "omega_xy0"])[["beyond", "gain"]].median()
    sizes = medians.groupby("omega_xy0")["beyond"].median().reset_index()
    return [faster, every((medians["gain"] - 1).abs() < 0.1), between], {
        "value": wobbling["centre_median"].median(),
        "low": wobbling["centre_low"].min(),
        "high": wobbling["centre_high"].max(),
        "faster": faster,
        "between": between,
        "near": len(settled) - len(far),
        "beyond": records(sizes),
        "most": far["beyond"].max(),
        "gain": medians["gain"].median(),
    }


def draw_types(tables: Tables) -> Figure:
    """Draw (a), a column for each spin and a row for each oscillation, and (b)."""
    values = tables["fractions"].sort_values("K_r")
    occurring = [name for name in _SHOWN if values[name].any()]
    shown = records(tables["examples"])
    spins = sorted(values["n_i"].unique(), key=abs)
    sizes = sorted(values["omega_xy0"].unique())
    heights = [1.75 * len(sizes) + 0.7]
    if shown:
        heights.append(2.4)
    figure = paper_figure(2.1 * len(spins) + 0.6, sum(heights))
    upper, *lower = figure.subfigures(
        len(heights), 1, height_ratios=heights, squeeze=False
    )[:, 0]
    axes = upper.subplots(
        len(sizes), len(spins), sharex=True, sharey=True, squeeze=False
    )
    for spin, size in product(spins, sizes):
        rows = values[(values["n_i"] == spin) & (values["omega_xy0"] == size)]
        axis = axes[sizes.index(size), spins.index(spin)]
        axis.plot(
            rows["K_r"],
            rows["fraction_bondi"],
            color="black",
            marker="^",
            markersize=3.4,
            linestyle="none",
            label=r"$|n_{c1}| < |n_i|$ (Bondi)",
            zorder=4,
        )
        for name in occurring:
            mark = TYPE_STYLE[name]
            face = "white"
            if mark.marker == "x":  # a cross has no face to leave white
                face = mark.colour
            draw_share(
                axis,
                rows,
                "K_r",
                name,
                color=mark.colour,
                marker=mark.marker,
                label=mark.label,
                markerfacecolor=face,
            )
        axis.grid(visible=True, axis="y")
        axis.set(xlabel="$K_r$", ylabel=f"{value_text('omega_xy0', size)}\nfraction")
        if size == sizes[0]:
            axis.set_title(value_text("n_i", spin))
        axis.label_outer()
    # On a short logarithmic axis the labels between decades overlap.
    axes[0, 0].tick_params(axis="x", which="minor", labelbottom=False)
    axes[0, 0].set(xscale="log", ylim=(-0.04, 1.04), yticks=[0, 0.5, 1])
    axes[0, 0].set_title("(a)", loc="left")
    add_legend(upper, axes[0, 0].get_legend_handles_labels()[0])
    if shown:
        below = lower[0].subplots(1, len(shown), squeeze=False)[0]
        for axis, row in zip(below, shown, strict=True):
            draw_spin(axis, tables[row["example"]], 0.7)
            point = ", ".join(
                value_text(name, row[name]) for name in ("n_i", "omega_xy0", "K_r")
            )
            axis.set_title(f"{EXAMPLES[row['example']][2]}\n{point}")
    return figure


def friction(ws: Workspace) -> Tables:
    """Return how many bodies reverse which way, by the size of a friction.

    The tables are ``shares``, by sigma, and ``pivoting``, by the lever of pivoting
    friction.
    """
    return {
        "shares": _ways(ws.sweep("friction"), "sigma"),
        "pivoting": _ways(ws.sweep("pivoting"), "pivot"),
    }


def _ways(runs: pd.DataFrame, size: str) -> pd.DataFrame:
    """Count the bodies that reverse which way, by the column `size` of a friction."""
    turns = runs.pivot_table("n_turns", [size, "sample"], "n_i").dropna()
    unsteady = turns[0.3] > 0
    steady = turns[-0.3] > 0
    ways = pd.DataFrame(
        {
            "runs": 1,
            "one_way": unsteady & ~steady,
            "both": unsteady & steady,
            "neither": ~unsteady & ~steady,
            "steady_only": ~unsteady & steady,
            "unsteady": unsteady,
            "twice": turns[0.3] > 1,
        }
    )
    rows = ways.groupby(size).sum().reset_index()
    return with_shares(rows, ["one_way", "both", "neither"])


def one_way(made: Made) -> Measured:
    """Measure C1: the share of bodies that reverse in one direction only."""
    by_sigma = made["friction"]["shares"]
    by_lever = made["friction"]["pivoting"]
    tops = []
    steady_only = []
    most_of_rest = []
    for rows, size, least in (
        (by_sigma, "sigma", LEAST_SIGMA),
        (by_lever, "pivot", LEAST_LEVER),
    ):
        tops.append(records(rows.nlargest(1, "fraction_one_way"))[0])
        steady_only.append(rows["steady_only"] == 0)
        still = rows[(rows["unsteady"] > rows["runs"] / 2) & (rows[size] >= least)]
        most_of_rest.append(wilson(still["one_way"], still["unsteady"]))
    low, high = np.concatenate(most_of_rest, axis=1)
    checks = [
        every(
            [top["fraction_one_way_low"] > 0.5 for top in tops],
            [top["fraction_one_way_high"] > 0.5 for top in tops],
        ),
        every(np.concatenate(steady_only)),
        every(low > 0.5, high > 0.5),
    ]
    top, top_lever = tops
    return checks, {
        "value": top["fraction_one_way"],
        "low": top["fraction_one_way_low"],
        "high": top["fraction_one_way_high"],
        "rows": records(by_sigma),
        "levers": records(by_lever),
        "lever": top_lever,
        "runs": int(by_sigma["runs"].max()),
        "runs_lever": int(by_lever["runs"].max()),
        "twice": records(by_sigma.assign(share=by_sigma["twice"] / by_sigma["runs"])),
        "twice_lever": records(
            by_lever.assign(share=by_lever["twice"] / by_lever["runs"])
        ),
    }


def draw_friction(tables: Tables) -> Figure:
    """Draw the shares of the bodies against sigma, and against the lever."""
    figure = paper_figure(7.2, 3.4)
    axes = figure.subplots(1, 2, sharey=True)
    names = {
        "both": "in both",
        "one_way": "in the unsteady direction only",
        "neither": "in neither",
    }
    panels = (
        ("shares", "sigma", r"$\sigma$ / $M a^2 \tilde\omega$"),
        ("pivoting", "pivot", "lever of pivoting friction / $a$"),
    )
    for axis, (table, size, label) in zip(axes, panels, strict=True):
        for (name, way), (colour, marker) in zip(names.items(), SERIES, strict=False):
            draw_share(
                axis,
                tables[table],
                size,
                name,
                color=colour,
                marker=marker,
                label=way,
            )
        axis.set(xscale="log", ylim=(-0.03, 1.03), xlabel=label)
        axis.grid(visible=True)
    axes[0].set_ylabel("share of the bodies that reverse")
    add_legend(figure, axes[0].get_legend_handles_labels()[0])
    return figure
