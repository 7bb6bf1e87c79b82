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
from rattlesweep.sweeps.columns import floats, read_parquet
from rattlesweep.sweeps.decide import decision
from rattlesweep.sweeps.stored import SUMMARY, Stored, open_stored
from rattlesweep.sweeps.summary import same_summary, summarise
from rattlesweep.sweeps.types import with_types
from rattlesweep.text import counted

CLOSE = 1e-9  # relative difference of theory on another processor
TOLD = 10  # problems that are printed


@dataclass
class Verified:
    """What was found."""

    directory: Path
    runs: int = 0  # rows
    files: int = 0
    missing: int = 0  # runs that are wanted and not there
    recomputed: int = 0  # runs that were integrated again
    problems: list[str] = field(default_factory=list)  # a sentence each

    @property
    def words(self) -> str:
        """The same for the terminal."""
        missing = f", {counted(self.missing, 'run')} not done yet" if self.missing else ""
        lines = [f"{counted(self.runs, 'run')} in {counted(self.files, 'file')}{missing}"]
        if self.recomputed:
            lines.append(f"{counted(self.recomputed, 'run')} computed again")
        lines += [f"problem: {problem}" for problem in self.problems[:TOLD]]
        if (more := len(self.problems) - TOLD) > 0:
            lines.append(f"and {counted(more, 'more problem')}")
        found = counted(len(self.problems), "problem") if self.problems else "no problem found"
        return "\n".join([*lines, found])


def verify(
    directory: Path,
    recompute: int = 0,
    seed: int = 0,
    threads: int | None = None,
    report: Callable[[float], None] = lambda share: None,
) -> Verified:
    """Read all of an output directory and compare it with its manifest; nothing is changed.

    So many runs as `recompute` says, drawn by `seed`, are integrated again and compared bit by bit.
    `report` is called with the share that is done.

    Raise a ConfigError if it is no output directory, and an OutputError if a file cannot be read
    or the manifest is damaged.
    """
    stored = open_stored(directory)
    found = stored.runs.find(stored.cases, stored.samples, stored.hash, stored.schema)
    result = Verified(directory, found.rows, len(stored.files()))
    problems = result.problems
    for path in found.damaged:
        problems.append(f"{path} is damaged; `rattlesweep run` does its runs again")
    decide = decision(stored.config, stored.cases, stored.samples)
    if decide is None:
        result.missing = found.done.size - found.rows
    elif not found.damaged:
        decide.read(stored)
        result.missing = int((decide.wanted() & ~found.done).sum())
    problems += [
        f"{counted(len(paths), 'file')}, such as {paths[0]}, typed by other thresholds; "
        "`rattlesweep classify` ends what was begun"
        for text, paths in found.typed.items() if text != stored.typed
    ]  # fmt: skip
    good = [path for paths in found.typed.values() for path in paths]
    count, last = min(recompute, found.rows), 0
    chosen = np.random.default_rng(seed).choice(found.rows, count, replace=False)
    for number, path in enumerate(good):
        report(number / len(good))
        rows = stored.runs.table(path)
        problems += _row_problems(stored, path, rows)
        first, last = last, last + len(rows)
        if len(here := np.sort(chosen[(chosen >= first) & (chosen < last)]) - first):
            _recompute(stored, rows.take(pa.array(here)), threads, result)
    path, anew = stored.directory / SUMMARY, "`rattlesweep run` writes it anew"
    try:
        if not path.exists():
            if not result.missing and not problems:
                problems.append(f"{path} is missing; {anew}")
        elif not problems and not same_summary(read_parquet(path), summarise(stored)):
            problems.append(f"{path} does not follow from the runs; {anew}")
    except DamagedError as error:
        problems.append(f"{error}; {anew}")
    report(1.0)
    return result


def _row_problems(stored: Stored, path: Path, rows: pa.Table) -> Iterator[str]:
    """Yield what is wrong with the rows of a file."""
    case, sample = (rows.column(n).to_numpy().astype(np.int64) for n in ("case", "sample"))

    def told(wrong: Any, what: str) -> Iterator[str]:
        places = np.flatnonzero(wrong)
        if len(places):
            such = f"such as case {case[places[0]]} sample {sample[places[0]]}"
            yield f"{path}: {counted(len(places), 'run')}, {such}: {what}"

    yield from told(np.lexsort((sample, case)) != np.arange(len(case)), "its rows are not in order")
    again = with_types(rows, stored.thresholds)
    for name in {"type", "type_sure"}.intersection(rows.schema.names):
        theirs, ours = (table.column(name).to_numpy() for table in (rows, again))
        yield from told(theirs != ours, f"{name} does not follow from its columns")
    modes = theory.modes(*(floats(rows.column(n)) for n in ("alpha", "beta", "theta", "phi", "xi")))
    for name in ("omega_p", "omega_r", "K_p", "K_r"):
        theirs, ours = floats(rows.column(name)), getattr(modes, name)
        wrong = np.isfinite(ours) & ~np.isclose(theirs, ours, CLOSE, 0)
        yield from told(wrong, f"{name} does not follow from its body")
    late = floats(rows.column("t_r")) > floats(rows.column("t_end")) * (1 + 1e-12)
    yield from told(late, "t_r is later than t_end")


def _recompute(stored: Stored, rows: pa.Table, threads: int | None, result: Verified) -> None:
    """Integrate some runs again."""
    # Numba, without which the rest can be checked.
    from rattlesweep.sweeps.memory import differing_rows

    try:
        plan = stored.plan
    except ConfigError as error:
        if str(error) not in result.problems:
            result.problems.append(str(error))
        return
    # Runs that were given up under a smaller limit go on under a larger one.
    limit = stored.config.integrator.max_steps
    given_up = pc.and_(pc.equal(rows["status"], "step_limit"), pc.less(rows["n_steps"], limit))
    again = rows.filter(pc.invert(given_up))
    for case, sample, names in differing_rows(plan, again, threads):
        what = ", ".join(names[:4])
        result.problems.append(f"case {case} sample {sample} comes out differently: {what}")
    result.recomputed += len(again)
