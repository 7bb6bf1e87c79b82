"""Draw the figure of docs/one_way.md and print its tables.

rattlesweep run configs/one_way.yaml
rattlesweep run configs/one_way_both.yaml
rattlesweep paper --only friction --output out/paper
python docs/figures/one_way.py out/one-way out/one-way-both out/paper/pivoting \
    docs/one_way.png
"""

import sys

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

import rattlesweep as rs

SPIN = -0.3  # of the panel of first reversals
MU = 0.3  # of the same
RULE = 0.65  # ratio above which a body turns back after a small push
# Edges of the spin that there is over the one that is needed.
RATIOS = (-np.inf, 0, 0.4, 0.6, 0.8, 1, 2, np.inf)
LINE_STYLES = {0.01: "-", 0.1: "--"}  # of the pushes
COLOURS = {0.0: "0.5", 0.2: "#d55e00", 0.3: "#0072b2", 0.5: "#009e73"}  # of mu
STONE = {
    "length": "12 cm",
    "width": "3 cm",
    "height": "12 mm",
    "mass": "60 g",
    "skew": "3 deg",
}
MATERIALS = {
    "steel on glass": ("steel", "glass"),
    "PLA on glass": ("PLA", "glass"),
    "PLA on wood": ("PLA", "wood"),
}
SPEEDS = (30, 45, 60, 90, 120)  # rpm


def ratio_of_rule(runs: pd.DataFrame, growing: str) -> pd.Series:
    """Return the ratio of the rule for each run; infinite where it needs no growth.

    The averaged equations with one mode of the energy ``E`` are ``dE/dt = K' abs(n) E``
    and ``gamma d abs(n)/dt = -K E - l``, with ``K'`` less than ``K`` by creep.  The
    spin passes zero if the torque ``K E`` is then above the lever ``l``: if ``K' gamma
    n_i^2 / (2 l) > 1 - e - ln e``, with ``e`` the first ``K E / l``.  The column
    `growing` has ``K'``.
    """
    lever = runs["pivot"]
    push = runs["gamma"] * (runs["n_0"] ** 2 - runs["n_i"] ** 2) / 2
    start = runs["K_r"] * push / lever
    have = runs[growing] * runs["gamma"] * runs["n_i"] ** 2 / (2 * lever)
    need = 1 - start - np.log(start)
    return (have / need).where(start < 1, np.inf)


def read(directory: str) -> pd.DataFrame:
    """Return the runs that ended well."""
    sweep = rs.load(directory)
    runs = sweep.runs
    runs = runs.merge(
        sweep.summary[["case", "K_r"]], on="case", suffixes=("", "_target")
    )
    print(directory, len(runs), runs["status"].value_counts().to_dict())
    print("largest error of energy", runs["energy_drift"].abs().max())
    runs = runs[runs["status"] == "ok"].copy()
    runs["reverses"] = runs["type"] == "R"
    return runs


def shares(runs: pd.DataFrame, by: list[str], what: str) -> pd.DataFrame:
    """Return the share of runs with a property, and its interval, for each group."""
    counts = runs.groupby(by, observed=False)[what].agg(["sum", "count"])
    counts = counts[counts["count"] > 0]
    counts["share"] = counts["sum"] / counts["count"]
    counts["low"], counts["high"] = rs.wilson(counts["sum"], counts["count"])
    return counts


def ways_of(runs: pd.DataFrame, turns: pd.Series) -> pd.DataFrame:
    """Return which bodies turn which way, a row for each body and friction."""
    table = runs.assign(turns=turns).pivot_table(
        index=["creep", "pivot", "sample"], columns="n_i", values="turns"
    )
    table = table.dropna().astype(bool)
    unsteady = table[0.3]
    steady = table[-0.3]
    ways = {
        "only unsteady": unsteady & ~steady,
        "both": unsteady & steady,
        "neither": ~unsteady & ~steady,
        "only steady": ~unsteady & steady,
    }
    return pd.DataFrame(ways).reset_index()


def draw_line(
    axis: Axes, rows: pd.DataFrame, style: str, colour: object, label: str
) -> None:
    """Draw a share against the lever."""
    x = rows["pivot"]
    axis.plot(x, rows["share"], style, color=colour, marker="o", ms=3, label=label)


