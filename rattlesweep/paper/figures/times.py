"""Figs. 5(a) and 7: times of reversal against the torque coefficient, beside Garcia and Hubbard's.

One row a point: mean, deviation and scatter of the runs that reverse, and the theory's line, "using
the mean values of n_0".
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.paper.style import MARKERS, decade_ticks, frame, new_figure
from rattlesweep.sweeps.tables.arrow import build_table
from rattlesweep.sweeps.tables.columns import RATE, TIME

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    from rattlesweep.paper.sweeps import Report, Sweep

Z95 = 1.959964
COLUMNS = ("n_i", "omega_xy0", "n_0", "t_rgh", "t_r", "type")


def _field(name: str, unit: str, words: str, *, nullable: bool = True) -> pa.Field:
    metadata = {"unit": unit, "description": words}
    return pa.field(name, pa.float64(), nullable=nullable, metadata=metadata)


def schema(coefficient: str) -> pa.Schema:
    """Columns of the table; ``coefficient`` is ``K_p`` or ``K_r``."""
    count = {"unit": "1", "description": "runs with status ok"}
    reversed_ = {"unit": "1", "description": "of them, runs that reverse (type R)"}
    return pa.schema(
        [
            _field(coefficient, "1", "target of the torque coefficient", nullable=False),
            _field("n_i", RATE, "initial spin", nullable=False),
            _field("omega_xy0", RATE, "initial rate of the oscillation", nullable=False),
            pa.field("runs", pa.int64(), nullable=False, metadata=count),
            pa.field("reversed", pa.int64(), nullable=False, metadata=reversed_),
            _field("t_r_mean", TIME, "mean time of reversal"),
            _field("t_r_std", TIME, "its sample standard deviation over the runs"),
            _field("t_r_low", TIME, "95 % confidence interval of the mean (normal), lower end"),
            _field("t_r_high", TIME, "the same, upper end"),
            _field("t_r_median", TIME, "median time of reversal"),
            _field("n_0_mean", RATE, "mean over all runs of the spin that would hold all energy"),
            _field("t_rgh_line", TIME, "Garcia and Hubbard's time at the mean n_0"),
            _field("ratio_mean", "1", "mean over the runs of t_r / t_rGH of the same run"),
            _field("ratio_std", "1", "its sample standard deviation"),
        ]
    )


def compute(sweep: Sweep, coefficient: str, report: Report) -> pa.Table:
    """One row a case of a sweep with a target of ``coefficient``."""
    rows = []
    total = len(sweep.plan.cases)
    for case, runs in sweep.cases(COLUMNS):
        assert case.target is not None
        assert case.n_i is not None
        report((case.index + 1) / total, "means and deviations")
        point = {coefficient: case.target, "n_i": case.n_i, "omega_xy0": case.omega_xy0}
        rows.append({**point, **_row(runs, case.target, case.n_i)})
    wanted = schema(coefficient)
    columns = {
        f.name: np.array([row[f.name] for row in rows], dtype=f.type.to_pandas_dtype())
        for f in wanted
    }
    return build_table(columns, wanted)


def _row(runs: pd.DataFrame, coefficient: float, n_i: float) -> dict[str, float]:
    back = runs[runs["type"] == "R"]
    t_r = back["t_r"].to_numpy(dtype=float)
    ratio = t_r / back["t_rgh"].to_numpy(dtype=float)
    n_0 = float(runs["n_0"].mean())
    mean, std = _mean(t_r), _std(t_r)
    half = Z95 * std / np.sqrt(len(t_r)) if len(t_r) else np.nan
    return {
        "runs": len(runs),
        "reversed": len(back),
        "t_r_mean": mean,
        "t_r_std": std,
        "t_r_low": mean - half,
        "t_r_high": mean + half,
        "t_r_median": float(np.median(t_r)) if len(t_r) else np.nan,
        "n_0_mean": n_0,
        "t_rgh_line": gh_line(coefficient, n_i, n_0),
        "ratio_mean": _mean(ratio),
        "ratio_std": _std(ratio),
    }


def gh_line(coefficient: float, n_i: float, n_0: float) -> float:
    """Garcia and Hubbard's reversal time from ``n_0`` (Eqs. (56) [trgh-p] and (58) [trgh-m]).

    Twice artanh(n_i/n_0): the logarithm's argument loses no more digits than the mean of n_0 has.
    """
    return 2 * float(np.arctanh(abs(n_i) / n_0)) / (n_0 * coefficient)


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean()) if len(values) else np.nan


def _std(values: NDArray[np.float64]) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else np.nan


# ---------------------------------------------------------------------------- the picture


def draw(table: pa.Table, coefficient: str, time: str, theory: str, traces: Any = None) -> Any:
    """One panel a spin, three oscillations each, with the theory's lines.

    Parameters
    ----------
    table : pyarrow.Table
        Of :func:`compute`.
    coefficient : str
        ``K_p`` or ``K_r``.
    time, theory : str
        Symbols of the time and of the theory's, as mathematics.
    traces : callable, optional
        Draws into the axes that are left over, and into those alone.
    """
    data = table.to_pandas()
    spins = sorted(data["n_i"].unique(), key=abs)
    columns = 3
    rows = -(-(len(spins) + 1) // columns)
    figure = new_figure(9.2, 2.9 * rows + 0.35)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    low, high = _limits(data)
    symbol = coefficient.replace("_", "_{") + "}"
    for axis, spin in zip(axes, spins, strict=False):
        _panel(axis, data[data["n_i"] == spin], coefficient)
        axis.set(xscale="log", yscale="log", ylim=(low, high))
        axis.set_xlim(data[coefficient].min() / 1.35, data[coefficient].max() * 1.35)
        decade_ticks(axis.xaxis)
        axis.set_title(rf"$n_i = {spin:g}$", fontsize=10, pad=4)
        axis.set_xlabel(rf"${symbol}$")
        axis.grid(visible=True, which="major", color="#e3e3e3", linewidth=0.6)
        frame(axis)
    for place in range(0, len(spins), columns):
        axes[place].set_ylabel(rf"${time}$ / $\tilde t$")
    marks = {label: handle for handle, label in zip(*axes[0].get_legend_handles_labels(),
                                                    strict=True)}  # fmt: skip
    line = marks.pop("theory")
    spare = axes[len(spins) :]
    for axis in spare:
        axis.axis("off")
    if traces is not None:
        axes[0].set_title("(a)", loc="left", fontsize=10, pad=4)
        spare[0].axis("on")
        traces(spare[0])
    words = [*marks, rf"${theory}$ at the mean $n_0$"]
    if traces is None and len(spare):
        spare[-1].legend([*marks.values(), line], words, loc="center", frameon=False,
                         labelspacing=0.9)  # fmt: skip
    else:
        figure.legend(
            [*marks.values(), line], words, loc="outside upper center", ncols=len(words),
            frameon=False, fontsize=9.5,
        )  # fmt: skip
    return figure


def _limits(frame: pd.DataFrame) -> tuple[float, float]:
    means = frame[["t_r_mean", "t_rgh_line"]].to_numpy()
    if np.isnan(means).all():
        return 0.1, 1.0
    return float(np.nanmin(means)) / 2.5, float(np.nanmax(means)) * 2.5


def _panel(axis: Any, rows: pd.DataFrame, coefficient: str) -> None:
    for size, (colour, shape) in zip(sorted(rows["omega_xy0"].unique()), MARKERS, strict=False):
        own = rows[rows["omega_xy0"] == size].sort_values(coefficient)
        axis.plot(
            own[coefficient], own["t_rgh_line"], color=colour, linewidth=1.1, zorder=2,
            label="_theory",
        )  # fmt: skip
        mean, std = own["t_r_mean"].to_numpy(), own["t_r_std"].to_numpy()
        # On a logarithmic axis a bar that reaches zero has no lower end.
        down = np.minimum(std, 0.999 * mean)
        axis.errorbar(
            own[coefficient], mean, yerr=[down, std], color=colour, marker=shape, markersize=5,
            markerfacecolor="white", markeredgewidth=1.2, linestyle="none", elinewidth=0.9,
            capsize=2.2, zorder=3, label=rf"$|\omega_{{xy0}}| = {size:g}$",
        )  # fmt: skip
    axis.plot([], [], color="#555555", linewidth=1.1, label="theory")
