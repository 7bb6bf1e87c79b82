"""Which lanes step in a rack: those that slide take its slots in turns."""

# mypy: ignore-errors

from math import sqrt

import numpy as np
from numba import njit

from rattlesweep.compiling.intrinsics import FUSED, INNER, lowest_bit, widest_vectors
from rattlesweep.kernel import runs
from rattlesweep.kernel.state.fields import (
    STEP,
    Flag,
    Number,
    Past,
    Slip,
)
from rattlesweep.kernel.state.lane import lane_of
from rattlesweep.kernel.state.statuses import (
    JAMMED,
    STEP_TOO_SMALL,
)
from rattlesweep.kernel.state.ways import steps_in_rack
from rattlesweep.kernel.step.sliding_step import (
    BEGINNING,
    FAILED,
    contact_at_slip,
    guess_beginning,
    hold_back,
    load_slot,
    look_ahead,
    note_forces,
    observe,
    set_limit,
    squared_error,
    stretch,
    time_to_rest,
)
from rattlesweep.kernel.step.to_rest import (
    LAST_ANGLE,
    LEAST_LEFT,
    MOST_LEFT,
    SHORTEST_ANGLE,
    fall_to_rest,
    observe_ends,
    rest_after,
    stay,
    step_to_rest,
    turn_to_rest,
)
from rattlesweep.physics.friction.sliding import (
    meets_singularity,
)

# Slots of a rack in which a turn goes on, if lanes that roll step in the same turn.
FEWEST_SLIDING = 4
# Slots that are left for the next turn otherwise.
FEWEST_BUSY = 6
# Slots that become free before others take their places.
FEWEST_FREE = 3


class SlotFields:
    """What a lane that may slide knows of its steps in a rack."""

    waits: Flag  # whether it tries no step in this turn
    past_h: Number  # size of the last step of the slide, 0 if there is none
    tried_h: Number  # the same of the step tried
    # Ratio of the next step to the step tried, 0 where `turn.decide` finds it.
    stretch: Number
    rise: Number  # 18th root of the squared error of the step tried
    past_rise: Number  # the same of the last step
    past: Past  # rates in the last step of the slide (`step.radau`)
    tried: Past  # rates in the step tried


@njit(**FUSED)
def end_or_load(lane, z, slot, scale, contact_recorded):
    """Return whether the step is one of a rack, and copy it there.

    Otherwise the slide ends with it, or is jammed.
    """
    load_slot(lane, z, slot, scale)
    time = time_to_rest(lane, z, slot)
    angle = time * lane.swing
    searches = lane.search != STEP
    if angle < LAST_ANGLE:
        rest = rest_after(lane, time, scale)
        if rest.steady:
            if rest.time < lane.h and not searches:
                lane.h = rest.time
                lane.last = 0.0
            step_to_rest(lane, rest)
            observe_ends(lane, contact_recorded)
            return False
    if angle < SHORTEST_ANGLE:
        mean, direction, time, falls = fall_to_rest(lane)
        if not falls and not searches:
            contact, _, _ = contact_at_slip(lane, lane.y, lane.slip)
            if meets_singularity(contact, lane.mu, lane.slip.angle):
                lane.refused = JAMMED
                stay(lane)
                return False
        if time > 0.0:
            # After rejected steps the rest may be further away than the next step goes.
            if not searches and (time < lane.h or lane.last == 0.0):
                lane.h = time
                lane.last = 0.0
            turn_to_rest(lane, mean, direction, time)
            set_limit(lane)
            observe_ends(lane, contact_recorded)
            return False
        # The speed rises by now.
        time = np.inf
    if not searches:
        # The cubic term of the speed may bring the rest nearer, and errors matter the
        # less the shorter the rest is.
        left = min(MOST_LEFT, max(LEAST_LEFT, 0.5 * sqrt(angle)))
        if time * (1.0 - left) < lane.h:
            lane.h = time * (1.0 - left)
            lane.last = 0.0
    look_ahead(lane, z, slot)
    return True


@njit(**FUSED)
def take_from(lane, z, slot, scale, contact_recorded):
    """Copy the end of a step from a rack, with its error and what is observed."""
    rack = lane.problem.rack
    lane.y1 = rack.state(z, slot)
    lane.slip1 = Slip(*rack.slip(z, slot))
    lane.f1 = rack.rate(z, slot)
    solved = z[rack.busy * rack.width + slot] == 0.0
    if not (solved and lane.slip1.speed > 0.0):
        # Nothing is observed at the end of a step that is not taken.
        hold_back(lane)
        lane.leaves = lane.watched = 0.0
        lane.error = FAILED
        lane.tried_h = 0.0
        return
    rates = rack.rates(z, slot)
    lane.error = squared_error(lane, z, slot, rates, scale)
    lane.tried = rates
    lane.tried_h = lane.h
    lane.stretch = stretch(lane)
    limit_half, lift_half = note_forces(lane, z, slot)
    observe(lane, contact_recorded, limit_half, lift_half)


@njit(**INNER)
def lane_in(problem, w, z, slot):
    """Return the lane whose step is in a slot."""
    rack = problem.rack
    return lane_of(problem, w, int(z[rack.lane * rack.width + slot]) - 1)


