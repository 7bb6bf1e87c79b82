"""Fig. 9: three long runs, through many reversals, with the reduced model beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing
from scipy.ndimage import uniform_filter1d

from rattlesweep.analysis.style import BLUE, VERMILION, new_figure
from rattlesweep.api import modes
from rattlesweep.arrays import Floats
from rattlesweep.paper.figures.frames import ABOVE, DASHES, N_AXIS, T_AXIS, ZERO, frame, launch
from rattlesweep.paper.figures.single import FORCES, follow, forces, thinned
from rattlesweep.paper.workspace import Report, Tables
from rattlesweep.physics import reduced
from rattlesweep.physics.body import Rattleback

BODIES = [replace(Rattleback.gh(), theta=theta) for theta in (0.6429, 0.82, 0.9)]
LETTERS = "abc"
N_I, OMEGA_XY0 = 0.1, 0.01
# Energy of the roll with which the reduced model begins; its E_p is the launch's.
E_R0 = 3e-5
# Not named in the paper.
T_END = 20_000.0
# At 1e-9 the reversals of the first run come up to 7 % early; 1e-13, Verner's method at 1e-12 and
# RK4 with the paper's step agree to 0.1 on all of them.
TOL, REDUCED_TOL = 1e-13, 1e-12
BINS = 1100
# Zeros of the spin closer to each other than so many periods of the roll are one reversal.
ONE_REVERSAL = 5


def data(report: Report, *, t_end: float = T_END, tol: float = TOL) -> Tables:
    """Return the tables of the three runs.

    ``spin``: the series as drawn; ``reversals``: one row a reversal of either model;
    ``invariants``: what is conserved, one row a run and model; ``forces``.
    """
    tables: dict[str, list[Any]] = {
        name: [] for name in ("spin", "reversals", "invariants", "forces")
    }
    channels = ("n", "n_reduced", "E_p", "E_r", "energy_drift", *FORCES)
    for k, body in enumerate(BODIES):
        words = f"GH with theta = {body.theta:g}"
        same: dict[str, Any] = {"n_i": N_I, "omega_xy0": OMEGA_XY0, "t_end": t_end, "e_r0": E_R0}
        found = follow(body, words, *channels, tol=tol, **same)
        simple = follow(body, words, "n", "energy_drift", "C_I", model="reduced",
                        tol=REDUCED_TOL, dt=1.0, **same)  # fmt: skip
        table, c_i = found.table, simple.table["C_I"].to_numpy()
        starts, casimir = reversals_of_full(table, found.zeros, body)
        of_reduced = [
            {"t": t, "t_last": t, "zeros": 1, "casimir": np.interp(t, simple.table["t"], c_i)}
            for t in simple.zeros
        ]
        for model, rows, series, values in (
            ("full", starts, table, casimir),
            ("reduced", of_reduced, simple.table, c_i),
        ):
            key = {"theta": body.theta, "model": model}
            tables["reversals"] += [key | row for row in rows]
            tables["invariants"].append(
                key | {"energy_drift": series["energy_drift"].abs().max(),
                       "casimir_low": values.min(), "casimir_high": values.max()}
            )  # fmt: skip
        tables["forces"].append(forces(f"Fig. 9, theta = {body.theta:g}", table))
        shown = thinned(table, n=BINS, n_reduced=BINS // 2)
        tables["spin"].append(shown.assign(theta=body.theta))
        report((k + 1) / len(BODIES))
    return {
        name: pd.concat(rows, ignore_index=True) if name == "spin" else pd.DataFrame(rows)
        for name, rows in tables.items()
    }


def reversals_of_full(
    table: pd.DataFrame, zeros: Sequence[float] | Floats, body: Rattleback
) -> tuple[list[dict[str, Any]], Floats]:
    """Return the reversals of a run, and its C_I from the first one on."""
    found = modes(body)
    period = 2 * np.pi / float(found.omega_r)
    t = table["t"].to_numpy()
    casimir = averaged_casimir(table, float(found.K_p), float(found.K_r), period)
    groups = reversals(zeros, ONE_REVERSAL * period)
    rows = [
        {
            "t": own[0],
            "t_last": own[-1],
            "zeros": len(own),
            "casimir": np.interp(own[0], t, casimir),
        }
        for own in groups
    ]
    # Half a period at the end has no whole average.
    inside = (t >= (groups[0][0] if groups else 0.0)) & (t <= t[-1] - period / 2)
    return rows, casimir[inside]


def averaged_casimir(table: pd.DataFrame, K_p: float, K_r: float, period: float) -> Floats:
    """Return C_I (Eq. (51) [casimir]) of the energies averaged over a period of the roll."""
    t = table["t"].to_numpy()
    width = max(1, round(period / (t[1] - t[0])))
    pitch, roll = (
        uniform_filter1d(table[name].to_numpy(), width, mode="nearest") for name in ("E_p", "E_r")
    )
    values: Floats = reduced.casimir(pitch, roll, K_p, K_r)
    return values


def reversals(zeros: Sequence[float] | Floats, gap: float) -> list[Floats]:
    """Return zeros of the spin in groups that are farther than ``gap`` from each other."""
    times = np.asarray(zeros, dtype=float)
    if not times.size:
        return []
    return list(np.split(times, 1 + np.flatnonzero(np.diff(times) > gap)))


def draw(tables: Tables) -> Drawing:
    """Draw a panel for each run."""
    return panels(tables["spin"], N_AXIS, n=("full dynamics", BLUE, "-", 0.8),
                  n_reduced=("reduced model", VERMILION, DASHES, 1.2))  # fmt: skip


def panels(series: pd.DataFrame, label: str, **curves: tuple[str, str, Any, float]) -> Drawing:
    """Draw columns of the series of the three runs, each with its words, colour, style, width."""
    runs = list(series.groupby("theta"))
    figure = new_figure(8.2, 1.9 * len(runs) + 0.7)
    axes = figure.subplots(len(runs), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axis, (theta, own), letter in zip(axes, runs, LETTERS, strict=True):
        for name, (words, colour, style, width) in curves.items():
            axis.plot(own["t"], own[name], color=colour, linewidth=width, linestyle=style,
                      label=words)  # fmt: skip
        axis.axhline(0, **ZERO)
        axis.set_ylabel(label)
        axis.set_xlim(0, own["t"].max())
        frame(axis, f"({letter}) {launch({'theta': theta}, 'theta')}", loc="left")
    axes[-1].set_xlabel(T_AXIS)
    if len(curves) > 1:
        figure.legend(*axes[0].get_legend_handles_labels(), ncols=2, **ABOVE)
    return figure
