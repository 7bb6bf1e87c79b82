"""Merge the directories of one sweep, such as those of its shards."""

import contextlib
import filecmp
import os
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.decide import wanted_runs
from rattlesweep.sweeps.files import explained, streamed_file
from rattlesweep.sweeps.locks import hold
from rattlesweep.sweeps.plan import check_empty, check_same
from rattlesweep.sweeps.stored import MANIFEST, Stored, free_path, open_stored
from rattlesweep.sweeps.summary import write_summary


class Merged(NamedTuple):
    """Contents of the merged directory."""

    runs: int
    files: int
    missing: int
    failed: int
    summary: pa.Table | None  # None if runs are missing


def merge(directories: Sequence[Path], output: Path) -> Merged:
    """Copy the runs of directories of one sweep into `output`.

    That is a new directory, or one that has runs of the same sweep.
    """
    sources = _sources(directories, output)
    largest = max(sources, key=lambda stored: stored.shape)
    for stored in sources:
        check_same(stored, largest)
    with contextlib.ExitStack() as stack:
        for directory in directories:
            if os.access(directory, os.W_OK):  # a read-only directory has no writers
                stack.enter_context(hold(directory))
        merged = replace(largest, directory=output)
        with explained(f"cannot write in {output}"):
            output.mkdir(parents=True, exist_ok=True)
            stack.enter_context(hold(output))
            merged.folder.mkdir(exist_ok=True)
        new = _new_files(sources, merged)
        on_disk = merged.find([*merged.files(), *new])
        if on_disk.damaged:
            advice = "do its runs again before merging"
            raise OutputError(f"{on_disk.damaged[0]} is damaged; {advice}")
        if len(on_disk.typed) > 1:
            differing = " and ".join(str(paths[0]) for paths in on_disk.typed.values())
            problem = "have types of different thresholds"
            raise ConfigError(f"{differing} {problem}; run `rattlesweep classify`")
        merged.write_manifest()
        for path in new:
            _link_or_copy(path, merged)
        missing = int((wanted_runs(merged, on_disk) & ~on_disk.done).sum())
        summary = None if missing else write_summary(merged)
    failed = on_disk.rows - on_disk.status["ok"]
    return Merged(on_disk.rows, len(merged.files()), missing, failed, summary)


def _sources(directories: Sequence[Path], output: Path) -> list[Stored]:
    """Return the sweeps to merge, with that of `output` if it has one."""
    distinct = {directory.resolve() for directory in (output, *directories)}
    if len(distinct) <= len(directories):
        advice = "give each once, and another as --output"
        raise ConfigError(f"a directory is given twice; {advice}")
    sources = [open_stored(directory) for directory in directories]
    if (output / MANIFEST).exists():
        sources.append(open_stored(output))
    else:
        check_empty(output)
    return sources


def _new_files(sources: Sequence[Stored], merged: Stored) -> list[Path]:
    """Return the files of rows that the merged directory does not have."""
    new = []
    for stored in sources:
        for path in stored.files():
            # The file itself, or one that was left by a merge that was killed.
            twin = merged.folder / path.name
            is_there = twin.exists() and (
                twin.samefile(path) or filecmp.cmp(path, twin, shallow=False)
            )
            if not is_there:
                new.append(path)
    return new


def _link_or_copy(path: Path, merged: Stored) -> None:
    """Add a file to the merged directory."""
    target = free_path(merged.folder / path.name)
    try:
        # Links are safe, as files are never changed in place.
        os.link(path, target)
    except OSError:
        with open(path, "rb") as file, streamed_file(target, merged.directory) as copy:
            shutil.copyfileobj(file, copy)
