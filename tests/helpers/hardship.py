"""Small sweeps that come to harm, and what must be left of them.

Each sweep runs in a process of its own, forked from one that has everything loaded, so that it
takes some 50 ms: hundreds of kills and faults are a matter of seconds. The model is gh, which needs
no kernel; only where the kernel is the point are tests to start the real program.
"""

from __future__ import annotations

import atexit
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import duckdb
import pandas as pd
from rattlesweep.sweeps.old.content_hash import content_hash
from rattlesweep.sweeps.old.verify import verify

from rattlesweep.sweeps.old import sealed as sealedjson

PROGRAM = Path(sys.executable).with_name("rattlesweep")
BLOCKS = 12
TINY = """\
name: tiny
bodies: {source: sd, samples: 12}
spin: {n_i: [-0.1, 0.2], omega_xy0: 0.01}
model: gh
horizon: {t: 1000}
block_size: 2
"""
# At these thresholds some runs of the closed form change their type.
OTHER_TYPES = "classify.sw_departure=1e-6"


def tiny(folder: Path, *lines: str, **changes: Any) -> Path:
    """A config of 12 blocks of two runs; `changes` replace its keys."""
    path = folder / "tiny.yaml"
    text = TINY
    for key, value in changes.items():
        text = "".join(
            f"{key}: {value}\n" if line.startswith(f"{key}:") else line
            for line in text.splitlines(keepends=True)
        )
        assert f"{key}: {value}\n" in text
    path.write_text(text + "".join(f"{line}\n" for line in lines))
    return path


# -- processes that are quick to start ---------------------------------------------------------


@dataclass(frozen=True)
class Ended:
    """How a process ended: exit code, or less than 0 for the signal that killed it."""

    code: int
    out: str
    err: str


class Child:
    """A `rattlesweep` command in a process of its own."""

    def __init__(self, nursery: Nursery, number: int, pid: int, folder: Path) -> None:
        self.pid = pid
        self._nursery, self._number, self._folder = nursery, number, folder

    def kill(self, number: int = signal.SIGKILL) -> None:
        """Send a signal."""
        os.kill(self.pid, number)

    def go_on(self) -> None:
        """Let the blocks go on that ``hold`` keeps back."""
        self.kill(signal.SIGUSR1)

    def ended(self) -> bool:
        """Whether it has ended."""
        return self._nursery.code(self._number, 0) is not None

    def wait(self, seconds: float = 60) -> Ended:
        """Wait for the end."""
        code = self._nursery.code(self._number, seconds)
        assert code is not None, f"no end within {seconds} s"
        out, err = ((self._folder / f"{self._number}.{n}").read_text() for n in ("out", "err"))
        return Ended(code, out, err)


