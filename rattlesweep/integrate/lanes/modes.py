"""Modes: the ways in which a body moves, what ends them, and what follows.

A lane is in one mode at a time, which lasts while its limit is positive:

| mode | what acts on the body | its limit | what follows |
|---|---|---|---|
| ROLLING | the plane holds the contact | the friction | SLIDING |
| SLIDING | friction against the slip | the normal force, the mobility | an end |
| PIVOTING | it rolls; a torque against its spin | its spin, the friction | HELD |
| HELD | it rolls; its spin is held at zero | the torque, the friction | PIVOTING |

Where the friction is used up, SLIDING follows all others.  PIVOTING follows itself,
with the other sense of the spin.  A slide also ends where the contact point is at rest:
then the body rolls if the plane can hold it.

The limit of a body with a rim is combined with the height that is left below it
(`inside.both`), so that one search (`lanes.events`) finds the first zero of all.  Which
of the two is zero is told apart once its zero is found.

A mode is a record (:class:`~rattlesweep.integrate.lanes.lane.Mode`) of `lanes.slides`
or `lanes.pivots`; ROLLING of a body that never slides is here.  :func:`modes_of`
combines those of a model.
"""

# mypy: ignore-errors
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numba import njit

from rattlesweep.integrate.lanes import inside, pivots, runs, slides
from rattlesweep.integrate.lanes.lane import (
    DIFFERENCE,
    INNER,
    ROLLING,
    Mode,
    ModeSet,
    Point,
    choice,
    lane_of,
    moved,
    widest_vectors,
)
from rattlesweep.integrate.lanes.statuses import AT_LIMIT, RIM
from rattlesweep.integrate.lanes.tangents import nothing
from rattlesweep.integrate.model import Model
from rattlesweep.physics.full import FASTMATH, scalar

# The results of a run in any model.
RESULT = np.dtype([*runs.RESULTS, *slides.RESULTS, *pivots.RESULTS], align=True)


# A body that rolls whatever the force.


@scalar
def no_limit(lane, h, y, f):
    """Return the limit of a model that holds everywhere."""
    return Point(h, 1.0, 0.0)


@scalar
def limit_of_model(lane, h, y, f):
    """Return the limit of the model."""
    ahead = DIFFERENCE / lane.swing
    limit = lane.problem.model.limit
    now = limit(y, lane.constants)
    later = limit(moved(y, f, ahead), lane.constants)
    return Point(h, now, (later - now) / ahead)


@scalar
def no_rim(lane, y):
    """Return the height that is left below the rim of a body without one."""
    return 1.0


@scalar
def below_rim(lane, y):
    """Return the height that is left between the contact and the rim."""
    return lane.rim - lane.problem.model.rise(y, lane.constants)


@scalar
def limit_at_rim(lane, h, y, f):
    """Return the height that is left below the rim."""
    ahead = DIFFERENCE / lane.swing
    now = below_rim(lane, y)
    later = below_rim(lane, moved(y, f, ahead))
    return Point(h, now, (later - now) / ahead)


@njit(**INNER)
def go_on(lane, status, move, recording):
    """Return status and move; the lane goes on as it is."""
    return status, move


@njit(**INNER)
def end_at_rim(lane, status, move, recording):
    """Return status and move of a run that has no other limit but the rim."""
    return RIM if status == AT_LIMIT else status, move


@njit(**INNER)
def settle(lane, y, t):
    """Let the lane roll."""
    lane.mode = ROLLING


@njit(fastmath=FASTMATH, **INNER)
def energy(lane):
    """Return the energy at the end of the step just tried."""
    return lane.problem.model.energy(lane.y1, lane.constants)


@njit(**INNER)
def work(lane):
    """Return the work of friction until the end of the step, which is negative."""
    return lane.problem.model.work(lane.y1)


@njit(fastmath=FASTMATH, **INNER)
def observe(model, y, slip, constants, mu):
    """Return what `ModeSet.observe` does."""
    normal, tangential = model.contact(y, constants)
    return model.energy(y, constants), normal, tangential, 0.0


# How modes combine.


def of_mode(modes: Sequence[Mode], name: str) -> Callable[..., object]:
    """Return a function that calls the one of the mode in which a lane is."""
    one_of = choice({mode.number: getattr(mode, name) for mode in modes})

    @njit(**INNER)
    def of_lane(lane, *arguments):
        return one_of(lane.mode, lane, *arguments)

    return of_lane


def in_turn(functions: Sequence[Callable[..., None] | None]) -> Callable[..., None]:
    """Return a function that calls others in turn; those that are None are left out."""
    first, *others = [function for function in functions if function] or [nothing]
    if not others:
        return first
    rest = in_turn(others)

    @njit(**INNER)
    def all_of(*arguments):
        first(*arguments)
        rest(*arguments)

    return all_of


def observe_limits(limit_of_most: Callable[..., Point]) -> Callable[..., None]:
    """Return a function that computes a limit at the end of the step on all lanes."""

    @njit(fastmath=FASTMATH, **INNER)
    def observe_limit(problem, w):
        widest_vectors()
        for l in range(problem.lanes):
            lane = lane_of(problem, w, l)
            end = limit_of_most(lane, lane.h, lane.y1, lane.f1)
            start = lane.limit0
            lane.limit1 = end
            half = limit_of_most(lane, lane.h, inside.middle(lane), lane.f1)
            angle = lane.h * lane.swing
            leaves = 1.0 if inside.falls(start, half.value, end, angle) else 0.0
            lane.leaves = leaves
            lane.watched += leaves

    return observe_limit


def modes_of(model: Model, rimmed: bool) -> ModeSet:
    """Return the modes of a model's bodies."""
    limit = no_limit if model.limit is None else limit_of_model
    change = go_on
    if rimmed:
        limit = limit_at_rim
        change = end_at_rim
    rolling = Mode(ROLLING, limit, change)
    further = ()
    if model.slide is not None:
        rolling = slides.ROLLING_MODE
        further = (slides.SLIDING_MODE,)
    modes = (rolling, *further)
    if model.pivot is not None:
        pivoting = pivots.pivoting_modes(rolling)
        modes = (*pivoting, *further)
    observed = [mode.observe_limit for mode in modes]
    combined = ModeSet(
        limit=of_mode(modes, "limit"),
        observe_limit=in_turn([observe_limits(modes[0].limit), *observed]),
        change=of_mode(modes, "change"),
        prepare=nothing,
        launch=nothing,
        settle=settle,
        free=nothing,
        advance=nothing,
        left=below_rim if rimmed else no_rim,
        energy=energy,
        work=work,
        observe=observe,
        store=in_turn([mode.store for mode in modes]),
        results=tuple(name for mode in modes for name, _ in mode.results),
    )
    if model.slide is not None:
        combined = replace(
            combined,
            prepare=slides.prepare,
            launch=slides.launch,
            advance=slides.advance,
            energy=slides.energy,
            work=slides.work,
            observe=slides.observe_body,
        )
    if model.pivot is not None:
        combined = replace(
            combined,
            prepare=pivots.preparing(combined.prepare),
            settle=pivots.settle,
            free=pivots.free,
            observe=pivots.observing(combined.observe),
        )
    return combined
