"""Join the directories of shards into one, in files of sensible size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.load import differences, override_config, physics_part, resolved
from rattlesweep.sweeps.inspect.retype import stored_cases
from rattlesweep.sweeps.inspect.summary import summarise
from rattlesweep.sweeps.store.atomic import probe_directory
from rattlesweep.sweeps.store.locks import hold
from rattlesweep.sweeps.store.provenance import command_line, now, read_manifest
from rattlesweep.sweeps.store.receipts import Note, Receipt, borders, count_failed
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.tables.arrow import DamagedError

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
        Spans ``(first, stop)`` of run numbers that the merged directory does not have.
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
    what there is is joined in the sources' own blocks; another merge into the same output, or
    `rattlesweep run`, does the rest there.

    Parameters
    ----------
    sources : sequence of Path
        Output directories, of shards or of anything else of one config.
    output : Path
        New, or of this sweep already, as after an earlier merge: what it has is kept, in the
        blocks that it has.
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
    pieces, absent = _cover(stores, manifests)
    target = Store(output)
    target.check_ours()
    probe_directory(output)
    with hold(output):
        old = _held(target, manifests[0])
        size = MERGED_SIZE if not absent else manifests[0]["config"]["block_size"]
        if old is not None:
            size = old["config"]["block_size"]
        target.prepare()
        target.remove_stale_temporaries()
        result = Merged(output)
        manifest = _manifest(stores, manifests, old, output, size)
        target.write_manifest(manifest)
        receipts: dict[str, Any] = {}
        touched = {i for p in pieces for i in range(p.first // size, -(-p.stop // size))}
        touched |= {i for i in target.block_indices() if i < manifest["blocks"]}
        spans = []
        for place, index in enumerate(sorted(touched)):
            report(place / len(touched))
            note = Note.of(manifest, index)
            receipt = _kept(target, index, note)
            if receipt is None:
                if any(first < note.stop and note.first < stop for first, stop in absent):
                    continue
                table = _gather(pieces, note.first, note.stop)
                receipt = target.rewrite_block(index, table, note)
            receipts[str(index)] = receipt.dump()
            spans.append((note.first, note.stop))
            result.runs += receipt.rows
        result.files, result.missing = len(spans), _gaps(spans, manifest["runs"])
        result.failed = count_failed(receipts.values())
        size_on_disk = sum(receipt["bytes"] for receipt in receipts.values())
        manifest |= {"receipts": receipts, "failed": result.failed, "bytes": size_on_disk}
        if result.missing:
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
    return pieces, _gaps([(piece.first, piece.stop) for piece in pieces], manifests[0]["runs"])


def _gaps(spans: list[tuple[int, int]], end: int) -> list[tuple[int, int]]:
    """What spans in order of their beginnings leave out of the runs up to `end`."""
    gaps, reached = [], 0
    for first, stop in [*spans, (end, end)]:
        if first > reached:
            gaps.append((reached, first))
        reached = max(reached, stop)
    return gaps


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


def _held(target: Store, manifest: dict[str, Any]) -> dict[str, Any] | None:
    """Manifest of the output, if it has one, which must be of the same sweep."""
    if not target.has_manifest():
        if target.block_indices():
            raise ConfigError(f"--output {target.directory}: it holds runs already; give a new one")
        return None
    old = read_manifest(target)
    changes = differences(_matter(old["config"]), _matter(manifest["config"]))
    if changes or old["config_hash"] != manifest["config_hash"]:
        what = "; ".join(changes[:3]) or "the table of bodies has changed"
        raise ConfigError(
            f"--output {target.directory}: it holds another sweep ({what}); give a new one"
        )
    return old


def _manifest(
    stores: list[Store],
    manifests: list[dict[str, Any]],
    old: dict[str, Any] | None,
    output: Path,
    size: int,
) -> dict[str, Any]:
    """The manifest of the merged directory: the first one's, with the sessions of all."""
    first = {key: value for key, value in manifests[0].items() if key != "finished"}
    config = resolved(override_config(first["config"], [])) | {
        "block_size": size,
        "output": str(output),
    }
    # What an earlier merge has noted first: its directories may be given again.
    every = manifests if old is None else [old, *manifests]
    places = [store.directory for store in stores]
    sessions: dict[Any, dict[str, Any]] = {}
    for manifest, place in zip(every, places if old is None else [output, *places], strict=True):
        origin = {
            "directory": str(place),
            **{key: manifest[key] for key in ("versions", "machine", "command")},
        }
        for session in manifest["sessions"]:
            key = tuple(session.get(name) for name in ("started", "host", "pid", "shard"))
            sessions.setdefault(key, {**origin, **session})
    commands = [c for m in every for c in m.get("commands", [m["command"]])]
    done = sorted(sessions.values(), key=lambda session: str(session["started"]))
    return first | {
        "state": "running",
        "config": config,
        "blocks": -(-first["runs"] // size),
        "started": min(m["started"] for m in every),
        "command": command_line(),
        "commands": [c for place, c in enumerate(commands) if c not in commands[:place]],
        "sessions": done,
        "receipts": {},
        **{
            key: round(sum(session.get(key, 0.0) for session in done), 3)
            for key in ("seconds", "kernel_seconds")
        },
        "peak_memory": max((m.get("peak_memory") or 0 for m in every), default=0) or None,
    }


def _same_place(one: Path, other: Path) -> bool:
    return one.resolve() == other.resolve()


__all__ = ["MERGED_SIZE", "Merged", "merge"]
