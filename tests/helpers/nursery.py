"""A process with everything loaded, that forks one for each command it is told; see `hardship`."""

from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import select
import signal
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from syscalls import Calls

from rattlesweep import cli
from rattlesweep.sweeps import run as runner

ROWS = 6
"""Runs of a block, so that small sweeps have several files."""


def _serve(folder: Path, config: str) -> None:
    """Fork a process for each line of standard input; say what becomes of it."""
    answers = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    (folder / "warm.yaml").write_text(config)
    for args in (("run", "warm.yaml", "--output", "warm"), ("classify", "warm"),
                 ("merge", "warm", "--output", "merged")):  # fmt: skip
        paths = [str(folder / a) if a.startswith(("warm", "merged")) else a for a in args]
        with contextlib.redirect_stderr(io.StringIO()), contextlib.suppress(SystemExit):
            cli.main(paths)
    # Children that count references in memory of their parent's would copy it, page by page.
    gc.collect()
    gc.freeze()
    gc.disable()
    at_work: dict[int, int] = {}
    rest = b""
    while True:
        if select.select([0], [], [], 0.002 if at_work else None)[0]:
            data = os.read(0, 65536)
            if not data:
                break
            *lines, rest = (rest + data).split(b"\n")
            for order in map(json.loads, lines):
                pid = os.fork()
                if pid == 0:
                    _become(order, folder)
                at_work[pid] = order["number"]
                os.write(answers, f"pid {order['number']} {pid}\n".encode())
        while at_work:
            pid, ended = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                break
            code = os.waitstatus_to_exitcode(ended)
            os.write(answers, f"code {at_work.pop(pid)} {code}\n".encode())
    for pid in at_work:
        os.kill(pid, signal.SIGKILL)


def _become(order: dict[str, Any], folder: Path) -> None:
    """Be the process of a command, to its end."""
    code = 1
    try:
        for handle, name in ((1, "out"), (2, "err")):
            path = folder / f"{order['number']}.{name}"
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), handle)
        _prepare(order)
        sys.argv = ["rattlesweep", *order["args"]]
        cli.main(order["args"], prog_name="rattlesweep")
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _prepare(order: dict[str, Any]) -> None:
    # A kill of the process takes nothing from the system's memory: whether that is on the disk
    # is a question of power cuts, and costs most of the time.
    os.fsync = os.fstat  # type: ignore[assignment]
    runner.MOST_ROWS, runner.GRACE = order.get("rows", ROWS), order.get("grace", runner.GRACE)
    if "hold" in order:
        _hold(order["hold"])
    if "calls" in order:
        Calls(**order["calls"]).install()


def _hold(blocks: int) -> None:
    """Let so many blocks pass, and the others wait for SIGUSR1 or a stop."""
    honest, passed, released = runner.compute, [], []
    signal.signal(signal.SIGUSR1, lambda *_: released.append(True))

    def held(config: Any, schema: Any, prepared: Any, threads: int, control: Any) -> Any:
        while len(passed) >= blocks and not released:
            if control.stopping:
                return schema.remove_metadata().empty_table(), 0
            time.sleep(0.005)
        passed.append(None)
        return honest(config, schema, prepared, threads, control)

    runner.compute = held  # type: ignore[assignment]


if __name__ == "__main__":
    _serve(Path(sys.argv[1]), sys.argv[2])
    os._exit(0)
