"""Type stored runs by other thresholds, without integrating them again."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.config.read import parse_config, resolved
from rattlesweep.config.schema import Classify
from rattlesweep.rows.types import with_types
from rattlesweep.store.locks import hold
from rattlesweep.store.merging import all_runs, find_merged
from rattlesweep.store.rows import Stored, open_stored, rewrite, typed_by
from rattlesweep.store.summary import write_summary
from rattlesweep.words.errors import ConfigError


class Classified(NamedTuple):
    """Result of typing the runs of a directory again."""

    changed: int  # runs whose type has changed
    files: int  # files written
    now: dict[str, float]  # thresholds
    summary: pa.Table  # one row a case


def classify_stored(directory: Path, overrides: Sequence[str] = ()) -> Classified:
    """Type the stored runs by the config with overrides ``classify.KEY=VALUE``."""
    # Refuse before anything is created there.
    _thresholds(open_stored(directory), overrides)
    with hold(directory):
        stored = open_stored(directory)
        thresholds = _thresholds(stored, overrides)
        find_merged(stored, all_runs)
        changed = 0
        files = 0
        for path in stored.files():
            if typed_by(path) != thresholds.as_text:
                rows = stored.rows_of(path)
                retyped = with_types(rows, thresholds)
                rewrite(path, retyped, thresholds.as_text)
                before = pc.fill_null(rows.column("type"), "")
                after = pc.fill_null(retyped.column("type"), "")
                changed += pc.sum(pc.not_equal(before, after)).as_py()
                files += 1
        return Classified(changed, files, thresholds.thresholds, write_summary(stored))


def _thresholds(stored: Stored, overrides: Sequence[str]) -> Classify:
    """Return the thresholds of the config with overrides; refuse other changes."""
    before = stored.config
    config = parse_config(resolved(before), list(overrides))
    if config.model_copy(update={"classify": before.classify}) != before:
        raise ConfigError(
            "--set: only keys of classify can change here; others need a new sweep"
        )
    decisive = ["early"]
    if config.dissipation:
        # Then t_r is stored only of zeros before the energy falls below this.
        decisive.append("dead_energy")
    for key in decisive:
        if getattr(config.classify, key) != getattr(before.classify, key):
            raise ConfigError(
                f"--set classify.{key}: decides more than types; it needs a new sweep"
            )
    return config.classify
