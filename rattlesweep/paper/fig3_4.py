"""Random bodies of SD: Fig. 3, frequencies (T4), and Fig. 4, coefficients (T5)."""

import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import ks_2samp

from rattlesweep.api import draw_bodies
from rattlesweep.api.style import BLUE, GREEN, ORANGE, SKY, VERMILION
from rattlesweep.arrays import Floats, Integers
from rattlesweep.paper.claim import Measured
from rattlesweep.paper.workspace import (
    TABLE_I,
    Made,
    Tables,
    Workspace,
    paper_figure,
    records,
)
from rattlesweep.physics import theory
from rattlesweep.physics.body import PARAMETERS, shell_dumbbell

# Lower and upper ends by name.
Ranges = Mapping[str, Sequence[float]]
_SEED = 2017
LEVELS = 2001  # points of a cumulative distribution
_CHUNK = 100_000  # bodies counted at a time
# The paper's lower bound of omega_p/omega_r (Methods), and its colour code of nine
# decades.
BOUND = 1.3
DECADES = 9
# The binned axes of Fig. 4(b).  Not named in the paper; no body of Table I lies
# outside.
_ENDS = {"K_p": (0.0, 7.0), "K_r": (0.0, 0.4)}
_BINS = 200
EDGES = {name: np.linspace(*ends, _BINS + 1) for name, ends in _ENDS.items()}
_CLOSE = 0.02  # distance at which two distributions look the same in print
MUCH = 10.0  # ratio that counts as "much larger"


def drawn_bodies(first: int, last: int, ranges: Ranges = TABLE_I) -> tuple[Floats, ...]:
    """Return ``alpha, beta, gamma, theta, phi, xi`` of some of the random bodies."""
    bodies = draw_bodies(last - first, seed=_SEED, first=first, ranges=ranges)
    return tuple(bodies[name].to_numpy() for name in PARAMETERS)


def drawn_modes(samples: int, ranges: Ranges = TABLE_I) -> theory.Modes:
    """Return the modes of the first `samples` random bodies."""
    alpha, beta, _, theta, phi, xi = drawn_bodies(0, samples, ranges)
    return theory.modes(alpha, beta, theta, phi, xi)


def cumulative(**values: Floats) -> pd.DataFrame:
    """Return quantiles of values at the levels of the column ``probability``."""
    probability = np.linspace(0, 1, LEVELS)
    columns = {
        n: np.quantile(v, probability, method="inverted_cdf") for n, v in values.items()
    }
    return pd.DataFrame({"probability": probability} | columns)


def frequencies(ws: Workspace) -> Tables:
    """Return the tables ``cumulative`` and ``summary`` (one row) of Fig. 3."""
    modes = drawn_modes(ws.sizes.fig3_bodies, ws.ranges)
    ratio = modes.omega_p / modes.omega_r
    row = {
        "samples": len(ratio),
        "below": (ratio <= BOUND).sum(),
        "ratio_bound": ratio_bound(ws.ranges),
    }
    for mode in "pr":
        exact = getattr(modes, f"omega_{mode}")
        zeroth = getattr(modes, f"omega_{mode}0")
        row[f"distance_{mode}"] = ks_2samp(exact, zeroth, method="asymp").statistic
        off = np.quantile(np.abs(zeroth / exact - 1), (0.5, 0.99))
        row[f"off_median_{mode}"], row[f"off_p99_{mode}"] = off
    values = {
        n: getattr(modes, n) for n in ("omega_p", "omega_r", "omega_p0", "omega_r0")
    }
    return {
        "cumulative": cumulative(**values, ratio=ratio),
        "summary": pd.DataFrame([row]),
    }


def ratio_bound(ranges: Ranges = TABLE_I) -> float:
    """Return the infimum of ``omega_p / omega_r`` over ranges of random bodies."""
    alpha, beta = shell_dumbbell(ranges["gamma"][1], ranges["f_sd"][0])
    xi = -np.radians(ranges["minus_xi_deg"][0])
    theta = ranges["theta"][0]
    phi = ranges["phi"][1]
    modes = theory.modes(alpha, beta, theta, phi, xi)
    return float(modes.omega_p / modes.omega_r)


def frequency_claim(made: Made) -> Measured:
    """Measure T4: the ratio of the frequencies, and their zeroth order."""
    row = records(made["fig3"]["summary"])[0]
    least = float(made["fig3"]["cumulative"]["ratio"].iloc[0])
    distance = max(row["distance_p"], row["distance_r"])
    checks = [row["below"] == 0, row["ratio_bound"] >= BOUND, distance < _CLOSE]
    return checks, {**row, "value": least, "low": row["ratio_bound"]}


def draw_frequencies(tables: Tables) -> Figure:
    """Draw the four distributions of Fig. 3 and, in the inset, that of the ratio."""
    values = tables["cumulative"]
    level = values["probability"]
    figure = paper_figure(4.6, 3.6)
    axes = figure.add_subplot()
    # The curves nearly coincide: draw the approximation dark, dashed and thin on a
    # broad pale line.
    for mode, colour, dark in (("p", SKY, "#003F66"), ("r", ORANGE, "#7A2E00")):
        axes.plot(
            values[f"omega_{mode}"],
            level,
            color=colour,
            linewidth=3.2,
            solid_capstyle="butt",
            label=rf"$\omega_{mode}$",
        )
        axes.plot(
            values[f"omega_{mode}0"],
            level,
            color=dark,
            linewidth=1.1,
            linestyle=(0, (4, 2)),
            label=rf"$\omega_{{{mode}0}}$",
        )
    axes.set(
        xlim=(0, 1.02 * values["omega_p"].iloc[-1]),
        ylim=(0, 1.03),
        xlabel=r"$\omega\,/\,\tilde\omega$",
        ylabel="cumulative distribution",
    )
    axes.legend(loc="upper right", bbox_to_anchor=(0.99, 0.9), ncols=2)
    inset = axes.inset_axes((0.6, 0.19, 0.36, 0.42))
    inset.plot(values["ratio"], level, color=GREEN, linewidth=1.6)
    inset.axvline(BOUND, color="#444444", linewidth=0.8, linestyle=":")
    # The last percent of the ratios would fill half of the axis.
    inset.set(
        xlim=(0, np.ceil(np.interp(0.995, level, values["ratio"]))), ylim=(0, 1.05)
    )
    inset.set_xlabel(r"$\omega_p/\omega_r$", labelpad=1)
    inset.tick_params(labelsize=7.5)
    return figure


