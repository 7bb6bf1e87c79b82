"""What every kind of picture has; `registry` lists the kinds."""

from __future__ import annotations

import io
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as parquet
from matplotlib.figure import Figure

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.analysis.plots.layout import Axis, Layout
from rattlesweep.analysis.plots.panels import BESIDE, head, plain_ticks
from rattlesweep.analysis.style import new_figure, value_text
from rattlesweep.sweeps.files import replace_file


class Picture(ABC):
    """A picture of a sweep: takes the rows as they go by, and then draws.

    A kind of picture is a subclass in a file of its own, and a word in `registry.KINDS`.
    """

    name: ClassVar[str]  # of the kind
    caption: ClassVar[str] = ""  # below it in a report
    columns: Sequence[str]  # of `runs` that it reads

    def __init__(self, layout: Layout, x: str | None) -> None:
        self.layout = layout
        # The abscissa first, then as the kind draws them.
        self.axes: tuple[Axis, ...] = tuple(layout.axes[name] for name in self.order(layout, x))

    @staticmethod
    def fits(layout: Layout) -> bool:
        """Whether the kind suits what varies."""
        return True

    @staticmethod
    def order(layout: Layout, x: str | None) -> Sequence[str]:
        """Names of `axes`, for the abscissa that is asked for."""
        return ()

    @abstractmethod
    def add(self, rows: pa.RecordBatch) -> None:
        """Take more rows."""

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of runs that are shown."""

    @abstractmethod
    def table(self) -> pa.Table:
        """The numbers that are drawn."""

    @abstractmethod
    def size(self) -> tuple[float, float]:
        """Width and height in inches that suit what is shown."""

    def side_by_side(self) -> bool:
        """Whether values stand side by side along the abscissa, which then has no limits."""
        return False

    @abstractmethod
    def draw(self, figure: Any, log: bool | None) -> None:
        """Draw it; `log` is whether axes are logarithmic, None: as suits the values."""

    def words(self) -> str:
        """How much is shown."""
        return f"{len(self):,} runs"

    def figure(
        self,
        *,
        title: str | None = None,
        log: bool | None = None,
        size: tuple[float, float] | None = None,
        xlim: tuple[float, float] | None = None,
        ylim: tuple[float, float] | None = None,
    ) -> Figure:
        """Draw it; None: as suits the values.  There must be runs, and axes that can be so."""
        if not len(self):
            raise OutputError(f"{self.layout.store.directory} holds no run of those selected")
        figure = new_figure(*(size or self.size()))
        self.draw(figure, log)
        for which, limits in (("x", xlim), ("y", ylim)):
            if limits is not None:
                self._limit(figure, which, limits)
        # What a selection has pinned is nowhere else in the picture.
        axes = self.layout.axes.values()
        pinned = ", ".join(value_text(a.name, float(a.values[0])) for a in axes if a.pinned)
        where = self.layout.where
        # As it was written, with no formula in it.
        condition = where.text.replace("$", "\\$") if where else ""
        head(figure, [line for line in (title, pinned, condition) if line])
        return figure

    def _limit(self, figure: Figure, which: str, limits: tuple[float, float]) -> None:
        """Let every panel end there."""
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

    def write_data(self, path: Path) -> None:
        """Write the numbers that are drawn as CSV or Parquet, in one step."""
        buffer = io.BytesIO()
        if path.suffix.lower() == ".csv":
            csv.write_csv(self.table(), buffer)
        else:
            parquet.write_table(self.table(), buffer)
        replace_file(path, buffer.getvalue())


def abscissa(layout: Layout, candidates: Sequence[str], x: str | None) -> str:
    """The axis that is asked for, else the first with more than two values, else the longest."""
    return (
        x
        or next((name for name in candidates if layout.lengths[name] > 2), None)
        or max(candidates, key=layout.lengths.__getitem__)
    )
