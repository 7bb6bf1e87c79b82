"""What the measures of the claims share: tolerances, shares, points beside the theory's line."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.paper.claims.claim import Count, every
from rattlesweep.paper.figures.chaos import EDGE
from rattlesweep.sweeps.tables.cells import wilson

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd

# Rounding error allowed in an identity between doubles.
EXACT = 1e-9
# A tenth of a decade: the size of a symbol on the paper's logarithmic axes.
SYMBOL = 10**0.1


def share(hits: int, runs: int) -> dict[str, float]:
    """Share with its interval, as the numbers that decide a claim."""
    low, high = map(float, wilson(hits, runs))
    return {"value": hits / runs if runs else np.nan, "low": low, "high": high}


def share_words(hits: int, runs: int) -> str:
    """Share with its interval, in words."""
    return "{value:.2%} [{low:.2%}, {high:.2%}]".format(**share(hits, runs))


def slow(frame: pd.DataFrame, most: float) -> pd.DataFrame:
    """Points of ``abs(n_i) <= most``."""
    return frame[frame["n_i"].abs() <= most + EDGE]


def fast(frame: pd.DataFrame, least: float) -> pd.DataFrame:
    """Points of ``abs(n_i) >= least``."""
    return frame[frame["n_i"].abs() >= least - EDGE]


def small(frame: pd.DataFrame, most: float = 0.01) -> pd.DataFrame:
    """Points of ``omega_xy0 <= most``."""
    return frame[frame["omega_xy0"] <= most + EDGE]


def at_spin(frame: pd.DataFrame, n_i: float) -> pd.DataFrame:
    """Points of this spin."""
    return frame[(frame["n_i"] - n_i).abs() < EDGE]


def rises(frame: pd.DataFrame, value: str, by: str, within: Sequence[str]) -> Count:
    """In how many groups ``within`` the value rises strictly with abs(``by``)."""
    groups = [g.sort_values(by, key=np.abs)[value] for _, g in frame.groupby(list(within))]
    return every([bool(np.all(np.diff(g) > 0)) for g in groups if len(g) > 1])


def beside_line(frame: pd.DataFrame) -> pd.DataFrame:
    """Add ``ratio``, mean over line, with its interval, and ``scatter``, deviation over mean."""
    line = frame["t_rgh_line"]
    return frame.assign(
        ratio=frame["t_r_mean"] / line,
        ratio_low=frame["t_r_low"] / line,
        ratio_high=frame["t_r_high"] / line,
        scatter=frame["t_r_std"] / frame["t_r_mean"],
    ).dropna(subset=["ratio"])


def near(ratio: pd.Series[float]) -> pd.Series[bool]:
    """Whether each is within the size of a symbol of 1."""
    inside: pd.Series[bool] = np.abs(np.log(ratio)) < np.log(SYMBOL)
    return inside


def slopes(frame: pd.DataFrame, coefficient: str) -> list[float]:
    """Slope of log mean time against log coefficient, one a spin and oscillation."""
    return [
        float(np.polyfit(np.log(own[coefficient]), np.log(own["t_r_mean"]), 1)[0])
        for _, own in frame.groupby(["n_i", "omega_xy0"])
        if len(own) > 1
    ]


def farthest(frame: pd.DataFrame, coefficient: str) -> dict[str, float | str]:
    """The ratio farthest from 1 with its interval, and where it is, among the range of all."""
    row = frame.loc[np.log(frame["ratio"]).abs().idxmax()]
    value, low, high = (float(row[name]) for name in ("ratio", "ratio_low", "ratio_high"))
    return {
        "value": value, "low": low, "high": high,
        "least": frame["ratio"].min(), "largest": frame["ratio"].max(),
        "farthest": f"{value:.3f} [{low:.3f}, {high:.3f}] at {coefficient} = "
        f"{row[coefficient]:.3g}, n_i = {row['n_i']:g}, omega_xy0 = {row['omega_xy0']:g}",
    }  # fmt: skip
