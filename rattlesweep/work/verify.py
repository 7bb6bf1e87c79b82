"""Whether the contents of an output directory are correct."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.arrays import Flags, Floats
from rattlesweep.config.schema import Config
from rattlesweep.rows.arrow import floats
from rattlesweep.rows.types import with_types
from rattlesweep.store.decide import wanted_runs
from rattlesweep.store.parquet import read_parquet
from rattlesweep.store.progress import set_aside
from rattlesweep.store.rows import (
    IS_DAMAGED,
    SUMMARY,
    Found,
    Stored,
    keys_of,
    open_stored,
    same_bits,
)
from rattlesweep.store.summary import is_summary_right, summarise
from rattlesweep.system.console import counted
from rattlesweep.words.errors import ConfigError, as_lines

if TYPE_CHECKING:
    from rattlesweep.design.plan import Plan

MAX_SHOWN = 10  # problems that are printed


@dataclass
class Verified:
    """Result of :func:`verify`."""

    directory: Path
    runs: int = 0  # on disk
    files: int = 0
    missing: int = 0  # wanted runs that are not on disk
    wanted: int = 0
    recomputed: int = 0  # runs that were integrated again
    problems: list[str] = field(default_factory=list)  # a sentence each
    # Files that were damaged, and that a later session moved away and replaced.
    damaged: list[str] = field(default_factory=list)

    @property
    def words(self) -> str:
        """The result as lines of text."""
        lines = [f"{counted(self.runs, 'run')} in {counted(self.files, 'file')}"]
        if self.missing:
            lines.append(f"missing: {self.missing:,} of {counted(self.wanted, 'run')}")
        if self.recomputed:
            lines.append(f"{counted(self.recomputed, 'run')} computed again")
        if self.damaged:
            lines.append(f"damaged before: {set_aside(self.damaged)}")
        lines += [f"problem: {problem}" for problem in self.problems[:MAX_SHOWN]]
        hidden = len(self.problems) - MAX_SHOWN
        if hidden > 0:
            lines.append(f"and {counted(hidden, 'more problem')}")
        if self.problems:
            lines.append(counted(len(self.problems), "problem"))
        else:
            found = "no problem found"
            if self.missing:
                found += " in the runs that are there"
            lines.append(found)
        return as_lines(lines)


def verify(
    directory: Path,
    recompute: int = 0,
    seed: int = 0,
    threads: int | None = None,
    report: Callable[[float], None] = lambda share: None,
    complete: bool = False,
) -> Verified:
    """Check the files, rows and summary of a directory, and integrate some runs again.

    With `complete`, missing runs are a problem. They are none of a sweep under way.
    `recompute` is the number of these runs, and `seed` decides which they are. `report`
    is called with the share of the files that are done.
    """
    stored = open_stored(directory)

    def look(files: list[Path]) -> Verified:
        return _verified(stored, files, recompute, seed, threads, report, complete)

    # A session that begins may merge files: then all are looked at again.
    return stored.steadily(look)


def _verified(
    stored: Stored,
    files: list[Path],
    recompute: int,
    seed: int,
    threads: int | None,
    report: Callable[[float], None],
    complete: bool,
) -> Verified:
    """Check what the files contain; raise a GoneError if one is gone meanwhile."""
    on_disk = stored.find(files)
    thresholds = stored.thresholds
    wanted = wanted_runs(stored, on_disk)
    missing = int((wanted & ~on_disk.done).sum())
    damaged = [str(path) for path in stored.damaged_files()]
    result = Verified(
        stored.directory,
        on_disk.rows,
        len(files),
        missing,
        int(wanted.sum()),
        damaged=damaged,
    )
    problems = result.problems
    problems += _problems_of_files(stored, on_disk, missing)
    if complete and missing and not problems:
        problems.append(
            f"{missing:,} of {counted(result.wanted, 'run')} are missing; "
            "`rattlesweep run` does them"
        )
    plan = None
    if recompute:
        # This imports Numba, which the rest does without.
        from rattlesweep.store.manifest import stored_plan

        try:
            plan = stored_plan(stored)
        except ConfigError as error:  # the table of bodies is missing or has changed
            problems.append(str(error))
    # Every file that could be read is listed under the thresholds it was typed by.
    intact = [path for paths in on_disk.typed.values() for path in paths]
    count = min(recompute, on_disk.rows)
    chosen = np.random.default_rng(seed).choice(on_disk.rows, count, replace=False)
    # Runs are chosen by their place among the rows of all files, one after another.
    rows_before = 0
    for number, path in enumerate(intact):
        report(number / len(intact))
        rows = read_parquet(path)
        retyped = with_types(rows, thresholds)
        problems += _problems_of_rows(path, rows, retyped, stored.config)
        is_in_file = (chosen >= rows_before) & (chosen < rows_before + len(rows))
        places = np.sort(chosen[is_in_file]) - rows_before
        rows_before += len(rows)
        if len(places) and plan is not None:
            max_steps = stored.config.integrator.max_steps
            repeatable = _repeatable(rows.take(places), max_steps)
            for case, sample, names in differing_rows(plan, repeatable, threads):
                what = f"differs when computed again: {', '.join(names[:4])}"
                problems.append(f"case {case} sample {sample} {what}")
            result.recomputed += len(repeatable)
    # Wrong or missing rows make the summary differ too, which would say nothing new.
    if not problems and not missing and not is_summary_right(stored, summarise(stored)):
        what = "is missing, damaged or contradicts the runs"
        path = stored.directory / SUMMARY
        problems.append(f"{path} {what}; `rattlesweep run` writes it again")
    report(1.0)
    return result


def _problems_of_files(stored: Stored, on_disk: Found, missing: int) -> Iterator[str]:
    """Yield problems that show without the values of the rows."""
    for path in on_disk.damaged:
        yield IS_DAMAGED.format(path)
    thresholds = stored.thresholds.as_text
    for text, paths in on_disk.typed.items():
        if text != thresholds:
            yield (
                f"{counted(len(paths), 'file')}, such as {paths[0]}, typed by other "
                "thresholds; run `rattlesweep classify` to type all alike"
            )
    # The runs of damaged files are missing, but they have been named above.
    if on_disk.damaged:
        return
    # A sweep makes its folder first and its summary last, when all runs are there. So a
    # missing folder, or a summary beside missing runs, means that files were lost.
    path = stored.directory / SUMMARY
    if not stored.folder.is_dir():
        yield f"{stored.folder} is gone; `rattlesweep run` does its runs again"
    elif missing and path.exists():
        yield (
            f"{path} is of all runs, {counted(missing, 'run')} of them lost; "
            "`rattlesweep run` does them again"
        )


def _repeatable(rows: pa.Table, max_steps: int) -> pa.Table:
    """Leave out runs that ended at a smaller limit of steps, and would now go on."""
    ended_at_limit = pc.equal(rows["status"], "step_limit")
    would_go_on = pc.and_(ended_at_limit, pc.less(rows["n_steps"], max_steps))
    return rows.filter(pc.invert(would_go_on))


def _problems_of_rows(
    path: Path, rows: pa.Table, retyped: pa.Table, config: Config
) -> Iterator[str]:
    """Yield problems of a file's rows; `retyped` are the same rows, typed again."""
    case, sample = keys_of(rows)
    in_order = np.lexsort((sample, case)) == np.arange(len(case))
    # Each problem, and the rows that have it.
    wrong: dict[str, Flags] = {"its rows are not in order": ~in_order}
    for name in ("type", "type_sure"):
        if name in rows.schema.names:
            differs = rows.column(name).to_numpy() != retyped.column(name).to_numpy()
            wrong[f"{name} contradicts the columns it follows from"] = differs
    for column in rows.schema:
        if pa.types.is_floating(column.type):
            # A run without a value has null, so no value may be infinite or NaN.
            values = floats(rows.column(column.name).fill_null(0.0))
            is_infinite = ~np.isfinite(values)
            if is_infinite.any():
                wrong[f"{column.name} is not finite"] = is_infinite
    for name in ("t_r", "t_end"):
        wrong[f"{name} is negative"] = floats(rows[name]) < 0
    wrong["t_end contradicts t_r or the horizon"] = _wrong_ends(rows, config)
    for what, has_problem in wrong.items():
        if has_problem.any():
            first = np.flatnonzero(has_problem)[0]
            runs = counted(int(has_problem.sum()), "run")
            such = f"such as case {case[first]} sample {sample[first]}"
            yield f"{path}: {runs}, {such}: {what}"


