"""Refuse configs of which no run can be right, and warn of those that make little physical sense.

Theory and linear stability judge a few thousand runs; nothing is compiled and nothing integrated.
Random bodies are drawn in NumPy, since the compiled sampler may take hours of redrawing, and always
the same, so that a config always gets one answer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers, take
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import MAX_DAMPING
from rattlesweep.integrate.tableau import METHODS, Tableau
from rattlesweep.physics import theory
from rattlesweep.sweeps.bodies.protocol import Bodies, Source
from rattlesweep.sweeps.bodies.sampler import bodies_of
from rattlesweep.sweeps.bodies.sources import SdBodies, drawn, ranges_of
from rattlesweep.sweeps.config.messages import Key
from rattlesweep.sweeps.config.schema import Config, SdSource
from rattlesweep.sweeps.launches import Launches, make_batch, prepare
from rattlesweep.sweeps.plan import Plan, make_plan

RUNS, DRAWN = 4096, 65_536
"""Runs that stand for a sweep, and bodies drawn to see which targets are within reach."""
SEED = 2017
MOST = 0.5
"""Share of runs from which on a short horizon looks like a mistake."""
ENOUGH = 32
"""Bodies by which the density near a target is judged."""
TOO_MANY, MANY = 1e10, 1e11
"""Draws a body and in all; the sampler makes some 1e7 a second and thread."""

Finding = tuple[Key, str, bool]
"""What makes little sense at a key, and whether no run of the sweep can be right."""


def checked_plan(
    config: Config, base: Path | None = None, source: Source | None = None
) -> tuple[Plan, list[str]]:
    """Return the plan of a config (:func:`rattlesweep.sweeps.plan.make_plan`) and its warnings.

    Raises
    ------
    ConfigError
        If no run can be right; like a warning, each line is place, key, sentence.
    """
    with config.locating():
        plan = make_plan(config, base, source)
        warnings = check_physics(plan)
        if isinstance(plan.source, SdBodies):
            plan.source.check_targets()
    return plan, warnings


def check_physics(plan: Plan) -> list[str]:
    """Return the warnings about a plan; raise a ConfigError if no run of it can be right."""
    config, bodies, words = plan.config, plan.config.bodies, f"the {plan.runs} runs"
    with np.errstate(all="ignore"):
        found = [*target_findings(bodies)] if isinstance(bodies, SdSource) else []
        if not any(fatal for *_, fatal in found):
            if isinstance(bodies, SdSource):
                plan = replace(plan, source=DrawnBodies(bodies))
                words = f"{min(plan.runs, RUNS)} runs drawn from the ranges"
            elif plan.runs > RUNS:
                words = f"{RUNS} of the {plan.runs} runs"
            runs = np.linspace(0, plan.runs - 1, min(plan.runs, RUNS)).astype(np.int64)
            found += _findings(config, prepare(plan, *np.divmod(runs, plan.samples)), words)
    if any(fatal for *_, fatal in found):
        raise ConfigError(config.line(key, message) for key, message, fatal in found if fatal)
    return [config.line(key, message) for key, message, _ in found]


def _findings(config: Config, launches: Launches, words: str) -> Iterator[Finding]:
    """Yield what is wrong with the horizons and the step of some runs."""

    def told(mask: Flags) -> str:
        """Return words for the runs of a mask."""
        if len(mask) == 1:
            return "the only run"
        return f"{'all' if mask.all() else mask.sum()} of {words}"

    t_end, t_rgh, horizon = launches.t_end, launches.gh.t_rgh, config.horizon
    endless = ~np.isfinite(t_end)
    if endless.any():
        unit = "t_rgh times t_rGH" if horizon.t_rgh is not None else "t_decay times gamma/sigma"
        message = f"{unit} is not a finite time in {told(endless)}; give t as well"
        yield ("horizon", unit.split()[0]), message, bool(endless.all())
        return
    key = ("horizon", "t")
    if launches.bodies.t_end is not None:
        key = ("bodies", "path")
    elif horizon.t is None:
        key = ("horizon", "t_rgh" if horizon.t_decay is None else "t_decay")
    period = 2 * np.pi / launches.modes.omega_p
    # A launch without spin has no t_rGH, which is NaN.
    brief, early = (t_end < period) & (config.model == "full"), t_end < t_rgh
    if brief.mean() >= MOST:
        message = f"the horizon of {_span(t_end)} is shorter than one pitch oscillation, "
        message += f"{_span(period)}, in {told(brief)}, and no type can be told; give a longer one"
        yield key, message, False
    elif early.mean() >= MOST and horizon.t_decay is None:
        message = "the horizon comes before t_rGH, the time of reversal by theory, in "
        message += f"{told(early)}, and few will be of type R; give t_rgh above 1, or t above "
        yield key, f"{message}{np.nanmedian(t_rgh):.3g}, the median of t_rGH", False

    method, dt = METHODS[config.integrator.method], config.integrator.dt
    if dt is None or config.model != "full":
        return
    batch = make_batch(launches, config.model)
    assert batch is not None
    limit, fastest = stability_limit(method), batch.swing / 2
    # At the launch's spin and without spin, which is where a reversal leads.
    slowest = np.minimum(fastest, launches.modes.omega_p)
    unstable = dt * slowest > limit
    # The test of the status coarse_step in `rattlesweep.integrate.batch.integrate`.
    damping = method.damping(dt * batch.relevant) * (np.fmin(t_end, t_rgh) / dt)
    coarse = unstable | ~(np.abs(damping) <= MAX_DAMPING)
    if unstable.all():
        message = f"{dt:g} is beyond the stability of {method.name} for {told(unstable)}: dt "
        message += f"omega_p must be below {limit:.3g}, and omega_p is {_span(slowest)}"
        yield ("integrator", "dt"), f"{message}; give a smaller dt", True
    elif coarse.any():
        message = f"{dt:g} is too coarse for {told(coarse)}: up to their horizons {method.name} "
        message += f"damps or feeds the oscillation by more than {100 * MAX_DAMPING:g} %, and they "
        message += "end as coarse_step or energy; give a smaller dt or take an adaptive method"
        yield ("integrator", "dt"), message, False


def target_findings(source: SdSource) -> Iterator[Finding]:
    """Yield targets that are out of reach in the ranges, and those that will take long."""
    target = source.target
    if target is None:
        return
    key, tol = ("bodies", "target", target.name), target.rel_tol
    found = DrawnBodies(source).coefficient
    low, high = float(np.nanmin(found)), float(np.nanmax(found))
    for value in target.values:
        # A value beyond all of these takes millions of draws a body, if there is any.
        if not low <= (1 + tol) * value or not (1 - tol) * value <= high:
            message = f"{value:g} is out of reach: in {DRAWN} bodies drawn from the ranges "
            message += f"{target.name} lies between {low:.4g} and {high:.4g}; give a target in "
            yield key, message + "between or other ranges", True
            continue
        # The nearest bodies stand for the neighbourhood.
        off = np.sort(np.abs(found - value))
        inside = int(np.searchsorted(off, tol * value, side="right"))
        near = ENOUGH * tol * value / max(float(off[ENOUGH - 1]), tol * value)
        draws = DRAWN / max(inside, near, 1e-300)
        missed = float(np.exp(-target.max_draws / draws))
        words = f"{value:g} takes about {draws:.1e} draws a body"
        wayout = "give other ranges, a larger rel_tol or another target"
        if draws > TOO_MANY or draws * source.samples > MANY:
            which = "each" if draws > TOO_MANY else f"all {source.samples} samples"
            yield key, f"{words}: hours for {which}; {wayout}", draws > TOO_MANY
        elif missed * source.samples > 0.01:
            message = f"{words}, but max_draws is {target.max_draws}, and a sample that misses the "
            yield key, f"{message}target ends the sweep; {wayout}, or more max_draws", False


def stability_limit(method: Tableau) -> float:
    """Return the largest phase of an oscillation in one step that the method does not blow up."""
    phase = np.arange(0.0, 20.0, 1e-3)
    growing = np.flatnonzero(method.damping(phase) < -1e-3)
    return float(phase[growing[0]]) if growing.size else np.inf


def _span(values: Floats) -> str:
    low, high = f"{values.min():.3g}", f"{values.max():.3g}"
    return low if low == high else f"{low} to {high}"


class DrawnBodies:
    """A source of random bodies; with targets, of those that come nearest to them."""

    samples = RUNS
    fields = ()

    def __init__(self, source: SdSource) -> None:
        ranges = ranges_of(source)
        points = np.random.default_rng(SEED).random((len(ranges), DRAWN))
        self._bodies = b = drawn(bodies_of(points, ranges))
        self._aims = source.target is not None
        with np.errstate(all="ignore"):
            *_, K_p, K_r = theory.torque_coefficients(b.alpha, b.beta, b.theta, b.phi, b.xi)
        # The one that has targets.
        self.coefficient = K_p if source.target and source.target.name == "K_p" else K_r

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some runs."""
        wanted, place = np.broadcast_to(target, sample.shape), sample.copy()
        for value in np.unique(wanted) if self._aims else ():
            nearest = np.argpartition(np.abs(self.coefficient - value), RUNS)[:RUNS]
            place[wanted == value] = nearest[sample[wanted == value]]
        return take(self._bodies, place)
