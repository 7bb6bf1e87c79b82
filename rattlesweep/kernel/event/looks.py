"""Looks into steps: may a step tried hold an extreme or a mark that is recorded?

Every turn looks at all lanes at once, by a glance at the middle of their steps, and
follows functions through long ones (`look.inside`).  A lane whose step may hold
something new is watched: the step is then searched (`event.zeros`).

What looks at a word of `record` is a part (:data:`LOOKS_AT`), compiled for each model
and called by its address (`kernel.turn`).  It is only loaded where this word is
recorded.
"""

# mypy: ignore-errors

from numba import njit

from rattlesweep.compiling.intrinsics import FUSED, INNER
from rattlesweep.kernel.event.peaks import mark_points
from rattlesweep.kernel.look import extremes, inside
from rattlesweep.kernel.look.marks import MARKS, value_of
from rattlesweep.kernel.state.fields import Flag, Number, Peak
from rattlesweep.kernel.state.lane import lane_of


class LookFields:
    """What a look tells of the step tried."""

    inside: Flag  # whether it is long, and may hold a peak
    # Of no lane: what is seen of a long step at places side by side (`look.inside`).
    seen_first: Number
    seen_second: Number


@njit(**FUSED)
def dip_of_mark(lane, k, start, end):
    """Return where a mark may fall to zero within the step tried, as a peak."""
    if inside.is_long(lane):
        if not lane.error <= 1.0:
            return Peak(0.0, 0.0, 0.0)
        return inside.follow(lane, inside.rates_beyond(lane), inside.MARK, k)
    n = lane.problem.model.spin(inside.middle(lane))
    half, _ = value_of(k, n, 0.0, lane.n_launch)
    seen = inside.glance(
        inside.turned_over(start), -half, inside.turned_over(end), lane.h * lane.swing
    )
    return inside.peak_if(seen.value > 0.0, seen)


@njit(**INNER)
def observe_marks(problem, w, marks):
    """Compute which steps tried may hold a mark that has not been reached."""
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        run = int(lane.run)
        due = 0
        # As in `may_reverse`: what the spin may come down and back up in the step.
        path = 2.0 * lane.h * max(0.9 * lane.rate_max, abs(lane.rate1))
        if run >= 0 and lane.n_launch != 0.0:
            for k in range(len(MARKS)):
                if marks[run, 0, k] >= 0.0:
                    continue
                start, end = mark_points(lane, k)
                if start.value + end.value > path:
                    continue
                seen = dip_of_mark(lane, k, start, end)
                if end.value <= 0.0 or seen.h > 0.0:
                    if due == 0:
                        lane.mark_peak = seen
                    due += 1 << k
        lane.marks_due = due
        lane.watched += due


def look_at_marks(problem, w, stage, may_put_off, marks):
    """Look at marks in the steps tried on all lanes; ``marks`` has their times."""
    if stage == extremes.STEPPED:
        observe_marks(problem, w, marks)


# What looks at the words of `record`, by the word.
LOOKS_AT = extremes.LOOKS_AT_EXTREMES | {"marks": look_at_marks}
