"""Errors of reversal times, from companions: the same runs at a looser tolerance.

With d = abs(t_r'/t_r - 1), where t_r' is the reversal time of the companion, and s the
distance of the two states at their reversals in the norm of the step control,

    t_r_error / t_r
        = (floor + near r) tol + slope T (d + share s / sqrt(N)) + C + G + S,
    T = max((r + near r^2)^power, P),   P = min(1, (s / PARTED)^2),
    r = tol / tol',   N = n_steps / 1000,

The estimate is at most 1, and is 1 if the companion does not reverse.  The second term
scales the difference down to the tighter tolerance as long as the two runs stay
together (small s), and takes all of it once they have parted.  Too often d alone is
small by chance; s, which has several components, is not.  C is P^2 in the unsteady
direction, where runs that part are chaotic, and 0 in the other.  G is a swing of the
spin, or several, if an extremum of the spin touches zero within the tolerance.  S is a
constant if the run slides, since the errors of slides change much from one tolerance to
the next.

**Swinging launches** hold most of their energy in the oscillation, often in the slower
of two modes.  The tolerance is relative to both modes together.  So a companion would
take steps up to the limit of stability, six radians of the faster mode, where the
method damps this mode away, and where the errors of successive steps cancel each
other.  In the shorter steps of the run they have the same sign and add up.  The
difference d would then be far too small.  Therefore companions of these launches take
steps of at most COMPANION_ANGLE.  In T, r is then at least (n_steps'/n_steps)^order,
and the weight of s is SWINGING_SHARE, as these errors do not average out.  Where a body
may slide, their estimate is multiplied by a factor of its own.

**Pulled bodies** rock so hard that the plane would have to pull them.  There is no
friction while it would, so the torque against pivoting has a kink where it ends and
where it begins again.  No step ends there.  The step control keeps the errors of such
steps below the tolerance, but they have any sign and do not fall with its order: a
tolerance a hundred times tighter may leave the error of the reversal as it was.  So T
is at least r^PULLED_POWER for these runs, and the weight of s is PULLED_SHARE.

With `accuracy: {t_r: ...}`, runs with a larger estimate are integrated again, a hundred
times tighter, with the previous run as their companion; and then once more.  A
companion that has itself diverged from its own companion may be near the run by chance.
So T is at least a tenth of (s' / PARTED)^2, where s' is the distance of these two.

If reversals are recorded too, runs that end at their first reversal are also integrated
to the horizon.  The error of a later turn follows from the largest d up to this turn,
with P = min(1, (d / TURN_PARTED)^2) and s = 0.  ``benchmarks/errors.py`` fits the
constants.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers, put, take
from rattlesweep.config.schema import Config
from rattlesweep.design.models import model_of
from rattlesweep.kernel.batch import integrate, stride
from rattlesweep.kernel.method.tableau import DT, MAX_STEPS, METHODS, TOL
from rattlesweep.kernel.outcome import Batch, Estimated, Outcome, has_settled
from rattlesweep.kernel.state.fields import MOST_REVERSALS
from rattlesweep.kernel.state.status import Status
from rattlesweep.kernel.task import Control
from rattlesweep.motion.model import Model
from rattlesweep.physics import full
from rattlesweep.work.error_fit import TIGHTEST, fit_of

LEAST_LOOSER = 10.0  # smallest ratio of the companion's tolerance to the run's
LOOSEST = 1e-5  # largest tolerance of a companion; at larger ones most runs part
PARTED = 0.2  # distance at which two runs have become independent
# Minimum weight of d when the companion itself had diverged from its own companion.
REMEMBERED = 0.1
# Share of the squared amplitude at launch below which a mode is at rest.
DECAYED = 1e-16

# A launch is swinging if its oscillation has this many times the energy of its spin.
SWINGING = 3.0
COMPANION_ANGLE = 2.0  # longest step of its companion, in radians of the faster mode
SWINGING_SHARE = 0.01  # weight of its distance s
# Largest r from the numbers of steps: at 1 the companion is as accurate as the run.
MOST_RATIO = 0.6

# Where the plane would have to pull the body: power of r in T, and weight of s.
PULLED_POWER = 0.3
PULLED_SHARE = 0.25

TURN_PARTED = 5e-3  # relative difference of turns at which two runs have parted
TURN_SLOPE = 50.0  # slope of the errors of turns
SURE_TURN = 1e-3  # relative error below which a turn is sure, if those before it are

# Tolerances for a given error: the first in units of it (and of the floor of the
# estimate, if that is above 1), the ratio of the next ones, their number.
FIRST_RUNG = 0.3
RUNG = 1e-2
RUNGS = 3
# The loosest of these tolerances, and of their companions, where runs part early and so
# tell best. With companions at 1e-5, runs agree by chance: 6 of 4,886 were off by more
# than 1e-4.
LOOSEST_RUNG = 1e-6
LOOSEST_OF_LADDER = 1e-4
# Cost of each repetition, relative to that of all runs at the first tolerance.
AGAIN = (0.4, 0.1)
# Error of amp_growth and n_departure over their difference from the companion.
DIFFER = 10.0


def integrate_estimated(
    config: Config, batch: Batch, threads: int | None, control: Control
) -> Estimated:
    """Integrate companions and runs, and again more tightly those of large error."""
    stages = _Stages(config, threads, control)
    companions = stages.integrate(batch, rung=0, record=frozenset())
    # Companions tell the cost of each run, so the longest begin first and no lane
    # waits.
    runs = stages.integrate(batch, 1, stages.record, companions.n_steps)
    estimated = with_errors(config, batch, runs, companions, stages.settings(1))
    _repeat_inaccurate(stages, batch, runs, estimated)
    if stages.has_turns:
        estimated = _with_later_turns(stages, batch, estimated)
    stopped = bool((estimated.status == Status.STOPPED).any())
    return replace(estimated, stopped=stopped)


class Settings(NamedTuple):
    """Tolerances of runs and of their companions; steps, for methods of fixed steps."""

    runs: float
    companions: float


class _Stages:
    """Integrations of a block one after another, each a stage of the control."""

    def __init__(self, config: Config, threads: int | None, control: Control) -> None:
        self.config = config
        self.control = control
        self.has_turns = "reversals" in config.record
        # Turns are recorded last, in runs to the horizon.
        self.record = frozenset(config.record) - {"reversals"}
        self.rungs, costs = ladder(config)
        if self.has_turns:
            # Companions and runs once more, to the horizon.
            costs = [*costs, *costs[:2]]
        # Whether later stages may integrate some of the runs again.
        self._repeats = len(costs) > 2
        ends = np.cumsum([0.0, *costs])
        self._ends = ends / ends[-1]
        self._stage = 0  # the next one
        self._threads = threads

    def settings(self, rung: int) -> Settings:
        """Return the settings of the runs on a rung and of their companions."""
        return Settings(self.rungs[rung], self.rungs[rung - 1])

    def integrate(
        self,
        batch: Batch,
        rung: int,
        record: frozenset[str],
        cost: Integers | None = None,
    ) -> Outcome:
        """Integrate runs with the setting of a rung; rung 0 has the companions."""
        integrator = self.config.integrator
        tableau = METHODS[integrator.method]
        model = model_of(self.config)
        # Runs, unlike companions, are done when they end if no stage repeats them.
        ends_runs = self._stage == 1 and not self._repeats
        begin = self._ends[self._stage]
        end = self._ends[self._stage + 1]
        self.control.stage(begin, end, ends=ends_runs)
        self._stage += 1
        max_steps = integrator.max_steps
        longest_step = None
        if rung == 0:
            # A companion's limit of steps must not change the error of its run.
            max_steps = max(max_steps, MAX_STEPS)
            longest_step = longest_companion_steps(batch, model)
        return integrate(
            batch,
            tableau,
            model,
            tol=self.rungs[rung] if tableau.adaptive else TOL,
            dt=DT if tableau.adaptive else self.rungs[rung],
            max_steps=max_steps,
            longest_step=longest_step,
            record=record,
            cost=cost,
            threads=self._threads,
            control=self.control,
        )

    def count_ended(self, estimated: Estimated, goes_on: Flags) -> None:
        """Tell the control how many runs do not go on to a later stage."""
        ended = ~goes_on & (estimated.status != Status.STOPPED)
        self.control.count_ended(int(ended.sum()))


def _repeat_inaccurate(
    stages: _Stages, batch: Batch, runs: Outcome, estimated: Estimated
) -> None:
    """Integrate runs again on tighter rungs, until their error is as small as asked.

    The rows of repeated runs in `estimated` are replaced.
    """
    goal = stages.config.integrator.goal or np.inf
    rows = np.arange(len(batch))
    latest = estimated
    for rung in range(2, len(stages.rungs)):
        again = _misses(latest, goal)
        if not again.any():
            break
        stages.count_ended(latest, again)
        rows = rows[again]
        batch = take(batch, again)
        companions = take(runs, again)
        distance_before = latest.apart[again]
        runs = stages.integrate(batch, rung, stages.record, companions.n_steps)
        latest = with_errors(
            stages.config,
            batch,
            runs,
            companions,
            stages.settings(rung),
            distance_before,
        )
        put(latest, estimated, rows)


def _misses(estimated: Estimated, goal: float) -> Flags:
    """Return the runs that have failed, or whose reversal is not as good as asked."""
    is_inaccurate = estimated.t_r_error > goal * estimated.t_r
    # Only the companion reverses.
    has_missed = np.isnan(estimated.t_r) & np.isfinite(estimated.companion_t_r)
    is_ok = estimated.status == Status.OK
    no_failure = (Status.OK, Status.STEP_LIMIT, Status.STOPPED)
    has_failed = ~np.isin(estimated.status, no_failure)
    return (is_inaccurate | has_missed) & is_ok | has_failed


def _with_later_turns(stages: _Stages, batch: Batch, estimated: Estimated) -> Estimated:
    """Integrate runs that ended at their first reversal to the horizon, with turns."""
    empty = np.full((len(batch), MOST_REVERSALS, 2), np.nan)
    estimated = replace(estimated, reversals=empty, turn_errors=empty[:, :, 0].copy())
    goes_on = (estimated.status == Status.OK) & (estimated.t_end < batch.t_end)
    stages.count_ended(estimated, goes_on)
    batch = take(batch, goes_on)
    to_reversal = take(estimated, goes_on)
    turns = frozenset({"reversals"})
    companions = stages.integrate(batch, 0, turns)
    runs = stages.integrate(batch, 1, stages.record | turns, companions.n_steps)
    settings = stages.settings(1)
    to_horizon = with_errors(stages.config, batch, runs, companions, settings)
    scale = _Scale(stages.config, settings)
    to_horizon = _with_turns(to_horizon, to_reversal, companions, scale)
    put(to_horizon, estimated, np.flatnonzero(goes_on))
    return estimated


def ladder(config: Config) -> tuple[list[float], list[float]]:
    """Return tolerances (or steps) of companions, runs and repetitions, and costs."""
    integrator = config.integrator
    tableau = METHODS[integrator.method]
    if not tableau.adaptive:
        dt = integrator.dt or DT
        return [companion_setting(config, dt), dt], [0.5, 1.0]
    if integrator.goal is None:
        tol = integrator.tol or TOL
        values = [companion_setting(config, tol), tol]
    else:
        fit = fit_of(config)
        # Else the floor of the estimate alone could be above the goal.
        first = FIRST_RUNG * integrator.goal / max(1.0, fit.floor)
        first = min(first, LOOSEST_RUNG)
        rungs = {max(first * RUNG**k, TIGHTEST) for k in range(RUNGS)}
        loosest = min(fit.looser * first, LOOSEST_OF_LADDER)
        values = [loosest, *sorted(rungs, reverse=True)]
    # 1.1 for rejected steps; measured costs are 40 to 45 % at 1e-9, and 77 to 84 % at
    # 1e-6.
    companion = 1.1 * float((values[1] / values[0]) ** (1.0 / tableau.order))
    return values, [companion, 1.0, *AGAIN[: len(values) - 2]]


def companion_setting(config: Config, value: float) -> float:
    """Return a companion's tolerance; for methods of fixed steps, twice the step."""
    if not METHODS[config.integrator.method].adaptive:
        return 2.0 * value
    return max(LEAST_LOOSER * value, min(fit_of(config).looser * value, LOOSEST))


