"""Single runs behind Figs. 5, 6(b), 7(b) and 9: integrated, thinned for pictures, their forces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from rattlesweep.analysis.onerun.course import Trajectory
from rattlesweep.analysis.style import thin
from rattlesweep.api import trajectory
from rattlesweep.errors import OutputError
from rattlesweep.physics.body import PARAMETERS, Rattleback

# Distance of the rows, in sqrt(a/g): a hundredth of the period of a pitch.
DT = 0.05
FORCES = ("F_normal", "F_tangential")


def follow(
    body: Rattleback, words: str, *channels: str, dt: float = DT, **launch: Any
) -> Trajectory:
    """Integrate one run past its reversals; raise OutputError, with the words, if it fails."""
    found = trajectory(body, channels=("t", *channels), dt=dt, **launch)
    if found.status != "ok":
        raise OutputError(f"{words}: the run ended at t = {found.t_end:g} with {found.status}")
    return found


def body_of(run: pd.Series) -> Rattleback:
    """Return the body of a run of a sweep."""
    return Rattleback(*(float(run[name]) for name in PARAMETERS))


def forces(name: str, run: pd.DataFrame) -> dict[str, Any]:
    """Return extremes of the contact force in a run with the channels :data:`FORCES`.

    Where the body would leave the plane, ``F_perp / F_parallel`` means nothing and is left out.
    Times are NaN for what never happens.
    """
    t, normal = run["t"], run["F_normal"]
    down = normal > 0
    ratio = (run["F_tangential"] / normal).where(down, 0.0)
    most, least = int(ratio.argmax()), int(normal.argmin())
    return {
        "run": name,
        "t_end": t.iloc[-1],
        "ratio_max": ratio.iloc[most],
        "ratio_t": t.iloc[most],
        "normal_min": normal.iloc[least],
        "normal_t": t.iloc[least],
        "slip_t": t[ratio > 1].min(),
        "open_t": t[~down].min(),
    }


def thinned(run: pd.DataFrame, *beside: str, **bins: int) -> pd.DataFrame:
    """Return ``t`` and some columns of a run at the rows that curves through them need.

    ``bins`` are numbers of stretches by column, of which each keeps its extremes; columns
    ``beside`` have no say in the choice of the rows.
    """
    places = [thin(run[name].to_numpy(), number) for name, number in bins.items()]
    rows = run.iloc[np.unique(np.concatenate(places))]
    return rows[["t", *beside, *bins]].reset_index(drop=True)
