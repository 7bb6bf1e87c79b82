"""A stored run again, as a trajectory: found, proved equal to what is stored, followed."""
# ruff: noqa: D102 - names and types say it

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.analysis.layout import parse_where
from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.integrate.model import MODELS
from rattlesweep.integrate.status import Status
from rattlesweep.sweeps.block import run_batch
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.counts import is_sensitive
from rattlesweep.sweeps.decide import decides
from rattlesweep.sweeps.error import PARTED, Estimated
from rattlesweep.sweeps.launches import Launches, make_batch, prepare
from rattlesweep.sweeps.memory import differing_rows
from rattlesweep.sweeps.stored import open_stored


@dataclass(frozen=True)
class StoredRun:
    """One row of a sweep's runs; null is None."""

    case: int
    sample: int
    t_r: float | None
    t_end: float
    type: str | None
    status: str
    n_end: float | None
    n_steps: int
    t_r_error: float | None = None
    type_sure: bool | None = None
    tol: float | None = None
    early: bool = False  # whether it may have ended before its horizon

    @property
    def name(self) -> str:
        return f"case {self.case}, sample {self.sample}"

    @property
    def sensitive(self) -> bool:
        return None not in (self.t_r, self.t_r_error) and is_sensitive(self.t_r_error, self.t_r)

    @property
    def proof(self) -> str:
        """What :meth:`Replay.prove` and :meth:`check` have shown, in one line."""
        if self.status != "ok":
            return f"{self.name}: status {self.status} as stored, bit for bit"
        error = "" if None in (self.t_r, self.t_r_error) else f" +- {self.t_r_error:.2g}"
        error += " (sensitive)" if self.sensitive else ""
        t_r = "no reversal" if self.t_r is None else f"t_r {self.t_r!r}{error}"
        doubt = " (not sure)" if self.type_sure is False else ""
        return f"{self.name}: {t_r} and type {self.type}{doubt} as stored, bit for bit"

    def check(self, course: Course) -> None:
        """Compare a followed trajectory with the stored row, bit for bit.

        The first zero of its spin is ``t_r``; where the run ends at the stored ``t_end`` without
        one, its number of steps is ``n_steps``, or one more behind an early end, which a step was
        to go beyond by less than a rounding error. An OutputError says that they differ.
        """
        if course.model not in MODELS or self.status != "ok":
            return
        if course.status != Status.OK and course.t < self.t_end:
            return  # a body on its side, which a trajectory does not follow
        first = course.zeros[0] if course.zeros else None
        if self.t_r is None:
            wrong = first is not None and first <= self.t_end
            more = course.n_steps - self.n_steps
            wrong |= course.t == self.t_end and not 0 <= more <= self.early
        else:
            wrong = first != self.t_r if self.t_end <= course.t else first is not None
        if wrong:
            raise OutputError(
                f"{self.name} reverses at {first!r} after {course.n_steps} steps when it is "
                f"followed, and is stored with t_r = {self.t_r!r} and {self.n_steps} steps"
            )


