"""Single runs behind Figs. 4, 5(b), 6(b) and 8: followed, thinned for pictures, forces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.analysis.onerun.course import Course, Trajectory, collect
from rattlesweep.analysis.onerun.figure import thin
from rattlesweep.analysis.onerun.rows import Rows
from rattlesweep.errors import OutputError
from rattlesweep.paper.columns import number, schema, table, word
from rattlesweep.paper.workspace import Progress
from rattlesweep.sweeps.columns import FORCE, TIME
from rattlesweep.sweeps.single import Launch

# Of forces and spins, in sqrt(a/g): a hundredth of the period of a pitch.
DT = 0.05
FORCE_CHANNELS = ("F_normal", "F_tangential")
SPIN = schema("t n")
FORCES = schema(
    "",
    word("run", "which run"),
    number("t_end", "time reached", TIME),
    number("ratio_max", "largest F_perp / F_parallel while the body presses down"),
    number("ratio_t", "when", TIME),
    number("normal_min", "least F_parallel; the contact would open below 0", FORCE),
    number("normal_t", "when", TIME),
    number("slip_t", "first time at which F_perp / F_parallel is above 1", TIME),
    number("open_t", "first time at which F_parallel is not positive", TIME),
)


def follow(
    launch: Launch, channels: Sequence[str], words: str, progress: Progress, dt: float = DT
) -> tuple[Trajectory, Course]:
    """One run past its reversals with a row every ``dt``; ``words`` say what it is."""
    course = Course(
        launch, channels=channels, rows=Rows(dt=dt), watch=lambda share: progress(share, words)
    )
    found = collect(course)
    if found.status != "ok":
        raise OutputError(f"{words}: the run ended at t = {found.t_end:g} with {found.status}")
    return found, course


def forces(name: str, run: pd.DataFrame) -> dict[str, Any]:
    """Row of :data:`FORCES` of a run with the channels :data:`FORCE_CHANNELS`; NaN for never."""
    t, normal = run["t"], run["F_normal"]
    # Where the body would leave the plane, the ratio means nothing.
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


def thinned(run: pd.DataFrame, wanted: pa.Schema, bins: dict[str, int]) -> pa.Table:
    """Rows of a run that curves through some of its columns need: bins by column."""
    places = [thin(run[name].to_numpy(), number) for name, number in bins.items()]
    return table(run.iloc[np.unique(np.concatenate(places))], wanted)
