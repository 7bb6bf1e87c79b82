"""The progress of a sweep, at any time: its rows, and who is at work."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rattlesweep.store.decide import wanted_runs
from rattlesweep.store.locks import is_readable, probe_locks
from rattlesweep.store.rows import IS_DAMAGED, open_stored
from rattlesweep.store.sessions import read_sessions, unfinished, who
from rattlesweep.system.console import counted
from rattlesweep.words.errors import DamagedError, as_lines


@dataclass(frozen=True)
class SweepStatus:
    """Progress of a sweep; :func:`status` defines the keys of `data`."""

    title: str
    data: dict[str, Any]

    @property
    def words(self) -> str:
        """The same as text."""
        data = self.data
        percent = 100 * data["runs"] / max(1, data["wanted"])
        lines = [
            f"{self.title}: {data['runs']:,} of {data['wanted']:,} runs "
            f"({percent:.1f} %), {counted(data['files'], 'file')}, "
            f"{data['bytes'] / 1e6:.1f} MB"
        ]
        for kind in ("status", "types"):
            if data[kind]:
                lines.append(f"{kind}: {_counts(data[kind])}")
        if data["damaged"]:
            lines.append(f"damaged: {set_aside(data['damaged'])}")
        for session in data["at_work"]:
            shard = session["shard"] or "the whole sweep"
            lines.append(f"at work: {shard}, {who(session)}")
        for session in data["unknown"]:
            lines.append(f"at work or killed (its lock does not tell): {who(session)}")
        last = data["last"]
        if last is not None and not data["at_work"] and not data["unknown"]:
            how = f"ended: {last['how']}"
            if last["how"] == "running":
                how = "was killed"
            lines.append(f"no process is at work; the last session, {who(last)}, {how}")
        return as_lines(lines)


def _counts(numbers: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count:,}" for name, count in numbers.items())


def set_aside(paths: list[str]) -> str:
    """Return in words which damaged files were moved out of the way of readers."""
    folder = Path(paths[0]).parent
    files = counted(len(paths), "file")
    return f"{files} in {folder}, replaced by new runs; look why before you delete it"


def _size(path: Path) -> int:
    """Return the size of a file; 0 if it is gone."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def status(directory: Path) -> SweepStatus:
    """Count the rows of an output directory, and list the sessions at work there."""
    stored = open_stored(directory)
    on_disk = stored.find()
    if on_disk.damaged:
        raise DamagedError(IS_DAMAGED.format(on_disk.damaged[0]))
    files = stored.files()
    sessions = read_sessions(directory)
    locks = probe_locks(directory)
    can_tell = is_readable(directory)
    working = []
    unknown = []
    for lock, session in unfinished(sessions).items():
        held = locks.get(lock, False)
        if held:
            working.append(session)
        elif held is None or not can_tell:
            unknown.append(session)
    idle = [session for session in sessions if session not in working + unknown]
    data = {
        "runs": on_disk.rows,
        "wanted": int(wanted_runs(stored, on_disk).sum()),
        "files": len(files),
        "bytes": sum(map(_size, files)),
        "status": dict(on_disk.status.most_common()),
        "types": dict(on_disk.types.most_common()),
        "damaged": [str(path) for path in stored.damaged_files()],
        "at_work": working,
        "unknown": unknown,
        "last": idle[-1] if idle else None,
    }
    return SweepStatus(f"{stored.manifest['name']} in {directory}", data)