class Replay:
    """An output directory, whole or still running, whose runs can be integrated again.

    What is wrong with a request is a ConfigError; what is not stored yet, damaged, or comes out
    otherwise than stored is an OutputError.
    """

    def __init__(self, directory: Path) -> None:
        self._stored = open_stored(directory)
        self.directory = directory
        self.config: Config = self._stored.config
        there = self._stored.schema.names
        self._fields = [part.name for part in fields(StoredRun) if part.name in there]

    def find(self, case: int, sample: int) -> StoredRun:
        stored = self._stored
        for name, value, count in (
            ("case", case, len(stored.cases)), ("sample", sample, stored.samples)
        ):  # fmt: skip
            if not 0 <= value < count:
                raise ConfigError(
                    f"{name} {value}: {self.directory} has the {name}s 0 to {count - 1}"
                )
        found = self._row(case, sample, self._fields)
        if not len(found):
            key = decides(self.config)
            why = f": {key} has left it out, or it is still to come" if key else " yet"
            raise OutputError(
                f"case {case}, sample {sample} is not stored{why} in {self.directory}"
            )
        return self._runs(found)[0]

    def where(self, text: str, first: int) -> list[StoredRun]:
        """Return the first runs, in their order, for which a condition is true; at least one."""
        where = parse_where(text, self._stored.schema)
        found: list[StoredRun] = []
        for rows in self._stored.batches(list(dict.fromkeys((*self._fields, *where.columns)))):
            chosen = pa.Table.from_batches([where.filter(rows)])
            found += self._runs(chosen.slice(0, first - len(found)).select(self._fields))
            if len(found) == first:
                break
        if not found:
            raise ConfigError(f"--where {text}: {self.directory} stores no such run")
        return found

    def _row(self, case: int, sample: int, names: Sequence[str] | None = None) -> pa.Table:
        mine = (pc.field("case") == case) & (pc.field("sample") == sample)
        for rows in self._stored.batches(names):
            if len(found := pa.Table.from_batches([rows]).filter(mine)):
                return found
        return pa.table({})

    def _runs(self, table: pa.Table) -> list[StoredRun]:
        early = self.config.classify.early
        return [StoredRun(**values, early=early) for values in table.to_pylist()]

    def select(
        self,
        case: int | None = None,
        sample: int | None = None,
        where: str | None = None,
        first: int | None = None,
    ) -> list[StoredRun]:
        """Return runs by case and sample, or the first by a condition, as the command line does."""
        if where is not None:
            if case is not None or sample is not None:
                raise ConfigError("--where and --case, --sample are both given; keep one way")
            return self.where(where, first or 1)
        if case is None or sample is None:
            raise ConfigError("which run? give --case and --sample, or --where")
        if first is not None:
            raise ConfigError("--first goes with --where")
        return [self.find(case, sample)]

    def prove(self, run: StoredRun, threads: int | None = 1) -> None:
        """Integrate a run as the sweep did, and compare its whole row bit for bit."""
        thresholds = self._stored.thresholds
        plan = self._stored.plan
        plan = replace(plan, config=plan.config.model_copy(update={"classify": thresholds}))
        for _, _, names in differing_rows(plan, self._row(run.case, run.sample), threads):
            raise OutputError(
                f"{run.name} comes out otherwise than stored, in {', '.join(names[:6])}"
                f"{' and others' if len(names) > 6 else ''}; see rattlesweep verify"
            )

    def cause(self, run: StoredRun) -> str:
        """Return why a run is sensitive, in a line with its numbers; empty if it is not."""
        if not run.sensitive:
            return ""
        launches = self._launches(run)
        batch = make_batch(launches, self.config.model)
        assert batch is not None
        found = run_batch(self.config, batch, threads=1)
        assert isinstance(found, Estimated)
        swing = 2 * np.pi / float(batch.swing[0])
        return f"{run.name}: {cause_of(found, swing, float(launches.n_i[0]))}"

    def _launches(self, run: StoredRun) -> Launches:
        return prepare(self._stored.plan, np.array([run.case]), np.array([run.sample]))

    def prepare(self, run: StoredRun, t_end: float | None = None) -> PreparedRun:
        """Return the run for a :class:`Course`, to ``t_end`` or the sweep's horizon."""
        launches = self._launches(run)
        if t_end is not None:
            if not (np.isfinite(t_end) and t_end > 0):
                raise ConfigError(f"t_end {t_end:g}: a finite, positive time is needed")
            launches = replace(launches, t_end=np.array([t_end]))
        config = self.config
        if run.tol is not None:
            # The one of several tolerances that the run was integrated with.
            own = config.integrator.model_copy(update={"accuracy": None, "tol": run.tol})
            config = config.model_copy(update={"integrator": own})
        return config, launches, make_batch(launches, config.model)


def cause_of(found: Estimated, swing: float, n_i: float) -> str:
    """Return why the error of the only run of an outcome is large: what its companion did.

    `swing` is how long the spin takes to swing once; docs/accuracy.md tells of each kind.
    """
    looser, apart, grazes = (
        getattr(found, name)[0] for name in ("companion_tol", "apart", "grazes")
    )
    other, t_r = found.companion_t_r[0], found.t_r[0]
    at = "in steps twice as long" if np.isnan(looser) else f"at tol {looser:.2g}"
    instead = f"{at} it reverses at {other:.8g} instead of {t_r:.8g}"
    # A zero that was missed or found too much is a swing off; what is more has other reasons.
    if grazes and found.t_r_error[0] <= 2 * swing:
        extrema = "an extremum" if grazes == 1 else f"{grazes} extrema"
        return (
            f"it grazes zero: {extrema} of its spin so near zero that the tolerance cannot tell "
            f"whether it reversed there; {instead}"
        )
    if np.isnan(other):
        return f"it may not reverse: {at} it does not"
    if apart >= PARTED:
        kind = "a delayed loss of stability" if n_i < 0 else "chaos"
        grown = "" if np.isnan(looser) else f", {apart / looser:.0e} times that tol"
        return (
            f"{kind}: {instead}, with states that are {apart:.2g} of the oscillation apart{grown}"
        )
    return (
        f"errors that a tighter tolerance makes smaller: {instead}, "
        f"with states that are {apart:.1e} of the oscillation apart"
    )


def targets(
    path: Path | None, runs: Sequence[StoredRun], option: str, *, printed: bool = False
) -> list[Path | None]:
    """Return a file for each run: the path with ``{case}`` and ``{sample}`` filled in.

    `printed` tells whether runs without a file are printed, which is for one run only.
    """
    advice = "name files by run, such as run-{case}-{sample}"
    if path is None:
        if printed and len(runs) > 1:
            raise ConfigError(f"{len(runs)} runs do not go into one table; {advice} ({option})")
        return [None] * len(runs)
    names = [
        str(path).replace("{case}", str(run.case)).replace("{sample}", str(run.sample))
        for run in runs
    ]
    if len(set(names)) < len(names):
        raise ConfigError(f"{option} {path}: {len(names)} runs would be written there; {advice}")
    return [Path(name) for name in names]
