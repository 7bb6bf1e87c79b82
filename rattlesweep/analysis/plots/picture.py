"""What all pictures of a sweep share: panels, headings, legends and tables."""

import math
import textwrap
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rattlesweep.analysis import room, style
from rattlesweep.analysis.labels import Labels
from rattlesweep.analysis.layout import LAUNCH_COLUMNS, Axis, SweepLayout
from rattlesweep.analysis.style import label, value_text
from rattlesweep.arrays import Floats
from rattlesweep.rows.arrow import floats
from rattlesweep.rows.types import codes
from rattlesweep.statistics.intervals import share
from rattlesweep.store.summary import Counts
from rattlesweep.words.errors import ConfigError, OutputError
from rattlesweep.words.names import REGIMES

MOST_PANELS = 40
LEAST_TITLED = 0.9  # inches of a panel that has room for a title
LOW_PANEL = 0.6  # inches of a panel that has room for few ticks
PER_INCH = 11  # letters of a heading in an inch of width
# Values that make an axis long enough for an abscissa, and for a side of a map.
ENOUGH = 3
SIDE = 8
# Values whose largest ratio exceeds this are shown on a logarithmic scale.
WIDE = 30.0
# Inches: around the panels, and the smallest and the largest figure.
MARGINS = (1.6, 1.4)
WISHED_ACROSS = 3  # most panels side by side of those that are wished
SMALLEST = (6.4, 3.4)
LARGEST = 14.0

Handle = Artist  # a legend entry
_T = TypeVar("_T", bound=np.generic)


class Arrangement(NamedTuple):
    """Names of the axes inside a panel, and of the rows and columns of panels."""

    inside: list[str]
    rows: list[str]
    columns: list[str]


class Panel(NamedTuple):
    """A panel, with the places of its values on the axes of the rows and columns."""

    axes: Axes
    place: tuple[int, ...]
    is_lowest: bool = True  # whether it has the label of the abscissa


@dataclass(frozen=True)
class Looks:
    """What the caller wants of a figure; None stands for what suits the values."""

    title: str | None = None
    log: bool | None = None
    caption: bool = True
    size: tuple[float, float] | None = None
    xlim: tuple[float, float] | None = None
    ylim: tuple[float, float] | None = None
    labels: Labels | None = None  # of its texts


