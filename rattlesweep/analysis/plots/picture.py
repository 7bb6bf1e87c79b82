"""What pictures have in common: runs counted by cell, panels, axes, heading, legend, caption."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from rattlesweep.analysis.plots.layout import Axis, Layout
from rattlesweep.analysis.style import add_caption, add_legend, new_figure, save_table, value_text
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.messages import not_one_of
from rattlesweep.sweeps.counts import Counts, Moments, share, wilson

MOST_CELLS = 4_000_000
MOST_PANELS = 40
BESIDE = "<beside>"
"""Label of Axes, like "<colorbar>", whose limits are their own."""
# Values that spread over more than this ratio are shown by their logarithms.
WIDE = 30.0
# Inches of an abscissa on which no more than a few numbers have room.
NARROW = 1.1


class Picture(ABC):
    """A picture of a sweep.

    A kind is a subclass and a word in `kinds.KINDS`. `axes` are those that it tells apart, the
    abscissa first: runs that differ in others are counted together. `more` are columns of which
    each cell has a mean. Drawing fills `notes`, the sentences of the caption.
    """

    name: ClassVar[str]
    more: tuple[str, ...] = ()

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        self.layout, self.quantity = layout, quantity
        self.unit = "" if quantity is None else unit_of(layout, quantity, "--quantity")
        self.axes: tuple[Axis, ...] = tuple(layout.axes[name] for name in self.order(layout, x))
        self.notes: list[str] = []
        if math.prod(self.shape) > MOST_CELLS:
            raise ConfigError(
                f"{math.prod(self.shape)} cells are too many for a picture; choose some with "
                "--select"
            )

    @staticmethod
    def fits(layout: Layout) -> bool:
        """Tell whether the kind suits what varies."""
        return True

    @classmethod
    def order(cls, layout: Layout, x: str | None) -> Sequence[str]:
        """Return the names of `axes`, for the abscissa that is asked for."""
        return ()

    @abstractmethod
    def size(self) -> tuple[float, float]:
        """Return the width and height in inches that suit what is shown."""

    @abstractmethod
    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw it and return the entries of its legend; `log` None: as suits the values."""

    def side_by_side(self) -> bool:
        """Tell whether values stand side by side along the abscissa, which then has no limits."""
        return False

    # -- numbers -------------------------------------------------------------------------------

    @property
    def shape(self) -> tuple[int, ...]:
        """Values along each axis."""
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def _sorted(self) -> list[Axis]:
        """The axes in the order of the layout, in which pictures share their counts."""
        names = [axis.name for axis in self.axes]
        return [axis for axis in self.layout.axes.values() if axis.name in names]

    @property
    def counted(self) -> tuple[Counts, dict[str, Moments]]:
        """The runs by cell and the moments of `more`, with cells in the order of the layout."""
        return self.layout.count(self._sorted, self.more)

    @property
    def cells(self) -> Counts:
        """The runs by cell; :meth:`grid` puts its arrays along `axes`."""
        return self.counted[0]

    def __len__(self) -> int:
        """Return the number of runs that are shown."""
        return int(self.cells.runs.sum())

    def grid(self, flat: NDArray[Any]) -> NDArray[Any]:
        """Give an array over the cells the shape of `axes`."""
        names = [axis.name for axis in self._sorted]
        found: NDArray[Any] = flat.reshape([len(axis.values) for axis in self._sorted])
        return found.transpose([names.index(axis.name) for axis in self.axes])

    def mean(self, column: str) -> Floats:
        """Return the mean of one of the columns `more`, in the shape of the axes."""
        return self.grid(self.counted[1][column].means())

    def table(self) -> pa.Table:
        """Return the numbers that are drawn: one row for each cell that holds runs."""
        cells = self.cells
        names = [axis.name for axis in self.axes]
        columns: dict[str, Any] = {
            axis.name: np.full(self.shape, axis.values[0])
            for axis in reversed(self.layout.axes.values())
            if len(axis.values) == 1 and axis.name not in names
        }
        meshes = np.meshgrid(*(axis.values for axis in self.axes), indexing="ij")
        columns |= dict(zip(names, meshes, strict=True))
        flat: dict[str, Any] = {"runs": cells.runs, "failed": cells.failed}
        for name, part in cells.types.items():
            low, high = wilson(part, cells.ok)
            flat |= {f"fraction_{name}": share(part, cells.ok), f"fraction_{name}_low": low,
                     f"fraction_{name}_high": high}  # fmt: skip
        flat["fraction_bondi"] = share(cells.bondi, cells.steady)
        for name, moments in (("t_r", cells.t_r), ("ratio", cells.ratio)):
            flat |= {f"{name}_mean": moments.means(), f"{name}_std": moments.deviations(),
                     f"{name}_sem": moments.errors()}  # fmt: skip
        flat["t_rgh_mean"] = cells.t_rgh.means()
        flat |= {f"{name}_mean": m.means() for name, m in self.counted[1].items()}
        if cells.has_errors:
            flat["t_r_mean_error"] = cells.t_r_error.means()
            flat |= {"sensitive": cells.sensitive, "unsure": cells.unsure}
        columns |= {name: self.grid(values) for name, values in flat.items()}
        kept = columns["runs"] > 0
        return pa.table({n: pa.array(v[kept], from_pandas=True) for n, v in columns.items()})

    def write_data(self, path: Path) -> None:
        """Write the numbers that are drawn as CSV or Parquet, in one step."""
        save_table(self.table(), path)

    def words(self) -> str:
        """Return how much is shown."""
        return f"{len(self):,} runs"

    @property
    def caption(self) -> str:
        """What a reader needs to know besides labels, in plain words; known once it is drawn."""
        return " ".join(self.notes)

    # -- the figure ----------------------------------------------------------------------------

    def figure(
        self,
        *,
        title: str | None = None,
        log: bool | None = None,
        size: tuple[float, float] | None = None,
        xlim: tuple[float, float] | None = None,
        ylim: tuple[float, float] | None = None,
        captioned: bool = True,
    ) -> Figure:
        """Draw it; None: as suits the values.

        Raises
        ------
        OutputError
            There is no run to show.
        ConfigError
            An axis cannot be so.
        """
        if not len(self):
            chosen = self.layout.where or any(a.pinned for a in self.layout.axes.values())
            which = "of those selected" if chosen else "that this picture could show"
            raise OutputError(f"{self.layout.stored.directory} holds no run {which}")
        figure = new_figure(*(size or self.size()))
        self.notes = []
        handles = self.draw(figure, log)
        for which, limits in (("x", xlim), ("y", ylim)):
            if limits is not None:
                self._limit(figure, which, limits)
        # A selection of one value is nowhere else in the picture.
        axes = self.layout.axes.values()
        pinned = ", ".join(value_text(a.name, float(a.values[0])) for a in axes if a.pinned)
        where = self.layout.where
        # As it was written: a dollar in it begins no formula.
        condition = where.text.replace("$", "\\$") if where else ""
        add_legend(figure, handles, [line for line in (title, pinned, condition) if line])
        if captioned:
            add_caption(figure, self.caption, grow=size is None)
        return figure

    def _limit(self, figure: Figure, which: str, limits: tuple[float, float]) -> None:
        """Give every panel these limits."""
        option = f"--{which}lim {limits[0]:g},{limits[1]:g}"
        if which == "x" and self.side_by_side():
            raise ConfigError(f"{option}: so few values stand side by side; choose with --select")
        for axes in figure.axes:
            if axes.get_label() in (BESIDE, "<colorbar>"):
                continue
            if getattr(axes, f"get_{which}scale")() == "log":
                if limits[0] <= 0:
                    raise ConfigError(
                        f"{option}: a logarithmic axis has no such end; add --linear, or give a "
                        "positive one"
                    )
                plain_ticks(axes, which, limits)
            getattr(axes, f"set_{which}lim")(limits)


