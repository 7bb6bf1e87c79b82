"""Fig. 3: frequencies of random bodies of the set SD. Fig. 4: their torque coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.figure import Figure
from scipy.stats import ks_2samp

from rattlesweep.analysis.style import BLUE, GREEN, ORANGE, SKY, VERMILION, new_figure
from rattlesweep.arrays import Floats, Integers
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.task import Control, side_by_side
from rattlesweep.paper.frames import DASHES, frame
from rattlesweep.paper.workspace import Tables, Workspace
from rattlesweep.physics import theory
from rattlesweep.physics.body import shell_dumbbell
from rattlesweep.sweeps.bodies.sources import bodies_at, draw_points
from rattlesweep.sweeps.config.schema import SdRanges

# Points of a cumulative distribution; bodies drawn at a time.
LEVELS, CHUNK = 2001, 100_000
# The paper's lower bound of omega_p/omega_r (Methods), and its colour code of nine decades.
BOUND, DECADES = 1.3, 9
# The binned axes of Fig. 4(b).  Not named in the paper; no body of Table I lies outside.
ENDS, BINS = {"K_p": (0.0, 7.0), "K_r": (0.0, 0.4)}, 200


def drawn_bodies(first: int, last: int, seed: int = 2017) -> tuple[Floats, ...]:
    """Return ``alpha, beta, gamma, theta, phi, xi`` of the bodies of some numbers."""
    b = bodies_at(draw_points(seed, np.arange(first, last)), np.array(SdRanges().ends()))
    return b.alpha, b.beta, b.gamma, b.theta, b.phi, b.xi


def drawn_modes(samples: int, names: Sequence[str]) -> dict[str, Floats]:
    """Return attributes of :class:`rattlesweep.physics.theory.Modes` of so many random bodies."""
    kept = {name: np.empty(samples) for name in names}
    for first in range(0, samples, CHUNK):
        last = min(first + CHUNK, samples)
        alpha, beta, _, theta, phi, xi = drawn_bodies(first, last)
        found = theory.modes(alpha, beta, theta, phi, xi)
        for name in names:
            kept[name][first:last] = getattr(found, name)
    return kept


def cumulative(values: dict[str, Floats]) -> pd.DataFrame:
    """Return the values at or below which even shares, in ``probability``, lie."""
    probability = np.linspace(0, 1, LEVELS)
    columns = {n: np.quantile(v, probability, method="inverted_cdf") for n, v in values.items()}
    return pd.DataFrame({"probability": probability} | columns)


def frequencies(ws: Workspace) -> Tables:
    """Return the tables ``cumulative`` and ``summary`` (one row) of Fig. 3."""
    bodies = ws.sizes.fig3_bodies
    found = drawn_modes(bodies, ("omega_p", "omega_r", "omega_p0", "omega_r0"))
    ratio = found["omega_p"] / found["omega_r"]
    row = {"samples": bodies, "below": (ratio <= BOUND).sum(), "ratio_bound": ratio_bound()}
    for mode in ("p", "r"):
        exact, zeroth = found[f"omega_{mode}"], found[f"omega_{mode}0"]
        row[f"distance_{mode}"] = ks_2samp(exact, zeroth, method="asymp").statistic
        off = np.quantile(np.abs(zeroth / exact - 1), (0.5, 0.99))
        row[f"off_median_{mode}"], row[f"off_p99_{mode}"] = off
    return {"cumulative": cumulative(found | {"ratio": ratio}), "summary": pd.DataFrame([row])}


def ratio_bound() -> float:
    """Return the infimum of ``omega_p / omega_r`` over the ranges of the paper's Table I."""
    ranges = SdRanges()
    alpha, beta = shell_dumbbell(np.array(ranges.gamma[::-1]), np.array(ranges.f_sd))
    theta, phi = np.array(ranges.theta), np.array(ranges.phi[::-1])
    xi = -np.radians(ranges.minus_xi_deg[0])
    found = theory.modes(alpha[:, None], beta[:, None], theta, phi, xi)
    return float(np.min(found.omega_p / found.omega_r))


def draw_frequencies(tables: Tables) -> Figure:
    """Draw the four distributions of Fig. 3 and, in the inset, that of the ratio."""
    values = tables["cumulative"]
    level = values["probability"]
    figure = new_figure(4.6, 3.6)
    axes = figure.add_subplot()
    # The approximations lie almost on top, so they are dark, dashed and thin over something pale
    # and broad.
    for mode, colour, dark in (("p", SKY, "#003F66"), ("r", ORANGE, "#7A2E00")):
        axes.plot(values[f"omega_{mode}"], level, color=colour, linewidth=3.2,
                  solid_capstyle="butt", label=rf"$\omega_{mode}$")  # fmt: skip
        axes.plot(values[f"omega_{mode}0"], level, color=dark, linewidth=1.1, linestyle=DASHES,
                  label=rf"$\omega_{{{mode}0}}$")  # fmt: skip
    axes.set(xlim=(0, 1.02 * values["omega_p"].iloc[-1]), ylim=(0, 1.03),
             xlabel=r"$\omega\,/\,\tilde\omega$", ylabel="cumulative distribution")  # fmt: skip
    axes.legend(frameon=False, loc="upper right", bbox_to_anchor=(0.99, 0.9), ncols=2,
                handlelength=1.9, columnspacing=1.0)  # fmt: skip
    inset = axes.inset_axes((0.6, 0.19, 0.36, 0.42))
    inset.plot(values["ratio"], level, color=GREEN, linewidth=1.6)
    inset.axvline(BOUND, color="#444444", linewidth=0.8, linestyle=":")
    inset.annotate(f"{BOUND:g}", (BOUND, 0.93), xytext=(3, 0), textcoords="offset points",
                   fontsize=7.5, color="#444444", va="center")  # fmt: skip
    # The last percent of the ratios would fill half of the axis.
    inset.set(xlim=(0, np.ceil(np.interp(0.995, level, values["ratio"]))), ylim=(0, 1.05))
    inset.set_xlabel(r"$\omega_p/\omega_r$", fontsize=9, labelpad=1)
    for each in (axes, inset):
        frame(each)
    inset.tick_params(labelsize=7.5)
    return figure


