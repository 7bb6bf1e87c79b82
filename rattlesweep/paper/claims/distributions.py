"""Claims about the distributions of the set SD (T4, T5)."""

from __future__ import annotations

import numpy as np

from rattlesweep.paper.claims.claim import Made, Measured, share
from rattlesweep.paper.figures.fig3 import BOUND
from rattlesweep.paper.figures.fig4 import DECADES, counts_of, edges
from rattlesweep.paper.workspace import records

# Distributions this close cannot be told apart in print.
CLOSE = 0.02
# What "much larger" means here.
MUCH = 10.0


def frequencies(made: Made) -> Measured:
    """Measure T4: the ratio of the frequencies, and their zeroth order."""
    row = records(made["fig3"]["summary"])[0]
    rare = []
    if "fig4" in made:
        # Its bodies are a hundred times as many.
        many = records(made["fig4"]["summary"])[0]
        own = share(many["below"], many["density_samples"])
        rare = [many | own | {"none": np.exp(-1e6 * own["value"])}]
    checks = [row["below"] == 0, row["ratio_bound"] >= BOUND,
              max(row["distance_p"], row["distance_r"]) < CLOSE]  # fmt: skip
    least = float(made["fig3"]["cumulative"]["ratio"].iloc[0])
    return checks, {**row, "value": least, "low": row["ratio_bound"], "rare": rare}


def coefficients(made: Made) -> Measured:
    """Measure T5: the distributions of the torque coefficients."""
    own = made["fig4"]
    row = records(own["summary"])[0]
    data = {n: own["cumulative"][n].to_numpy() for n in ("probability", "K_p", "K_r", "ratio")}
    level = data["probability"]
    # Order statistics: the median's place is binomial.
    half = 0.98 / np.sqrt(row["samples"])
    low, median, high = np.interp([0.5 - half, 0.5, 0.5 + half], level, data["ratio"]).tolist()
    share = own["density"]["relative_frequency"].to_numpy()
    decades = (float(np.log10(share.min())), float(np.log10(share.max())))
    # The two parts of the figure come from two codes: vectorised theory and the counting loop.
    counts, total = counts_of(own), row["density_samples"]
    gap = 0.0
    for axis, name in enumerate(("K_p", "K_r")):
        rising = np.cumsum(counts.sum(axis=1 - axis)) / total
        drawn = np.interp(edges(name)[1:], data[name], level)
        gap = max(gap, float(np.abs(drawn - rising).max()))
    # Kolmogorov's 99.9 % quantile for each, and the steps of the stored levels.
    allowed = 1.95 * np.sqrt(1 / row["samples"] + 1 / total) + 1 / (len(level) - 1)
    allowed += row["outside"] / total
    checks = [
        median >= MUCH,
        bool(data["ratio"][0] > 1),
        -DECADES <= decades[0] <= decades[1] <= 0,
        int(own["density"]["count"].to_numpy().sum()) + row["outside"] == total,
        bool(gap < allowed),
    ]
    return checks, {
        "value": median, "low": low, "high": high, "samples": row["samples"], "total": total,
        "least": data["ratio"][0], "decades": decades, "gap": gap, "allowed": allowed,
        **{name: np.interp(0.5, level, data[name]) for name in ("K_p", "K_r")},
    }  # fmt: skip
