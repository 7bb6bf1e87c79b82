"""Lyapunov exponents: of the wobbling runs of Fig. 7 and of the long runs of Fig. 9.

A run of type SW is chaotic if a small difference grows more than e^10-fold in its second half
(:mod:`rattlesweep.sweeps.types`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing

from rattlesweep.analysis.style import GREY, SERIES, new_figure
from rattlesweep.arrays import Floats
from rattlesweep.integrate.batch import available_threads, integrate
from rattlesweep.integrate.model import FULL
from rattlesweep.integrate.tableau import DOP853
from rattlesweep.integrate.task import Control, side_by_side
from rattlesweep.paper.figures.fig9 import BODIES, LETTERS, N_I, OMEGA_XY0
from rattlesweep.paper.figures.frames import ABOVE, DASHES, T_AXIS, decade_ticks, frame, launch
from rattlesweep.paper.figures.single import body_of
from rattlesweep.paper.workspace import Tables, Workspace, thinned_out
from rattlesweep.sweeps.single import Launch, single_run
from rattlesweep.sweeps.types import is_chaotic

# Runs called chaotic although they are slow are followed to this many horizons.
LONGER = 6
SLOW = 0.4
# A difference's growth is noted at the ends of so many parts of a run.
WINDOWS = 600
PAST_REVERSALS = frozenset(["lyapunov", "reversals"])
COLUMNS = ["K_r", "n_i", "omega_xy0", "sample", "t_end", "n_departure", "lyapunov",
           "lyapunov_late", "chaotic"]  # fmt: skip


def exponents(ws: Workspace, name: str, runs: pd.DataFrame, most: int) -> pd.DataFrame:
    """Integrate runs of the steady sweep again, so many at most, with their exponents.

    Returns the runs with ``lyapunov``, ``lyapunov_late`` and ``chaotic``.
    """
    runs = thinned_out(runs, most)
    new = ws.again(name, runs, record=["lyapunov"])
    new = new.reindex(columns=["t_end", "lyapunov", "lyapunov_late"])
    chaotic = is_chaotic(new["lyapunov_late"], new["t_end"])
    return runs.drop(columns="t_end").join(new).assign(chaotic=chaotic)


def wobbling(ws: Workspace) -> Tables:
    """Return the table ``runs``, one row a run of type SW.

    Those that are called chaotic at ``abs(n_i) <= 0.4`` are followed to six horizons.
    """
    runs = ws.sweep("steady")
    found = exponents(ws, "lyapunov", runs[runs["type"] == "SW"], ws.sizes.lyapunov)
    slow = found[found["chaotic"] & (found["n_i"].abs() <= SLOW)]
    ends = np.array([LONGER / 2, LONGER])
    launches = [
        (Launch(body_of(run), n_i=run["n_i"], omega_xy0=run["omega_xy0"], t_end=1.0),
         run["t_end"] * ends, 1e-11)
        for _, run in slow.iterrows()
    ]  # fmt: skip
    grown = growths(ws, launches, "are the chaotic ones chaotic for good?")
    found = found[COLUMNS].assign(growth_longer=np.nan)
    found.loc[slow.index, "growth_longer"] = [late - early for early, late in grown]
    return {"runs": found}


def growth_of(launch: Launch, times: Floats, tol: float, control: Control | None = None) -> Floats:
    """Return the logarithm of a difference's growth along a run, past its reversals."""
    batch = single_run(launch)[2]
    assert batch is not None
    end = np.array(times[-1:])
    batch = replace(batch, t_end=end, window=end / WINDOWS)
    found = integrate(batch, DOP853, FULL, tol=tol, record=PAST_REVERSALS, threads=1,
                      control=control).growth[0]  # fmt: skip
    t, grown = found[np.isfinite(found[:, 0])].T
    values: Floats = np.interp(times, t, grown)
    return values


def growths(
    ws: Workspace, runs: Sequence[tuple[Launch, Floats, float]], words: str
) -> list[Floats]:
    """Return :func:`growth_of` each of some runs."""
    calls = [partial(growth_of, *run) for run in runs]
    return side_by_side(calls, ws.threads or available_threads(), ws.reporting(words))


# The long runs, at two tolerances: only what does not depend on the tolerance is the body's own.
# On the way from reversal to reversal the pitch falls to a millionth of its size, and an error of
# the integrator there grows as any other difference.  The last tolerance is the one to trust.
TOLERANCES = (1e-11, 1e-13)
POINTS = 120
# The second half is cut into so many parts, whose scatter gives the error of the exponent.
PARTS = 10


def long_runs(ws: Workspace, tolerances: Sequence[float] = TOLERANCES) -> Tables:
    """Return the tables ``growth``, the running exponents, and ``exponents``, a row a run."""
    t_end = ws.sizes.exponents_t_end
    ends = np.linspace(t_end / 2, t_end, PARTS + 1)
    times = np.union1d(np.geomspace(t_end / 300, t_end, POINTS, endpoint=False), ends)
    late = np.searchsorted(times, ends)
    runs = [(Launch(body, N_I, OMEGA_XY0, t_end), times, tol)
            for body in BODIES for tol in tolerances]  # fmt: skip
    found = growths(ws, runs, "differences along the runs of Fig. 9")
    growth, rows = [], []
    for (run, _, tol), values in zip(runs, found, strict=True):
        key = {"theta": run.body.theta, "tol": tol}
        own = key | {"t": times, "growth": values, "exponent": values / times}
        growth.append(pd.DataFrame(own))
        rates = np.diff(values[late]) / (t_end / 2 / PARTS)
        rows.append(
            key | {"t_end": t_end, "exponent": rates.mean(),
                   "error": rates.std(ddof=1) / np.sqrt(PARTS),
                   "growth": values[late[-1]] - values[late[0]]}
        )  # fmt: skip
    return {"growth": pd.concat(growth, ignore_index=True), "exponents": pd.DataFrame(rows)}


def draw(tables: Tables) -> Drawing:
    """Draw the running exponents on logarithmic axes; the coarser tolerance is dashed."""
    values = tables["growth"]
    first, end, best = values["t"].min(), values["t"].max(), values["tol"].min()
    figure = new_figure(7.2, 4.4)
    axis = figure.add_subplot()
    for (theta, runs), letter, (colour, _) in zip(
        values.groupby("theta"), LETTERS, SERIES, strict=False
    ):
        for tol, own in runs.groupby("tol"):
            axis.plot(
                own["t"], own["exponent"].where(own["exponent"] > 0), color=colour,
                linewidth=1.6 if tol == best else 1.0,
                linestyle="-" if tol == best else DASHES,
                label=f"({letter}) {launch({'theta': theta}, 'theta')}" if tol == best else None,
            )  # fmt: skip
    t = np.geomspace(first, end, 50)
    axis.plot(t, np.log(t) / t, color="#777777", linewidth=1.0, linestyle=":",
              label=r"$\ln(t)/t$: growth like $t$")  # fmt: skip
    for tol in sorted(values["tol"].unique(), reverse=True):
        axis.plot([], [], color=GREY, linewidth=1.2, linestyle="-" if tol == best else DASHES,
                  label=f"tol {tol:g}")  # fmt: skip
    axis.set(xscale="log", yscale="log", xlabel=T_AXIS, xlim=(first, end))
    axis.set_ylabel(r"running Lyapunov exponent / $\tilde\omega$")
    axis.set_ylim(bottom=max(1e-7, 0.3 * values["exponent"][values["exponent"] > 0].min()))
    decade_ticks(axis.xaxis)
    frame(axis, grid="both")
    figure.legend(ncols=3, **ABOVE)
    return figure
