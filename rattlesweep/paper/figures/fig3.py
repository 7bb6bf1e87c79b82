"""Fig. 3: distributions of the torque coefficients K_p and K_r of the set SD."""

from __future__ import annotations

from functools import partial
from threading import Lock

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from rattlesweep.arrays import Floats, Integers
from rattlesweep.integrate.task import Control, side_by_side
from rattlesweep.paper.columns import count, number, schema, table
from rattlesweep.paper.figures.fig2 import (
    BOUND,
    CHUNK,
    SEED,
    cumulative,
    draw_modes,
    drawn_bodies,
)
from rattlesweep.paper.figures.style import frame
from rattlesweep.paper.workspace import Progress, Tables, between
from rattlesweep.physics import theory
from rattlesweep.analysis.style import BLUE, VERMILION, new_figure
from rattlesweep.sweeps.config.schema import SdRanges

# The paper's colour code: nine decades.
DECADES = 9
# The binned axes.  Not named in the paper, which has a logarithmic scale for the colours only; no
# body of Table I lies outside.
ENDS, BINS = {"K_p": (0.0, 7.0), "K_r": (0.0, 0.4)}, 200

CUMULATIVE = schema(
    "probability",
    number("K_p", "torque coefficient of the pitch (Eq. (39) [Kp])"),
    number("K_r", "torque coefficient of the roll (Eq. (40) [Kr])"),
    number("ratio", "K_p / K_r"),
)
DENSITY = schema(
    "",
    count("i", "number of the bin of K_p"),
    count("j", "number of the bin of K_r"),
    number("K_p_low", "lower edge of the bin"),
    number("K_p_high", "upper edge of the bin"),
    number("K_r_low", "lower edge of the bin"),
    number("K_r_high", "upper edge of the bin"),
    count("count", "bodies in the bin; bins without any have no row"),
    number("relative_frequency", "count / samples: the paper's P(K_p, K_r)"),
)
SUMMARY = schema(
    "",
    count("samples", "bodies of the cumulative distributions"),
    count("density_samples", "bodies of the density"),
    count("outside", "of these, outside the bins"),
    number("ratio_min", "of these, the least omega_p / omega_r"),
    count("below", f"of these, with omega_p / omega_r below {BOUND}"),
    count("bins", "bins on each axis"),
    number("K_p_low", "lower end of the binned axis of K_p"),
    number("K_p_high", "upper end of the binned axis of K_p"),
    number("K_r_low", "lower end of the binned axis of K_r"),
    number("K_r_high", "upper end of the binned axis of K_r"),
)


def distributions(
    bodies: int, total: int, ranges: SdRanges, threads: int, progress: Progress
) -> Tables:
    """Tables ``cumulative``, ``density`` (bins that hold bodies) and ``summary`` (one row).

    Of so many bodies in (a) and in (b): the same for any number of threads.
    """
    early = bodies / (bodies + total)
    found = draw_modes(("K_p", "K_r"), bodies, ranges, between(progress, 0.0, early))
    found["ratio"] = found["K_p"] / found["K_r"]
    counts, least, below = count_bodies(total, ranges, threads, between(progress, early, 1.0))
    i, j = np.nonzero(counts)
    (p, r), inside = (edges(name) for name in ENDS), counts[i, j]
    density = [i, j, p[i], p[i + 1], r[j], r[j + 1], inside, inside / total]
    row = [bodies, total, total - counts.sum(), least, below, BINS, *ENDS["K_p"], *ENDS["K_r"]]
    return {
        "cumulative": table(cumulative(found), CUMULATIVE),
        "density": table(dict(zip(DENSITY.names, density, strict=True)), DENSITY),
        "summary": table([dict(zip(SUMMARY.names, row, strict=True))], SUMMARY),
    }


def count_bodies(
    total: int, ranges: SdRanges, threads: int, progress: Progress, seed: int = SEED
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

    # Compiled here, if at all, and not in two threads at once.
    drawn_bodies(0, 0, ranges, seed)
    found = side_by_side(
        [partial(part, first) for first in range(0, total, CHUNK)],
        threads,
        lambda done: progress(done, f"{round(done * total):,} of {total:,} bodies"),
    )
    ratios, below = zip(*found, strict=True)
    return counts, min(ratios), sum(below)


def edges(name: str) -> Floats:
    """Edges of the bins of ``K_p`` or ``K_r``, shape (bins + 1,)."""
    return np.linspace(*ENDS[name], BINS + 1)


def counts_of(tables: Tables) -> Integers:
    """Bodies in all bins of the figure's tables, shape (bins, bins), by ``K_p`` and ``K_r``."""
    counts, filled = np.zeros((BINS, BINS), dtype=np.int64), tables["density"]
    counts[filled["i"].to_numpy(), filled["j"].to_numpy()] = filled["count"].to_numpy()
    return counts


def draw(tables: Tables) -> Drawing:
    """(a) cumulative distributions; (b) the density in the plane."""
    figure = new_figure(4.6, 7.2)
    upper, lower = figure.subplots(2, 1, height_ratios=(1, 1.25))
    values, counts = tables["cumulative"].to_pandas(), counts_of(tables)
    _cumulative(upper, values, (ENDS["K_r"][0], ENDS["K_p"][1]))
    upper.set(xlabel="$K_p$,  $K_r$", ylabel="cumulative distribution")
    upper.legend(frameon=False, loc="upper right", bbox_to_anchor=(1, 0.93), ncols=2)
    # K_r is steep on the axis of K_p: the same again over decades.
    inset = upper.inset_axes((0.47, 0.18, 0.5, 0.52))
    inset.set_xscale("log")
    _cumulative(inset, values, (1e-4, 10.0))
    inset.tick_params(labelsize=7.5)
    inset.minorticks_off()

    shown = np.full(counts.shape, np.nan)
    total = tables["summary"]["density_samples"][0].as_py()
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