def finish_levers(axis: Axes, title: str) -> None:
    """Label a panel over the lever."""
    axis.set(xscale="log", ylim=(-0.02, 1.02), xlabel="lever over $a$")
    axis.set_xticks([1e-3, 1e-2], ["0.001", "0.01"])
    axis.minorticks_off()
    axis.set_title(title, fontsize=9, pad=62)
    axis.legend(
        frameon=False, fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0, 1)
    )


def draw_ways(axis: Axes, ways: pd.DataFrame) -> None:
    """Draw the shares that turn both ways, and from the unsteady direction only."""
    for mu, own in ways.groupby("creep"):
        friction = f"$\\mu$ {mu:g}" if mu else "no creep"
        for what, style in (("both", "-"), ("only unsteady", "--")):
            rows = shares(own, ["pivot"], what).reset_index()
            draw_line(axis, rows, style, COLOURS[mu], f"{what}, {friction}")
            low, high = rows["low"], rows["high"]
            axis.fill_between(
                rows["pivot"], low, high, color=COLOURS[mu], alpha=0.1, lw=0
            )
    finish_levers(axis, "turn; spun at 0.3 with a push of 0.01")


def draw_torques(axis: Axes, runs: pd.DataFrame) -> None:
    """Draw the share that reverses against the lever, a line for each K_r and push."""
    colours = plt.get_cmap("plasma")
    for push, style in LINE_STYLES.items():
        for place, torque in enumerate(sorted(runs["K_r_target"].unique())):
            chosen = runs[(runs["K_r_target"] == torque) & (runs["omega_xy0"] == push)]
            label = f"$K_r$ {torque:.2g}, push {push:g}"
            rows = shares(chosen, ["pivot"], "reverses").reset_index()
            draw_line(axis, rows, style, colours(0.1 + 0.35 * place), label)
    title = f"reverse; steady direction, $n_i$ = {SPIN:g}, $\\mu$ {MU:g}"
    finish_levers(axis, title)


def draw_second_rule(axis: Axes, bodies: pd.DataFrame) -> None:
    """Draw the share of bodies whose roll grows at no spin, over the lever."""
    strength = (bodies["K_r"] - bodies["K_r_creep"]) / bodies["pivot"]
    strength *= bodies["creep"] ** 2
    levers = np.geomspace(5e-4, 2e-2, 60)
    for mu in (0.2, 0.3, 0.5):
        critical = bodies["K_r"] / strength * mu**2
        share = [(critical < lever).mean() for lever in levers]
        axis.plot(levers, share, color=COLOURS[mu], label=f"$\\mu$ {mu:g}")
    title = "never turn back from the steady direction: $K_r < c_r l/\\mu^2$"
    finish_levers(axis, title)
    axis.set_title(title, fontsize=9)
    axis.legend(frameon=False, fontsize=8, loc="upper left")


def draw_rule(axis: Axes, runs: pd.DataFrame) -> None:
    """Draw the share that reverses against the ratio of the rule."""
    edges = np.geomspace(0.1, 10, 21)
    for push, colour in ((0.01, "#0072b2"), (0.1, "#d55e00")):
        side = runs[runs["omega_xy0"] == push]
        parts = side.assign(bin=pd.cut(side["ratio"], edges))
        rows = shares(parts, ["bin"], "reverses")
        x = [np.sqrt(part.left * part.right) for part in rows.index]
        axis.plot(x, rows["share"], color=colour, label=f"push of {push:g}")
        axis.fill_between(x, rows["low"], rows["high"], color=colour, alpha=0.2, lw=0)
    axis.axvline(RULE, color="0.3", lw=0.6)
    axis.text(RULE * 1.05, 0.02, f"{RULE:g}", fontsize=8, color="0.3")
    axis.set(xscale="log", xlim=(0.1, 10), ylim=(-0.02, 1.02))
    axis.set_xticks([0.1, 1, 10], ["0.1", "1", "10"])
    axis.set_xlabel("ratio of the rule")
    axis.set_title(
        "reverse; steady direction, all spins, levers and $\\mu$", fontsize=9
    )
    axis.legend(frameon=False, fontsize=8, loc="lower right")


def percent(runs: pd.DataFrame, by: list[str], what: str) -> str:
    """Return shares in percent as a table, the last of `by` from left to right."""
    return (100 * shares(runs, by, what)["share"]).unstack().round(1).to_string()


