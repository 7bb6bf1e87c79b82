"""How far a sweep is: its rows are counted, and who works on it says how far that is."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rattlesweep.durations import clock
from rattlesweep.sweeps.decide import decides, decision
from rattlesweep.sweeps.locks import FOLDER, WHOLE, at_work
from rattlesweep.sweeps.sessions import read_sessions
from rattlesweep.sweeps.stored import Stored, open_stored
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
        share = 100 * data["runs"] / max(1, data["wanted"])
        so_far = " wanted so far" if self.decides and not self.done else ""
        lines = [
            f"{self.name} in {self.directory}: {data['runs']:,} of {data['wanted']:,} runs"
            f"{so_far} ({share:.1f} %), {counted(data['files'], 'file')}, "
            f"{data['bytes'] / 1e6:.1f} MB"
        ]
        for what in ("status", "types"):
            if data[what]:
                counts = ", ".join(f"{word} {count:,}" for word, count in data[what].items())
                lines.append(f"{what}: {counts}")
        for session in data["at_work"]:
            lines.append(f"at work: {_who(session)}{_how_far(session)}")
        if not data["at_work"] and (last := data["last"]) is not None:
            how = last["how"] if last["how"] != "running" else "died without a word"
            lines.append(f"nobody is at work; the last session, {_who(last)}, {_ended(how)}")
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
    counts, types = Counter[str](), Counter[str]()
    runs = 0
    for path in files:
        rows = stored.runs.table(path, ["status", "type"])
        runs += len(rows)
        for name, counter in (("status", counts), ("type", types)):
            for entry in rows.column(name).value_counts().to_pylist():
                if entry["values"] is not None:
                    counter[entry["values"]] += entry["counts"]
    sessions = read_sessions(directory)
    # Of several that died without a word or live, the last of each share holds its lock.
    last = {session.get("share"): session for session in sessions if _runs(session)}
    working = [session for session in last.values() if _is_at_work(stored, session)]
    ended = [session for session in sessions if session not in working]
    data = {
        "runs": runs,
        "wanted": _wanted(stored),
        "files": len(files),
        "bytes": sum(path.stat().st_size for path in files),
        "status": dict(counts.most_common()),
        "types": dict(types.most_common()),
        "at_work": working,
        "last": ended[-1] if ended else None,
    }
    return Status(directory, str(stored.manifest["name"]), data, decides(stored.config))


def _wanted(stored: Stored) -> int:
    decide = decision(stored.config, stored.cases, stored.samples)
    if decide is None:
        return len(stored.cases) * stored.samples
    decide.read(stored)
    return int(decide.wanted().sum())


def _runs(session: dict[str, Any]) -> bool:
    return session.get("how") == "running"


def _is_at_work(stored: Stored, session: dict[str, Any]) -> bool:
    """Return whether the process of a session lives, by the lock that it would hold."""
    share = session.get("share")
    lock = stored.directory / FOLDER / (share or WHOLE)
    return lock.exists() and at_work(lock)


def _who(session: dict[str, Any]) -> str:
    share = session.get("share")
    of = "" if share is None else f" for {share}"
    return (
        f"`{session.get('command')}`{of} (process {session.get('pid')} on {session.get('host')}, "
        f"since {str(session.get('started'))[:19]} UTC)"
    )


def _how_far(session: dict[str, Any]) -> str:
    progress = session.get("progress")
    if not isinstance(progress, dict):
        return ""
    what = "" if session.get("share") is None else " of its share"
    left = progress.get("left")
    return (
        f": {progress['runs']:,} of {progress['total']:,} runs{what}, those under way included"
        f"{'' if left is None else f', about {clock(left)} left'}"
    )


def _ended(how: str) -> str:
    words = {"complete": "has done all of its runs", "stopped": "stopped when its time was up"}
    return words.get(how, f"was {how}" if how == "interrupted" else how)
