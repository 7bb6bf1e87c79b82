"""Check an output directory: files, keys, types, theory, and runs that are computed again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError, DamagedError
from rattlesweep.physics import theory
from rattlesweep.sweeps.arrow import read_parquet
from rattlesweep.sweeps.counts import floats
from rattlesweep.sweeps.decide import decision
from rattlesweep.sweeps.provenance import versions
from rattlesweep.sweeps.rows import Found
from rattlesweep.sweeps.stored import SUMMARY, Stored, open_stored
from rattlesweep.sweeps.summary import same_summary, summarise
from rattlesweep.sweeps.types import with_types
from rattlesweep.text import counted

CLOSE = 1e-9
"""Relative difference up to which theory counts as equal: other processors have other last bits."""
TOLD = 10
"""Problems that are printed."""


@dataclass
class Verified:
    """What was found.

    Attributes
    ----------
    directory : Path
    runs, files, missing : int
        Rows and files there are, and runs that are wanted and not there.
    recomputed : int
        Runs that were integrated again.
    problems, notes : list of str
        What is wrong, a sentence each; what is worth knowing and no problem.
    """

    directory: Path
    runs: int = 0
    files: int = 0
    missing: int = 0
    recomputed: int = 0
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def words(self) -> str:
        """The same for the terminal."""
        missing = f", {counted(self.missing, 'run')} not done yet" if self.missing else ""
        lines = [f"{counted(self.runs, 'run')} in {counted(self.files, 'file')}{missing}"]
        if self.recomputed:
            lines.append(f"{counted(self.recomputed, 'run')} computed again")
        lines += [f"note: {note}" for note in self.notes]
        lines += [f"problem: {problem}" for problem in self.problems[:TOLD]]
        if (more := len(self.problems) - TOLD) > 0:
            lines.append(f"and {counted(more, 'more problem')}")
        lines.append(
            counted(len(self.problems), "problem") if self.problems else "no problem found"
        )
        return "\n".join(lines)


def verify(
    directory: Path,
    recompute: int = 0,
    seed: int = 0,
    threads: int | None = None,
    report: Callable[[float], None] = lambda share: None,
) -> Verified:
    """Read all of an output directory and compare it with its manifest; nothing is changed.

    Parameters
    ----------
    directory : Path
    recompute, seed : int
        Number of runs that are integrated again and compared bit by bit, and the seed of their
        draw.
    threads : int, optional
    report : callable
        Called with the share that is done.

    Raises
    ------
    ConfigError
        If it is no output directory.
    OutputError
        If a file cannot be read, or the manifest is damaged.
    """
    stored = open_stored(directory)
    result = Verified(directory, files=len(stored.files()))
    found = stored.runs.find(stored.cases, stored.samples, stored.hash, stored.schema)
    result.runs = found.rows
    result.problems += [
        f"{path} is damaged; `rattlesweep run` does its runs again" for path in found.damaged
    ]
    decide = decision(stored.config, stored.cases, stored.samples)
    if decide is None:
        result.missing = found.done.size - found.rows
    elif not found.damaged:
        decide.read(stored)
        result.missing = int((decide.wanted() & ~found.done).sum())
    for text, paths in found.typed.items():
        if text != stored.typed:
            more = f" and {counted(len(paths) - 1, 'more file')}" if len(paths) > 1 else ""
            result.problems.append(
                f"{paths[0]}{more} were typed by other thresholds; `rattlesweep classify` ends "
                "what was begun"
            )
    good = [path for paths in found.typed.values() for path in paths]
    for number, path in enumerate(good):
        report(0.5 * number / len(good))
        result.problems += _row_problems(stored, path)
    _check_summary(stored, result)
    if recompute:
        _recompute(stored, found, min(recompute, found.rows), seed, threads, result, report)
    report(1.0)
    return result


def _row_problems(stored: Stored, path: Path) -> Iterator[str]:
    """Yield what is wrong with the rows of a file."""
    rows = stored.runs.table(path)
    case, sample = (rows.column(n).to_numpy().astype(np.int64) for n in ("case", "sample"))

    def told(wrong: Any, what: str) -> Iterator[str]:
        places = np.flatnonzero(wrong)
        if len(places):
            such = f"such as case {case[places[0]]} sample {sample[places[0]]}"
            yield f"{path}: {counted(len(places), 'run')}, {such}: {what}"

    order = np.lexsort((sample, case))
    yield from told(order != np.arange(len(order)), "its rows are not in order")
    for name, kind in zip(rows.schema.names, rows.schema.types, strict=True):
        values = pc.drop_null(rows.column(name)).to_numpy()
        if pa.types.is_floating(kind) and not np.isfinite(values).all():
            yield f"{path}: {name} holds a number that is not finite"
    again = with_types(rows, stored.thresholds)
    for name in {"type", "type_sure"}.intersection(rows.schema.names):
        theirs, ours = (table.column(name).to_numpy() for table in (rows, again))
        yield from told(theirs != ours, f"{name} does not follow from its columns")
    modes = theory.modes(*(floats(rows.column(n)) for n in ("alpha", "beta", "theta", "phi", "xi")))
    for name in ("omega_p", "omega_r", "K_p", "K_r"):
        theirs, ours = floats(rows.column(name)), getattr(modes, name)
        ours = np.where(np.isfinite(ours), ours, np.nan)
        wrong = ~np.isclose(theirs, ours, CLOSE, 0, equal_nan=True)
        yield from told(wrong, f"{name} does not follow from its body")
    t_r, t_end = floats(rows.column("t_r")), floats(rows.column("t_end"))
    yield from told(t_r > t_end * (1 + 1e-12), "t_r is later than t_end")


def _check_summary(stored: Stored, result: Verified) -> None:
    path = stored.directory / SUMMARY
    try:
        if not path.exists():
            if not result.missing and not result.problems:
                result.problems.append(f"{path} is missing; `rattlesweep run` writes it")
        elif not result.problems and not same_summary(read_parquet(path), summarise(stored)):
            result.problems.append(
                f"{path} does not follow from the runs; `rattlesweep run` writes it anew"
            )
    except DamagedError as error:
        result.problems.append(f"{error}; `rattlesweep run` writes it anew")


def _recompute(
    stored: Stored,
    found: Found,
    count: int,
    seed: int,
    threads: int | None,
    result: Verified,
    report: Callable[[float], None],
) -> None:
    """Integrate some runs again."""
    # Numba, without which the rest can be checked.
    from rattlesweep.sweeps.memory import differing_rows

    theirs = stored.manifest["versions"]
    other = [f"{n} {theirs.get(n)} then, {v} now" for n, v in versions().items()
             if theirs.get(n) != v]  # fmt: skip
    if other:
        result.notes.append(f"last bits may differ: {'; '.join(other)}")
    try:
        plan = stored.plan
    except ConfigError as error:
        result.problems.append(str(error))
        return
    random = np.random.default_rng(seed)
    chosen = np.sort(random.choice(found.rows, count, replace=False, shuffle=False))
    limit, gone_on, first = stored.config.integrator.max_steps, 0, 0
    for path in (path for paths in found.typed.values() for path in paths):
        rows = stored.runs.table(path)
        here = chosen[(chosen >= first) & (chosen < first + len(rows))] - first
        first += len(rows)
        if not len(here):
            continue
        rows = rows.take(pa.array(here))
        keys = zip(rows["case"].to_pylist(), rows["sample"].to_pylist(), strict=True)
        told = zip(rows["status"].to_pylist(), rows["n_steps"].to_pylist(), strict=True)
        stopped = {
            key
            for key, (status, steps) in zip(keys, told, strict=True)
            if status == "step_limit" and steps < limit
        }
        for case, sample, names in differing_rows(plan, rows, threads):
            if (case, sample) in stopped:
                gone_on += 1
                continue
            result.problems.append(
                f"case {case} sample {sample} comes out differently: {', '.join(names[:4])}"
            )
        result.recomputed += len(here)
        report(0.5 + 0.5 * result.recomputed / count)
    if gone_on:
        result.notes.append(
            f"{counted(gone_on, 'run')} failed before, under a smaller integrator.max_steps; "
            "`rattlesweep run --retry-failed` does them again"
        )
