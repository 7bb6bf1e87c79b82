"""Type stored runs again, without integrating."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.load import override_config, resolved
from rattlesweep.sweeps.inspect.summary import Summary
from rattlesweep.sweeps.store.locks import hold
from rattlesweep.sweeps.store.manifest import Classified, Manifest, Receipt
from rattlesweep.sweeps.store.provenance import now
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.store.stored import Stored, open_stored
from rattlesweep.sweeps.tables.arrow import DamagedError
from rattlesweep.sweeps.tables.types import with_types

if TYPE_CHECKING:
    from rattlesweep.sweeps.config.schema import Classify, Config
    from rattlesweep.sweeps.store.blockfile import BlockFile


class _Noting(Protocol):
    """What keeps the receipts of blocks that are replaced."""

    def forget(self, indices: list[int]) -> None:
        """Drop receipts, before."""

    def wrote(self, index: int, receipt: Receipt) -> object:
        """Keep a receipt, after."""


def retype_blocks(
    store: Store, indices: Sequence[int], thresholds: Classify, noting: _Noting
) -> None:
    """Give the runs of some blocks the types that these thresholds ask for.

    Parameters
    ----------
    store : Store
        Its blocks are replaced, one by one and each in one step.
    indices : sequence of int
    thresholds : Classify
    noting
        Hears which blocks are replaced.
    """
    noting.forget(list(indices))
    for index in indices:
        file = _inspect(store, index)
        rows = with_types(file.table(), thresholds)
        noting.wrote(index, _rewrite(store, index, file, rows, thresholds))


def _rewrite(
    store: Store, index: int, file: BlockFile, rows: pa.Table, thresholds: Classify
) -> Receipt:
    note = file.note and replace(file.note, classify=thresholds.model_dump())
    return store.rewrite_block(index, rows, note)


@dataclass(frozen=True)
class Retyped:
    """What a directory was typed by again.

    Attributes
    ----------
    changed : int
        Runs whose type has changed.
    blocks : int
        Blocks that were written.
    before, own, now : dict
        Thresholds behind the types before, those of the config of its sweep, and those of now.
    summary : pa.Table
        One row a case.
    """

    changed: int
    blocks: int
    before: dict[str, float]
    own: dict[str, float]
    now: dict[str, float]
    summary: pa.Table


def retype(directory: Path, overrides: Sequence[str] = ()) -> Retyped:
    """Type the runs of an output directory again and renew its summary.

    Parameters
    ----------
    directory : Path
    overrides : sequence of str
        ``classify.KEY=VALUE`` texts over the directory's own thresholds.

    Returns
    -------
    Retyped

    Raises
    ------
    ConfigError
        If this is no output directory, or an override is not of ``classify``.
    OutputError
        If a file is damaged or cannot be written, or another process works there.
    """
    _changed_config(open_stored(directory), overrides)  # before anything is made there
    with hold(directory) as alone:
        stored = open_stored(directory)
        store, manifest = stored.store, stored.manifest
        config = _changed_config(stored, overrides)
        thresholds, before = resolved(config)["classify"], resolved(stored.config)["classify"]
        own = manifest.classified.config if manifest.classified else before
        store.remove_stale_temporaries(alone)
        indices = [index for index in store.block_indices() if index < manifest.blocks]
        notes = {index: store.glance(index)[0] for index in indices}
        old = {i for i, note in notes.items() if note is None or note.classify != thresholds}
        if old:
            store.update_manifest(lambda manifest: _forget(manifest, old))
        changed = 0
        receipts: dict[int, Receipt] = {}
        summary = Summary(manifest.cases, store.runs)
        for index in indices:
            file = _inspect(store, index)
            receipt, rows = manifest.receipts.get(index), file.table()
            if index in old:
                seconds = None if receipt is None else receipt.seconds
                types, rows = rows.column("type"), with_types(rows, config.classify)
                changed += _differing(types, rows.column("type"))
                receipt = _rewrite(store, index, file, rows, config.classify).took(seconds)
            elif receipt is None and file.note and file.note.sweep == manifest.config_hash:
                receipt = file.receipt  # a killed process has typed it, and it has lost its own
            # What a stopped session has left of a block has no receipt, and does not count.
            if file.complete:
                if receipt is not None:
                    receipts[index] = receipt
                for batch in rows.to_batches():
                    summary.add(batch)
        store.write_summary(summary.table())

        def change(manifest: Manifest) -> None:
            manifest.config = config
            manifest.clear("classified")
            if thresholds != own:
                manifest.classified = Classified(config=own, now=thresholds, at=now())
            manifest.receipts = receipts

        store.update_manifest(change)
    return Retyped(changed, len(old), before, own, thresholds, summary.table())


def _forget(manifest: Manifest, indices: set[int]) -> None:
    for index in indices:
        manifest.receipts.pop(index, None)


def _changed_config(stored: Stored, overrides: Sequence[str]) -> Config:
    """The config of a directory with other thresholds."""
    for text in overrides:
        if not text.strip().startswith("classify."):
            raise ConfigError(
                f"--set {text}: only keys of classify can change without integrating, such as "
                "classify.sw_departure=0.1"
            )
    return override_config(resolved(stored.config), overrides)


def _inspect(store: Store, index: int) -> BlockFile:
    try:
        return store.inspect_block(index)
    except DamagedError as error:
        raise OutputError(f"{store.block_path(index)} is damaged: {error}") from error


def _differing(before: pa.ChunkedArray, after: pa.ChunkedArray) -> int:
    changed = pc.not_equal(pc.fill_null(before, ""), pc.fill_null(after, ""))
    return int(pc.sum(changed).as_py() or 0)
