"""Behind Fig. 7: reversals that come late, and when the spin begins to wobble.

Both are seen in windows of time.  The runs that do not reverse (type SW) and those that reverse
late are integrated once more with the smallest and the largest spin of each of 64 windows
written down; the same launches give the same bits.

The onset of wobbling is the middle of the first window in which the loss of spin, 1 - n/n_i,
exceeds half of the largest loss in the run.  A reversal is a loss of 1, of which half is lost at
nearly the same time as all of it, so that the onset and the time of reversal are alike.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.paper.figures.steady_checks import F64, I64, column
from rattlesweep.paper.sweeps import LAUNCH, bodies_of, horizons
from rattlesweep.physics import full
from rattlesweep.physics.steady import growth
from rattlesweep.sweeps.tables.columns import RATE, TIME

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.paper.sweeps import Place, Report, Sweep
    from rattlesweep.sweeps.cases.plan import Case

    Floats = NDArray[np.float64]

# The spin has left its plateau when it has lost this much of itself.
PLATEAU = 0.1
# Spins beyond which the paper sees late reversals.
FAST = 0.3

POINT = (
    column("K_r", F64, "target of the torque coefficient"),
    column("n_i", F64, "initial spin", RATE),
    column("omega_xy0", F64, "initial rate of the oscillation", RATE),
)
LATE = pa.schema(
    [
        *POINT,
        column("reversed", I64, "runs of type R"),
        column("late", I64, "of them, later than so many t_rGH as the settings say"),
        column("ratio_std", F64, "standard deviation of t_r / t_rGH over type R"),
        column("ratio_std_prompt", F64, "the same without the late ones"),
        column("growth_late", F64, "growth rate of the roll at n_i over abs(n_i) K_r / 2: median "
               "of the late ones"),
        column("growth_prompt", F64, "the same of the others"),
        column("followed", I64, "late ones that were followed in windows"),
        column("plateau", F64, "share of t_r until the spin has lost 10 %: median of those"),
    ]
)  # fmt: skip
ONSET = pa.schema(
    [
        *POINT,
        column("wobbling", I64, "runs of type SW that were followed in windows"),
        column("onset_median", F64, "median of their onset", TIME),
        column("onset_low", F64, "95 % confidence interval of that (order statistics)", TIME),
        column("onset_high", F64, "the same, upper end", TIME),
        column("onset_late", I64, "onsets later than so many t_rGH as the settings say"),
        column("leave_median", F64, "median time until 5 % of the spin is lost", TIME),
        column("reversed", I64, "runs of type R"),
        column("t_r_median", F64, "median t_r of type R", TIME),
        column("t_rgh_median", F64, "median t_rGH of the runs that were followed", TIME),
    ]
)
COLUMNS = (*LAUNCH, "sample", "t_rgh", "t_r", "type", "K_r")


def compute(place: Place, sweep: Sweep, report: Report) -> dict[str, pa.Table]:
    """Tables ``late`` and ``onset``, one row a point of Fig. 7 each."""
    settings = place.paper.fig7
    points, wanted = [], []
    for case, runs in sweep.cases(COLUMNS):
        back = runs["type"] == "R"
        ratio = runs["t_r"] / runs["t_rgh"]
        late = back & (ratio > settings.late)
        points.append(_point(case, runs, ratio, back, late))
        chosen = runs[(runs["type"] == "SW") | late]
        wanted.append(chosen.assign(case=case.index))
    runs = pd.concat(wanted, ignore_index=True)
    # Evenly thinned, so that all cases keep their share.
    stride = -(-len(runs) // settings.closer) if len(runs) else 1
    runs = runs.iloc[::stride].reset_index(drop=True)
    if len(runs):
        runs = runs.assign(**follow(place, sweep, runs, report))
    onsets = []
    for index, point in enumerate(points):
        own = runs[runs["case"] == index] if len(runs) else runs
        late_ones = own[own["type"] == "R"]
        point["followed"] = len(late_ones)
        point["plateau"] = _median((late_ones["kept"] / late_ones["t_r"]) if len(late_ones) else [])
        onsets.append(_onset(point, own[own["type"] == "SW"], settings.late))
    return {
        "late": pa.Table.from_pylist(points, schema=LATE),
        "onset": pa.Table.from_pylist(onsets, schema=ONSET),
    }


def _point(
    case: Case, runs: pd.DataFrame, ratio: pd.Series, back: pd.Series, late: pd.Series
) -> dict[str, float | None]:
    assert case.n_i is not None
    constants = full.constants(
        *(runs[name].to_numpy() for name in ("alpha", "beta", "gamma", "theta", "phi", "xi"))
    )
    slow = abs(case.n_i) < FAST
    # Exact at any spin, over its limit for small spins (Eq. (74) [case-instab1]).
    rate = (
        np.full(len(runs), np.nan)
        if slow
        else growth(constants, runs["n_i"].to_numpy())[1]
        / (runs["n_i"].abs() * runs["K_r"] / 2).to_numpy()
    )
    prompt = (back & ~late).to_numpy()
    return {
        "K_r": case.target,
        "n_i": case.n_i,
        "omega_xy0": case.omega_xy0,
        "reversed": int(back.sum()),
        "late": int(late.sum()),
        "ratio_std": _std(ratio[back]),
        "ratio_std_prompt": _std(ratio[back & ~late]),
        "growth_late": None if slow else _median(rate[late.to_numpy()]),
        "growth_prompt": None if slow else _median(rate[prompt]),
        "t_r_median": _median(runs["t_r"][back]),
    }


def follow(place: Place, sweep: Sweep, runs: pd.DataFrame, report: Report) -> dict[str, Floats]:
    """Integrate runs once more with windows.

    Returns
    -------
    dict
        ``onset``, ``leaves`` (5 % of the spin is lost) and ``kept`` (less than 10 % is lost until
        then), in ``sqrt(a/g)``; NaN where it does not happen.
    """
    config = sweep.plan.config.model_copy(
        update={"name": "closer", "record": ["windows"], "block_size": 2000}
    )
    table = bodies_of(runs, horizons(config, runs["t_rgh"].to_numpy(dtype=float)))
    done = place.derived("closer", config, report, table)
    found = {name: np.full(len(runs), np.nan) for name in ("onset", "leaves", "kept")}
    leave = config.classify.sw_departure
    for _, rows in done.cases(("sample", "n_i", "window_t", "window_n_min", "window_n_max")):
        for sample, n_i, step, least, most in rows.itertuples(index=False):
            # The end nearer to zero, or beyond it.
            loss = 1 - np.asarray(most if n_i < 0 else least) / n_i
            if not len(loss):
                continue
            found["onset"][sample] = first_above(loss, loss.max() / 2, step)
            found["leaves"][sample] = first_above(loss, leave, step)
            kept = first_above(loss, PLATEAU, step)
            # So abrupt that the run was over before the window was: kept to its beginning at least.
            found["kept"][sample] = kept if np.isfinite(kept) else len(loss) * step
    return found


def first_above(loss: Floats, level: float, step: float) -> float:
    """Middle of the first window whose loss is above a level; NaN without one."""
    above = np.flatnonzero(loss > level)
    return (float(above[0]) + 0.5) * step if above.size else np.nan


def _onset(
    point: dict[str, float | None], runs: pd.DataFrame, late: float
) -> dict[str, float | None]:
    times = runs["onset"].to_numpy() if len(runs) else np.zeros(0)
    low, high = median_interval(times)
    return {
        "K_r": point["K_r"],
        "n_i": point["n_i"],
        "omega_xy0": point["omega_xy0"],
        "wobbling": len(runs),
        "onset_median": _median(times),
        "onset_low": low,
        "onset_high": high,
        "onset_late": int((runs["onset"] > late * runs["t_rgh"]).sum()) if len(runs) else 0,
        "leave_median": _median(runs["leaves"]) if len(runs) else None,
        "reversed": point["reversed"],
        "t_r_median": point.pop("t_r_median"),
        "t_rgh_median": _median(runs["t_rgh"]) if len(runs) else None,
    }


def median_interval(values: Floats) -> tuple[float | None, float | None]:
    """95 % confidence interval of a median from order statistics; none for fewer than 6 values.

    Of independent values, each lies below the median with probability one half, so the number
    below it is binomial whatever the distribution.
    """
    from scipy.stats import binom

    n = len(values)
    k = int(binom.ppf(0.025, n, 0.5)) if n else 0
    if k < 1:
        return None, None
    ordered = np.sort(values)
    return float(ordered[k - 1]), float(ordered[n - k])


def _median(values: Floats | pd.Series | list[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def _std(values: pd.Series) -> float | None:
    return float(values.std(ddof=1)) if len(values) > 1 else None
