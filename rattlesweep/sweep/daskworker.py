"""What a Dask worker does: one block, from its number to its file in the shared directory.

The driver puts a work order into the output directory: the config and what the numbers depend on.
A worker that can read it sees the right directory, and learns everything else from it, so a task
is no more than a path and a number, and its answer a receipt. The order is taken away when the
driver stops, and workers that are at a block then drop it.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import socket
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.integrate.cache import PACKAGE
from rattlesweep.sweep.blocks import Interrupted, finish_block, prepare_block
from rattlesweep.sweep.config import override_config, resolved
from rattlesweep.sweep.errors import OutputError
from rattlesweep.sweep.files import reason, replace_file
from rattlesweep.sweep.local import write_block
from rattlesweep.sweep.plan import make_plan
from rattlesweep.sweep.provenance import identity, machine, versions
from rattlesweep.sweep.receipts import Receipt
from rattlesweep.sweep.session import Opened
from rattlesweep.sweep.store import Store
from rattlesweep.sweep.tables import DamagedError
from rattlesweep.sweep.task import POLL, Task

if TYPE_CHECKING:
    from rattlesweep.sweep.plan import Block, Plan

# Packages whose versions the bits depend on.
NUMERIC = ("numpy", "numba", "llvmlite", "scipy")
# Seconds between two looks at the order while a block is under way.
LOOK_EVERY = 1.0

# One kernel at a time in a process; a second task prepares and writes meanwhile.
_kernel = threading.Lock()
_opening = threading.Lock()


@dataclass(frozen=True)
class Done:
    """A worker's answer, small.

    Attributes
    ----------
    seconds : float or None
        Time of the integration; None if the block was in place.
    cpu : str
        Of the worker's machine.
    """

    receipt: dict[str, Any]
    seconds: float | None
    cpu: str


@cache
def essentials() -> dict[str, str]:
    """What must be equal for the bits to be: this package's source and what it computes with."""
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(path.relative_to(PACKAGE).as_posix().encode())
        digest.update(path.read_bytes())
    known = versions()
    return {
        "rattlesweep": f"{known['rattlesweep']} ({digest.hexdigest()[:12]})",
        **{name: known[name] for name in NUMERIC},
    }


def place_order(opened: Opened, base: Path | None, threads: int | None) -> Path:
    """Write the order for the workers of this session; to be removed when it ends.

    Parameters
    ----------
    threads : int or None
        Threads of a kernel; by default those that the worker says it has.
    """
    order = {
        "config": resolved(opened.plan.config) | {"block_size": opened.plan.block_size},
        "base": None if base is None else str(base),
        "hash": opened.hash_,
        "threads": threads,
        "essentials": essentials(),
        "host": socket.gethostname(),
    }
    path = opened.store.directory.resolve() / f".order-{secrets.token_hex(8)}.json"
    replace_file(path, json.dumps(order).encode())
    return path


def remove_orders(directory: Path) -> None:
    """Remove what killed drivers have left."""
    for path in directory.glob(".order-*.json"):
        with suppress(OSError):
            path.unlink()


def leave_path() -> None:
    """Take the scratch directories of Dask off the path: nothing is imported from them."""
    import dask

    scratch = dask.config.get("temporary-directory")
    sys.path[:] = [path for path in sys.path if not Path(path).is_relative_to(scratch)]


def dask_setup(worker: object) -> None:
    """Called by Dask as a worker of the embedded cluster starts."""
    leave_path()


def do_block(order: str, index: int) -> Done:
    """Do one block, unless it is in place; called by Dask on a worker.

    Parameters
    ----------
    order : str
        Path of the order, in the output directory.
    index : int
        Number of the block.

    Raises
    ------
    OutputError
        This worker cannot do what the driver asks for; says why.
    Interrupted
        The driver has stopped.
    """
    with _opening:
        opened, threads = _open(order)
    block = opened.plan.block(index)
    cpu = machine()["cpu"]
    found = _in_place(opened, block)
    if found is not None:
        return Done(found.dump(), None, cpu)
    watch = _Watch(Path(order))
    threads = threads or _my_threads()
    ready = prepare_block(opened.plan, block)
    while not _kernel.acquire(timeout=POLL):
        watch()
    try:
        task: Task[Mapping[str, Any]] = Task(
            lambda control: finish_block(
                opened.plan.config, *ready, threads=threads, control=control
            )
        )
        columns = task.wait(lambda control: watch())
    finally:
        _kernel.release()
    return Done(write_block(opened, block, columns).dump(), task.seconds, cpu)


@cache
def _open(order: str) -> tuple[Opened, int | None]:
    """The plan of an order, if this worker can follow it."""
    path = Path(order)
    try:
        asked = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise OutputError(
            f"{_me()} does not see {path.parent} as the driver does; workers need the output "
            "directory on a file system that all share, under the same path"
        ) from None
    except (OSError, ValueError) as error:
        raise OutputError(f"{_me()} cannot read {path}: {reason(error)}") from error
    ours = essentials()
    other = [
        f"{name} {ours[name]} there, {version} here"
        for name, version in asked["essentials"].items()
        if ours.get(name) != version
    ]
    if other:
        raise OutputError(
            f"{_me()} would compute other bits: {'; '.join(other)}; give all workers the "
            "environment of the driver"
        )
    base = None if asked["base"] is None else Path(asked["base"])
    plan: Plan = make_plan(override_config(asked["config"], []), base)
    if identity(plan, base) != asked["hash"]:
        raise OutputError(
            f"{_me()} sees another table of bodies than the driver on {asked['host']}"
        )
    return Opened(Store(path.parent), plan, asked["hash"], None, []), asked["threads"]


def _in_place(opened: Opened, block: Block) -> Receipt | None:
    """Receipt of a block that a worker finished before it was lost."""
    try:
        found = opened.store.inspect_block(block.index)
    except DamagedError:
        return None
    return found.receipt if found.note == opened.note(block) else None


class _Watch:
    """Hears a stop: the order is gone, or the worker is being closed."""

    def __init__(self, order: Path) -> None:
        self._order = order
        self._due = time.monotonic() + LOOK_EVERY

    def __call__(self) -> None:
        from distributed import Status, get_worker

        if get_worker().status in (Status.closing, Status.closed):
            raise Interrupted
        if time.monotonic() < self._due:
            return
        self._due = time.monotonic() + LOOK_EVERY
        try:
            # Opened, not only looked up: network file systems answer look-ups from memory.
            with open(self._order, "rb"):
                pass
        except FileNotFoundError:
            raise Interrupted from None
        except OSError:
            pass  # a moment of a network file system


def _my_threads() -> int:
    from distributed import get_worker

    return int(get_worker().state.nthreads)


def _me() -> str:
    from distributed import get_worker

    return f"the worker at {get_worker().address} on {socket.gethostname()}"