class Nursery:
    """A process with everything loaded, that forks one for each command."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="nursery-"))
        self._process = subprocess.Popen(
            [sys.executable, Path(__file__).with_name("nursery.py"), self.folder, TINY],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        self._codes: dict[int, int] = {}
        self._pids: dict[int, int] = {}
        self._number = 0
        self._rest = b""

    def start(self, *args: Any, **how: Any) -> Child:
        """Start a command.

        Parameters
        ----------
        how
            ``calls``: arguments of `syscalls.Calls`. ``pace``: seconds that each block takes.
            ``hold``: how many blocks are done before `Child.go_on`. ``grace``: seconds that a first
            run is waited for when the time is up.
            ``uid``: user to become. ``fsize``: largest file that may be written, in bytes.
            ``full``: whether standard output takes nothing.
        """
        self._number += 1
        number = self._number
        order = {"number": number, "args": [str(a) for a in args], **how}
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order, default=str).encode() + b"\n")
        self._process.stdin.flush()
        while number not in self._pids:
            self._hear(60)
        return Child(self, number, self._pids[number], self.folder)

    def run(self, *args: Any, **how: Any) -> Ended:
        """Start a command and wait for it."""
        return self.start(*args, **how).wait()

    def code(self, number: int, seconds: float) -> int | None:
        """How a command ended; None if it has not by then."""
        while number not in self._codes and self._hear(seconds):
            pass
        return self._codes.get(number)

    def _hear(self, seconds: float) -> bool:
        assert self._process.stdout is not None
        pipe = self._process.stdout.fileno()
        if not select.select([pipe], [], [], seconds)[0]:
            return False
        data = os.read(pipe, 65536)
        assert data, "the nursery has died"
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            what, number, value = line.split()
            {b"pid": self._pids, b"code": self._codes}[what][int(number)] = int(value)
        return True

    def close(self) -> None:
        """End it, and all that it started."""
        self._process.communicate()


@cache
def nursery() -> Nursery:
    """The one of this test run."""
    made = Nursery()
    atexit.register(made.close)
    return made


# -- what must be left --------------------------------------------------------------------------


@dataclass(frozen=True)
class Reference:
    """A sweep to which nothing has happened."""

    runs: dict[str, bytes]
    summary: bytes
    hash: str

    @classmethod
    def of(cls, directory: Path) -> Reference:
        """Remember a directory."""
        return cls(
            blocks_of(directory),
            (directory / "summary.parquet").read_bytes(),
            content_hash(directory),
        )


def blocks_of(directory: Path) -> dict[str, bytes]:
    """What `runs/*.parquet` matches."""
    return {p.name: p.read_bytes() for p in sorted(directory.glob("runs/*.parquet"))}


# States of `runs` that readers have been shown: most kills leave one that another has left.
_READ: set[int] = set()


def check_whole(directory: Path, *references: Reference) -> int:
    """Every file that readers see is a whole block of one of the sweeps; returns how many."""
    blocks = blocks_of(directory)
    for name, data in blocks.items():
        assert any(r.runs.get(name) == data for r in references), f"{name} is nobody's"
    if blocks and (state := hash(tuple(blocks.items()))) not in _READ:
        keys = [*pd.read_parquet(directory / "runs")[["case", "sample"]].itertuples(index=False)]
        every = duckdb.sql(f"select * from '{directory}/runs/*.parquet'").fetchall()
        assert len(every) == len(keys) == len(set(keys)) == len({row[:2] for row in every})
        _READ.add(state)
    if (directory / "manifest.json").exists():
        manifest(directory)
    return len(blocks)


def check_finished(directory: Path, reference: Reference) -> None:
    """The sweep is what it would have been, to the last bit, and nothing else is there."""
    # Equal bytes, so equal contents: there is no need to hash them anew.
    assert blocks_of(directory) == reference.runs
    assert (directory / "summary.parquet").read_bytes() == reference.summary
    said = manifest(directory)
    assert said["state"] == "complete"
    assert said["blocks"] == len(reference.runs)
    assert list(said["receipts"]) == [str(k) for k in range(len(reference.runs))], said["receipts"]
    problems = verify(directory).problems
    assert problems == [], problems
    files = {"manifest.json", "summary.parquet", "runs", *(f"runs/{n}" for n in reference.runs)}
    assert everything_in(directory) == files, everything_in(directory) ^ files


def check_goes_on(config: Path, directory: Path, reference: Reference) -> None:
    """The same command again ends well, and the sweep is what it would have been."""
    done = nursery().run("run", config, "--output", directory, "-q")
    assert done.code == 0, done
    check_finished(directory, reference)


def everything_in(directory: Path) -> set[str]:
    """Names of all files and folders, hidden ones too; but for the locks, which stay."""
    names = {str(path.relative_to(directory)) for path in directory.rglob("*")}
    return {name for name in names if not name.startswith(".locks")}


def manifest(directory: Path) -> dict[str, Any]:
    """What `manifest.json` says, proved whole."""
    return sealedjson.load((directory / "manifest.json").read_bytes())


def trace(directory: Path, log: Path, *args: Any, kinds: tuple[str, ...]) -> list[str]:
    """Run a command to which nothing happens; the calls it makes of these kinds, in order."""
    log.unlink(missing_ok=True)
    done = nursery().run(*args, calls={"root": directory, "kinds": kinds, "log": log})
    assert done.code in (0, 3), done.err
    assert "Traceback" not in done.err
    lines = log.read_text().splitlines()
    return [line for line in lines if line.split()[0] in kinds]


def one_sentence(err: str) -> bool:
    """Whether a command that failed says so in one line that is a sentence, and no more."""
    lines = [line for line in err.splitlines() if not line.startswith(("note: ", "warning: "))]
    return len(lines) == 1 and lines[0].startswith("error: ") and "internal error" not in err


def wait_until(
    what: Callable[[], Any],
    seconds: float = 60,
    process: subprocess.Popen[str] | None = None,
) -> None:
    """Wait for something to become true, which a process brings about that has not ended."""
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, f"not within {seconds} s"
        assert process is None or process.poll() is None, process.communicate()
        time.sleep(0.002)
