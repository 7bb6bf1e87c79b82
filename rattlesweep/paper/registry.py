"""What the command makes: each figure by its name, in the paper's order."""

from __future__ import annotations

from rattlesweep.errors import ConfigError
from rattlesweep.paper.figures import fig2, fig3, fig4, fig5, fig6, fig7, fig8, lyapunov
from rattlesweep.paper.workspace import Figure
from rattlesweep.sweeps.config.messages import not_one_of

# The claims about formulas alone go by this name where figures are chosen.
THEORY = "theory"
FIGURES: dict[str, Figure] = {
    "fig2": fig2.FIGURE,
    "fig3": fig3.FIGURE,
    "fig4": fig4.FIGURE,
    "fig5": fig5.FIGURE,
    "fig6": fig6.FIGURE,
    "fig7": fig7.FIGURE,
    "fig8": fig8.FIGURE,
    "fig8_lyapunov": lyapunov.FIGURE,
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
