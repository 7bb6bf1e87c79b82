"""What the command makes: each figure by its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import pyarrow as pa
from matplotlib.figure import Figure as Drawing

from rattlesweep.errors import ConfigError
from rattlesweep.paper.data import chaos
from rattlesweep.paper.data import fig2 as data2
from rattlesweep.paper.data import fig3 as data3
from rattlesweep.paper.data import fig4 as data4
from rattlesweep.paper.data import fig5 as data5
from rattlesweep.paper.data import fig6 as data6
from rattlesweep.paper.data import fig7 as data7
from rattlesweep.paper.data import fig8 as data8
from rattlesweep.paper.data.progress import Progress
from rattlesweep.paper.figures import fig2, fig3, fig4, fig6, fig8, times
from rattlesweep.paper.workspace import Workspace
from rattlesweep.sweeps.config.messages import not_one_of

# The claims about formulas alone go by this name where figures are chosen.
THEORY = "theory"


@dataclass(frozen=True)
class Figure:
    """A figure of the paper.

    Attributes
    ----------
    title, caption : str
        For people.
    data : callable
        Makes its tables, by name.
    draw : callable
        From the tables to a Matplotlib figure.
    seconds : tuple of float
        That the tables take, roughly, at full size and with ``--quick``, on two cores of an EPYC
        server (Zen 5), without the sweep.
    sweep : str, optional
        Name of the sweep that it reads.
    """

    title: str
    caption: str
    data: Callable[[Workspace, Progress], Mapping[str, pa.Table]]
    draw: Callable[[Mapping[str, pa.Table]], Drawing]
    seconds: tuple[float, float]
    sweep: str | None = None


# Seconds of the sweeps, as :attr:`Figure.seconds`.
SWEEPS = {"unsteady": (4.0, 0.5), "steady": (27.0, 1.1)}
FIGURES: dict[str, Figure] = {
    "fig2": Figure(
        "Fig. 2: frequencies",
        "Cumulative distributions of the pitch and roll frequencies of random shell-dumbbell "
        "bodies, exact and to zeroth order in the skew angle. Inset: their ratio, with the paper's "
        "lower bound.",
        lambda ws, progress: data2.data(ws.sizes.fig2_bodies, progress),
        fig2.draw,
        (1.4, 0.3),
    ),
    "fig3": Figure(
        "Fig. 3: asymmetric torque coefficients",
        "(a) Cumulative distributions of K_p and K_r. (b) Relative frequency of pairs (K_p, K_r), "
        "over nine decades.",
        lambda ws, progress: data3.data(
            ws.sizes.fig3_bodies, ws.sizes.fig3_density, progress, threads=ws.threads
        ),
        fig3.draw,
        (4.5, 0.6),
    ),
    "fig4": Figure(
        "Fig. 4: the body GH in both directions",
        "Spin and angular velocities in (a) the unsteady and (b) the steady direction. Dashed: "
        "Garcia and Hubbard's solution; dotted: the first reversal. The four lower panels share a "
        "scale.",
        lambda ws, progress: data4.data(progress),
        fig4.draw,
        (1.0, 1.0),
    ),
    "fig5": Figure(
        "Fig. 5: time of reversal in the unsteady direction",
        "(a) Mean over the runs of each point; bars are one standard deviation of the runs, lines "
        "Garcia and Hubbard's formula at the mean n_0. (b) A run of GH.",
        lambda ws, progress: data5.data(ws.sweep("unsteady", progress), progress),
        times.fig5,
        (0.2, 0.2),
        sweep="unsteady",
    ),
    "fig6": Figure(
        "Fig. 6: types in the steady direction",
        "(a) Fractions of the types; bars are 95 % confidence intervals (Wilson). Filled "
        "triangles: fraction of the bodies whose Bondi threshold lies below the spin. (b) Examples "
        "from the sweep, chosen by the rules in fig6_examples.parquet, as far as there are any.",
        data6.data,
        fig6.draw,
        (47.0, 5.0),
        sweep="steady",
    ),
    "fig7": Figure(
        "Fig. 7: time of reversal in the steady direction",
        "Mean over the runs of type R; bars are one standard deviation, lines Garcia and Hubbard's "
        "formula at the mean n_0.",
        data7.data,
        times.fig7,
        (7.7, 1.0),
        sweep="steady",
    ),
    "fig8": Figure(
        "Fig. 8: three long runs",
        "Spin of GH with other curvatures theta, through many reversals. Dashed: the reduced model "
        "(Eqs. (47) [diff-ne-1] to (49) [diff-ne-3]), started with the same energy of the pitch "
        "and a little energy of the roll.",
        lambda ws, progress: data8.data(progress),
        fig8.draw,
        (4.0, 4.0),
    ),
    "fig8_lyapunov": Figure(
        "Supplement to Fig. 8: Lyapunov exponents",
        "Running estimate of the largest Lyapunov exponent of the runs of Fig. 8, continued to "
        "longer times. A plateau means chaos; a decay along the dotted line means that differences "
        "grow no faster than linearly. Dashed: the same at a coarser tolerance.",
        lambda ws, progress: chaos.beside_fig8(ws.sizes.fig8_lyapunov_t_end, ws.threads, progress),
        fig8.lyapunov,
        (11.5, 2.3),
    ),
}
"""All of them, in the paper's order."""


def choose(names: str | None) -> list[str]:
    """Names that were asked for, in the paper's order, ``theory`` last; all without a word.

    Parameters
    ----------
    names
        Separated by commas, such as ``fig6,fig7``.

    Raises
    ------
    ConfigError
        A name is unknown.
    """
    known = [*FIGURES, THEORY]
    if names is None:
        return known
    wanted = [word.strip() for word in names.split(",") if word.strip()]
    unknown = [word for word in wanted if word not in known]
    if unknown or not wanted:
        raise ConfigError(f"--only: {not_one_of(unknown[0] if unknown else '', known)}")
    return [name for name in known if name in wanted]