def abscissa(layout: Layout, candidates: Sequence[str], x: str | None) -> str:
    """Return the axis asked for, else the first with more than two values, else the longest."""
    return (
        x
        or next((name for name in candidates if layout.lengths[name] > 2), None)
        or max(candidates, key=layout.lengths.__getitem__)
    )


def numeric_columns(layout: Layout) -> dict[str, str]:
    """Return the columns of the runs that hold one number a run, with their units."""
    schema = layout.stored.schema
    numbers = [f for f in schema if pa.types.is_floating(f.type) or pa.types.is_integer(f.type)]
    return {f.name: f.metadata[b"unit"].decode() for f in numbers}


def unit_of(layout: Layout, column: str, option: str) -> str:
    """Return the unit of a numeric column; raise a ConfigError if there is none of this name."""
    units = numeric_columns(layout)
    if column not in units:
        raise ConfigError(f"{option}: {not_one_of(column, units)}")
    return units[column]


# -- panels and axes -----------------------------------------------------------------------------


def draw_panels(
    figure: Any, rows: Sequence[Axis], columns: Sequence[Axis], xlabel: str, *, parts: int = 1
) -> list[tuple[Any, tuple[int, ...]]]:
    """Make panels: a row for each combination of some axes' values, columns likewise.

    Values are written above each column and at the right of each row. Each combination has `parts`
    panels, side by side. Returns the Axes of each panel with the places of its values; raises a
    ConfigError if there would be too many.
    """
    down, across = (
        list(product(*(range(len(axis.values)) for axis in axes))) for axes in (rows, columns)
    )
    if len(down) * len(across) > MOST_PANELS:
        names = " and ".join(axis.name for axis in (*rows, *columns) if len(axis.values) > 1)
        raise ConfigError(
            f"there would be {len(down) * len(across)} panels, one for each {names}; choose some "
            "with --select, as in --select n_i=-0.3,-0.5"
        )
    wide = [column for column in across for _ in range(parts)]
    grid = figure.subplots(len(down), len(wide), sharex=True, sharey=True, squeeze=False)
    for axes, column in zip(grid[0], wide, strict=True):
        axes.set_title(_text(columns, column), fontsize="medium")
    for axes in grid[-1]:
        axes.set_xlabel(xlabel)
    for axes, row in zip(grid[:, -1], down, strict=True):
        axes.annotate(_text(rows, row), (1.02, 0.5), xycoords="axes fraction", rotation=270,
                      va="center", ha="left")  # fmt: skip
    places = [row + column for row, column in product(down, wide)]
    return list(zip(grid.flat, places, strict=True))


