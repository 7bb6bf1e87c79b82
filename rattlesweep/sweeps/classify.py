"""Type stored runs again by other thresholds, without integrating."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.config.read import parse_config, resolved
from rattlesweep.sweeps.config.schema import Classify
from rattlesweep.sweeps.provenance import hold
from rattlesweep.sweeps.rows import TYPED
from rattlesweep.sweeps.stored import Stored, open_stored
from rattlesweep.sweeps.summary import summarise, write_summary
from rattlesweep.sweeps.types import with_types


@dataclass(frozen=True)
class Classified:
    """What typing the runs of a directory again came to."""

    changed: int  # runs whose type is another one now
    files: int  # files that were written
    before: dict[str, float]  # thresholds behind the types before
    own: dict[str, float]  # thresholds of the sweep's config
    now: dict[str, float]
    summary: pa.Table  # one row a case


def classify_stored(directory: Path, overrides: Sequence[str] = ()) -> Classified:
    """Type the stored runs of a directory by some thresholds, and renew the summary.

    `overrides` are ``classify.KEY=VALUE`` texts over the sweep's config.  Each file is rewritten in
    one step; after a kill the same command goes on.
    """
    _changed(open_stored(directory), overrides)  # before anything is made there
    with hold(directory):
        stored = open_stored(directory)
        own, thresholds = stored.config.classify, _changed(stored, overrides)
        before, changed, files = stored.thresholds.thresholds, 0, 0
        for path in stored.files():
            if stored.runs.metadata(path).get(TYPED) != thresholds.as_text:
                rows = stored.runs.table(path)
                again = with_types(rows, thresholds)
                stored.runs.rewrite(path, again, thresholds.as_text)
                old, new = (pc.fill_null(t.column("type"), "") for t in (rows, again))
                changed += pc.sum(pc.not_equal(old, new)).as_py()
                files += 1
        summary = summarise(stored)
        write_summary(stored, summary)
    return Classified(changed, files, before, own.thresholds, thresholds.thresholds, summary)


def _changed(stored: Stored, overrides: Sequence[str]) -> Classify:
    """Return other thresholds for a sweep."""
    config, own = parse_config(resolved(stored.config), list(overrides)), stored.config
    if config.model_copy(update={"classify": own.classify}) != own:
        raise ConfigError("--set: only keys of classify can change here; others need a new sweep")
    # A zero of the spin after the energy has fallen below dead_energy is not stored as t_r.
    for key in ("early", *(["dead_energy"] if config.dissipation else [])):
        if getattr(config.classify, key) != getattr(own.classify, key):
            raise ConfigError(
                f"--set classify.{key}: decides more than types; it needs a new sweep"
            )
    return config.classify
