"""From runs to what most pictures show: the runs counted by their place along some axes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.analysis.plots.picture import Picture
from rattlesweep.sweeps.counts import Cells, Moments, columns_for, floats, share, wilson

MOST_CELLS = 4_000_000


class Counted(Picture):
    """A picture of runs by cell: those that differ in other than its axes are counted together.

    `cells` are flat, and so are the `moments` of `more` columns, of the runs that have one; `grid`
    gives any of their arrays the shape of the axes.
    """

    def __init__(self, layout: Layout, x: str | None, more: Sequence[str] = ()) -> None:
        super().__init__(layout, x)
        self.columns = ("case", "sample", *columns_for(layout.config), *more)
        if (cells := math.prod(self.shape)) > MOST_CELLS:
            raise ConfigError(
                f"{cells} cells are too many for a picture; choose some with --select"
            )
        self.cells = Cells(cells)
        self.moments = {name: Moments(cells) for name in more}

    @property
    def shape(self) -> tuple[int, ...]:
        """Values along each axis."""
        return tuple(len(axis.values) for axis in self.axes)

    def add(self, rows: pa.RecordBatch) -> None:
        """Count more rows."""
        cell = self.layout.cells(rows, self.axes)
        self.cells.add(rows, cell)
        for name, moments in self.moments.items():
            values = floats(rows.column(name))
            kept = (cell >= 0) & np.isfinite(values)
            moments.add(cell[kept], values[kept])

    def __len__(self) -> int:
        return int(self.cells.runs.sum())

    def grid(self, flat: NDArray[Any]) -> NDArray[Any]:
        """An array over the cells in the shape of the axes."""
        return flat.reshape(self.shape)

    def bondi(self) -> Floats:
        """Share of bodies past Bondi's threshold among those in the steady direction."""
        return self.grid(share(self.cells.bondi, self.cells.steady))

    def table(self) -> pa.Table:
        """One row a cell that holds runs."""
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
            low, high = wilson(part, cells.ok)
            columns |= {
                f"fraction_{name}": share(part, cells.ok),
                f"fraction_{name}_low": low,
                f"fraction_{name}_high": high,
            }
        columns["fraction_bondi"] = share(cells.bondi, cells.steady)
        for name, moments in (("t_r", cells.t_r), ("ratio", cells.ratio)):
            columns |= {
                f"{name}_mean": moments.means(),
                f"{name}_std": moments.deviations(),
                f"{name}_sem": moments.errors(),
            }
        columns["t_rgh_mean"] = cells.t_rgh.means()
        if cells.has_errors:
            columns["t_r_mean_error"] = cells.t_r_error.means()
            columns |= {"sensitive": cells.sensitive, "unsure": cells.unsure}
        kept = cells.runs > 0
        return pa.table(
            {name: pa.array(values[kept], from_pandas=True) for name, values in columns.items()}
        )
