"""What the command makes: each figure by its name, in the paper's order, and the supplements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure as Drawing

from rattlesweep.errors import ConfigError
from rattlesweep.paper.figures import (
    chaos,
    fig3,
    fig4,
    fig5,
    fig6,
    fig7,
    fig8,
    fig9,
    friction,
    rk4,
    volume,
)
from rattlesweep.paper.workspace import Tables, Workspace
from rattlesweep.sweeps.config.messages import not_one_of
from rattlesweep.sweeps.config.schema import SdRanges

# The claims about formulas alone go by this name where parts are chosen.
THEORY = "theory"


@dataclass(frozen=True)
class Part:
    """A figure of the paper, or a supplement to one: words for people, its data, its picture."""

    title: str
    caption: str
    data: Callable[[Workspace], Tables]
    draw: Callable[[Tables], Drawing] | None = None


PARTS: dict[str, Part] = {
    "fig3": Part(
        "Fig. 3: frequencies",
        "Cumulative distributions of the pitch and roll frequencies of random shell-dumbbell "
        "bodies, exact and to zeroth order in the skew angle. Inset: their ratio, with the paper's "
        "lower bound.",
        lambda ws: fig3.data(ws.sizes.fig3_bodies, SdRanges(), ws.reporting("bodies of Fig. 3")),
        fig3.draw,
    ),
    "fig4": Part(
        "Fig. 4: asymmetric torque coefficients",
        "(a) Cumulative distributions of K_p and K_r. (b) Relative frequency of pairs (K_p, K_r), "
        "over nine decades.",
        lambda ws: fig4.data(
            ws.sizes.fig4_bodies, ws.sizes.fig4_density, SdRanges(), ws.threads,
            ws.reporting("bodies of Fig. 4"),
        ),
        fig4.draw,
    ),
    "fig5": Part(
        "Fig. 5: the body GH in both directions",
        "Spin and angular velocities in (a) the unsteady and (b) the steady direction. Dashed: "
        "Garcia and Hubbard's solution; dotted: the first reversal. The four lower panels share a "
        "scale.",
        lambda ws: fig5.data(ws.reporting("runs of Fig. 5")),
        fig5.draw,
    ),
    "fig6": Part(
        "Fig. 6: time of reversal in the unsteady direction",
        "(a) Mean over the runs of each point; bars are one standard deviation of the runs, lines "
        "Garcia and Hubbard's formula at the mean n_0. (b) A run of GH.",
        fig6.data,
        fig6.draw,
    ),
    "fig7": Part(
        "Fig. 7: types in the steady direction",
        "(a) Fractions of the types; bars are 95 % confidence intervals (Wilson). Filled "
        "triangles: fraction of the bodies whose Bondi threshold lies below the spin. (b) Examples "
        "from the sweep, listed in fig7_examples.parquet, as far as there are any.",
        fig7.data,
        fig7.draw,
    ),
    "fig7_chaos": Part("Supplement to Fig. 7: which wobbling runs are chaotic", "", chaos.wobbling),
    "fig7_rk4": Part("Supplement to Fig. 7: the paper's integrator", "", rk4.data),
    "fig8": Part(
        "Fig. 8: time of reversal in the steady direction",
        "Mean over the runs of type R; bars are one standard deviation, lines Garcia and Hubbard's "
        "formula at the mean n_0.",
        fig8.data,
        fig8.draw,
    ),
    "fig8_windows": Part("Supplement to Fig. 8: late reversals, wobbling", "", fig8.windows),
    "fig9": Part(
        "Fig. 9: three long runs",
        "Spin of GH with other curvatures theta, through many reversals. Dashed: the reduced model "
        "(Eqs. (47) [diff-ne-1] to (49) [diff-ne-3]), started with the same energy of the pitch "
        "and a little energy of the roll.",
        lambda ws: fig9.data(ws.reporting("runs of Fig. 9")),
        fig9.draw,
    ),
    "fig9_volume": Part(
        "Supplement to Fig. 9: phase volume",
        "Natural logarithm of the phase volume that moves along with each run of Fig. 9; "
        "Liouville's theorem would keep it at zero.",
        lambda ws: volume.data(ws.reporting("phase volume along the runs of Fig. 9")),
        volume.draw,
    ),
    "fig9_lyapunov": Part(
        "Supplement to Fig. 9: Lyapunov exponents",
        "Running estimate of the largest Lyapunov exponent of the runs of Fig. 9, continued to "
        "longer times. A plateau means chaos; a decay along the dotted line means that differences "
        "grow no faster than linearly. Dashed: the same at a coarser tolerance.",
        chaos.long_runs,
        chaos.draw,
    ),
    "friction": Part(
        "Supplement: reversals under friction",
        "Bodies of SD spun both ways at abs(n_i) = 0.3 with a push of 0.01, under a torque of "
        "friction -sigma omega, until at most 0.2 % of the energy is left. Bars are 95 % "
        "confidence intervals (Wilson).",
        friction.data,
        friction.draw,
    ),
}  # fmt: skip


def choose(names: str | None) -> list[str]:
    """Return the parts that were asked for, such as ``fig8,fig7``, in the paper's order, or all.

    Raises
    ------
    ConfigError
        If a name is unknown.
    """
    known = [*PARTS, THEORY]
    if names is None:
        return known
    wanted = [word.strip() for word in names.split(",") if word.strip()]
    unknown = [word for word in wanted if word not in known]
    if unknown or not wanted:
        raise ConfigError(f"--only: {not_one_of(unknown[0] if unknown else '', known)}")
    return [name for name in known if name in wanted]
