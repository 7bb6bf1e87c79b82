"""Kills and faults at every system call of a command on its directory.

After each, readers see intact files, and repeating the command gives the expected rows
and summary and leaves nothing else behind.
"""

from __future__ import annotations

import errno
import re
import shutil
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from hardship import (
    OTHER_TYPES,
    Ended,
    check_equal,
    check_whole,
    command,
    files_of,
    tiny,
)
from sweeping import invoke
from syscalls import CHANGES, MAY_FAIL

from rattlesweep.store.parquet import read_parquet, write_parquet
from rattlesweep.store.rows import metadata
from rattlesweep.work import run

GRID = (
    "bodies: {source: grid, base: {preset: GH}, "
    "axes: {theta: {linspace: [0.6, 0.99, 17]}}, refine: {levels: 2}}"
)
SPINS = "spin: {n_i: {linspace: [-0.4, 0.4, 6]}, omega_xy0: 0.01}"
SD = "bodies: {source: sd, samples: 600}"
QUICK_STRIDE = 150  # calls between two that quick tests harm
SCENES = (
    "run",
    "one file",
    "small files",
    "classify",
    "retry",
    "merge",
    "grow",
    "refine",
    "stop",
)
LARGE = 1 << 22  # bytes of a file, as without these tests


@dataclass(frozen=True)
class Scene:
    """A command on the directory ``{out}``, which starts as a copy of `before` each
    time.
    """

    before: Path | None
    args: tuple[Any, ...]
    after: Path
    rows: int = 12
    bytes: int = 1  # of a file that is large

    def begin(self, output: Path) -> None:
        shutil.rmtree(output, ignore_errors=True)
        if self.before is not None:
            shutil.copytree(self.before, output)

    def run(self, output: Path, **how: Any) -> Ended:
        how |= {"rows": self.rows, "bytes": self.bytes}
        return command(*self.arguments(output), **how)

    def arguments(self, output: Path) -> list[str]:
        return [str(text).replace("{out}", str(output)) for text in self.args]


def make_scene(name: str, folder: Path) -> Scene:
    """Make one of `SCENES` on a sweep of two blocks; more blocks repeat the same
    calls.
    """
    config = tiny(folder)
    rows = 12
    if name == "refine":
        _change(config, {"bodies": GRID, "spin": SPINS})
        rows = 20
    elif name == "stop":
        _change(config, {"bodies": SD, "stop": "stop: {fraction: 0.04}"})
        rows = 400
    run = ("run", config, "--output", "{out}", "-q")

    def did(args: tuple[Any, ...], output: Path) -> Path:
        done = Scene(None, args, output, rows).run(output)
        assert done.code == 0, done
        return output

    whole = did(run, folder / "whole")
    if name in ("run", "refine", "stop"):
        return Scene(None, run, whole, rows)
    if name == "one file":
        return Scene(None, run, whole, 5, LARGE)
    if name == "small files":
        before = folder / "small"
        assert Scene(None, run, before, 1).run(before).code == 0
        (before / "summary.parquet").unlink()
        for path in files_of(before)[::7]:
            path.unlink()
        return Scene(before, run, whole, 2, LARGE)
    if name == "merge":
        shards = [did((*run, "--shard", f"{k}/2"), folder / str(k)) for k in range(2)]
        return Scene(None, ("merge", *shards, "--output", "{out}"), whole)
    if name == "classify":
        classify = ("classify", "{out}", "--set", OTHER_TYPES)
        after = did(classify, Path(shutil.copytree(whole, folder / "after")))
        return Scene(whole, classify, after)
    if name == "retry":
        before = Path(shutil.copytree(whole, folder / "failed"))
        fail_some(before)
        return Scene(before, (*run, "--retry-failed"), whole)
    smaller = ("--set", "spin.n_i=0.2", "--set", "bodies.samples=7")
    before = did((*run, *smaller), folder / "smaller")
    return Scene(before, run, did(run, Path(shutil.copytree(before, folder / "after"))))


