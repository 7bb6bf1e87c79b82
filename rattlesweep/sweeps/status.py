"""How far a sweep is: its rows are counted, and who works on it says how far that is."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rattlesweep.sweeps.decide import decides, decision
from rattlesweep.sweeps.provenance import WHOLE, at_work, read_sessions, who
from rattlesweep.sweeps.stored import open_stored
from rattlesweep.text import clock, counted

ENDED = {
    "complete": "has done all of its runs",
    "stopped": "stopped when its time was up",
    "interrupted": "was interrupted",
    "running": "died without a word",
}


@dataclass(frozen=True)
class Status:
    """What is there of a sweep.

    `data` has ``runs``, ``wanted``, ``files``, ``bytes``, ``status`` and ``types`` (runs by each),
    ``at_work`` (sessions under way) and ``last`` (the session that ended last).
    """

    directory: Path
    name: str
    data: dict[str, Any]
    decides: str | None  # key of the config by which the sweep leaves runs out

    @property
    def done(self) -> bool:
        """Whether all runs are there that are wanted."""
        return bool(self.data["runs"] >= self.data["wanted"])

    @property
    def words(self) -> str:
        """The same for the terminal."""
        data = self.data
        runs = f"{data['runs']:,} of {data['wanted']:,} runs"
        runs += " wanted so far" if self.decides and not self.done else ""
        share, size = data["runs"] / max(1, data["wanted"]), f"{data['bytes'] / 1e6:.1f} MB"
        files = counted(data["files"], "file")
        lines = [f"{self.name} in {self.directory}: {runs} ({100 * share:.1f} %), {files}, {size}"]
        for what in ("status", "types"):
            counts = ", ".join(f"{word} {count:,}" for word, count in data[what].items())
            lines += [f"{what}: {counts}"] if counts else []
        for session in data["at_work"]:
            line = f"at work: {session['shard'] or 'the whole sweep'}, {who(session)}"
            if progress := session.get("progress"):
                line += f": {progress['runs']:,} of {progress['total']:,} runs"
                if progress["left"] is not None:
                    line += f", about {clock(progress['left'])} left"
            lines.append(line)
        if not data["at_work"] and (last := data["last"]) is not None:
            ended = ENDED.get(last["how"], last["how"])
            lines.append(f"nobody is at work; the last session, {who(last)}, {ended}")
        return "\n".join(lines)


def status(directory: Path) -> Status:
    """Count the rows of an output directory, and look who is at work there."""
    stored = open_stored(directory)
    words, types = Counter[str](), Counter[str]()
    for rows in stored.batches(["status", "type"]):
        for name, counter in (("status", words), ("type", types)):
            for entry in rows.column(name).drop_null().value_counts().to_pylist():
                counter[entry["values"]] += entry["counts"]
    wanted = len(stored.cases) * stored.samples
    if (decide := decision(stored.config, stored.cases, stored.samples)) is not None:
        decide.read(stored)
        wanted = int(decide.wanted().sum())
    sessions, held = read_sessions(directory), at_work(directory)
    # Of several of a shard that have not said their end, the last holds its lock, if any does.
    last = {s["shard"]: s for s in sessions if s["how"] == "running"}
    working = [session for shard, session in last.items() if (shard or WHOLE) in held]
    data = {
        "runs": words.total(),
        "wanted": wanted,
        "files": len(stored.files()),
        "bytes": sum(path.stat().st_size for path in stored.files()),
        "status": dict(words.most_common()),
        "types": dict(types.most_common()),
        "at_work": working,
        "last": next((s for s in reversed(sessions) if s not in working), None),
    }
    return Status(directory, str(stored.manifest["name"]), data, decides(stored.config))
