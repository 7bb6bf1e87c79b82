"""What the command makes: each figure by its name, in the paper's order, and its kernels."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from typing import Any

from rattlesweep.errors import ConfigError
from rattlesweep.integrate.follow.kernels import aside_kernel, march_kernel
from rattlesweep.integrate.follow.lyapunov import example
from rattlesweep.integrate.lanes.build import kernel
from rattlesweep.integrate.loading import AT_ONCE, loaded
from rattlesweep.integrate.model import FULL, REDUCED, WITH_TANGENT
from rattlesweep.integrate.task import Control, Task, side_by_side
from rattlesweep.paper.figures import fig2, fig3, fig4, fig5, fig6, fig7, fig8, integrators
from rattlesweep.paper.figures import lyapunov as fig8_lyapunov
from rattlesweep.paper.workspace import Figure
from rattlesweep.sweeps.config.schema import SdRanges
from rattlesweep.sweeps.config.messages import not_one_of

# The claims about formulas alone go by this name where figures are chosen.
THEORY = "theory"
FIGURES: dict[str, Figure] = {
    "fig2": Figure(
        "Fig. 2: frequencies",
        "Cumulative distributions of the pitch and roll frequencies of random shell-dumbbell "
        "bodies, exact and to zeroth order in the skew angle. Inset: their ratio, with the paper's "
        "lower bound.",
        lambda ws, progress: fig2.distributions(ws.sizes.fig2_bodies, SdRanges(), progress),
        fig2.draw,
        seconds=(1.4, 0.3),
    ),
    "fig3": Figure(
        "Fig. 3: asymmetric torque coefficients",
        "(a) Cumulative distributions of K_p and K_r. (b) Relative frequency of pairs (K_p, K_r), "
        "over nine decades.",
        lambda ws, progress: fig3.distributions(
            ws.sizes.fig3_bodies, ws.sizes.fig3_density, SdRanges(), ws.threads, progress
        ),
        fig3.draw,
        seconds=(4.5, 0.6),
    ),
    "fig4": Figure(
        "Fig. 4: the body GH in both directions",
        "Spin and angular velocities in (a) the unsteady and (b) the steady direction. Dashed: "
        "Garcia and Hubbard's solution; dotted: the first reversal. The four lower panels share a "
        "scale.",
        lambda ws, progress: fig4.first_reversals(progress),
        fig4.draw,
        seconds=(1.0, 1.0),
    ),
    "fig5": Figure(
        "Fig. 5: time of reversal in the unsteady direction",
        "(a) Mean over the runs of each point; bars are one standard deviation of the runs, lines "
        "Garcia and Hubbard's formula at the mean n_0. (b) A run of GH.",
        fig5.data,
        fig5.draw,
        seconds=(0.2, 0.2),
        sweep="unsteady",
    ),
    "fig6": Figure(
        "Fig. 6: types in the steady direction",
        "(a) Fractions of the types; bars are 95 % confidence intervals (Wilson). Filled "
        "triangles: fraction of the bodies whose Bondi threshold lies below the spin. (b) Examples "
        "from the sweep, chosen by the rules in fig6_examples.parquet, as far as there are any.",
        fig6.data,
        fig6.draw,
        seconds=(47.0, 5.0),
        sweep="steady",
    ),
    "fig7": Figure(
        "Fig. 7: time of reversal in the steady direction",
        "Mean over the runs of type R; bars are one standard deviation, lines Garcia and Hubbard's "
        "formula at the mean n_0.",
        fig7.data,
        fig7.draw,
        seconds=(7.7, 1.0),
        sweep="steady",
    ),
    "fig8": Figure(
        "Fig. 8: three long runs",
        "Spin of GH with other curvatures theta, through many reversals. Dashed: the reduced model "
        "(Eqs. (47) [diff-ne-1] to (49) [diff-ne-3]), started with the same energy of the pitch "
        "and a little energy of the roll.",
        lambda ws, progress: fig8.long_runs(progress),
        fig8.draw,
        seconds=(4.0, 4.0),
    ),
    "fig8_lyapunov": Figure(
        "Supplement to Fig. 8: Lyapunov exponents",
        "Running estimate of the largest Lyapunov exponent of the runs of Fig. 8, continued to "
        "longer times. A plateau means chaos; a decay along the dotted line means that differences "
        "grow no faster than linearly. Dashed: the same at a coarser tolerance.",
        lambda ws, progress: fig8_lyapunov.beside_fig8(
            ws.sizes.fig8_lyapunov_t_end, ws.threads, progress
        ),
        fig8_lyapunov.draw,
        seconds=(11.5, 2.3),
    ),
}
# Seconds of the sweeps, as :attr:`Figure.seconds`.
SWEEPS = {"unsteady": (4.0, 0.5), "steady": (27.0, 1.1)}


def choose(names: str | None) -> list[str]:
    """Names that were asked for, such as ``fig7,fig6``, in the paper's order; by default all.

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


def needed(figures: Collection[str]) -> list[Callable[[Control], Any]]:
    """What loads the kernels of some figures, in the order in which they come to be needed."""
    tangent = WITH_TANGENT[FULL.name].name
    kernels: list[tuple[str, Callable[..., Any], str, str]] = [
        ("fig4 fig5 fig6 fig8", march_kernel, "dop853", FULL.name),
        ("fig4 fig5 fig6 fig8", aside_kernel, "dop853", FULL.name),
        ("fig5 fig6 fig7", kernel, "dop853", FULL.name),
        ("fig6", kernel, "dop853", tangent),
        ("fig6", kernel, integrators.PAPERS["method"], FULL.name),
        ("fig8", march_kernel, "dop853", REDUCED.name),
        ("fig8", aside_kernel, "dop853", REDUCED.name),
        ("fig8_lyapunov", partial(loaded, example), "dop853", tangent),
    ]

    def load(make: Callable[..., Any], method: str, model: str, _: Control) -> None:
        make(method, model)

    return [
        partial(load, make, method, model)
        for users, make, method, model in kernels
        if {*users.split()} & {*figures}
    ]


def compile_ahead(figures: Collection[str]) -> None:
    """Begin to load the kernels of some figures, in threads of their own.

    Who needs one meanwhile waits for it: each is compiled once.
    """
    if calls := needed(figures):
        Task(lambda _: side_by_side(calls, AT_ONCE))
