"""What the figures share: single runs, thinned for pictures; frames, ticks and symbols."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from rattlesweep.analysis.style import FAINT, thin
from rattlesweep.api import trajectory
from rattlesweep.api.single import Trajectory
from rattlesweep.errors import OutputError
from rattlesweep.physics.body import Rattleback

# Distance of the rows of single runs, in sqrt(a/g): a hundredth of the period of a pitch.
DT = 0.05

T_AXIS, N_AXIS = r"$t$ / $\tilde t$", r"$n$ / $\tilde\omega$"
DASHES: Any = (0, (4, 2))
ZERO: dict[str, Any] = {"color": "#777777", "linewidth": 0.6, "zorder": 1}
# Place and look of a legend above all panels.
ABOVE: dict[str, Any] = {"loc": "outside upper center", "frameon": False, "fontsize": 9.5}


def follow(body: Rattleback, *channels: str, dt: float = DT, **launch: Any) -> Trajectory:
    """Integrate one run past its reversals; raise OutputError if it fails."""
    found = trajectory(body, channels=("t", *channels), dt=dt, **launch)
    if found.status != "ok":
        raise OutputError(f"{body}: the run ended at t = {found.t_end:g} with {found.status}")
    return found


def thinned(run: pd.DataFrame, *beside: str, **bins: int) -> pd.DataFrame:
    """Return ``t`` and some columns of a run at the rows that curves through them need."""
    places = [thin(run[name].to_numpy(), number) for name, number in bins.items()]
    rows = run.iloc[np.unique(np.concatenate(places))]
    return rows[["t", *beside, *bins]].reset_index(drop=True)


def frame(axes: Axes, title: str = "", *, loc: str = "center", grid: str = "") -> None:
    """Draw a thin frame with ticks inward; a title, and a grid of x, y or both."""
    axes.set_axisbelow(True)
    axes.tick_params(which="both", direction="in", top=True, right=True, width=0.6, labelsize=9)
    for side in axes.spines.values():
        side.set_linewidth(0.7)
    if title:
        # At a fixed height: to avoid what is at the top takes a sixth of the drawing's time.
        axes.set_title(title, loc=loc, fontsize=10, pad=4, y=1.0)  # type: ignore[arg-type]
    if grid:
        axes.grid(visible=True, which="major", axis=grid, color=FAINT, linewidth=0.6)  # type: ignore[arg-type]


def decade_ticks(axis: Any) -> None:
    """Label decades only: on a short logarithmic axis the minor labels run into each other."""
    axis.set_major_locator(LogLocator(base=10))
    axis.set_minor_formatter(NullFormatter())


def launch(run: Any, *names: str) -> str:
    """Return values of a run as a formula, such as ``n_i = 0.1, |omega_xy0| = 0.01``."""
    symbols = {"n_i": "n_i", "omega_xy0": r"|\omega_{xy0}|", "K_r": "K_r", "theta": r"\theta"}
    return ", ".join(f"${symbols[name]} = {run[name]:g}$" for name in names)
