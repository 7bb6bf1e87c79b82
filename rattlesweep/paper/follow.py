"""Single runs behind Figs. 4, 5(b), 6(b) and 8: followed, thinned for pictures, forces."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.errors import OutputError
from rattlesweep.study.onerun.course import Course, Trajectory, collect
from rattlesweep.study.onerun.rows import Rows
from rattlesweep.sweeps.blocks.single import Launch
from rattlesweep.sweeps.tables.columns import RATE, TIME

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd
    from numpy.typing import NDArray

    from rattlesweep.paper.sweeps import Report
    from rattlesweep.physics.body import Rattleback

    Floats = NDArray[np.float64]

# Of forces and spins, in sqrt(a/g): a hundredth of the period of a pitch.
DT = 0.05
FORCE_CHANNELS = ("F_normal", "F_tangential")


def column(name: str, kind: pa.DataType, words: str, unit: str = "1") -> pa.Field:
    """A field of a table with its unit and a description."""
    return pa.field(name, kind, metadata={"unit": unit, "description": words})


F64, I64, TEXT = pa.float64(), pa.int64(), pa.string()
SPIN = pa.schema([column("t", F64, "time", TIME), column("n", F64, "spin u . omega", RATE)])
FORCES = pa.schema(
    [
        column("run", TEXT, "which run"),
        column("t_end", F64, "time reached", TIME),
        column("ratio_max", F64, "largest F_perp / F_parallel while the body presses down"),
        column("ratio_t", F64, "when", TIME),
        column("normal_min", F64, "least F_parallel; the contact would open below 0", "M g"),
        column("normal_t", F64, "when", TIME),
        column("slip_t", F64, "first time at which F_perp / F_parallel is above 1", TIME),
        column("open_t", F64, "first time at which F_parallel is not positive", TIME),
    ]
)


def follow(
    body: Rattleback,
    *,
    n_i: float,
    omega_xy0: float,
    t_end: float,
    channels: Sequence[str],
    report: Report,
    words: str,
    dt: float = DT,
    **others: Any,
) -> tuple[Trajectory, Course]:
    """One run, past its reversals.

    Parameters
    ----------
    body, n_i, omega_xy0, t_end, others
        As for :class:`rattlesweep.sweeps.blocks.single.Launch`.
    channels : sequence of str
        As for :class:`rattlesweep.study.onerun.course.Course`.
    dt : float
        Distance of two rows, in ``sqrt(a/g)``.
    report : callable
        Called with the share done and ``words``.

    Raises
    ------
    OutputError
        If the integration fails.
    """
    launch = Launch(body, n_i, omega_xy0, t_end, **others)
    course = Course(
        launch, channels=channels, rows=Rows(dt=dt), watch=lambda share: report(share, words)
    )
    found = collect(course)
    if found.status != "ok":
        raise OutputError(f"{words}: the run ended at t = {found.t_end:g} with {found.status}")
    return found, course


def forces(name: str, table: pd.DataFrame) -> dict[str, Any]:
    """Row of :data:`FORCES` of a run with the channels :data:`FORCE_CHANNELS`."""
    t, normal = table["t"].to_numpy(), table["F_normal"].to_numpy()
    # Where the body would leave the plane, the ratio means nothing.
    down = normal > 0
    ratio = np.divide(table["F_tangential"], normal, out=np.zeros(len(t)), where=down)
    most, least = int(np.argmax(ratio)), int(np.argmin(normal))
    return {
        "run": name,
        "t_end": float(t[-1]),
        "ratio_max": float(ratio[most]),
        "ratio_t": float(t[most]),
        "normal_min": float(normal[least]),
        "normal_t": float(t[least]),
        "slip_t": _first(t, down & (ratio > 1)),
        "open_t": _first(t, ~down),
    }


def _first(t: Floats, happens: NDArray[np.bool_]) -> float | None:
    return float(t[np.argmax(happens)]) if happens.any() else None


def thin(values: Floats, bins: int) -> NDArray[np.int64]:
    """Places of the least and the largest value of each of so many stretches, in order.

    A curve through them covers on paper what the whole one does, if a stretch is no wider than a
    line.  The ends are among them.
    """
    count = len(values)
    if count <= 2 * bins:
        return np.arange(count)
    edges = np.linspace(0, count, bins + 1).astype(np.int64)
    places = [0, count - 1]
    for first, last in pairwise(edges):
        part = values[first:last]
        places += [first + int(part.argmin()), first + int(part.argmax())]
    return np.unique(places)


def spin_table(trajectory: Trajectory, bins: int) -> pa.Table:
    """Times and spins, thinned."""
    t, n = (trajectory.table[name].to_numpy() for name in ("t", "n"))
    chosen = thin(n, bins)
    return pa.table({"t": t[chosen], "n": n[chosen]}, schema=SPIN)
