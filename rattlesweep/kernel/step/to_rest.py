"""The last step of a slide, until the contact point is at rest."""

# mypy: ignore-errors

from math import exp
from typing import NamedTuple

from numba import njit

from rattlesweep.compiling.intrinsics import FUSED, INNER, moved
from rattlesweep.kernel.look.inside import (
    both,
    halfway,
)
from rattlesweep.kernel.state.fields import (
    Point,
    Slip,
)
from rattlesweep.kernel.step.sliding_motion import (
    LEAST_MOBILITY,
    Motion,
)
from rattlesweep.kernel.step.sliding_step import (
    BEGINNING,
    hold_back,
    motion_of,
    observe,
    squared_rounding,
)

# A slide ends with a step of second order if its rest is as short as this, in radians
# of the fastest swing, and the rates hardly change.
LAST_ANGLE = 1e-4
# Squared error, in units of the tolerance, of a step of first order at that place.
LAST_ERROR = 1e-3
# If the deceleration changes by more than this share until then, the direction turns.
STEADY = 0.1
# A slide that comes to rest within this angle ends with one step in any case, in which
# only the direction changes.
SHORTEST_ANGLE = 1e-8
# Where the direction turns, that step is cut into pieces, in which the speed falls by
# this factor's exponential: it changes by what is left after all of them, 2e-4.
FALL = 0.1
FALLS = 85
# A turn in an e-fold of the speed, times the angle until rest, that does not count.
SETTLED = 1e-15
# Fraction of the time to rest that a step leaves: at least, and at most.
LEAST_LEFT = 0.01
MOST_LEFT = 0.3


class Rest(NamedTuple):
    """The end of a slide whose rates hardly change until it."""

    now: Motion  # at the start of the step
    then: Motion  # at rest
    time: float  # until rest
    steady: bool  # whether the rates hardly change


@njit(**FUSED)
def rest_after(lane, time, scale):
    """Return the :class:`Rest` that a slide reaches after about some time."""
    slip = lane.slip
    now = motion_of(lane, lane.y, slip)
    # Where the angle is stiff, it follows the force at once, as in an implicit step.
    turn = time * now.slip.angle / (1.0 + time * abs(now.stiffness))
    state = moved(lane.y, now.f, time)
    then = motion_of(lane, state, Slip(BEGINNING, slip.angle + turn, slip.work))
    bend = then.slip.speed - now.slip.speed
    # A step along the derivative at the start would have this error.
    lacking = moved(then.f, now.f, -1.0)
    error, size = lane.problem.model.error(lacking, state, lane.constants)
    error = 0.25 * time * time * (error + bend * bend)
    # The last step may tell of a fall where the speed rises by now.
    steady = (
        (abs(bend) <= -STEADY * now.slip.speed)
        & (error <= max(LAST_ERROR * size / scale, squared_rounding(lane)))
        & (then.mobility > LEAST_MOBILITY)
    )
    mean = now.slip.speed + 0.5 * bend
    return Rest(now, then, -slip.speed / mean if steady else time, steady)


@njit(**FUSED)
def step_to_rest(lane, rest):
    """Step to rest, or towards it if the step is shorter, with the forces there."""
    h = lane.h
    slip = lane.slip
    now = rest.now
    then = rest.then
    share = h / rest.time
    change = moved(then.f, now.f, -1.0)
    bend = then.slip.speed - now.slip.speed
    speed = slip.speed + h * (now.slip.speed + 0.5 * share * bend)
    lane.slip1 = Slip(
        max(speed, BEGINNING) if share < 1.0 else 0.0,
        slip.angle,
        slip.work + h * now.slip.work * (1.0 - 0.5 * share),
    )
    lane.y1 = moved(moved(lane.y, now.f, h), change, 0.5 * h * share)
    lane.f1 = moved(now.f, change, share)
    lane.error = 0.0
    left = lane.problem.modes.left
    start = both(now.margin, left(lane, lane.y))
    margin = now.margin + share * (then.margin - now.margin)
    limit = both(margin, left(lane, lane.y1))
    normal = now.normal + share * (then.normal - now.normal)
    lane.limit1 = Point(h, limit, (limit - start) / h)
    lane.lift1 = Point(h, -normal, (now.normal - then.normal) / rest.time)
    lane.ratio1 = Point(h, lane.mu, 0.0)


@njit(**FUSED)
def fall_to_rest(lane):
    """Return how a slide comes to rest, soon.

    The results are the mean derivative of the state until rest, the direction there,
    the time until then, and whether the body can come to rest.  The direction turns by
    ``across / along`` in each e-fold of the speed, and may turn until the end.
    """
    slip = lane.slip
    now = motion_of(lane, lane.y, slip)
    rest = -slip.speed / now.slip.speed
    falls = now.slip.speed < 0.0
    if not falls or abs(now.slip.angle * rest * rest * lane.swing) < SETTLED:
        return now.f, slip.angle + rest * now.slip.angle, rest, falls
    nothing = moved(now.f, now.f, -1.0)
    path = nothing
    time = 0.0
    for _ in range(FALLS):
        rest = -slip.speed / now.slip.speed
        # Linearly implicit: a direction to which slides turn fast is stiff.
        stiffness = min(1.0, 0.5 * FALL * rest * now.stiffness)
        turned = FALL * rest * now.slip.angle / max(0.5, 1.0 - stiffness)
        later = Slip(slip.speed * exp(-FALL), slip.angle + turned, slip.work)
        after = motion_of(lane, lane.y, later)
        falls = after.slip.speed < 0.0 and after.mobility > 0.0
        if not falls:
            break
        half = 0.5 * (slip.speed - later.speed)
        path = moved(path, now.f, -half / now.slip.speed)
        path = moved(path, after.f, -half / after.slip.speed)
        time -= half / now.slip.speed + half / after.slip.speed
        slip = later
        now = after
    rest = -slip.speed / now.slip.speed
    path = moved(path, now.f, rest)
    time += rest
    return moved(nothing, path, 1.0 / time), slip.angle, time, falls


@njit(**FUSED)
def turn_to_rest(lane, mean, angle, rest):
    """Step along the mean derivative, to rest if the step is as long as that takes."""
    h = lane.h
    slip = lane.slip
    now = motion_of(lane, lane.y, slip)
    lane.slip1 = Slip(
        slip.speed * (1.0 - h / rest) if h < rest else 0.0,
        slip.angle + h / rest * (angle - slip.angle),
        slip.work + h * now.slip.work,
    )
    lane.y1 = moved(lane.y, mean, h)
    lane.f1 = mean
    lane.error = 0.0


@njit(**INNER)
def stay(lane):
    """Take a step of size zero, so that the run ends where it is."""
    hold_back(lane)
    lane.h = 0.0
    lane.error = 0.0
    lane.last = 0.0
    lane.leaves = 0.0
    lane.watched = 1.0


@njit(**FUSED)
def observe_ends(lane, contact_recorded):
    """Observe a step of which the limit and the forces are known at its ends alone."""
    limit_half = halfway(lane.limit0, lane.limit1)
    lift_half = halfway(lane.lift0, lane.lift1)
    observe(lane, contact_recorded, limit_half, lift_half)
    lane.problem.modes.slow(lane)