def is_swinging(batch: Batch, model: Model) -> Flags:
    """Return the launches that hold most of their energy in the oscillation."""
    if model.chart is None:  # its steps do not follow the oscillation
        return np.zeros(len(batch), dtype=bool)
    # The square of the spin that would have the energy of the oscillation.
    oscillation = batch.rate / batch.swing
    swinging: Flags = oscillation > SWINGING * batch.scale**2
    return batch.tapped | swinging


def longest_companion_steps(batch: Batch, model: Model) -> Floats:
    """Return the longest steps that companions may take, in ``sqrt(a/g)``."""
    # The spin swings at twice the frequency of the faster mode.
    limit = 2.0 * COMPANION_ANGLE / batch.swing
    return np.where(is_swinging(batch, model), limit, np.inf)


class _Scale:
    """Constants of an estimate, and the ratio of the errors of runs and companions.

    `common` is the first term of the estimate, `ratio` is r.
    """

    def __init__(self, config: Config, settings: Settings) -> None:
        tableau = METHODS[config.integrator.method]
        self.fit = fit_of(config)
        self.order = tableau.order
        self.adaptive = tableau.adaptive
        self.ratio = settings.runs / settings.companions
        tol = settings.runs
        if not tableau.adaptive:  # the errors of fixed steps are systematic
            self.ratio **= tableau.order
            tol = 0.0
        of_steps = self.fit.floor + self.fit.near * self.ratio
        self.common = of_steps * max(tol, self.fit.tightest)

    def carried(self, ratio: Floats | float) -> Floats:
        """Return the part of a difference that the run has, for a ratio r of errors."""
        return (ratio + self.fit.near * ratio**2) ** self.fit.power


