"""Fig. 5: times of reversal in the unsteady direction, and a spin that swings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pyarrow as pa
from pydantic import Field

from rattlesweep.paper.figures import times
from rattlesweep.paper.follow import F64, FORCE_CHANNELS, FORCES, column, follow, forces
from rattlesweep.paper.style import frame
from rattlesweep.paper.sweeps import part
from rattlesweep.physics.body import Rattleback
from rattlesweep.study.style import BLUE
from rattlesweep.sweeps.config.fields import Base
from rattlesweep.sweeps.tables.columns import RATE, TIME

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rattlesweep.paper.sweeps import Place, Report


class Fig5Settings(Base):
    """The run of part (b), of the body GH."""

    n_i: float = Field(gt=0, description="Initial spin, in sqrt(g/a).")
    omega_xy0: float = Field(gt=0, description="Initial oscillation, in sqrt(g/a).")
    t_end: float = Field(gt=0, description="Length, in sqrt(a/g).")


SPIN = pa.schema(
    [
        column("t", F64, "time", TIME),
        column("n", F64, "spin u . omega", RATE),
        column("omega_x", F64, "angular velocity, body's x", RATE),
    ]
)


def compute(place: Place, report: Report) -> dict[str, pa.Table]:
    """Data of the figure.

    Returns
    -------
    dict
        ``times``: one row a point of part (a), see :func:`rattlesweep.paper.figures.times.schema`;
        ``spin``, ``forces``: the run of part (b), in the sweep's integrator.
    """
    sweep, s = place.sweep("unsteady", part(report, 0.0, 0.0)), place.paper.fig5
    found, _ = follow(
        Rattleback.gh(), n_i=s.n_i, omega_xy0=s.omega_xy0, t_end=s.t_end,
        channels=("t", "n", "omega_x", *FORCE_CHANNELS), words=f"GH at n_i = {s.n_i:g}",
        report=part(report, 0.0, 0.5),
        integrator=place.paper.unsteady.integrator.model_dump(exclude_none=True),
    )  # fmt: skip
    press = forces(f"Fig. 5(b), n_i = {s.n_i:g}", found.table)
    return {
        "times": times.compute(sweep, "K_p", part(report, 0.5, 1.0)),
        "spin": pa.Table.from_pandas(found.table[SPIN.names], schema=SPIN, preserve_index=False),
        "forces": pa.Table.from_pylist([press], schema=FORCES),
    }


def draw(tables: Mapping[str, pa.Table]) -> Any:
    """Draw the figure; part (b) if there is a table ``spin``."""
    spin = tables.get("spin")

    def trace(axis: Any) -> None:
        assert spin is not None
        axis.plot(spin["t"].to_numpy(), spin["n"].to_numpy(), color=BLUE, linewidth=0.8)
        axis.axhline(0, color="#777777", linewidth=0.6)
        axis.set(xlabel=r"$t$ / $\tilde t$", ylabel=r"$n$ / $\tilde\omega$")
        axis.set_title(rf"(b) GH, $n_i = {spin['n'][0].as_py():g}$", fontsize=10, pad=4)
        frame(axis)

    return times.draw(tables["times"], "K_p", "t_{ru}", "t_{rGH+}", None if spin is None else trace)
