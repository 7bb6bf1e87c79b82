"""What pictures share: runs counted by cell, panels, axes, heading, legend, caption."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rattlesweep.analysis import style
from rattlesweep.analysis.plots.layout import LAUNCH, Axis, Layout
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.summary import Counts
from rattlesweep.sweeps.types import share, wilson

MOST_PANELS = 40
# Values that spread over more than this ratio are shown by their logarithms.
WIDE = 30.0


class Picture(ABC):
    """A picture of a sweep.

    `axes` are those that it tells apart, the abscissa first; others have a single value. `more` are
    columns of which each cell has a mean. Drawing fills `notes`, the sentences of the caption.
    """

    name: ClassVar[str]
    more: tuple[str, ...] = ()

    def __init__(self, layout: Layout, axes: list[str], width: float, height: float) -> None:
        self.layout, self.size = layout, (width, height)
        self.axes = [layout.axes[name] for name in axes]
        self.notes: list[str] = []

    @abstractmethod
    def draw(self, figure: Any, log: bool | None) -> list[Any]:
        """Draw it and return the entries of its legend; `log` None: as suits the values."""

    @property
    def cells(self) -> Counts:
        """The runs by cell; :meth:`grid` puts its arrays along `axes`."""
        return self.layout.count(self.more)[0]

    def __len__(self) -> int:
        """Return the number of runs that are shown."""
        return int(self.cells.runs.sum())

    def grid(self, flat: NDArray[Any]) -> NDArray[Any]:
        """Give an array over the cells the shape of `axes`."""
        names, lengths = list(self.layout.axes), list(self.layout.lengths.values())
        order = [names.index(axis.name) for axis in self.axes]
        others = [k for k in range(len(names)) if k not in order]
        whole = flat.reshape(lengths).transpose(order + others)
        return whole.reshape([lengths[k] for k in order])

    def table(self) -> pa.Table:
        """Return the numbers that are drawn: one row for each cell that holds runs."""
        cells, more = self.layout.count(self.more)
        kept = np.flatnonzero(cells.runs)
        places = np.unravel_index(kept, [*self.layout.lengths.values()] or [1])
        axes = self.layout.axes.items()
        columns = {name: axis.values[k] for (name, axis), k in zip(axes, places, strict=False)}
        found: dict[str, Any] = {"runs": cells.runs, "failed": cells.failed}
        for name, part in cells.types.items():
            low, high = wilson(part, cells.ok)
            found |= {f"fraction_{name}": share(part, cells.ok), f"fraction_{name}_low": low,
                      f"fraction_{name}_high": high}  # fmt: skip
        for name, moments in (("t_r", cells.t_r), ("ratio", cells.ratio)):
            found |= {f"{name}_mean": moments.means(), f"{name}_std": moments.deviations(),
                      f"{name}_sem": moments.errors()}  # fmt: skip
        found |= {"fraction_bondi": share(cells.bondi, cells.steady),
                  "t_rgh_mean": cells.t_rgh.means()}  # fmt: skip
        found |= {f"{name}_mean": mean for name, mean in more.items()}
        if cells.has_errors:
            found |= {"t_r_mean_error": cells.t_r_error.means(), "sensitive": cells.sensitive,
                      "unsure": cells.unsure}  # fmt: skip
        columns |= {name: values[kept] for name, values in found.items()}
        return pa.table({n: pa.array(v, from_pandas=True) for n, v in columns.items()})

    def write_data(self, path: Path) -> None:
        """Write the numbers that are drawn as CSV or Parquet, in one step."""
        style.save_table(self.table(), path)

    def words(self) -> str:
        """Return how much is shown."""
        return f"{len(self):,} runs"

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
        """Draw it; None: as suits the values."""
        if not len(self):
            raise OutputError(f"{self.layout.stored.directory} holds no run of those selected")
        figure = style.new_figure(*(size or self.size))
        self.notes = []
        handles = self.draw(figure, log)
        panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
        for axes, (which, limits) in product(panels, (("x", xlim), ("y", ylim))):
            if limits is not None and getattr(axes, f"get_{which}scale")() == "log":
                if limits[0] <= 0:
                    raise ConfigError(f"--{which}lim: a logarithmic axis is positive; add --linear")
                style.plain_ticks(axes, which, limits)
            getattr(axes, f"set_{which}lim")(limits)
        # A selection of one value is nowhere else in the picture.
        where = self.layout.where
        single = (axis for axis in self.layout.axes.values() if len(axis.values) == 1)
        pinned = [style.value_text(axis.name, axis.values[0]) for axis in single if -1 in axis.rank]
        # A dollar in a condition begins no formula.
        condition = where.text.replace("$", "\\$") if where else ""
        style.add_legend(figure, handles, [t for t in (title, ", ".join(pinned), condition) if t])
        if captioned:
            style.add_caption(figure, " ".join(self.notes), grow=size is None)
        return figure


def ordered(layout: Layout, enough: int, prefer: str = "") -> list[str]:
    """Return all axes, the longest first, of which `enough` values count as many.

    Of equal length come one that is preferred, then targets and bodies, then the launch.
    """
    lengths = layout.lengths
    return sorted(lengths, key=lambda n: (-min(lengths[n], enough), n != prefer, n in LAUNCH))


def draw_panels(
    figure: Any, rows: Sequence[Axis], columns: Sequence[Axis], xlabel: str, *, parts: int = 1
) -> list[tuple[Any, tuple[int, ...]]]:
    """Make a row of panels for each combination of some axes' values, and columns likewise.

    Each combination has `parts` panels, side by side. Returns the Axes of each panel with the
    places of its values; raises a ConfigError if there would be too many.
    """
    down, across = (
        list(product(*(range(len(axis.values)) for axis in axes))) for axes in (rows, columns)
    )
    if len(down) * len(across) > MOST_PANELS:
        names = " and ".join(axis.name for axis in (*rows, *columns))
        raise ConfigError(
            f"there would be {len(down) * len(across)} panels, one for each {names}; choose some "
            "with --select, as in --select n_i=-0.3,-0.5"
        )

    def text(axes: Sequence[Axis], places: tuple[int, ...]) -> str:
        shown = zip(axes, places, strict=True)
        return ", ".join(style.value_text(axis.name, axis.values[k]) for axis, k in shown)

    wide = [column for column in across for _ in range(parts)]
    grid = figure.subplots(len(down), len(wide), sharex=True, sharey=True, squeeze=False)
    for axes, column in zip(grid[0], wide, strict=True):
        axes.set_title(text(columns, column), fontsize="medium")
    for axes in grid[-1]:
        axes.set_xlabel(xlabel)
    for axes, row in zip(grid[:, -1], down, strict=True):
        axes.annotate(text(rows, row), (1.02, 0.5), xycoords="axes fraction", rotation=270,
                      va="center", ha="left")  # fmt: skip
    return list(zip(grid.flat, [r + c for r, c in product(down, wide)], strict=True))
