"""Type stored runs again by other thresholds, without integrating."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.config.read import override_config, resolved
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.locks import hold
from rattlesweep.sweeps.stored import Stored, note_thresholds, open_stored
from rattlesweep.sweeps.summary import summarise, write_summary
from rattlesweep.sweeps.types import with_types


@dataclass(frozen=True)
class Classified:
    """What typing the runs of a directory again came to.

    Attributes
    ----------
    changed : int
        Runs whose type is another one now.
    files : int
        Files that were written.
    before, own, now : dict
        Thresholds behind the types before, those of the sweep's config, and those now.
    summary : pa.Table
        One row a case.
    """

    changed: int
    files: int
    before: dict[str, float]
    own: dict[str, float]
    now: dict[str, float]
    summary: pa.Table


def classify_stored(directory: Path, overrides: Sequence[str] = ()) -> Classified:
    """Type the stored runs of a directory by some thresholds, and renew the summary.

    Each file is rewritten in one step; after a kill the same command goes on.

    Parameters
    ----------
    directory : Path
    overrides : sequence of str
        ``classify.KEY=VALUE`` texts over the thresholds of the sweep's config.

    Raises
    ------
    ConfigError
        If the directory is no output directory, or something else than a threshold is to change.
    OutputError
        If another process works there, or a file cannot be read or written.
    """
    _changed(open_stored(directory), overrides)  # before anything is made there
    with hold(directory):
        stored = open_stored(directory)
        runs, thresholds = stored.runs, _changed(stored, overrides).classify
        changed = files = 0
        for path in runs.files():
            if runs.typed(path) != thresholds.as_text:
                rows = runs.table(path)
                again = with_types(rows, thresholds)
                runs.rewrite(path, again, thresholds.as_text)
                old, new = (pc.fill_null(t.column("type"), "") for t in (rows, again))
                changed += pc.sum(pc.not_equal(old, new)).as_py()
                files += 1
        own, before = stored.config.classify.thresholds, stored.thresholds.thresholds
        now = thresholds.thresholds
        note_thresholds(stored, None if now == own else thresholds)
        summary = summarise(stored)
        write_summary(stored, summary)
    return Classified(changed, files, before, own, now, summary)


def _changed(stored: Stored, overrides: Sequence[str]) -> Config:
    """Return the sweep's config with other thresholds."""
    config, own = override_config(resolved(stored.config), list(overrides)), stored.config
    if config.model_copy(update={"classify": own.classify}) != own:
        raise ConfigError("--set: only keys of classify can change here; others need a new sweep")
    if config.classify.early != own.classify.early:
        raise ConfigError("--set classify.early: decides how far runs go; it needs a new sweep")
    # A zero of the spin after the energy has fallen below it is not stored as t_r.
    if config.dissipation and config.classify.dead_energy != own.classify.dead_energy:
        raise ConfigError(
            "--set classify.dead_energy: decides which zeros of the spin are reversals; with "
            "dissipation it needs a new sweep"
        )
    return config
