"""Fig. 4: distributions of the torque coefficients K_p and K_r of the set SD."""

from __future__ import annotations

from functools import partial
from threading import Lock

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from rattlesweep.analysis.style import BLUE, VERMILION, new_figure
from rattlesweep.arrays import Floats, Integers
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.task import Control, side_by_side
from rattlesweep.paper.figures.fig3 import (
    BOUND,
    CHUNK,
    SEED,
    cumulative,
    draw_modes,
    drawn_bodies,
)
from rattlesweep.paper.figures.frames import frame
from rattlesweep.paper.workspace import Report, Tables
from rattlesweep.physics import theory
from rattlesweep.sweeps.config.schema import SdRanges

# The paper's colour code: nine decades.
DECADES = 9
# The binned axes.  Not named in the paper, which has a logarithmic scale for the colours only; no
# body of Table I lies outside.
ENDS, BINS = {"K_p": (0.0, 7.0), "K_r": (0.0, 0.4)}, 200


def data(bodies: int, total: int, ranges: SdRanges, threads: int | None, report: Report) -> Tables:
    """Return the tables ``cumulative``, ``density`` (bins that hold bodies) and ``summary``.

    They are of so many bodies in (a) and in (b), and the same for any number of threads.
    """
    found = draw_modes(("K_p", "K_r"), bodies, ranges, lambda share: None)
    found["ratio"] = found["K_p"] / found["K_r"]
    counts, least, below = count_bodies(total, ranges, threads, report)
    i, j = np.nonzero(counts)
    p, r = edges("K_p"), edges("K_r")
    density = pd.DataFrame(
        {"i": i, "j": j, "K_p_low": p[i], "K_p_high": p[i + 1], "K_r_low": r[j],
         "K_r_high": r[j + 1], "count": counts[i, j], "relative_frequency": counts[i, j] / total}
    )  # fmt: skip
    summary = {"samples": bodies, "density_samples": total, "outside": total - counts.sum(),
               "ratio_min": least, "below": below}  # fmt: skip
    return {
        "cumulative": cumulative(found), "density": density, "summary": pd.DataFrame([summary]),
    }  # fmt: skip


def count_bodies(
    total: int, ranges: SdRanges, threads: int | None, report: Report, seed: int = SEED
) -> tuple[Integers, float, int]:
    """Draw bodies and count them by their torque coefficients; none is stored.

    Returns
    -------
    counts : ndarray, shape (bins, bins)
        By ``K_p`` and ``K_r``.
    least, below
        The least ``omega_p / omega_r``, and the number of those below :data:`BOUND`.
    """
    counts, one_at_a_time = np.zeros((BINS, BINS), np.int64), Lock()

    def part(first: int, _: Control) -> tuple[float, int]:
        last = min(first + CHUNK, total)
        alpha, beta, _gamma, theta, phi, xi = drawn_bodies(first, last, ranges, seed)
        square_p, square_r, *coefficients = theory.torque_coefficients(alpha, beta, theta, phi, xi)
        ratio = square_p / square_r
        places = [
            np.floor((values - low) / ((high - low) / BINS)).astype(np.int64)
            for values, (low, high) in zip(coefficients, ENDS.values(), strict=True)
        ]
        inside = np.logical_and.reduce([(place >= 0) & (place < BINS) for place in places])
        i, j = (place[inside] for place in places)
        own = np.bincount(BINS * i + j, minlength=BINS**2).reshape(BINS, BINS)
        with one_at_a_time:
            np.add(counts, own, out=counts)
        return float(np.sqrt(ratio.min())), int(np.count_nonzero(ratio < BOUND**2))

    # The sampler is compiled here, if at all, and not in two threads at once.
    drawn_bodies(0, 0, ranges, seed)
    calls = [partial(part, first) for first in range(0, total, CHUNK)]
    found = side_by_side(calls, threads or available_threads(), report)
    ratios, below = zip(*found, strict=True)
    return counts, min(ratios), sum(below)


def edges(name: str) -> Floats:
    """Return the edges of the bins of ``K_p`` or ``K_r``, shape (bins + 1,)."""
    return np.linspace(*ENDS[name], BINS + 1)


def counts_of(tables: Tables) -> Integers:
    """Return the bodies in all bins of the figure's tables, shape (bins, bins), by ``K_p, K_r``."""
    counts, filled = np.zeros((BINS, BINS), dtype=np.int64), tables["density"]
    counts[filled["i"], filled["j"]] = filled["count"]
    return counts


def draw(tables: Tables) -> Drawing:
    """Draw (a) the cumulative distributions and (b) the density in the plane."""
    figure = new_figure(4.6, 7.2)
    upper, lower = figure.subplots(2, 1, height_ratios=(1, 1.25))
    values, counts = tables["cumulative"], counts_of(tables)
    _cumulative(upper, values, (ENDS["K_r"][0], ENDS["K_p"][1]))
    upper.set(xlabel="$K_p$,  $K_r$", ylabel="cumulative distribution")
    upper.legend(frameon=False, loc="upper right", bbox_to_anchor=(1, 0.93), ncols=2)
    # K_r is steep on the axis of K_p, so the inset shows the same over decades.
    inset = upper.inset_axes((0.47, 0.18, 0.5, 0.52))
    inset.set_xscale("log")
    _cumulative(inset, values, (1e-4, 10.0))
    inset.tick_params(labelsize=7.5)
    inset.minorticks_off()

    shown = np.full(counts.shape, np.nan)
    total = tables["summary"]["density_samples"].iloc[0]
    np.log10(counts / total, where=counts > 0, out=shown)
    picture = lower.pcolormesh(
        edges("K_p"), edges("K_r"), shown.T, cmap=colormaps["viridis"],
        vmin=-DECADES, vmax=0, rasterized=True,
    )  # fmt: skip
    lower.set(xlabel="$K_p$", ylabel="$K_r$")
    bar = figure.colorbar(picture, ax=lower, ticks=range(-DECADES, 1), pad=0.02)
    bar.set_label(r"$\log_{10} P(K_p, K_r)$")
    frame(lower)
    for axes, letter in ((upper, "(a)"), (lower, "(b)")):
        axes.set_title(letter, loc="left", fontsize=11)
    return figure


def _cumulative(axes: Axes, values: pd.DataFrame, ends: tuple[float, float]) -> None:
    for name, colour, style in (("K_p", BLUE, "-"), ("K_r", VERMILION, (0, (5, 1.5)))):
        axes.plot(values[name], values["probability"], color=colour, linestyle=style,
                  linewidth=1.8, label=f"${name}$")  # fmt: skip
    axes.set(xlim=ends, ylim=(0, 1.03))
    frame(axes)
