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
then the body rolls if the plane can hold it.  A body on a plane that shakes may leave
it, so the normal force is a limit, too, whose zero ends the run.

The limit of a body with a rim is combined with the height that is left below it
(`inside.both`), so that one search (`event.zeros`) finds the first zero of all.  Which
of the two is zero is told apart once its zero is found.

A mode is a record (:class:`~rattlesweep.kernel.state.lane.Mode`) of `mode.slides`
or `mode.pivots`; ROLLING of a body that never slides is here.  :func:`modes_of`
combines those of a model.
"""

# mypy: ignore-errors
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from numba import njit

from rattlesweep.compiling.intrinsics import FUSED, INNER, apart, choice, widest_vectors
from rattlesweep.kernel.event.zeros import LIMIT
from rattlesweep.kernel.look import inside
from rattlesweep.kernel.mode import pivots, slides
from rattlesweep.kernel.state.fields import (
    GROUP,
    STEP,
    Point,
)
from rattlesweep.kernel.state.lane import Mode, ModeSet, lane_of, never, nothing
from rattlesweep.kernel.state.statuses import AT_LIMIT, LIFTS_OFF, RIM
from rattlesweep.kernel.state.ways import PIVOTING, ROLLING, SLIDING
from rattlesweep.kernel.step import slots
from rattlesweep.kernel.step.radau import Rack, rack_of
from rattlesweep.motion.model import Model
from rattlesweep.physics.full import scalar

# A body that rolls whatever the force.


@scalar
def no_limit(lane, h, y, f):
    """Return the limit of a model that holds everywhere."""
    return Point(h, 1.0, 0.0)


@scalar
def left_of_model(lane, y):
    """Return the limit of the model."""
    return lane.problem.model.limit(y, lane.constants)


@scalar
def margin_of_model(lane, y, f):
    """Return the limit of the model."""
    return left_of_model(lane, y)


@scalar
def no_margin(lane, y, f):
    """Return the margin of a body that rolls whatever the force."""
    return 1.0


@scalar
def no_rim(lane, y):
    """Return the height that is left below the rim of a body without one."""
    return 1.0


@scalar
def below_rim(lane, y):
    """Return the height that is left between the contact and the rim."""
    return lane.rim - lane.problem.model.rise(y, lane.constants)


@scalar
def margin_at_rim(lane, y, f):
    """Return the height that is left below the rim."""
    return below_rim(lane, y)


@scalar
def force_left(lane, y):
    """Return the normal force, combined with the height that is left below a rim."""
    normal, _ = lane.problem.model.contact(y, lane.constants)
    return inside.both(normal, lane.problem.modes.left(lane, y))


@scalar
def margin_of_force(lane, y, f):
    """Return the same from a state and its derivative."""
    normal, _ = lane.problem.model.force(y, f, lane.constants)
    return inside.both(normal, lane.problem.modes.left(lane, y))


@njit(**INNER)
def pulls_at_launch(lane):
    """Return whether the plane would have to pull a body at its launch.

    A body that slides says so by itself.
    """
    return lane.margin0 <= 0.0


@njit(**INNER)
def end_off_plane(lane, status, move, goes_on, reversals_recorded):
    """Return status and move of a run that ends where the body leaves the plane."""
    if status != AT_LIMIT:
        return status, move
    at_rim = lane.problem.modes.left(lane, lane.y1) < slides.AT_RIM
    return RIM if at_rim else LIFTS_OFF, move


@njit(**INNER)
def go_on(lane, status, move, goes_on, reversals_recorded):
    """Return status and move; the lane goes on as it is."""
    return status, move


@njit(**INNER)
def end_at_rim(lane, status, move, goes_on, reversals_recorded):
    """Return status and move of a run that has no other limit but the rim."""
    return RIM if status == AT_LIMIT else status, move


@njit(**FUSED)
def settle(lane, y, n, t):
    """Let the lane roll."""
    lane.mode = ROLLING


@njit(**FUSED)
def energy(lane):
    """Return the energy at the end of the step just tried."""
    return lane.problem.model.energy(lane.y1, lane.constants)


@njit(**INNER)
def work(lane):
    """Return the work of friction until the end of the step, which is negative."""
    return lane.problem.model.work(lane.y1)


@njit(**FUSED)
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


def observe_margin(
    margin: Callable[..., float], is_calm: Callable[..., bool]
) -> Callable[..., None]:
    """Return a function that looks at the margin in the steps tried on all lanes.

    It needs no right-hand side: the margin follows from the state and its derivative,
    and within the step from those of the cubic through both ends.  A step too long for
    this is searched unless it is calm.
    """

    @njit(**FUSED)
    def observe_limit(problem, w, used):
        widest_vectors()
        for first in range(0, used, GROUP):
            for l in range(first, first + GROUP):
                lane = lane_of(problem, w, l)
                start = lane.margin0
                half = margin(lane, inside.middle(lane), inside.middle_rate(lane))
                end = margin(lane, lane.y1, lane.f1)
                angle = lane.h * lane.swing
                dips = inside.may_dip(start, half, end, angle)
                swings = not is_calm(lane)
                leaves = 1.0 if (swings if angle > inside.GLANCED else dips) else 0.0
                watched = lane.watched
                lane.margin1 = end
                lane.leaves = leaves
                lane.watched = watched + leaves

    return observe_limit


def stays_on_plane(model: Model) -> Callable[..., bool]:
    """Return whether a body is too calm for a plane that shakes to lose it in a step.

    As in `slides.is_calm`, the normal force is within a share of the weight, whose
    amplitude is that of the plane's acceleration.
    """
    (strength,) = [each.strength for each in model.actions if each.lifts]
    place = model.constants.index(strength)

    @scalar
    def stays(lane):
        acceleration = lane.constants[place]
        most = slides.most_of_force(lane)
        return acceleration + 2.0 * (1.0 + acceleration) * most < 1.0

    return stays


def observe_force(
    margin: Callable[..., float], stays: Callable[..., bool]
) -> Callable[..., None]:
    """Return what :func:`observe_margin` does, which looks only at lanes that may lift.

    The margin of the others counts as 1, whatever is computed for it.
    """
    observe_all = observe_margin(margin, never)

    @njit(**FUSED)
    def observe_limit(problem, w, used):
        widest_vectors()
        lifting = 0
        for l in range(problem.lanes):
            lane = lane_of(problem, w, l)
            lifting += 0 if stays(lane) else 1
        if lifting > 0:
            observe_all(problem, w, used)
        for l in range(problem.lanes):
            lane = lane_of(problem, w, l)
            calm = stays(lane)
            leaves = lane.leaves
            watched = lane.watched
            end = lane.margin1
            looked = lifting > 0
            lane.margin1 = 1.0 if calm else end
            lane.leaves = 0.0 if calm else leaves
            lane.watched = watched - leaves if calm & looked else watched

    return observe_limit


@njit(**INNER)
def observe_nothing(problem, w, used):
    """Let no step end at a zero of the limit."""
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        lane.leaves = 0.0


@njit(**FUSED)
def look_at_limit(lane):
    """Compute the limit at the ends of the step tried, where it is to be searched.

    A closer look, with the rates of the limit, tells whether the step may end at a zero
    of it.  Steps of lanes that slide have computed it.
    """
    apart()
    limit = lane.problem.modes.limit
    rolls = lane.mode != SLIDING
    if lane.search != STEP:
        if rolls and lane.searched == LIMIT:
            lane.limit1 = limit(lane, lane.h, lane.y1, lane.f1)
        return
    if lane.mode == SLIDING or (lane.leaves == 0.0 and lane.mode != PIVOTING):
        return
    if rolls:
        lane.limit0 = limit(lane, 0.0, lane.y, lane.f)
        lane.limit1 = limit(lane, lane.h, lane.y1, lane.f1)
    lane.limit0 = lane.problem.modes.at_start(lane, lane.limit0)
    if lane.leaves > 0.0:
        half = limit(lane, lane.h, inside.middle(lane), inside.middle_rate(lane))
        angle = lane.h * lane.swing
        falls = inside.falls(lane.limit0, half.value, lane.limit1, angle)
        falls |= lane.problem.modes.gives_way(lane)
        lane.leaves = 1.0 if falls else 0.0


@njit(**INNER)
def roll_on(problem, w):
    """Return that all lanes try a step in this turn, and that none slides."""
    return True, False


@njit(**INNER)
def keep(problem, w, due):
    """Return which lanes are due."""
    return due


def modes_of(model: Model, rimmed: bool) -> ModeSet:
    """Return the modes of a model's bodies."""
    rolling = Mode(ROLLING, no_limit, go_on)
    if model.limit is not None:
        rolling = Mode(
            ROLLING, inside.along_flow(left_of_model), go_on, margin_of_model
        )
    if rimmed:
        rolling = Mode(ROLLING, inside.along_flow(below_rim), end_at_rim, margin_at_rim)
    further = ()
    if model.lifts:
        rolling = Mode(
            ROLLING, inside.along_flow(force_left), end_off_plane, margin_of_force
        )
    if model.slide is not None:
        rolling = slides.ROLLING_MODE
        further = (slides.SLIDING_MODE,)
    modes = (rolling, *further)
    if model.pivot is not None:
        pivoting = pivots.pivoting_modes(rolling)
        further = tuple(pivots.sliding_and_pivoting(mode) for mode in further)
        modes = (*pivoting, *further)
    margin = rolling.margin
    observed = [mode.observe_limit for mode in modes]
    has_limit = margin is not None or model.pivot is not None
    if model.lifts and model.slide is None and not rimmed:
        observed.insert(0, observe_force(margin, stays_on_plane(model)))
    elif margin is not None:
        is_calm = never
        # Of a plane that shakes the oscillation does not bound the force.
        if rolling.is_calm and not rimmed and not model.lifts:
            is_calm = rolling.is_calm
        observed.insert(0, observe_margin(margin, is_calm))
    elif has_limit:
        observed.insert(0, observe_nothing)
    combined = ModeSet(
        limit=of_mode(modes, "limit"),
        limited=has_limit,
        schedules=False,
        advances=False,
        margin=margin or no_margin,
        observe_limit=in_turn(observed),
        look=look_at_limit if has_limit else nothing,
        gives_way=of_mode(modes, "gives_way"),
        schedule=roll_on,
        decide=keep,
        change=of_mode(modes, "change"),
        settle=settle,
        left=below_rim if rimmed else no_rim,
        energy=energy,
        work=work,
        observe=observe,
    )
    if model.lifts and model.slide is None:
        combined = replace(combined, refuses=pulls_at_launch)
    if model.slide is not None:
        combined = replace(
            combined,
            schedules=True,
            advances=True,
            schedule=slots.schedule_slides,
            decide=slots.decide_sliding,
            launch=slides.launch,
            advance=slides.advance,
            store=slides.store,
            energy=slides.energy,
            work=slides.work,
            observe=slides.observe_body,
        )
    if model.pivot is not None:
        combined = replace(
            combined,
            prepare=pivots.prepare,
            at_start=pivots.after_zero,
            settle=pivots.settle,
            free=pivots.free,
            slow=pivots.slow,
            launch=pivots.launching(combined.launch),
            store=in_turn([combined.store, pivots.store]),
            observe=pivots.observing(combined.observe),
        )
    return combined


