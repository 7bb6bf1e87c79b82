"""Prove a directory: nothing damaged, missing or double, and numbers that can be had again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.arrays import Integers
from rattlesweep.errors import ConfigError, DamagedError, OutputError
from rattlesweep.sweeps.block import STATUS_WORDS
from rattlesweep.sweeps.memory import differing_rows
from rattlesweep.sweeps.summary import Summary, same_summary
from rattlesweep.sweeps.files import temporaries
from rattlesweep.sweeps.old.blockfile import BlockFile, numbers_of
from rattlesweep.sweeps.old.growth import FOLDER
from rattlesweep.sweeps.old.locks import holder
from rattlesweep.sweeps.old.manifest import count_failed
from rattlesweep.sweeps.old.stored import Stored, open_stored
from rattlesweep.sweeps.arrow import same_schema
from rattlesweep.sweeps.types import TYPES, with_types

_OK, _TYPE = pc.field("status") == "ok", pc.field("type")
# What a block must not have, and the rows that have it.
_BROKEN = {
    "words in status that mean nothing": ~pc.field("status").isin(STATUS_WORDS),
    "words in type that mean nothing": _TYPE.is_valid() & ~_TYPE.isin(TYPES),
    "types that are null though the status is ok, or the other way about": (
        _TYPE.is_valid() != _OK
    ),
    "reversal times that do not go with their types": (
        (_TYPE.is_valid() & (_TYPE == "R")) != (_OK & pc.field("t_r").is_valid())
    ),
    "runs that are ok but have no n_end or energy_drift": (
        _OK & (pc.field("n_end").is_null() | pc.field("energy_drift").is_null())
    ),
}


@dataclass
class Verdict:
    """What a look at everything came to."""

    problems: list[str] = field(default_factory=list)  # what is wrong, a sentence each
    blocks: int = 0  # in place and whole, with so many runs
    runs: int = 0
    # Spans, from and up to, of blocks not in place: a problem only if the sweep is said to be
    # complete; and runs of theirs in place, which a stopped session has left.
    missing: list[tuple[int, int]] = field(default_factory=list)
    begun: int = 0
    recomputed: int = 0  # runs integrated again
    remarks: list[str] = field(default_factory=list)  # what is not wrong, but worth knowing

    @property
    def absent(self) -> int:
        """Number of blocks not in place."""
        return sum(stop - first for first, stop in self.missing)


def verify(
    directory: Path,
    *,
    recompute: int = 0,
    seed: int | None = None,
    threads: int | None = None,
    report: Callable[[float], None] = lambda fraction: None,
) -> Verdict:
    """Check a directory from the first bit to the last; nothing is written.

    Checksums of files and pages; that every block is the one that was written and holds just its
    runs; schema; nulls, infinities and words where none belong; types against thresholds; the
    summary and the counts in the manifest against the runs.

    Parameters
    ----------
    recompute : int
        Number of random runs to integrate again and compare bit for bit, chosen by a `seed`, by
        default another one each time.
    report : callable
        Called with the fraction of the blocks that are done.
    """
    verdict = Verdict()
    try:
        stored = open_stored(directory)
    except DamagedError as error:
        verdict.problems.append(f"{error}; `rattlesweep run` recreates it")
        return verdict
    store, manifest = stored.store, stored.manifest
    at_work = holder(directory)
    if at_work is not None:
        verdict.remarks.append(f"{directory} is in use by {at_work}; blocks may come and go")
    summary = Summary(manifest.cases, store.runs)
    whole = _check_blocks(stored, verdict, summary, report)
    verdict.problems += [
        f"{path} is no block of this sweep, but readers will take it for one"
        for path in store.strays(manifest.blocks)
    ]
    left = [] if at_work else _left_behind(stored)
    verdict.problems += [
        f"{path} was left by a process that died; `rattlesweep run` removes it" for path in left[:1]
    ]
    complete = manifest.state == "complete"
    if verdict.missing and complete:
        verdict.problems.append(
            f"{store.runs}: {_listed(verdict.missing)} of a sweep that is said to be complete "
            "is missing"
        )
    if complete and not verdict.problems:
        staged = stored.staged
        if staged.done and [*map(len, staged.stages)] == (manifest.stages or []):
            verdict.problems += _check_summary(stored, summary.table())
        else:
            verdict.problems.append(
                f"{store.manifest_path} has other stages than the runs ask for; `rattlesweep run` "
                "goes on from there"
            )
    if recompute:
        verdict.problems += _check_numbers(stored, whole, recompute, seed, threads, verdict)
    return verdict


def _check_blocks(
    stored: Stored, verdict: Verdict, summary: Summary, report: Callable[[float], None]
) -> list[int]:
    """Check every block; the numbers of those without a fault, which are summed up."""
    manifest, present = stored.manifest, stored.present()
    schema = manifest.schema
    ends = [-1, *present, manifest.blocks]
    verdict.missing = [(a + 1, b) for a, b in pairwise(ends) if b > a + 1]
    whole = []
    for place, index in enumerate(present):
        report(place / len(present))
        try:
            file = stored.store.read_block(index)
            rows = file.table()
        except DamagedError as error:
            verdict.problems.append(str(error))
            continue
        if faults := [*_faults(index, file, rows, stored, schema)]:
            verdict.problems += [f"{file.path} {fault}" for fault in faults]
        elif not file.complete:
            verdict.missing.append((index, index + 1))
            verdict.begun += file.receipt.rows
        else:
            whole.append(index)
            summary.add_table(rows)
            verdict.blocks += 1
            verdict.runs += file.receipt.rows
    verdict.missing.sort()
    return whole


def _faults(
    index: int, file: BlockFile, rows: pa.Table, stored: Stored, schema: pa.Schema
) -> Iterator[str]:
    """What is wrong with a block, worst first."""
    manifest, wanted, note = stored.manifest, stored.note(index), file.note
    if note is None or note.runs != wanted.runs:
        yield "is a block of another sweep, or of another place in this one"
        return
    if not same_schema(file.schema, schema):
        yield "has other columns than its config asks for"
        return
    receipt = manifest.receipts.get(index)
    if receipt is not None and receipt.sha256 != file.receipt.sha256:
        yield "is not the file that the manifest has the checksum of"
    if receipt is None and file.complete and manifest.state == "complete":
        yield "has no checksum in the manifest"
    sample, samples = rows.column("sample").to_numpy(), manifest.samples
    numbers = numbers_of(rows, samples)
    all_runs = stored.numbers(index)
    # A stopped session leaves some of them, in their order.
    some = numbers if all_runs is None else all_runs[np.isin(all_runs, numbers)]
    if not np.array_equal(numbers, some) or not ((sample >= 0) & (sample < samples)).all():
        yield "has runs missing, double or out of order"
    yield from _bad_values(rows)
    if note.classify != wanted.classify:
        yield "has types of other thresholds; `rattlesweep classify` renews them"
        return
    names = [name for name in ("type", "type_sure") if name in rows.schema.names]
    if not with_types(rows, manifest.config.classify).select(names).equals(rows.select(names)):
        yield "has types that do not follow from its numbers"


def _bad_values(table: pa.Table) -> Iterator[str]:
    """Nulls, infinities and words where none belong."""
    for column_field in table.schema:
        column = table.column(column_field.name)
        if column.null_count and not column_field.nullable:
            yield f"has nulls in {column_field.name}"
        if pa.types.is_floating(column_field.type):
            values = column.drop_null()
            if len(values) and not pc.all(pc.is_finite(values)).as_py():
                yield f"has NaN or infinity in {column_field.name}"
    for words, broken in _BROKEN.items():
        if table.filter(broken).num_rows:
            yield f"has {words}"


def _left_behind(stored: Stored) -> list[Path]:
    """Files that processes which died have left half-written."""
    folders = (stored.directory, stored.store.runs)
    files = [path for folder in folders if folder.is_dir() for path in temporaries(folder)]
    grown = stored.directory / FOLDER
    return [grown, *files] if grown.exists() else files


def _check_summary(stored: Stored, made: pa.Table) -> Iterator[str]:
    store, manifest = stored.store, stored.manifest
    try:
        found = store.read_summary()
    except OutputError as error:
        yield f"{error}; `rattlesweep run` recreates it"
        return
    if found.schema.names != made.schema.names:
        # Of an earlier version, which gave Bondi's share in the unsteady direction too.
        common = [n for n in made.schema.names if n in found.schema.names and n != "fraction_bondi"]
        found, made = found.select(common), made.select(common)
    if not same_summary(found, made):
        yield f"{store.summary_path} does not follow from the runs; `rattlesweep run` recreates it"
    if count_failed(manifest.receipts.values()) != manifest.failed:
        yield f"{store.manifest_path} counts failed runs other than those there are"


def _check_numbers(
    stored: Stored,
    whole: list[int],
    count: int,
    seed: int | None,
    threads: int | None,
    verdict: Verdict,
) -> Iterator[str]:
    """Integrate random runs again."""
    try:
        stored.plan  # noqa: B018
    except ConfigError as error:
        yield f"no run can be integrated again: {error.messages[0]}"
        return
    chosen = _choose([stored.manifest.borders(index) for index in whole], count, seed)
    for case, sample, columns in differing_rows(stored, chosen, threads):
        yield (
            f"case {case}, sample {sample} comes out otherwise when integrated again, in "
            f"{', '.join(columns[:4])}{' and others' if len(columns) > 4 else ''}"
        )
    verdict.recomputed = len(chosen)


def _choose(spans: list[tuple[int, int]], count: int, seed: int | None) -> Integers:
    """So many numbers out of some spans of run numbers at random, ascending, each once."""
    if not spans:
        return np.zeros(0, dtype=np.int64)
    first, stop = np.array(spans, dtype=np.int64).T
    # Places in the spans laid end to end, of which there is no list: they may be a billion.
    ends = np.cumsum(stop - first)
    total = int(ends[-1])
    places = np.sort(np.random.default_rng(seed).choice(total, min(count, total), replace=False))
    span = np.searchsorted(ends, places, side="right")
    numbers: Integers = stop[span] - (ends[span] - places)
    return numbers


def _listed(spans: list[tuple[int, int]]) -> str:
    words = [str(a) if b == a + 1 else f"{a} to {b - 1}" for a, b in spans[:8]]
    one = len(spans) == 1 and spans[0][1] == spans[0][0] + 1
    more = " and others" if len(spans) > 8 else ""
    return f"block{'' if one else 's'} {', '.join(words)}{more}"
