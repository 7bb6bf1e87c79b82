"""Join the directories of shards into one, in files of sensible size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from rattlesweep.sweep.config import differences, override_config, physics_part, resolved
from rattlesweep.sweep.errors import ConfigError, OutputError
from rattlesweep.sweep.files import probe_directory
from rattlesweep.sweep.locks import hold
from rattlesweep.sweep.provenance import now, read_manifest
from rattlesweep.sweep.receipts import Note, Receipt, borders, count_failed
from rattlesweep.sweep.retype import stored_cases
from rattlesweep.sweep.store import Store
from rattlesweep.sweep.summary import summarise
from rattlesweep.sweep.tables import DamagedError

if TYPE_CHECKING:
    pass

# Runs in a file: about 28 MB, and as much as a block may have, so that a merged
# directory is an output directory like any other.
MERGED_SIZE = 200_000


@dataclass
class Merged:
    """What a merge came to.

    Attributes
    ----------
    directory : Path
    runs, files : int
        Runs and files in the merged directory.
    missing : list of tuple
        Spans ``(first, stop)`` of run numbers that no directory has.
    failed : dict
        Runs by status, other than ``ok``.
    summary : pa.Table or None
        One row a case; None if runs are missing.
    """

    directory: Path
    runs: int = 0
    files: int = 0
    missing: list[tuple[int, int]] = field(default_factory=list)
    failed: dict[str, int] = field(default_factory=dict)
    summary: pa.Table | None = None


@dataclass(frozen=True)
class _Piece:
    """A block of one of the sources."""

    store: Store
    index: int
    first: int
    stop: int


def merge(
    sources: Sequence[Path],
    output: Path,
    *,
    report: Callable[[float], None] = lambda fraction: None,
) -> Merged:
    """Join directories of one sweep.

    Runs that several directories have must be the same in all of them. Where runs are missing,
    what there is is joined in the sources' own blocks, and `rattlesweep run` can do the rest there.

    Parameters
    ----------
    sources : sequence of Path
        Output directories, of shards or of anything else of one config.
    output : Path
        New, or of an earlier merge.
    report : callable
        Called with the fraction done.

    Returns
    -------
    Merged

    Raises
    ------
    ConfigError
        A source is no output directory or of another config, or the output is in use for
        something else; says what differs.
    OutputError
        A block is damaged, sources contradict each other, or a file cannot be written.
    """
    stores = [Store(path) for path in sources]
    manifests = [read_manifest(store) for store in stores]
    _check_config(stores, manifests)
    if any(_same_place(store.directory, output) for store in stores):
        raise ConfigError(f"--output {output}: is one of the directories to be merged; give a new")
    pieces, missing = _cover(stores, manifests)
    size = MERGED_SIZE if not missing else manifests[0]["config"]["block_size"]
    probe_directory(output)
    with hold(output):
        target = Store(output)
        _check_target(target, manifests[0], size)
        target.prepare()
        target.remove_stale_temporaries()
        result = Merged(output, missing=missing)
        manifest = _manifest(stores, manifests, output, size)
        target.write_manifest(manifest)
        receipts: dict[str, Any] = {}
        for index in range(manifest["blocks"]):
            report(index / manifest["blocks"])
            note = Note.of(manifest, index)
            if any(first < note.stop and note.first < stop for first, stop in missing):
                continue
            receipt = _kept(target, index, note) or target.rewrite_block(
                index, _gather(pieces, note.first, note.stop), note
            )
            receipts[str(index)] = receipt.dump()
            result.files += 1
            result.runs += receipt.rows
        result.failed = count_failed(receipts.values())
        manifest |= {"receipts": receipts, "failed": result.failed}
        if missing:
            manifest["state"] = "stopped"
        else:
            result.summary = summarise(target, stored_cases(manifest))
            target.write_summary(result.summary)
            manifest |= {"state": "complete", "finished": now()}
        target.write_manifest(manifest)
    return result


def _check_config(stores: list[Store], manifests: list[dict[str, Any]]) -> None:
    """Refuse shares of different sweeps."""
    first = manifests[0]
    for store, manifest in zip(stores[1:], manifests[1:], strict=True):
        changes = differences(_matter(first["config"]), _matter(manifest["config"]))
        if not changes and manifest["config_hash"] != first["config_hash"]:
            changes = ["the table of bodies has changed"]
        if changes:
            raise ConfigError(
                f"{store.directory}: its config is not that of {stores[0].directory} "
                f"({'; '.join(changes[:3])}); only shares of one sweep can be merged"
            )


def _matter(config: dict[str, Any]) -> dict[str, Any]:
    limit = {"max_steps": config["integrator"]["max_steps"]}
    return physics_part(config) | limit | {"classify": config["classify"]}


def _cover(
    stores: list[Store], manifests: list[dict[str, Any]]
) -> tuple[list[_Piece], list[tuple[int, int]]]:
    """All blocks there are, by their runs, and the runs that none has."""
    pieces = []
    for store, manifest in zip(stores, manifests, strict=True):
        pieces += [
            _Piece(store, index, *borders(manifest, index))
            for index in store.block_indices()
            if index < manifest["blocks"] and store.is_complete(index)
        ]
    pieces.sort(key=lambda piece: (piece.first, -piece.stop))
    missing, reached = [], 0
    for piece in pieces:
        if piece.first > reached:
            missing.append((reached, piece.first))
        reached = max(reached, piece.stop)
    if reached < manifests[0]["runs"]:
        missing.append((reached, manifests[0]["runs"]))
    return pieces, missing


def _gather(pieces: list[_Piece], first: int, stop: int) -> pa.Table:
    """Rows of the runs ``first <= run < stop``, each from one block, proved equal in all others."""
    parts: list[pa.Table] = []
    reached = first
    for piece in pieces:
        if piece.stop <= first or piece.first >= stop:
            continue
        table = piece.store.read_block(piece.index)
        if len(table) != piece.stop - piece.first:
            raise OutputError(f"{piece.store.block_path(piece.index)} is not a block of its sweep")
        low, high = max(piece.first, first), min(piece.stop, stop)
        both = min(high, reached)
        if low < both:
            held = pa.concat_tables(parts).slice(low - first, both - low)
            if not held.equals(table.slice(low - piece.first, both - low)):
                raise OutputError(
                    f"{piece.store.block_path(piece.index)} contradicts another directory's runs "
                    f"{low} to {both - 1}; `rattlesweep verify --recompute` tells which is wrong"
                )
        if high > reached:
            parts.append(table.slice(reached - piece.first, high - reached))
            reached = high
    return pa.concat_tables(parts).combine_chunks()


def _kept(target: Store, index: int, note: Note) -> Receipt | None:
    """Receipt of a block that an earlier, interrupted merge has left whole."""
    try:
        found = target.inspect_block(index)
    except DamagedError:
        return None
    return found.receipt if found.note == note and found.complete else None


def _check_target(target: Store, manifest: dict[str, Any], size: int) -> None:
    if not target.has_manifest():
        if target.block_indices():
            raise ConfigError(f"--output {target.directory}: it holds runs already; give a new one")
        return
    old = read_manifest(target)
    if old["config_hash"] != manifest["config_hash"] or old["config"]["block_size"] != size:
        raise ConfigError(
            f"--output {target.directory}: it holds another sweep, or this one in other blocks; "
            "give a new one"
        )


def _manifest(
    stores: list[Store], manifests: list[dict[str, Any]], output: Path, size: int
) -> dict[str, Any]:
    """The manifest of the merged directory: the first one's, with the sessions of all."""
    first = manifests[0]
    config = resolved(override_config(first["config"], [])) | {
        "block_size": size,
        "output": str(output),
    }
    sessions = [
        {**session, "directory": str(store.directory), "versions": manifest["versions"],
         "machine": manifest["machine"]}
        for store, manifest in zip(stores, manifests, strict=True)
        for session in manifest["sessions"]
    ]  # fmt: skip
    totals = {
        key: round(sum(m.get(key, 0.0) for m in manifests), 3)
        for key in ("seconds", "kernel_seconds")
    }
    return first | {
        "state": "running",
        "config": config,
        "blocks": -(-first["runs"] // size),
        "started": min(m["started"] for m in manifests),
        "sessions": sorted(sessions, key=lambda session: str(session["started"])),
        "receipts": {},
        **totals,
    }


def _same_place(one: Path, other: Path) -> bool:
    return one.resolve() == other.resolve()


__all__ = ["MERGED_SIZE", "Merged", "merge"]
