"""Merge the directories of one sweep, such as those of its shards."""

import contextlib
import filecmp
import os
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, NamedTuple

import pyarrow as pa

from rattlesweep.store.copies import Copies
from rattlesweep.store.decide import wanted_runs
from rattlesweep.store.locks import hold
from rattlesweep.store.manifest import check_empty, check_same
from rattlesweep.store.rows import (
    MANIFEST,
    Stored,
    free_path,
    open_stored,
)
from rattlesweep.store.summary import write_summary
from rattlesweep.system.console import counted
from rattlesweep.system.files import (
    explained,
    move,
    open_regular,
    staged_name,
    streamed_file,
)
from rattlesweep.words.errors import ConfigError, OutputError

FICLONE = 0x40049409  # the request of Linux by which two files share their blocks


class Merged(NamedTuple):
    """Contents of the merged directory."""

    runs: int
    files: int
    missing: int
    failed: int
    summary: pa.Table | None  # None if runs are missing


def merge(directories: Sequence[Path], output: Path, link: bool = False) -> Merged:
    """Copy the runs of directories of one sweep into `output`.

    That is a new directory, or one that has runs of the same sweep. With `link`, its
    files are hard links to those of the directories, where the system can make them.
    """
    sources = _sources(directories, output)
    largest = max(sources, key=lambda stored: stored.shape)
    for stored in sources:
        check_same(stored, largest)
        _check_part(stored, largest)
    with contextlib.ExitStack() as stack:
        for directory in directories:
            if os.access(directory, os.W_OK):  # a read-only directory has no writers
                stack.enter_context(hold(directory))
        if output.exists():
            stack.enter_context(hold(output))
        merged = replace(largest, directory=output)
        new = _new_files(sources, merged)
        copies = Copies(merged)
        on_disk = merged.find([*copies.files, *new], copies.see, copies.note)
        if on_disk.damaged:
            raise OutputError(
                f"{on_disk.damaged[0]} is damaged; do its runs again before merging"
            )
        if len(on_disk.typed) > 1:
            differing = " and ".join(str(paths[0]) for paths in on_disk.typed.values())
            raise ConfigError(
                f"{differing} have types of different thresholds; run `rattlesweep "
                "classify`"
            )
        for path in copies.partial:
            copies.check(path)
        # What is refused leaves nothing behind, so a new directory is made only now.
        with explained(f"cannot write in {output}"):
            if not output.exists():
                output.mkdir(parents=True)
                stack.enter_context(hold(output))
            merged.folder.mkdir(exist_ok=True)
        merged.write_manifest()
        for path in new:
            if path in copies.partial:
                copies.add_rest(path)
            else:
                _add(path, merged, link)
        missing = int((wanted_runs(merged, on_disk) & ~on_disk.done).sum())
        summary = None if missing else write_summary(merged)
    failed = on_disk.rows - on_disk.status["ok"]
    return Merged(on_disk.rows, len(merged.files()), missing, failed, summary)


def _sources(directories: Sequence[Path], output: Path) -> list[Stored]:
    """Return the sweeps to merge, with that of `output` if it has one."""
    distinct = {directory.resolve() for directory in (output, *directories)}
    if len(distinct) <= len(directories):
        raise ConfigError(
            "a directory is given twice; give each once, and another as --output"
        )
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


def _check_part(stored: Stored, largest: Stored) -> None:
    """Raise an OutputError if a sweep is no part of the largest one."""
    how = None
    for case, other in zip(stored.cases, largest.cases, strict=False):
        if case != other:
            how = (
                f"numbers its cases differently than {largest.directory} (case "
                f"{case.index} is {case} there and {other} here)"
            )
            break
    if how is None and stored.samples > largest.samples:
        how = (
            f"has {stored.samples} samples of {counted(len(stored.cases), 'case')}, "
            f"and {largest.directory} {largest.samples} of "
            f"{counted(len(largest.cases), 'case')}"
        )
    if how is not None:
        raise OutputError(
            f"{stored.directory} {how}: these are two sweeps; merge directories that "
            "were run by one config"
        )


def _add(path: Path, merged: Stored, link: bool) -> None:
    """Add a file to the merged directory."""
    target = free_path(merged.folder / path.name)
    if link:
        staged = staged_name(target, merged.directory)
        with contextlib.suppress(OSError):
            # A link to a link would end with it.
            os.link(path.resolve(), staged)
            with explained(f"cannot write {target}"):
                move(staged, target)
            return
    staging = merged.directory
    with open_regular(path) as file, streamed_file(target, staging, new=True) as copy:
        if not _share(file, copy):
            shutil.copyfileobj(file, copy)


def _share(file: BinaryIO, copy: BinaryIO) -> bool:
    """Let a copy share the blocks of a file on disk until one of them changes.

    Return whether the file system can.
    """
    if sys.platform != "linux":
        return False
    import fcntl

    try:
        fcntl.ioctl(copy.fileno(), FICLONE, file.fileno())
    except OSError:
        return False
    return True
