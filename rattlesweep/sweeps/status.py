"""How far a sweep is: its rows are counted, and who works on it says how far that is."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rattlesweep.durations import clock
from rattlesweep.sweeps.decide import decides, decision
from rattlesweep.sweeps.locks import FOLDER, WHOLE, at_work
from rattlesweep.sweeps.provenance import read_sessions, who
from rattlesweep.sweeps.stored import open_stored
from rattlesweep.text import counted


@dataclass(frozen=True)
class Status:
    """What is there of a sweep.

    Attributes
    ----------
    data : dict
        ``runs``, ``wanted``, ``files``, ``bytes``, ``status`` and ``types`` (runs by each),
        ``at_work`` (sessions under way) and ``last`` (the session that ended last).
    directory : Path
    name : str
    decides : str or None
        Key of the config by which the sweep leaves runs out.
    """

    directory: Path
    name: str
    data: dict[str, Any]
    decides: str | None

    @property
    def done(self) -> bool:
        """Whether all runs are there that are wanted."""
        return bool(self.data["runs"] >= self.data["wanted"])

    @property
    def words(self) -> str:
        """The same for the terminal."""
        data = self.data
        percent = 100 * data["runs"] / max(1, data["wanted"])
        so_far = " wanted so far" if self.decides and not self.done else ""
        lines = [
            f"{self.name} in {self.directory}: {data['runs']:,} of {data['wanted']:,} runs"
            f"{so_far} ({percent:.1f} %), {counted(data['files'], 'file')}, "
            f"{data['bytes'] / 1e6:.1f} MB"
        ]
        for what in ("status", "types"):
            if data[what]:
                counts = ", ".join(f"{word} {count:,}" for word, count in data[what].items())
                lines.append(f"{what}: {counts}")
        for session in data["at_work"]:
            shard = f"{session['shard']}, " if session.get("shard") else ""
            lines.append(f"at work: {shard}{who(session)}{_how_far(session)}")
        if not data["at_work"] and (last := data["last"]) is not None:
            lines.append(f"nobody is at work; the last session, {who(last)}, {_ended(last)}")
        return "\n".join(lines)


def status(directory: Path) -> Status:
    """Count the rows of an output directory.

    Raises
    ------
    ConfigError
        If it is no output directory.
    OutputError
        If a file cannot be read or is damaged.
    """
    stored = open_stored(directory)
    files = stored.files()
    counts = {"status": Counter[str](), "type": Counter[str]()}
    runs = 0
    for path in files:
        rows = stored.runs.table(path, ["status", "type"])
        runs += len(rows)
        for name, counter in counts.items():
            for entry in rows.column(name).drop_null().value_counts().to_pylist():
                counter[entry["values"]] += entry["counts"]
    wanted = len(stored.cases) * stored.samples
    if (decide := decision(stored.config, stored.cases, stored.samples)) is not None:
        decide.read(stored)
        wanted = int(decide.wanted().sum())
    sessions = read_sessions(directory)
    # Of several of a shard that have not said their end, the last holds its lock, if any does.
    last = {s.get("shard"): s for s in sessions if s.get("how") == "running"}
    locks = directory / FOLDER
    held = [p.name for p in locks.iterdir() if at_work(p)] if locks.is_dir() else []
    working = [session for shard, session in last.items() if (shard or WHOLE) in held]
    ended = [session for session in sessions if session not in working]
    data = {
        "runs": runs,
        "wanted": wanted,
        "files": len(files),
        "bytes": sum(path.stat().st_size for path in files),
        "status": dict(counts["status"].most_common()),
        "types": dict(counts["type"].most_common()),
        "at_work": working,
        "last": ended[-1] if ended else None,
    }
    return Status(directory, str(stored.manifest["name"]), data, decides(stored.config))


def _how_far(session: dict[str, Any]) -> str:
    progress = session.get("progress")
    if not isinstance(progress, dict):
        return ""
    left = progress.get("left")
    return (
        f": {progress['runs']:,} of {progress['total']:,} runs, those under way included"
        f"{'' if left is None else f', about {clock(left)} left'}"
    )


def _ended(session: dict[str, Any]) -> str:
    how = session.get("how")
    words = {
        "complete": "has done all of its runs",
        "stopped": "stopped when its time was up",
        "interrupted": "was interrupted",
        "running": "died without a word",
    }
    return words.get(str(how), str(how))
