"""A few thousand runs of a plan, by which its physical sense is judged.

Random bodies are drawn in NumPy: the compiled sampler may take hours of redrawing.  The draw has a
fixed seed, so that a config always gets the same answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.physics import theory
from rattlesweep.sweeps.blocks.rows import take
from rattlesweep.sweeps.cases.launches import Launches, prepare
from rattlesweep.sweeps.cases.plan import Plan
from rattlesweep.sweeps.cases.sampler import bodies_of
from rattlesweep.sweeps.cases.sources import Bodies
from rattlesweep.sweeps.config.bodies import SdSource

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
        drawn = draw(source, RUNS if target is None else DRAWN)
        self._groups = [drawn]
        if target is not None:
            found = coefficient(drawn, target.name)
            order = np.argsort(found)
            middle = np.searchsorted(found, target.values, sorter=order)
            first = np.clip(middle - RUNS // 2, 0, DRAWN - RUNS)
            self._groups = [take(drawn, order[start : start + RUNS]) for start in first]

    def bodies(self, group: int, samples: Integers) -> Bodies:
        """Bodies of some samples of the cases of target ``group``."""
        return take(self._groups[group], samples)


def draw(source: SdSource, size: int = DRAWN) -> Bodies:
    """Bodies drawn evenly from the ranges of a source."""
    ranges = np.array([*source.ranges.ends(), *([] if source.c is None else [source.c])])
    points = np.random.default_rng(SEED).random((len(ranges), size))
    # From the upper ends of all ranges.
    points[:4] = 1 - points[:4]
    gamma, f_sd, theta, phi, xi, alpha, beta, *c = bodies_of(points, ranges)
    return Bodies(alpha, beta, gamma, theta, phi, xi, f_sd, c=c[0] if c else None)


def coefficient(bodies: Bodies, name: str) -> Floats:
    """The torque coefficient K_p or K_r of bodies."""
    b = bodies
    with np.errstate(all="ignore"):
        found = theory.torque_coefficients(b.alpha, b.beta, b.theta, b.phi, b.xi)
    chosen: Floats = found[2 if name == "K_p" else 3]
    return chosen