class _Pair(NamedTuple):
    """Runs and their companions."""

    runs: Outcome
    companions: Outcome

    @property
    def both_reverse(self) -> Flags:
        return np.isfinite(self.runs.t_r) & np.isfinite(self.companions.t_r)

    @property
    def both_ok(self) -> Flags:
        runs_ok = self.runs.status == Status.OK
        return runs_ok & (self.companions.status == Status.OK)

    @property
    def both_stay(self) -> Flags:
        """Whether neither reverses by the horizon."""
        no_reversal = np.isnan(self.runs.t_r) & np.isnan(self.companions.t_r)
        return self.both_ok & no_reversal

    @property
    def grazes(self) -> Integers:
        return self.runs.near_tangencies + self.companions.near_tangencies


def with_errors(
    config: Config,
    batch: Batch,
    runs: Outcome,
    companions: Outcome,
    settings: Settings,
    before: Floats | float = 0.0,
) -> Estimated:
    """Add errors to runs.

    `before` is the distance of the companions from their own companions.
    """
    model = model_of(config)
    scale = _Scale(config, settings)
    pair = _Pair(runs, companions)
    apart = np.ones(len(batch))
    comparable = pair.both_reverse | pair.both_stay
    apart[comparable] = distance(
        model,
        runs.y_end[comparable],
        companions.y_end[comparable],
        batch.constants[comparable],
    )
    relative = _relative_error(batch, model, pair, scale, apart, before)
    t_r_error = relative * runs.t_r
    reverses_in_time = (relative < 1.0) & (runs.t_r + t_r_error < batch.t_end)
    # The oscillation of a swinging launch drives the spin either way, so that the true
    # run need not reverse where these two have parted.
    reverses_in_time &= ~is_swinging(batch, model) | (apart <= PARTED)
    # If a stop ended the companion, its run has no error and counts as stopped.
    is_cut = companions.status == Status.STOPPED
    tol = np.nan
    if scale.adaptive:
        tol = settings.runs
    values = vars(runs) | {"status": np.where(is_cut, Status.STOPPED, runs.status)}
    return Estimated(
        **values,
        t_r_error=t_r_error,
        amp_growth_error=_growth_error(config, batch, model, pair),
        n_departure_error=_departure_error(config, batch, pair, apart),
        reversal_sure=reverses_in_time | (pair.both_stay & (pair.grazes == 0)),
        tol=np.full(len(batch), tol),
        companion_t_r=companions.t_r,
        apart=apart,
        grazes=pair.grazes,
        turn_errors=np.zeros((0, MOST_REVERSALS)),
        turns_sure=np.zeros(len(batch), np.int64),
    )


