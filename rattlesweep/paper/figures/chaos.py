"""Which wobbling runs of Fig. 6 are chaotic, by the growth of a small difference.

The runs of type SW are integrated once more with their Lyapunov exponents; the same launches give
the same runs.  A run is chaotic if a small difference grows more than e^10-fold in its second half
(:mod:`rattlesweep.sweeps.types`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.arrays import Floats
from rattlesweep.integrate.follow.lyapunov import growth_along
from rattlesweep.integrate.task import Control, side_by_side
from rattlesweep.paper.columns import number, schema
from rattlesweep.paper.workspace import Progress, Workspace, between
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.sweeps.columns import RATE, TIME, field
from rattlesweep.sweeps.single import Launch, single_run
from rattlesweep.sweeps.types import is_chaotic

# Runs called chaotic although they are slow are followed to this many horizons.
LONGER = 6
SLOW = 0.4

CHAOS = schema(
    "K_r n_i omega_xy0 sample",
    number("t_end", "horizon", TIME),
    number("n_departure", "largest loss of spin over the run, relative"),
    number("lyapunov", "largest Lyapunov exponent over the run", RATE),
    number("lyapunov_late", "the same over its second half", RATE),
    field("chaotic", pa.bool_(), "1", "whether a difference grows e^10-fold in the second half"),
    number("growth_longer", "logarithm of the growth in the second half of six horizons; only for "
           "runs called chaotic with abs(n_i) <= 0.4"),
)  # fmt: skip


def exponents(ws: Workspace, progress: Progress) -> pd.DataFrame:
    """Columns of :data:`CHAOS`, one row a run of type SW."""
    runs = ws.sweep("steady", progress).runs
    runs = thinned_out(runs[runs["type"] == "SW"], ws.sizes.lyapunov)
    columns = ["t_end", "lyapunov", "lyapunov_late"]
    runs[columns] = np.nan
    if len(runs):
        part = between(progress, 0.0, 0.7)
        runs[columns] = ws.again("lyapunov", runs, part, record=["lyapunov"])[columns]
    runs["chaotic"] = is_chaotic(runs["lyapunov_late"].to_numpy(), runs["t_end"].to_numpy())
    slow = runs[runs["chaotic"] & (runs["n_i"].abs() <= SLOW)]
    ends = np.array([LONGER / 2, LONGER])
    found = growths(
        [(launch_of(run), float(run["t_end"]) * ends, 1e-11) for _, run in slow.iterrows()],
        ws.threads, between(progress, 0.7, 1.0), "are the chaotic ones chaotic for good?",
    )  # fmt: skip
    runs["growth_longer"] = np.nan
    runs.loc[slow.index, "growth_longer"] = [late - early for early, late in found]
    return runs


def thinned_out(runs: pd.DataFrame, most: int) -> pd.DataFrame:
    """So many of the runs at most, evenly, so that all cases keep their share."""
    return runs.iloc[:: max(1, -(-len(runs) // most))].reset_index(drop=True)


def launch_of(run: pd.Series) -> Launch:
    """Launch of a run of the sweep."""
    body = Rattleback(*(float(run[name]) for name in PARAMETERS))
    return Launch(body, n_i=float(run["n_i"]), omega_xy0=float(run["omega_xy0"]), t_end=1.0)


def growths(
    runs: Sequence[tuple[Launch, Floats, float]], threads: int, progress: Progress, words: str
) -> list[Floats]:
    """Logarithms of a difference's growth along runs: of each its launch, times and tolerance."""

    def growth(launch: Launch, times: Floats, tol: float, _: Control) -> Floats:
        batch = single_run(launch)[2]
        assert batch is not None
        return growth_along(batch.constants[0], batch.y0[0], times, tol=tol)

    calls = [partial(growth, *run) for run in runs]
    return side_by_side(calls, threads, lambda share: progress(share, words))
