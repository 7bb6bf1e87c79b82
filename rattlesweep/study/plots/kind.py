"""What a kind of picture is made of; `registry` lists those there are."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.study.plots.layout import Layout, Reader

Lengths = Mapping[str, int]
Chosen = Mapping[str, NDArray[np.int64]]


class Data(Reader, Protocol):
    """What a picture shows, gathered from the rows of a sweep as they go by."""

    def table(self) -> pa.Table:
        """The numbers that are drawn."""

    def __len__(self) -> int:
        """Return the number of runs that are shown."""

    def words(self) -> str:
        """How much is shown, in a few words."""


@dataclass(frozen=True)
class Kind:
    """A kind of picture.

    Attributes
    ----------
    name : str
    caption : str
        What stands below it in a report; empty: it is not in reports.
    fits : callable
        Whether it suits a layout of which so many values of each axis are left.
    order : callable
        From these two and the abscissa that is asked for: the axes in the order that `draw` wants
        them.
    gather : callable
        From a layout, these axes and the places along any axes that are taken: its data.
    size : callable
        Width and height in inches that suit some data.
    draw : callable
        Draws data into a figure; the last argument is whether axes are logarithmic, None for as
        suits the values.
    x_limits : callable
        Whether the abscissa of some data has limits that can be chosen.
    """

    name: str
    caption: str
    fits: Callable[[Layout, Lengths], bool]
    order: Callable[[Layout, Lengths, str | None], tuple[str, ...]]
    gather: Callable[[Layout, Sequence[str], Chosen], Any]
    size: Callable[[Any], tuple[float, float]]
    draw: Callable[[Any, Any, bool | None], None]
    x_limits: Callable[[Any], bool] = lambda data: True


def abscissa(left: Lengths, candidates: Sequence[str], x: str | None) -> str:
    """The axis that is asked for, else the first with more than two values, else the longest."""
    return (
        x
        or next((name for name in candidates if left[name] > 2), None)
        or max(candidates, key=left.__getitem__)
    )
