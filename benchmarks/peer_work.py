"""The work that every method of ``peers.py`` does, and its errors."""

from __future__ import annotations

import time
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from machine import all_runs, plan_of

from rattlesweep.arrays import take
from rattlesweep.config.read import parse_config
from rattlesweep.design.plan import make_plan
from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.kernel.outcome import Batch
from rattlesweep.motion.model import FULL

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Solve = Callable[[Batch], Floats]

SPINS = (-0.5, -0.4, -0.3, -0.2, -0.1, 0.1, 0.2, 0.3, 0.4, 0.5)
GH = {
    "bodies": {"source": "preset", "name": "GH"},
    "spin": {"n_i": list(SPINS), "omega_xy0": [0.001, 0.01, 0.1]},
    "horizon": {"t_rgh": 5},
}
HORIZON = 2000.0
AGREE = 1e-8  # largest relative difference of two references


@dataclass(frozen=True)
class Work:
    """Runs and their reversal times, NaN where there is none before the horizon."""

    runs: Batch
    t_ref: Floats

    @property
    def units(self) -> float:
        """Return the total time to integrate, in ``sqrt(a/g)``."""
        ends = np.where(np.isnan(self.t_ref), self.runs.t_end, self.t_ref)
        return float(ends.sum())

    def take(self, index: NDArray[np.bool_]) -> Work:
        """Return some of the runs."""
        return Work(take(self.runs, index), self.t_ref[index])

    def tiled(self, least: int) -> tuple[Batch, int]:
        """Return the runs, repeated until there are ``least``, and the repeats."""
        copies = -(-least // len(self.runs))
        return take(self.runs, np.tile(np.arange(len(self.runs)), copies)), copies


@dataclass(frozen=True)
class Errors:
    """Errors of a method's reversal times."""

    median: float
    p99: float
    missed: int
    false: int
    another_zero: int
    runs: int


def draw(samples: int) -> Batch:
    """Return runs of each of the 120 cases of steady.yaml, and of the GH body."""
    plans = (
        plan_of("steady.yaml", f"bodies.samples={samples}"),
        make_plan(parse_config(GH)),
    )
    batches = [all_runs(plan)[1] for plan in plans]
    joined = {
        field.name: np.concatenate([getattr(batch, field.name) for batch in batches])
        for field in fields(Batch)
    }
    runs = Batch(**joined)
    return replace(runs, t_end=np.minimum(runs.t_end, HORIZON))


def rattlesweep(method: str, *, tol: float = 1e-9, dt: float = 0.002) -> Solve:
    """Return a solver by rattlesweep's kernel on one thread."""

    def solve(runs: Batch) -> Floats:
        return integrate(runs, METHODS[method], FULL, tol=tol, dt=dt, threads=1).t_r

    return solve


def errors_of(t_r: Floats, work: Work) -> Errors:
    """Compare times of reversal with the reference."""
    reverses = ~np.isnan(t_r)
    should = ~np.isnan(work.t_ref)
    both = reverses & should
    difference = np.abs(t_r - work.t_ref)
    relative = (difference / work.t_ref)[both]
    quarter_swing = 0.25 * 2 * np.pi / work.runs.swing
    return Errors(
        median=float(np.median(relative)),
        p99=float(np.percentile(relative, 99)),
        missed=int((should & ~reverses).sum()),
        false=int((reverses & ~should).sum()),
        another_zero=int((difference > quarter_swing)[both].sum()),
        runs=len(t_r),
    )


def timed(solve: Solve, runs: Batch) -> tuple[float, Floats]:
    """Return processor seconds of all threads of this process, and the result.

    A method that secretly used two threads pays for both.
    """
    begin = time.process_time()
    t_r = solve(runs)
    return time.process_time() - begin, t_r


def cost_at(error: float, errors: Floats, costs: Floats) -> tuple[float, str]:
    """Return the cost at an error, log-log along a curve, and a mark.

    Beyond the ends of the curve it is the cost at the end. The mark is ``<`` if the
    cost is at most this (no measured error is as large), ``>`` if it is at least this.
    """
    order = np.argsort(errors)
    x = np.log(errors[order])
    y = np.log(costs[order])
    mark = ""
    if np.log(error) > x[-1]:
        mark = "<"
    if np.log(error) < x[0]:
        mark = ">"
    return float(np.exp(np.interp(np.log(error), x, y))), mark