def _relative_error(
    batch: Batch,
    model: Model,
    pair: _Pair,
    scale: _Scale,
    apart: Floats,
    before: Floats | float,
) -> Floats:
    """Return ``t_r_error / t_r`` by the formula at the head of this module."""
    runs, companions = pair
    difference = np.where(
        pair.both_reverse, np.abs(companions.t_r / runs.t_r - 1.0), 1.0
    )
    n_steps = np.maximum(runs.n_steps, 1)
    weight = scale.fit.share / np.sqrt(n_steps / 1000.0)
    ratio = np.full(len(batch), scale.ratio)
    swinging = is_swinging(batch, model)
    if swinging.any():
        weight = np.where(swinging, SWINGING_SHARE, weight)
        # A companion whose steps are bounded is more accurate than its tolerance.
        by_steps = (companions.n_steps / n_steps) ** scale.order
        by_steps = np.maximum(ratio, np.minimum(by_steps, MOST_RATIO))
        ratio = np.where(swinging, by_steps, ratio)
    parted = _parted(apart)
    carried = np.maximum(scale.carried(ratio), parted)
    is_pulled = _is_pulled(pair)
    weight = np.where(is_pulled, PULLED_SHARE, weight)
    carried = np.where(is_pulled, np.maximum(carried, ratio**PULLED_POWER), carried)
    carried = np.maximum(carried, REMEMBERED * _parted(before))
    relative = scale.common + scale.fit.slope * carried * (difference + weight * apart)
    relative += np.where(_is_unsteady(batch, model), parted**2, 0.0)
    one_swing = 2 * np.pi / batch.swing / runs.t_r
    relative += np.where(pair.grazes > 0, scale.fit.swings * one_swing, 0.0)
    relative += _error_of_slides(runs, scale)
    relative = np.where(swinging, scale.fit.swinging * relative, relative)
    return np.minimum(relative, 1.0)


