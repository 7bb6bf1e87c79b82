"""Fig. 8: times of reversal in the steady direction, late reversals, the onset of wobbling.

Late reversals and onsets are seen in windows of time.  The runs that do not reverse (type SW) and
those that reverse late are integrated once more with the smallest and the largest spin of each of
64 windows recorded; the same launches give the same bits.

The onset of wobbling is the middle of the first window in which the loss of spin, 1 - n/n_i,
exceeds half of the largest loss in the run.  A reversal is a loss of 1, of which half is lost at
nearly the same time as all of it, so that the onset and the time of reversal are alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing
from scipy.special import bdtr

from rattlesweep.api import growth_rates
from rattlesweep.arrays import Floats
from rattlesweep.paper.figures.fig6 import panels, times
from rattlesweep.paper.workspace import Tables, Workspace, thinned_out

# "Several times" t_rGH: a reversal later than this many is late.
LATE_FROM = 2.0
# The spin has left its plateau when it has lost this much of itself.
PLATEAU = 0.1
# Spins beyond which the paper sees late reversals.
FAST = 0.3


def data(ws: Workspace) -> Tables:
    """Return the table ``times``, one row a point."""
    return {"times": times(ws.sweep("steady"), "K_r")}


def windows(ws: Workspace) -> Tables:
    """Return the tables ``late`` and ``onset``, one row a point each."""
    runs = ws.sweep("steady")
    ratio, back = runs["t_r"] / runs["t_rgh"], runs["type"] == "R"
    runs = runs.assign(ratio=ratio, back=back, late=back & (ratio > LATE_FROM))
    chosen = thinned_out(runs[(runs["type"] == "SW") | runs["late"]], ws.sizes.windows)
    followed = in_windows(ws, chosen)
    cells = dict(list(followed.groupby("case")))
    late, onset = [], []
    for case, own in runs.groupby("case"):
        point = own[["K_r", "n_i", "omega_xy0"]].iloc[0].to_dict()
        seen = cells.get(case, followed[:0])
        late.append(point | of_late(own, seen[seen["back"]]))
        onset.append(point | of_onsets(own, seen[~seen["back"]]))
    return {"late": pd.DataFrame(late), "onset": pd.DataFrame(onset)}


def in_windows(ws: Workspace, runs: pd.DataFrame) -> pd.DataFrame:
    """Return runs with what their windows show, NaN where it does not happen.

    ``onset`` and ``kept`` (less than 10 % of the spin is lost until then) are times in
    ``sqrt(a/g)``; ``centre`` is the mean spin of the windows from the onset on.
    """
    found = np.full((len(runs), 3), np.nan)
    if len(runs):
        names = ["window_t", "window_n_min", "window_n_max"]
        recorded = ws.again("windows", runs, record=["windows"])[names]
        spins = runs["n_i"].to_numpy()
        for k, (step, *ends) in enumerate(recorded.itertuples(index=False)):
            least, most = (np.asarray(end, dtype=float) for end in ends)
            # The end nearer to zero, or beyond it.
            loss = 1 - (most if spins[k] < 0 else least) / spins[k]
            if loss.size:
                half = loss.max() / 2
                found[k, :2] = [first_above(loss, level, step) for level in (half, PLATEAU)]
                if np.isnan(found[k, 1]):
                    # So abrupt that the run was over before the window was: kept to its beginning.
                    found[k, 1] = loss.size * step
                found[k, 2] = ((least + most) / 2)[np.argmax(loss > half) :].mean()
    columns = dict(zip(("onset", "kept", "centre"), found.T, strict=True))
    return runs.assign(**columns)


def first_above(loss: Floats, level: float, step: float) -> float:
    """Return the middle of the first window whose loss is above a level; NaN without one."""
    above = np.flatnonzero(loss > level)
    return (float(above[0]) + 0.5) * step if above.size else np.nan


def of_late(runs: pd.DataFrame, followed: pd.DataFrame) -> dict[str, Any]:
    """Return a row of ``late`` by the runs of a point, and the late ones that were followed."""
    prompt = runs["back"] & ~runs["late"]
    rate = pd.Series(np.nan, runs.index)
    if (runs["n_i"].abs() >= FAST).any():
        # Exact at any spin, over its limit for small spins (Eq. (74) [case-instab1]).
        bodies = runs.assign(K_r=runs["K_r_body"])
        exact = growth_rates(bodies[["alpha", "beta", "gamma", "theta", "phi", "xi"]],
                             runs["n_i"].to_numpy(), exact=True)  # fmt: skip
        rate = pd.Series(exact.roll, runs.index) / (runs["n_i"].abs() * runs["K_r_body"] / 2)
    return {
        "reversed": runs["back"].sum(),
        "late": runs["late"].sum(),
        "ratio_std": runs["ratio"][runs["back"]].std(),
        "ratio_std_prompt": runs["ratio"][prompt].std(),
        "growth_late": rate[runs["late"]].median(),
        "growth_prompt": rate[prompt].median(),
        "followed": len(followed),
        "plateau": (followed["kept"] / followed["t_r"]).median(),
    }


def of_onsets(runs: pd.DataFrame, wobbling: pd.DataFrame) -> dict[str, Any]:
    """Return a row of ``onset`` by the runs of a point, and those of type SW that were followed."""
    low, high = median_interval(wobbling["onset"].to_numpy())
    centre, spin = wobbling["centre"], wobbling["n_i"]
    return {
        "wobbling": len(wobbling),
        "onset_median": wobbling["onset"].median(),
        "onset_low": low,
        "onset_high": high,
        "onset_late": (wobbling["onset"] > LATE_FROM * wobbling["t_rgh"]).sum(),
        "reversed": runs["back"].sum(),
        "t_r_median": runs["t_r"][runs["back"]].median(),
        "centre_between": ((spin < centre) & (centre < 0)).sum(),
        "centre_median": (centre / spin).median(),
        "centre_low": (centre / spin).min(),
        "centre_high": (centre / spin).max(),
    }


def median_interval(values: Floats) -> tuple[float, float]:
    """Return a 95 % confidence interval of a median; NaN for fewer than 6 values.

    Of independent values, each lies below the median with probability one half, so the number
    below it is binomial whatever the distribution: the ends are order statistics.
    """
    n = len(values)
    k = int(np.searchsorted(bdtr(np.arange(n + 1), n, 0.5), 0.025))
    if k < 1:
        return np.nan, np.nan
    ordered = np.sort(values)
    return float(ordered[k - 1]), float(ordered[n - k])


def draw(tables: Tables) -> Drawing:
    """Draw a panel for each spin."""
    return panels(tables["times"], "K_r", "t_{rs}", "t_{rGH-}")[0]