class Picture(ABC):
    """A picture of a sweep over `axes`; drawing it fills `notes`, the caption."""

    panel: ClassVar[tuple[float, float]]  # width and height of a panel in inches
    ticks: Sequence[float] = (0.0, 0.5, 1.0)  # of fractions
    ylabel: str  # of all panels, set by drawing
    shows = "of those selected"  # which runs the picture shows
    more: tuple[str, ...] = ()  # columns that are averaged in each cell
    colour: str | None = None  # column that colours the points of a scatter

    def __init__(
        self,
        layout: SweepLayout,
        name: str,
        x: str | None,
        quantity: str | None,
        panels: str | None = None,
    ) -> None:
        self.layout = layout
        self.name = name
        self.x = x
        self.quantity = quantity
        self.panels = panels
        arrangement = self.arrange()
        self.rows = [layout.axes[name] for name in arrangement.rows]
        self.columns = [layout.axes[name] for name in arrangement.columns]
        self.inside = [layout.axes[name] for name in arrangement.inside]
        self.axes = [*self.inside, *self.rows, *self.columns]
        self.notes: list[str] = []
        self.doubts: list[str] = []  # sentences that follow the notes of any drawing

    def arrange(self) -> Arrangement:
        """Return which axes are inside a panel, and which make rows and columns."""
        return Arrangement([], [], [])

    @abstractmethod
    def draw(self, panels: list[Panel], log: bool | None) -> list[Handle]:
        """Draw the panels, and return the legend entries.

        With `log` None, scales are as suits the values.
        """

    @cached_property
    def counted(self) -> tuple[Counts, dict[str, Floats]]:
        """The runs counted by cell, and the means of the columns `more`."""
        return self.layout.count(self.more)

    @property
    def count(self) -> int:
        """The number of panels."""
        return len(_places(self.rows)) * len(_places(self.columns)) * self.parts

    @property
    def parts(self) -> int:
        """The number of panels side by side for each combination of values."""
        return 1

    @property
    def wished(self) -> list[str]:
        """The axis whose values the caller wishes to have panels of their own."""
        return [] if self.panels is None else [self.panels]

    def ordered(self, enough: int, prefer: str = "") -> list[str]:
        """Return the axes of several values but for the wished one; see `ordered`."""
        names = ordered(self.layout, self.x, enough, prefer, self.panels)
        left = [name for name in names if name != self.panels]
        if not left:
            raise ConfigError(
                f"panels {self.panels}: nothing else varies that could be an abscissa; "
                "leave panels out"
            )
        return left

    @property
    def down(self) -> list[tuple[int, ...]]:
        """The places of the rows of panels."""
        return _places(self.rows)

    def __len__(self) -> int:
        return int(self.counted[0]["runs"].sum())

    def grid(self, cells: NDArray[_T]) -> NDArray[_T]:
        """Reshape an array over the cells to the shape of `axes`."""
        names = [axis.name for axis in self.layout.axes.values()]
        order = [names.index(axis.name) for axis in self.axes]
        # Axes that the picture does not have are of one value.
        single = [k for k in range(len(names)) if k not in order]
        whole = cells.reshape(list(self.layout.lengths.values()))
        last = tuple(range(len(order), len(names)))
        return whole.transpose(order + single).squeeze(last)

    def table(self) -> pd.DataFrame:
        """Return the numbers of the picture, one row for each cell that holds runs."""
        return pd.DataFrame(dict(self._numbers()))

    def _numbers(self) -> Iterator[tuple[str, NDArray[np.generic]]]:
        """Yield the columns of the table one by one, as each may be large."""
        cells, means = self.counted
        has_runs = cells["runs"] > 0
        for column, values in self._of_cells(cells, means):
            shown = values[has_runs]
            if shown.dtype == np.int32:  # numbers of runs, as they are held
                shown = shown.astype(np.int64)
            yield column, shown

    def _of_cells(
        self, cells: Counts, means: dict[str, Floats]
    ) -> Iterator[tuple[str, NDArray[np.generic]]]:
        """Yield the columns of the table for all cells."""
        name = self.layout.name
        axes = self.layout.axes.values()
        lengths = tuple(self.layout.lengths.values())
        values_of_axes = [axis.values for axis in axes]
        grid = np.meshgrid(*values_of_axes, indexing="ij", sparse=True, copy=False)
        for axis, values in zip(axes, grid, strict=True):
            yield axis.name, np.broadcast_to(values, lengths).ravel()
        yield "runs", cells["runs"]
        yield "failed", cells["failed"]
        for kind, count in cells.types.items():
            yield f"fraction_{kind}", share(count, cells["ok"])
        for regime in REGIMES:
            if f"regime_{regime}" in cells:
                count = cells[f"regime_{regime}"]
                yield f"fraction_{regime}", share(count, cells["ok"])
        yield "fraction_bondi", share(cells["bondi"], cells["steady"])
        for column, moments in ((name("t_r"), cells.t_r), ("ratio", cells.ratio)):
            yield f"{column}_mean", moments.means()
            yield f"{column}_std", moments.deviations()
            yield f"{column}_sem", moments.errors()
        yield f"{name('t_rgh')}_mean", cells.t_rgh.means()
        for column, mean in means.items():
            yield f"{name(column)}_mean", mean
        if "sensitive" in cells:
            yield "sensitive", cells["sensitive"]
            yield "unsure", cells["unsure"]

    def told(self) -> tuple[str, str]:
        """Return what the picture is of, in words, and the column of its table."""
        raise NotImplementedError

    def alt(self) -> str:
        """Return what the picture shows, for those who cannot see it.

        The sentence gives the values at both ends of the first axis, each a mean over
        the other axes.
        """
        words, column = self.told()
        cells, means = self.counted
        names = ", ".join(axis.name for axis in self.axes)
        sentence = f"{words} of {int(cells['runs'].sum()):,} runs by {names}"
        of_cells = self._of_cells(cells, means)
        values = next(each for name, each in of_cells if name == column).astype(float)
        is_known = np.isfinite(values)
        if not is_known.any():
            return f"{sentence}: no value"
        runs = self.grid(np.where(is_known, cells["runs"], 0))
        weighted = self.grid(np.where(is_known, values, 0.0)) * runs
        others = tuple(range(1, len(self.axes)))
        weights = runs.sum(axis=others)
        places = np.flatnonzero(weights)[[0, -1]]
        first, last = (weighted.sum(axis=others) / np.maximum(weights, 1))[places]
        x = self.axes[0]
        low, high = x.values[places]
        return (
            f"{sentence}: from {first:.3g} at {x.name} = {low:.4g} "
            f"to {last:.3g} at {high:.4g}"
        )

    def read(self, *columns: str) -> Floats:
        """Return cells and columns of runs that are ok, shape (1 + columns, runs)."""
        blocks = [np.empty((1 + len(columns), 0))]
        for rows in self.layout.rows(("case", "sample", "status", *columns)):
            cells = self.layout.cells(rows)
            values = [floats(rows.column(name)) for name in columns]
            ok = codes(rows.column("status"), ("ok",)) == 0
            blocks.append(np.stack([cells, *values])[:, ok & (cells >= 0)])
        return np.concatenate(blocks, axis=1)

    def figure(self, **wanted: Any) -> Figure:
        """Return the figure, whose `Looks` are given by name."""
        self._check_runs()
        looks = Looks(**wanted)

        def drawn(size: tuple[float, float] | None) -> Figure:
            with room.sized(size):
                figure = self._drawn(looks, size)
                room.separate_ticks(figure)
            if size is not None:
                room.check_panels(figure, size)
            return figure

        size = looks.size or room.chosen_size()
        return drawn(None) if size is None else room.with_room(drawn, size)

    def _drawn(self, looks: Looks, size: tuple[float, float] | None) -> Figure:
        """Return the figure, before its texts are fitted."""
        down = self.down
        across = _places(self.columns)
        # Each combination of values has as many panels as the picture has parts.
        across = [place for place in across for _ in range(self.parts)]
        lines, columns = self._lines(len(down), len(across), size)
        if size is None:
            width = self.panel[0] * columns + MARGINS[0]
            height = self.panel[1] * lines + MARGINS[1]
            figure = style.new_figure(*np.clip((width, height), SMALLEST, LARGEST))
        else:
            figure = style.new_figure(*size)
        if figure.get_figheight() < LOW_PANEL * lines + MARGINS[1]:
            self.ticks = [0.0, 1.0]
        grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
        places = [row + column for row, column in product(down, across)]
        every = list(grid.flat)
        for spare in every[len(places) :]:
            spare.remove()
        # The lowest panels of a column are numbered, and the others are not.
        lowest = [place + columns >= len(places) for place in range(len(places))]
        panels = [Panel(*each) for each in zip(every, places, lowest, strict=False)]
        self._head_panels(panels, columns, is_wrapped=lines > len(down))
        self.notes.clear()
        handles = self.draw(panels, looks.log)
        for panel in panels[::columns]:
            panel.axes.set_ylabel(self.ylabel)
        _limit([panel.axes for panel in panels], looks)
        heading = [looks.title or "", *self._selection(figure.get_figwidth())]
        notes = [*self.notes, *self.doubts]
        labels = looks.labels
        if labels is not None:
            labels.rename(handles)
            heading = [labels(line) if line else "" for line in heading]
            notes = [labels(note) for note in notes]
            notes = [labels.role("caption", " ".join(notes))]
        style.add_legend(figure, handles, [line for line in heading if line])
        if looks.caption:
            style.add_caption(figure, notes, grow=size is None)
        if labels is not None:
            labels.apply(figure)
        return figure

    def _lines(
        self, down: int, across: int, size: tuple[float, float] | None
    ) -> tuple[int, int]:
        """Return the numbers of rows and columns of panels.

        Panels of one row go on in the next line where there is not enough room, or
        where they are wished: five spins make 2 x 3 panels.
        """
        if down > 1 or self.parts > 1 or across == 1:
            return down, across
        wide, high = self.panel
        if size is None:
            most = int((LARGEST - MARGINS[0]) / wide)
            if self.panels is not None and across > WISHED_ACROSS:
                most = WISHED_ACROSS
            columns = min(across, most)
            # The same number of lines, as even as possible.
            lines = math.ceil(across / columns)
            return lines, math.ceil(across / lines)
        width = max(size[0] - MARGINS[0] / 2, 1.0)
        height = max(size[1] - MARGINS[1] / 2, 1.0)

        def room(columns: int) -> float:
            lines = math.ceil(across / columns)
            return min(width / (columns * wide), height / (lines * high))

        columns = max(range(across, 0, -1), key=room)
        return math.ceil(across / columns), columns

    def draw_on(self, axes: Axes, **wanted: Any) -> None:
        """Draw the picture on axes of the caller's, if it has a single panel.

        Its size and its caption are left to the caller.
        """
        self._check_runs()
        looks = Looks(**wanted)
        if self.count > 1:
            raise ConfigError(
                f"ax: there are {self.count} panels; choose one with select, as in "
                "n_i=-0.3, or quantity for a map"
            )
        self.notes.clear()
        if self.axes:
            axes.set_xlabel(label(self.axes[0].name))
        place = (0,) * (len(self.rows) + len(self.columns))
        handles = self.draw([Panel(axes, place)], looks.log)
        axes.set_ylabel(self.ylabel)
        _limit([axes], looks)
        if looks.title is not None:
            axes.set_title(looks.title)
        if looks.labels is not None:
            looks.labels.rename(handles)
            looks.labels.apply(axes)
        if handles:
            axes.legend(handles=handles)

    def _check_runs(self) -> None:
        """Raise an OutputError if there is no run to be shown."""
        if not len(self):
            raise OutputError(
                f"{self.layout.stored.directory} holds no run {self.shows}"
            )

    def _head_panels(self, panels: list[Panel], columns: int, is_wrapped: bool) -> None:
        """Write the values of the columns above, those of the rows beside."""
        figure: Any = panels[0].axes.figure
        width, height = figure.get_size_inches()
        # A long text above a narrow panel is smaller.
        small = style.small_size()
        fontsize: str | float = "medium"
        if width < LEAST_TITLED * columns:
            fontsize = small
        rows = len(self.rows)
        for place, panel in enumerate(panels):
            if place < columns or is_wrapped:
                heading = texts(self.columns, panel.place[rows:])
                panel.axes.set_title(heading, fontsize=fontsize)
            if panel.is_lowest:
                panel.axes.tick_params(labelbottom=True)
            # Above an empty place, numbers are enough.
            is_last_line = place // columns == (len(panels) - 1) // columns
            if self.axes and is_last_line:
                panel.axes.set_xlabel(label(self.axes[0].name))
        if not self.rows:
            return
        # A long text beside a low panel is smaller.
        fontsize = "medium"
        if height < 1.6 * len(panels) / columns:
            fontsize = small
        for panel in panels[columns - 1 :: columns]:
            panel.axes.annotate(
                texts(self.rows, panel.place[:rows]),
                (1.02, 0.5),
                xycoords="axes fraction",
                rotation=270,
                va="center",
                ha="left",
                fontsize=fontsize,
            )

    def _selection(self, width: float) -> list[str]:
        """Return what was selected, as lines for a figure of some width in inches."""
        # A value selected alone appears nowhere else in the picture.
        pinned = [
            axis
            for axis in self.layout.axes.values()
            if len(axis.values) == 1 and -1 in axis.rank
        ]
        lines = [texts(pinned, [0] * len(pinned))]
        if self.layout.where is not None:
            # A dollar sign in a condition does not begin a formula.
            condition = self.layout.where.text.replace("$", "\\$")
            lines.append(textwrap.fill(condition, int(PER_INCH * width)))
        return lines


