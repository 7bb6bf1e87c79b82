"""Slides of a run in a lane: their steps, their begin and their end.

A body rolls until the force that keeps its contact point at rest exceeds ``mu`` times
the normal force; this is the limit of the model, whose zero the lanes find as they find
others (`event.zeros`).  From there the lane slides: its steps are those of
`slots.slide_lanes` and not of ``attempt``, in the same turns as those of the other
lanes, and everything that is observed at steps is observed as before.  It rolls again
once the speed is zero and friction can hold the contact point, and otherwise slides on.

The angle of sliding is stiff near the begin and the end of a slide
(`physics.friction.sliding`), and nothing else is, unless the patch pivots: then spin
and speed are, through its torque.  So a step of a Radau IIA method solves its equations
for the angle, and for this torque, by Newton's method, which needs one derivative a
stage of each, and for the rest by iteration, on several lanes at once (`step.radau`).
Near the end of a slide steps become shorter with the speed, since the equations have no
sense beyond its zero.  The last one is of second order, in which the speed falls to
zero.
"""

# mypy: ignore-errors
from dataclasses import dataclass
from math import floor

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import FUSED, INNER
from rattlesweep.kernel.answer import jump
from rattlesweep.kernel.look.extremes import note_contact, start_points
from rattlesweep.kernel.look.inside import along_flow, both
from rattlesweep.kernel.state.fields import (
    NEVER,
    Number,
    Point,
    Slip,
)
from rattlesweep.kernel.state.lane import Mode, lane_of
from rattlesweep.kernel.state.statuses import (
    AT_LIMIT,
    JAMMED,
    LIFTS_OFF,
    OK,
    RIM,
    STEP_TOO_SMALL,
)
from rattlesweep.kernel.state.ways import ROLLING, SLIDING
from rattlesweep.kernel.step.sliding_motion import (
    LEAST_MOBILITY,
    contact_of,
)
from rattlesweep.kernel.step.sliding_step import (
    BEGINNING,
    contact_at_slip,
    motion_of,
    set_limit,
)
from rattlesweep.physics.friction.sliding import (
    TWO_PI,
    meets_singularity,
    outgoing,
    push,
    slip_energy,
)
from rattlesweep.physics.full import scalar
from rattlesweep.physics.stone import dot

FIRST_ANGLE = 0.2  # first step of a slide, in radians of the fastest swing
# Height left below the rim, in a, at which a zero of the limit is that of the rim.
AT_RIM = 1e-9
# A slide is jammed where steps become too small this short before the mobility is zero,
# in radians of the fastest swing: it falls as the root of the time that is left.
JAMMING_ANGLE = 1e-6
TURN_AHEAD = 1e-6  # of differences with respect to the angle


class SlipFields:
    """The sliding of the contact point, at either end of the step."""

    slip: Slip


class SlideFields:
    """What a lane that may slide knows of its slides."""

    mu: Number  # coefficient of friction, which follows the other constants of the run
    t_begin: Number  # begin of the last slide
    h_rolling: Number  # size of the step before it
    refused: Number  # status of a body that can neither roll nor slide at launch, or 0


@dataclass(frozen=True)
class SlideResults:
    """Results of a model that slides; without rows in others."""

    t_slide: Floats  # begin of the first slide
    n_slides: NDArray[np.int32]
    slide_time: Floats  # time spent sliding
    slide_work: Floats  # energy lost by sliding, relative to energy_0


# From rolling to sliding and back.


@scalar
def friction_left(lane, y):
    """Return the friction that is left: positive while the plane holds the body.

    Of a body with a rim it is combined with the height that is left below the rim, so
    that one search finds the first zero of both.
    """
    normal, tangential = lane.problem.model.contact(y, lane.constants)
    return both(lane.mu * normal - tangential, lane.problem.modes.left(lane, y))


@scalar
def hold_margin(lane, y, f):
    """Return a smooth function with the sign of :func:`friction_left`.

    It is ``(mu F_n)^2 - F_t^2``, with the sign of ``F_n`` before the first square, and
    the height that is left.  It has no kink where the tangential force ``F_t`` is zero.
    """
    normal, square = lane.problem.model.force(y, f, lane.constants)
    held = lane.mu * normal
    return both(held * abs(held) - square, lane.problem.modes.left(lane, y))