def _is_pulled(pair: _Pair) -> Flags:
    """Return the runs in which the plane would have to pull the body."""
    runs, companions = pair
    if not len(runs.pulled):  # without pivoting there is no such kink
        return np.zeros(len(runs.t_r), dtype=bool)
    return (runs.pulled > 0) | (companions.pulled > 0)


def _error_of_slides(runs: Outcome, scale: _Scale) -> Floats | float:
    """Return S of the formula."""
    if not len(runs.n_slides):  # the model has no slides
        return 0.0
    return np.where(runs.n_slides > 0, scale.fit.slides, 0.0)


def _parted(apart: Floats | float) -> Floats:
    """Return P of the formula: 0 for runs that are together, 1 for parted ones."""
    return np.minimum(1.0, (np.asarray(apart) / PARTED) ** 2)


def _is_unsteady(batch: Batch, model: Model) -> Flags:
    """Return the launches in the unsteady direction."""
    constants = model.named(batch.constants.T)
    if model.chart is None:
        unsteady: Flags = constants["k_p"] * batch.y0[:, 0] >= 0
    else:
        # The mixed curvature has the sign of K_p, and omega_z that of -n.
        _, _, _, _, c, *_ = batch.y0.T
        unsteady = constants["cxy"] * c <= 0
    return unsteady


def _growth_error(config: Config, batch: Batch, model: Model, pair: _Pair) -> Floats:
    """Return errors of ``amp_growth``, NaN for runs that are not ok."""
    runs, companions = pair
    # The final amp_growth of a run that has settled lies between its value so far and
    # 0.
    high = np.where(has_settled(batch, runs), 0.0, runs.amp_growth)
    companion_high = np.where(
        has_settled(batch, companions), 0.0, companions.amp_growth
    )
    below = runs.amp_growth - companion_high
    above = companions.amp_growth - high
    error = DIFFER * np.maximum(0.0, np.maximum(below, above))
    # A growth of exactly zero is that of a mode at rest, or the largest state of two
    # windows is the one at their border.  Both runs may have it there, while the
    # amplitude still rises between that step and the next.
    at_border = (runs.amp_growth == 0.0) & ~_is_at_rest(batch, model, runs)
    further = _angle_of_steps(config, batch, runs) ** 2 / 8
    error += np.where(at_border, further, 0.0)
    return np.where(runs.status == Status.OK, error, np.nan)


