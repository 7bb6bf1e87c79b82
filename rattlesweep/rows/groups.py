"""What a column of the table `runs` is, and a group of columns."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import pyarrow as pa

from rattlesweep.rows.arrow import F64, Values, field
from rattlesweep.words.quantities import QUANTITIES, Definition
from rattlesweep.words.watched import (
    EXTREME_QUANTITIES,
    ExtremeQuantity,
    ExtremeWord,
    MarkQuantity,
)

if TYPE_CHECKING:
    # What is stored is read without the kernels, which results need.
    from rattlesweep.rows.results import Results

_Source: TypeAlias = "Callable[[Results], Values]"
"""Function of the results of a block that returns a column."""


@dataclass(frozen=True)
class Column:
    """A column of `runs`, and where its value comes from.

    A name in :data:`rattlesweep.words.quantities.QUANTITIES` has its unit and meaning
    from there; only the others are given here.
    """

    name: str
    type: pa.DataType
    source: _Source
    unit: str = "1"
    meaning: str = ""
    # Appended to the meaning: what a null means, or a sign.
    note: str = ""
    formula: str = ""
    nullable: bool = True
    # Whether `bodies.refine.by` may compare it.
    refines: bool = False

    @property
    def definition(self) -> Definition:
        """Symbol, unit and meaning."""
        if self.name in QUANTITIES:
            return QUANTITIES[self.name]
        return Definition(self.name, self.unit, self.meaning, formula=self.formula)

    @property
    def field(self) -> pa.Field:
        """The column of the Arrow schema."""
        definition = self.definition
        meaning = definition.meaning
        if self.note:
            meaning = f"{meaning}; {self.note}"
        return field(self.name, self.type, definition.unit, meaning, self.nullable)


@dataclass(frozen=True)
class Group:
    """Columns that a sweep has together."""

    name: str
    # In the documentation; groups with one heading share a table.
    heading: str
    columns: tuple[Column, ...]
    # Whether only sweeps that ask for the group have it.
    optional: bool = False
    # Whether they ask for it by a word of `record`, the name.
    recorded: bool = False
    # Models that do not have it.
    not_with: tuple[str, ...] = ()


# A column without nulls.
must = partial(Column, nullable=False)
# Columns that a word of `record` adds.
on_request = partial(Group, optional=True, recorded=True)


def of_loss(name: str) -> Column:
    """Return the column of a constant of dissipation, such as ``sigma``."""
    return must(name, F64, lambda runs: runs.launches.losses[name])


def of_surface(name: str) -> Column:
    """Return the column of a constant of the surface."""
    return Column(
        name,
        F64,
        lambda runs: runs.launches.bodies.further[name],
        note="null: a paraboloid",
    )


def of_mark(mark: MarkQuantity) -> Group:
    """Return the column of a mark, which its name adds."""
    column = Column(
        mark.name,
        F64,
        lambda runs: runs.integrated.mark(mark.name),
        mark.unit,
        mark.meaning,
        mark.note,
        refines=True,
    )
    return on_request(
        mark.name, f"`record: [{mark.name}]`", (column,), not_with=("gh",)
    )


def of_extremes(word: ExtremeWord) -> Group:
    """Return the columns of the extremes that a word of `record` adds."""
    extremes = [each for each in EXTREME_QUANTITIES if each.word == word]
    return on_request(
        word,
        f"`record: [{word}]`",
        tuple(map(_of_extreme, extremes)),
        not_with=("reduced", "gh"),
    )


def _of_extreme(extreme: ExtremeQuantity) -> Column:
    return Column(
        extreme.name,
        F64,
        lambda runs: runs.integrated.extreme(extreme.name),
        extreme.unit,
        extreme.meaning,
        refines=True,
    )
