"""What is done with stored runs without integrating: merge directories, and type runs again."""

import contextlib
import filecmp
import os
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.columns import read_parquet
from rattlesweep.sweeps.config.read import parse_config, resolved
from rattlesweep.sweeps.config.schema import Classify
from rattlesweep.sweeps.files import explained, streamed_file
from rattlesweep.sweeps.plan import check_empty, check_same
from rattlesweep.sweeps.provenance import hold
from rattlesweep.sweeps.stored import MANIFEST, Stored, free_path, open_stored, rewrite, typed_by
from rattlesweep.sweeps.summary import summarise, write_summary
from rattlesweep.sweeps.types import with_types
from rattlesweep.sweeps.verify import wanted_runs


class Merged(NamedTuple):
    """What there is in the new directory."""

    runs: int
    files: int
    missing: int
    failed: int
    summary: pa.Table | None  # None if runs are missing


def merge(directories: Sequence[Path], output: Path) -> Merged:
    """Put the runs of directories of one sweep into another, which is new or of the same sweep."""
    if len({directory.resolve() for directory in (output, *directories)}) <= len(directories):
        raise ConfigError("a directory is given twice; give each once, and as --output another one")
    sources = [open_stored(directory) for directory in directories]
    if (output / MANIFEST).exists():
        sources.append(open_stored(output))
    else:
        check_empty(output)
    largest = max(sources, key=lambda stored: (len(stored.cases), stored.samples))
    for stored in sources:
        check_same(stored, largest)
    with contextlib.ExitStack() as stack:
        for directory in directories:
            if os.access(directory, os.W_OK):  # nobody works in one that is read-only
                stack.enter_context(hold(directory))
        merged = replace(largest, directory=output)
        with explained(f"cannot write in {output}"):
            output.mkdir(parents=True, exist_ok=True)
            stack.enter_context(hold(output))
            merged.folder.mkdir(exist_ok=True)
        # A merge that was killed has left some files there.
        new = [
            path for source in sources[: len(directories)] for path in source.files()
            if not ((twin := merged.folder / path.name).exists() and filecmp.cmp(path, twin, False))
        ]  # fmt: skip
        found = merged.find([*merged.files(), *new])
        if found.damaged:
            raise OutputError(f"{found.damaged[0]} is damaged; do its runs again before merging")
        if len(found.typed) > 1:
            told = "have types of different thresholds; run `rattlesweep classify`"
            raise ConfigError(f"{' and '.join(str(p[0]) for p in found.typed.values())} {told}")
        merged.write_manifest()
        for path in new:
            target = free_path(merged.folder / path.name)
            try:
                os.link(path, target)  # files are never changed in place
            except OSError:
                with open(path, "rb") as file, streamed_file(target) as copy:
                    shutil.copyfileobj(file, copy)
        missing = int((wanted_runs(merged, found) & ~found.done).sum())
        summary = None if missing else summarise(merged)
        if summary is not None:
            write_summary(merged, summary)
    failed = found.rows - found.status["ok"]
    return Merged(found.rows, len(merged.files()), missing, failed, summary)


class Classified(NamedTuple):
    """What typing the runs of a directory again came to."""

    changed: int  # runs whose type is another one now
    files: int  # files that were written
    now: dict[str, float]  # thresholds
    summary: pa.Table  # one row a case


def classify_stored(directory: Path, overrides: Sequence[str] = ()) -> Classified:
    """Type the stored runs anew, by ``classify.KEY=VALUE`` over the config, and the summary."""
    _changed(open_stored(directory), overrides)  # before anything is made there
    with hold(directory):
        stored = open_stored(directory)
        thresholds, changed, files = _changed(stored, overrides), 0, 0
        for path in stored.files():
            if typed_by(path) != thresholds.as_text:
                rows = read_parquet(path)
                again = with_types(rows, thresholds)
                rewrite(path, again, thresholds.as_text)
                old, new = (pc.fill_null(t.column("type"), "") for t in (rows, again))
                changed += pc.sum(pc.not_equal(old, new)).as_py()
                files += 1
        summary = summarise(stored)
        write_summary(stored, summary)
    return Classified(changed, files, thresholds.thresholds, summary)


def _changed(stored: Stored, overrides: Sequence[str]) -> Classify:
    config, own = parse_config(resolved(stored.config), list(overrides)), stored.config
    if config.model_copy(update={"classify": own.classify}) != own:
        raise ConfigError("--set: only keys of classify can change here; others need a new sweep")
    # A zero of the spin after the energy has fallen below dead_energy is not stored as t_r.
    for key in ("early", *(["dead_energy"] if config.dissipation else [])):
        if getattr(config.classify, key) != getattr(own.classify, key):
            told = "decides more than types; it needs a new sweep"
            raise ConfigError(f"--set classify.{key}: {told}")
    return config.classify
