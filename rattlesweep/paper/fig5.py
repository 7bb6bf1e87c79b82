"""Fig. 5: the body GH in the unsteady and in the steady direction, up to its first reversals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.ndimage import maximum_filter1d

from rattlesweep.analysis.style import BLUE, INK, VERMILION, new_figure
from rattlesweep.api import modes, reversal_time_gh
from rattlesweep.paper.frames import (
    ABOVE,
    DASHES,
    DT,
    N_AXIS,
    T_AXIS,
    ZERO,
    follow,
    frame,
    launch,
    thinned,
)
from rattlesweep.paper.workspace import Tables, Workspace
from rattlesweep.physics.body import Rattleback

OMEGA_XY0, TOL = 0.01, 1e-12
# Spin, and length, which the paper does not name, of (a) and of (b).
ENDS = {"unsteady": (0.1, 200.0), "steady": (-0.1, 1500.0)}
COMPONENTS = ("omega_x", "omega_y")
BINS = 900


def data(_: Workspace) -> Tables:
    """Return the tables ``unsteady`` and ``steady`` (series), ``runs`` and ``envelopes``."""
    body = Rattleback.gh()
    tables: dict[str, pd.DataFrame] = {}
    runs, envelopes = [], []
    for name, (n_i, t_end) in ENDS.items():
        found = follow(body, "n", "n_gh", *COMPONENTS, n_i=n_i, omega_xy0=OMEGA_XY0,
                       t_end=t_end, tol=TOL)  # fmt: skip
        omega = float(getattr(modes(body), "omega_p" if n_i > 0 else "omega_r"))
        period, t_r = 2 * np.pi / omega, float(found.zeros[0])
        row: dict[str, Any] = {
            "run": name, "n_i": n_i, "omega_xy0": OMEGA_XY0, "t_r": t_r, "period": period,
            "zeros": len(found.zeros), "t_rgh": reversal_time_gh(body, n_i, OMEGA_XY0),
        }  # fmt: skip
        for component in COMPONENTS:
            key = {"run": name, "component": component}
            envelopes.append(key | envelope(found.table, component, t_r, period))
            ratio = frequency(found.table, component, t_r, 10 * period) / omega
            row[f"frequency_{component[-1]}"] = ratio
        runs.append(row)
        tables[name] = thinned(found.table, "n_gh", **dict.fromkeys(("n", *COMPONENTS), BINS))
    return tables | {"runs": pd.DataFrame(runs), "envelopes": pd.DataFrame(envelopes)}


def envelope(run: pd.DataFrame, component: str, t_r: float, period: float) -> dict[str, float]:
    """Return extremes of the amplitude, the largest modulus within a period, and their times."""
    t = run["t"].to_numpy()
    size = maximum_filter1d(run[component].abs().to_numpy(), round(period / DT))
    left = int(np.argmax(np.where(t < t_r, size, -1)))
    right = int(np.argmax(np.where(t >= t_r, size, -1)))
    # The least amplitude lasts as long as the filter is wide: its middle.
    between = size[left : right + 1]
    low = left + int(np.median(np.flatnonzero(between == between.min())))
    top = int(run[component].abs().argmax())
    places = {"top": top, "left": left, "right": right, "low": low}
    values = {name: float(size[place]) for name, place in places.items()}
    return values | {f"{name}_t": float(t[place]) for name, place in places.items()}


def frequency(run: pd.DataFrame, component: str, middle: float, width: float) -> float:
    """Return the angular frequency by the zeros of a rate near a time."""
    near = run[(run["t"] - middle).abs() < width]
    t, values = near["t"].to_numpy(), near[component].to_numpy()
    at = np.flatnonzero(values[1:] * values[:-1] < 0)
    zeros = t[at] - values[at] * DT / (values[at + 1] - values[at])
    return float(np.pi * (len(zeros) - 1) / (zeros[-1] - zeros[0]))


def draw(tables: Tables) -> Figure:
    """Draw (a) on the left, (b) on the right, the spin above the oscillations."""
    figure = new_figure(9.2, 6.0)
    axes = figure.subplots(3, 2, sharex="col")
    for k, (column, name) in enumerate(zip(axes.T, ENDS, strict=True)):
        draw_run(column, "ab"[k], tables["runs"].iloc[k], tables[name])
    # omega_x and omega_y share their scale, so that (a) and (b) can be compared.
    most = max(max(map(abs, axis.get_ylim())) for axis in axes[1:].ravel())
    for axis in axes[1:].ravel():
        axis.set_ylim(-most, most)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), ncols=3, **ABOVE)
    return figure


def draw_run(axes: Any, letter: str, run: pd.Series, series: pd.DataFrame) -> None:
    """Draw one run in a column of panels."""
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
