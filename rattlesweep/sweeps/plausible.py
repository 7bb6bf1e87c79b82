"""Refuse configs of which no run can be right, and warn of those that make little physical sense.

Theory and linear stability judge a few thousand runs; nothing is compiled and nothing integrated.
Random bodies are drawn in NumPy, since the compiled sampler may take hours of redrawing, and always
the same, so that a config always gets one answer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

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
from rattlesweep.sweeps.launches import make_batch, prepare
from rattlesweep.sweeps.plan import Plan, make_plan

# Runs that stand for a sweep, and bodies drawn to see which targets are within reach.
RUNS, DRAWN = 4096, 65_536
SEED = 2017
# Share of runs from which on a short horizon looks like a mistake.
MOST = 0.5
# Bodies by which the density near a target is judged.
ENOUGH = 32
# Draws a body and in all; the sampler makes some 1e7 a second and thread.
TOO_MANY, MANY = 1e10, 1e11


class Finding(NamedTuple):
    """What makes little sense at a key; fatal if no run of the sweep can be right."""

    key: Key
    message: str
    fatal: bool = False


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
    with np.errstate(all="ignore"):
        found = list(_findings(plan))
    if fatal := [one for one in found if one.fatal]:
        raise ConfigError(plan.config.line(one.key, one.message) for one in fatal)
    return [plan.config.line(one.key, one.message) for one in found]


def _findings(plan: Plan) -> Iterator[Finding]:
    config, bodies, words = plan.config, plan.config.bodies, f"the {plan.runs} runs"
    if isinstance(bodies, SdSource):
        targets = list(target_findings(bodies))
        yield from targets
        if any(one.fatal for one in targets):
            return
        plan = replace(plan, source=DrawnBodies(bodies))
        words = f"{min(plan.runs, RUNS)} runs drawn from the ranges"
    elif plan.runs > RUNS:
        words = f"{RUNS} of the {plan.runs} runs"
    runs = np.linspace(0, plan.runs - 1, min(plan.runs, RUNS)).astype(np.int64)
    launches = prepare(plan, *np.divmod(runs, plan.samples))

    def told(mask: Flags) -> str:
        """Return words for the runs of a mask."""
        if len(runs) == 1:
            return "the only run"
        return f"{'all' if mask.all() else mask.sum()} of {words}"

    t_end, t_rgh = launches.t_end, launches.gh.t_rgh
    period = 2 * np.pi / launches.modes.omega_p
    horizon, key = config.horizon, ("horizon", "t")
    if launches.bodies.t_end is not None:
        key = ("bodies", "path")
    elif horizon.t is None:
        key = ("horizon", "t_rgh" if horizon.t_decay is None else "t_decay")
    endless = ~np.isfinite(t_end)
    if endless.any():
        unit = "t_rgh times t_rGH" if horizon.t_rgh is not None else "t_decay times gamma/sigma"
        message = f"{unit} is not a finite time in {told(endless)}; give t as well"
        yield Finding(("horizon", unit.split()[0]), message, fatal=bool(endless.all()))
        return
    brief, early = (t_end < period) & (config.model == "full"), t_end < t_rgh
    if brief.mean() >= MOST:
        message = f"the horizon of {_span(t_end)} is shorter than one pitch oscillation, "
        message += f"{_span(period)}, in {told(brief)}, and no type can be told; give a longer one"
        yield Finding(key, message)
    elif early.mean() >= MOST and horizon.t_decay is None:
        message = "the horizon comes before t_rGH, the time of reversal by theory, in "
        message += f"{told(early)}, and few will be of type R; give t_rgh above 1, or t above "
        yield Finding(key, f"{message}{np.median(t_rgh):.3g}, the median of t_rGH")

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
        yield Finding(("integrator", "dt"), f"{message}; give a smaller dt", fatal=True)
    elif coarse.any():
        message = f"{dt:g} is too coarse for {told(coarse)}: up to their horizons {method.name} "
        message += f"damps or feeds the oscillation by more than {100 * MAX_DAMPING:g} %, and they "
        message += "end as coarse_step or energy; give a smaller dt or take an adaptive method"
        yield Finding(("integrator", "dt"), message)


def target_findings(source: SdSource) -> Iterator[Finding]:
    """Yield targets that are out of reach in the ranges, and those that will take long."""
    target = source.target
    if target is None:
        return
    key, tol = ("bodies", "target", target.name), target.rel_tol
    found = coefficient(draw(source), target.name)
    low, high = float(np.nanmin(found)), float(np.nanmax(found))
    for value in target.values:
        # A value beyond all of these takes millions of draws a body, if there is any.
        if not low <= (1 + tol) * value or not (1 - tol) * value <= high:
            message = f"{value:g} is out of reach: in {DRAWN} bodies drawn from the ranges "
            message += f"{target.name} lies between {low:.4g} and {high:.4g}; give a target in "
            yield Finding(key, message + "between or other ranges", fatal=True)
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
            fatal = draws > TOO_MANY
            which = "each" if fatal else f"all {source.samples} samples"
            yield Finding(key, f"{words}: hours for {which}; {wayout}", fatal=fatal)
        elif missed * source.samples > 0.01:
            message = f"{words}, but max_draws is {target.max_draws}, and a sample that misses the "
            yield Finding(key, f"{message}target ends the sweep; {wayout}, or more max_draws")


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
        self._bodies = draw(source)
        self._found = coefficient(self._bodies, source.target.name) if source.target else None

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some runs."""
        wanted, place = np.broadcast_to(target, sample.shape), sample.copy()
        for value in np.unique(wanted) if self._found is not None else ():
            nearest = np.argpartition(np.abs(self._found - value), RUNS)[:RUNS]
            place[wanted == value] = nearest[sample[wanted == value]]
        return take(self._bodies, place)


def draw(source: SdSource) -> Bodies:
    """Return bodies drawn evenly from the ranges of a source."""
    ranges = ranges_of(source)
    points = np.random.default_rng(SEED).random((len(ranges), DRAWN))
    return drawn(bodies_of(points, ranges))


def coefficient(bodies: Bodies, name: str) -> Floats:
    """Return the torque coefficient K_p or K_r of bodies."""
    b = bodies
    with np.errstate(all="ignore"):
        found = theory.torque_coefficients(b.alpha, b.beta, b.theta, b.phi, b.xi)
    chosen: Floats = found[2 if name == "K_p" else 3]
    return chosen
