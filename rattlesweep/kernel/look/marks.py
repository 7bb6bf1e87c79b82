"""Marks: times at which a function of the spin first falls to zero in a run.

A mark is a record; a further one is an entry of :data:`MARKS` here, and a column.  Its
zero is found within an accepted step by Newton's method in a bracket, with shorter
steps of the method (`event.zeros`), and changes nothing else of the run.
"""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Callable
from typing import Any, NamedTuple

from rattlesweep.compiling.intrinsics import choice
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


value_of = choice({k: mark.value for k, mark in enumerate(MARKS)}, inline=True)
