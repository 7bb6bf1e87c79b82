"""From runs to what a picture shows: counts, means and deviations by cell, read in one pass."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.physics.theory import unsteady
from rattlesweep.study.plots.layout import Axis, Layout
from rattlesweep.sweeps.tables.cells import Moments, codes, share, wilson
from rattlesweep.sweeps.tables.types import TYPES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

COLUMNS = ("case", "sample", "n_i", "K_p", "omega_p", "n_c1", "t_rgh", "t_r", "type", "status")
MOST_CELLS = 4_000_000
# Edges of t_r/t_rGH for its distribution: 40 a decade.
EDGES = 10.0 ** (np.arange(-80, 81) / 40)


@dataclass
class Tally:
    """Runs by cell; arrays have the shape of `axes`.

    Attributes
    ----------
    axes : tuple of Axis
        What tells the cells apart; what is selected, in ascending order.
    runs, ok : array
        Runs stored, and those with status ``ok``.
    types : dict
        Of these, runs of each type.
    steady, bondi : array
        Runs in the steady direction that have a theory, and of these the ones past Bondi's
        threshold, ``abs(n_c1) < abs(n_i)``.
    t_r, ratio : Moments
        Of ``t_r`` and ``t_r/t_rGH`` of type R.
    t_rgh : Moments
        Of the runs that have one and are ``ok``.
    histogram : array
        Runs of type R by ``t_r/t_rGH`` between `EDGES`, all cells together.
    """

    axes: tuple[Axis, ...]
    runs: Floats
    ok: Floats
    types: dict[str, Floats]
    steady: Floats
    bondi: Floats
    t_r: Moments
    ratio: Moments
    t_rgh: Moments
    histogram: Floats

    @property
    def shape(self) -> tuple[int, ...]:
        """Values along each axis."""
        return tuple(len(axis.values) for axis in self.axes)

    def grid(self, flat: Floats) -> Floats:
        """A column by cell in the shape of the axes."""
        return flat.reshape(self.shape)

    def table(self) -> pa.Table:
        """One row a cell that holds runs: what the pictures draw."""
        columns: dict[str, Floats] = {}
        meshes = np.meshgrid(*(axis.values for axis in self.axes), indexing="ij")
        for axis, mesh in zip(self.axes, meshes, strict=True):
            columns[axis.name] = mesh.ravel()
        columns |= {"runs": self.runs, "failed": self.runs - self.ok}
        for name in TYPES:
            columns[f"fraction_{name}"] = share(self.types[name], self.ok)
            low, high = wilson(self.types[name], self.ok)
            columns |= {f"fraction_{name}_low": low, f"fraction_{name}_high": high}
        columns["fraction_bondi"] = share(self.bondi, self.steady)
        for name, moments in (("t_r", self.t_r), ("ratio", self.ratio)):
            columns |= {
                f"{name}_mean": moments.means(),
                f"{name}_std": moments.deviations(),
                f"{name}_sem": moments.errors(),
            }
        columns["t_rgh_mean"] = self.t_rgh.means()
        kept = self.runs > 0
        return pa.table(
            {
                name: pa.array(
                    values[kept].astype(np.int64 if name in ("runs", "failed") else float),
                    from_pandas=True,
                )
                for name, values in columns.items()
            }
        )


def empty(axes: tuple[Axis, ...] = ()) -> Tally:
    """A tally of no runs."""
    cells = math.prod(len(axis.values) for axis in axes)
    runs, ok, steady, bondi = (np.zeros(cells) for _ in range(4))
    return Tally(
        axes, runs, ok, {name: np.zeros(cells) for name in TYPES}, steady, bondi,
        Moments(cells), Moments(cells), Moments(cells), np.zeros(len(EDGES) - 1),
    )  # fmt: skip


def tally(
    layout: Layout, names: Sequence[str], chosen: Mapping[str, Integers] | None = None
) -> Tally:
    """Count the stored runs by their place along some axes.

    Parameters
    ----------
    layout
    names
        Axes that tell the cells apart; runs that differ in others only are counted together.
    chosen
        Places along any axes that are taken; others are left out.

    Raises
    ------
    ConfigError
        There would be more cells than a picture can show.
    OutputError
        A block is unreadable, or no run is left.
    """
    chosen = chosen or {}
    place: dict[str, Integers] = {}
    for name, axis in layout.axes.items():
        place[name] = np.full(len(axis.values), -1, np.int64)
        kept = chosen.get(name, np.arange(len(axis.values)))
        place[name][kept] = np.arange(len(kept))
    axes = tuple(
        Axis.of(name, layout.axes[name].values[place[name] >= 0].tolist()) for name in names
    )
    shape = tuple(len(axis.values) for axis in axes)
    cells = math.prod(shape)
    if cells > MOST_CELLS:
        raise ConfigError(f"{cells} cells are too many for a picture; choose some with --select")
    made = empty(axes)
    for batch in layout.store.iter_batches(COLUMNS, complete=True):
        _count(made, batch, layout, names, place)
    if not made.runs.any():
        raise OutputError(f"{layout.store.directory} holds no run of those selected")
    return made


def _count(
    made: Tally,
    batch: pa.RecordBatch,
    layout: Layout,
    names: Sequence[str],
    place: Mapping[str, Integers],
) -> None:
    case, sample = (batch.column(n).to_numpy().astype(np.int64) for n in ("case", "sample"))
    ranks = layout.ranks(case, sample)
    at = {name: place[name][rank] for name, rank in ranks.items()}
    kept = np.ones(len(case), bool)
    for where in at.values():
        kept &= where >= 0
    if not kept.any():
        return
    cell = np.zeros(int(kept.sum()), np.int64)
    if names:
        cell = np.ravel_multi_index(tuple(at[name][kept] for name in names), made.shape)
    n_i, K_p, omega_p, n_c1, t_rgh, t_r = (
        batch.column(name).to_numpy(zero_copy_only=False).astype(float)[kept]
        for name in ("n_i", "K_p", "omega_p", "n_c1", "t_rgh", "t_r")
    )
    kind = codes(batch.column("type"), TYPES)[kept]
    ok = codes(batch.column("status"), ("ok",))[kept] == 0
    cells = len(made.runs)

    def add(total: Floats, which: NDArray[np.bool_]) -> None:
        total += np.bincount(cell[which], minlength=cells)

    add(made.runs, np.ones(len(cell), bool))
    add(made.ok, ok)
    for code, name in enumerate(TYPES):
        add(made.types[name], ok & (kind == code))
    steady = np.isfinite(omega_p) & ~unsteady(K_p, n_i)
    add(made.steady, steady)
    # A null threshold is NaN here, which is below nothing.
    add(made.bondi, steady & (np.abs(n_c1) < np.abs(n_i)))
    reversed_ = ok & (kind == TYPES.index("R")) & np.isfinite(t_r)
    made.t_r.add(cell[reversed_], t_r[reversed_])
    timed = reversed_ & (t_rgh > 0)
    ratio = t_r[timed] / t_rgh[timed]
    made.ratio.add(cell[timed], ratio)
    # What lies outside is counted at the edge.
    inside = np.clip(np.searchsorted(EDGES, ratio, "right") - 1, 0, len(EDGES) - 2)
    made.histogram += np.bincount(inside, minlength=len(EDGES) - 1)
    known = ok & np.isfinite(t_rgh)
    made.t_rgh.add(cell[known], t_rgh[known])
