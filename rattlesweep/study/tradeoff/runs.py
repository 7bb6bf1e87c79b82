"""The runs on which methods are compared, and one call that integrates them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.status import Status
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.blocks.block import run_batch
from rattlesweep.sweeps.cases.launches import full_batch, prepare, reduced_batch
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.config.bodies import SdSource
from rattlesweep.sweeps.config.load import override_config, resolved
from rattlesweep.sweeps.tables.types import classify

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from rattlesweep.integrate.batch import Batch
    from rattlesweep.sweeps.cases.launches import Launches
    from rattlesweep.sweeps.config.schema import Config

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Solution:
    """What an integration comes to; arrays over runs.

    Attributes
    ----------
    t_r, t_end : ndarray
        First zero of the spin (NaN without one), and the time reached, in ``sqrt(a/g)``.
    types : ndarray of int
        Places in :data:`rattlesweep.sweeps.tables.types.TYPES`; -1 where ``ok`` is false.
    ok : ndarray of bool
        Whether the status is ``ok``.
    n_end : ndarray
        Spin at ``t_end``.
    drift : ndarray
        Relative change of energy.
    tries : float
        Steps tried in all, accepted or not.
    """

    t_r: Floats
    t_end: Floats
    types: NDArray[Any]
    ok: Flags
    n_end: Floats
    drift: Floats
    tries: float


@dataclass(frozen=True)
class Runs:
    """Runs of a config, ready for the full and the reduced dynamics."""

    config: Config
    launches: Launches

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.launches.n_i)

    @cached_property
    def batches(self) -> dict[str, Batch]:
        """The runs as the models take them."""
        return {"full": full_batch(self.launches), "reduced": reduced_batch(self.launches)}

    @property
    def bounded(self) -> Flags:
        """Which runs have a horizon to be integrated to."""
        bounded: Flags = np.isfinite(self.launches.t_end) & (self.launches.t_end > 0)
        return bounded

    def integrate(
        self, batch: Batch, model: str, integrator: Mapping[str, Any], threads: int
    ) -> Solution:
        """Integrate a batch of these runs with a method and its setting.

        The kernel works in a thread of its own, so that Ctrl-C is heard.
        """
        settings = type(self.config.integrator).model_validate(dict(integrator))
        chosen = self.config.model_copy(update={"model": model, "integrator": settings})
        out = Task(
            lambda control: run_batch(chosen, batch, threads=threads, control=control)
        ).wait()
        ok = out.status == Status.OK
        return Solution(
            t_r=np.where(ok, out.t_r, np.nan),
            t_end=out.t_end,
            types=classify(ok, out.t_r, out.amp_growth, out.n_departure, chosen.classify),
            ok=ok,
            n_end=out.n_end,
            drift=np.abs(out.energy_drift),
            tries=float(out.n_steps.sum() + out.n_rejected.sum()),
        )


def draw(config: Config, base: Path | None, *, samples: int | None, least: int) -> Runs:
    """Draw runs from a config.

    Parameters
    ----------
    config : Config
        Its model, integrator and records play no part.
    base : Path, optional
        Where a table's relative path is looked up besides the working directory.
    samples : int, optional
        Runs of each case, if there are as many; by default so many that there are ``least`` runs.
    least : int
    """
    data = resolved(config) | {"record": [], "model": "full"}
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
