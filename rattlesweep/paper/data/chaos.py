"""Which runs are chaotic, by the growth of a small difference.

The runs of type SW of Fig. 6 are integrated once more with their Lyapunov exponents; the same
launches give the same runs.  A run is chaotic if a small difference grows more than e^10-fold in
its second half (:mod:`rattlesweep.sweeps.tables.chaos`).

The runs of Fig. 8 are followed far beyond the figure, at two tolerances.  Only what does not hang
on the tolerance is the body's own: on the way from reversal to reversal the pitch falls to a
millionth of its size, and what the integrator adds to it there is a difference like any other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.integrate.follow.lyapunov import growth_along
from rattlesweep.integrate.task import Control, side_by_side
from rattlesweep.paper.data import fig8
from rattlesweep.paper.data.columns import number, schema, table
from rattlesweep.paper.data.progress import Progress, between
from rattlesweep.paper.workspace import LAUNCH, Workspace
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.sweeps.blocks.single import Launch, single_run
from rattlesweep.sweeps.tables.chaos import is_chaotic
from rattlesweep.sweeps.tables.columns import RATE, TIME, field

Floats = NDArray[np.float64]

# Spins and oscillations are compared with this margin, as they come from a file.
EDGE = 1e-9
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
    runs = ws.sweep("steady", progress).runs((*LAUNCH, "sample", "n_departure", "type"))
    runs = runs[runs["type"] == "SW"]
    runs = runs.iloc[:: max(1, -(-len(runs) // ws.sizes.lyapunov))].reset_index(drop=True)
    columns = ["t_end", "lyapunov", "lyapunov_late"]
    runs[columns] = np.nan
    if len(runs):
        runs[columns] = ws.again(
            "lyapunov", runs, columns, between(progress, 0.0, 0.7), record=["lyapunov"]
        )
    runs["chaotic"] = is_chaotic(runs["lyapunov_late"].to_numpy(), runs["t_end"].to_numpy())
    slow = runs[runs["chaotic"] & (runs["n_i"].abs() <= SLOW + EDGE)]
    found = growths(
        [
            (launch_of(run), float(run["t_end"]) * np.array([LONGER / 2, LONGER]), 1e-11)
            for _, run in slow.iterrows()
        ],
        ws.threads, between(progress, 0.7, 1.0), "are the chaotic ones chaotic for good?",
    )  # fmt: skip
    runs["growth_longer"] = np.nan
    runs.loc[slow.index, "growth_longer"] = [late - early for early, late in found]
    return runs


def launch_of(run: pd.Series) -> Launch:
    """Launch of a run of the sweep."""
    body = Rattleback(**{name: float(run[name]) for name in PARAMETERS})
    return Launch(body, n_i=float(run["n_i"]), omega_xy0=float(run["omega_xy0"]), t_end=1.0)


def growths(
    runs: Sequence[tuple[Launch, Floats, float]], threads: int, progress: Progress, words: str
) -> list[Floats]:
    """Logarithms of a difference's growth along runs: of each its launch, times and tolerance."""
    calls: list[Callable[[Control], Floats]] = []
    for launch, times, tol in runs:
        _, _, batch = single_run(launch)
        assert batch is not None
        constants, y0 = batch.constants[0], batch.y0[0]
        if not calls:
            # Compiled here, and not in two threads at once.
            growth_along(constants, y0, [1.0])
        grown = partial(growth_along, constants, y0, times, tol=tol)
        calls.append(lambda control, grown=grown: grown())  # type: ignore[misc]
    return side_by_side(calls, threads, lambda share: progress(share, words))


# ------------------------------------------------------------------------- beside Fig. 8

# The one to trust last.
TOLERANCES = (1e-11, 1e-13)
POINTS = 120
# The second half is cut into so many parts, whose scatter gives the error of the exponent.
PARTS = 10
GROWTH = schema(
    "theta tol t",
    number("growth", "logarithm of the growth of a small difference"),
    number("exponent", "growth / t: running estimate of the largest exponent", RATE),
)
EXPONENTS = schema(
    "theta tol t_end",
    number("exponent", "largest Lyapunov exponent over the second half", RATE),
    number("error", "its standard error, from ten parts of that half", RATE),
    number("growth", "logarithm of the growth in the second half"),
)


def beside_fig8(
    t_end: float, threads: int, progress: Progress, tolerances: Sequence[float] = TOLERANCES
) -> dict[str, pa.Table]:
    """Lyapunov exponents of the runs of Fig. 8.

    Returns
    -------
    dict
        ``growth``: the running exponents; ``exponents``: one row a run and tolerance.
    """
    ends = np.linspace(t_end / 2, t_end, PARTS + 1)
    times = np.union1d(np.geomspace(t_end / 300, t_end, POINTS, endpoint=False), ends)
    late = np.searchsorted(times, ends)
    runs = [(body, tol) for body in fig8.BODIES for tol in tolerances]
    launches = [
        (Launch(body, n_i=fig8.N_I, omega_xy0=fig8.OMEGA_XY0, t_end=t_end), times, tol)
        for body, tol in runs
    ]
    words = "differences along the runs of Fig. 8"
    growth, exponents = [], []
    for (body, tol), values in zip(runs, growths(launches, threads, progress, words), strict=True):
        same = [np.full(len(times), value) for value in (body.theta, tol)]
        growth.append(pa.table([*same, times, values, values / times], schema=GROWTH))
        rates = np.diff(values[late]) / (t_end / 2 / PARTS)
        exponents.append(
            {"theta": body.theta, "tol": tol, "t_end": t_end, "exponent": rates.mean(),
             "error": rates.std(ddof=1) / np.sqrt(PARTS),
             "growth": values[late[-1]] - values[late[0]]}
        )  # fmt: skip
    return {"growth": pa.concat_tables(growth), "exponents": table(exponents, EXPONENTS)}
