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
AT_ONCE = 10_000
TOLD = 10


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
    problems : list of str
        What is wrong, a sentence each.
    notes : list of str
        What is worth knowing and no problem.
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
        if len(self.problems) > TOLD:
            lines.append(f"and {len(self.problems) - TOLD} more problems")
        lines.append(
            "no problem found" if not self.problems else counted(len(self.problems), "problem")
        )
        return "\n".join(lines)


def verify(
    directory: Path,
    recompute: int = 0,
    seed: int = 0,
    threads: int | None = None,
    report: Callable[[float], None] = lambda share: None,
) -> Verified:
    """Read all of an output directory and compare it with what its manifest says; nothing is
    changed.

    Parameters
    ----------
    directory : Path
    recompute : int
        Number of runs, drawn at random, that are integrated again and compared bit by bit.
    seed : int
        Seed of that draw.
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
    found = stored.runs.find(
        stored.cases, stored.samples, stored.hash, stored.schema, put_aside=False
    )
    result.runs = found.rows
    result.problems += [
        f"{path} is damaged; `rattlesweep run` does its runs again" for path in found.aside
    ]
    _check_keys(stored, found, result)
    good = [path for paths in found.typed.values() for path in paths]
    for number, path in enumerate(good):
        report(0.5 * number / len(good))
        result.problems += _row_problems(stored, path)
    _check_summary(stored, result)
    if recompute:
        _recompute(stored, good, recompute, seed, threads, result, report)
    report(1.0)
    return result


def _check_keys(stored: Stored, found: Found, result: Verified) -> None:
    decide = decision(stored.config, stored.cases, stored.samples)
    if decide is None:
        result.missing = found.done.size - found.rows
    elif not found.aside:
        decide.read(stored)
        result.missing = int((decide.wanted() & ~found.done).sum())
    typed = stored.typed
    for text, paths in found.typed.items():
        if text != typed:
            result.problems.append(
                f"{paths[0]}{f' and {len(paths) - 1} more files' if len(paths) > 1 else ''} were "
                "typed by other thresholds; `rattlesweep classify` ends what was begun"
            )


def _row_problems(stored: Stored, path: Path) -> Iterator[str]:
    """Yield what is wrong with the rows of a file."""
    rows = stored.runs.table(path)

    def told(wrong: Any, what: str) -> Iterator[str]:
        places = np.flatnonzero(wrong)
        if len(places):
            case, sample = (rows.column(n)[int(places[0])].as_py() for n in ("case", "sample"))
            yield f"{path}: {len(places)} runs, such as case {case} sample {sample}: {what}"

    case, sample = (rows.column(n).to_numpy().astype(np.int64) for n in ("case", "sample"))
    later = (case[1:] > case[:-1]) | ((case[1:] == case[:-1]) & (sample[1:] > sample[:-1]))
    yield from told(np.append(True, ~later)[1:], "its rows are not in order")
    for name, kind in zip(rows.schema.names, rows.schema.types, strict=True):
        if pa.types.is_floating(kind):
            values = pc.drop_null(rows.column(name)).to_numpy()
            if not np.isfinite(values).all():
                yield f"{path}: {name} holds a number that is not finite"
    again = with_types(rows, stored.thresholds)
    for name in ("type", "type_sure"):
        if name in rows.schema.names:
            same = pc.equal(rows.column(name), again.column(name)).fill_null(False)
            both = pc.and_(rows.column(name).is_null(), again.column(name).is_null())
            wrong = ~pc.or_(same, both).to_numpy()
            yield from told(wrong, f"{name} does not follow from its columns")
    bodies = {n: floats(rows.column(n)) for n in ("alpha", "beta", "theta", "phi", "xi")}
    modes = theory.modes(**bodies)
    for name in ("omega_p", "omega_r", "K_p", "K_r"):
        theirs, ours = floats(rows.column(name)), getattr(modes, name)
        ours = np.where(np.isfinite(ours), ours, np.nan)
        wrong = ~np.isclose(theirs, ours, CLOSE, 0, equal_nan=True)
        yield from told(wrong, f"{name} does not follow from its body")
    t_r, t_end = floats(rows.column("t_r")), floats(rows.column("t_end"))
    yield from told(t_r > t_end * (1 + 1e-12), "t_r is later than t_end")


def _check_summary(stored: Stored, result: Verified) -> None:
    path = stored.directory / SUMMARY
    if not path.exists():
        if not result.missing and not result.problems:
            result.problems.append(f"{path} is missing; `rattlesweep run` writes it")
        return
    try:
        theirs = read_parquet(path)
    except DamagedError as error:
        result.problems.append(f"{error}; `rattlesweep run` writes it anew")
        return
    if not result.problems and not same_summary(theirs, summarise(stored)):
        result.problems.append(
            f"{path} does not follow from the runs; `rattlesweep run` writes it anew"
        )


def _recompute(
    stored: Stored,
    files: list[Path],
    count: int,
    seed: int,
    threads: int | None,
    result: Verified,
    report: Callable[[float], None],
) -> None:
    # Numba, without which the rest can be checked.
    from rattlesweep.sweeps.memory import differing_rows

    theirs = stored.manifest["versions"]
    ours = versions()
    other = [f"{n} {theirs.get(n)} then, {v} now" for n, v in ours.items() if theirs.get(n) != v]
    if other:
        result.notes.append(f"last bits may differ: {'; '.join(other)}")
    sizes = [len(stored.runs.table(path, ["case"])) for path in files]
    chosen = np.random.default_rng(seed).choice(
        sum(sizes), min(count, sum(sizes)), replace=False, shuffle=False
    )
    chosen.sort()
    try:
        plan = stored.plan
    except ConfigError as error:
        result.problems.append(str(error))
        return
    first = 0
    for path, size in zip(files, sizes, strict=True):
        here = chosen[(chosen >= first) & (chosen < first + size)] - first
        first += size
        if len(here):
            rows = stored.runs.table(path).take(pa.array(here))
            for start in range(0, len(rows), AT_ONCE):
                part = rows.slice(start, AT_ONCE)
                for case, sample, names in differing_rows(plan, part, threads):
                    result.problems.append(
                        f"case {case} sample {sample} comes out differently: {', '.join(names[:4])}"
                    )
            result.recomputed += len(here)
            report(0.5 + 0.5 * result.recomputed / len(chosen))
