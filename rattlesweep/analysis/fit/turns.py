"""Times of reversals of many runs at once, by the kernel of the sweeps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.arrays import Floats
from rattlesweep.design.batches import full_batch
from rattlesweep.design.bodies.table import OMEGA, TableBodies, U, launched_from
from rattlesweep.design.models import model_of
from rattlesweep.design.prepare import prepare_launches
from rattlesweep.design.single import Launch, directions, plan_of_rows
from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.method.tableau import METHODS, TOL
from rattlesweep.kernel.runs import MOST_REVERSALS
from rattlesweep.kernel.state.status import Status
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.words.errors import ConfigError

UP = (0.0, 0.0, -1.0)  # the vertical along the axes of an upright body


def failure(status: Status) -> ConfigError:
    """Return the error about a run that was not integrated to its end."""
    return ConfigError(f"the run failed: {status.meaning}")


def reversal_times(
    launches: Sequence[Launch], count: int
) -> list[Floats | ConfigError]:
    """Return the times of the first `count` reversals of runs, or why there are none.

    A run with fewer reversals has the others at its end at the earliest.  The runs
    differ in their numbers alone: all have the same surface and the same losses.
    """
    if count > MOST_REVERSALS:
        # A kernel stores no more.
        return [_followed(launch, count) for launch in launches]
    plan = plan_of_rows(TableBodies(_columns(launches)), "full", {}, ["reversals"])
    rows = np.arange(len(launches))
    prepared = prepare_launches(plan, np.zeros_like(rows), rows)
    settings = plan.config.integrator
    outcome = integrate(
        full_batch(prepared),
        METHODS[settings.method],
        model_of(plan.config),
        tol=settings.tol or TOL,
        max_steps=settings.max_steps,
        record=frozenset({"reversals"}),
    )
    answers: list[Floats | ConfigError] = []
    for row, launch in enumerate(launches):
        status = Status(outcome.status[row])
        if status != Status.OK:
            answers.append(failure(status))
            continue
        turns = min(count, int(outcome.n_turns[row]))
        answers.append(_filled(outcome.reversals[row, :turns, 0], launch, count))
    return answers


def _filled(times: Floats, launch: Launch, count: int) -> Floats:
    filled = np.full(count, launch.t_end or 0.0)
    filled[: len(times)] = times
    return filled


def _followed(launch: Launch, count: int) -> Floats | ConfigError:
    """Return the reversals of a run that is followed by itself."""
    course = Course(PreparedRun.of(launch), ["n"], times=np.zeros(1))
    course.columns()
    status = course.follower.status
    if status != Status.OK:
        return failure(status)
    return _filled(np.array(course.reversals[:count]), launch, count)


def _columns(launches: Sequence[Launch]) -> dict[str, Floats]:
    """Return launches as the columns of a table in units of the bodies."""
    first = launches[0]
    columns: dict[str, Floats] = {}
    for name in (*PARAMETERS, "c"):  # without c, which is None, a NaN
        columns[name] = np.array([getattr(run.body, name) for run in launches], float)
    for name in first.losses:
        columns[name] = np.array([run.losses[name] for run in launches], float)
    columns["t_end"] = np.array([run.t_end for run in launches], float)
    if first.omega is not None:
        states = np.array([[*(run.omega or ()), *(run.u or UP)] for run in launches])
        columns |= dict(zip((*OMEGA, *U), states.T, strict=True))
        return columns | launched_from(columns, "launch")
    for name in ("n_i", "omega_xy0"):
        columns[name] = np.array([getattr(run, name) for run in launches], float)
    if isinstance(first.psi, float):
        columns["psi"] = np.radians(np.array([run.psi for run in launches], float))
    else:
        columns["psi"] = directions(columns, first.psi or "relevant")
    return columns
