"""What every kind of picture has: its axes, the runs counted by cell, the table that is drawn."""

from __future__ import annotations

import io
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as parquet
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rattlesweep.analysis.plots.layout import Axis, Layout
from rattlesweep.analysis.plots.panels import BESIDE, add_heading, plain_ticks
from rattlesweep.analysis.style import new_figure, value_text
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.messages import not_one_of
from rattlesweep.sweeps.counts import Counts, Moments, columns_for, floats, share, wilson
from rattlesweep.sweeps.files import replace_file

MOST_CELLS = 4_000_000


class CellCounts(NamedTuple):
    """Runs counted by cell, and means of some more columns; arrays over the cells are flat."""

    counts: Counts
    means: dict[str, Moments]


class Picture(ABC):
    """A picture of a sweep.

    A kind is a subclass in a file of its own and a word in `kinds.KINDS`. `axes` are those that it
    tells apart, the abscissa first: runs that differ in others are counted together. `more` are
    columns of which each cell has a mean.
    """

    name: ClassVar[str]
    caption: ClassVar[str] = ""  # below it in a report
    takes_quantity: ClassVar[bool] = False

    def __init__(self, layout: Layout, x: str | None = None, quantity: str | None = None) -> None:
        if quantity is not None and not self.takes_quantity:
            raise ConfigError(f"--quantity: goes with --kind map or distribution, not {self.name}")
        self.layout, self.quantity = layout, quantity
        self.unit = "" if quantity is None else unit_of(layout, quantity, "--quantity")
        self.axes: tuple[Axis, ...] = tuple(layout.axes[name] for name in self.order(layout, x))
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

    @property
    def more(self) -> tuple[str, ...]:
        """Columns of which each cell has a mean."""
        return ()

    @abstractmethod
    def size(self) -> tuple[float, float]:
        """Return the width and height in inches that suit what is shown."""

    @abstractmethod
    def draw(self, figure: Any, log: bool | None) -> None:
        """Draw it; `log` is whether axes are logarithmic, None: as suits the values."""

    def side_by_side(self) -> bool:
        """Tell whether values stand side by side along the abscissa, which then has no limits."""
        return False

    # -- numbers -------------------------------------------------------------------------------

    @property
    def shape(self) -> tuple[int, ...]:
        """Values along each axis."""
        return tuple(len(axis.values) for axis in self.axes)

    @cached_property
    def counted(self) -> CellCounts:
        """The runs by cell, counted in one pass over the files."""
        cells = math.prod(self.shape)
        found = CellCounts(Counts(cells), {name: Moments(cells) for name in self.more})
        columns = ("case", "sample", *columns_for(self.layout.config), *self.more)
        for rows in self.layout.rows(columns):
            cell = self.layout.cells(rows, self.axes)
            found.counts.add(rows, cell)
            for name, moments in found.means.items():
                values = floats(rows.column(name))
                kept = (cell >= 0) & np.isfinite(values)
                moments.add(cell[kept], values[kept])
        return found

    @property
    def cells(self) -> Counts:
        """The runs by cell."""
        return self.counted.counts

    def __len__(self) -> int:
        """Return the number of runs that are shown."""
        return int(self.cells.runs.sum())

    def grid(self, flat: NDArray[Any]) -> NDArray[Any]:
        """Give an array over the cells the shape of the axes."""
        return flat.reshape(self.shape)

    def mean(self, column: str) -> Floats:
        """Return the mean of one of the columns `more`, in the shape of the axes."""
        return self.grid(self.counted.means[column].means())

    def bondi(self) -> Floats:
        """Return the share of bodies past Bondi's threshold among those in the steady direction."""
        return self.grid(share(self.cells.bondi, self.cells.steady))

    def table(self) -> pa.Table:
        """Return the numbers that are drawn: one row for each cell that holds runs."""
        cells = self.cells
        names = [axis.name for axis in self.axes]
        columns: dict[str, Any] = {
            axis.name: np.full(len(cells.runs), axis.values[0])
            for axis in reversed(self.layout.axes.values())
            if len(axis.values) == 1 and axis.name not in names
        }
        meshes = np.meshgrid(*(axis.values for axis in self.axes), indexing="ij")
        columns |= {name: mesh.ravel() for name, mesh in zip(names, meshes, strict=True)}
        columns |= {"runs": cells.runs, "failed": cells.failed}
        for name, part in cells.types.items():
            columns[f"fraction_{name}"] = share(part, cells.ok)
            low, high = wilson(part, cells.ok)
            columns |= {f"fraction_{name}_low": low, f"fraction_{name}_high": high}
        columns["fraction_bondi"] = share(cells.bondi, cells.steady)
        for name, moments in (("t_r", cells.t_r), ("ratio", cells.ratio)):
            columns |= {f"{name}_mean": moments.means(), f"{name}_std": moments.deviations(),
                        f"{name}_sem": moments.errors()}  # fmt: skip
        columns["t_rgh_mean"] = cells.t_rgh.means()
        columns |= {f"{name}_mean": m.means() for name, m in self.counted.means.items()}
        if cells.has_errors:
            columns["t_r_mean_error"] = cells.t_r_error.means()
            columns |= {"sensitive": cells.sensitive, "unsure": cells.unsure}
        kept = cells.runs > 0
        return pa.table(
            {name: pa.array(values[kept], from_pandas=True) for name, values in columns.items()}
        )

    def write_data(self, path: Path) -> None:
        """Write the numbers that are drawn as CSV or Parquet, in one step."""
        buffer = io.BytesIO()
        if path.suffix.lower() == ".csv":
            csv.write_csv(self.table(), buffer)
        else:
            parquet.write_table(self.table(), buffer)
        replace_file(path, buffer.getvalue())

    def words(self) -> str:
        """Return how much is shown."""
        return f"{len(self):,} runs"

    # -- the figure ----------------------------------------------------------------------------

    def figure(
        self,
        *,
        title: str | None = None,
        log: bool | None = None,
        size: tuple[float, float] | None = None,
        xlim: tuple[float, float] | None = None,
        ylim: tuple[float, float] | None = None,
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
        self.draw(figure, log)
        for which, limits in (("x", xlim), ("y", ylim)):
            if limits is not None:
                self._limit(figure, which, limits)
        # A selection of one value is nowhere else in the picture.
        axes = self.layout.axes.values()
        pinned = ", ".join(value_text(a.name, float(a.values[0])) for a in axes if a.pinned)
        where = self.layout.where
        # As it was written: a dollar in it begins no formula.
        condition = where.text.replace("$", "\\$") if where else ""
        add_heading(figure, [line for line in (title, pinned, condition) if line])
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
