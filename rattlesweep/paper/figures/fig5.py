"""Fig. 5: times of reversal in the unsteady direction; (b): a spin that swings."""

from __future__ import annotations

from matplotlib.figure import Figure as Drawing

from rattlesweep.paper.columns import schema, table
from rattlesweep.paper.figures.follow import FORCE_CHANNELS, FORCES, follow, forces
from rattlesweep.paper.figures.style import N_AXIS, T_AXIS, ZERO, frame, launch
from rattlesweep.paper.figures.times import panels, times
from rattlesweep.paper.workspace import Progress, Tables, Workspace
from rattlesweep.physics.body import Rattleback
from rattlesweep.study.style import BLUE
from rattlesweep.sweeps.blocks.single import Launch

# Of (b); its length is not named in the paper.
N_I, OMEGA_XY0, T_END = 0.5, 0.01, 150.0
SPIN = schema("t n omega_x")


def data(ws: Workspace, progress: Progress) -> Tables:
    """Tables ``times`` of part (a); ``spin`` and ``forces`` of part (b), in the sweep's method."""
    sweep = ws.sweep("unsteady", progress)
    integrator = sweep.config.integrator.model_dump(exclude_none=True)
    gh = Launch(Rattleback.gh(), N_I, OMEGA_XY0, T_END, integrator=integrator)
    channels = ("t", "n", "omega_x", *FORCE_CHANNELS)
    found, _ = follow(gh, channels, f"GH at n_i = {N_I:g}", progress)
    return {
        "times": times(sweep),
        "spin": table(found.table, SPIN),
        "forces": table([forces(f"Fig. 5(b), n_i = {N_I:g}", found.table)], FORCES),
    }


def draw(tables: Tables) -> Drawing:
    """A panel a spin, and part (b) in the place that is left."""
    figure, used, (axis, *_) = panels(tables["times"], "K_p", "t_{ru}", "t_{rGH+}", above=True)
    frame(used[0], "(a)", loc="left")
    spin = tables["spin"].to_pandas()
    axis.axis("on")
    axis.plot(spin["t"], spin["n"], color=BLUE, linewidth=0.8)
    axis.axhline(0, **ZERO)
    axis.set(xlabel=T_AXIS, ylabel=N_AXIS)
    frame(axis, "(b) GH, " + launch({"n_i": spin["n"].iloc[0]}, "n_i"))
    return figure
