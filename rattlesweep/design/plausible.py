"""Doubts about a plan: theory judges a sample of the runs before they begin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from rattlesweep.arrays import Flags, Floats
from rattlesweep.config.body_sources import SdSource, Target
from rattlesweep.config.schema import Config
from rattlesweep.design.bodies.sources import bodies_at, ranges_of
from rattlesweep.design.bodies.table import TableBodies
from rattlesweep.design.plan import Plan
from rattlesweep.design.prepare import prepare_launches
from rattlesweep.physics import si, theory
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.physics.si import check_spins
from rattlesweep.rows.prepared import Bodies, PreparedRuns
from rattlesweep.statistics.tails import LEAST_INDEX, tail_index
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import CONSTANT_OF_SURFACE

_MOST_RUNS = 4096  # runs that are judged
BODIES_DRAWN = 65_536  # bodies drawn to find the range of a target's coefficient
_SEED = 2017
NEARLY_ZERO = 1e-12  # of the largest spin


def check_physics(plan: Plan) -> list[str]:
    """Return warnings about a plan; raise a ConfigError if no run of it makes sense."""
    config = plan.config
    which = f"the {plan.runs} runs"
    with config.locating(), np.errstate(all="ignore"):
        if isinstance(config.bodies, SdSource):
            which = f"{_MOST_RUNS} runs drawn from the ranges"
            plan = replace(
                plan, source=_drawn_bodies(config.bodies), samples=_MOST_RUNS
            )
        elif plan.runs > _MOST_RUNS:
            which = f"{_MOST_RUNS} of the {plan.runs} runs"
        judged = min(plan.runs, _MOST_RUNS)
        numbers = np.linspace(0, plan.runs - 1, judged).astype(np.int64)
        case, sample = np.divmod(numbers, plan.samples)
        launches = prepare_launches(plan, case, sample)
        warnings = [*_doubts(config, launches, which), *_near_taps(config, launches)]
        warnings += _doubts_of_sizes(launches)
        return [config.located(warning) for warning in warnings]


def _doubts(config: Config, launches: PreparedRuns, which: str) -> Iterator[str]:
    """Yield warnings about horizons; raise a ConfigError if no run has one."""
    horizon = config.horizon
    t_rgh = launches.gh.t_rgh
    is_endless = ~np.isfinite(launches.horizon)
    # False without spin, where t_rGH is NaN.
    is_early = launches.horizon < t_rgh
    if is_endless.any():
        name = "t_decay"
        unit = "gamma/sigma"
        if horizon.t_rgh:
            name = "t_rgh"
            unit = "t_rGH"
        problem = (
            f"horizon.{name}: {name} times {unit} is not a finite time in "
            f"{_how_many(is_endless, which)}; give t as well"
        )
        if is_endless.all():
            raise ConfigError(problem)
        yield problem
    yield from _doubts_of_means(config, launches)
    if not is_endless.any() and is_early.mean() >= 0.5 and horizon.t_decay is None:
        key = "horizon.t_rgh"
        if launches.bodies.t_end is not None:
            key = "bodies.path"
        elif horizon.t:
            key = "horizon.t"
        yield (
            f"{key}: the horizon comes before t_rGH, the reversal time of theory, in "
            f"{_how_many(is_early, which)}, so few will be of type R; give t_rgh above "
            f"1, or t above {np.nanmedian(t_rgh):.3g}, the median of t_rGH"
        )


def _doubts_of_means(config: Config, launches: PreparedRuns) -> Iterator[str]:
    """Yield a warning if reversal times of theory have no mean, and a mean is asked."""
    if config.stop is None or config.stop.t_r is None:
        return
    t_rgh = launches.gh.t_rgh
    index = tail_index(t_rgh[t_rgh < launches.horizon])
    if index < LEAST_INDEX:
        yield (
            "stop.t_r: the mean of t_r may not exist, as t_rGH goes as 1/xi and its "
            f"tail index is {index:.2g}, below {LEAST_INDEX:g}; such cases run "
            "all samples; give t_r_median, or skews that are not close to 0"
        )


def _near_taps(config: Config, launches: PreparedRuns) -> Iterator[str]:
    """Yield a question about spins that seem to be rounding errors of zero."""
    key = "spin.n_i"
    if launches.bodies.n_i is not None:
        key = "bodies.path"
    # The spin of a full state is computed, and need not be zero to the last bit.
    if launches.bodies.omega is None:
        question = near_tap(launches.n_i)
        if question is not None:
            yield f"{key}: {question}"


def _doubts_of_sizes(launches: PreparedRuns) -> Iterator[str]:
    """Yield warnings about bodies with a size; raise for spins that no hand gives."""
    bodies = launches.bodies
    if bodies.units is None:
        return
    for name, rates in (("n_i", launches.n_i), ("omega_xy0", launches.omega_xy0)):
        check_spins(f"spin.{name}", rates, bodies.units)
    for doubt in si.doubts(bodies.units, bodies.gamma, bodies.xi):
        yield f"bodies: {doubt}"


def near_tap(n_i: Floats) -> str | None:
    """Return a question about a spin that is tiny beside the others, None without.

    A tap, whose spin is zero, and a launch whose spin is 1e-16 of others reverse at
    quite other times.
    """
    size = np.abs(n_i)
    tiny = (size > 0) & (size < NEARLY_ZERO * size.max(initial=0))
    if not tiny.any():
        return None
    first = n_i[np.argmax(tiny)]
    return (
        f"{first:.3g} is a rounding error beside {size.max():.3g}; is 0 meant, a tap?"
    )


def _how_many(mask: Flags, which: str) -> str:
    """Return how many of `which` runs a mask selects, in words."""
    if len(mask) == 1:
        return "the only run"
    if mask.all():
        return f"all of {which}"
    return f"{mask.sum()} of {which}"


def _drawn_bodies(source: SdSource) -> TableBodies:
    """Return bodies drawn by NumPy, without targets.

    For a target the sampler may take hours.
    """
    ranges = ranges_of(source)
    points = np.random.default_rng(_SEED).random((len(ranges), BODIES_DRAWN))
    bodies = bodies_at(points, ranges, CONSTANT_OF_SURFACE[source.bottom])
    if source.target is not None:
        _check_reach(bodies, source.target)
    columns = {name: getattr(bodies, name) for name in (*PARAMETERS, "f_sd")}
    return TableBodies(columns | bodies.further)


def _check_reach(bodies: Bodies, target: Target) -> None:
    """Raise a ConfigError if no body comes near a value of a target."""
    *_, K_p, K_r = theory.torque_coefficients(
        bodies.alpha, bodies.beta, bodies.theta, bodies.phi, bodies.xi
    )
    coefficient = K_p if target.name == "K_p" else K_r
    low = np.nanmin(coefficient)
    high = np.nanmax(coefficient)
    for value in target.values:
        if abs(value - np.clip(value, low, high)) > target.rel_tol * value:
            raise ConfigError(
                f"bodies.target.{target.name}: {value:g} is out of reach: in "
                f"{BODIES_DRAWN} bodies drawn from the ranges {target.name} lies "
                f"between {low:.4g} and {high:.4g}"
            )