def print_ways(runs: pd.DataFrame) -> None:
    """Print which bodies turn, and which reverse, from which direction."""
    for name, turns in (("turn", runs["n_turns"] > 0), ("reverse", runs["reverses"])):
        ways = ways_of(runs, turns)
        for what in ("only unsteady", "both", "neither", "only steady"):
            print(name, what)
            print((100 * shares(ways, ["creep", "pivot"], what)).round(1).to_string())
    steady = runs[(runs["n_i"] < 0) & (runs["creep"] > 0)]
    never = steady["K_r_creep"] < 0
    print(
        "second rule: runs, of them reverse", never.sum(), steady[never].reverses.sum()
    )
    print(percent(steady.assign(never=never), ["creep", "pivot"], "never"))
    doubtful = steady.groupby(["creep", "pivot"])["creep_doubtful"]
    print("doubtful", doubtful.median().unstack().round(2).to_string())
    twice = runs[runs["n_i"] > 0].assign(twice=runs["n_turns"] > 1)
    print("twice", percent(twice, ["creep", "pivot"], "twice"))


def print_rule(runs: pd.DataFrame) -> None:
    """Print what the page says of first reversals, and of the rules."""
    print(percent(runs, ["creep", "omega_xy0", "n_i", "pivot"], "reverses"))
    torques = runs[runs["n_i"] == SPIN]
    print(percent(torques, ["creep", "omega_xy0", "K_r_target", "pivot"], "reverses"))
    bins = pd.cut(runs["ratio"], RATIOS)
    print(shares(runs.assign(bin=bins), ["omega_xy0", "bin"], "reverses"))
    for name in ("ratio", "ratio_without"):
        right = (runs[name] > RULE) == runs["reverses"]
        print(name, "right", right.groupby(runs["omega_xy0"]).agg(["mean", "count"]))
        print(right.groupby([runs["omega_xy0"], runs["n_i"]]).mean().unstack())
    never = runs["K_r_creep"] < 0
    print(
        "second rule", runs[never].groupby("omega_xy0").reverses.agg(["sum", "count"])
    )
    print(percent(runs.assign(never=never), ["creep", "pivot"], "never"))


def print_stone() -> None:
    """Print the reversal times of a real stone, and its turns within 8 s."""
    body = rs.Rattleback.half_ellipsoid(**STONE)
    spins = [f"{sign * rpm} rpm" for sign in (1, -1) for rpm in SPEEDS]
    for mu in (0.2, 0.3, 0.5):
        for contact, materials in MATERIALS.items():
            lever = rs.contact_patch(body, materials, mu=mu).pivot
            launch = {"n_i": spins, "omega_xy0": "6 rpm", "pivot": lever, "creep": mu}
            runs = rs.simulate(body, t_end="60 s", record="reversals", **launch)
            turns = rs.simulate(body, t_end="8 s", record="reversals", **launch)
            table = pd.DataFrame(
                {
                    "spin": spins,
                    "type": runs["type"],
                    "t_r_s": runs["t_r"] * body.units.time,
                    "turns": turns["n_turns"],
                    "doubtful": runs["creep_doubtful"],
                    "K_r_creep": runs["K_r_creep"],
                }
            )
            print(mu, contact, f"lever {lever:.4f}")
            print(table.to_string(index=False))


def main(rule: str, both: str, claim: str, target: str) -> None:
    """Draw the figure and print the tables."""
    mpl.use("Agg")
    plt.rcParams.update({"font.size": 9, "axes.linewidth": 0.6})
    runs = read(rule)
    runs["ratio"] = ratio_of_rule(runs, "K_r_creep")
    runs["ratio_without"] = ratio_of_rule(runs, "K_r")
    several = read(both)
    many = read(claim)
    followed = pd.concat([several[several["creep"] != MU], many], ignore_index=True)
    figure, axes = plt.subplots(2, 2, figsize=(9, 8), layout="constrained")
    draw_ways(axes[0, 0], ways_of(followed, followed["n_turns"] > 0))
    draw_torques(axes[0, 1], runs[(runs["n_i"] == SPIN) & (runs["creep"] == MU)])
    draw_second_rule(axes[1, 0], many[(many["n_i"] > 0) & (many["pivot"] == 0.01)])
    draw_rule(axes[1, 1], runs)
    for axis in axes[:, 0]:
        axis.set_ylabel("fraction of bodies")
    figure.savefig(target, dpi=150)
    print_ways(followed)
    print_rule(runs)
    print_stone()


if __name__ == "__main__":
    main(*sys.argv[1:])