@scalar
def most_of_force(lane):
    """Return what the squared force of an oscillation is below in the step tried.

    Twice its energy is ``S``, so the speed of the centre of mass is at most the root of
    ``S``, and it turns and swings no faster than ``w``, the sum of the spin and half
    the swing, which is at most that of the slope.  So the square is at most ``w^2 S``.
    """
    error = lane.problem.model.error
    _, before = error(lane.y, lane.y, lane.constants)
    _, after = error(lane.y1, lane.y1, lane.constants)
    fastest = 0.5 * lane.swing + abs(lane.n0) + abs(lane.n1)
    return fastest * fastest * (before + after)


@scalar
def is_calm(lane):
    """Return whether the oscillation is too small for a slide in the step tried.

    ``F_t^2`` is at most :func:`most_of_force`, and ``F_n`` differs from 1 by a share of
    it.  Both are counted more than twice, as it is that to second order.
    """
    most = most_of_force(lane)
    held = lane.mu * (1.0 - 2.0 * most)
    return (held > 0.0) & (held * held > 2.0 * most)


@njit(**FUSED)
def jams(lane):
    """Return whether the mobility is about to vanish at the start of the step.

    It falls with the angle, whose rate has no bound.
    """
    slip = lane.slip
    contact, _, _ = contact_at_slip(lane, lane.y, slip)
    _, mobility, _, across, _ = push(contact, lane.mu, slip.angle)
    turning = across / slip.speed - contact.turn
    ahead = TURN_AHEAD if turning > 0.0 else -TURN_AHEAD
    _, later, _, _, _ = push(contact, lane.mu, slip.angle + ahead)
    fall = (mobility - later) / ahead * turning
    soon = JAMMING_ANGLE / lane.swing
    if mobility > max(LEAST_MOBILITY, 2.0 * soon * fall):
        return False
    return meets_singularity(contact, lane.mu, slip.angle)


@njit(**FUSED)
def why_not(contact):
    """Return the status of a body that can neither roll nor slide."""
    return LIFTS_OFF if contact.need < LEAST_MOBILITY else JAMMED


@njit(**FUSED)
def slide_from_rest(lane):
    """Let a lane slide from rest at the end of the step; return a status."""
    rest = Slip(0.0, 0.0, 0.0)
    lane.problem.modes.free(lane)
    contact, _, _ = contact_at_slip(lane, lane.y1, rest)
    angle, found = outgoing(contact, lane.mu)
    slip = Slip(BEGINNING, angle, lane.slip.work)
    motion = motion_of(lane, lane.y1, slip)
    # Without a margin the plane would have to pull, in any direction of sliding.
    if not (found and motion.margin > 0.0):
        return why_not(contact)
    lane.slip1 = slip
    lane.f1 = motion.f
    lane.tried_h = 0.0
    lane.rate1 = lane.problem.model.spin_rate(lane.y1, motion.f)
    set_limit(lane)
    lane.h_next = FIRST_ANGLE / lane.swing
    lane.root = 1.0
    lane.last = 0.0
    return OK


@njit(**FUSED)
def begin(lane, t):
    """Begin a slide at the end of the step, at time ``t``; return a status."""
    p = lane.y1[0]
    q = lane.y1[1]
    steepest = lane.problem.model.slide.steepest
    if p * p + q * q > steepest * steepest:
        return STEP_TOO_SMALL
    longest = max(lane.h, lane.h_next)
    status = slide_from_rest(lane)
    if status == OK:
        lane.mode = SLIDING
        lane.h_rolling = longest
        lane.t_begin = t
        if lane.n_slides == 0.0:
            lane.t_slide = t
        lane.n_slides += 1.0
    return status


@njit(**FUSED)
def end(lane, t):
    """End a slide at the end of the step, at time ``t``, or let it go on."""
    y = lane.y1
    lane.problem.modes.settle(lane, y, lane.n1, t)
    f = lane.problem.model.rhs(y, lane.constants)
    if hold_margin(lane, y, f) <= 0.0:
        # It slides on in another direction, in which the force is another, too.
        lane.mode = SLIDING
        note_contact(lane)
        return slide_from_rest(lane)
    jump(lane)
    lane.h_next = lane.h_rolling
    lane.slide_time += t - lane.t_begin
    return OK


