"""A few thousand runs of a plan, by which its physical sense is judged.

Random bodies are drawn in NumPy: the compiled sampler may take hours of redrawing.  The draw has a
fixed seed, so that a config always gets the same answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.physics import theory
from rattlesweep.physics.body import shell_dumbbell
from rattlesweep.sweeps.cases.launches import Launches, prepare
from rattlesweep.sweeps.cases.plan import Plan
from rattlesweep.sweeps.cases.sources import Bodies
from rattlesweep.sweeps.config.bodies import SdRanges, SdSource

RUNS = 4096
DRAWN = 65_536
SEED = 2017


@dataclass(frozen=True)
class Sample:
    """Some runs of a plan, and what they are in words: "4096 runs drawn from the ranges"."""

    launches: Launches
    words: str

    def told(self, mask: Flags) -> str:
        """How many of the runs are meant, in words."""
        if mask.size == 1:
            return "the only run"
        count = int(mask.sum())
        return f"all of {self.words}" if count == mask.size else f"{count} of {self.words}"


def sample_runs(plan: Plan) -> Sample:
    """Runs that stand for those of a sweep: all if they are few, else `RUNS` from all over it."""
    plan, bodies = plan.whole, plan.config.bodies
    if isinstance(bodies, SdSource):
        plan = replace(plan, source=DrawnBodies(bodies))
    size = min(plan.runs, RUNS)
    runs = np.linspace(0, plan.runs - 1, size).astype(np.int64)
    words = f"the {size} runs" if size == plan.runs else f"{size} of the {plan.runs} runs"
    if isinstance(bodies, SdSource):
        words = f"{size} runs drawn from the ranges"
    return Sample(prepare(plan, *plan.runs_at(runs)), words)


class DrawnBodies:
    """A source of random bodies: with targets, of those that come nearest to them."""

    samples = RUNS

    def __init__(self, source: SdSource) -> None:
        target = source.target
        points = draw(source.ranges, RUNS if target is None else DRAWN)
        self._groups = [points]
        if target is not None:
            found = coefficient(points, target.name)
            order = np.argsort(found)
            middle = np.searchsorted(found[order], target.values)
            first = np.clip(middle - RUNS // 2, 0, DRAWN - RUNS)
            self._groups = [points[:, order[start : start + RUNS]] for start in first]

        self._c = source.c

    def bodies(self, group: int, samples: Integers) -> Bodies:
        """Bodies of some samples of the cases of target ``group``."""
        found = bodies_at(self._groups[group][:, samples])
        if self._c is None:
            return found
        return replace(found, c=np.linspace(self._c[0], self._c[1], len(samples)))


def draw(ranges: SdRanges, size: int = DRAWN) -> Floats:
    """Points drawn evenly from the ranges, shape (5, size)."""
    low, high = np.array(ranges.ends()).T[:, :, None]
    # Like the sampler: the skew angle's own range is open below.
    points: Floats = high - (high - low) * np.random.default_rng(SEED).random((5, size))
    return points


def bodies_at(points: Floats) -> Bodies:
    """Bodies at points of the ranges, shape (5, bodies)."""
    gamma, f_sd, theta, phi, minus_xi_deg = points
    alpha, beta = shell_dumbbell(gamma, f_sd)
    return Bodies(alpha, beta, gamma, theta, phi, -np.radians(minus_xi_deg), f_sd)


def coefficient(points: Floats, name: str) -> Floats:
    """The torque coefficient K_p or K_r of the bodies at `points`."""
    b = bodies_at(points)
    with np.errstate(all="ignore"):
        found = theory.torque_coefficients(b.alpha, b.beta, b.theta, b.phi, b.xi)
    chosen: Floats = found[2 if name == "K_p" else 3]
    return chosen
