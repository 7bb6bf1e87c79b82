"""Runs that a study integrates again and again, and one call that does it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.batch import Batch
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.blocks.block import run_batch
from rattlesweep.sweeps.cases.launches import Launches, full_batch, prepare, reduced_batch
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.config.load import Config, SdSource, override_config, resolved
from rattlesweep.sweeps.tables.types import classify

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Answer:
    """What an integration says; arrays over runs.

    Attributes
    ----------
    t_r, t_end : ndarray
        First zero of the spin (NaN without one), and the time reached.
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
class Work:
    """Runs of a config, ready for the full and the reduced dynamics."""

    config: Config
    launches: Launches
    full: Batch
    reduced: Batch

    def batch(self, model: str) -> Batch:
        """The runs as a model takes them."""
        return self.full if model == "full" else self.reduced

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.full)


def draw(config: Config, base: Path | None, *, samples: int | None, least: int) -> Work:
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
    launches = prepare(plan, case, np.tile(picks, len(plan.cases)))
    return Work(config, launches, full_batch(launches), reduced_batch(launches))


def take(batch: Batch, index: NDArray[Any]) -> Batch:
    """Some of the runs of a batch."""
    return Batch(**{name: getattr(batch, name)[index] for name in batch.__dataclass_fields__})


def cut(batch: Batch, horizon: float) -> Batch:
    """Let runs end no later than ``horizon``."""
    return replace(batch, t_end=np.minimum(batch.t_end, horizon))


def with_horizon(work: Work) -> NDArray[np.bool_]:
    """Which runs have a horizon to be integrated to."""
    return np.isfinite(work.full.t_end) & (work.full.t_end > 0)


def integrate(
    config: Config, batch: Batch, model: str, integrator: Mapping[str, Any], threads: int
) -> Answer:
    """Integrate runs with a method and its setting.

    The kernel works in a thread of its own, so that Ctrl-C is heard.
    """
    chosen = config.model_copy(
        update={
            "model": model,
            "integrator": type(config.integrator).model_validate(dict(integrator)),
        }
    )
    out = Task(lambda control: run_batch(chosen, batch, threads=threads, control=control)).wait()
    ok = out.status == Status.OK
    return Answer(
        t_r=np.where(ok, out.t_r, np.nan),
        t_end=out.t_end,
        types=classify(ok, out.t_r, out.amp_growth, out.n_departure, config.classify),
        ok=ok,
        n_end=out.n_end,
        drift=np.abs(out.energy_drift),
        tries=float(out.n_steps.sum() + out.n_rejected.sum()),
    )
