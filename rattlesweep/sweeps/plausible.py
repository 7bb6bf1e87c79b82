"""Whether a config makes physical sense: bodies that exist, steps and horizons that can do.

A config that no run of the sweep can survive is an error; what spoils some runs, or leaves them
without a result, is a warning.  Judged by theory and linear stability on a few thousand runs;
nothing is compiled and nothing integrated.  Random bodies are drawn in NumPy, since the compiled
sampler may take hours of redrawing, and always the same, so that a config always gets one answer.
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
from rattlesweep.sweeps.config.bodies import SdSource
from rattlesweep.sweeps.config.places import Key, Problem
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.launches import Launches, make_batch, prepare
from rattlesweep.sweeps.plan import Plan, make_plan

# Runs that stand for a sweep, and bodies drawn to see what targets are within reach.
RUNS, DRAWN = 4096, 65_536
SEED = 2017
# A run may reverse before t_rGH, but none was seen to in a tenth of it.
EARLY = 0.1
# Shares of runs from which on a short horizon looks like a mistake.
MOST = 0.5
# Bodies by which the density near a target is judged.
ENOUGH = 32
# The sampler draws some 1e7 bodies a second and thread.
TOO_MANY, MANY = 1e10, 1e11


class Finding(NamedTuple):
    """What makes little sense at a key; fatal if no run of the sweep can be right."""

    key: Key
    message: str
    fatal: bool = False


def checked_plan(
    config: Config, base: Path | None = None, source: Source | None = None
) -> tuple[Plan, list[str]]:
    """Plan of a config (:func:`rattlesweep.sweeps.plan.make_plan`), and its warnings.

    A warning, like each line of the ConfigError if no run can be right, is place, key, sentence.
    """
    with config.locating():
        plan = make_plan(config, base, source)
        warnings = check_physics(plan)
        if isinstance(plan.source, SdBodies):
            plan.source.check_targets()
    return plan, warnings


def check_physics(plan: Plan) -> list[str]:
    """Warnings about a plan, or a ConfigError if no run of the sweep can be right."""
    with np.errstate(all="ignore"):
        found = list(_findings(plan))
    fatal = [one for one in found if one.fatal]
    lines = plan.config.places.lines(Problem(one.key, one.message) for one in fatal or found)
    if fatal:
        raise ConfigError(lines)
    return lines


def _findings(plan: Plan) -> Iterator[Finding]:
    config = plan.config
    if isinstance(config.bodies, SdSource):
        targets = list(target_findings(config.bodies))
        yield from targets
        if any(one.fatal for one in targets):
            return
    sample = sample_runs(plan)
    yield from _horizon(config, sample)
    # Without a horizon there is nothing to judge by; the runs get a status of their own.
    if config.model == "gh" or not np.isfinite(sample.launches.t_end).all():
        return
    batch = make_batch(sample.launches, config.model)
    assert batch is not None
    method = METHODS[config.integrator.method]
    reduced = config.model == "reduced"
    if not method.adaptive and reduced:
        yield from _reduced_step(config, sample, batch)
    elif not method.adaptive:
        yield from _step(config, sample, batch, method)
    if not method.adaptive or not reduced:
        yield from _max_steps(config, sample, batch)


def target_findings(source: SdSource) -> Iterator[Finding]:
    """Targets that are out of reach in the ranges, and those that will take long."""
    target = source.target
    if target is None:
        return
    key: Key = ("bodies", "target", target.name)
    found = coefficient(draw(source), target.name)
    low, high = float(np.nanmin(found)), float(np.nanmax(found))
    wayout = "give other ranges, a larger rel_tol or another target"
    for value in target.values:
        # What lies beyond all of these takes millions of draws a body, if there is any.
        if not low <= (1 + target.rel_tol) * value or not (1 - target.rel_tol) * value <= high:
            yield Finding(
                key,
                f"{value:g} is out of reach: in {DRAWN} bodies drawn from the ranges {target.name} "
                f"lies between {low:.4g} and {high:.4g}; give a target in between or other ranges",
                fatal=True,
            )
            continue
        chance, most = _chance(found, value, target.rel_tol)
        draws = 1 / chance if chance else np.inf
        words = (
            f"{value:g} takes {'at least' if most else 'about'} {draws:.1e} draws a body, by "
            f"{DRAWN} bodies drawn from the ranges"
        )
        missed = float(np.exp(-chance * target.max_draws))
        if draws > TOO_MANY:
            yield Finding(key, f"{words}: hours for each; {wayout}", fatal=True)
        elif missed > 0.99:
            yield Finding(
                key,
                f"{words}, but max_draws is {target.max_draws}; {wayout}, or more max_draws",
                fatal=True,
            )
        elif missed * source.samples > 0.01:
            yield Finding(
                key,
                f"{words}: in max_draws = {target.max_draws} of them each of the {source.samples} "
                f"samples is missed with probability {missed:.1g}, and one miss ends the sweep; "
                f"{wayout}, or more max_draws",
            )
        elif draws * source.samples > MANY:
            yield Finding(key, f"{words}, {draws * source.samples:.1e} in all: hours; {wayout}")


def _chance(found: Floats, value: float, rel_tol: float) -> tuple[float, bool]:
    """Probability that a draw meets `value`, and whether it is only an upper limit."""
    off = np.sort(np.abs(found - value))
    inside = int(np.searchsorted(off, rel_tol * value, side="right"))
    if inside >= ENOUGH:
        return inside / len(off), False
    # The nearest bodies stand for the neighbourhood, if they are not more than half as far away.
    count = int(np.searchsorted(off, value / 2))
    place = (min(count, ENOUGH) or ENOUGH) - 1
    share = rel_tol * value / max(float(off[place]), rel_tol * value)
    return (place + 1) / len(off) * share, count == 0


def _horizon(config: Config, sample: Sample) -> Iterator[Finding]:
    launches, horizon = sample.launches, config.horizon
    key: Key = ("horizon", "t")
    if launches.bodies.t_end is not None:
        key = ("bodies", "path")
    elif horizon.t_decay is not None:
        key = ("horizon", "t_decay")
    elif horizon.t is None or (horizon.t_rgh is not None and horizon.t_rgh < 1):
        key = ("horizon", "t_rgh")
    t_end, t_rgh = launches.t_end, launches.gh.t_rgh
    period = 2 * np.pi / launches.modes.omega_p
    endless, early = ~np.isfinite(t_end), t_end < t_rgh
    brief = (t_end < period) & (config.model not in ("reduced", "gh"))
    if endless.any():
        name, what = "t_rgh", "t_rgh times t_rGH"
        if horizon.t_rgh is None:
            name, what = "t_decay", "t_decay times gamma/sigma"
        yield Finding(
            ("horizon", name),
            f"{what} is not a finite time in {sample.told(endless)}; give t as well, which then "
            "counts",
            fatal=bool(endless.all()),
        )
    elif brief.mean() >= MOST:
        yield Finding(
            key,
            f"the horizon of {_span(t_end)} is shorter than one pitch oscillation, {_span(period)},"
            f" in {sample.told(brief)}, and no type can be told; give a longer one",
        )
    elif early.mean() >= MOST and horizon.t_decay is None:
        yield Finding(
            key,
            f"the horizon comes before t_rGH, the time of reversal by theory, in "
            f"{sample.told(early)}, and few will be of type R; give t_rgh above 1, or t above "
            f"{_figure(float(np.median(t_rgh)))}, the median of t_rGH",
        )


def _step(config: Config, sample: Sample, batch: Batch, method: Tableau) -> Iterator[Finding]:
    """A fixed step against the oscillations: stability first, then the status coarse_step."""
    dt = config.integrator.dt
    assert dt is not None
    key: Key = ("integrator", "dt")
    limit = stability_limit(method)
    fastest = batch.swing / 2
    # What `rattlesweep.integrate.batch.integrate` will hold against runs of that length.
    span = np.fmin(sample.launches.t_end, sample.launches.gh.t_rgh)

    def coarse(step: float) -> Flags:
        """Runs whose oscillation a step damps or feeds too much."""
        bad: Flags = ~(np.abs(method.damping(step * batch.relevant) * (span / step)) <= MAX_DAMPING)
        return bad

    def advice() -> str:
        """The largest step of 1, 2 or 5 times a power of ten with which every run would do."""
        exponent = int(np.floor(np.log10(dt)))
        for power in range(exponent, exponent - 12, -1):
            for step in (digit * 10.0**power for digit in (5, 2, 1)):
                if step < dt and not coarse(step).any() and (step * fastest < limit).all():
                    return f"dt {step:g} would do for all of them"
        return "take an adaptive method"

    # At the launch's spin and without spin, which is where a reversal leads.
    slowest = np.minimum(fastest, sample.launches.modes.omega_p)
    unstable = dt * slowest > limit
    spoilt = unstable | coarse(dt)
    if unstable.all():
        yield Finding(
            key,
            f"{dt:g} is beyond the stability of {method.name} for {sample.told(unstable)}: dt "
            f"omega_p must be below {limit:.3g}, and omega_p is {_span(slowest)}; {advice()}",
            fatal=True,
        )
    elif spoilt.any():
        yield Finding(
            key,
            f"{dt:g} is too coarse for {sample.told(spoilt)}: up to their horizons {method.name} "
            f"damps or feeds the oscillation by more than {100 * MAX_DAMPING:g} %, and they end as "
            f"coarse_step or energy (omega_p goes up to {fastest.max():.3g}); {advice()}",
        )


def stability_limit(method: Tableau) -> float:
    """Largest phase of an oscillation in one step that the method does not blow up."""
    phase = np.arange(0.0, 20.0, 1e-3)
    growing = np.flatnonzero(method.damping(phase) < -1e-3)
    return float(phase[growing[0]]) if growing.size else np.inf


def _reduced_step(config: Config, sample: Sample, batch: Batch) -> Iterator[Finding]:
    """A fixed step against the growth of the reduced model, which does not oscillate."""
    dt = config.integrator.dt
    assert dt is not None
    coarse = dt * batch.swing > 1
    if coarse.any():
        yield Finding(
            ("integrator", "dt"),
            f"{dt:g} is longer than the oscillation's energy takes to grow e-fold, "
            f"{_span(1 / batch.swing)}, in {sample.told(coarse)}; give a tenth of that or less",
        )


def _max_steps(config: Config, sample: Sample, batch: Batch) -> Iterator[Finding]:
    """Steps allowed against the horizon; an adaptive step spans less than a pitch period."""
    steps, dt = config.integrator.max_steps, config.integrator.dt
    each = "of a whole pitch period each" if dt is None else f"of dt {dt:g}"
    length = 4 * np.pi / batch.swing if dt is None else np.full(len(batch), dt)
    reach = steps * length
    t_end, t_rgh = sample.launches.t_end, sample.launches.gh.t_rgh
    key: Key = ("integrator", "max_steps")
    wayout = f"give {_figure(float(np.max(t_end / reach)) * steps)} steps, or a shorter horizon"
    lost = reach < np.minimum(t_end, EARLY * t_rgh)
    far = reach < t_end
    if lost.all():
        yield Finding(
            key,
            f"{steps} steps {each} end at {_span(reach)}, before the horizon and before a tenth of "
            f"t_rGH, {_span(t_rgh)}, in {sample.told(lost)}: none can be done; {wayout}",
            fatal=True,
        )
    elif far.any():
        yield Finding(
            key,
            f"{steps} steps {each} do not reach the horizon, {_span(t_end)}, in "
            f"{sample.told(far)}, which end as step_limit unless they reverse; {wayout}",
        )


def _span(values: Floats) -> str:
    low, high = _figure(float(values.min())), _figure(float(values.max()))
    return low if low == high else f"{low} to {high}"


def _figure(value: float) -> str:
    return f"{float(f'{value:.3g}'):g}"


# -- the runs by which it is judged --------------------------------------------------------------


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
    bodies = plan.config.bodies
    if isinstance(bodies, SdSource):
        plan = replace(plan, source=DrawnBodies(bodies))
    size = min(plan.runs, RUNS)
    runs = np.linspace(0, plan.runs - 1, size).astype(np.int64)
    words = f"the {size} runs" if size == plan.runs else f"{size} of the {plan.runs} runs"
    if isinstance(bodies, SdSource):
        words = f"{size} runs drawn from the ranges"
    return Sample(prepare(plan, *np.divmod(runs, plan.samples)), words)


class DrawnBodies:
    """A source of random bodies: with targets, of those that come nearest to them."""

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
    """Bodies drawn evenly from the ranges of a source."""
    ranges = ranges_of(source)
    points = np.random.default_rng(SEED).random((len(ranges), size))
    # From the upper ends of all ranges.
    points[:4] = 1 - points[:4]
    return drawn(bodies_of(points, ranges))


def coefficient(bodies: Bodies, name: str) -> Floats:
    """The torque coefficient K_p or K_r of bodies."""
    b = bodies
    with np.errstate(all="ignore"):
        found = theory.torque_coefficients(b.alpha, b.beta, b.theta, b.phi, b.xi)
    chosen: Floats = found[2 if name == "K_p" else 3]
    return chosen
