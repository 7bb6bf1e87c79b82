"""What is watched within the steps of a run, in words: marks and extremes.

A further one is named and explained here, and computed in `kernel.look.marks` or
`kernel.look.extremes`.  Its word of `record` and its column of `runs` follow.
"""

from dataclasses import dataclass
from typing import Literal, get_args

from rattlesweep.words.quantities import FORCE, TIME, Definition

MarkName = Literal["t_half"]
"""Marks: words of `record` and columns."""

ExtremeWord = Literal["contact"]
"""Words of `record` for extremes."""

ExtremeName = Literal["contact_ratio_max", "contact_normal_min"]
"""Columns of extremes."""


@dataclass(frozen=True)
class MarkQuantity(Definition):
    """The first time at which a function of the spin is zero."""

    name: MarkName
    note: str = "null: never"


@dataclass(frozen=True)
class ExtremeQuantity(Definition):
    """The largest or the least value of a function of the state in a run."""

    name: ExtremeName
    word: ExtremeWord = "contact"


MARK_QUANTITIES = (
    MarkQuantity("t_half", TIME, "first time at which the spin has half its size"),
)
"""What marks are, in the order of their columns."""

EXTREME_QUANTITIES = (
    ExtremeQuantity(
        "contact_ratio_max",
        "1",
        "largest F_perp / F_parallel at the contact",
        word="contact",
    ),
    ExtremeQuantity(
        "contact_normal_min",
        FORCE,
        "smallest F_parallel; negative: lift-off",
        word="contact",
    ),
)
"""What extremes are, in the order of their columns."""

EXTREME_WORDS: tuple[ExtremeWord, ...] = get_args(ExtremeWord)