def coefficients(ws: Workspace) -> Tables:
    """Return ``cumulative``, ``density`` (bins that hold bodies) and ``summary`` of Fig. 4."""
    total = ws.sizes.fig4_density
    found = drawn_modes(ws.sizes.fig4_bodies, ("K_p", "K_r"))
    found["ratio"] = found["K_p"] / found["K_r"]
    counts, least, below = count_bodies(total, ws.settings["threads"])
    i, j = np.nonzero(counts)
    density = {"i": i, "j": j, "count": counts[i, j], "relative_frequency": counts[i, j] / total}
    for name, places in (("K_p", i), ("K_r", j)):
        density |= {f"{name}_low": edges(name)[places], f"{name}_high": edges(name)[places + 1]}
    summary = {"samples": ws.sizes.fig4_bodies, "density_samples": total, "ratio_min": least,
               "below": below}  # fmt: skip
    return {
        "cumulative": cumulative(found),
        "density": pd.DataFrame(density),
        "summary": pd.DataFrame([summary]),
    }


def count_bodies(total: int, threads: int | None = None) -> tuple[Integers, float, int]:
    """Draw bodies and count them by their torque coefficients; none is stored."""
    counts = np.zeros((BINS, BINS), np.int64)

    def part(first: int, control: Control) -> tuple[Integers, float, int]:
        alpha, beta, _, theta, phi, xi = drawn_bodies(first, min(first + CHUNK, total))
        square_p, square_r, *pair = theory.torque_coefficients(alpha, beta, theta, phi, xi)
        i, j = (
            ((values - low) * (BINS / (high - low))).astype(np.int64)
            for values, (low, high) in zip(pair, ENDS.values(), strict=True)
        )
        own = np.bincount((BINS * i + j)[(i < BINS) & (j < BINS)], minlength=BINS**2)
        ratio = np.sqrt(square_p / square_r)
        return own.reshape(BINS, BINS), float(ratio.min()), int((ratio < BOUND).sum())

    drawn_bodies(0, 0)  # compiles the sampler, if need be, in one thread
    # A hundred parts at a time, as each has counts of its own.
    least, below = np.inf, 0
    for start in range(0, total, 100 * CHUNK):
        calls = [partial(part, k) for k in range(start, min(start + 100 * CHUNK, total), CHUNK)]
        for own, ratio, few in side_by_side(calls, threads or available_threads()):
            counts += own
            least, below = min(least, ratio), below + few
    return counts, least, below


def edges(name: str) -> Floats:
    """Return the edges of the bins of ``K_p`` or ``K_r``, shape (bins + 1,)."""
    return np.linspace(*ENDS[name], BINS + 1)


def counts_of(tables: Tables) -> Integers:
    """Return the bodies in all bins of Fig. 4(b), shape (bins, bins), by ``K_p, K_r``."""
    counts, filled = np.zeros((BINS, BINS), dtype=np.int64), tables["density"]
    counts[filled["i"], filled["j"]] = filled["count"]
    return counts


def draw_coefficients(tables: Tables) -> Figure:
    """Draw (a) the cumulative distributions and (b) the density in the plane."""
    figure = new_figure(4.6, 7.2)
    upper, lower = figure.subplots(2, 1, height_ratios=(1, 1.25))
    values, counts = tables["cumulative"], counts_of(tables)
    # K_r is steep on the axis of K_p, so the inset shows the same over decades.
    inset = upper.inset_axes((0.47, 0.18, 0.5, 0.52))
    for axes in (upper, inset):
        for name, colour, style in (("K_p", BLUE, "-"), ("K_r", VERMILION, (0, (5, 1.5)))):
            axes.plot(values[name], values["probability"], color=colour, linestyle=style,
                      linewidth=1.8, label=f"${name}$")  # fmt: skip
        axes.set_ylim(0, 1.03)
        frame(axes)
    upper.set(xlim=(0, ENDS["K_p"][1]), xlabel="$K_p$,  $K_r$", ylabel="cumulative distribution")
    upper.legend(frameon=False, loc="upper right", bbox_to_anchor=(1, 0.93), ncols=2)
    inset.set(xscale="log", xlim=(1e-4, 10.0))
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
