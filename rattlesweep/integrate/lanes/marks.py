"""Marks: times at which a function of the spin first falls to zero in a run.

A mark is a record; a further one is an entry of :data:`MARKS` here, and a column.  Its
zero is found within an accepted step by Newton's method in a bracket, with shorter
steps of the method (`lanes.events`), and changes nothing else of the run.
"""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Callable
from typing import Any, NamedTuple

from rattlesweep.physics.full import scalar


class Mark(NamedTuple):
    """A function of the spin whose first zero is recorded."""

    name: str
    # value(n, rate, n_launch): the function and its rate; positive before the mark
    value: Callable[..., Any]


@scalar
def above_half(n, rate, n_launch):
    """Return by how much the spin exceeds half its size at launch, and its rate."""
    side = 1.0 if n_launch > 0.0 else -1.0
    return side * n - 0.5 * abs(n_launch), side * rate


MARKS = (Mark("t_half", above_half),)
"""The marks, in the order of their columns in a Recording."""


def _joined(marks: tuple[Mark, ...]) -> Callable[..., Any]:
    """Return ``value(k, n, rate, n_launch)`` of the mark ``k``."""
    value = marks[0].value

    @scalar
    def last(k, n, rate, n_launch):
        return value(n, rate, n_launch)

    formula: Callable[..., Any] = last
    if len(marks) > 1:
        others = _joined(marks[1:])

        @scalar
        def one_of(k, n, rate, n_launch):
            if k == 0:
                return value(n, rate, n_launch)
            return others(k - 1, n, rate, n_launch)

        formula = one_of
    return formula


value_of = _joined(MARKS)