def within(values: NDArray[_T], place: tuple[int, ...]) -> NDArray[_T]:
    """Return the values of a panel, along the axes inside it."""
    index: Any = (..., *place)
    return values[index]


def _places(axes: list[Axis]) -> list[tuple[int, ...]]:
    """Return the places of all combinations of values; one if there are no axes."""
    return list(product(*(range(len(axis.values)) for axis in axes)))


def _limit(panels: Sequence[Axes], looks: Looks) -> None:
    """Set the limits that are given; raise a ConfigError if nothing is within them."""
    for which, limits in (("x", looks.xlim), ("y", looks.ylim)):
        if limits is None:
            continue
        low, high = limits
        if low >= high:
            raise ConfigError(
                f"{which}lim: {low:g},{high:g} is no range; give LOW,HIGH with LOW "
                "below HIGH"
            )
        is_log = any(getattr(axes, f"get_{which}scale")() == "log" for axes in panels)
        if low <= 0 and is_log:
            raise ConfigError(
                f"{which}lim: a logarithmic axis is positive; take a linear one"
            )
        drawn = [getattr(axes.dataLim, f"interval{which}") for axes in panels]
        known = [ends for ends in drawn if np.isfinite(ends).all()]
        if known and all(ends[0] > high or ends[1] < low for ends in known):
            first = min(ends[0] for ends in known)
            last = max(ends[1] for ends in known)
            raise ConfigError(
                f"{which}lim: nothing lies between {low:g} and {high:g}; the picture "
                f"reaches from {first:.6g} to {last:.6g}"
            )
        for axes in panels:
            getattr(axes, f"set_{which}lim")(low, high)
    for axes in panels:
        _drop_outside(axes)


