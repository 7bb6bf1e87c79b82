"""Fig. 5: times of reversal in the unsteady direction, and a spin that swings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rattlesweep.study.paper import times
from rattlesweep.study.paper.style import frame

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pyarrow as pa

    from rattlesweep.study.paper.sweeps import Place, Report


def compute(place: Place, report: Report) -> dict[str, pa.Table]:
    """Data of the figure.

    Returns
    -------
    dict
        ``times``: one row a point of part (a), see :func:`rattlesweep.study.paper.times.schema`.
    """
    return {"times": times.compute(place.sweep("unsteady", report), "K_p", report)}


def draw(tables: Mapping[str, pa.Table]) -> Any:
    """Draw the figure; part (b) if there is a table ``spin`` with columns ``t`` and ``n``."""
    spin = tables.get("spin")

    def trace(axis: Any) -> None:
        assert spin is not None
        axis.plot(spin["t"].to_numpy(), spin["n"].to_numpy(), color="#0072B2", linewidth=0.8)
        axis.axhline(0, color="#777777", linewidth=0.6)
        axis.set(xlabel=r"$t$ / $\tilde t$", ylabel=r"$n$ / $\tilde\omega$")
        axis.set_title(r"(b) GH, $n_i = 0.5$, $|\omega_{xy0}| = 0.01$", fontsize=10, pad=4)
        frame(axis)

    return times.draw(tables["times"], "K_p", "t_{ru}", "t_{rGH+}", None if spin is None else trace)