def _is_at_rest(batch: Batch, model: Model, runs: Outcome) -> Flags:
    """Return the runs at whose end the relevant mode has decayed."""
    amplitude: Any = model.amplitude
    first, last = (
        amplitude.py_func(y.T, batch.probe.T) for y in (batch.y0, runs.y_end)
    )
    return last <= DECAYED * first


def _angle_of_steps(config: Config, batch: Batch, runs: Outcome) -> Floats:
    """Return the mean angle between the ends of steps, of the spin's fastest swing."""
    ends = np.maximum(runs.n_steps, 1) / stride(METHODS[config.integrator.method])
    return np.minimum(batch.swing * runs.t_end / ends, np.pi)


def _departure_error(
    config: Config, batch: Batch, pair: _Pair, apart: Floats
) -> Floats:
    """Return errors of ``n_departure``, NaN for runs that are not ok."""
    departure = pair.runs.n_departure
    error = DIFFER * np.abs(departure - pair.companions.n_departure)
    if config.model != "reduced":  # its spin does not swing
        # The loss is that at the ends of steps.  A swing of the launch's rate gets at
        # most ``rate * swing * h^2 / 8`` further between two of them.
        angle = _angle_of_steps(config, batch, pair.runs)
        further = batch.rate / batch.swing * angle**2 / 8
        error += np.where(pair.both_reverse, 0.0, further / batch.scale)
    # Where the two have parted, nothing tells how much nearer to zero the spin may
    # come, however far from it both stay.  Those whose oscillation only decays differ
    # in its phase alone.
    decays = (pair.runs.amp_growth <= 0.0) & (pair.companions.amp_growth <= 0.0)
    may_reverse = pair.both_stay & (apart > PARTED) & ~decays
    error = np.where(may_reverse, np.maximum(error, 1.0 - departure), error)
    return np.where(pair.both_ok, error, np.nan)


def distance(model: Model, y: Floats, other: Floats, constants: Floats) -> Floats:
    """Return the distance of two states in the norm of the step control.

    It is relative to the size of `y`.
    """
    change = (y - other).T
    if model.chart is None:
        norm: Any = model.error
        moved, size = norm.py_func(change, y.T, constants.T)
    else:
        # The spin is zero in both states at a reversal.
        oscillation = full.oscillation.py_func
        moved = oscillation(change, constants.T)
        size = oscillation(y.T, constants.T)
    return np.sqrt(moved / size)


def _with_turns(
    to_horizon: Estimated, to_reversal: Estimated, companions: Outcome, scale: _Scale
) -> Estimated:
    """Add errors of turns to runs to the horizon; the first is already known."""
    times = to_horizon.reversals[:, :, 0]
    t_r = to_reversal.t_r[:, None]
    difference = np.abs(companions.reversals[:, :, 0] / times - 1.0)
    both_turn = np.isfinite(difference)
    largest = np.maximum.accumulate(np.where(both_turn, difference, 1.0), axis=1)
    parted = np.minimum(1.0, (largest / TURN_PARTED) ** 2)
    carried = np.maximum(scale.carried(scale.ratio), parted)
    relative = scale.common + TURN_SLOPE * carried * largest
    relative += np.reshape(_error_of_slides(to_horizon, scale), (-1, 1))
    # If the spin returns after its first zero, it turns at a later zero, which is less
    # certain.
    returned = times[:, :1] / t_r - 1.0
    relative[:, :1] = np.maximum(to_reversal.t_r_error[:, None] / t_r, returned)
    relative = np.minimum(relative, 1.0)
    is_sure = both_turn & (relative < SURE_TURN)
    return replace(
        to_horizon,
        turn_errors=np.where(both_turn, relative * times, np.nan),
        turns_sure=np.cumprod(is_sure, axis=1).sum(axis=1),
        t_r_error=to_reversal.t_r_error,
        reversal_sure=to_reversal.reversal_sure,
        apart=to_reversal.apart,
        companion_t_r=to_reversal.companion_t_r,
        grazes=to_reversal.grazes,
    )