def coefficients(ws: Workspace) -> Tables:
    """Return ``cumulative``, ``density`` (bins with bodies), ``summary`` of Fig. 4."""
    samples = ws.sizes.fig4_bodies
    total = ws.sizes.fig4_density
    modes = drawn_modes(samples)
    counts, below = count_bodies(total, ws.settings.get("threads"))
    i, j = np.nonzero(counts)
    density = {
        "i": i,
        "j": j,
        "K_p_low": EDGES["K_p"][i],
        "K_p_high": EDGES["K_p"][i + 1],
        "K_r_low": EDGES["K_r"][j],
        "K_r_high": EDGES["K_r"][j + 1],
        "count": counts[i, j],
        "relative_frequency": counts[i, j] / total,
    }
    return {
        "cumulative": cumulative(
            K_p=modes.K_p, K_r=modes.K_r, ratio=modes.K_p / modes.K_r
        ),
        "density": pd.DataFrame(density),
        "summary": pd.DataFrame(
            [{"samples": samples, "density_samples": total, "below": below}]
        ),
    }


def count_bodies(total: int, threads: int | None = None) -> tuple[Integers, int]:
    """Count bodies by ``K_p, K_r``, shape (bins, bins), and those below the bound."""
    counts = np.zeros(_BINS**2, np.int64)
    lock = threading.Lock()

    def count_chunk(first: int) -> int:
        alpha, beta, _, theta, phi, xi = drawn_bodies(first, min(first + _CHUNK, total))
        square_p, square_r, *pair = theory.torque_coefficients(
            alpha, beta, theta, phi, xi
        )
        i, j = (
            ((values - low) * (_BINS / (high - low))).astype(np.int64)
            for values, (low, high) in zip(pair, _ENDS.values(), strict=True)
        )
        inside = (i < _BINS) & (j < _BINS)
        bodies_in_bins = np.bincount((_BINS * i + j)[inside], minlength=_BINS**2)
        with lock:
            np.add(counts, bodies_in_bins, out=counts)
        return int((np.sqrt(square_p / square_r) < BOUND).sum())

    drawn_bodies(0, 1)  # compiles the sampler, if need be, in one thread
    with ThreadPoolExecutor(threads) as pool:
        below = sum(pool.map(count_chunk, range(0, total, _CHUNK)))
    return counts.reshape(_BINS, _BINS), below


def coefficient_claim(made: Made) -> Measured:
    """Measure T5: the distributions of the torque coefficients."""
    tables = made["fig4"]
    row = records(tables["summary"])[0]
    data = tables["cumulative"]
    level = data["probability"].to_numpy()
    # Order statistics: the median's place is binomial.
    half = 0.98 / np.sqrt(row["samples"])
    low, median, high = np.interp(
        [0.5 - half, 0.5, 0.5 + half], level, data["ratio"]
    ).tolist()
    decades = np.log10(
        tables["density"]["relative_frequency"].agg(["min", "max"])
    ).to_list()
    checks = [
        median >= MUCH,
        data["ratio"][0] > 1,
        -DECADES <= decades[0] <= decades[1] <= 0,
    ]
    return checks, {
        "value": median,
        "low": low,
        "high": high,
        "samples": row["samples"],
        "total": row["density_samples"],
        "least": data["ratio"][0],
        "decades": decades,
        **{name: np.interp(0.5, level, data[name]) for name in ("K_p", "K_r")},
    }


def draw_coefficients(tables: Tables) -> Figure:
    """Draw (a) the cumulative distributions and (b) the density in the plane."""
    figure = paper_figure(4.6, 7.2)
    upper, lower = figure.subplots(2, 1, height_ratios=(1, 1.25))
    values = tables["cumulative"]
    density = tables["density"]
    for name, colour, style in (("K_p", BLUE, "-"), ("K_r", VERMILION, (0, (5, 1.5)))):
        upper.plot(
            values[name],
            values["probability"],
            color=colour,
            linestyle=style,
            linewidth=1.8,
            label=f"${name}$",
        )
    # Over decades, as K_r is steep on the axis of K_p.
    upper.set(
        xscale="log",
        xlim=(1e-4, 10.0),
        ylim=(0, 1.03),
        xlabel="$K_p$,  $K_r$",
        ylabel="cumulative distribution",
    )
    upper.legend()
    upper.set_title("(a)", loc="left")
    shown = np.full((_BINS, _BINS), np.nan)
    shown[density["i"], density["j"]] = np.log10(density["relative_frequency"])
    picture = lower.pcolormesh(
        EDGES["K_p"],
        EDGES["K_r"],
        shown.T,
        cmap="viridis",
        vmin=-DECADES,
        vmax=0,
        rasterized=True,
    )
    bar = figure.colorbar(picture, ax=lower, ticks=range(-DECADES, 1), pad=0.02)
    bar.set_label(r"$\log_{10} P(K_p, K_r)$")
    lower.set(xlabel="$K_p$", ylabel="$K_r$")
    lower.set_title("(b)", loc="left")
    return figure
