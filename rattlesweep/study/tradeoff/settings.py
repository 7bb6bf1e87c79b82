"""What the trade is measured with: methods and their settings, models, and how many runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rattlesweep.integrate.tableau import METHODS
from rattlesweep.study.tradeoff.scalar_rk4 import DT

if TYPE_CHECKING:
    from collections.abc import Mapping

DEFAULT: dict[str, Any] = {
    "name": "tradeoff",
    "seed": 2017,
    "bodies": {"source": "sd"},
    "spin": {
        "n_i": [-0.1, -0.2, -0.3, -0.4, -0.5, 0.1, 0.2, 0.3, 0.4, 0.5],
        "omega_xy0": [0.001, 0.01, 0.1],
    },
    "horizon": {"t_rgh": 5, "t": 1e5},
}
"""The config of the command without one; also in ``configs/tradeoff.yaml``."""

TOLERANCES: dict[str, tuple[float, ...]] = {
    "dopri5": (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9),
    "dop853": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12),
    "verner98": (1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12),
}
# A method without a list here.
OTHER_TOLERANCES = (1e-6, 1e-8, 1e-10, 1e-12)
STEPS = (0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
REDUCED_TOL = 1e-9


@dataclass(frozen=True)
class Scope:
    """How much is measured.

    Attributes
    ----------
    least : int
        Runs to draw.
    rounds : int
        Measurements of each cost.
    horizon : float
        Where runs are cut for the cost, in ``sqrt(a/g)``.
    stages : float
        Evaluations of the right-hand side to spend on the errors of one setting; what takes more
        has its errors from a part of the runs.
    scalar_stages, cost_stages : float
        The same for scalar RK4, and for one measurement of a cost.
    confirm : float
        Time that the independent integrator may integrate in all.
    """

    least: int = 2000
    rounds: int = 3
    horizon: float = 1000.0
    stages: float = 6e8
    scalar_stages: float = 1e8
    cost_stages: float = 5e7
    confirm: float = 4000.0


FULL = Scope()
QUICK = Scope(300, 2, 500.0, 1e8, 2e7, 1e7, 400.0)


@dataclass(frozen=True)
class Setting:
    """A model, a method and its setting."""

    model: str
    method: str
    name: str = ""
    value: float = float("nan")

    @property
    def integrator(self) -> Mapping[str, Any]:
        """As in a config."""
        return {"method": self.method, self.name: self.value}

    @property
    def stages(self) -> int:
        """Evaluations of the right-hand side in a step."""
        tableau = METHODS["rk4" if self.method == "plain" else self.method]
        return tableau.stages


def settings() -> list[Setting]:
    """All that is measured; a method of a new tableau is among them by itself."""
    found = [Setting("full", "plain", "dt", DT)]
    for name, tableau in sorted(METHODS.items(), key=lambda item: item[1].order):
        if tableau.adaptive:
            values = TOLERANCES.get(name, OTHER_TOLERANCES)
            found += [Setting("full", name, "tol", value) for value in values]
        else:
            found += [Setting("full", name, "dt", value) for value in STEPS]
    return [*found, Setting("reduced", "dop853", "tol", REDUCED_TOL), Setting("gh", "none", "none")]