@njit(**INNER)
def change_rolling(lane, status, move, goes_on, reversals_recorded):
    """Begin a slide after a step that ends at the limit of friction."""
    if lane.refused > 0.0:
        return int(lane.refused), move
    if status == AT_LIMIT and lane.problem.modes.left(lane, lane.y1) < AT_RIM:
        return RIM, move
    if status == AT_LIMIT:
        status = begin(lane, lane.t + (lane.h - lane.t_low))
    return status, move


@njit(**INNER)
def change_sliding(lane, status, move, goes_on, reversals_recorded):
    """End a slide after a step that ends at rest, or say why it cannot go on."""
    if lane.refused > 0.0:
        return int(lane.refused), move
    if status == AT_LIMIT and lane.problem.modes.left(lane, lane.y1) < AT_RIM:
        return RIM, move
    if status == AT_LIMIT:
        contact, _, _ = contact_at_slip(lane, lane.y1, lane.slip1)
        status = why_not(contact)
    elif status == STEP_TOO_SMALL and jams(lane):
        status = JAMMED
    elif status == OK and lane.slip1.speed == 0.0:
        status = end(lane, lane.t + (lane.h - lane.t_low))
    return status, move


@scalar
def slide_point(lane, h, y, f):
    """Return the limit of a slide, which its steps compute with the forces."""
    return lane.limit1


# What differs from bodies that always roll: see `lane.ModeSet`.


@njit(**INNER)
def launch(lane):
    """Slide from the launch on where the plane cannot hold the body."""
    if lane.margin0 >= 0.0:
        return
    lane.y1 = lane.y
    lane.f1 = lane.f
    lane.refused = begin(lane, 0.0)
    lane.slip = lane.slip1
    lane.y = lane.y1
    lane.f = lane.f1
    lane.rate0 = lane.rate1
    lane.h = min(lane.h, lane.h_next)
    limit = lane.limit1
    lane.limit0 = Point(0.0, limit.value, limit.rate)
    start_points(lane)
    # The force that would hold the body never acts.
    lane.ratio_max = 0.0
    lane.normal_min = NEVER
    note_contact(lane)


@njit(**INNER)
def advance(problem, w):
    """Move the slip of all lanes to the end of their step."""
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        slip = lane.slip1
        # Rounding errors of a direction that turns on and on would grow.
        turns = floor(slip.angle / TWO_PI + 0.5)
        lane.slip = Slip(slip.speed, slip.angle - turns * TWO_PI, slip.work)


@njit(**FUSED)
def energy_of(model, y, slip, constants):
    """Return the energy minus the work of friction of a body that may slide."""
    at = model.slide.place(y, slip, 0.0, constants)
    moving = slip_energy(at.u, at.omega, at.r, slip.speed, slip.angle)
    return model.energy(y, constants) + moving - slip.work


@njit(**FUSED)
def force_of(model, y, slip, constants, mu):
    """Return the forces on a body that slides, and the torque along the vertical.

    The forces are the normal and the tangential one.
    """
    contact, _, placed = contact_of(model, y, slip, mu, constants)
    normal, _, _, _, _ = push(contact, mu, slip.angle)
    return normal, mu * normal, normal * dot(placed.drag, placed.u)


@njit(**INNER)
def energy(lane):
    """Return the energy minus the work of friction at the end of the step."""
    return energy_of(lane.problem.model, lane.y1, lane.slip1, lane.constants)


@njit(**INNER)
def work(lane):
    """Return the work of friction until the end of the step, which is negative."""
    return lane.problem.model.work(lane.y1) + lane.slip1.work


@njit(**INNER)
def store(lane):
    """Set the results of slides."""
    if lane.mode == SLIDING:
        lane.slide_time += lane.t_ended - lane.t_begin
    if lane.n_slides == 0.0:
        lane.t_slide = np.nan
    # Zero and not -0 for a run that never slides.
    lane.slide_work = 0.0 - lane.slip1.work / lane.energy0


@njit(**FUSED)
def observe_body(model, y, slip, constants, mu):
    """Return what `ModeSet.observe` does."""
    torque = 0.0
    if slip.speed > 0.0:
        normal, tangential, torque = force_of(model, y, slip, constants, mu)
    else:
        normal, tangential = model.contact(y, constants)
    return energy_of(model, y, slip, constants), normal, tangential, torque


ROLLING_MODE = Mode(
    ROLLING, along_flow(friction_left), change_rolling, hold_margin, is_calm
)
SLIDING_MODE = Mode(SLIDING, slide_point, change_sliding)
