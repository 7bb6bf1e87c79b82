"""From runs to what a picture shows: the runs counted by their place along some axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.errors import ConfigError
from rattlesweep.study.plots.layout import Layout, Places
from rattlesweep.sweeps.tables.cells import COLUMNS, Cells, Moments, share, wilson

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

MOST_CELLS = 4_000_000


class Counts:
    """Runs by cell.

    Parameters
    ----------
    layout
    names
        Axes that tell the cells apart; runs that differ in others only are counted together.
    chosen
        Places along any axes that are taken; others are left out.

    Attributes
    ----------
    axes : tuple of Axis
        What tells the cells apart; what is chosen, in ascending order.
    cells : Cells
        Flat; `grid` gives any of its arrays the shape of the axes.

    Raises
    ------
    ConfigError
        There would be more cells than a picture can show.
    """

    columns: Sequence[str] = ("case", "sample", *COLUMNS)

    def __init__(
        self, layout: Layout, names: Sequence[str], chosen: Mapping[str, Integers] | None = None
    ) -> None:
        self.layout = layout
        self._places = Places(layout, names, chosen or {})
        self.axes = self._places.axes
        if (cells := math.prod(self.shape)) > MOST_CELLS:
            raise ConfigError(
                f"{cells} cells are too many for a picture; choose some with --select"
            )
        self.cells = Cells(cells)

    @property
    def shape(self) -> tuple[int, ...]:
        """Values along each axis."""
        return tuple(len(axis.values) for axis in self.axes)

    def add(self, rows: pa.RecordBatch) -> None:
        """Count more rows."""
        self.cells.add(rows, self._places.cells(rows))

    def __len__(self) -> int:
        """Return the number of runs counted."""
        return int(self.cells.runs.sum())

    def words(self) -> str:
        """How many they are."""
        return f"{len(self):,} runs"

    def grid(self, flat: NDArray[Any]) -> NDArray[Any]:
        """An array over the cells in the shape of the axes."""
        return flat.reshape(self.shape)

    def bondi(self) -> Floats:
        """Share of bodies past Bondi's threshold among those in the steady direction."""
        return self.grid(share(self.cells.bondi, self.cells.steady))

    def table(self) -> pa.Table:
        """One row a cell that holds runs: what the pictures draw."""
        cells = self.cells
        meshes = np.meshgrid(*(axis.values for axis in self.axes), indexing="ij")
        columns: dict[str, Any] = {
            axis.name: mesh.ravel() for axis, mesh in zip(self.axes, meshes, strict=True)
        }
        columns |= {"runs": cells.runs, "failed": cells.failed}
        for name, part in cells.types.items():
            low, high = wilson(part, cells.ok)
            columns |= {
                f"fraction_{name}": share(part, cells.ok),
                f"fraction_{name}_low": low,
                f"fraction_{name}_high": high,
            }
        columns["fraction_bondi"] = share(cells.bondi, cells.steady)
        moments: Moments
        for name, moments in (("t_r", cells.t_r), ("ratio", cells.ratio)):
            columns |= {
                f"{name}_mean": moments.means(),
                f"{name}_std": moments.deviations(),
                f"{name}_sem": moments.errors(),
            }
        columns["t_rgh_mean"] = cells.t_rgh.means()
        kept = cells.runs > 0
        return pa.table(
            {name: pa.array(values[kept], from_pandas=True) for name, values in columns.items()}
        )
