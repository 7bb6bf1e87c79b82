"""Fig. 7: times of reversal in the steady direction, for the runs that reverse."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rattlesweep.paper.figures import onset, times
from rattlesweep.paper.sweeps import part

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pyarrow as pa

    from rattlesweep.paper.sweeps import Place, Report


def compute(place: Place, report: Report) -> dict[str, pa.Table]:
    """Data of the figure, and what its claims need.

    Returns
    -------
    dict
        ``times``: one row a point, see :func:`rattlesweep.paper.figures.times.schema`. ``late``,
        ``onset``: see :mod:`rattlesweep.paper.figures.onset`.
    """
    sweep = place.sweep("steady", part(report, 0.0, 0.1))
    return {
        "times": times.compute(sweep, "K_r", part(report, 0.1, 0.15)),
        **onset.compute(place, sweep, part(report, 0.15, 1.0)),
    }


def draw(tables: Mapping[str, pa.Table]) -> Any:
    """Draw the figure."""
    return times.draw(tables["times"], "K_r", "t_{rs}", "t_{rGH-}")
