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
from rattlesweep.sweeps.stored import MANIFEST, free_path, open_stored
from rattlesweep.sweeps.summary import write_summary


class Merged(NamedTuple):
    """Contents of the merged directory."""

    runs: int
    files: int
    missing: int
    failed: int
    summary: pa.Table | None  # None if runs are missing


def merge(directories: Sequence[Path], output: Path) -> Merged:
    """Copy the runs of directories of one sweep into another, which is new or of the
    same sweep.
    """
    if len({directory.resolve() for directory in (output, *directories)}) <= len(
        directories
    ):
        raise ConfigError(
            "a directory is given twice; give each once, and another as --output"
        )
    sources = [open_stored(directory) for directory in directories]
    if (output / MANIFEST).exists():
        sources.append(open_stored(output))
    else:
        check_empty(output)
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
        new = []
        for path in [path for stored in sources for path in stored.files()]:
            twin = (
                merged.folder / path.name
            )  # left by a merge that was killed, or the file itself
            if not (
                twin.exists()
                and (twin.samefile(path) or filecmp.cmp(path, twin, False))
            ):
                new.append(path)
        found = merged.find([*merged.files(), *new])
        if found.damaged:
            raise OutputError(
                f"{found.damaged[0]} is damaged; do its runs again before merging"
            )
        if len(found.typed) > 1:
            differing = " and ".join(str(paths[0]) for paths in found.typed.values())
            told = "have types of different thresholds; run `rattlesweep classify`"
            raise ConfigError(f"{differing} {told}")
        merged.write_manifest()
        for path in new:
            target = free_path(merged.folder / path.name)
            try:
                os.link(
                    path, target
                )  # links are safe as files are never changed in place
            except OSError:
                with open(path, "rb") as file, streamed_file(target) as copy:
                    shutil.copyfileobj(file, copy)
        missing = int((wanted_runs(merged, found) & ~found.done).sum())
        summary = None if missing else write_summary(merged)
    failed = found.rows - found.status["ok"]
    return Merged(found.rows, len(merged.files()), missing, failed, summary)
