"""Runs counted by cell: types, Bondi's share, means and deviations of reversal times.

A cell is whatever the caller tells apart: a case, a pixel of a map, a point of a curve. Sums grow
in the order of the rows, so they do not depend on how rows lie in files; memory goes with the cells
and not with the runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import ArrayLike

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.physics.theory import unsteady
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.types import TYPES

COLUMNS = ("n_i", "K_p", "omega_p", "n_c1", "t_rgh", "t_r", "type", "status", "near_tangencies")
FRICTION = {"share_friction_above_0_3": 0.3, "share_friction_above_0_6": 0.6}
"""Coefficients of friction by the columns of the shares of runs that need a larger one."""
SENSITIVE = 1e-6
"""A run is sensitive if its ``t_r_error`` is a larger share of ``t_r``."""
Z95 = 1.959963984540054
"""Quantile of the normal distribution for two-sided 95 %."""


def columns_for(config: Config) -> tuple[str, ...]:
    """Return the columns of a sweep's runs that `Counts.add` reads."""
    losses = ("energy_left", "sigma", "rolling") if config.dissipation else ()
    errors = ("t_r_error", "type_sure") if "error" in config.record else ()
    contact = ("contact_ratio_max", "contact_normal_min") if "contact" in config.record else ()
    return (*COLUMNS, *errors, *losses, *contact)


class Moments:
    """Count, mean and deviation of values by cell.

    Sums are of differences from the first value of each cell, so that a mean far larger than the
    deviation costs no digits.
    """

    def __init__(self, cells: int) -> None:
        self.count = np.zeros(cells, np.int64)
        self._first, self._sum, self._squares = (np.zeros(cells) for _ in range(3))

    def add(self, cell: Integers, values: Floats, weight: Integers | int = 1) -> None:
        """Add values, each to its cell, as if each stood there so many times."""
        new = np.flatnonzero(self.count[cell] == 0)
        cells, place = np.unique(cell[new], return_index=True)
        self._first[cells] = values[new[place]]
        step = values - self._first[cell]
        # One by one and in order: np.bincount would sum each piece apart.
        np.add.at(self.count, cell, weight)
        np.add.at(self._sum, cell, weight * step)
        with np.errstate(over="ignore"):  # the deviation is then infinite, and stored as null
            np.add.at(self._squares, cell, weight * step**2)

    def means(self) -> Floats:
        """Return the means, NaN of nothing."""
        return self._first + share(self._sum, self.count)

    def deviations(self) -> Floats:
        """Return the sample standard deviations (divisor n - 1), NaN for fewer than two."""
        with np.errstate(over="ignore", invalid="ignore"):
            squares = self._squares - share(self._sum**2, np.maximum(self.count, 1))
            return np.sqrt(share(np.maximum(squares, 0), self.count - 1))

    def errors(self) -> Floats:
        """Return the standard errors of the means, NaN for fewer than two."""
        return share(self.deviations(), np.sqrt(self.count))


