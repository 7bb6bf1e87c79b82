"""Beside Fig. 8: Lyapunov exponents of its runs, followed far beyond the figure.

At two tolerances: only what does not hang on the tolerance is the body's own.  On the way from
reversal to reversal the pitch falls to a millionth of its size, and what the integrator adds to it
there is a difference like any other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure as Drawing

from rattlesweep.analysis.style import GREY, SERIES, new_figure
from rattlesweep.paper.columns import number, schema, table
from rattlesweep.paper.figures.chaos import growths
from rattlesweep.paper.figures.fig8 import BODIES, LETTERS, N_I, OMEGA_XY0
from rattlesweep.paper.figures.style import ABOVE, DASHES, T_AXIS, decade_ticks, frame, launch
from rattlesweep.paper.workspace import Progress, Tables
from rattlesweep.sweeps.columns import RATE
from rattlesweep.sweeps.single import Launch

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
) -> Tables:
    """Tables ``growth``, the running exponents, and ``exponents``, a row a run and tolerance."""
    ends = np.linspace(t_end / 2, t_end, PARTS + 1)
    times = np.union1d(np.geomspace(t_end / 300, t_end, POINTS, endpoint=False), ends)
    late = np.searchsorted(times, ends)
    runs = [(Launch(body, N_I, OMEGA_XY0, t_end), times, tol)
            for body in BODIES for tol in tolerances]  # fmt: skip
    found = growths(runs, threads, progress, "differences along the runs of Fig. 8")
    growth, exponents = [], []
    for (run, _, tol), values in zip(runs, found, strict=True):
        key = {"theta": run.body.theta, "tol": tol}
        own = key | {"t": times, "growth": values, "exponent": values / times}
        growth.append(table(own, GROWTH))
        rates = np.diff(values[late]) / (t_end / 2 / PARTS)
        exponents.append(
            key | {"t_end": t_end, "exponent": rates.mean(),
                   "error": rates.std(ddof=1) / np.sqrt(PARTS),
                   "growth": values[late[-1]] - values[late[0]]}
        )  # fmt: skip
    return {"growth": pa.concat_tables(growth), "exponents": table(exponents, EXPONENTS)}


def draw(tables: Tables) -> Drawing:
    """Running exponents on logarithmic axes; the coarser tolerances are dashed."""
    values = tables["growth"].to_pandas()
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
