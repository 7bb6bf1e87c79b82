"""Modes of a lane as numbers, and what others than the modes may ask of them.

What a lane does in a mode is in `kernel.mode`.  No other code tests ``lane.mode``.  It
asks the functions here for what it needs to know.
"""

# mypy: ignore-errors
from rattlesweep.kernel.state.fields import Flag, Number, OfEnd, Point
from rattlesweep.physics.full import scalar

# It rolls, slides, rolls with a torque against its spin, or rolls with its spin held at
# zero.
ROLLING, SLIDING, PIVOTING, HELD = 0.0, 1.0, 2.0, 3.0


class ModeFields:
    """The mode of a lane, and its limit."""

    mode: Number  # ROLLING, SLIDING, ...
    margin0: Number  # a smooth function with the sign of the limit, while it rolls
    margin1: OfEnd[Number]  # the same at the end of the step
    # The limit of the mode; while the lane rolls, only of steps that are searched.
    limit0: Point
    limit1: Point
    leaves: Flag  # whether the step may end at a zero of the limit
    h_limit: Number  # size of the step that does


@scalar
def steps_in_rack(lane):
    """Return whether the lane slides, so that it steps in a rack (`step.slots`).

    Its limit is then known at the ends of every step.
    """
    return lane.mode == SLIDING


@scalar
def keeps_zero(lane):
    """Return whether the spin is held at zero."""
    return lane.mode == HELD


@scalar
def turns_at_zero(lane):
    """Return whether a zero of the spin ends the mode."""
    return lane.mode == PIVOTING


@scalar
def counts_zeros(lane):
    """Return whether zeros of the spin are events within a smooth motion."""
    # After a launch without spin, none counts before the spin is far.  In PIVOTING, the
    # mode ends at a zero, and in HELD the spin stays there.
    mode = lane.mode
    return (lane.arm == 0.0) & (mode != PIVOTING) & (mode != HELD)


@scalar
def mode_of(speed, has_sense, sense):
    """Return the mode of a lane with a speed of slip and a sense of its spin.

    The sense is the sign of the spin, or 0 where it is held.  Only a body with pivoting
    friction has one.
    """
    rolling = ROLLING
    if has_sense:
        rolling = HELD if sense == 0.0 else PIVOTING
    return SLIDING if speed > 0.0 else rolling
