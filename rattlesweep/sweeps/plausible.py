"""Refuse configs of which no run can be right, and warn of those that make little physical sense.

Theory and linear stability judge a few thousand runs; nothing is compiled and nothing integrated.
Random bodies are drawn in NumPy, since the compiled sampler may take hours of redrawing, and always
the same, so that a config always gets one answer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers, take
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import MAX_DAMPING, Batch
from rattlesweep.integrate.tableau import METHODS, Tableau
from rattlesweep.physics import theory
from rattlesweep.sweeps.bodies.protocol import Bodies, Source
from rattlesweep.sweeps.bodies.sampler import bodies_of
from rattlesweep.sweeps.bodies.sources import SdBodies, drawn, ranges_of
from rattlesweep.sweeps.config.messages import Key
from rattlesweep.sweeps.config.schema import Config, SdSource
from rattlesweep.sweeps.launches import Launches, make_batch, prepare
from rattlesweep.sweeps.plan import Plan, make_plan

# Runs that stand for a sweep, and bodies drawn to see which targets are within reach.
RUNS, DRAWN = 4096, 65_536
SEED = 2017
# A run may reverse before t_rGH, but none was seen to in a tenth of it.
EARLY = 0.1
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
    config = plan.config
    targets = list(target_findings(config.bodies)) if isinstance(config.bodies, SdSource) else []
    yield from targets
    if any(one.fatal for one in targets):
        return
    sample = sample_runs(plan)
    yield from _horizon_findings(config, sample)
    # Without a horizon there is nothing to judge by; the runs get a status of their own.
    if config.model == "gh" or not np.isfinite(sample.launches.t_end).all():
        return
    batch = make_batch(sample.launches, config.model)
    assert batch is not None
    method, dt = METHODS[config.integrator.method], config.integrator.dt
    if dt is not None and config.model == "reduced":
        coarse = dt * batch.swing > 1
        if coarse.any():
            told = f"{_span(1 / batch.swing)}, in {sample.count(coarse)}"
            words = f"{dt:g} is longer than the oscillation's energy takes to grow e-fold"
            yield Finding(("integrator", "dt"), f"{words}, {told}; give a tenth of that or less")
    elif dt is not None:
        yield from _step_findings(dt, sample, batch, method)
    if dt is not None or config.model != "reduced":
        yield from _limit_findings(config, sample, batch)


# -- targets ---------------------------------------------------------------------------------------


def target_findings(source: SdSource) -> Iterator[Finding]:
    """Yield targets that are out of reach in the ranges, and those that will take long."""
    target = source.target
    if target is None:
        return
    key, tol, tries = ("bodies", "target", target.name), target.rel_tol, target.max_draws
    found = coefficient(draw(source), target.name)
    low, high = float(np.nanmin(found)), float(np.nanmax(found))
    wayout = "give other ranges, a larger rel_tol or another target"
    for value in target.values:
        # A value beyond all of these takes millions of draws a body, if there is any.
        if not low <= (1 + tol) * value or not (1 - tol) * value <= high:
            reach = f"in {DRAWN} bodies drawn from the ranges {target.name} lies between"
            words = f"{value:g} is out of reach: {reach} {low:.4g} and {high:.4g}"
            yield Finding(key, f"{words}; give a target in between or other ranges", fatal=True)
            continue
        chance, most = _chance(found, value, tol)
        draws = 1 / chance if chance else np.inf
        words = f"{value:g} takes {'at least' if most else 'about'} {draws:.1e} draws a body, by "
        words += f"{DRAWN} bodies drawn from the ranges"
        missed = float(np.exp(-chance * tries))
        if draws > TOO_MANY:
            yield Finding(key, f"{words}: hours for each; {wayout}", fatal=True)
        elif missed > 0.99:
            more = f"but max_draws is {tries}; {wayout}, or more max_draws"
            yield Finding(key, f"{words}, {more}", fatal=True)
        elif missed * source.samples > 0.01:
            yield Finding(
                key,
                f"{words}: in max_draws = {tries} of them each of the {source.samples} samples is "
                f"missed with probability {missed:.1g}, and one miss ends the sweep; {wayout}, or "
                "more max_draws",
            )
        elif draws * source.samples > MANY:
            yield Finding(key, f"{words}, {draws * source.samples:.1e} in all: hours; {wayout}")


def _chance(found: Floats, value: float, rel_tol: float) -> tuple[float, bool]:
    """Return the probability that a draw meets `value`, and whether it is only an upper limit."""
    off = np.sort(np.abs(found - value))
    inside = int(np.searchsorted(off, rel_tol * value, side="right"))
    if inside >= ENOUGH:
        return inside / len(off), False
    # The nearest bodies stand for the neighbourhood, if they are not more than half as far away.
    count = int(np.searchsorted(off, value / 2))
    place = (min(count, ENOUGH) or ENOUGH) - 1
    share = rel_tol * value / max(float(off[place]), rel_tol * value)
    return (place + 1) / len(off) * share, count == 0


# -- horizons and steps ----------------------------------------------------------------------------


def _horizon_findings(config: Config, sample: Sample) -> Iterator[Finding]:
    launches, horizon = sample.launches, config.horizon
    t_end, t_rgh = launches.t_end, launches.gh.t_rgh
    period = 2 * np.pi / launches.modes.omega_p
    key: Key = ("horizon", "t")
    if launches.bodies.t_end is not None:
        key = ("bodies", "path")
    elif horizon.t_decay is not None:
        key = ("horizon", "t_decay")
    elif horizon.t is None or (horizon.t_rgh is not None and horizon.t_rgh < 1):
        key = ("horizon", "t_rgh")
    endless, early = ~np.isfinite(t_end), t_end < t_rgh
    brief = (t_end < period) & (config.model == "full")
    if endless.any():
        unit = "t_rgh times t_rGH" if horizon.t_rgh is not None else "t_decay times gamma/sigma"
        words = f"{unit} is not a finite time in {sample.count(endless)}"
        which = ("horizon", unit.split()[0])
        fatal = bool(endless.all())
        yield Finding(which, f"{words}; give t as well, which then counts", fatal=fatal)
    elif brief.mean() >= MOST:
        words = f"the horizon of {_span(t_end)} is shorter than one pitch oscillation, "
        words += f"{_span(period)}, in {sample.count(brief)}, and no type can be told"
        yield Finding(key, f"{words}; give a longer one")
    elif early.mean() >= MOST and horizon.t_decay is None:
        words = "the horizon comes before t_rGH, the time of reversal by theory, in "
        words += f"{sample.count(early)}, and few will be of type R"
        median = _figure(float(np.median(t_rgh)))
        wayout = f"give t_rgh above 1, or t above {median}, the median of t_rGH"
        yield Finding(key, f"{words}; {wayout}")


def _step_findings(dt: float, sample: Sample, batch: Batch, method: Tableau) -> Iterator[Finding]:
    """Compare a fixed step with the stability of the method and with the status coarse_step."""
    key: Key = ("integrator", "dt")
    limit, fastest = stability_limit(method), batch.swing / 2
    # The span that `rattlesweep.integrate.batch.integrate` will hold against runs of that length.
    span = np.fmin(sample.launches.t_end, sample.launches.gh.t_rgh)

    def coarse(step: float) -> Flags:
        """Return the runs whose oscillation a step damps or feeds too much."""
        bad: Flags = ~(np.abs(method.damping(step * batch.relevant) * (span / step)) <= MAX_DAMPING)
        return bad

    def advice() -> str:
        """Return the largest step of 1, 2 or 5 times a power of ten that suits every run."""
        exponent = int(np.floor(np.log10(dt)))
        powers = range(exponent, exponent - 12, -1)
        for step in (digit * 10.0**power for power in powers for digit in (5, 2, 1)):
            if step < dt and not coarse(step).any() and (step * fastest < limit).all():
                return f"dt {step:g} would do for all of them"
        return "take an adaptive method"

    # At the launch's spin and without spin, which is where a reversal leads.
    slowest = np.minimum(fastest, sample.launches.modes.omega_p)
    unstable = dt * slowest > limit
    spoilt = unstable | coarse(dt)
    if unstable.all():
        words = f"{dt:g} is beyond the stability of {method.name} for {sample.count(unstable)}: "
        words += f"dt omega_p must be below {limit:.3g}, and omega_p is {_span(slowest)}"
        yield Finding(key, f"{words}; {advice()}", fatal=True)
    elif spoilt.any():
        words = f"{dt:g} is too coarse for {sample.count(spoilt)}: up to their horizons "
        words += f"{method.name} damps or feeds the oscillation by more than {100 * MAX_DAMPING:g} "
        words += "%, and they end as coarse_step or energy "
        words += f"(omega_p goes up to {fastest.max():.3g})"
        yield Finding(key, f"{words}; {advice()}")


def stability_limit(method: Tableau) -> float:
    """Return the largest phase of an oscillation in one step that the method does not blow up."""
    phase = np.arange(0.0, 20.0, 1e-3)
    growing = np.flatnonzero(method.damping(phase) < -1e-3)
    return float(phase[growing[0]]) if growing.size else np.inf


def _limit_findings(config: Config, sample: Sample, batch: Batch) -> Iterator[Finding]:
    """Compare max_steps with the horizon; an adaptive step spans less than a pitch period."""
    steps, dt = config.integrator.max_steps, config.integrator.dt
    each = f"{steps} steps of " + ("a whole pitch period each" if dt is None else f"dt {dt:g}")
    reach = steps * (4 * np.pi / batch.swing if dt is None else np.full(len(batch), dt))
    t_end, t_rgh = sample.launches.t_end, sample.launches.gh.t_rgh
    key: Key = ("integrator", "max_steps")
    wayout = f"give {_figure(float(np.max(t_end / reach)) * steps)} steps, or a shorter horizon"
    lost = reach < np.minimum(t_end, EARLY * t_rgh)
    far = reach < t_end
    if lost.all():
        words = f"{each} end at {_span(reach)}, before the horizon and before a tenth of t_rGH, "
        words += f"{_span(t_rgh)}, in {sample.count(lost)}: none can be done"
        yield Finding(key, f"{words}; {wayout}", fatal=True)
    elif far.any():
        words = f"{each} do not reach the horizon, {_span(t_end)}, in {sample.count(far)}, which "
        yield Finding(key, f"{words}end as step_limit unless they reverse; {wayout}")


def _span(values: Floats) -> str:
    low, high = _figure(float(values.min())), _figure(float(values.max()))
    return low if low == high else f"{low} to {high}"


def _figure(value: float) -> str:
    return f"{float(f'{value:.3g}'):g}"


# -- the runs that stand for a sweep ---------------------------------------------------------------


@dataclass(frozen=True)
class Sample:
    """Some runs of a plan, and words for them: "4096 runs drawn from the ranges"."""

    launches: Launches
    words: str

    def count(self, mask: Flags) -> str:
        """Return words for how many of the runs a mask holds."""
        if mask.size == 1:
            return "the only run"
        count = int(mask.sum())
        return f"all of {self.words}" if count == mask.size else f"{count} of {self.words}"


def sample_runs(plan: Plan) -> Sample:
    """Return runs that stand for those of a sweep: all if they are few, else `RUNS` of them."""
    drawn = isinstance(plan.config.bodies, SdSource)
    if isinstance(plan.config.bodies, SdSource):
        plan = replace(plan, source=DrawnBodies(plan.config.bodies))
    size = min(plan.runs, RUNS)
    runs = np.linspace(0, plan.runs - 1, size).astype(np.int64)
    words = f"the {size} runs" if size == plan.runs else f"{size} of the {plan.runs} runs"
    words = f"{size} runs drawn from the ranges" if drawn else words
    return Sample(prepare(plan, *np.divmod(runs, plan.samples)), words)


class DrawnBodies:
    """A source of random bodies; with targets, of those that come nearest to them."""

    samples = RUNS

    def __init__(self, source: SdSource) -> None:
        target = source.target
        self._bodies = draw(source, RUNS if target is None else DRAWN)
        self._targets = target.values if target else [0.0]
        if target is not None:
            found = coefficient(self._bodies, target.name)
            order = np.argsort(found)
            middle = np.searchsorted(found, target.values, sorter=order)
            first = np.clip(middle - RUNS // 2, 0, DRAWN - RUNS)
            nearest = order[np.add.outer(first, np.arange(RUNS)).ravel()]
            self._bodies = take(self._bodies, nearest)

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some runs."""
        place = {value: k for k, value in enumerate(self._targets)}
        wanted = np.nan_to_num(np.broadcast_to(target, sample.shape)).tolist()
        group = np.array([place[value] for value in wanted], dtype=np.int64)
        return take(self._bodies, group * RUNS + sample)


def draw(source: SdSource, size: int = DRAWN) -> Bodies:
    """Return bodies drawn evenly from the ranges of a source."""
    ranges = ranges_of(source)
    points = np.random.default_rng(SEED).random((len(ranges), size))
    # Intervals that hold their upper ends.
    points[:4] = 1 - points[:4]
    return drawn(bodies_of(points, ranges))


def coefficient(bodies: Bodies, name: str) -> Floats:
    """Return the torque coefficient K_p or K_r of bodies."""
    b = bodies
    with np.errstate(all="ignore"):
        found = theory.torque_coefficients(b.alpha, b.beta, b.theta, b.phi, b.xi)
    chosen: Floats = found[2 if name == "K_p" else 3]
    return chosen
