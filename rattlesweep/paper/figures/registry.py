"""What the command makes: each figure by its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rattlesweep.errors import ConfigError
from rattlesweep.paper.figures import fig2, fig3, fig4, fig5, fig6, fig7, fig8, fig8_lyapunov
from rattlesweep.sweeps.config.messages import not_one_of

if TYPE_CHECKING:
    import pyarrow as pa

    from rattlesweep.paper.settings import Paper
    from rattlesweep.paper.sweeps import Place, Report

    Tables = Mapping[str, pa.Table]

# The claims about formulas alone go by this name where figures are chosen.
THEORY = "theory"


@dataclass(frozen=True)
class Figure:
    """A figure of the paper.

    Attributes
    ----------
    title, caption : str
        For people.
    sections : tuple of str
        Of the settings; nothing else determines the data.
    compute : callable
        From the place and a report (fraction, words) to tables by name.
    draw : callable
        From the tables to a Matplotlib figure.
    cost : callable
        Seconds that it takes, roughly, on two cores of an EPYC server (Zen 5), without its sweep.
    sweep : str, optional
        Name of the sweep that it reads.
    """

    title: str
    caption: str
    sections: tuple[str, ...]
    compute: Callable[[Place, Report], Tables]
    draw: Callable[[Tables], Any]
    cost: Callable[[Paper], float]
    sweep: str | None = None


FIGURES: dict[str, Figure] = {
    "fig2": Figure(
        "Fig. 2: frequencies",
        "Cumulative distributions of the pitch and roll frequencies of random shell-dumbbell "
        "bodies, exact and to zeroth order in the skew angle. Inset: their ratio, with the paper's "
        "lower bound.",
        ("fig2",),
        lambda place, report: fig2.compute(place.paper.fig2, report),
        fig2.draw,
        lambda paper: 0.2 + paper.fig2.samples * 1.2e-6,
    ),
    "fig3": Figure(
        "Fig. 3: asymmetric torque coefficients",
        "(a) Cumulative distributions of K_p and K_r. (b) Relative frequency of pairs (K_p, K_r), "
        "over nine decades.",
        ("fig3",),
        lambda place, report: fig3.compute(place.paper.fig3, report, place.threads),
        fig3.draw,
        lambda paper: 0.5 + paper.fig3.density_samples * 4e-8,
    ),
    "fig4": Figure(
        "Fig. 4: the body GH in both directions",
        "Spin and angular velocities in (a) the unsteady and (b) the steady direction. Dashed: "
        "Garcia and Hubbard's solution; dotted: the first reversal. The four lower panels share a "
        "scale.",
        ("fig4",),
        fig4.compute,
        fig4.draw,
        lambda paper: 1.0,
    ),
    "fig5": Figure(
        "Fig. 5: time of reversal in the unsteady direction",
        "(a) Mean over the runs of each point; bars are one standard deviation of the runs, lines "
        "Garcia and Hubbard's formula at the mean n_0. (b) A run of GH.",
        ("unsteady", "fig5"),
        fig5.compute,
        fig5.draw,
        lambda paper: 0.2,
        sweep="unsteady",
    ),
    "fig6": Figure(
        "Fig. 6: types in the steady direction",
        "(a) Fractions of the types; bars are 95 % confidence intervals (Wilson). Filled "
        "triangles: fraction of the bodies whose Bondi threshold lies below the spin. (b) Examples "
        "from the sweep, chosen by the rules in fig6_examples.parquet, as far as there are any.",
        ("steady", "fig6"),
        fig6.compute,
        fig6.draw,
        lambda paper: 3.0 + _runs(paper, "steady") * 2.5e-4 + _rk4_runs(paper) * 0.012,
        sweep="steady",
    ),
    "fig7": Figure(
        "Fig. 7: time of reversal in the steady direction",
        "Mean over the runs of type R; bars are one standard deviation, lines Garcia and Hubbard's "
        "formula at the mean n_0.",
        ("steady", "fig7"),
        fig7.compute,
        fig7.draw,
        lambda paper: 0.5 + min(paper.fig7.closer, 0.12 * _runs(paper, "steady")) * 1.2e-3,
        sweep="steady",
    ),
    "fig8": Figure(
        "Fig. 8: three long runs",
        "Spin of GH with other curvatures theta, through many reversals. Dashed: the reduced model "
        "(Eqs. (47) [diff-ne-1] to (49) [diff-ne-3]), started with the same energy of the pitch "
        "and a little energy of the roll.",
        ("fig8",),
        fig8.compute,
        fig8.draw,
        lambda paper: 1.0 + paper.fig8.t_end * len(paper.fig8.theta) * 5e-5,
    ),
    "fig8_lyapunov": Figure(
        "Supplement to Fig. 8: Lyapunov exponents",
        "Running estimate of the largest Lyapunov exponent of the runs of Fig. 8, continued to "
        "longer times. A plateau means chaos; a decay along the dotted line means that differences "
        "grow no faster than linearly. Dashed: the same at a coarser tolerance.",
        ("fig8", "fig8_lyapunov"),
        fig8_lyapunov.compute,
        fig8_lyapunov.draw,
        lambda paper: 1.0 + paper.fig8_lyapunov.t_end * len(paper.fig8.theta) * 7e-6,
    ),
}
"""All of them, in the paper's order."""


def _runs(paper: Paper, sweep: str) -> int:
    config = getattr(paper, sweep)
    cases = len(config.bodies.target.values) * len(config.spin.n_i) * len(config.spin.omega_xy0)
    return int(config.bodies.samples * cases)


def _rk4_runs(paper: Paper) -> float:
    most = paper.fig6.rk4.samples / paper.steady.bodies.samples  # type: ignore[union-attr]
    return min(1.0, most) * _runs(paper, "steady")


def sweep_cost(paper: Paper, name: str) -> float:
    """Seconds that a sweep takes, roughly; as :attr:`Figure.cost`."""
    return 0.3 + _runs(paper, name) * {"unsteady": 3e-5, "steady": 2.2e-4}[name]


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