def _drop_outside(axes: Axes) -> None:
    """Remove points beyond the panel from lines that are not clipped at its border."""
    left, right = sorted(axes.get_xlim())
    bottom, top = sorted(axes.get_ylim())
    for line in axes.lines:
        if line.get_clip_on():
            continue
        x, y = (np.asarray(values, float) for values in line.get_data())
        is_inside = (x >= left) & (x <= right) & (y >= bottom) & (y <= top)
        line.set_data(x[is_inside], y[is_inside])
        # The extent of a line without points is infinite.
        line.set_in_layout(bool(is_inside.any()))


def texts(axes: Sequence[Axis], places: Sequence[int]) -> str:
    """Return the values at some places of axes as text: ``n_i = -0.1, K_r = 0.02``."""
    values = zip(axes, places, strict=True)
    return ", ".join(value_text(axis.name, axis.values[k]) for axis, k in values)


def ordered(
    layout: SweepLayout,
    first: str | None,
    enough: int,
    prefer: str = "",
    last: str | None = None,
) -> list[str]:
    """Return the axes of several values, `first` before all others, then by length.

    All lengths from `enough` on are alike; then `prefer` comes first, a launch last.
    The axis `last` comes behind all.
    """
    lengths = layout.lengths
    names = sorted(
        lengths,
        key=lambda name: (
            name == last,
            -min(lengths[name], enough),
            name != prefer,
            name in LAUNCH_COLUMNS,
        ),
    )
    if first is None:
        first = names[0]
    return [first, *(name for name in names if name != first and lengths[name] > 1)]


def scale(axes: Axes, which: str, axis: Axis, log: bool | None) -> None:
    """Make an axis logarithmic if `log`, or with None if its values are spaced so."""
    style.scale_axis(axes, which, axis.values, axis.logarithmic(log), axis.name)
