"""What the checks of the claims about sweeps are made of."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd

SYMBOL = 10**0.1
"""A tenth of a decade: the size of a symbol on the paper's logarithmic axes."""

EDGE = 1e-9
"""Spins and oscillations are compared with this margin, as they come from a file."""


def rises(frame: pd.DataFrame, value: str, by: str, within: Sequence[str]) -> tuple[int, int]:
    """In how many groups ``within`` the value rises strictly with abs(``by``), and of how many."""
    groups = [g.sort_values(by, key=np.abs)[value] for _, g in frame.groupby(list(within))]
    groups = [g for g in groups if len(g) > 1]
    return sum(bool(np.all(np.diff(g) > 0)) for g in groups), len(groups)


def of(pair: tuple[int, int]) -> str:
    """Words for a count of a total."""
    return f"{pair[0]} of {pair[1]}"


def ends(frame: pd.DataFrame, by: str) -> pd.DataFrame:
    """Rows of the smallest and the largest ``by`` alone."""
    return frame[frame[by].isin([frame[by].min(), frame[by].max()])]


def covers(frame: pd.DataFrame) -> bool:
    """Whether a sweep has the spins and oscillations that the paper's claims speak of."""
    # A point without a good run, or a mean time without a reversal, settles nothing.
    frame = frame[frame["runs"] > 0]
    if "t_r_mean" in frame:
        frame = frame.dropna(subset=["t_r_mean"])
    spins, sizes = frame["n_i"].abs(), frame["omega_xy0"]
    has = [
        (spins <= 0.1 + EDGE).any(),
        ((spins - 0.3).abs() < EDGE).any(),
        (spins >= 0.4 - EDGE).any(),
        (sizes <= 0.01 + EDGE).any(),
        (sizes > 0.01 + EDGE).any(),
    ]
    coefficient = frame["K_p" if "K_p" in frame else "K_r"]
    return all(has) and coefficient.nunique() > 2
