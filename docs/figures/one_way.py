"""Draw the figure of docs/one_way.md and print its tables.

rattlesweep run configs/one_way.yaml
rattlesweep run configs/one_way.yaml --output out/turns --set record=[reversals] \
    --set 'horizon={t: 5000}' --set spin.n_i=[-0.1,-0.3,-0.5,0.1,0.3,0.5]
python docs/figures/one_way.py out/one-way out/turns docs/one_way.png
"""

import sys

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

import rattlesweep as rs

PUSH = 0.01  # of the left panel
SPIN = -0.3  # of the panel of first reversals by torque
SECOND_SPIN = 0.3  # of the panel of second turns
RULE = 0.65  # ratio above which a body turns back after a small push
BODY = ["alpha", "gamma", "xi", "n_i", "omega_xy0"]
# Edges of the spin that there is over the one that is needed.
RATIOS = (0, 0.4, 0.6, 0.8, 1, 2, np.inf)
LINE_STYLES = {0.01: "-", 0.1: "--"}  # of the pushes
# Where a lever of zero is drawn on the logarithmic axis.
LEFT_END = 2.5e-4

STONE = {
    "length": "12 cm",
    "width": "3 cm",
    "height": "12 mm",
    "mass": "60 g",
    "skew": "3 deg",
}
# Contacts of the stone, with the levers of Hertz's theory at a friction of 0.3.
LEVERS = {
    "no friction": "0 um",
    "steel on glass": "22 um",
    "PLA on glass": "54 um",
    "PLA on wood": "88 um",
}


def ratio_of_rule(runs: pd.DataFrame) -> pd.Series:
    """Return the ratio of the rule for each run; infinite where it needs no growth.

    The averaged equations with one mode of the energy ``E`` are ``dE/dt = K abs(n) E``
    and ``gamma d abs(n)/dt = -K E - l``.  The spin passes zero if the torque ``K E``
    is then above the lever ``l``: if ``K gamma n_i^2 / (2 l) > 1 - e - ln e``, with
    ``e`` the first ``K E / l``.
    """
    lever = runs["pivot"]
    torque = runs["K_r"].where(runs["n_i"] < 0, runs["K_p"])
    push = runs["gamma"] * (runs["n_0"] ** 2 - runs["n_i"] ** 2) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        start = torque * push / lever
        have = torque * runs["gamma"] * runs["n_i"] ** 2 / (2 * lever)
        need = 1 - start - np.log(start)
        return (have / need).where(start < 1, np.inf)


def read(directory: str) -> pd.DataFrame:
    """Return the runs that ended well, with the ratio of the rule."""
    sweep = rs.load(directory)
    runs = sweep.runs
    runs = runs.merge(
        sweep.summary[["case", "K_r"]], on="case", suffixes=("", "_target")
    )
    print(directory, runs["status"].value_counts().to_dict())
    runs = runs[runs["status"] == "ok"].copy()
    runs["reverses"] = runs["type"] == "R"
    runs["ratio"] = ratio_of_rule(runs)
    return runs


def shares(runs: pd.DataFrame, by: list[str], what: str = "reverses") -> pd.DataFrame:
    """Return the share of runs with a property, and its interval, for each group."""
    counts = runs.groupby(by, observed=False)[what].agg(["sum", "count"])
    counts = counts[counts["count"] > 0]
    counts["share"] = counts["sum"] / counts["count"]
    counts["low"], counts["high"] = rs.wilson(counts["sum"], counts["count"])
    return counts


def draw_line(
    axis: Axes,
    runs: pd.DataFrame,
    style: str,
    colour: object,
    label: str,
    what: str = "reverses",
) -> None:
    """Draw a share against the lever, with its interval."""
    rows = shares(runs, ["pivot"], what).reset_index()
    x = rows["pivot"].where(rows["pivot"] > 0, LEFT_END)
    axis.plot(x, rows["share"], style, color=colour, marker="o", ms=3, label=label)
    axis.fill_between(x, rows["low"], rows["high"], color=colour, alpha=0.15, lw=0)


def finish_levers(axis: Axes, title: str) -> None:
    """Label a panel over the lever."""
    axis.set(xscale="log", ylim=(-0.02, 1.02), xlabel="lever over $a$")
    axis.set_xticks([LEFT_END, 1e-3, 1e-2], ["0", "0.001", "0.01"])
    axis.minorticks_off()
    axis.set_title(title, fontsize=9, pad=47)
    axis.legend(
        frameon=False, fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0, 1)
    )


def draw_spins(axis: Axes, runs: pd.DataFrame) -> None:
    """Draw the share that reverses against the lever, a line for each spin."""
    colours = plt.get_cmap("viridis")
    for spin in (-0.1, -0.3, -0.5, 0.1, 0.3, 0.5):
        style = "-" if spin < 0 else "--"
        colour = colours(0.1 + 1.6 * (abs(spin) - 0.1))
        draw_line(axis, runs[runs["n_i"] == spin], style, colour, f"$n_i$ = {spin:g}")
    finish_levers(axis, f"reverse; both directions, push of {PUSH:g}")


def draw_torques(axis: Axes, runs: pd.DataFrame, what: str, title: str) -> None:
    """Draw a share against the lever, a line for each K_r and push."""
    colours = plt.get_cmap("plasma")
    for push, style in LINE_STYLES.items():
        for place, torque in enumerate(sorted(runs["K_r_target"].unique())):
            chosen = runs[(runs["K_r_target"] == torque) & (runs["omega_xy0"] == push)]
            label = f"$K_r$ {torque:.2g}, push {push:g}"
            draw_line(axis, chosen, style, colours(0.1 + 0.35 * place), label, what)
    finish_levers(axis, title)


