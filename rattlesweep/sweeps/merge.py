"""Merge directories of one sweep: files go into one folder, for no run stands in two of them."""

from __future__ import annotations

import contextlib
import filecmp
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.read import differences, fixed_part, resolved
from rattlesweep.sweeps.decide import decision
from rattlesweep.sweeps.files import explained, streamed_file
from rattlesweep.sweeps.locks import hold
from rattlesweep.sweeps.rows import Runs
from rattlesweep.sweeps.stored import (
    MANIFEST,
    Stored,
    foreign_name,
    open_stored,
    write_manifest,
)
from rattlesweep.sweeps.summary import summarise, write_summary


@dataclass(frozen=True)
class Merged:
    """What a merge came to: runs and files in the new directory, runs that are missing or failed,
    and the summary if none is missing.
    """

    runs: int
    files: int
    missing: int
    failed: int
    summary: pa.Table | None


def merge(directories: Sequence[Path], output: Path) -> Merged:
    """Make one directory of several of the same sweep, such as its shards; the sources stay as they
    are.

    Parameters
    ----------
    directories : sequence of Path
    output : Path
        New or empty directory, or one of the same sweep, which then gets the rows of the others.

    Raises
    ------
    ConfigError
        If the directories hold different sweeps, or number their cases differently.
    OutputError
        If a run stands in two files, a file is damaged, or a directory is in use.
    """
    places = [directory.resolve() for directory in (output, *directories)]
    if len(set(places)) < len(places):
        raise ConfigError(
            "a directory is given twice; give each once, and as --output another one, whose own "
            "runs are kept"
        )
    sources = [open_stored(directory) for directory in directories]
    there = [open_stored(output)] if (output / MANIFEST).exists() else []
    everything = [*there, *sources]
    largest = max(everything, key=lambda stored: (len(stored.cases), stored.samples))
    for stored in everything:
        _check(stored, largest)
    if not there and (foreign_name(output) or Runs(output).files()):
        raise ConfigError(f"{output}: holds other files; give a new directory")
    with contextlib.ExitStack() as stack:
        for stored in sources:
            if os.access(stored.directory, os.W_OK):  # nobody works in one that is read-only
                stack.enter_context(hold(stored.directory))
        here = Runs(output)
        with explained(f"cannot write in {output}", folder=True):
            here.folder.mkdir(parents=True, exist_ok=True)
        stack.enter_context(hold(output))
        # A merge that was killed has left some files there.
        merged_before = {
            p for s in sources for p in s.files() if _is_there(p, here.folder / p.name)
        }
        done, failed = np.zeros((len(largest.cases), largest.samples), dtype=bool), 0
        for runs in (here, *(stored.runs for stored in sources)):
            found = runs.find(
                largest.cases, largest.samples, largest.hash, largest.schema, merged_before,
                put_aside=False,
            )  # fmt: skip
            if found.aside:
                raise OutputError(
                    f"{found.aside[0]} is damaged; do its runs again with `rattlesweep run` before "
                    "merging"
                )
            for typed, paths in found.typed.items():
                if typed != largest.typed:
                    raise OutputError(
                        f"{paths[0]} was typed by other thresholds; `rattlesweep classify` ends "
                        "what was begun"
                    )
            if (twice := done & found.done).any():
                case, sample = np.argwhere(twice)[0]
                raise OutputError(
                    f"{int(twice.sum())} runs, such as case {case} sample {sample}, stand in "
                    f"{runs.folder} and in another directory; give each shard once"
                )
            done |= found.done
            failed += found.rows - found.status["ok"]
        write_manifest(output, largest.manifest)
        for stored in sources:
            for path in stored.files():
                if path not in merged_before:
                    _put(path, here.free(path.stem))
        merged, wanted = open_stored(output), np.ones_like(done)
        if (decide := decision(merged.config, merged.cases, merged.samples)) is not None:
            decide.read(merged)
            wanted = decide.wanted()
        missing, summary = int((wanted & ~done).sum()), None
        if not missing:
            summary = summarise(merged)
            write_summary(merged, summary)
    return Merged(int(done.sum()), len(merged.files()), missing, failed, summary)


def _check(stored: Stored, largest: Stored) -> None:
    """Raise a ConfigError unless the runs of a directory belong to the largest sweep."""
    both = f"{stored.directory} and {largest.directory}"
    if stored.hash != largest.hash:
        ours, theirs = (fixed_part(resolved(s.config)) for s in (stored, largest))
        what = "; ".join(differences(ours, theirs)[:3]) or "the tables of bodies differ"
        raise ConfigError(f"{both} hold different sweeps ({what})")
    if [c.key for c in stored.cases] != [c.key for c in largest.cases[: len(stored.cases)]]:
        raise ConfigError(
            f"{both} number their cases differently, as they have grown in different ways; run the "
            "whole config in one of them instead"
        )
    if stored.thresholds != largest.thresholds:
        raise ConfigError(
            f"{both} have types of different thresholds; run `rattlesweep classify` with the same "
            "ones on both"
        )


def _is_there(path: Path, target: Path) -> bool:
    return target.exists() and filecmp.cmp(path, target, shallow=False)


def _put(path: Path, target: Path) -> None:
    """Link a file, or copy it whole where that cannot be done; files are never changed in place."""
    with contextlib.suppress(OSError):
        os.link(path, target)
        return
    with open(path, "rb") as file, streamed_file(target) as copy:
        shutil.copyfileobj(file, copy)
