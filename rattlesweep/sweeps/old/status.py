"""How far a sweep is, told from its directory alone."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from rattlesweep.durations import clock
from rattlesweep.errors import MAX_LINE, one_line
from rattlesweep.sweeps.old.locks import holder
from rattlesweep.sweeps.old.manifest import Manifest
from rattlesweep.sweeps.old.stored import open_stored

# Seconds that are still a date.
LONGEST = 1e11


@dataclass(frozen=True)
class Status:
    """How far a sweep is; done are the runs of complete blocks."""

    directory: str
    name: str
    # complete, running, stopped (on purpose or by a signal), partial (a shard's share is done,
    # others are not here) or died (its process ended without a word)
    state: str
    holder: str | None  # who is at work there
    runs: int
    runs_done: int
    blocks: int
    blocks_done: int
    runs_begun: int  # of other blocks, which a stopped session has left and the next one completes
    failed: dict[str, int]  # runs in place by status, other than ok
    # Runs in place whose t_r is known to a few digits only, and whose type is not sure; None where
    # no errors are recorded.
    sensitive: int | None
    unsure: int | None
    damaged: list[int]  # blocks that do not read, or hold other runs; `verify` says more
    strays: list[str]  # files that readers take for runs, but none of this sweep's blocks
    seconds: float  # spent by all sessions that have ended
    left: float | None  # seconds, at the speed so far of the processes at work if there are any
    ends: str | None  # when it will be done, in UTC, if somebody is at work


def status_of(directory: Path) -> Status:
    """Look at a directory, also while a sweep is at work in it; nothing is written."""
    at_work = holder(directory)
    stored = open_stored(directory)
    store, manifest = stored.store, stored.manifest
    failed: Counter[str] = Counter()
    doubts = {"sensitive": 0, "unsure": 0} if "error" in stored.config.record else {}
    damaged: list[int] = []
    blocks = done = begun = 0
    for index in stored.present():
        receipt = manifest.receipts.get(index)
        if receipt is None:
            # Not noted yet, so the file is asked.
            file = store.find_block(index, stored.note(index).runs)
            if file is None:
                damaged.append(index)
                continue
            receipt = file.receipt
            if not file.complete:
                begun += receipt.rows
                continue
        blocks += 1
        failed.update(receipt.failed)
        for name in doubts:
            doubts[name] += getattr(receipt, name) or 0
        first, stop = manifest.borders(index)
        done += min(receipt.rows, stop - first)
    left, ends = _time_left(manifest, done + begun, at_work is not None)
    died = at_work is None and manifest.state == "running"
    return Status(
        directory=str(directory),
        name=manifest.name,
        state="running" if at_work is not None else "died" if died else manifest.state,
        holder=at_work,
        runs=manifest.runs,
        runs_done=done,
        blocks=manifest.blocks,
        blocks_done=blocks,
        runs_begun=begun,
        failed=dict(sorted(failed.items())),
        sensitive=doubts.get("sensitive"),
        unsure=doubts.get("unsure"),
        damaged=damaged,
        strays=[path.name for path in store.strays(manifest.blocks)],
        seconds=manifest.seconds,
        left=left,
        ends=ends,
    )


def _time_left(manifest: Manifest, done: int, at_work: bool) -> tuple[float | None, str | None]:
    """Seconds left, and the end if somebody is at work."""
    if done >= manifest.runs:
        return 0.0, None
    # Each process knows its own share best; the last to end ends the sweep.
    ends = [
        datetime.fromisoformat(session.progress.at)
        + timedelta(seconds=min(session.progress.left, LONGEST))
        for session in manifest.sessions
        if session.state == "running" and session.progress and session.progress.left is not None
    ]
    if at_work and ends:
        left = max(0.0, (max(ends) - datetime.now(UTC)).total_seconds())
        return left, max(ends).isoformat(timespec="seconds")
    timed = [receipt for receipt in manifest.receipts.values() if receipt.seconds]
    if not timed:
        return None, None
    each = sum(r.seconds or 0.0 for r in timed) / max(sum(r.rows for r in timed), 1)
    return each * (manifest.runs - done), None


def describe(status: Status) -> str:
    """A few lines for people."""
    share = 100 * status.runs_done / max(status.runs, 1)
    left = "unknown" if status.left is None else f"about {clock(status.left)}"
    lines = {
        "sweep": f"{status.name}, in {status.directory}",
        "state": status.state + (f", by {status.holder}" if status.holder else ""),
        "runs": f"{status.runs_done} of {status.runs} done ({share:.1f} %)",
        "blocks": f"{status.blocks_done} of {status.blocks}",
        "begun": f"{status.runs_begun} runs of blocks that are not complete",
        "damaged": f"blocks {', '.join(map(str, status.damaged[:10]))}",
        "strays": f"{', '.join(status.strays[:3])}{' and others' if len(status.strays) > 3 else ''}"
        ": no block of this sweep",
        "failed": ", ".join(f"{n} {word}" for word, n in status.failed.items()) or "none",
        "errors": f"{status.sensitive} sensitive (t_r_error above 1e-6 t_r), "
        f"{status.unsure} whose type is not sure",
        "time": f"{clock(status.seconds)} spent",
        "left": left + (f", until {status.ends}" if status.ends else ""),
    }
    absent = {
        "begun": not status.runs_begun,
        "damaged": not status.damaged,
        "strays": not status.strays,
        "errors": status.sensitive is None,
        "left": status.runs_done >= status.runs,
    }
    return "\n".join(
        f"{name:<8} {one_line(text, MAX_LINE)}"
        for name, text in lines.items()
        if not absent.get(name)
    )
