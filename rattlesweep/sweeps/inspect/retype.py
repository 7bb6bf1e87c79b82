"""Type stored runs again, without integrating."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.load import override_config, resolved
from rattlesweep.sweeps.inspect.summary import summarise
from rattlesweep.sweeps.store.locks import hold
from rattlesweep.sweeps.store.provenance import now, read_manifest
from rattlesweep.sweeps.store.store import Found, Store
from rattlesweep.sweeps.tables.arrow import DamagedError
from rattlesweep.sweeps.tables.types import TYPES, classify

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from rattlesweep.sweeps.config.schema import Classify, Config
    from rattlesweep.sweeps.store.receipts import Receipt


class _Noting(Protocol):
    """What keeps the receipts of blocks that are replaced."""

    def forget(self, indices: list[int]) -> None:
        """Drop receipts, before."""

    def wrote(self, index: int, receipt: Receipt) -> object:
        """Keep a receipt, after."""


def retype_blocks(
    store: Store, indices: Sequence[int], thresholds: Classify, noting: _Noting
) -> int:
    """Give the runs of some blocks the types that these thresholds ask for.

    Parameters
    ----------
    store : Store
        Its blocks are replaced, one by one and each in one step.
    indices : sequence of int
    thresholds : Classify
    noting
        Hears which blocks are replaced.

    Returns
    -------
    int
        Number of runs whose type has changed.
    """
    changed = 0
    noting.forget(list(indices))
    for index in indices:
        note = _inspect(store, index).note
        table = store.read_block(index)
        types = typed(table, thresholds)
        changed += _differing(table.column("type").combine_chunks(), types)
        place = table.schema.get_field_index("type")
        if note is not None:
            note = replace(note, classify=thresholds.model_dump())
        table = table.set_column(place, table.schema.field(place), types)
        noting.wrote(index, store.rewrite_block(index, table, note))
    return changed


class _Receipts:
    """Receipts in the manifest of a directory that no sweep is at work in."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._seconds: dict[str, float] = {}
        self.fresh: dict[str, Any] = {}

    def forget(self, indices: list[int]) -> None:
        """Drop receipts."""

        def change(manifest: dict[str, Any]) -> None:
            for index in map(str, indices):
                old = manifest["receipts"].pop(index, {})
                self._seconds |= {index: old["seconds"]} if "seconds" in old else {}

        self._store.update_manifest(change)

    def wrote(self, index: int, receipt: Receipt) -> None:
        """Keep a receipt."""
        seconds = self._seconds.get(str(index))
        self.fresh[str(index)] = replace(receipt, seconds=seconds).dump()


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
    store = Store(directory)
    config_of(store, overrides)  # before anything is made there
    with hold(directory):
        manifest, config = config_of(store, overrides)
        thresholds = resolved(config)["classify"]
        before = manifest["config"]["classify"]
        own = manifest.get("classified", {}).get("config", before)
        store.remove_stale_temporaries()
        receipts = _Receipts(store)
        found = {index: _inspect(store, index) for index in store.block_indices()
                 if index < manifest["blocks"]}  # fmt: skip
        old = [i for i, f in found.items() if f.note is None or f.note.classify != thresholds]
        # Those that a killed process has typed have lost theirs.
        whole = {
            str(i): f.receipt.dump()
            for i, f in found.items()
            if f.note is not None and f.note.sweep == manifest["config_hash"] and f.complete
        }
        changed = retype_blocks(store, old, config.classify, receipts) if old else 0
        summary = summarise(store, stored_cases(manifest))
        store.write_summary(summary)

        def change(manifest: dict[str, Any]) -> None:
            manifest["config"] = manifest["config"] | {"classify": thresholds}
            manifest.pop("classified", None)
            if thresholds != own:
                manifest["classified"] = {"config": own, "now": thresholds, "at": now()}
            known = whole | manifest["receipts"] | receipts.fresh
            order = sorted(known.items(), key=lambda item: int(item[0]))
            # What a stopped session has left of a block has no receipt.
            manifest["receipts"] = {i: r for i, r in order if found[int(i)].complete}

        store.update_manifest(change)
    return Retyped(changed, len(old), before, own, thresholds, summary)


def config_of(store: Store, overrides: Sequence[str]) -> tuple[dict[str, Any], Config]:
    """Manifest and config of a directory, with other thresholds.

    Raises
    ------
    ConfigError
        If it is no output directory, or an override is not of ``classify``.
    OutputError
        If its manifest is damaged.
    """
    manifest = read_manifest(store)
    for text in overrides:
        if not text.strip().startswith("classify."):
            raise ConfigError(
                f"--set {text}: only keys of classify can change without integrating, such as "
                "classify.sw_departure=0.1"
            )
    return manifest, override_config(manifest["config"], overrides)


def _inspect(store: Store, index: int) -> Found:
    try:
        return store.inspect_block(index)
    except DamagedError as error:
        raise OutputError(f"{store.block_path(index)} is damaged: {error}") from error


@dataclass(frozen=True)
class StoredCase:
    """A case as the manifest names it."""

    index: int
    target_name: str | None
    target: float | None
    n_i: float | None
    omega_xy0: float | None


def stored_cases(manifest: dict[str, Any]) -> list[StoredCase]:
    """Cases of an output directory."""
    cases = []
    for entry in manifest["cases"]:
        name = next((key for key in ("K_p", "K_r") if key in entry), None)
        target = entry[name] if name else None
        cases.append(
            StoredCase(entry["case"], name, target, entry.get("n_i"), entry.get("omega_xy0"))
        )
    return cases


def _floats(table: pa.Table, name: str) -> NDArray[np.float64]:
    values: NDArray[np.float64] = table.column(name).to_numpy()
    return values


def typed(table: pa.Table, thresholds: Classify) -> pa.Array:
    """Types that the numbers of stored runs give under these thresholds."""
    status: Any = table.column("status").to_numpy()
    codes = classify(
        status == "ok",
        _floats(table, "t_r"),
        _floats(table, "amp_growth"),
        _floats(table, "n_departure"),
        thresholds,
    )
    indices = pa.array(codes, mask=codes < 0)
    return pa.DictionaryArray.from_arrays(indices, pa.array(TYPES)).cast(pa.string())


def _differing(before: pa.Array, after: pa.Array) -> int:
    changed = pc.not_equal(pc.fill_null(before, ""), pc.fill_null(after, ""))
    return int(pc.sum(changed).as_py() or 0)