# What modes bring to a lane and to the results of runs.


@dataclass(frozen=True)
class ModeResults(slides.SlideResults, pivots.RestResults):
    """What modes add to the results of runs; no rows of a mode that the model lacks."""


# The results of a run of a model that lacks a mode which others have.
WITHOUT_MODE = pivots.WITHOUT_TORQUE


@dataclass(frozen=True)
class ModeNouns:
    """Classes that declare fields: at both ends of a step, others, and of results."""

    ends: list[type] = field(default_factory=list)
    others: list[type] = field(default_factory=list)
    results: list[type] = field(default_factory=list)


def nouns_of(model: Model) -> ModeNouns:
    """Return what the modes of a model bring."""
    nouns = ModeNouns()
    if model.pivot is not None:
        nouns.ends.append(pivots.HoldFields)
    if model.slide is not None:
        nouns.ends.append(slides.SlipFields)
        nouns.others.extend([slides.SlideFields, slots.SlotFields])
        nouns.results.append(slides.SlideResults)
    if model.pivot is not None:
        nouns.others.append(pivots.RestFields)
        nouns.results.append(pivots.RestResults)
    return nouns


def places_of(model: Model) -> dict[str, int]:
    """Return the places of the constants that modes read or set one by one.

    While a body with pivoting friction slides, which needs no sense of its spin, the
    least creep (`physics.friction.pivoting`) has its place.
    """
    if model.pivot is None:
        return {}
    sense = model.constants.index("sense")
    # In the reduced model the lever is another constant.
    name = "lever"
    if name not in model.constants:
        name = "pivot"
    lever = model.constants.index(name)
    return {"lever": lever, "sense": sense, "least_creep": sense}


def rack_for(model: Model) -> Rack | None:
    """Return the rack for steps of slides, None for a model that does not slide."""
    if model.slide is None:
        return None
    return rack_of(model)
