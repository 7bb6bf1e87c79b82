"""Settings that are compared, the runs they are compared on, and a call that solves the runs."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from rattlesweep.analysis.tradeoff.scalar_rk4 import DT, scalar_rk4
from rattlesweep.arrays import Flags, Floats, Integers, Places, take
from rattlesweep.integrate.batch import Batch
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import columns_of, load_kernel, run_batch
from rattlesweep.sweeps.config.read import override_config, resolved
from rattlesweep.sweeps.config.schema import Config, SdSource
from rattlesweep.sweeps.error import Estimated
from rattlesweep.sweeps.launches import Launches, full_batch, prepare, reduced_batch
from rattlesweep.sweeps.plan import make_plan

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
# For a method without a list here.
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
        """The part of a config."""
        if self.method == "none":
            return {}
        value = {"t_r": self.value} if self.name == "accuracy" else self.value
        return {"method": self.method, self.name: value}

    @property
    def stages(self) -> int:
        """Evaluations of the right-hand side in a step."""
        return METHODS["rk4" if self.method == "plain" else self.method].stages


# Two methods that must agree.
REFERENCES = tuple(Setting("full", method, "tol", 1e-13) for method in ("verner98", "dop853"))
PLAIN = Setting("full", "plain", "dt", DT)
REDUCED = Setting("reduced", "dop853", "tol", 1e-9)
CLOSED_FORM = Setting("gh", "none")
GOAL = Setting("full", "dop853", "accuracy", 1e-6)


def settings(methods: Collection[str]) -> list[Setting]:
    """Return the settings of some methods, by their order."""
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
    references: tuple[Setting, ...] = REFERENCES
    least: int = 2000  # runs to draw
    rounds: int = 3  # measurements of each cost
    horizon: float = 1000.0  # where runs are cut for the cost, in sqrt(a/g)
    # Evaluations of the right-hand side to spend on the errors of one setting, which come from a
    # part of the runs where all would take more; a fifth of it on scalar RK4, a tenth on one cost.
    stages: float = 6e8


FULL = Scope((PLAIN, *settings(METHODS), GOAL, REDUCED, CLOSED_FORM))
# A quick study needs no kernel but those of the references.
QUICK = Scope(
    (PLAIN, *settings([s.method for s in REFERENCES]), GOAL, CLOSED_FORM),
    least=300, rounds=2, horizon=500.0, stages=1e8,
)  # fmt: skip


@dataclass(frozen=True)
class Solution:
    """What a setting makes of some runs; arrays over runs, times in ``sqrt(a/g)``."""

    t_r: Floats  # first zero of the spin; NaN without one
    t_end: Floats  # time reached
    types: Integers  # places in TYPES; -1 where not ok, -2 where a method knows no types
    ok: Flags  # whether the status is ok
    n_end: Floats  # spin at t_end
    drift: Floats  # relative change of energy
    tries: float  # steps tried in all, accepted or not
    t_r_error: Floats  # estimate of the error of t_r; NaN where there is none


@dataclass(frozen=True)
class Runs:
    """Runs of a config, ready for every model."""

    config: Config
    launches: Launches

    def __len__(self) -> int:
        return len(self.launches.n_i)

    @cached_property
    def bounded(self) -> Places:
        """Places of the runs that have a horizon to be integrated to."""
        t_end = self.launches.t_end
        return np.flatnonzero(np.isfinite(t_end) & (t_end > 0))

    @cached_property
    def _batches(self) -> dict[str, Batch]:
        return {"full": full_batch(self.launches), "reduced": reduced_batch(self.launches)}

    def batch(self, setting: Setting, index: Places) -> Batch | None:
        """Return some of the runs as the model takes them; None: it is a formula."""
        return None if setting.model == "gh" else take(self._batches[setting.model], index)

    def load(self, setting: Setting) -> None:
        """Load the kernel, compiled if need be."""
        if setting.method == "plain":
            scalar_rk4(take(self._batches["full"], np.empty(0, np.intp)))
        else:
            load_kernel(self._config(setting))

    def solve(
        self, setting: Setting, index: Places, batch: Batch | None = None, *, threads: int = 1
    ) -> Solution:
        """Solve some of the runs by a setting; `batch` is theirs, with the horizons wanted."""
        batch = self.batch(setting, index) if batch is None else batch
        nothing = np.full(len(index), np.nan)
        if setting.method == "plain" and batch is not None:
            # It sees no oscillation and so knows no types.
            t_r = scalar_rk4(batch)
            t_end = np.where(np.isnan(t_r), batch.t_end, t_r)
            ok, tries = np.ones(len(batch), dtype=bool), float(t_end.sum()) / setting.value
            return Solution(t_r, t_end, np.full(len(batch), -2), ok, nothing, nothing, tries,
                            nothing)  # fmt: skip
        config, outcome = self._config(setting), None
        if batch is not None:
            work = batch
            # In a thread of its own, so that Ctrl-C is heard.
            outcome = Task(
                lambda control: run_batch(config, work, threads=threads, control=control)
            ).wait()
        columns = columns_of(config, take(self.launches, index), batch, outcome)
        ok = columns["status"][0] == Status.OK
        tries = 0.0
        if isinstance(outcome, Estimated):
            tries = float(outcome.tries.sum())
        elif outcome is not None:
            tries = float((outcome.n_steps + outcome.n_rejected).sum())
        return Solution(
            t_r=np.where(ok, columns["t_r"], np.nan),
            t_end=columns["t_end"],
            types=columns["type"][0],
            ok=ok,
            n_end=columns["n_end"],
            drift=nothing if outcome is None else np.abs(outcome.energy_drift),
            tries=tries,
            t_r_error=columns.get("t_r_error", nothing),
        )

    def _config(self, setting: Setting) -> Config:
        integrator = type(self.config.integrator).model_validate(setting.integrator)
        record = ["error"] if integrator.goal is not None else []
        return self.config.model_copy(
            update={"model": setting.model, "integrator": integrator, "record": record}
        )


def draw(config: Config, base: Path | None, *, samples: int | None, least: int) -> Runs:
    """Draw runs from a config, whose model, integrator and records play no part.

    There are `samples` runs of each case, or so many that there are `least` runs, or all. `base` is
    where a table's relative path is looked up besides the working directory.
    """
    data: dict[str, Any] = resolved(config) | {"record": [], "model": "full"}
    config = override_config(data, ["integrator={method: dop853}"])
    plan = make_plan(config, base)
    wanted = samples or -(-least // len(plan.cases))
    if isinstance(config.bodies, SdSource):
        config = override_config(resolved(config), [f"bodies.samples={wanted}"])
        plan = make_plan(config, base)
    count = min(wanted, plan.samples)
    picks = np.unique(np.linspace(0, plan.samples - 1, count).round().astype(np.int64))
    case = np.repeat(np.arange(len(plan.cases)), len(picks))
    return Runs(config, prepare(plan, case, np.tile(picks, len(plan.cases))))
