"""Runs counted by cell: types, Bondi's share, means and deviations of reversal times.

A cell is whatever the caller tells apart: a case, a pixel of a map, a point of a curve. Sums grow
run by run in the order of the rows, so that how a sweep is cut into blocks does not show in any
bit; memory goes with the cells and not with the runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import ArrayLike

from rattlesweep.arrays import Floats, Integers
from rattlesweep.physics.theory import unsteady
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.types import TYPES

COLUMNS = ("n_i", "K_p", "omega_p", "n_c1", "t_rgh", "t_r", "type", "status", "near_tangencies")
"""Columns of `runs` that `Counts.add` reads."""
ERRORS = ("t_r_error", "type_sure")
"""Columns that it reads too, where they are recorded."""
LOSSES = ("energy_left", "sigma", "rolling")
"""And where there is dissipation."""
CONTACT = ("contact_ratio_max", "contact_normal_min")
"""And where contact is recorded."""
FRICTION = {"share_friction_above_0_3": 0.3, "share_friction_above_0_6": 0.6}
"""Coefficients of friction by the columns of the shares of runs that need a larger one."""
SENSITIVE = 1e-6
"""A run is sensitive if its ``t_r_error`` is a larger share of ``t_r``."""
Z95 = 1.959963984540054
"""Quantile of the normal distribution for two-sided 95 %."""


def columns_for(config: Config) -> tuple[str, ...]:
    """Columns of the runs of a sweep that `Counts.add` reads."""
    losses = LOSSES if config.dissipation else ()
    errors = ERRORS if "error" in config.record else ()
    contact = CONTACT if "contact" in config.record else ()
    return (*COLUMNS, *errors, *losses, *contact)


class Moments:
    """Count, mean and deviation of values by cell.

    Sums are of differences from the first value of each cell, so that a mean far larger than the
    deviation costs no digits. What is beyond the range of numbers is NaN.

    Attributes
    ----------
    count : array of int, shape (cells,)
    """

    def __init__(self, cells: int) -> None:
        self.count = np.zeros(cells, np.int64)
        self._first, self._sum, self._squares = (np.zeros(cells) for _ in range(3))

    def add(self, cell: Integers, values: Floats) -> None:
        """Add values, each to its cell."""
        new = np.flatnonzero(self.count[cell] == 0)
        cells, place = np.unique(cell[new], return_index=True)
        self._first[cells] = values[new[place]]
        # One by one and in order: np.bincount would sum each piece apart.
        np.add.at(self.count, cell, 1)
        with np.errstate(over="ignore", invalid="ignore"):
            step = values - self._first[cell]
            np.add.at(self._sum, cell, step)
            np.add.at(self._squares, cell, step**2)

    def means(self) -> Floats:
        """Means, NaN of nothing."""
        return _finite(self._first + share(self._sum, self.count))

    def deviations(self) -> Floats:
        """Sample standard deviations (divisor n - 1), NaN for fewer than two."""
        with np.errstate(over="ignore", invalid="ignore"):
            squares = self._squares - share(self._sum**2, np.maximum(self.count, 1))
        return _finite(np.sqrt(share(np.maximum(squares, 0), self.count - 1)))

    def errors(self) -> Floats:
        """Standard errors of the means, NaN for fewer than two."""
        return share(self.deviations(), np.sqrt(self.count))


class Counts:
    """Runs by cell; each attribute has the shape (cells,).

    Attributes
    ----------
    runs, ok, types
        Runs, those with status ``ok``, and of these the runs of each of `TYPES`; of D only if the
        runs have dissipation.
    steady, bondi
        Runs in the steady direction that have a theory (``omega_p`` is not null) and no
        dissipation, and of these the ones past Bondi's threshold, ``abs(n_c1) < abs(n_i)``. In the
        other direction the pitch always grows.
    near_tangencies
        Sum over the runs.
    t_r, ratio : Moments
        Of ``t_r`` and of ``t_r/t_rGH`` of the runs of type R. Ratios are taken run by run: bodies
        differ in ``t_rgh`` by orders of magnitude, and those that reverse are no fair sample.
    t_rgh : Moments
        Of all runs that have one.
    t_r_error : Moments
        Of runs of type R that have one.
    sensitive, unsure_types
        Runs of type R whose error is large, and runs of each of `TYPES` whose type is not sure.
    slips, lifts
        Runs that need a larger coefficient of friction than each of `FRICTION`, and runs that lift
        off, of those with status ``ok``.
    has_errors, has_losses, has_contact : bool
        Whether any rows told errors, have dissipation, and tell the forces of contact.
    """

    def __init__(self, cells: int) -> None:
        self.runs, self.ok, self.steady, self.bondi, self.near_tangencies = (
            np.zeros(cells, np.int64) for _ in range(5)
        )
        self.sensitive = np.zeros(cells, np.int64)
        self.lifts = np.zeros(cells, np.int64)
        self.slips = {name: np.zeros(cells, np.int64) for name in FRICTION}
        self.has_errors = self.has_losses = self.has_contact = False
        # Of the runs that were done, where they count for others as well.
        self.stored_failed: Integers | None = None
        self._types = {name: np.zeros(cells, np.int64) for name in TYPES}
        self.unsure_types = {name: np.zeros(cells, np.int64) for name in TYPES}
        self.t_r, self.ratio, self.t_rgh, self.t_r_error = (Moments(cells) for _ in range(4))

    def add(self, rows: pa.RecordBatch, cell: Integers) -> None:
        """Count more runs, each in its cell; a row in a negative one is left out."""
        kept = cell >= 0
        cell = cell[kept]
        n_i, K_p, omega_p, n_c1, t_rgh, t_r = (
            floats(rows.column(name))[kept]
            for name in ("n_i", "K_p", "omega_p", "n_c1", "t_rgh", "t_r")
        )
        kind = codes(rows.column("type"), TYPES)[kept]
        ok = codes(rows.column("status"), ("ok",))[kept] == 0
        near = floats(rows.column("near_tangencies"))[kept]

        np.add.at(self.runs, cell, 1)
        np.add.at(self.ok, cell[ok], 1)
        for code, name in enumerate(TYPES):
            np.add.at(self._types[name], cell[ok & (kind == code)], 1)
        steady = np.isfinite(omega_p) & ~unsteady(K_p, n_i)
        if "energy_left" in rows.schema.names:
            self.has_losses = True
            for name in ("sigma", "rolling"):
                steady &= floats(rows.column(name))[kept] == 0
        np.add.at(self.steady, cell[steady], 1)
        # A null threshold is NaN here, which is below nothing.
        np.add.at(self.bondi, cell[steady & (np.abs(n_c1) < np.abs(n_i))], 1)
        np.add.at(self.near_tangencies, cell, np.nan_to_num(near).astype(np.int64))

        reversed_ = ok & (kind == TYPES.index("R")) & np.isfinite(t_r)
        timed = reversed_ & (t_rgh > 0)
        known = np.isfinite(t_rgh)
        self.t_r.add(cell[reversed_], t_r[reversed_])
        with np.errstate(over="ignore"):
            self.ratio.add(cell[timed], t_r[timed] / t_rgh[timed])
        self.t_rgh.add(cell[known], t_rgh[known])
        if "t_r_error" in rows.schema.names:
            self.has_errors = True
            error = floats(rows.column("t_r_error"))[kept]
            marked = reversed_ & np.isfinite(error)
            self.t_r_error.add(cell[marked], error[marked])
            np.add.at(self.sensitive, cell[marked & is_sensitive(error, t_r)], 1)
            unsure = floats(rows.column("type_sure"))[kept] == 0
            for code, name in enumerate(TYPES):
                np.add.at(self.unsure_types[name], cell[unsure & (kind == code)], 1)
        if "contact_ratio_max" in rows.schema.names:
            self.has_contact = True
            ratio, normal = (floats(rows.column(name))[kept] for name in CONTACT)
            for name, most in FRICTION.items():
                np.add.at(self.slips[name], cell[ok & (ratio > most)], 1)
            np.add.at(self.lifts, cell[ok & (normal < 0)], 1)

    @property
    def unsure(self) -> Integers:
        """Runs whose type is not sure."""
        total: Integers = np.sum([*self.unsure_types.values()], axis=0)
        return total

    @property
    def types(self) -> dict[str, Integers]:
        """Runs of each type."""
        return {n: part for n, part in self._types.items() if n != "D" or self.has_losses}

    @property
    def failed(self) -> Integers:
        """Runs with a status other than ``ok``."""
        return self.runs - self.ok if self.stored_failed is None else self.stored_failed

    def columns(self) -> dict[str, Floats | Integers | pa.Array]:
        """The columns of `summary` that follow from the runs."""
        return {
            "runs": self.runs,
            **{f"fraction_{name}": share(part, self.ok) for name, part in self.types.items()},
            **({} if self.has_losses else {"fraction_D": pa.nulls(len(self.ok), pa.float64())}),
            "fraction_bondi": share(self.bondi, self.steady),
            "t_r_mean": self.t_r.means(),
            "t_r_std": self.t_r.deviations(),
            "t_rgh_mean": self.t_rgh.means(),
            "t_r_over_t_rgh_mean": self.ratio.means(),
            "t_r_over_t_rgh_sem": self.ratio.errors(),
            "failed": self.failed,
            "near_tangencies": self.near_tangencies,
            "t_r_mean_error": self.t_r_error.means(),
            **{
                name: part if self.has_errors else pa.nulls(len(part), pa.int64())
                for name, part in (("sensitive", self.sensitive), ("unsure", self.unsure))
            },
            **{
                name: share(part, self.ok)
                if self.has_contact
                else pa.nulls(len(part), pa.float64())
                for name, part in {**self.slips, "share_lift_off": self.lifts}.items()
            },
        }


def floats(column: pa.Array) -> Floats:
    """A column of numbers; null is NaN."""
    values: Floats = column.to_numpy(zero_copy_only=False).astype(float)
    return values


def codes(column: pa.Array, words: Sequence[str]) -> Integers:
    """Place of each entry in `words`, -1 for others and null."""
    found = pc.fill_null(pc.index_in(column, pa.array(words)), -1)
    values: Integers = found.to_numpy(zero_copy_only=False).astype(np.int64)
    return values


def share(part: ArrayLike, whole: ArrayLike) -> Floats:
    """``part / whole``, NaN where there is nothing."""
    part, whole = np.asarray(part, float), np.asarray(whole, float)
    result: Floats = np.divide(part, whole, out=np.full(part.shape, np.nan), where=whole > 0)
    return result


def is_sensitive(t_r_error: Any, t_r: Any) -> Any:
    """Whether a run is sensitive, of numbers or arrays; NaN is not."""
    return t_r_error > SENSITIVE * t_r


def _finite(values: Floats) -> Floats:
    return np.where(np.isfinite(values), values, np.nan)


def wilson(part: ArrayLike, whole: ArrayLike, z: float = Z95) -> tuple[Floats, Floats]:
    """Interval of a share by Wilson (J. Am. Stat. Assoc. 22, 209, 1927), by default of 95 %.

    Lower and upper ends, of the shape of `part` and `whole`; NaN where there is nothing.
    """
    part, whole = np.asarray(part, float), np.asarray(whole, float)
    if np.any((part < 0) | (part > whole)):
        raise ValueError("a share has more parts than its whole, or less than none")
    p, weight = share(part, whole), share(np.full(part.shape, z * z), whole)
    centre = (p + weight / 2) / (1 + weight)
    half = np.sqrt(weight * (p * (1 - p) + weight / 4)) / (1 + weight)
    # At 0 and 1 the ends are exact; rounding must not carry them out of the unit interval.
    return np.where(p == 0, 0.0, centre - half), np.where(p == 1, 1.0, centre + half)
