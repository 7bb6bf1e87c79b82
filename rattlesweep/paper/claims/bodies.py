"""The paper's claims about frequencies and torque coefficients of random bodies (T4, T5)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.paper.claims.claim import Claim, wilson
from rattlesweep.paper.data.fig3 import DECADES, counts_of, grid_of
from rattlesweep.paper.data.sd import BOUND

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pyarrow as pa

# Distributions this close cannot be told apart in print.
CLOSE = 0.02
# What "much larger" means here.
MUCH = 10.0


def frequency_claim(
    tables: Mapping[str, pa.Table], density: Mapping[str, pa.Table] | None = None
) -> Claim:
    """T4: the ratio of the frequencies, and their zeroth order.

    Parameters
    ----------
    tables : mapping
        Of Fig. 2.
    density : mapping, optional
        Tables of Fig. 3, whose bodies are a hundred times as many.
    """
    row = tables["summary"].to_pylist()[0]
    least = tables["cumulative"]["ratio"][0].as_py()
    rare = ""
    if density is not None:
        many = density["summary"].to_pylist()[0]
        low, high = wilson(many["below"], many["density_samples"])
        rare = (
            f" Of the {many['density_samples']:,} bodies of Fig. 3, {many['below']} have a ratio "
            f"of {BOUND:g} or less ({low:.1e} to {high:.1e} of them, 95 %), the least being "
            f"{many['ratio_min']:.3f}; a sample of a million contains none with probability "
            f"{np.exp(-1e6 * many['below'] / many['density_samples']):.0%}."
        )
    return Claim(
        id="T4",
        where="Fig. 2; Methods; Eq. (43) [omg_pr-approx-omgpr0]",
        words="“it shows (omega_p/omega_r) > 1.3 in accordance with the condition (2)”; "
        "“omega_p^2 ~ omega_p0^2” and “omega_r^2 ~ omega_r0^2”",
        measured=(
            f"smallest omega_p/omega_r of {row['samples']:,} bodies: {least:.3f}; infimum over "
            f"the ranges of SD: {row['ratio_bound']:.4f}; the distributions of omega_p0 and "
            f"omega_r0 differ from those of omega_p and omega_r by at most "
            f"{row['distance_p']:.3f} and {row['distance_r']:.3f}, the frequencies themselves by "
            f"{row['off_median_p']:.1%} and {row['off_median_r']:.1%} (medians; for 99 % of the "
            f"bodies by less than {row['off_p99_p']:.1%} and {row['off_p99_r']:.1%})"
        ),
        value=least,
        low=row["ratio_bound"],
        checks=[
            (f"omega_p/omega_r > {BOUND:g} for every body drawn", row["below"] == 0),
            ("and for every body that the ranges allow", row["ratio_bound"] >= BOUND),
            (
                f"distributions of omega_p0 and omega_r0 within {CLOSE:g}",
                max(row["distance_p"], row["distance_r"]) < CLOSE,
            ),
        ],
        notes="The infimum is approached at the largest gamma and phi and the smallest f_sd, theta "
        "and skew angle." + rare,
    )


def coefficient_claim(tables: Mapping[str, pa.Table]) -> Claim:
    """T5: the distributions of the torque coefficients."""
    row = tables["summary"].to_pylist()[0]
    data = {n: tables["cumulative"][n].to_numpy() for n in ("probability", "K_p", "K_r", "ratio")}
    level = data["probability"]
    # Order statistics: the median's place is binomial.
    half = 0.98 / np.sqrt(row["samples"])
    low, median, high = np.interp([0.5 - half, 0.5, 0.5 + half], level, data["ratio"])
    share = tables["density"]["relative_frequency"].to_numpy()
    counted = int(tables["density"]["count"].to_numpy().sum())
    decades = (float(np.log10(share.min())), float(np.log10(share.max())))
    # The two parts of the figure come from two codes: vectorised theory and the counting loop.
    counts, grid, total = counts_of(tables), grid_of(tables), row["density_samples"]
    gap = 0.0
    for axis, name in enumerate(("K_p", "K_r")):
        edges = grid.edges(name)
        rising = np.cumsum(counts.sum(axis=1 - axis)) / total
        gap = max(gap, float(np.abs(np.interp(edges[1:], data[name], level) - rising).max()))
    # Kolmogorov's 99.9 % quantile for each, and the steps of the stored levels.
    allowed = 1.95 * np.sqrt(1 / row["samples"] + 1 / total) + 1 / (len(level) - 1)
    allowed += row["outside"] / total
    return Claim(
        id="T5",
        where="Fig. 3",
        words="“one can see K_p >> K_r”; relative frequency: “-9 <= log_10 P(K_p, K_r) <= 0”",
        measured=(
            f"median K_p/K_r = {median:.2f} ({low:.2f} to {high:.2f}, 95 %), smallest of "
            f"{row['samples']:,}: {data['ratio'][0]:.2f}; medians K_p = "
            f"{np.interp(0.5, level, data['K_p']):.3f}, K_r = "
            f"{np.interp(0.5, level, data['K_r']):.4f}; log10 P from {decades[0]:.1f} to "
            f"{decades[1]:.1f} over {total:,} bodies"
        ),
        value=float(median),
        low=float(low),
        high=float(high),
        checks=[
            (f"median of K_p/K_r at least {MUCH:g}", bool(median >= MUCH)),
            ("K_p > K_r for every body", bool(data["ratio"][0] > 1)),
            (
                "log10 P within the paper's nine decades",
                bool(-DECADES <= decades[0] <= decades[1] <= 0),
            ),
            ("every body is counted", counted + row["outside"] == total),
            (
                f"the marginals of (b) are the distributions of (a) within {allowed:.4f} "
                f"(99.9 %; found {gap:.4f})",
                gap < allowed,
            ),
        ],
        notes="Parts (a) and (b) are computed by independent code.",
    )
