"""A process with everything loaded, that forks one for each command it is told; see `hardship`."""

from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import resource
import select
import signal
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from syscalls import Calls

from rattlesweep import cli
from rattlesweep.sweeps.old import remainder, session


def _serve(folder: Path, config: str) -> None:
    """Fork a process for each line of standard input; say what becomes of it."""
    answers = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    _warm_up(folder, config)
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
            pid, status = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                break
            code = os.waitstatus_to_exitcode(status)
            os.write(answers, f"code {at_work.pop(pid)} {code}\n".encode())
    for pid in at_work:
        os.kill(pid, signal.SIGKILL)


def _warm_up(folder: Path, config: str) -> None:
    """Load what the commands load late."""
    output = folder / "warm"
    (folder / "warm.yaml").write_text(config)
    commands = (
        ["run", str(folder / "warm.yaml"), "--output", str(output), "--retry-failed"],
        ["classify", str(output), "--set", "classify.sw_departure=0.5"],
        ["merge", str(output), "--output", str(folder / "merged")],
        ["verify", str(output)],
    )
    for args in commands:
        with contextlib.redirect_stderr(io.StringIO()):
            cli.main(args, standalone_mode=False)


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
    if "uid" in order:
        os.setgroups([])
        os.setgid(order["uid"])
        os.setuid(order["uid"])
    if order.get("full"):
        os.dup2(os.open("/dev/full", os.O_WRONLY), 1)
        # As Python has it, whatever PYTHONUNBUFFERED says here.
        sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
    if "fsize" in order:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (order["fsize"],) * 2)
    session.GRACE = order.get("grace", session.GRACE)
    if "pace" in order:
        finish = remainder.finish_block

        def slowly(*args: Any, control: Any, **kwargs: Any) -> Any:
            end = time.monotonic() + order["pace"]
            while time.monotonic() < end and not control.stopping:
                time.sleep(0.005)
            if control.stopping:
                raise remainder.Interrupted
            return finish(*args, control=control, **kwargs)

        remainder.finish_block = slowly
    if "hold" in order:
        honest, passed, released = remainder.finish_block, [], []
        signal.signal(signal.SIGUSR1, lambda *_: released.append(True))

        def held(*args: Any, control: Any, **kwargs: Any) -> Any:
            while len(passed) >= order["hold"] and not released:
                if control.stopping:
                    raise remainder.Interrupted
                time.sleep(0.005)
            passed.append(None)
            return honest(*args, control=control, **kwargs)

        remainder.finish_block = held
    if "calls" in order:
        calls = dict(order["calls"])
        log = calls.pop("log", None)
        root = Path(calls.pop("root"))
        kinds = tuple(calls.pop("kinds"))
        Calls(root, kinds, log=None if log is None else Path(log), **calls).install()


if __name__ == "__main__":
    _serve(Path(sys.argv[1]), sys.argv[2])
    os._exit(0)
