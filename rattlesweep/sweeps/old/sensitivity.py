"""Which parameter matters: indices of Sobol' over the ranges that bodies are drawn from.

First-order indices are the share of a variance that goes with one parameter alone, total ones the
share that would be left if all others were known. With ``draw: saltelli`` both follow from runs
that differ in one parameter (Saltelli et al., Comput. Phys. Commun. 181, 259, 2010; Jansen, Comput.
Phys. Commun. 117, 35, 1999), else first-order ones from means in bins of a parameter.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.schema import SdSource
from rattlesweep.sweeps.old.stored import Stored, open_stored
from rattlesweep.sweeps.types import TYPES

TIMES = ("t_r", "log10 t_r")
QUANTITIES = (*TIMES, *(f"P({name})" for name in TYPES))
REPLICATES = 500
FEWEST = 64
"""Values from which on indices are told."""
IN_BIN = 16
"""Values in a bin: more would blur what a quantity does within, fewer tell no variance."""
_SEED = 20170427
_COLUMNS = ("case", "sample", "t_r", "type", "status")


@dataclass(frozen=True)
class Indices:
    """What a parameter has to do with a quantity in a case; NaN is what cannot be told."""

    case: int
    of: str  # one of QUANTITIES
    parameter: str
    used: int  # runs by which it is told
    # Runs that were done but have no value: those that did not reverse or failed, and with
    # `draw: saltelli` those that differ from them in a parameter.
    left_out: int
    first: float  # index of first order, with its interval of 95 % (bootstrap)
    first_low: float
    first_high: float
    total: float
    total_low: float
    total_high: float

    def data(self) -> dict[str, Any]:
        """As JSON can hold it."""
        return {k: None if v != v else v for k, v in asdict(self).items()}


@dataclass
class Sensitivity:
    """Indices of a sweep, by case, quantity and parameter, of which these are all."""

    directory: Path
    draw: str
    parameters: tuple[str, ...]
    cases: list[dict[str, Any]]
    rows: list[Indices]

    def data(self) -> dict[str, Any]:
        """All of it as JSON can hold it."""
        return {
            "directory": str(self.directory),
            "draw": self.draw,
            "cases": self.cases,
            "indices": [row.data() for row in self.rows],
        }


def sensitivity(directory: Path) -> Sensitivity:
    """Indices of a directory's runs, of those that are there.

    A ConfigError if its bodies are not drawn from ranges alone, an OutputError if there are too
    few runs.
    """
    stored = open_stored(directory)
    bodies, manifest = stored.config.bodies, stored.manifest
    if not isinstance(bodies, SdSource):
        raise ConfigError(
            f"{directory}: its bodies are not drawn from ranges (source: {bodies.source}), so no "
            "share of a variance goes with any; indices need source: sd"
        )
    if bodies.target is not None:
        raise ConfigError(
            f"{directory}: its bodies are drawn for a target, by which their parameters depend on "
            "each other; indices need a sweep without bodies.target"
        )
    rows: list[Indices] = []
    for case, sample, x, y in _cases(stored, bodies.drawn):
        for of, values in y.items():
            rows += _of_values(case, of, sample, dict(zip(bodies.drawn, x, strict=True)), values,
                               bodies.group if bodies.draw == "saltelli" else 0)  # fmt: skip
    if not rows:
        raise OutputError(
            f"{directory}: no case has {FEWEST} values of anything that varies; it takes more runs"
        )
    cases = [case.model_dump(exclude_none=True) for case in manifest.cases]
    return Sensitivity(directory, bodies.draw, bodies.drawn, cases, rows)


def _cases(
    stored: Stored, drawn: tuple[str, ...]
) -> Iterator[tuple[int, Integers, Floats, dict[str, Floats]]]:
    """Case by case: samples, parameters of the shape (parameters, samples), and quantities."""
    own = ["xi" if name == "minus_xi_deg" else name for name in drawn]
    batches = [*stored.store.iter_batches([*_COLUMNS, *own], complete=True)]
    if not batches:
        return
    runs = pa.Table.from_batches(batches).to_pandas(categories=["type", "status"])
    for case, rows in runs.groupby("case"):
        kind = rows.type.where(rows.status == "ok")
        t_r = rows.t_r.where(kind == "R").to_numpy()
        quantities = {TIMES[0]: t_r, TIMES[1]: np.log10(t_r)}
        for name in TYPES:
            quantities[f"P({name})"] = (kind == name).where(kind.notna(), np.nan).to_numpy(float)
        yield int(case), rows["sample"].to_numpy(), rows[own].to_numpy(float).T, quantities


def _of_values(
    case: int, of: str, sample: Integers, x: Mapping[str, Floats], y: Floats, group: int
) -> Iterator[Indices]:
    """Indices of one quantity; nothing if it is too seldom or does not vary.

    `x` are the parameters in their order, `group` is how many samples are drawn together, if they
    are so for the sake of the indices.
    """
    designed = group > 0
    if designed:
        f = np.full((group, sample.max() // group + 1), np.nan)
        f[sample % group, sample // group] = y
    for place, (name, values) in enumerate(x.items()):
        runs = f[[0, 1, 2 + place]] if designed else np.stack([bins_of(values, y), y])
        together = runs.shape[0] if designed else 1
        done = together * runs.shape[1]
        runs = runs[:, np.isfinite(runs).all(axis=0)]
        used = runs.shape[1]
        if used < FEWEST or np.ptp(runs[:2] if designed else runs[1]) == 0:
            continue
        estimate = from_design if designed else from_bins
        random = np.random.default_rng(_SEED)
        again = np.array(
            [estimate(*runs[:, random.integers(0, used, used)]) for _ in range(REPLICATES)]
        )
        # Values that come again make means of bins vary more, which shifts all alike.
        found = np.array(estimate(*runs))
        ends = found + np.quantile(again - again.mean(axis=0), [0.025, 0.975], axis=0)
        first, total = (map(float, (found[k], *ends[:, k])) for k in (0, 1))
        yield Indices(case, of, name, together * used, done - together * used, *first, *total)


def from_design(f_a: Floats, f_b: Floats, f_ab: Floats) -> tuple[float, float]:
    """First-order and total index of a parameter, from runs at points A, at B, and at those of A
    with the parameter of B.
    """
    both = np.concatenate([f_a, f_b])
    variance = both.var()
    if variance == 0:  # of a few runs drawn again
        return 0.0, 0.0
    # A constant does not count, but adds to the error of the product.
    first = np.mean((f_b - both.mean()) * (f_ab - f_a)) / variance
    return float(first), float(np.mean((f_a - f_ab) ** 2) / 2 / variance)


def bins_of(x: Floats, y: Floats) -> Floats:
    """Bins with as many values of `x` each, as numbers from 0."""
    rank = np.argsort(np.argsort(x, kind="stable"))
    places: Floats = np.floor(rank / (len(x) / max(4, np.isfinite(y).sum() // IN_BIN)))
    return places


def from_bins(place: Floats, y: Floats) -> tuple[float, float]:
    """First-order index of a parameter from means of `y` in bins of it; no total one (NaN).

    The variance of the means is less what they vary by chance.
    """
    variance, at = y.var(ddof=1), place.astype(np.int64)
    if variance == 0:
        return 0.0, np.nan
    off = y - y.mean()
    counts = np.bincount(at)
    kept = counts > 1
    count = counts[kept]
    means, squares = (np.bincount(at, off**k)[kept] / count for k in (1, 2))
    chance = (squares - means**2) / (count - 1)
    return float(np.average(means**2 - chance, weights=count) / variance), np.nan
