"""Type stored runs again, without integrating."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.config.load import override_config, resolved
from rattlesweep.sweeps.config.schema import Classify, Config
from rattlesweep.sweeps.summary import Summary
from rattlesweep.sweeps.old.blockfile import BlockFile
from rattlesweep.sweeps.old.locks import hold
from rattlesweep.sweeps.old.manifest import Classified, Manifest, Receipt
from rattlesweep.sweeps.provenance import now
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.old.stored import Stored, open_stored
from rattlesweep.sweeps.types import with_types


@dataclass(frozen=True)
class Retyped:
    """What typing a directory again came to."""

    changed: int  # runs
    blocks: int  # that were written
    before: dict[str, float]  # thresholds behind the types before
    own: dict[str, float]  # those of its sweep's config
    now: dict[str, float]
    summary: pa.Table


def retype_block(
    store: Store, index: int, file: BlockFile, thresholds: Classify
) -> tuple[Receipt, pa.Table]:
    """Give the runs of a block the types that these thresholds ask for; its file and rows now.

    The manifest is to have no receipt of it before.
    """
    rows = with_types(file.table(), thresholds)
    note = file.note and replace(file.note, classify=thresholds.thresholds)
    return store.write_block(index, rows, note), rows


def retype(directory: Path, overrides: Sequence[str] = ()) -> Retyped:
    """Type the runs of an output directory again and renew its summary.

    `overrides` are ``classify.KEY=VALUE`` texts over the directory's own thresholds.
    """
    stored = open_stored(directory)
    stored.refuse_stages("its types cannot change")
    _changed_config(stored, overrides)  # before anything is made there
    with hold(directory) as alone:
        stored = open_stored(directory)
        store, manifest = stored.store, stored.manifest
        config = _changed_config(stored, overrides)
        thresholds, before = config.classify.thresholds, stored.config.classify.thresholds
        own = manifest.classified.config if manifest.classified else before
        store.remove_stale_temporaries(alone)
        notes = {index: store.glance(index)[0] for index in stored.present()}
        old = {i for i, note in notes.items() if note is None or note.classify != thresholds}
        if old:
            store.update_manifest(lambda manifest: manifest.forget(old))
        changed = 0
        receipts: dict[int, Receipt] = {}
        summary = Summary(manifest.cases, store.runs)
        for index in notes:
            file, receipt = store.read_block(index), manifest.receipts.get(index)
            rows = file.table()
            if index in old:
                seconds = None if receipt is None else receipt.seconds
                receipt, typed = retype_block(store, index, file, config.classify)
                receipt = receipt.took(seconds)
                changed += _differing(rows.column("type"), typed.column("type"))
                rows = typed
            elif receipt is None and file.note and file.note.sweep == manifest.config_hash:
                receipt = file.receipt  # a killed process has typed it, and it has lost its own
            # What a stopped session has left of a block has no receipt, and does not count.
            if file.complete:
                if receipt is not None:
                    receipts[index] = receipt
                summary.add_table(rows)
        store.write_summary(summary.table())

        def change(manifest: Manifest) -> None:
            changed = Classified(config=own, now=thresholds, at=now())
            manifest.config, manifest.receipts = config, receipts
            manifest.classified = None if thresholds == own else changed

        store.update_manifest(change)
    return Retyped(changed, len(old), before, own, thresholds, summary.table())


def _changed_config(stored: Stored, overrides: Sequence[str]) -> Config:
    """The config of a directory with other thresholds."""
    for text in overrides:
        if not text.strip().startswith("classify."):
            raise ConfigError(
                f"--set {text}: only keys of classify can change without integrating, such as "
                "classify.sw_departure=0.1"
            )
    config = override_config(resolved(stored.config), overrides)
    if config.classify.early != stored.config.classify.early:
        raise ConfigError(
            "--set classify.early: it decides when runs end, which takes their integration; run "
            "the config again with it, into another directory"
        )
    return config


def _differing(before: pa.ChunkedArray, after: pa.ChunkedArray) -> int:
    changed = pc.not_equal(pc.fill_null(before, ""), pc.fill_null(after, ""))
    return int(pc.sum(changed).as_py() or 0)
