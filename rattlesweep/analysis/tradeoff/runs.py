"""The runs on which methods are compared, and one call that solves them by any setting."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers, Places, take
from rattlesweep.integrate.batch import Batch
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.task import Task
from rattlesweep.analysis.tradeoff.scalar_rk4 import scalar_rk4
from rattlesweep.analysis.tradeoff.settings import Setting
from rattlesweep.sweeps.block import columns_of, load_kernel, run_batch
from rattlesweep.sweeps.error import Estimated
from rattlesweep.sweeps.launches import Launches, full_batch, prepare, reduced_batch
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.config.schema import SdSource
from rattlesweep.sweeps.config.read import override_config, resolved
from rattlesweep.sweeps.config.schema import Config


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
    t_r_error: Floats  # what the runs say of the error of t_r; NaN where they say nothing


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
        """Some of the runs as the model takes them; None: it is a formula."""
        return None if setting.model == "gh" else take(self._batches[setting.model], index)

    def load(self, setting: Setting) -> None:
        """Load the kernel, compiled if need be."""
        if setting.method == "plain":
            scalar_rk4(take(self._batches["full"], np.empty(0, np.intp)))
        else:
            load_kernel(self._config(setting))

    def solve(
        self,
        setting: Setting,
        index: Places,
        batch: Batch | None = None,
        *,
        threads: int = 1,
    ) -> Solution:
        """Some of the runs by a setting; `batch` is theirs, with the horizons that are wanted.

        The kernel works in a thread of its own, so that Ctrl-C is heard.
        """
        batch = self.batch(setting, index) if batch is None else batch
        if setting.method == "plain" and batch is not None:
            return _plain(batch, setting.value)
        config, outcome = self._config(setting), None
        if batch is not None:
            work = batch
            outcome = Task(
                lambda control: run_batch(config, work, threads=threads, control=control)
            ).wait()
        columns = columns_of(config, take(self.launches, index), batch, outcome)
        ok = columns["status"][0] == Status.OK
        nothing = np.full(len(index), np.nan)
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


def _plain(batch: Batch, dt: float) -> Solution:
    """By scalar RK4, which sees no oscillation and so knows no types."""
    t_r, nothing = scalar_rk4(batch), np.full(len(batch), np.nan)
    t_end = np.where(np.isnan(t_r), batch.t_end, t_r)
    types, ok = np.full(len(batch), -2), np.ones(len(batch), dtype=bool)
    return Solution(t_r, t_end, types, ok, nothing, nothing, float(t_end.sum()) / dt, nothing)


def draw(config: Config, base: Path | None, *, samples: int | None, least: int) -> Runs:
    """Draw runs from a config, whose model, integrator and records play no part.

    ``base`` is where a table's relative path is looked up besides the working directory.  There are
    ``samples`` runs of each case, or so many that there are ``least`` runs, or all.
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
