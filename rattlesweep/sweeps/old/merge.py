"""Join the directories of shards into one, in files of sensible size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.load import differences, physics_part, resolved
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.summary import summarise
from rattlesweep.sweeps.old.locks import hold
from rattlesweep.sweeps.old.manifest import Manifest, SessionRecord
from rattlesweep.sweeps.provenance import command_line, now
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.old.stored import Stored, open_stored
from rattlesweep.sweeps.counts import columns_for

# Runs in a file: about 28 MB, and as much as a block may have, so that a merged
# directory is an output directory like any other.
MERGED_SIZE = 200_000


@dataclass
class Merged:
    """What is in the merged directory."""

    directory: Path
    runs: int = 0
    files: int = 0
    missing: list[tuple[int, int]] = field(default_factory=list)  # runs, spans from and up to
    failed: dict[str, int] = field(default_factory=dict)  # runs by status, other than ok
    summary: pa.Table | None = None  # one row a case; None if runs are missing


@dataclass(frozen=True)
class _Piece:
    """A block of one of the sources, and its runs."""

    store: Store
    index: int
    first: int
    stop: int

    def table(self) -> pa.Table:
        """Its rows."""
        table = self.store.read_block(self.index).table()
        if len(table) != self.stop - self.first:
            raise OutputError(f"{self.store.block_path(self.index)} is not a block of its sweep")
        return table


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

    The output is new, or of this sweep already, as after an earlier merge: what it has is kept, in
    the blocks that it has. `report` is called with the fraction done. Raises ConfigError where
    directories are not of one sweep, OutputError where they are damaged or contradict each other.
    """
    shares = [open_stored(path) for path in sources]
    for share in shares:
        share.refuse_stages("there are no shares of it to merge")
        if what := _other_sweep(shares[0].manifest, share.manifest):
            raise ConfigError(
                f"{share.directory}: its config is not that of {shares[0].directory} ({what}); "
                "only shares of one sweep can be merged"
            )
    if any(share.directory.resolve() == output.resolve() for share in shares):
        raise ConfigError(f"--output {output}: is one of the directories to be merged; give a new")
    pieces, absent = _cover(shares)
    target = Store(output)
    target.prepare()
    with hold(output) as alone:
        earlier = _earlier(target, shares[0])
        size = MERGED_SIZE if not absent else shares[0].config.block_size
        if earlier is not None:
            size = earlier.config.block_size
        target.remove_stale_temporaries(alone)
        result = Merged(output)
        manifest = _manifest(shares, earlier, output, size)
        target.write_manifest(manifest)
        merged = Stored(target, manifest)
        touched = {i for p in pieces for i in range(p.first // size, -(-p.stop // size))}
        touched.update(merged.present())
        spans = []
        for place, index in enumerate(sorted(touched)):
            report(place / len(touched))
            note = merged.note(index)
            # An earlier merge, perhaps an interrupted one, may have left it whole.
            receipt = target.finished_block(index, note)
            if receipt is None:
                if any(first < note.stop and note.first < stop for first, stop in absent):
                    continue
                receipt = target.write_block(index, _gather(pieces, note.first, note.stop), note)
            manifest.receipts[index] = receipt
            spans.append((note.first, note.stop))
            result.runs += receipt.rows
        result.files, result.missing = len(spans), _gaps(spans, manifest.runs)
        manifest.add_up()
        result.failed = manifest.failed
        if result.missing:
            manifest.state = "stopped"
        else:
            result.summary = summarise(target, manifest.cases, columns_for(manifest.config))
            target.write_summary(result.summary)
            manifest.state, manifest.finished = "complete", now()
        target.write_manifest(manifest)
    return result


def _other_sweep(one: Manifest, other: Manifest) -> str:
    """In what two sweeps differ; empty if they are one."""
    changes = differences(_matter(one.config), _matter(other.config))
    if not changes and one.config_hash != other.config_hash:
        changes = ["the table of bodies has changed"]
    return "; ".join(changes[:3])


def _matter(config: Config) -> dict[str, Any]:
    data = resolved(config)
    limit = {"max_steps": config.integrator.max_steps}
    return physics_part(data) | limit | {"classify": data["classify"]}


def _cover(shares: list[Stored]) -> tuple[list[_Piece], list[tuple[int, int]]]:
    """All blocks there are, by their runs, and the runs that none has."""
    pieces = [
        _Piece(share.store, index, *share.manifest.borders(index))
        for share in shares
        for index in share.present()
        if share.store.glance(index)[1]
    ]
    pieces.sort(key=lambda piece: (piece.first, -piece.stop))
    return pieces, _gaps([(piece.first, piece.stop) for piece in pieces], shares[0].manifest.runs)


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
        table = piece.table()
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
    return pa.concat_tables(parts)


def _earlier(target: Store, share: Stored) -> Manifest | None:
    """Manifest of the output, if it has one, which must be of the same sweep."""
    if not target.has_manifest():
        if target.block_indices():
            raise ConfigError(f"--output {target.directory}: it holds runs already; give a new one")
        return None
    earlier = target.read_manifest()
    if what := _other_sweep(earlier, share.manifest):
        raise ConfigError(
            f"--output {target.directory}: it holds another sweep ({what}); give a new one"
        )
    return earlier


def _manifest(shares: list[Stored], earlier: Manifest | None, output: Path, size: int) -> Manifest:
    """The manifest of the merged directory: the first one's, with the sessions of all."""
    # What an earlier merge has noted first: its directories may be given again.
    every = [(share.directory, share.manifest) for share in shares]
    if earlier is not None:
        every = [(output, earlier), *every]
    sessions: dict[Any, SessionRecord] = {}
    for place, manifest in every:
        origin = {
            "directory": str(place),
            "versions": manifest.versions,
            "machine": manifest.machine,
            "command": manifest.command,
        }
        for session in manifest.sessions:
            own = session.model_dump(exclude_defaults=True)
            sessions.setdefault(session.key, SessionRecord(**origin | own))
    done = sorted(sessions.values(), key=lambda session: session.started)
    commands = [words for _, m in every for words in (m.commands or [m.command])]
    peaks = [m.peak_memory for _, m in every if m.peak_memory]
    first = shares[0].manifest
    fresh = {
        "state": "running",
        "config": first.config.model_copy(update={"block_size": size, "output": str(output)}),
        "blocks": -(-first.runs // size),
        "started": min(m.started for _, m in every),
        "command": command_line(),
        "commands": [words for k, words in enumerate(commands) if words not in commands[:k]],
        "sessions": done,
        "receipts": {},
        "peak_memory": max(peaks, default=None),
        "finished": None,
    }
    merged = first.model_copy(update=fresh)
    merged.add_up()
    return merged
