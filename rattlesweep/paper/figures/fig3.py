"""Fig. 3: cumulative distributions of the frequencies of the set SD; its bodies, for Fig. 4 too."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing

from rattlesweep.analysis.style import GREEN, ORANGE, SKY, new_figure
from rattlesweep.arrays import Floats
from rattlesweep.paper.figures.frames import DASHES, frame
from rattlesweep.paper.workspace import Report, Tables
from rattlesweep.physics import theory
from rattlesweep.physics.body import shell_dumbbell
from rattlesweep.sweeps.bodies.sampler import draw_bodies
from rattlesweep.sweeps.config.schema import SdRanges

SEED = 2017
# Points of a cumulative distribution.
LEVELS = 2001
# The paper's lower bound of omega_p / omega_r (Methods).
BOUND = 1.3
# Bodies drawn at a time: a tenth of a second.
CHUNK = 100_000


def drawn_bodies(first: int, last: int, ranges: SdRanges, seed: int = SEED) -> tuple[Floats, ...]:
    """Return ``alpha, beta, gamma, theta, phi, xi`` of the bodies of some numbers.

    Body number ``i`` is sample ``i`` of a sweep of the same seed without a target.
    """
    limits = [ranges.gamma, ranges.f_sd, ranges.theta, ranges.phi, ranges.minus_xi_deg]
    drawn = draw_bodies(seed, np.arange(first, last), np.array(limits))[0]
    gamma, _, theta, phi, xi, alpha, beta = drawn
    return alpha, beta, gamma, theta, phi, xi


def draw_modes(
    names: Sequence[str], samples: int, ranges: SdRanges, report: Report
) -> dict[str, Floats]:
    """Return attributes of :class:`rattlesweep.physics.theory.Modes` of so many random bodies."""
    kept = {name: np.empty(samples) for name in names}
    for first in range(0, samples, CHUNK):
        last = min(first + CHUNK, samples)
        alpha, beta, _, theta, phi, xi = drawn_bodies(first, last, ranges)
        found = theory.modes(alpha, beta, theta, phi, xi)
        for name in names:
            kept[name][first:last] = getattr(found, name)
        report(last / samples)
    return kept


def cumulative(values: dict[str, Floats], levels: int = LEVELS) -> pd.DataFrame:
    """Return the values of which even shares, in ``probability``, lie at or below.

    All are members of what is given, from the least to the largest.
    """
    probability = np.linspace(0, 1, levels)
    columns = {n: np.quantile(v, probability, method="inverted_cdf") for n, v in values.items()}
    return pd.DataFrame({"probability": probability} | columns)


def data(bodies: int, ranges: SdRanges, report: Report) -> Tables:
    """Return the tables ``cumulative`` and ``summary`` (one row)."""
    names = ("omega_p", "omega_r", "omega_p0", "omega_r0")
    found = draw_modes(names, bodies, ranges, report)
    found["ratio"] = found["omega_p"] / found["omega_r"]
    below = np.count_nonzero(found["ratio"] <= BOUND)
    row = {"samples": bodies, "below": below, "ratio_bound": ratio_bound(ranges)}
    for mode in ("p", "r"):
        exact, zeroth = found[f"omega_{mode}"], found[f"omega_{mode}0"]
        row[f"distance_{mode}"] = largest_distance(exact, zeroth)
        off = np.quantile(np.abs(zeroth / exact - 1), (0.5, 0.99))
        row[f"off_median_{mode}"], row[f"off_p99_{mode}"] = off
    return {"cumulative": cumulative(found), "summary": pd.DataFrame([row])}


def largest_distance(one: Floats, other: Floats) -> float:
    """Return the Kolmogorov-Smirnov distance of two samples.

    Importing ``scipy.stats`` for it would take longer than the rest of the figure.
    """
    both = np.sort(one), np.sort(other)
    places = np.concatenate(both)
    shares = [np.searchsorted(own, places, side="right") / own.size for own in both]
    return float(np.abs(shares[0] - shares[1]).max())


def ratio_bound(ranges: SdRanges) -> float:
    """Return the infimum of ``omega_p / omega_r`` over ranges of bodies.

    The product of the squares, ``det H``, does not depend on xi and their sum grows with ``sin^2
    xi``, so the ratio is least at the least skew angle.  There it depends on ``beta/alpha`` and
    ``(1/phi - 1)/(1/theta - 1)`` alone, monotonically in both, and the four pairs of their ends
    decide.  Where pitch and roll can change places this is 1, the bound of any ratio.
    """
    alpha, beta = shell_dumbbell(
        np.array([ranges.gamma[1], ranges.gamma[0]]), np.array([ranges.f_sd[0], ranges.f_sd[1]])
    )
    theta, phi = np.array(ranges.theta), np.array(ranges.phi[::-1])
    xi = -np.radians(ranges.minus_xi_deg[0])
    found = theory.modes(alpha[:, None], beta[:, None], theta, phi, xi)
    if np.any(found.omega_p0 <= found.omega_r0):
        return 1.0
    return float(np.min(found.omega_p / found.omega_r))


def draw(tables: Tables) -> Drawing:
    """Draw the four distributions and, in the inset, that of the ratio."""
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