def _text(axes: Sequence[Axis], places: Sequence[int]) -> str:
    return ", ".join(
        value_text(axis.name, float(axis.values[place]))
        for axis, place in zip(axes, places, strict=True)
        if len(axis.values) > 1
    )


def entry(words: str, **look: Any) -> Line2D:
    """Make an entry of a legend."""
    return Line2D([], [], label=words, **{"linestyle": "", **look})


def scale_axis(axes: Any, which: str, values: Any, log: bool, name: str = "t_r") -> None:
    """Make an axis for values of some name logarithmic if `log`."""
    if not log:
        return
    ends = float(np.min(values)), float(np.max(values))
    if ends[0] <= 0:
        raise ConfigError(f"--log: {name} has values that are not positive; leave it out")
    getattr(axes, f"set_{which}scale")("log")
    plain_ticks(axes, which, ends)


def plain_ticks(axes: Any, which: str, ends: tuple[float, float]) -> None:
    """Set ticks of a logarithmic axis in plain numbers, enough of them over half a decade too."""
    span = ends[1] / ends[0] if ends[0] > 0 else 1.0
    axis = getattr(axes, f"{which}axis")
    subs: tuple[float, ...] = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
    for least, coarser in ((4, (1.0, 2.0, 5.0)), (40, (1.0, 3.0)), (300, (1.0,))):
        if span > least:
            subs = coarser
    if which == "x" and axes.get_position().width * axes.get_figure().get_figwidth() < NARROW:
        subs = (1.0,) if span > 8 else (1.0, 3.0)
    axis.set_major_locator(MaxNLocator(4) if span < 2 else LogLocator(subs=subs, numticks=20))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