@njit(**INNER)
def fill_slots(problem, w, z, waiting, free, scale, contact_recorded):
    """Let lanes take free slots; return those that still wait, and free slots."""
    rack = problem.rack
    before = free
    while waiting != 0 and free != 0:
        l = lowest_bit(waiting)
        waiting &= waiting - 1
        lane = lane_of(problem, w, l)
        slot = lowest_bit(free)
        if end_or_load(lane, z, slot, scale, contact_recorded):
            free &= free - 1
            z[rack.lane * rack.width + slot] = l + 1.0
    taken = before & ~free
    if taken != 0:
        rack.predict(problem, z)
    while taken != 0:
        slot = lowest_bit(taken)
        taken &= taken - 1
        lane = lane_in(problem, w, z, slot)
        if lane.slip.speed <= BEGINNING:
            guess_beginning(lane, z, slot)
    return waiting, free


@njit(**INNER)
def empty(problem, w, z, free, scale, contact_recorded):
    """Take the steps whose equations are solved, or cannot be; return free slots."""
    rack = problem.rack
    for slot in range(rack.width):
        if (free >> slot) & 1 == 0 and z[rack.busy * rack.width + slot] <= 0.0:
            lane = lane_in(problem, w, z, slot)
            take_from(lane, z, slot, scale, contact_recorded)
            z[rack.lane * rack.width + slot] = 0.0
            free |= 1 << slot
    return free


@njit(**INNER)
def schedule_slides(problem, w):
    """Return what `ModeSet.schedule` does: if lanes roll, and if some slide."""
    widest_vectors()
    others = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        others += 1 if (lane.refused > 0.0) | steps_in_rack(lane) else 0
    if others == 0:
        return True, False
    return schedule_turn(problem, w), True


@njit(**INNER)
def schedule_turn(problem, w):
    """Return whether the lanes that roll try a step in this turn, or wait.

    Their step takes as long for one of them as for all, so they wait while most lanes
    slide.  This changes nothing of a run.
    """
    rolling = 0
    sliding = 0
    watched = 0.0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        busy = lane.run >= 0.0
        slides = steps_in_rack(lane)
        sliding += 1 if busy & slides else 0
        rolling += 1 if busy & (not slides) else 0
        watched += lane.watched
    rolls = (rolling >= sliding) | (watched > 0.0)
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        waits = (not rolls) & (not steps_in_rack(lane))
        lane.waits = 1.0 if waits else 0.0
    if not rolls:
        for l in range(problem.lanes):
            lane = lane_of(problem, w, l)
            if lane.waits > 0.0:
                hold_back(lane)
    return rolls


@njit(**INNER)
def sliding_lanes(problem, w):
    """Return which lanes slide, as bits."""
    bits = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        lane.stretch = 0.0
        if lane.refused > 0.0:
            lane.waits = 0.0
            stay(lane)
        bits |= (1 if (lane.refused == 0.0) & steps_in_rack(lane) else 0) << l
    return bits


@njit(**INNER)
def decide_sliding(problem, w, due):
    """Decide on lanes that slide or wait, after all others; return which are due.

    A slide has its own ratio of two steps.  A lane that waits tries its step again.
    """
    waiting = 0
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        waits = lane.waits > 0.0
        # Lanes that are due are looked at later.
        moves = steps_in_rack(lane) & (lane.accept > 0.0) & ((due >> l) & 1 == 0)
        if moves and runs.stalls(lane, True):
            lane.refused = STEP_TOO_SMALL
        if lane.stretch > 0.0:
            ratio = min(lane.stretch, 1.0) if lane.held > 0.0 else lane.stretch
            lane.h_next = min(lane.h * ratio, lane.h_longest)
        if waits:
            lane.h_next = lane.h
            lane.root = lane.root0
            lane.accept = 0.0
            waiting |= 1 << l
    return due & ~waiting


def slide_lanes(problem, w, scale, contact_recorded, fewest):
    """Try a step on lanes that slide.

    Each slot of the rack takes the next lane once its own step is solved.  If fewer
    slots than ``fewest`` are left, their lanes wait, and go on in the next turn.

    The rack is at the end of the workspace.
    """
    rack = problem.rack
    z = w[w.size - rack.rows * rack.width :]
    waiting = sliding_lanes(problem, w)
    free = 0
    for slot in range(rack.width):
        l = int(z[rack.lane * rack.width + slot]) - 1
        if l < 0:
            free |= 1 << slot
        else:
            waiting &= ~(1 << l)
    fewest = min(fewest, FEWEST_BUSY)
    some = False
    while True:
        waiting, free = fill_slots(
            problem, w, z, waiting, free, scale, contact_recorded
        )
        busy = rack.width - bits_of(free)
        if busy == 0 or (some and waiting == 0 and busy < fewest):
            break
        # Fewer are left in the end, or before others come.
        few = max(0, busy - FEWEST_FREE) if waiting != 0 else max(0, fewest - 1)
        few = min(few, busy - 1)
        while rack.iterate(problem, z) > few:
            pass
        free = empty(problem, w, z, free, scale, contact_recorded)
        some = True
    for slot in range(rack.width):
        if (free >> slot) & 1 == 0:
            lane = lane_in(problem, w, z, slot)
            hold_back(lane)
            lane.waits = 1.0


@njit(**INNER)
def bits_of(bits):
    """Return the number of bits that are set."""
    count = 0
    while bits != 0:
        bits &= bits - 1
        count += 1
    return count
