"""Trial runs of a fit: many launches at once, whose config is read once for a law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rattlesweep.analysis.onerun.channels import CHANNELS, View
from rattlesweep.arrays import Floats, take
from rattlesweep.config.schema import Config
from rattlesweep.design.batches import full_batch
from rattlesweep.design.launch import Launch, launch_rows, plan_of_rows
from rattlesweep.design.models import model_of
from rattlesweep.design.plan import Plan
from rattlesweep.design.prepare import prepare_launches
from rattlesweep.kernel.abreast import RunAbreast, follow_abreast
from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.follow import Follower
from rattlesweep.kernel.method.tableau import METHODS, TOL
from rattlesweep.kernel.outcome import Batch
from rattlesweep.kernel.state.fields import MOST_REVERSALS
from rattlesweep.kernel.state.status import Status
from rattlesweep.rows.prepared import PreparedRuns
from rattlesweep.words.errors import ConfigError

# The channels that measured quantities are compared with.
CHANNELS_OF = {
    "angle": "angle_deg",
    "spin": "angle_deg",
    "n": "n",
    "gyro": "omega_z",
}
# Names of the losses that act, and whether the body has c and a rim.
_Law = tuple[frozenset[str], bool, bool]
RunKey = tuple[float | None, ...]


@dataclass(frozen=True)
class Trials:
    """Runs that differ in their numbers, and in the losses that are zero.

    The latest ones are `known` by their parameters, horizon and number of values.
    """

    known: dict[RunKey, Floats | ValueError] = field(default_factory=dict)
    _plans: dict[_Law, Plan] = field(default_factory=dict)

    def follow(
        self, launches: Sequence[Launch], kind: str, times: Sequence[Floats]
    ) -> list[Floats | ConfigError]:
        """Return the quantity `kind` of each run at its times, or why there is none."""
        answers: dict[int, Floats | ConfigError] = {}
        for law, places in _by_law(launches).items():
            config, prepared = self._prepared(law, [launches[k] for k in places])
            found = _followed(config, prepared, kind, [times[k] for k in places])
            answers |= dict(zip(places, found, strict=True))
        return [answers[place] for place in range(len(launches))]

    def reversal_times(
        self, launches: Sequence[Launch], count: int
    ) -> list[Floats | ConfigError]:
        """Return the times of the first `count` reversals, or why there are none.

        A run with fewer reversals has the others at its end at the earliest.
        """
        answers: dict[int, Floats | ConfigError] = {}
        for law, places in _by_law(launches).items():
            config, prepared = self._prepared(law, [launches[k] for k in places])
            times = _turns(config, prepared, count)
            answers |= dict(zip(places, times, strict=True))
        return [answers[place] for place in range(len(launches))]

    def _prepared(
        self, law: _Law, launches: Sequence[Launch]
    ) -> tuple[Config, PreparedRuns]:
        """Return the config of runs of one law, and their launches."""
        rows = launch_rows(launches)
        acting, _, _ = law
        if "creep" in rows.columns and "creep" not in acting:
            # A patch that does not turn does not give way.
            rows.columns["creep"] = np.zeros(len(launches))
        if law not in self._plans:
            self._plans[law] = plan_of_rows(rows, "full", {}, ["reversals"])
        plan = replace(self._plans[law], source=rows)
        numbers = np.arange(len(launches))
        return plan.config, prepare_launches(plan, np.zeros_like(numbers), numbers)


def follow_quantity(launch: Launch, kind: str, times: Floats) -> Floats:
    """Return the quantity `kind` of a run at some times.

    Raises a ConfigError if the integration fails.
    """
    (values,) = Trials().follow([launch], kind, [times])
    if isinstance(values, ConfigError):
        raise values
    return values


def _failure(status: Status) -> ConfigError:
    """Return the error about a run that was not integrated to its end."""
    return ConfigError(f"the run failed: {status.meaning}")


def _by_law(launches: Sequence[Launch]) -> dict[_Law, list[int]]:
    """Return the places of the runs of each law."""
    places: dict[_Law, list[int]] = {}
    for place, run in enumerate(launches):
        acting = {name for name, value in run.losses.items() if value}
        if "pivot" not in acting:
            acting.discard("creep")
        law = frozenset(acting), run.body.c is not None, run.body.rim is not None
        places.setdefault(law, []).append(place)
    return places


def _follower(config: Config, batch: Batch, has_attitude: bool) -> Follower:
    """Return the integration of one run, whose contact nobody watches."""
    settings = config.integrator
    return Follower(
        batch,
        METHODS[settings.method],
        model_of(config),
        tol=settings.tol or TOL,
        max_steps=settings.max_steps,
        attitude=has_attitude,
    )


def _followed(
    config: Config, prepared: PreparedRuns, kind: str, times: Sequence[Floats]
) -> list[Floats | ConfigError]:
    """Return a quantity of runs at their times, or why there is none."""
    channel = CHANNELS[CHANNELS_OF[kind]]
    has_attitude = channel.needs == "attitude"
    batch = full_batch(prepared)
    settings = config.integrator
    courses = follow_abreast(
        batch,
        METHODS[settings.method],
        model_of(config),
        times,
        tol=settings.tol or TOL,
        max_steps=settings.max_steps,
        attitude=has_attitude,
    )
    answers: list[Floats | ConfigError] = []
    for row, course in enumerate(courses):
        one = np.array([row])
        run: RunAbreast | Follower
        if course is not None:
            run = course
            samples = course.samples
        else:
            run = _follower(config, take(batch, one), has_attitude)
            samples = run.at(times[row])
            while not run.ended:
                run.steps()
            if run.status != Status.OK or not len(samples.t):
                answers.append(_failure(run.status))
                continue
        view = View(take(prepared, one), run, samples, None)
        answers.append(_measured(kind, channel.of(view), times[row]))
    return answers


def _measured(kind: str, values: Floats, times: Floats) -> Floats:
    """Return the values of a channel as they are measured at some times."""
    if kind in ("angle", "spin"):
        values = np.radians(values)
    elif kind == "gyro":
        # The body's z axis points downward.
        values = -values
    # A body that has come to rest keeps its last value.
    values = np.pad(values, (0, len(times) - len(values)), mode="edge")
    if kind == "spin":
        values = np.gradient(values, times)
    return values


def _turns(
    config: Config, prepared: PreparedRuns, count: int
) -> list[Floats | ConfigError]:
    """Return the times of reversals of runs, or why there are none."""
    ends = prepared.horizon
    answers: list[Floats | ConfigError] = []
    if count > MOST_REVERSALS:
        # A kernel of sweeps stores no more.
        batch = full_batch(prepared)
        for row, end in enumerate(ends):
            follower = _follower(config, take(batch, np.array([row])), False)
            while not follower.ended:
                follower.steps()
            times = np.array(follower.reversals[:count])
            answers.append(_filled(follower.status, times, end, count))
        return answers
    settings = config.integrator
    outcome = integrate(
        full_batch(prepared),
        METHODS[settings.method],
        model_of(config),
        tol=settings.tol or TOL,
        max_steps=settings.max_steps,
        record=frozenset({"reversals"}),
    )
    for row, end in enumerate(ends):
        turns = min(count, int(outcome.n_turns[row]))
        times = outcome.reversals[row, :turns, 0]
        answers.append(_filled(Status(outcome.status[row]), times, end, count))
    return answers


def _filled(
    status: Status, times: Floats, end: float, count: int
) -> Floats | ConfigError:
    """Return the times of so many reversals, or why the run has none."""
    if status != Status.OK:
        return _failure(status)
    filled = np.full(count, end)
    filled[: len(times)] = times
    return filled