class Counts:
    """Runs by cell; each array has the shape (cells,)."""

    def __init__(self, cells: int) -> None:
        # All runs, those with status ok, and the others.
        self.runs, self.ok, self.failed = _zeros(cells, 3)
        # Of the runs that are ok, those of each type, and of these the ones whose type is not sure;
        # of D only with dissipation.
        self.types = dict(zip(TYPES[:4], _zeros(cells, 4), strict=True))
        self.unsure_types = dict(zip(TYPES[:4], _zeros(cells, 4), strict=True))
        # Runs in the steady direction that have a theory and no dissipation, and of these the ones
        # past Bondi's threshold, abs(n_c1) < abs(n_i).
        self.steady, self.bondi = _zeros(cells, 2)
        # Sum over the runs; runs of type R whose error is large.
        self.near_tangencies, self.sensitive = _zeros(cells, 2)
        # Of type R, ratios taken run by run; t_rgh of all.
        self.t_r, self.t_r_error, self.ratio, self.t_rgh = (Moments(cells) for _ in range(4))
        # Of the runs that are ok, those that need more friction or lift off.
        self.contact = dict(zip((*FRICTION, "share_lift_off"), _zeros(cells, 3), strict=True))
        self.has_errors = self.has_contact = False  # whether rows tell

    def add(self, rows: pa.RecordBatch | pa.Table, cell: Integers, weight: Any = None) -> None:
        """Count more runs, each in its cell and, if told, as so many; none in a negative cell."""
        kept, names = cell >= 0, rows.schema.names
        cell = cell[kept]
        weight = np.ones(len(cell), np.int64) if weight is None else weight[kept]

        def column(name: str) -> Floats:
            return floats(rows.column(name))[kept]

        def count(into: Integers, which: Flags) -> None:
            np.add.at(into, cell[which], weight[which])

        def average(into: Moments, values: Floats, which: Flags) -> None:
            into.add(cell[which], values[which], weight[which])

        n_i, t_r, t_rgh = column("n_i"), column("t_r"), column("t_rgh")
        kind = codes(rows.column("type"), TYPES)[kept]
        ok = codes(rows.column("status"), ("ok",))[kept] == 0
        steady = np.isfinite(column("omega_p")) & ~unsteady(column("K_p"), n_i)
        if "energy_left" in names:
            for types in (self.types, self.unsure_types):
                types.setdefault("D", np.zeros(len(self.runs), np.int64))
            steady &= (column("sigma") == 0) & (column("rolling") == 0)
        count(self.runs, np.ones(len(cell), bool))
        count(self.ok, ok)
        count(self.failed, ~ok)
        for name, into in self.types.items():
            count(into, ok & (kind == TYPES.index(name)))
        near = np.nan_to_num(column("near_tangencies")).astype(np.int64)
        np.add.at(self.near_tangencies, cell, weight * near)
        count(self.steady, steady)
        count(self.bondi, steady & (np.abs(column("n_c1")) < np.abs(n_i)))
        reverses = ok & (kind == TYPES.index("R")) & np.isfinite(t_r)
        average(self.t_r, t_r, reverses)
        average(self.t_rgh, t_rgh, np.isfinite(t_rgh))
        compared = reverses & (t_rgh > 0)
        average(self.ratio, np.divide(t_r, t_rgh, np.zeros(len(t_r)), where=compared), compared)
        if "t_r_error" in names:
            self.has_errors, error = True, column("t_r_error")
            average(self.t_r_error, error, reverses & np.isfinite(error))
            count(self.sensitive, reverses & is_sensitive(error, t_r))
            unsure = column("type_sure") == 0
            for name, into in self.unsure_types.items():
                count(into, unsure & (kind == TYPES.index(name)))
        if "contact_ratio_max" in names:
            self.has_contact, ratio = True, column("contact_ratio_max")
            for name, most in FRICTION.items():
                count(self.contact[name], ok & (ratio > most))
            count(self.contact["share_lift_off"], ok & (column("contact_normal_min") < 0))

    @property
    def unsure(self) -> Integers:
        """Runs whose type is not sure."""
        total: Integers = np.sum([*self.unsure_types.values()], axis=0)
        return total


def _zeros(cells: int, count: int) -> list[Integers]:
    return [np.zeros(cells, np.int64) for _ in range(count)]


def floats(column: pa.Array) -> Floats:
    """Return a column of numbers; null is NaN."""
    values: Floats = column.to_numpy(zero_copy_only=False).astype(float)
    return values


def codes(column: pa.Array, words: Sequence[str]) -> Integers:
    """Return the place of each entry in `words`, -1 for others and null."""
    found = pc.fill_null(pc.index_in(column, pa.array(words)), -1)
    values: Integers = found.to_numpy(zero_copy_only=False).astype(np.int64)
    return values


def share(part: ArrayLike, whole: ArrayLike) -> Floats:
    """Return ``part / whole``, NaN where there is nothing."""
    part, whole = np.asarray(part, float), np.asarray(whole, float)
    result: Floats = np.divide(part, whole, out=np.full(part.shape, np.nan), where=whole > 0)
    return result


def is_sensitive(t_r_error: Any, t_r: Any) -> Any:
    """Return whether a run is sensitive, of numbers or arrays; NaN is not."""
    return t_r_error > SENSITIVE * t_r


def wilson(part: ArrayLike, whole: ArrayLike, z: float = Z95) -> tuple[Floats, Floats]:
    """Return the interval of a share, by default of 95 %; NaN where there is nothing.

    Source: E. B. Wilson, J. Am. Stat. Assoc. 22, 209 (1927).
    """
    part, whole = np.asarray(part, float), np.asarray(whole, float)
    p, weight = share(part, whole), share(np.full(part.shape, z * z), whole)
    centre = (p + weight / 2) / (1 + weight)
    half = np.sqrt(weight * (p * (1 - p) + weight / 4)) / (1 + weight)
    # At 0 and 1 the ends are exact; rounding must not carry them out of the unit interval.
    return np.where(p == 0, 0.0, centre - half), np.where(p == 1, 1.0, centre + half)
