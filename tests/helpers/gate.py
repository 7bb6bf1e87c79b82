"""A gate for the blocks of Dask workers, which preload this module.

A block passes when ``RATTLESWEEP_TESTS_GATE`` contains a file ``open`` or ``ticket``; a
ticket is used up.  Files inside ``RATTLESWEEP_TESTS_CLOSED`` cannot be opened.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from pathlib import Path
from typing import Any

from rattlesweep.kernel.task import Task
from rattlesweep.work import dask
from rattlesweep.work.block import compute

_place = Path(os.environ["RATTLESWEEP_TESTS_GATE"])
_closed = os.environ.get("RATTLESWEEP_TESTS_CLOSED")


def _passes() -> bool:
    if (_place / "open").exists():
        return True
    with contextlib.suppress(FileNotFoundError):
        (_place / "ticket").unlink()
        return True
    return False


def _held(plan: Any, *prepared: Any) -> Any:
    def work(control: Any) -> Any:
        while not _passes() and not control.stopping:
            time.sleep(0.01)
        return compute(plan.config, plan.schema, *prepared, control)

    return Task(work)


def _refuse(event: str, args: tuple[Any, ...]) -> None:
    if event in ("open", "os.listdir", "os.scandir", "os.mkdir") and str(
        args[0]
    ).startswith(str(_closed)):
        raise PermissionError(f"a worker looks at {args[0]}")


dask.start_block = _held
if _closed:
    sys.addaudithook(_refuse)