def draw_rule(axis: Axes, runs: pd.DataFrame) -> None:
    """Draw the share that reverses against the ratio of the rule."""
    edges = np.geomspace(0.1, 10, 21)
    for push, colour in ((0.01, "#0072b2"), (0.1, "#d55e00")):
        side = runs[runs["omega_xy0"] == push]
        rows = shares(side.assign(bin=pd.cut(side["ratio"], edges)), ["bin"])
        x = [np.sqrt(part.left * part.right) for part in rows.index]
        axis.plot(x, rows["share"], color=colour, label=f"push of {push:g}")
        axis.fill_between(x, rows["low"], rows["high"], color=colour, alpha=0.2, lw=0)
    axis.axvline(RULE, color="0.3", lw=0.6)
    axis.text(RULE * 1.05, 0.02, f"{RULE:g}", fontsize=8, color="0.3")
    axis.set(xscale="log", xlim=(0.1, 10), ylim=(-0.02, 1.02))
    axis.set_xticks([0.1, 1, 10], ["0.1", "1", "10"])
    axis.set_xlabel("ratio of the rule")
    title = "reverse; steady direction, all spins and levers"
    axis.set_title(title, fontsize=9)
    axis.legend(frameon=False, fontsize=8, loc="lower right")


def percent(runs: pd.DataFrame, by: list[str], what: str = "reverses") -> str:
    """Return shares in percent as a table, the last of `by` from left to right."""
    return (100 * shares(runs, by, what)["share"]).unstack().round(1).to_string()


def print_reversals(runs: pd.DataFrame) -> None:
    """Print what the page says of first reversals, and of the rule."""
    print(runs.groupby("pivot")["energy_drift_max"].max())
    print(percent(runs, ["omega_xy0", "n_i", "pivot"]))
    steady = runs[runs["n_i"] < 0]
    print(percent(steady, ["omega_xy0", "K_r_target", "n_i", "pivot"]))
    rule = steady[steady["pivot"] > 0]
    bins = pd.cut(rule["ratio"], RATIOS)
    print(shares(rule.assign(bin=bins), ["omega_xy0", "bin"]))
    right = (rule["ratio"] > RULE) == rule["reverses"]
    print("rule right", right.groupby(rule["omega_xy0"]).agg(["mean", "count"]))
    free = runs[(runs["pivot"] == 0) & runs["reverses"]][[*BODY, "t_r"]]
    both = runs[runs["reverses"]].merge(free, on=BODY, suffixes=("", "_free"))
    change = (both["t_r"] / both["t_r_free"]).groupby([both["n_i"], both["pivot"]])
    print("t_r over that without", change.median().unstack().round(4).to_string())
    print(pd.crosstab([runs["n_i"] < 0, runs["pivot"]], runs["type"]))


def print_turns(runs: pd.DataFrame) -> None:
    """Print how many bodies turn once and twice by t = 5000."""
    runs = runs.assign(once=runs["n_turns"] >= 1)
    by = ["omega_xy0", "n_i", "pivot"]
    for what in ("reverses", "once", "twice"):
        print(what, percent(runs, by, what))
    print("twice", percent(runs, ["omega_xy0", "n_i", "K_r_target", "pivot"], "twice"))
    print("twice, of those that turn", percent(runs[runs["once"]], by, "twice"))


def print_stone() -> None:
    """Print the reversal times of a real stone, and its turns within 8 s."""
    body = rs.Rattleback.half_ellipsoid(**STONE)
    rows = []
    for direction in (1, -1):
        for rpm in (30, 45, 60, 90, 120):
            for contact, lever in LEVERS.items():
                launch = {
                    "n_i": f"{direction * rpm} rpm",
                    "omega_xy0": "6 rpm",
                    "pivot": lever,
                }
                run = rs.simulate(body, t_end="60 s", record="error", **launch)
                turns = rs.simulate(body, t_end="8 s", record="reversals", **launch)
                rows.append(
                    {
                        "n_i": direction * rpm,
                        "contact": contact,
                        "type": run.type,
                        "t_r_s": run.t_r_s,
                        "error_s": (run.t_r_error or 0) * body.units.time,
                        "turns": turns.n_turns,
                    }
                )
    print(pd.DataFrame(rows).to_string())


def main(directory: str, turns: str, target: str) -> None:
    """Draw the figure and print the tables."""
    mpl.use("Agg")
    plt.rcParams.update({"font.size": 9, "axes.linewidth": 0.6})
    runs = read(directory)
    followed = read(turns)
    followed["twice"] = followed["n_turns"] >= 2
    figure, axes = plt.subplots(2, 2, figsize=(9, 8), layout="constrained")
    draw_spins(axes[0, 0], runs[runs["omega_xy0"] == PUSH])
    draw_torques(
        axes[0, 1],
        runs[runs["n_i"] == SPIN],
        "reverses",
        f"reverse; steady direction, $n_i$ = {SPIN:g}",
    )
    draw_torques(
        axes[1, 0],
        followed[followed["n_i"] == SECOND_SPIN],
        "twice",
        f"turn twice; unsteady direction, $n_i$ = {SECOND_SPIN:g}",
    )
    draw_rule(axes[1, 1], runs[(runs["n_i"] < 0) & (runs["pivot"] > 0)])
    for axis in axes[:, 0]:
        axis.set_ylabel("fraction of bodies")
    figure.savefig(target, dpi=150)
    print_reversals(runs)
    print_turns(followed)
    print_stone()


if __name__ == "__main__":
    main(*sys.argv[1:])