def _wrong_ends(rows: pa.Table, config: Config) -> Flags:
    """Return which runs end at a time that is neither a reversal nor the horizon."""
    t_end = floats(rows["t_end"])
    t_r = floats(rows["t_r"])
    is_ok = rows["status"].to_numpy() == "ok"
    horizon = _horizons(rows, config)
    reverses = np.isfinite(t_r)
    is_at_horizon = (t_end == horizon) | np.isnan(horizon)  # NaN: cannot be checked
    if config.goes_on:
        # Runs go on after their reversals, the first of which is before the end.
        goes_on = np.ones(len(rows), bool)
        is_right = is_at_horizon & ~(t_r > t_end)
    else:
        # A reversal ends a run.
        goes_on = ~reverses
        is_right = np.where(reverses, t_end == t_r, is_at_horizon)
    # Such runs may end before the horizon: `early` ends those that are settled, and
    # friction those whose spin changes sign with hardly any energy left.
    if config.classify.early or config.acting:
        is_right |= goes_on & (t_end < horizon)
    return (t_end > horizon) | (is_ok & ~is_right)


def _horizons(rows: pa.Table, config: Config) -> Floats:
    """Return the horizons of runs, NaN where the rows and the config do not tell."""
    horizon = config.horizon
    # A row of a table may have a horizon of its own, and a horizon in seconds depends
    # on the size of the body.
    if config.bodies.source == "table" or config.settings["t_end"][0].si is not None:
        return np.full(len(rows), np.nan)
    sigma = None
    if horizon.t_decay is not None:
        sigma = floats(rows["sigma"])
    t_rgh = floats(rows["t_rgh"])
    return horizon.earliest(horizon.t, t_rgh, floats(rows["gamma"]), sigma)


def differing_rows(
    plan: Plan, rows: pa.Table, threads: int | None
) -> Iterator[tuple[int, int, list[str]]]:
    """Integrate stored runs again; yield case, sample and columns that differ."""
    from rattlesweep.work.block import prepare_runs, start_block

    case, sample = keys_of(rows)
    recomputed = start_block(plan, prepare_runs(plan, case, sample), threads).wait()
    rows = rows.select(plan.schema.names)
    # Almost always all are equal, and the slow search by row and column is not needed.
    if same_bits(recomputed, rows):
        return
    for place in range(len(rows)):
        stored_row = rows.slice(place, 1)
        recomputed_row = recomputed.slice(place, 1)
        names = []
        for name in rows.schema.names:
            stored_value = stored_row.select([name])
            recomputed_value = recomputed_row.select([name])
            if not same_bits(stored_value, recomputed_value):
                names.append(name)
        if names:
            yield int(case[place]), int(sample[place]), names
