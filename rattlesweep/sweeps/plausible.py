"""Refuse configs of which no run can be right, and warn of those that make little physical sense.

Theory judges a few thousand runs; nothing is compiled and nothing integrated.  Random bodies are
drawn in NumPy, as the compiled sampler may redraw for hours, and with one seed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers, take
from rattlesweep.errors import ConfigError
from rattlesweep.physics import theory
from rattlesweep.sweeps.bodies import Bodies, Source
from rattlesweep.sweeps.bodies.sources import SdBodies, bodies_at, ranges_of
from rattlesweep.sweeps.config import Key
from rattlesweep.sweeps.config.schema import Config, SdSource
from rattlesweep.sweeps.launches import Launches, prepare
from rattlesweep.sweeps.plan import Plan, make_plan

RUNS, DRAWN = 4096, 65_536
"""Runs that stand for a sweep, and bodies drawn to see which targets are within reach."""
SEED = 2017


def checked_plan(
    config: Config, base: Path | None = None, source: Source | None = None
) -> tuple[Plan, list[str]]:
    """Return the plan of a config (:func:`rattlesweep.sweeps.plan.make_plan`) and its warnings.

    Raise a ConfigError if no run can be right; like a warning, each line is place, key, sentence.
    """
    with config.locating():
        plan = make_plan(config, base, source)
        warnings = check_physics(plan)
        if isinstance(plan.source, SdBodies):
            plan.source.check_targets()
    return plan, warnings


def check_physics(plan: Plan) -> list[str]:
    """Return the warnings about a plan; raise a ConfigError if no run of it can be right."""
    config, source, words = plan.config, plan.config.bodies, f"the {plan.runs} runs"
    with np.errstate(all="ignore"):
        if isinstance(source, SdSource):
            bodies = DrawnBodies(source)
            if far := [config.line(*found) for found in bodies.far_targets(source)]:
                raise ConfigError(far)
            plan = replace(plan, source=bodies)
            words = f"{min(plan.runs, RUNS)} runs drawn from the ranges"
        elif plan.runs > RUNS:
            words = f"{RUNS} of the {plan.runs} runs"
        runs = np.linspace(0, plan.runs - 1, min(plan.runs, RUNS)).astype(np.int64)
        launches = prepare(plan, *np.divmod(runs, plan.samples))
        return [config.line(*found) for found in _doubts(config, launches, words)]


def _doubts(config: Config, launches: Launches, words: str) -> Iterator[tuple[Key, str]]:
    """Yield what makes little sense of some runs, by keys; raise if none has a horizon."""

    def told(mask: Flags) -> str:
        if len(mask) == 1:
            return "the only run"
        return f"{'all' if mask.all() else mask.sum()} of {words}"

    t_end, t_rgh, horizon = launches.t_end, launches.gh.t_rgh, config.horizon
    name, unit = "t_rgh", "t_rGH"
    if horizon.t_rgh is None:
        name, unit = "t_decay", "gamma/sigma"
    endless = ~np.isfinite(t_end)
    if endless.any():
        message = f"{name} times {unit} is not a finite time in {told(endless)}; give t as well"
        found = ("horizon", name), message
        if endless.all():
            raise ConfigError([config.line(*found)])
        yield found
        return
    # A launch without spin has no t_rGH, which is NaN.
    early = t_end < t_rgh
    if early.mean() >= 0.5 and horizon.t_decay is None:
        own = launches.bodies.t_end is not None
        key = ("bodies", "path") if own else ("horizon", name if horizon.t is None else "t")
        message = "the horizon comes before t_rGH, the time of reversal by theory, in "
        message += f"{told(early)}, and few will be of type R; give t_rgh above 1, or t above "
        yield key, f"{message}{np.nanmedian(t_rgh):.3g}, the median of t_rGH"


class DrawnBodies:
    """A source of random bodies, whatever the target."""

    samples = RUNS
    fields = ()

    def __init__(self, source: SdSource) -> None:
        ranges = ranges_of(source)
        points = np.random.default_rng(SEED).random((len(ranges), DRAWN))
        self._bodies = bodies_at(points, ranges)

    def far_targets(self, source: SdSource) -> Iterator[tuple[Key, str]]:
        """Yield targets that are out of reach: there each body takes millions of draws, if any."""
        if (target := source.target) is None:
            return
        b = self._bodies
        *_, K_p, K_r = theory.torque_coefficients(b.alpha, b.beta, b.theta, b.phi, b.xi)
        found = K_p if target.name == "K_p" else K_r
        low, high = np.nanmin(found), np.nanmax(found)
        for value in target.values:
            if abs(value - np.clip(value, low, high)) > target.rel_tol * value:
                message = f"{value:g} is out of reach: in {DRAWN} bodies drawn from the ranges "
                message += f"{target.name} lies between {low:.4g} and {high:.4g}"
                yield ("bodies", "target", target.name), message

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some runs."""
        return take(self._bodies, sample)
