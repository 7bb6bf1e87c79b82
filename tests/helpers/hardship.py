"""Small sweeps that come to harm, and what must be left of them.

Each command runs in a process of its own, forked from one that has everything loaded, so that it
takes some 50 ms: hundreds of kills and faults are a matter of seconds.
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

import numpy as np
import pyarrow as pa

from rattlesweep.sweeps.stored import files_of, open_stored, pieces
from rattlesweep.sweeps.verify import same_bits, verify

TINY = """\
name: tiny
bodies: {source: sd, samples: 12}
spin: {n_i: [-0.1, 0.2], omega_xy0: 0.01}
model: gh
horizon: {t: 1000}
"""
# At these thresholds some runs of the closed form change their type.
OTHER_TYPES = "classify.sw_departure=1e-6"


def tiny(folder: Path, *lines: str) -> Path:
    """A config of 24 runs: four blocks in the nursery."""
    path = folder / "tiny.yaml"
    path.write_text(TINY + "".join(f"{line}\n" for line in lines))
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

    def __init__(self, nursery: Nursery, number: int, pid: int) -> None:
        self.pid, self._nursery, self._number = pid, nursery, number

    def kill(self, number: int = signal.SIGKILL) -> None:
        """Send a signal; SIGUSR1 lets the blocks go on that ``hold`` keeps back."""
        os.kill(self.pid, number)

    def ended(self) -> bool:
        """Whether it has ended."""
        return self._nursery.code(self._number, 0) is not None

    def wait(self, seconds: float = 120) -> Ended:
        """Wait for the end."""
        code = self._nursery.code(self._number, seconds)
        assert code is not None, f"no end within {seconds} s"
        folder = self._nursery.folder
        paths = [folder / f"{self._number}.{name}" for name in ("out", "err")]
        # Killed at once, it has not made them.
        out, err = (path.read_text() if path.exists() else "" for path in paths)
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

        `how`: ``calls``, arguments of `syscalls.Calls`; ``hold``, how many blocks are done before a
        SIGUSR1; ``grace``, seconds that a first run is waited for when the time is up; ``rows``,
        runs of a block.
        """
        self._number += 1
        number = self._number
        order = {"number": number, "args": [str(a) for a in args], **how}
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order, default=str).encode() + b"\n")
        self._process.stdin.flush()
        while number not in self._pids:
            assert self._hear(60), "the nursery does not answer"
        return Child(self, number, self._pids[number])

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
        try:
            self._process.communicate(timeout=30)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)


@cache
def nursery() -> Nursery:
    """The one of this test run."""
    made = Nursery()
    atexit.register(made.close)
    return made


# -- what must be left --------------------------------------------------------------------------


def rows_of(directory: Path) -> pa.Table:
    """All rows in the order of their keys."""
    return open_stored(directory).read()


def check_equal(directory: Path, expected: Path) -> None:
    """Rows and summary are equal to the last bit, all is whole, and nothing else is there."""
    assert same_bits(rows_of(directory), rows_of(expected))
    summaries = [(d / "summary.parquet").read_bytes() for d in (directory, expected)]
    assert summaries[0] == summaries[1]
    found = verify(directory)
    assert (found.problems, found.missing) == ([], 0)
    left = {str(p.relative_to(directory)) for p in directory.rglob("*") if p.is_file()}
    left = {name for name in left if not name.startswith((".locks/", "sessions/2"))}
    names = {f"runs/{path.name}" for path in files_of(directory)}
    assert left == {"manifest.json", "summary.parquet", *names}


def check_whole(directory: Path, *expected: Path) -> int:
    """Each file that readers see is whole, no run is there twice, and each row is one of those of
    other directories; return how many rows there are.
    """
    if (directory / "manifest.json").exists():
        open_stored(directory)
    if not (tables := list(pieces(files_of(directory)))):
        return 0
    rows = pa.concat_tables(tables)
    keys = keys_of(rows)
    assert len(set(keys)) == len(keys)
    good = np.zeros(len(rows), bool)
    for table in map(rows_of, expected):
        place = {key: k for k, key in enumerate(keys_of(table))}
        if place.keys() >= {*keys} and same_bits(rows, table.take([place[key] for key in keys])):
            return len(keys)
        for k, key in enumerate(keys):
            good[k] |= key in place and same_bits(rows.slice(k, 1), table.slice(place[key], 1))
    assert good.all(), [key for key, fine in zip(keys, good, strict=True) if not fine]
    return len(keys)


def keys_of(rows: pa.Table) -> list[tuple[int, int]]:
    """Case and sample of each row."""
    return list(zip(rows["case"].to_pylist(), rows["sample"].to_pylist(), strict=True))


def one_sentence(err: str) -> bool:
    """Whether a command that failed says so in one line that is a sentence, and no more."""
    lines = [line for line in err.splitlines() if not line.startswith(("note: ", "warning: "))]
    return len(lines) == 1 and lines[0].startswith("error: ") and "internal error" not in err


def wait_until(what: Callable[[], Any], seconds: float = 120) -> None:
    """Wait for something to become true."""
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, f"not within {seconds} s"
        time.sleep(0.005)
