"""The server from which `hardship` forks its processes, with all modules loaded."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

from syscalls import Calls

from rattlesweep import cli
from rattlesweep.store import merging
from rattlesweep.work import block, job

ROWS = 6  # runs per block, so that small sweeps have several files
TINY = """\
name: tiny
bodies: {source: sd, samples: 12}
spin: {n_i: [-0.1, 0.2], omega_xy0: 0.01}
model: gh
horizon: {t: 1000}
"""


def warm() -> None:
    """Load everything that a command needs, in the process that is forked."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("warm.yaml").write_text(TINY)
        for args in (
            ("run", "warm.yaml", "--output", "warm"),
            ("classify", "warm"),
            ("merge", "warm", "--output", "merged"),
        ):
            with (
                contextlib.redirect_stdout(io.StringIO()),
                contextlib.redirect_stderr(io.StringIO()),
                contextlib.suppress(SystemExit),
            ):
                cli.main(args)
    # Collections in the children would copy their parent's memory page by page.
    gc.collect()
    gc.freeze()
    gc.disable()


if "RATTLESWEEP_TESTS_NURSERY" in os.environ:
    warm()


def become(args: list[str], out: Path, how: dict[str, Any]) -> None:
    code = 1
    try:
        for handle in (1, 2):
            path = out.with_suffix(f".{handle}")
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), handle)
        # It matters after a power cut, not after a kill, and takes most of the time.
        os.fsync = os.fstat  # type: ignore[assignment]
        job.MAX_BLOCK_RUNS = how.get("rows", ROWS)
        merging.FILE_BYTES = how.get("bytes", 1)  # by default a file for each block
        if "hold" in how:
            _hold(how["hold"])
        if "calls" in how:
            paths = {k: str(v) for k, v in how["calls"].items() if isinstance(v, Path)}
            Calls(**how["calls"] | paths).install()
        sys.argv = ["rattlesweep", *args]
        cli.main(args, prog_name="rattlesweep")
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _hold(blocks: int) -> None:
    """Let some blocks pass and hold the others until SIGUSR1 or a stop."""
    honest = block.compute
    passed: list[None] = []
    released: list[bool] = []
    signal.signal(signal.SIGUSR1, lambda *_: released.append(True))

    def held(
        config: Any, schema: Any, prepared: Any, threads: int, control: Any
    ) -> Any:
        while len(passed) >= blocks and not released:
            if control.stopping:
                return schema.remove_metadata().empty_table()
            time.sleep(0.005)
        passed.append(None)
        return honest(config, schema, prepared, threads, control)

    block.compute = held  # type: ignore[assignment]
