"""How far a sweep is, told from its directory alone."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from rattlesweep.durations import clock
from rattlesweep.errors import MAX_LINE, one_line
from rattlesweep.sweeps.store.locks import holder
from rattlesweep.sweeps.store.provenance import read_manifest
from rattlesweep.sweeps.store.receipts import Note, Receipt, borders
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.tables.arrow import DamagedError

# Seconds that are still a date.
LONGEST = 1e11


@dataclass(frozen=True)
class Status:
    """How far a sweep is.

    Attributes
    ----------
    state : str
        ``complete``, ``running``, ``stopped`` (on purpose or by a signal), ``partial`` (a shard's
        share is done, others are not here) or ``died`` (its process ended without a word).
    holder : str or None
        Who is at work there.
    runs, runs_done, blocks, blocks_done : int
        Done are those of complete blocks.
    runs_begun : int
        Runs of other blocks, which a stopped session has left and the next one completes.
    failed : dict
        Runs in place by status, other than ``ok``.
    damaged : list of int
        Blocks in place that do not read, or hold other runs; `verify` says more.
    strays : list of str
        Files that readers take for runs, but none of this sweep's blocks.
    seconds : float
        Time spent by all sessions that have ended.
    left : float or None
        Seconds left at the speed so far, of the processes at work now if there are any.
    ends : str or None
        When it will be done, in UTC, if somebody is at work.
    """

    directory: str
    name: str
    state: str
    holder: str | None
    runs: int
    runs_done: int
    blocks: int
    blocks_done: int
    runs_begun: int
    failed: dict[str, int]
    damaged: list[int]
    strays: list[str]
    seconds: float
    left: float | None
    ends: str | None


def status_of(directory: Path) -> Status:
    """Look at a directory, also while a sweep is at work in it; nothing is written.

    Raises
    ------
    ConfigError
        It is no output directory.
    OutputError
        It cannot be read, or its manifest is damaged.
    """
    store = Store(directory)
    at_work = holder(directory)
    manifest = read_manifest(store)
    runs = manifest["runs"]
    failed: Counter[str] = Counter()
    damaged: list[int] = []
    blocks = done = begun = 0
    for index in store.block_indices():
        if index >= manifest["blocks"]:
            continue
        receipt = Receipt.load(manifest["receipts"].get(str(index)))
        if receipt is None:
            # Not noted yet, so the file is asked.
            try:
                found = store.inspect_block(index)
            except DamagedError:
                damaged.append(index)
                continue
            receipt = found.receipt
            if not Note.of(manifest, index).same_runs(found.note):
                damaged.append(index)
                continue
            if not found.complete:
                begun += receipt.rows
                continue
        blocks += 1
        failed.update(receipt.failed)
        first, stop = borders(manifest, index)
        done += min(receipt.rows, stop - first)
    seconds = float(manifest.get("seconds", 0.0))
    left, ends = _time_left(manifest, done + begun, at_work is not None)
    return Status(
        directory=str(directory),
        name=manifest["name"],
        state=_state(manifest, at_work),
        holder=at_work,
        runs=runs,
        runs_done=done,
        blocks=manifest["blocks"],
        blocks_done=blocks,
        runs_begun=begun,
        failed=dict(sorted(failed.items())),
        damaged=damaged,
        strays=_strays(store, manifest["blocks"]),
        seconds=seconds,
        left=left,
        ends=ends,
    )


def _strays(store: Store, blocks: int) -> list[str]:
    try:
        return [path.name for path in store.strays(blocks)]
    except OSError:
        return []


def _state(manifest: dict[str, Any], at_work: str | None) -> str:
    if at_work is not None:
        return "running"
    return "died" if manifest["state"] == "running" else str(manifest["state"])


def _time_left(
    manifest: dict[str, Any], done: int, at_work: bool
) -> tuple[float | None, str | None]:
    """Seconds left, and the end if somebody is at work."""
    if done >= manifest["runs"]:
        return 0.0, None
    running = [s for s in manifest["sessions"] if s.get("state") == "running" and "progress" in s]
    if at_work and running:
        # Each process knows its own share best; the last to end ends the sweep.
        ends = [
            datetime.fromisoformat(s["progress"]["at"])
            + timedelta(seconds=min(s["progress"]["left"], LONGEST))
            for s in running
            if s["progress"]["left"] is not None
        ]
        if ends:
            end = max(ends)
            left = max(0.0, (end - datetime.now(UTC)).total_seconds())
            return left, end.isoformat(timespec="seconds")
    timed = [r for r in map(Receipt.load, manifest["receipts"].values()) if r and r.seconds]
    if not timed:
        return None, None
    each = sum(r.seconds or 0.0 for r in timed) / max(sum(r.rows for r in timed), 1)
    return each * (manifest["runs"] - done), None


def describe(status: Status) -> str:
    """A few lines for people."""
    share = 100 * status.runs_done / max(status.runs, 1)
    lines = [
        ("sweep", f"{status.name}, in {status.directory}"),
        ("state", status.state + (f", by {status.holder}" if status.holder else "")),
        ("runs", f"{status.runs_done} of {status.runs} done ({share:.1f} %)"),
        ("blocks", f"{status.blocks_done} of {status.blocks}"),
    ]
    if status.runs_begun:
        lines.append(("begun", f"{status.runs_begun} runs of blocks that are not complete"))
    if status.damaged:
        lines.append(("damaged", f"blocks {', '.join(map(str, status.damaged[:10]))}"))
    if status.strays:
        more = " and others" if len(status.strays) > 3 else ""
        lines.append(("strays", f"{', '.join(status.strays[:3])}{more}: no block of this sweep"))
    words = ", ".join(f"{count} {word}" for word, count in status.failed.items())
    lines.append(("failed", words or "none"))
    lines.append(("time", f"{clock(status.seconds)} spent"))
    if status.runs_done < status.runs:
        left = "unknown" if status.left is None else f"about {clock(status.left)}"
        lines.append(("left", left + (f", until {status.ends}" if status.ends else "")))
    return "\n".join(f"{name:<8} {one_line(text, MAX_LINE)}" for name, text in lines)
