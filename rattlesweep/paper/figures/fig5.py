"""Fig. 5: the body GH in the unsteady and in the steady direction, up to its first reversals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing

from rattlesweep.analysis.style import BLUE, INK, VERMILION, new_figure
from rattlesweep.api import modes, reversal_time_gh
from rattlesweep.arrays import Floats
from rattlesweep.paper.figures.frames import ABOVE, DASHES, N_AXIS, T_AXIS, ZERO, frame, launch
from rattlesweep.paper.figures.single import FORCES, follow, forces, thinned
from rattlesweep.paper.workspace import Report, Tables
from rattlesweep.physics.body import Rattleback

OMEGA_XY0 = 0.01
# Spin, and length, which the paper does not name, of (a) and of (b).
ENDS = {"unsteady": (0.1, 200.0), "steady": (-0.1, 1500.0)}
TOL = 1e-12
BINS = 900
COMPONENTS = ("omega_x", "omega_y")


def data(report: Report) -> Tables:
    """Return the tables ``unsteady`` and ``steady`` (series), ``runs``, ``extrema``, ``forces``."""
    tables: dict[str, pd.DataFrame] = {}
    rows, presses, extrema = [], [], []
    body, found_modes = Rattleback.gh(), modes(Rattleback.gh())
    for k, (name, (n_i, t_end)) in enumerate(ENDS.items()):
        words = f"GH at n_i = {n_i:g}"
        found = follow(body, words, "n", "n_gh", *COMPONENTS, *FORCES, n_i=n_i,
                       omega_xy0=OMEGA_XY0, t_end=t_end, tol=TOL)  # fmt: skip
        relevant = float(found_modes.omega_p if n_i > 0 else found_modes.omega_r)
        period = 2 * np.pi / relevant
        t_r = found.zeros[0] if len(found.zeros) else np.nan
        row: dict[str, Any] = {
            "run": name, "n_i": n_i, "omega_xy0": OMEGA_XY0, "t_r": t_r,
            "zeros": len(found.zeros), "t_rgh": reversal_time_gh(body, n_i, OMEGA_XY0),
            "period": period, "omega_relevant": relevant,
        }  # fmt: skip
        for component in COMPONENTS:
            t, size = maxima(found.table["t"].to_numpy(), found.table[component].to_numpy())
            own = {"run": name, "component": component, "t": t, "amplitude": size}
            extrema.append(pd.DataFrame(own))
            row[f"frequency_{component[-1]}"] = frequency(t, t_r, 10 * period)
        main = COMPONENTS[0 if n_i > 0 else 1]
        largest = float(found.table[main].abs().max())
        row["frequency_free"] = free_frequency(largest, main, 20 * period)
        rows.append(row)
        presses.append(forces(f"Fig. 5, n_i = {n_i:g}", found.table))
        tables[name] = thinned(found.table, "n_gh", **dict.fromkeys(("n", *COMPONENTS), BINS))
        report((k + 1) / len(ENDS))
    return tables | {
        "runs": pd.DataFrame(rows),
        "extrema": pd.concat(extrema, ignore_index=True),
        "forces": pd.DataFrame(presses),
    }


def maxima(t: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return times and heights of the local maxima of a curve's modulus, by parabolas."""
    size = np.abs(values)
    k = 1 + np.flatnonzero((size[1:-1] >= size[:-2]) & (size[1:-1] > size[2:]))
    before, here, after = size[k - 1], size[k], size[k + 1]
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend
    return t[k] + shift * (t[1] - t[0]), here - 0.25 * (before - after) * shift


def frequency(extrema: Floats, middle: float, width: float) -> float:
    """Return the angular frequency by the mean distance of the extrema near a time, or NaN."""
    near = extrema[np.abs(extrema - middle) < width]
    return float(np.pi * (len(near) - 1) / (near[-1] - near[0])) if len(near) > 1 else np.nan


def free_frequency(size: float, main: str, length: float) -> float:
    """Return the frequency of a mode of GH alone, launched with this rate and nearly no spin."""
    found = follow(Rattleback.gh(), "a mode alone", main, n_i=1e-6, omega_xy0=size, tol=TOL,
                   psi="pitch" if main == "omega_x" else "roll", t_end=length, dt=0.01)  # fmt: skip
    t, _ = maxima(found.table["t"].to_numpy(), found.table[main].to_numpy())
    # Its first periods alone: the mode drives the spin, which then changes the frequency.
    return frequency(t, length / 8, length / 8)


def draw(tables: Tables) -> Drawing:
    """Draw (a) on the left, (b) on the right, the spin above the oscillations."""
    figure = new_figure(9.2, 6.0)
    axes = figure.subplots(3, 2, sharex="col")
    for k, (column, name) in enumerate(zip(axes.T, ENDS, strict=True)):
        _column(column, "ab"[k], tables["runs"].iloc[k], tables[name])
    # omega_x and omega_y share their scale, so that (a) and (b) can be compared.
    most = max(max(map(abs, axis.get_ylim())) for axis in axes[1:].ravel())
    for axis in axes[1:].ravel():
        axis.set_ylim(-most, most)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), ncols=3, **ABOVE)
    return figure


def _column(axes: Any, letter: str, run: pd.Series, series: pd.DataFrame) -> None:
    t, t_r = series["t"], run["t_r"]
    spin, *oscillations = axes
    spin.plot(t, series["n"], color=BLUE, linewidth=1.1, label="full dynamics")
    spin.plot(t, series["n_gh"], color=INK, linewidth=1.1, linestyle=DASHES,
              label=r"Garcia and Hubbard, $\overline{n}(t)$")  # fmt: skip
    spin.axhline(0, **ZERO)
    spin.set_ylabel(N_AXIS)
    for axis, name in zip(oscillations, COMPONENTS, strict=True):
        axis.plot(t, series[name], color=BLUE, linewidth=0.5)
        axis.set_ylabel(rf"$\omega_{name[-1]}$ / $\tilde\omega$")
    for k, axis in enumerate(axes, start=1):
        axis.axvline(t_r, color=VERMILION, linewidth=0.9, linestyle=":",
                     label="first reversal" if k == 1 else None)  # fmt: skip
        axis.set_xlim(0, t.iloc[-1])
        frame(axis, f"({letter}-{k})", loc="left")
    # Where the spin is not: after a reversal it is of the other sign.
    symbol = f"t_{{r{'u' if run['n_i'] > 0 else 's'}}}"
    spin.text(t_r + 0.02 * t.iloc[-1], 0.85 * run["n_i"], f"${symbol} = {t_r:.1f}$",
              color="#A33B00", fontsize=9.5, va="center")  # fmt: skip
    frame(spin, f"GH, {launch(run, 'n_i', 'omega_xy0')}")
    axes[-1].set_xlabel(T_AXIS)
