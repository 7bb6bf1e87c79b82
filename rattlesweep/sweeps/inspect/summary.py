"""One row a case: what the runs of a case have in common.

Counts are exact in any order. Means and deviations are taken over a case's values gathered in
the order of its samples, so that how a sweep was cut into blocks does not show in the last bit.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import OutputError
from rattlesweep.physics.theory import unsteady
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.tables.arrow import build_table
from rattlesweep.sweeps.tables.columns import summary_schema
from rattlesweep.sweeps.tables.types import TYPES

_NEEDED = ("case", "n_i", "K_p", "omega_p", "n_c1", "t_rgh", "t_r", "type", "status",
           "near_tangencies")  # fmt: skip
_NAN = float("nan")


class CaseLike(Protocol):
    """What a summary needs to know of a case."""

    @property
    def index(self) -> int:
        """Its number."""

    @property
    def target_name(self) -> str | None:
        """``"K_p"``, ``"K_r"`` or none."""

    @property
    def target(self) -> float | None:
        """Target value of that."""

    @property
    def n_i(self) -> float | None:
        """Initial spin in sqrt(g/a); none where rows differ."""

    @property
    def omega_xy0(self) -> float | None:
        """Initial rate of the oscillation in sqrt(g/a); none where rows differ."""


@dataclass
class _Tally:
    """What is gathered of one case; 24 bytes a row at most, the rest are counts."""

    runs: int = 0
    ok: int = 0
    types: dict[str, int] = field(default_factory=lambda: dict.fromkeys(TYPES, 0))
    steady: int = 0
    bondi: int = 0
    near_tangencies: int = 0
    # array() grows in place: a list of pieces needs twice the memory once joined.
    t_r: array[float] = field(default_factory=lambda: array("d"))
    t_rgh: array[float] = field(default_factory=lambda: array("d"))
    ratio: array[float] = field(default_factory=lambda: array("d"))

    def add(self, rows: pa.RecordBatch) -> None:
        ok = _is(rows, "status", "ok")
        self.runs += rows.num_rows
        self.ok += int(ok.sum())
        reversed_ = ok & _is(rows, "type", "R")
        for name in TYPES:
            self.types[name] += int((ok & _is(rows, "type", name)).sum())
        n_i = _floats(rows, "n_i")
        # Bondi's threshold is one of the steady direction: in the other the pitch always grows.
        steady = np.isfinite(_floats(rows, "omega_p")) & ~unsteady(_floats(rows, "K_p"), n_i)
        # A null threshold is NaN here, which is below nothing.
        bondi = np.abs(_floats(rows, "n_c1")) < np.abs(n_i)
        self.steady += int(steady.sum())
        self.bondi += int((steady & bondi).sum())
        self.near_tangencies += pc.sum(rows.column("near_tangencies"), min_count=0).as_py()
        t_r, t_rgh = _floats(rows, "t_r"), _floats(rows, "t_rgh")
        reversed_ &= np.isfinite(t_r)
        timed = reversed_ & (t_rgh > 0)
        self.t_r.frombytes(t_r[reversed_].tobytes())
        self.ratio.frombytes((t_r[timed] / t_rgh[timed]).tobytes())
        self.t_rgh.frombytes(t_rgh[np.isfinite(t_rgh)].tobytes())

    def row(self, case: CaseLike) -> dict[str, float]:
        t_rgh_mean = _mean(self.t_rgh)
        self.t_rgh = array("d")  # makes room for the copy that the deviation takes
        t_r_mean, t_r_std = _mean(self.t_r), _deviation(self.t_r)
        self.t_r = array("d")
        ratio_mean, ratio_std = _mean(self.ratio), _deviation(self.ratio)
        return {
            "case": case.index,
            "K_p": _value(case.target if case.target_name == "K_p" else None),
            "K_r": _value(case.target if case.target_name == "K_r" else None),
            "n_i": _value(case.n_i),
            "omega_xy0": _value(case.omega_xy0),
            "runs": self.runs,
            **{f"fraction_{name}": _share(n, self.ok) for name, n in self.types.items()},
            "fraction_bondi": _share(self.bondi, self.steady),
            "t_r_mean": t_r_mean,
            "t_r_std": t_r_std,
            "t_rgh_mean": t_rgh_mean,
            "t_r_over_t_rgh_mean": ratio_mean,
            "t_r_over_t_rgh_sem": ratio_std / max(len(self.ratio), 1) ** 0.5,
            "failed": self.runs - self.ok,
            "near_tangencies": self.near_tangencies,
        }


def summarise(store: Store, cases: Sequence[CaseLike]) -> pa.Table:
    """Summarise the stored runs, one row a case in the order of `cases`.

    The runs of complete blocks count: what a stopped session has left of another block are the runs
    that were first to end, which are not like the rest. Runs are streamed, and only one case's
    reversal times are held, 24 bytes a run. The result does not depend, in any bit, on how the runs
    are cut into blocks. A case of which nothing is stored yet has 0 runs and nulls.

    Parameters
    ----------
    store
        Where the runs are; those of one case must follow one another.
    cases
        Their targets and launches. A target is null unless the case has one.

    Returns
    -------
    pyarrow.Table
        Of `summary_schema`. Fractions of types are of runs with status ok, null where there are
        none. `t_r_std` is the sample standard deviation (divisor n - 1), null for fewer than
        two. A run has a theory where `omega_p` is not null, and `fraction_bondi` is of those in the
        steady direction. Ratios are taken run by run: bodies differ in `t_rgh` by orders of
        magnitude, and those that reverse are not a fair sample of them.

    Raises
    ------
    OutputError
        A block is unreadable or damaged, holds a case that is not in `cases`, or cases are
        out of order.
    """
    known = {case.index: case for case in cases}
    rows: dict[int, dict[str, float]] = {}
    for number, tally in _tallies(store):
        if number not in known:
            raise OutputError(f"{store.runs} holds runs of case {number}, which the sweep has not")
        rows[number] = tally.row(known[number])
    ordered = [rows.get(case.index) or _Tally().row(case) for case in cases]
    schema = summary_schema()
    columns = {
        f.name: np.array([row[f.name] for row in ordered], dtype=f.type.to_pandas_dtype())
        for f in schema
    }
    return build_table(columns, schema)


def _tallies(store: Store) -> Iterator[tuple[int, _Tally]]:
    """Yield (case, tally) as each case comes to its end."""
    current, tally = -1, _Tally()
    for batch in store.iter_batches(_NEEDED, complete=True):
        numbers = batch.column("case").to_numpy(zero_copy_only=False)
        starts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
        for start, stop in pairwise(starts):
            if start == stop:  # an empty batch
                continue
            number = int(numbers[start])
            if number < current:
                raise OutputError(f"the rows in {store.runs} are not in the order of their cases")
            if number > current:
                if tally.runs:
                    yield current, tally
                current, tally = number, _Tally()
            tally.add(batch.slice(start, stop - start))
    if tally.runs:
        yield current, tally


def _floats(rows: pa.RecordBatch, name: str) -> npt.NDArray[np.float64]:
    values: npt.NDArray[np.float64] = rows.column(name).to_numpy(zero_copy_only=False)
    return values


def _is(rows: pa.RecordBatch, name: str, word: str) -> npt.NDArray[np.bool_]:
    equal = pc.fill_null(pc.equal(rows.column(name), word), False)
    values: npt.NDArray[np.bool_] = equal.to_numpy(zero_copy_only=False)
    return values


def _mean(values: array[float]) -> float:
    return float(np.mean(np.frombuffer(values))) if values else _NAN


def _deviation(values: array[float]) -> float:
    return float(np.std(np.frombuffer(values), ddof=1)) if len(values) > 1 else _NAN


def _share(part: int, whole: int) -> float:
    return part / whole if whole else _NAN


def _value(value: float | None) -> float:
    return _NAN if value is None else float(value)


# -------------------------------------------------------------------- for the terminal


def closing_table(summary: pa.Table) -> str:
    """Lay a summary out as an aligned text table about 100 characters wide.

    ``t_r`` and ``t_r/t_rGH`` are means over type R, the latter of the ratio of each run. It is
    "-", as Bondi's share is, where there is none.
    """
    shares = {
        "R": "fraction_R",
        "SS": "fraction_SS",
        "SW": "fraction_SW",
        "uncl.": "fraction_unclassified",
        "Bondi": "fraction_bondi",
    }
    head = ["case", "target", "n_i", "omega_xy0", "runs", *shares, "t_r", "t_r/t_rGH"]
    lines = [[*head, "fail"]]
    for row in summary.to_pylist():
        targets = [f"{k}={row[k]:.4g}" for k in ("K_p", "K_r") if row[k] is not None]
        lines.append(
            [
                str(row["case"]),
                targets[0] if targets else "-",
                _text(row["n_i"], ".4g"),
                _text(row["omega_xy0"], ".4g"),
                str(row["runs"]),
                *(_text(row[name], ".3f") for name in shares.values()),
                _text(row["t_r_mean"], ".5g"),
                _text(row["t_r_over_t_rgh_mean"], ".4f"),
                str(row["failed"]),
            ]
        )
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True))
        for line in lines
    )


def _text(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
