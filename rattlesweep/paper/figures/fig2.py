"""Fig. 2: cumulative distributions of the frequencies of the set SD; its bodies, for Fig. 3 too."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure as Drawing

from rattlesweep.arrays import Floats
from rattlesweep.paper.columns import count, number, schema, table
from rattlesweep.paper.figures.style import DASHES, frame
from rattlesweep.paper.workspace import Progress, Tables, between
from rattlesweep.physics import theory
from rattlesweep.physics.body import shell_dumbbell
from rattlesweep.analysis.style import GREEN, ORANGE, SKY, new_figure
from rattlesweep.sweeps.bodies.sampler import draw_bodies
from rattlesweep.sweeps.config.schema import SdRanges
from rattlesweep.sweeps.columns import RATE

SEED = 2017
# Points of a cumulative distribution.
LEVELS = 2001
# The paper's lower bound of omega_p / omega_r (Methods).
BOUND = 1.3
# Bodies drawn at a time: a tenth of a second.
CHUNK = 100_000

CUMULATIVE = schema(
    "probability",
    number("omega_p", "pitch frequency (Eq. (24) [def-omega_pr])", RATE),
    number("omega_r", "roll frequency (Eq. (24) [def-omega_pr])", RATE),
    number("omega_p0", "pitch frequency at zero skew angle (Eq. (28) [omega_p0])", RATE),
    number("omega_r0", "roll frequency at zero skew angle (Eq. (29) [omega_r0])", RATE),
    number("ratio", "omega_p / omega_r"),
)
SUMMARY = schema(
    "",
    count("samples", "bodies"),
    count("below", f"bodies with omega_p / omega_r at or below {BOUND}"),
    number("ratio_bound", "infimum of omega_p / omega_r over the ranges"),
    number("distance_p", "largest difference of the pitch distributions"),
    number("off_median_p", "median of abs(omega_p0/omega_p - 1)"),
    number("off_p99_p", "99th percentile of abs(omega_p0/omega_p - 1)"),
    number("distance_r", "largest difference of the roll distributions"),
    number("off_median_r", "median of abs(omega_r0/omega_r - 1)"),
    number("off_p99_r", "99th percentile of abs(omega_r0/omega_r - 1)"),
)


def drawn_bodies(first: int, last: int, ranges: SdRanges, seed: int = SEED) -> tuple[Floats, ...]:
    """``alpha, beta, gamma, theta, phi, xi`` of the bodies from one number up to another.

    They are those of the sampler's group 0, so that body number ``i`` here is sample ``i`` of a
    sweep of the same seed.
    """
    limits = [ranges.gamma, ranges.f_sd, ranges.theta, ranges.phi, ranges.minus_xi_deg]
    drawn = draw_bodies(seed, np.arange(first, last), np.array(limits))[0]
    gamma, _, theta, phi, xi, alpha, beta = drawn
    return alpha, beta, gamma, theta, phi, xi


def draw_modes(
    names: Sequence[str], samples: int, ranges: SdRanges, progress: Progress
) -> dict[str, Floats]:
    """Attributes of :class:`rattlesweep.physics.theory.Modes` of so many random bodies."""
    kept = {name: np.empty(samples) for name in names}
    for first in range(0, samples, CHUNK):
        last = min(first + CHUNK, samples)
        alpha, beta, _, theta, phi, xi = drawn_bodies(first, last, ranges)
        found = theory.modes(alpha, beta, theta, phi, xi)
        for name in names:
            kept[name][first:last] = getattr(found, name)
        progress(last / samples, f"{last:,} bodies")
    return kept


def cumulative(values: dict[str, Floats], levels: int = LEVELS) -> dict[str, Floats]:
    """Cumulative distributions: their ``probability`` in even steps, and the values there.

    The values are members of what is given: from the least to the largest.
    """
    probability = np.linspace(0, 1, levels)
    return {"probability": probability} | {
        name: np.quantile(own, probability, method="inverted_cdf") for name, own in values.items()
    }


def distributions(bodies: int, ranges: SdRanges, progress: Progress) -> Tables:
    """Tables ``cumulative``, values at equally spaced probabilities, and ``summary``, one row."""
    names = ("omega_p", "omega_r", "omega_p0", "omega_r0")
    found = draw_modes(names, bodies, ranges, between(progress, 0.0, 0.8))
    found["ratio"] = found["omega_p"] / found["omega_r"]
    below = np.count_nonzero(found["ratio"] <= BOUND)
    row = {"samples": bodies, "below": below, "ratio_bound": ratio_bound(ranges)}
    progress(0.9, "comparing the distributions")
    for mode in ("p", "r"):
        exact, zeroth = found[f"omega_{mode}"], found[f"omega_{mode}0"]
        row[f"distance_{mode}"] = largest_distance(exact, zeroth)
        off = np.quantile(np.abs(zeroth / exact - 1), (0.5, 0.99))
        row[f"off_median_{mode}"], row[f"off_p99_{mode}"] = off
    progress(1.0, f"{bodies:,} bodies")
    return {"cumulative": table(cumulative(found), CUMULATIVE), "summary": table([row], SUMMARY)}


def largest_distance(one: Floats, other: Floats) -> float:
    """Largest difference of two empirical distributions: Kolmogorov and Smirnov's statistic."""
    # scipy.stats, which has it, takes a third of the time of all imports.
    both = np.sort(one), np.sort(other)
    places = np.concatenate(both)
    shares = [np.searchsorted(own, places, side="right") / own.size for own in both]
    return float(np.abs(shares[0] - shares[1]).max())


def ratio_bound(ranges: SdRanges) -> float:
    """Infimum of ``omega_p / omega_r`` over ranges of bodies whose pitch is the faster mode.

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
    """Four distributions; inset: that of the ratio."""
    values = tables["cumulative"].to_pandas()
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
