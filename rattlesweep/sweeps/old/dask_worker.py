"""What a Dask worker does: one block, from its number to its file in the shared directory.

The driver puts a work order into the output directory: the config and what the numbers depend on.
A worker that can read it sees the right directory, and learns everything else from it, so a task
is no more than a path and a number, and its answer a receipt. When the driver is asked to stop, it
says so in the order, and workers that are at a block answer with the runs that have ended: only the
driver may write them, for it holds the directory, and a worker may be late. The order is taken away
when the driver ends, and workers that are still at a block then drop it.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import socket
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from rattlesweep.child import PACKAGE
from rattlesweep.errors import OutputError
from rattlesweep.integrate.task import POLL, Task
from rattlesweep.sweeps.block import Interrupted, load_kernel
from rattlesweep.sweeps.plan import Plan, make_plan
from rattlesweep.sweeps.config.load import override_config, resolved
from rattlesweep.sweeps.old.remainder import Columns, Remainder, gather
from rattlesweep.sweeps.files import reason, replace_file
from rattlesweep.sweeps.old.manifest import Receipt
from rattlesweep.sweeps.old.output import Output
from rattlesweep.sweeps.provenance import identity, machine, versions
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.old.stored import Staged

# Packages whose versions the bits depend on.
NUMERIC = ("numpy", "numba", "llvmlite", "scipy")
# Seconds between two looks at the order while a block is under way.
LOOK_EVERY = 1.0

# One kernel at a time in a process; a second task prepares and writes meanwhile.
_kernel = threading.Lock()
_opening = threading.Lock()


@dataclass(frozen=True)
class Answer:
    """What a worker says of a block: small, unless a stop has left a part of it."""

    cpu: str  # of the worker's machine
    receipt: Receipt | None = None  # None if the block was stopped
    rows: int = 0  # integrated
    seconds: float | None = None  # of the integration; None if the block was in place
    columns: Columns | None = None  # of the runs that had ended when it was stopped
    lost: int = 0  # runs that had begun but not ended


class _Stopped(Exception):
    """The driver was asked to stop, and waits for what there is."""


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


def place_order(output: Output, threads: int | None) -> Path:
    """Write the order for the workers of this session; to be removed when it ends.

    A kernel is to have so many threads, by default those that the worker says it has.
    """
    order = {
        "config": resolved(output.plan.config),
        "base": None if output.base is None else str(output.base),
        "hash": output.hash_,
        "threads": threads,
        "retry_failed": output.retry_failed,
        "essentials": essentials(),
        "host": socket.gethostname(),
    }
    path = output.store.directory.resolve() / f".order-{secrets.token_hex(8)}.json"
    replace_file(path, json.dumps(order).encode())
    return path


def call_off(order: Path) -> None:
    """Tell the workers to answer with what they have."""
    replace_file(order, b"stop")


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


def do_block(order: str, index: int, begun: bool = False) -> Answer:
    """Do one block, unless it is in place; called by Dask on a worker.

    `order` is the path of the order, and `begun` says whether rows of the block are there. Raises
    OutputError if this worker cannot do what is asked for, Interrupted if the driver has ended.
    """
    from distributed import get_worker

    with _opening:
        output, threads = _open(order)
    block, cpu = output.plan.block(index), machine()["cpu"]
    if not begun and (there := output.finished(block)) is not None:
        return Answer(cpu, there, block.rows)  # by a worker that was lost
    watch = _Watch(Path(order))
    part = Remainder.prepare(output, block, begun)
    task: Task[Columns] | None = None
    try:
        while not _kernel.acquire(timeout=POLL):
            watch()
        try:
            # Not while another thread uses a kernel, nor as a part of the integration's time.
            load_kernel(output.plan.config)
            task = part.integrate(threads or get_worker().state.nthreads)
            columns = task.wait(lambda control: watch())
        finally:
            _kernel.release()
    except _Stopped:
        if task is None:
            return Answer(cpu)
        some, lost = gather(task)
        rows = 0 if some is None else len(some["case"])
        return Answer(cpu, None, rows, task.seconds, some, lost)
    return Answer(cpu, part.write(columns), part.rows, task.seconds)


@cache
def _open(order: str) -> tuple[Output, int | None]:
    """The plan of an order, if this worker can follow it."""
    path = Path(order)
    try:
        text = path.read_bytes()
        if text == b"stop":
            raise Interrupted
        asked = json.loads(text)
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
    store = Store(path.parent)
    staged = Staged(store, plan.config, len(plan.cases), plan.samples, asked["hash"])
    output = Output(store, staged.of(plan), base, asked["hash"], retry_failed=asked["retry_failed"])
    return output, asked["threads"]


class _Watch:
    """Hears a stop: the order says so or is gone, or the worker is being closed."""

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
            with open(self._order, "rb") as file:
                stop = file.read(4) == b"stop"
        except FileNotFoundError:
            raise Interrupted from None
        except OSError:
            return  # a moment of a network file system
        if stop:
            raise _Stopped


def _me() -> str:
    from distributed import get_worker

    return f"the worker at {get_worker().address} on {socket.gethostname()}"
