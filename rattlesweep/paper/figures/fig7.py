"""Fig. 7: times of reversal in the steady direction, late reversals, the onset of wobbling.

Late reversals and onsets are seen in windows of time.  The runs that do not reverse (type SW) and
those that reverse late are integrated once more with the smallest and the largest spin of each of
64 windows written down; the same launches give the same bits.

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

from rattlesweep.arrays import Floats
from rattlesweep.paper.columns import count, number, schema, table
from rattlesweep.paper.figures.chaos import thinned_out
from rattlesweep.paper.figures.fig5 import panels, times
from rattlesweep.paper.workspace import Progress, Tables, Workspace, between
from rattlesweep.physics import full
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.physics.steady import growth
from rattlesweep.sweeps.columns import TIME

# "Several times" t_rGH: a reversal later than this many is late.
LATE_FROM = 2.0
# The spin has left its plateau when it has lost this much of itself.
PLATEAU = 0.1
# Spins beyond which the paper sees late reversals.
FAST = 0.3

LATE = schema(
    "K_r n_i omega_xy0",
    count("reversed", "runs of type R"),
    count("late", f"of them, later than {LATE_FROM:g} t_rGH"),
    number("ratio_std", "standard deviation of t_r / t_rGH over type R"),
    number("ratio_std_prompt", "the same without the late ones"),
    number("growth_late", "growth rate of the roll at n_i over abs(n_i) K_r / 2: median of the "
           "late ones"),
    number("growth_prompt", "the same of the others"),
    count("followed", "late ones that were followed in windows"),
    number("plateau", "share of t_r until the spin has lost 10 %: median of those"),
)  # fmt: skip
ONSET = schema(
    "K_r n_i omega_xy0",
    count("wobbling", "runs of type SW that were followed in windows"),
    number("onset_median", "median of their onset", TIME),
    number("onset_low", "95 % confidence interval of that (order statistics)", TIME),
    number("onset_high", "the same, upper end", TIME),
    count("onset_late", f"onsets later than {LATE_FROM:g} t_rGH"),
    number("leave_median", "median time until 5 % of the spin is lost", TIME),
    count("reversed", "runs of type R"),
    number("t_r_median", "median t_r of type R", TIME),
    number("t_rgh_median", "median t_rGH of the runs that were followed", TIME),
)


def data(ws: Workspace, progress: Progress) -> Tables:
    """Tables ``times``, ``late`` and ``onset``: one row a point each."""
    sweep = ws.sweep("steady", progress)
    points = list(sweep.points())
    for _, runs in points:
        runs["ratio"], runs["back"] = runs["t_r"] / runs["t_rgh"], runs["type"] == "R"
        runs["late"] = runs["back"] & (runs["ratio"] > LATE_FROM)
    every = pd.concat([runs for _, runs in points], ignore_index=True)
    chosen = thinned_out(every[(every["type"] == "SW") | every["late"]], ws.sizes.windows)
    followed = in_windows(ws, chosen, between(progress, 0.1, 1.0))
    cells = dict(list(followed.groupby("case")))
    late, onset = [], []
    for case, (point, runs) in enumerate(points):
        own = cells.get(case, followed[:0])
        late.append(point | of_late(runs, own[own["back"]]))
        onset.append(point | of_onsets(runs, own[~own["back"]]))
    return {"times": times(sweep), "late": table(late, LATE), "onset": table(onset, ONSET)}


def in_windows(ws: Workspace, runs: pd.DataFrame, progress: Progress) -> pd.DataFrame:
    """Runs with three times, in ``sqrt(a/g)``, NaN where it does not happen.

    ``onset``; ``leaves``: 5 % of the spin is lost; ``kept``: less than 10 % is lost until then.
    """
    found = np.full((len(runs), 3), np.nan)
    if len(runs):
        columns = ["window_t", "window_n_min", "window_n_max"]
        windows = ws.again("closer", runs, progress, record=["windows"])[columns]
        leave = ws.sweep("steady", progress).config.classify.sw_departure
        spins = runs["n_i"].to_numpy()
        for k, (step, least, most) in enumerate(windows.itertuples(index=False)):
            # The end nearer to zero, or beyond it.
            loss = 1 - np.asarray(most if spins[k] < 0 else least, dtype=float) / spins[k]
            if loss.size:
                levels = (loss.max() / 2, leave, PLATEAU)
                found[k] = [first_above(loss, level, step) for level in levels]
                if np.isnan(found[k, 2]):
                    # So abrupt that the run was over before the window was: kept to its beginning.
                    found[k, 2] = loss.size * step
    return runs.assign(onset=found[:, 0], leaves=found[:, 1], kept=found[:, 2])


def first_above(loss: Floats, level: float, step: float) -> float:
    """Middle of the first window whose loss is above a level; NaN without one."""
    above = np.flatnonzero(loss > level)
    return (float(above[0]) + 0.5) * step if above.size else np.nan


def of_late(runs: pd.DataFrame, followed: pd.DataFrame) -> dict[str, Any]:
    """Row of :data:`LATE` from the runs of a point, and the late ones that were followed."""
    prompt = runs["back"] & ~runs["late"]
    rate = pd.Series(np.nan, runs.index)
    if (runs["n_i"].abs() >= FAST).any():
        # Exact at any spin, over its limit for small spins (Eq. (74) [case-instab1]).
        constants = full.constants(*(runs[name].to_numpy() for name in PARAMETERS))
        limit = runs["n_i"].abs() * runs["K_r_body"] / 2
        rate = growth(constants, runs["n_i"].to_numpy())[1] / limit
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
    """Row of :data:`ONSET` from the runs of a point, and those of type SW that were followed."""
    low, high = median_interval(wobbling["onset"].to_numpy())
    return {
        "wobbling": len(wobbling),
        "onset_median": wobbling["onset"].median(),
        "onset_low": low,
        "onset_high": high,
        "onset_late": (wobbling["onset"] > LATE_FROM * wobbling["t_rgh"]).sum(),
        "leave_median": wobbling["leaves"].median(),
        "reversed": runs["back"].sum(),
        "t_r_median": runs["t_r"][runs["back"]].median(),
        "t_rgh_median": wobbling["t_rgh"].median(),
    }


def median_interval(values: Floats) -> tuple[float | None, float | None]:
    """95 % confidence interval of a median from order statistics; none for fewer than 6 values.

    Of independent values, each lies below the median with probability one half, so the number
    below it is binomial whatever the distribution.
    """
    n = len(values)
    k = int(np.searchsorted(bdtr(np.arange(n + 1), n, 0.5), 0.025))
    if k < 1:
        return None, None
    ordered = np.sort(values)
    return float(ordered[k - 1]), float(ordered[n - k])


def draw(tables: Tables) -> Drawing:
    """A panel a spin."""
    return panels(tables["times"], "K_r", "t_{rs}", "t_{rGH-}")[0]