def _change(config: Path, lines: dict[str, str]) -> None:
    """Replace lines of a config by their keys, or add them."""
    unchanged = []
    for line in config.read_text().splitlines():
        if line.split(":")[0] not in lines:
            unchanged.append(line)
    config.write_text("\n".join([*unchanged, *lines.values()]) + "\n")


def fail_some(directory: Path) -> None:
    """Mark every third run as failed at its limit of steps."""
    for path in files_of(directory):
        table = read_parquet(path)
        columns = table.to_pydict()
        for row, sample in enumerate(columns["sample"]):
            if sample % 3 == 1:
                columns["status"][row] = "step_limit"
                columns["type"][row] = columns["t_r"][row] = None
        write_parquet(pa.table(columns, schema=table.schema), path, metadata(table))


def at_every_call(
    name: str,
    folder: Path,
    kinds: tuple[str, ...],
    judge: Callable[[Ended], bool],
    stride: int,
    **harm: Any,
) -> None:
    """Harm a command at one call after another; each time check, repeat it and check
    again.
    """
    scene = make_scene(name, folder)
    output = folder / "out"
    log = folder / "log"
    scene.begin(output)
    done = scene.run(output, calls={"root": output, "kinds": kinds, "log": log})
    assert done.code == 0, done
    calls = [line for line in log.read_text().splitlines() if line.split()[0] in kinds]
    assert len(calls) > 10
    check_equal(output, scene.after)
    known = [scene.after]
    if scene.before is not None:
        known.append(scene.before)
    # A command of few calls is harmed once at least.
    for at in range(min(stride, len(calls)) // 2, len(calls), stride):
        scene.begin(output)
        done = scene.run(
            output, calls={"root": output, "kinds": kinds, "at": at, **harm}
        )
        where = f"{harm} at call {at}, {calls[at]}: {done}"
        assert judge(done), where
        if output.exists():
            check_whole(output, *known)
        again = scene.run(output)
        assert again.code == 0, (where, again)
        check_equal(output, scene.after)


@pytest.mark.parametrize(
    "stride", [QUICK_STRIDE, pytest.param(1, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("name", SCENES)
def test_killed_at_every_call(name, stride, tmp_path):
    at_every_call(name, tmp_path, CHANGES, lambda done: done.code == -9, stride)


def fails(done: Ended) -> bool:
    """Whether a fault was explained in one line; session records may fail in
    silence.
    """
    return done.code == 0 or (done.code == 1 and done.sentence)


def every_fault() -> Iterator[Any]:
    """Return strides, errors and scenes; quick are one error a scene, in turn."""
    numbers = errno.ENOSPC, errno.EIO
    for place, name in enumerate(SCENES):
        for number in numbers:
            label = f"{name}-{errno.errorcode[number]}"
            is_quick = number == numbers[place % 2]
            marks = [] if is_quick else [pytest.mark.slow]
            yield pytest.param(
                QUICK_STRIDE, number, name, marks=marks, id=f"{label}-some"
            )
            yield pytest.param(
                1, number, name, marks=pytest.mark.slow, id=f"{label}-all"
            )


@pytest.mark.parametrize(("stride", "number", "name"), [*every_fault()])
def test_faults_at_every_call(name, number, stride, tmp_path):
    # A full disk stays full, but an I/O error may happen once and anywhere.
    kinds = MAY_FAIL[number]
    at_every_call(
        name,
        tmp_path,
        kinds,
        fails,
        stride,
        number=number,
        for_good=number == errno.ENOSPC,
    )


@pytest.mark.parametrize(
    "stride", [QUICK_STRIDE, pytest.param(1, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(
    ("number", "code", "word"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")],
)
@pytest.mark.parametrize("name", ["run", "refine"])
def test_stopped_at_every_call(name, number, code, word, stride, tmp_path):
    def stopped(done: Ended) -> bool:
        # The number of runs is unknown at the start and left out at the end.
        message = (
            rf"{word}(; \d+ runs are kept, and the same command resumes from there)?\n"
        )
        return done.code == code and re.fullmatch(message, done.err) is not None

    at_every_call(name, tmp_path, CHANGES, stopped, stride, sent=number)


@pytest.mark.parametrize(
    "name", ["retry", pytest.param("classify by run", marks=pytest.mark.slow)]
)
def test_an_io_error_is_no_damage_and_rows_are_stored_once(name, tmp_path):
    """An error at each read and close of the look after rows have changed."""
    scene = make_scene("retry", tmp_path)
    output = tmp_path / "out"
    if name != "retry":
        changed = (*scene.args[:-1], "--set", OTHER_TYPES)
        after = Path(shutil.copytree(scene.after, tmp_path / "after"))
        scene = Scene(scene.after, changed, after)
        assert scene.run(after).code == 0
    kinds = ("read", "close")
    scene.begin(output)
    log = tmp_path / "log"
    scene.run(output, calls={"root": output, "kinds": kinds, "log": log})
    lines = [x for x in log.read_text().splitlines() if x.split()[0] in kinds]
    files = [place for place, line in enumerate(lines) if "runs/" in line]
    assert len(files) > 20
    for at in files[:: len(files) // 20]:
        scene.begin(output)
        harm = {"root": output, "kinds": kinds, "at": at, "number": errno.EIO}
        done = scene.run(output, calls=harm)
        assert (done.code, done.sentence) == (1, True), (lines[at], done)
        assert "Input/output error" in done.err
        assert not (output / "damaged").exists()
        assert scene.run(output).code == 0
        check_equal(output, scene.after)


def test_damage_that_the_second_look_finds_is_mended(tmp_path, monkeypatch):
    scene = make_scene("retry", tmp_path)
    output = tmp_path / "out"
    scene.begin(output)
    honest = run.rewrite

    def harmful(path: Path, rows: pa.Table, typed: str) -> None:
        honest(path, rows, typed)
        path.write_bytes(path.read_bytes()[:-1] + b"?")

    monkeypatch.setattr(run, "rewrite", harmful)
    result = invoke(*scene.arguments(output))
    assert result.exit_code == 0
    moved = sorted((output / "damaged").iterdir())
    assert len(moved) == len(files_of(scene.before or output))
    assert all(str(path) in result.stderr for path in moved)
    shutil.rmtree(output / "damaged")
    check_equal(output, scene.after)


def test_calls_are_harmed_as_asked_and_files_are_synced(tmp_path):
    """Check `syscalls` itself: without harm the tests above would pass, too."""
    scene = make_scene("run", tmp_path)
    output = tmp_path / "out"
    log = tmp_path / "log"
    calls = {"root": output, "kinds": CHANGES}
    scene.run(output, calls=calls | {"log": log})
    lines = [
        line for line in log.read_text().splitlines() if line.split()[0] in CHANGES
    ]
    at = next(k for k, line in enumerate(lines) if line.startswith("write .case"))
    shutil.rmtree(output)
    assert scene.run(output, calls=calls | {"at": at + 1}).code == -9
    (left,) = output.glob(".*.tmp")
    assert 1000 < left.stat().st_size < 20_000  # half-written
    # A file is synced before its rename, and the folder after it.
    for place, line in enumerate(lines):
        kind, path = line.split()
        if kind == "rename":
            before = [x.split()[0] for x in lines[:place] if x.split()[1] == path]
            assert before[0] == "create"
            assert {*before[1:-1]} == {"write"}
            assert before[-1] == "fsync"
            # Files of rows are written beside their folder, where no reader looks.
            folder = "runs" if path.startswith(".case") else Path(path).parent
            assert lines[place + 1] == f"fsync {folder}"
