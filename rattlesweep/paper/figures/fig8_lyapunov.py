"""Beside Fig. 8: which of its runs are chaotic, by the growth of a small difference.

Each run is followed far beyond the figure, at two tolerances.  Only what does not hang on the
tolerance is the body's own: on the way from reversal to reversal the pitch falls to a millionth of
its size, and what the integrator adds to it there is a difference like any other.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from pydantic import Field

from rattlesweep.integrate.follow.lyapunov import growth_along
from rattlesweep.paper.follow import F64, column
from rattlesweep.paper.style import MARKERS, decade_ticks, frame, new_figure
from rattlesweep.paper.workers import side_by_side
from rattlesweep.sweeps.blocks.single import Launch, single_run
from rattlesweep.sweeps.config.fields import Base, PositiveNumbers
from rattlesweep.sweeps.tables.columns import RATE, TIME

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rattlesweep.paper.sweeps import Place, Report

POINTS = 120
# The second half is cut into so many parts, whose scatter gives the error of the exponent.
PARTS = 10


class Fig8LyapunovSettings(Base):
    """How far and how closely differences are followed."""

    t_end: float = Field(ge=1000, description="Length, in sqrt(a/g).")
    tol: PositiveNumbers = Field(description="Tolerances of DOP853, the one to trust last.")

    def quick(self) -> Fig8LyapunovSettings:
        """An eighth of the length."""
        return self.model_copy(update={"t_end": max(1000.0, self.t_end / 8)})


GROWTH = pa.schema(
    [
        column("theta", F64, "curvature of the body"),
        column("tol", F64, "tolerance of the integration"),
        column("t", F64, "time", TIME),
        column("growth", F64, "logarithm of the growth of a small difference"),
        column("exponent", F64, "growth / t: running estimate of the largest exponent", RATE),
    ]
)
EXPONENTS = pa.schema(
    [
        column("theta", F64, "curvature of the body"),
        column("tol", F64, "tolerance of the integration"),
        column("t_end", F64, "time reached", TIME),
        column("exponent", F64, "largest Lyapunov exponent over the second half", RATE),
        column("error", F64, "its standard error, from ten parts of that half", RATE),
        column("growth", F64, "logarithm of the growth in the second half"),
    ]
)


def compute(place: Place, report: Report) -> dict[str, pa.Table]:
    """Data of the figure.

    Returns
    -------
    dict
        ``growth``: the running exponents; ``exponents``: one row a run and tolerance.
    """
    runs, own = place.paper.fig8, place.paper.fig8_lyapunov
    ends = np.linspace(own.t_end / 2, own.t_end, PARTS + 1)
    shown = np.geomspace(own.t_end / 300, own.t_end, POINTS, endpoint=False)
    times = np.union1d(shown, ends)
    late = np.searchsorted(times, ends)
    pairs, tasks = [], []
    for body in runs.bodies():
        _, _, batch = single_run(Launch(body, runs.n_i, runs.omega_xy0, own.t_end))
        assert batch is not None
        # Compiled here, and not in two threads at once.
        growth_along(batch.constants[0], batch.y0[0], [1.0])
        for tol in own.tol:
            pairs.append((body.theta, tol))
            tasks.append(partial(growth_along, batch.constants[0], batch.y0[0], times, tol=tol))
    words = "differences along the runs of Fig. 8"
    found = side_by_side(tasks, place.threads, lambda share: report(share, words))
    growth, exponents = [], []
    for (theta, tol), values in zip(pairs, found, strict=True):
        growth.append(
            pa.table(
                {"theta": np.full(len(times), theta), "tol": np.full(len(times), tol), "t": times,
                 "growth": values, "exponent": values / times},
                schema=GROWTH,
            )
        )  # fmt: skip
        rates = np.diff(values[late]) / (own.t_end / 2 / PARTS)
        exponents.append(
            {"theta": theta, "tol": tol, "t_end": own.t_end, "exponent": float(rates.mean()),
             "error": float(rates.std(ddof=1) / np.sqrt(PARTS)),
             "growth": float(values[late[-1]] - values[late[0]])}
        )  # fmt: skip
    return {
        "growth": pa.concat_tables(growth),
        "exponents": pa.Table.from_pylist(exponents, schema=EXPONENTS),
    }


def draw(tables: Mapping[str, pa.Table]) -> Any:
    """Running exponents on logarithmic axes; the coarser tolerances are dashed."""
    data = tables["growth"].to_pandas()
    thetas, tols = (list(dict.fromkeys(data[name])) for name in ("theta", "tol"))
    figure = new_figure(7.2, 4.4)
    axis = figure.add_subplot()
    for theta, letter, (colour, _) in zip(thetas, "abcdef", MARKERS, strict=False):
        for tol in tols:
            own = data[(data["theta"] == theta) & (data["tol"] == tol)]
            best = tol == tols[-1]
            axis.plot(
                own["t"], own["exponent"].where(own["exponent"] > 0), color=colour,
                linewidth=1.6 if best else 1.0, linestyle="-" if best else (0, (4, 2)),
                label=rf"({letter}) $\theta = {theta:g}$" if best else None,
            )  # fmt: skip
    end = data["t"].max()
    t = np.geomspace(data["t"].min(), end, 50)
    axis.plot(t, np.log(t) / t, color="#777777", linewidth=1.0, linestyle=":",
              label=r"$\ln(t)/t$: growth like $t$")  # fmt: skip
    for tol in tols:
        style = "-" if tol == tols[-1] else (0, (4, 2))
        axis.plot([], [], color="#555555", linewidth=1.2, linestyle=style, label=f"tol {tol:g}")
    axis.set(xscale="log", yscale="log", xlabel=r"$t$ / $\tilde t$")
    axis.set_ylabel(r"running Lyapunov exponent / $\tilde\omega$")
    axis.set_xlim(data["t"].min(), end)
    axis.set_ylim(bottom=max(1e-7, 0.3 * float(data["exponent"][data["exponent"] > 0].min())))
    decade_ticks(axis.xaxis)
    axis.grid(visible=True, which="major", color="#e3e3e3", linewidth=0.6)
    frame(axis)
    figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    return figure
