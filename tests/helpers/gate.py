"""Preloaded by the Dask workers of a test: they hold their blocks until the test lets them go on.

A block passes if there is a file ``open`` or ``ticket`` in ``RATTLESWEEP_TESTS_GATE``; a ticket is
taken away.  Whatever lies below ``RATTLESWEEP_TESTS_CLOSED`` cannot be opened.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from pathlib import Path
from typing import Any

from rattlesweep.sweeps import dask
from rattlesweep.sweeps.block import compute

_place = Path(os.environ["RATTLESWEEP_TESTS_GATE"])
_closed = os.environ.get("RATTLESWEEP_TESTS_CLOSED")


def _passes() -> bool:
    if (_place / "open").exists():
        return True
    with contextlib.suppress(FileNotFoundError):
        (_place / "ticket").unlink()
        return True
    return False


def _held(*args: Any) -> Any:
    control = args[-1]
    while not _passes() and not control.stopping:
        time.sleep(0.01)
    return compute(*args)


def _refuse(event: str, args: tuple[Any, ...]) -> None:
    if event in ("open", "os.listdir", "os.scandir", "os.mkdir") and str(args[0]).startswith(
        str(_closed)
    ):
        raise PermissionError(f"a worker looks at {args[0]}")


dask.compute = _held
if _closed:
    sys.addaudithook(_refuse)
