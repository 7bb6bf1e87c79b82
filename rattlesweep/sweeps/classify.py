"""Type the stored runs of a directory again, by other thresholds and without
integrating.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.config.read import parse_config, resolved
from rattlesweep.sweeps.config.schema import Classify
from rattlesweep.sweeps.locks import hold
from rattlesweep.sweeps.parquet import read_parquet
from rattlesweep.sweeps.stored import Stored, open_stored, rewrite, typed_by
from rattlesweep.sweeps.summary import write_summary
from rattlesweep.sweeps.types import with_types


class Classified(NamedTuple):
    """Result of typing the runs of a directory again."""

    changed: int  # runs whose type has changed
    files: int  # files written
    now: dict[str, float]  # thresholds
    summary: pa.Table  # one row a case


def classify_stored(directory: Path, overrides: Sequence[str] = ()) -> Classified:
    """Type the stored runs by the config with overrides ``classify.KEY=VALUE``."""
    _thresholds(
        open_stored(directory), overrides
    )  # refuse before anything is created there
    with hold(directory):
        stored = open_stored(directory)
        thresholds, changed, files = _thresholds(stored, overrides), 0, 0
        for path in stored.files():
            if typed_by(path) != thresholds.as_text:
                rows = read_parquet(path)
                again = with_types(rows, thresholds)
                rewrite(path, again, thresholds.as_text)
                old, new = (
                    pc.fill_null(table.column("type"), "") for table in (rows, again)
                )
                changed += pc.sum(pc.not_equal(old, new)).as_py()
                files += 1
        return Classified(changed, files, thresholds.thresholds, write_summary(stored))


def _thresholds(stored: Stored, overrides: Sequence[str]) -> Classify:
    """Return the thresholds of the config with overrides; refuse what needs a new
    sweep.
    """
    config, own = parse_config(resolved(stored.config), list(overrides)), stored.config
    if config.model_copy(update={"classify": own.classify}) != own:
        raise ConfigError(
            "--set: only keys of classify can change here; others need a new sweep"
        )
    # With dissipation, t_r is stored only of zeros before the energy falls below
    # dead_energy.
    for key in ("early", *(["dead_energy"] if config.dissipation else [])):
        if getattr(config.classify, key) != getattr(own.classify, key):
            told = "decides more than types; it needs a new sweep"
            raise ConfigError(f"--set classify.{key}: {told}")
    return config.classify
