"""What the trade is measured with: methods and their settings, models, and how many runs."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from rattlesweep.integrate.tableau import METHODS
from rattlesweep.analysis.tradeoff.scalar_rk4 import DT

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


@dataclass(frozen=True)
class Setting:
    """A model, a method and its setting."""

    model: str
    method: str
    name: str = "none"
    value: float = float("nan")

    @property
    def integrator(self) -> dict[str, Any]:
        """As in a config."""
        if self.method == "none":
            return {}
        value = {"t_r": self.value} if self.name == "accuracy" else self.value
        return {"method": self.method, self.name: value}

    @property
    def stages(self) -> int:
        """Evaluations of the right-hand side in a step."""
        return METHODS["rk4" if self.method == "plain" else self.method].stages


# Two methods that are to agree; a quick study needs no kernel but theirs.
REFERENCES = tuple(Setting("full", method, "tol", 1e-13) for method in ("verner98", "dop853"))
PLAIN = Setting("full", "plain", "dt", DT)
REDUCED = Setting("reduced", "dop853", "tol", 1e-9)
CLOSED_FORM = Setting("gh", "none")
PROMISE = Setting("full", "dop853", "accuracy", 1e-6)


def settings(methods: Collection[str]) -> list[Setting]:
    """Those of some methods, by their order; a new method has a list without one of its own."""
    found = []
    for name in sorted(methods, key=lambda name: METHODS[name].order):
        key = "tol" if METHODS[name].adaptive else "dt"
        values = TOLERANCES.get(name, OTHER_TOLERANCES) if key == "tol" else STEPS
        found += [Setting("full", name, key, value) for value in values]
    return found


@dataclass(frozen=True)
class Scope:
    """How much is measured."""

    settings: tuple[Setting, ...]  # in the order of the table
    references: tuple[Setting, ...] = REFERENCES  # two, which are to agree
    least: int = 2000  # runs to draw
    rounds: int = 3  # measurements of each cost
    horizon: float = 1000.0  # where runs are cut for the cost, in sqrt(a/g)
    # Evaluations of the right-hand side to spend on the errors of one setting, which come from a
    # part of the runs where all would take more; on those of scalar RK4; on one cost.
    stages: float = 6e8
    scalar_stages: float = 1e8
    cost_stages: float = 5e7
    confirm: float = 4000.0  # time that the independent integrator may integrate in all


FULL = Scope((PLAIN, *settings(METHODS), PROMISE, REDUCED, CLOSED_FORM))
QUICK = Scope(
    (PLAIN, *settings([s.method for s in REFERENCES]), PROMISE, CLOSED_FORM),
    least=300, rounds=2, horizon=500.0, stages=1e8, scalar_stages=2e7, cost_stages=1e7,
    confirm=400.0,
)  # fmt: skip
