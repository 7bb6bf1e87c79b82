"""Marks: times at which a function of the spin first falls to zero in a run.

A mark is a record.  A further one is an entry of :data:`MARKS` here, and its name and
meaning in `words.watched`.  Its zero is found within an accepted step by Newton's
method in a bracket, with shorter steps of the method (`event.peaks`).  The search
changes nothing else of the run.
"""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

from numba import njit

from rattlesweep.arrays import Floats
from rattlesweep.compiling.intrinsics import INNER, choice
from rattlesweep.kernel.state.fields import Flag, Number, OfEnd, Peak
from rattlesweep.physics.full import scalar
from rattlesweep.words.watched import MarkName


class MarkFields:
    """The search for marks in a step."""

    marks_due: OfEnd[Number]  # bits of those that the step may hold
    mark_peak: OfEnd[Peak]  # where one may fall to zero within it, with a minus sign
    looks: Flag  # whether the point tried is to tell if a mark lies before it
    mark_found: Number  # 1 + the index of one that was found in it, or 0
    t_mark: Number  # its time


class Mark(NamedTuple):
    """A function of the spin whose first zero is recorded."""

    name: MarkName
    # value(n, rate, n_launch): the function and its rate; positive before the mark
    value: Callable[..., Any]


@scalar
def above_half(n, rate, n_launch):
    """Return by how much the spin exceeds half its size at launch, and its rate."""
    side = 1.0 if n_launch > 0.0 else -1.0
    return side * n - 0.5 * abs(n_launch), side * rate


MARKS = (Mark("t_half", above_half),)
"""The marks, in the order of their columns in a Recording."""


value_of = choice({k: mark.value for k, mark in enumerate(MARKS)}, inline=True)


@dataclass(frozen=True)
class MarkRecord:
    """Times of marks, over runs."""

    marks: Annotated[Floats, (1, len(MARKS))]

    def mark(self, name: MarkName) -> Floats:
        """Return the times of a mark, NaN where there is none."""
        place = [mark.name for mark in MARKS].index(name)
        return self.marks[:, 0, place]


@njit(**INNER)
def note_mark(lane, marks):
    """Store the mark that was found in the step, if there is one."""
    if lane.mark_found > 0.0:
        marks[int(lane.run), 0, int(lane.mark_found) - 1] = lane.t_mark
        lane.mark_found = 0.0
