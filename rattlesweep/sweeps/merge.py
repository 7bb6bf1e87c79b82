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
from rattlesweep.sweeps.decide import decision
from rattlesweep.sweeps.files import explained, streamed_file
from rattlesweep.sweeps.provenance import hold
from rattlesweep.sweeps.rows import Runs, free_path
from rattlesweep.sweeps.stored import (
    MANIFEST,
    check_empty,
    differing_keys,
    open_stored,
    write_manifest,
)
from rattlesweep.sweeps.summary import summarise, write_summary


@dataclass(frozen=True)
class Merged:
    """What there is in the new directory."""

    runs: int
    files: int
    missing: int
    failed: int
    summary: pa.Table | None  # None if runs are missing


def merge(directories: Sequence[Path], output: Path) -> Merged:
    """Put the runs of several directories of one sweep, such as its shards, into another.

    The output is new or empty, or of the same sweep.  The sources stay as they are.
    """
    if len({directory.resolve() for directory in (output, *directories)}) <= len(directories):
        raise ConfigError("a directory is given twice; give each once, and as --output another one")
    sources = [open_stored(directory) for directory in directories]
    if (output / MANIFEST).exists():
        sources.append(open_stored(output))
    else:
        check_empty(output)
    largest = max(sources, key=lambda stored: (len(stored.cases), stored.samples))
    for stored in sources:
        both = f"{stored.directory} and {largest.directory}"
        if stored.hash != largest.hash:
            what = differing_keys(stored.config, largest.config)
            raise ConfigError(f"{both} hold different sweeps ({what})")
        if [c.key for c in stored.cases] != [c.key for c in largest.cases[: len(stored.cases)]]:
            raise ConfigError(f"{both} number their cases differently; run the whole config in one")
    with contextlib.ExitStack() as stack:
        for directory in directories:
            if os.access(directory, os.W_OK):  # nobody works in one that is read-only
                stack.enter_context(hold(directory))
        here = Runs(output)
        with explained(f"cannot write in {output}"):
            output.mkdir(parents=True, exist_ok=True)
            stack.enter_context(hold(output))
            here.folder.mkdir(exist_ok=True)
        # A merge that was killed has left some files there.
        new = [
            path for directory in directories for path in Runs(directory).files()
            if not ((twin := here.folder / path.name).exists() and filecmp.cmp(path, twin, False))
        ]  # fmt: skip
        files = [*here.files(), *new]
        found = here.find(largest.cases, largest.samples, largest.hash, largest.schema, files)
        if found.damaged:
            raise OutputError(f"{found.damaged[0]} is damaged; do its runs again before merging")
        if len(found.typed) > 1:
            several = " and ".join(str(paths[0]) for paths in found.typed.values())
            raise ConfigError(
                f"{several} have types of different thresholds; run `rattlesweep classify`"
            )
        write_manifest(output, largest.manifest)
        for path in new:
            _put(path, free_path(here.folder / path.name))
        merged, wanted = open_stored(output), np.ones_like(found.done)
        if (decide := decision(merged.config, merged.cases, merged.samples)) is not None:
            decide.read(merged)
            wanted = decide.wanted()
        missing = int((wanted & ~found.done).sum())
        summary = None if missing else summarise(merged)
        if summary is not None:
            write_summary(merged, summary)
    failed = found.rows - found.status["ok"]
    return Merged(found.rows, len(merged.files()), missing, failed, summary)


def _put(path: Path, target: Path) -> None:
    """Link a file, or copy it whole where that cannot be done; files are never changed in place."""
    try:
        os.link(path, target)
    except OSError:
        with open(path, "rb") as file, streamed_file(target) as copy:
            shutil.copyfileobj(file, copy)
