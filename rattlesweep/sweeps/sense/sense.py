"""Whether a config makes physical sense: bodies that exist, steps and horizons that can do.

A config that no run of the sweep can survive is an error; what spoils some runs, or leaves them
without a result, is a warning.  Judged by theory and linear stability on a few thousand runs
(:mod:`rattlesweep.sweeps.sense.sample`); nothing is compiled and nothing integrated.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import MAX_DAMPING
from rattlesweep.integrate.tableau import METHODS, Tableau
from rattlesweep.sweeps.cases.launches import make_batch
from rattlesweep.sweeps.cases.plan import Plan, make_plan
from rattlesweep.sweeps.cases.sources import SdBodies
from rattlesweep.sweeps.config.bodies import SdSource
from rattlesweep.sweeps.config.places import Key, Problem
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.sense.sample import Sample, sample_runs
from rattlesweep.sweeps.sense.targets import target_problems

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.integrate.batch import Batch

    Floats = NDArray[np.float64]
    Mask = NDArray[np.bool_]

# A run may reverse before t_rGH, but none was seen to in a tenth of it.
EARLY = 0.1
# Shares of runs from which on a short horizon looks like a mistake.
MOST = 0.5


class _Finding(NamedTuple):
    key: Key
    message: str
    fatal: bool


def checked_plan(config: Config, base: Path | None = None) -> tuple[Plan, list[str]]:
    """Plan of a config, and one line for everything that makes little physical sense.

    Parameters
    ----------
    config : Config
    base : Path, optional
        See :func:`rattlesweep.sweeps.cases.plan.make_plan`.

    Returns
    -------
    tuple
        The plan, and the warnings: place, key, sentence.

    Raises
    ------
    ConfigError
        If the plan cannot be made, or if none of its runs can be right; each line names file, line
        and column of the key where they are known.
    """
    with config.locating():
        plan = make_plan(config, base)
    warnings = check_physics(plan)
    if isinstance(plan.source, SdBodies):
        with config.locating():
            plan.source.check_targets()
    return plan, warnings


def check_physics(plan: Plan) -> list[str]:
    """Warnings about a plan: place, key, sentence.

    Raises
    ------
    ConfigError
        If no run of the sweep can be right.
    """
    with np.errstate(all="ignore"):
        found = list(_findings(plan))
    places = plan.config.places
    if any(one.fatal for one in found):
        raise ConfigError(places.lines(Problem(one.key, one.message) for one in found if one.fatal))
    return places.lines(Problem(one.key, one.message) for one in found)


def _findings(plan: Plan) -> Iterator[_Finding]:
    config = plan.config
    bodies = config.bodies
    if isinstance(bodies, SdSource) and bodies.target is not None:
        key: Key = ("bodies", "target", bodies.target.name)
        problems = [_Finding(key, *problem) for problem in target_problems(bodies)]
        yield from problems
        if any(one.fatal for one in problems):
            return
    sample = sample_runs(plan)
    yield from _horizon(config, sample)
    launches = sample.launches
    # Without a horizon there is nothing to judge by; the runs get a status of their own.
    if config.model == "gh" or not np.isfinite(launches.t_end).all():
        return
    batch = make_batch(launches, config.model)
    assert batch is not None
    method = METHODS[config.integrator.method]
    if not method.adaptive and config.model == "full":
        yield from _step(config, sample, batch, method)
    elif not method.adaptive:
        yield from _reduced_step(config, sample, batch)
    if not method.adaptive or config.model == "full":
        yield from _max_steps(config, sample, batch)


def _told(mask: Mask, sample: Sample) -> str:
    if mask.size == 1:
        return "the only run"
    count = int(mask.sum())
    return f"all of {sample.words}" if count == mask.size else f"{count} of {sample.words}"


def _horizon(config: Config, sample: Sample) -> Iterator[_Finding]:
    launches = sample.launches
    horizon = config.horizon
    rows = launches.bodies.t_end is not None
    key: Key = ("bodies", "path") if rows else ("horizon", "t")
    if not rows and (horizon.t is None or (horizon.t_rgh is not None and horizon.t_rgh < 1)):
        key = ("horizon", "t_rgh")
    endless = ~np.isfinite(launches.t_end)
    if endless.any():
        yield _Finding(
            ("horizon", "t_rgh"),
            f"t_rgh times t_rGH is not a finite time in {_told(endless, sample)}; give t as well, "
            "which then counts",
            bool(endless.all()),
        )
        return
    t_end, t_rgh = launches.t_end, launches.gh.t_rgh
    period = 2 * np.pi / launches.modes.omega_p
    brief = (t_end < period) & (config.model == "full")
    early = t_end < t_rgh
    if brief.mean() >= MOST:
        yield _Finding(
            key,
            f"the horizon of {_span(t_end)} is shorter than one pitch oscillation, {_span(period)},"
            f" in {_told(brief, sample)}, and no type can be told; give a longer one",
            False,
        )
    elif early.mean() >= MOST:
        yield _Finding(
            key,
            f"the horizon comes before t_rGH, the time of reversal by theory, in "
            f"{_told(early, sample)}, and few will be of type R; give t_rgh above 1, or t above "
            f"{_figure(float(np.median(t_rgh)))}, the median of t_rGH",
            False,
        )


def _step(config: Config, sample: Sample, batch: Batch, method: Tableau) -> Iterator[_Finding]:
    """A fixed step against the oscillations: stability first, then the status coarse_step."""
    dt = config.integrator.dt
    assert dt is not None
    key: Key = ("integrator", "dt")
    limit = stability_limit(method)
    # At the launch's spin and without spin, which is where a reversal leads.
    slowest = np.minimum(batch.swing / 2, sample.launches.modes.omega_p)
    fits = _largest_step(sample, batch, method, dt)
    unstable = dt * slowest > limit
    if unstable.all():
        yield _Finding(
            key,
            f"{dt:g} is beyond the stability of {method.name} for {_told(unstable, sample)}: dt "
            f"omega_p must be below {limit:.3g}, and omega_p is {_span(slowest)}; {fits}",
            True,
        )
        return
    damping = _damping(sample, batch, method, dt)
    coarse = unstable | ~(np.abs(damping) <= MAX_DAMPING)
    if coarse.any():
        fastest = float(np.max(batch.swing / 2))
        yield _Finding(
            key,
            f"{dt:g} is too coarse for {_told(coarse, sample)}: up to their horizons {method.name} "
            f"damps or feeds the oscillation by more than {100 * MAX_DAMPING:g} %, and they end as "
            f"coarse_step or energy (omega_p goes up to {fastest:.3g}); {fits}",
            False,
        )


def _reduced_step(config: Config, sample: Sample, batch: Batch) -> Iterator[_Finding]:
    """A fixed step against the growth of the reduced model, which does not oscillate."""
    dt = config.integrator.dt
    assert dt is not None
    coarse = dt * batch.swing > 1
    if coarse.any():
        yield _Finding(
            ("integrator", "dt"),
            f"{dt:g} is longer than the oscillation's energy takes to grow e-fold, "
            f"{_span(1 / batch.swing)}, in {_told(coarse, sample)}; give a tenth of that or less",
            False,
        )


def _damping(sample: Sample, batch: Batch, method: Tableau, dt: float) -> Floats:
    """What :func:`rattlesweep.integrate.batch.integrate` will hold against runs of that length."""
    span = np.minimum(sample.launches.t_end, sample.launches.gh.t_rgh)
    found: Floats = method.damping(dt * batch.relevant) * (span / dt)
    return found


def _largest_step(sample: Sample, batch: Batch, method: Tableau, dt: float) -> str:
    """Advice: the largest step of 1, 2 or 5 times a power of ten with which every run would do."""
    exponent = int(np.floor(np.log10(dt)))
    for power in range(exponent, exponent - 12, -1):
        for digit in (5, 2, 1):
            step = digit * 10.0**power
            if step < dt and (
                np.abs(_damping(sample, batch, method, step)) <= MAX_DAMPING
            ).all() and (step * batch.swing / 2 < stability_limit(method)).all():  # fmt: skip
                return f"dt {step:g} would do for all of them"
    return "take an adaptive method"


def stability_limit(method: Tableau) -> float:
    """Largest phase of an oscillation in one step that the method does not blow up."""
    phase = np.arange(0.0, 20.0, 1e-3)
    growing = np.flatnonzero(method.damping(phase) < -1e-3)
    return float(phase[growing[0]]) if growing.size else np.inf


def _max_steps(config: Config, sample: Sample, batch: Batch) -> Iterator[_Finding]:
    """Steps allowed against the horizon; an adaptive step spans less than a pitch period."""
    steps, dt = config.integrator.max_steps, config.integrator.dt
    period = 4 * np.pi / batch.swing
    reach = np.full(len(batch), steps * dt) if dt is not None else steps * period
    each = f"of dt {dt:g}" if dt is not None else "of a whole pitch period each"
    t_end, t_rgh = sample.launches.t_end, sample.launches.gh.t_rgh
    key: Key = ("integrator", "max_steps")
    least = f"{_figure(float(np.max(t_end / reach)) * steps)} steps"
    lost = reach < np.minimum(t_end, EARLY * t_rgh)
    far = reach < t_end
    if lost.all():
        yield _Finding(
            key,
            f"{steps} steps {each} end at {_span(reach)}, before the horizon and before a tenth of "
            f"t_rGH, {_span(t_rgh)}, in {_told(lost, sample)}: none can be done; give {least}, or "
            "a shorter horizon",
            True,
        )
    elif far.any():
        yield _Finding(
            key,
            f"{steps} steps {each} do not reach the horizon, {_span(t_end)}, in "
            f"{_told(far, sample)}, which end as step_limit unless they reverse; give {least}, or "
            "a shorter horizon",
            False,
        )


def _span(values: Floats) -> str:
    low, high = _figure(float(values.min())), _figure(float(values.max()))
    return low if low == high else f"{low} to {high}"


def _figure(value: float) -> str:
    return f"{float(f'{value:.3g}'):g}"
