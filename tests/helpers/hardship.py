"""Small sweeps that are killed or hit by faults, and checks of what they leave behind.

Each runs in a process that is forked, within 50 ms, from a server with all modules
loaded.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import pyarrow as pa
from nursery import TINY, become

from rattlesweep.store.parquet import read_parquet
from rattlesweep.store.rows import KEY, open_stored, same_bits
from rattlesweep.work.verify import verify

# With this threshold some runs of the closed form change type.
OTHER_TYPES = "classify.sw_departure=1e-6"


def tiny(folder: Path) -> Path:
    """Write a config of 24 runs, which are four blocks in the nursery."""
    path = folder / "tiny.yaml"
    path.write_text(TINY)
    return path


@dataclass(frozen=True)
class Ended:
    """How a process ended; a negative exit code is the signal that killed it."""

    code: int
    out: str
    err: str

    @property
    def sentence(self) -> bool:
        """Whether standard error explains the failure in one line."""
        lines = []
        for line in self.err.splitlines():
            if not line.startswith(("note: ", "warning: ")):
                lines.append(line)
        is_explained = len(lines) == 1 and lines[0].startswith("error: ")
        return is_explained and "internal error" not in self.err


@cache
def _nursery() -> tuple[Any, Path, Any]:
    """Return the fork server, and a folder and numbers for the output of children."""
    os.environ["RATTLESWEEP_TESTS_NURSERY"] = "1"
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["nursery"])
    return context, Path(tempfile.mkdtemp(prefix="nursery-")), count()


class Child:
    """A `rattlesweep` command in a process of its own.

    Keywords: ``calls``, arguments of `syscalls.Calls`; ``hold``, the number of blocks
    to finish before waiting for SIGUSR1; ``rows``, runs per block; ``bytes``, from
    which on a file is large.
    """

    def __init__(self, *args: Any, **how: Any) -> None:
        context, folder, numbers = _nursery()
        self._out = folder / f"{next(numbers)}"
        texts = [str(a) for a in args]
        self._process = context.Process(
            target=become, args=(texts, self._out, how), daemon=True
        )
        self._process.start()
        self.pid = self._process.pid

    def kill(self, number: int = signal.SIGKILL) -> None:
        """Send a signal; SIGUSR1 releases the blocks that ``hold`` keeps waiting."""
        os.kill(self.pid, number)

    def ended(self) -> bool:
        return not self._process.is_alive()

    def wait(self, seconds: float = 120) -> Ended:
        self._process.join(seconds)
        assert self._process.exitcode is not None, f"still running after {seconds} s"
        # A process that was killed at once has no output files.
        texts = []
        for handle in (1, 2):
            path = self._out.with_suffix(f".{handle}")
            texts.append(path.read_text() if path.exists() else "")
        return Ended(self._process.exitcode, *texts)


def command(*args: Any, **how: Any) -> Ended:
    return Child(*args, **how).wait()


def files_of(directory: Path) -> list[Path]:
    return sorted(directory.glob("runs/[!.]*.parquet"))


def rows_of(directory: Path) -> pa.Table:
    return open_stored(directory).read()


def check_equal(directory: Path, expected: Path) -> None:
    """Check that two directories agree to the last bit, and that one is clean."""
    assert same_bits(rows_of(directory), rows_of(expected))
    summaries = [(d / "summary.parquet").read_bytes() for d in (directory, expected)]
    assert summaries[0] == summaries[1]
    result = verify(directory)
    assert (result.problems, result.missing) == ([], 0)
    names = set()
    for path in directory.rglob("*"):
        name = str(path.relative_to(directory))
        if path.is_file() and not name.startswith((".locks/", "sessions/2")):
            names.add(name)
    rows = {f"runs/{path.name}" for path in files_of(directory)}
    assert names == {"manifest.json", "summary.parquet", *rows}


def check_whole(directory: Path, *expected: Path) -> int:
    """Check that files are intact, and rows are expected and there once; count them."""
    if not (directory / "manifest.json").exists():
        assert not files_of(directory)
        return 0
    # Other programs find no row twice, whenever they look.
    keys = [read_parquet(path, KEY).to_pylist() for path in files_of(directory)]
    seen = [(row["case"], row["sample"]) for rows in keys for row in rows]
    assert len(set(seen)) == len(seen)
    rows = rows_of(directory).to_pylist()
    assert len({(row["case"], row["sample"]) for row in rows}) == len(rows)
    # `repr` tells any two different floats apart.
    known = {repr(row) for table in map(rows_of, expected) for row in table.to_pylist()}
    assert [row for row in rows if repr(row) not in known] == []
    return len(rows)


def wait_until(what: Callable[[], Any], seconds: float = 120) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, f"nothing happened within {seconds} s"
        time.sleep(0.005)
