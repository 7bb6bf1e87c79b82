"""Inspect an output directory: its progress, and whether its contents are correct."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError, DamagedError, OutputError
from rattlesweep.sweeps.columns import read_parquet
from rattlesweep.sweeps.decide import wanted_runs
from rattlesweep.sweeps.provenance import at_work, read_sessions, unfinished, who
from rattlesweep.sweeps.stored import SUMMARY, keys_of, open_stored
from rattlesweep.sweeps.summary import summarise
from rattlesweep.sweeps.types import with_types
from rattlesweep.text import counted

if TYPE_CHECKING:
    from rattlesweep.sweeps.plan import Plan

MAX_SHOWN = 10  # problems that are printed
DAMAGED = "{} is damaged; `rattlesweep run` does its runs again"


@dataclass(frozen=True)
class Status:
    """Progress of a sweep; :func:`status` defines the keys of `data`."""

    title: str
    data: dict[str, Any]

    @property
    def words(self) -> str:
        """The same as text."""
        data = self.data
        share, size = (
            data["runs"] / max(1, data["wanted"]),
            f"{data['bytes'] / 1e6:.1f} MB",
        )
        runs = f"{data['runs']:,} of {data['wanted']:,} runs ({100 * share:.1f} %)"
        lines = [f"{self.title}: {runs}, {counted(data['files'], 'file')}, {size}"]
        for what in [key for key in ("status", "types") if data[key]]:
            lines.append(
                f"{what}: {', '.join(f'{word} {n:,}' for word, n in data[what].items())}"
            )
        for session in data["at_work"]:
            lines.append(
                f"at work: {session['shard'] or 'the whole sweep'}, {who(session)}"
            )
        if not data["at_work"] and (last := data["last"]) is not None:
            how = "was killed" if last["how"] == "running" else f"ended: {last['how']}"
            lines.append(f"no process is at work; the last session, {who(last)}, {how}")
        return "\n".join(lines)


def status(directory: Path) -> Status:
    """Count the rows of an output directory, and list the sessions at work there."""
    stored = open_stored(directory)
    found, files = stored.find(), stored.files()
    if found.damaged:
        raise DamagedError(DAMAGED.format(found.damaged[0]))
    wanted = wanted_runs(stored, found)
    sessions, locks = read_sessions(directory), at_work(directory)
    working = [
        session for lock, session in unfinished(sessions).items() if lock in locks
    ]
    data = {
        "runs": found.rows,
        "wanted": int(wanted.sum()),
        "files": len(files),
        "bytes": sum(path.stat().st_size for path in files),
        "status": dict(found.status.most_common()),
        "types": dict(found.types.most_common()),
        "at_work": working,
        "last": next((s for s in reversed(sessions) if s not in working), None),
    }
    return Status(f"{stored.manifest['name']} in {directory}", data)


@dataclass
class Verified:
    """Result of :func:`verify`."""

    directory: Path
    runs: int = 0  # on disk
    files: int = 0
    missing: int = 0  # wanted runs that are not on disk
    recomputed: int = 0  # runs that were integrated again
    problems: list[str] = field(default_factory=list)  # a sentence each

    @property
    def words(self) -> str:
        """The same as text."""
        missing = (
            f", {counted(self.missing, 'run')} not done yet" if self.missing else ""
        )
        lines = [
            f"{counted(self.runs, 'run')} in {counted(self.files, 'file')}{missing}"
        ]
        if self.recomputed:
            lines.append(f"{counted(self.recomputed, 'run')} computed again")
        lines += [f"problem: {problem}" for problem in self.problems[:MAX_SHOWN]]
        if (more := len(self.problems) - MAX_SHOWN) > 0:
            lines.append(f"and {counted(more, 'more problem')}")
        found = (
            counted(len(self.problems), "problem")
            if self.problems
            else "no problem found"
        )
        return "\n".join([*lines, found])


def verify(
    directory: Path,
    recompute: int = 0,
    seed: int = 0,
    threads: int | None = None,
    report: Callable[[float], None] = lambda share: None,
) -> Verified:
    """Compare the files of a directory with its manifest; integrate `recompute` runs
    again.
    """
    stored = open_stored(directory)
    found, thresholds = stored.find(), stored.thresholds
    wanted, files = wanted_runs(stored, found), stored.files()
    result = Verified(
        directory, found.rows, len(files), int((wanted & ~found.done).sum())
    )
    problems = result.problems
    problems += map(DAMAGED.format, found.damaged)
    for text, paths in found.typed.items():
        if text != thresholds.as_text:
            told = "typed by other thresholds; run `rattlesweep classify` to type all alike"
            problems.append(
                f"{counted(len(paths), 'file')}, such as {paths[0]}, {told}"
            )
    plan = None
    if recompute:
        from rattlesweep.sweeps.plan import (
            stored_plan,
        )  # Numba, which the rest does without

        try:
            plan = stored_plan(stored)
        except ConfigError as error:  # the table of bodies is missing or has changed
            problems.append(str(error))
    good = [path for paths in found.typed.values() for path in paths]
    count, last = min(recompute, found.rows), 0
    chosen = np.random.default_rng(seed).choice(found.rows, count, replace=False)
    for number, path in enumerate(good):
        report(number / len(good))
        rows = read_parquet(path)
        problems += _row_problems(path, rows, with_types(rows, thresholds))
        first, last = last, last + len(rows)
        here = np.sort(chosen[(chosen >= first) & (chosen < last)]) - first
        if len(here) and plan is not None:
            again = rows.take(here)
            # Runs that stopped at a smaller limit of steps would now go on.
            less = pc.less(again["n_steps"], stored.config.integrator.max_steps)
            again = again.filter(
                pc.invert(pc.and_(pc.equal(again["status"], "step_limit"), less))
            )
            for case, sample, names in differing_rows(plan, again, threads):
                what = f"differs when computed again: {', '.join(names[:4])}"
                problems.append(f"case {case} sample {sample} {what}")
            result.recomputed += len(again)
    if not problems and not result.missing:
        path = directory / SUMMARY
        try:
            is_right = read_parquet(path).equals(summarise(stored))
        except OutputError:
            is_right = False
        if not is_right:
            told = "is missing, damaged or contradicts the runs"
            problems.append(f"{path} {told}; `rattlesweep run` writes it again")
    report(1.0)
    return result


def _row_problems(path: Path, rows: pa.Table, again: pa.Table) -> Iterator[str]:
    """Yield problems of the rows of a file; `again` are the rows, typed once more."""
    case, sample = keys_of(rows)
    wrong = {
        "its rows are not in order": np.lexsort((sample, case)) != np.arange(len(case))
    }
    for name in {"type", "type_sure"}.intersection(rows.schema.names):
        differ = rows.column(name).to_numpy() != again.column(name).to_numpy()
        wrong[f"{name} contradicts the columns it follows from"] = differ
    for what, which in wrong.items():
        if which.any():
            such = f"such as case {case[which][0]} sample {sample[which][0]}"
            yield f"{path}: {counted(int(which.sum()), 'run')}, {such}: {what}"


def differing_rows(
    plan: Plan, rows: pa.Table, threads: int | None = None
) -> Iterator[tuple[int, int, list[str]]]:
    """Integrate stored runs again; yield case, sample and columns of the rows that
    differ.
    """
    from rattlesweep.sweeps.block import prepare_runs, start_block

    case, sample = keys_of(rows)
    again = start_block(plan, prepare_runs(plan, case, sample), threads).wait()
    rows = rows.select(plan.schema.names)
    if same_bits(again, rows):
        return
    for k in range(len(rows)):
        one, other = again.slice(k, 1), rows.slice(k, 1)
        names = [
            n
            for n in rows.schema.names
            if not same_bits(one.select([n]), other.select([n]))
        ]
        if names:
            yield int(case[k]), int(sample[k]), names


def same_bits(one: pa.Table, other: pa.Table) -> bool:
    """Return whether two tables have the same values, and zeros of the same sign."""
    return one.schema.names == other.schema.names and all(
        a.equals(b) and _bits(a).equals(_bits(b))
        for a, b in zip(one.columns, other.columns, strict=True)
    )


def _bits(column: pa.ChunkedArray) -> pa.Array:
    values = column.combine_chunks()
    if pa.types.is_list(values.type):
        values = values.flatten()
    return values.view(pa.int64()) if pa.types.is_float64(values.type) else values
