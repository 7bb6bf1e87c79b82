"""The engine of many machines: a Dask cluster works off the blocks.

The driver holds the directory, hands out blocks, a few more than there are workers, and keeps the
receipts. Which worker does a block, and what happens to the blocks of one that is lost, is left
to Dask's scheduler; a block done twice is the same file twice.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.integrate.task import POLL
from rattlesweep.sweeps.block import Interrupted, load_kernel
from rattlesweep.sweeps.plan import Block
from rattlesweep.sweeps.old.dask_cluster import ANSWER, embedded, existing, quiet, reach
from rattlesweep.sweeps.old.dask_worker import (
    Answer,
    call_off,
    do_block,
    place_order,
    remove_orders,
)
from rattlesweep.sweeps.old.remainder import GATHER
from rattlesweep.sweeps.old.session import Session
from rattlesweep.sweeps.provenance import machine

if TYPE_CHECKING:
    from distributed import Client, Future

AHEAD = 2  # blocks handed out for each worker: one under way, one ready
# Seconds in which a lost scheduler may come back.
RETURN = 8.0
# Seconds for which there may be no worker.
WORKERLESS = 120.0
# Dask gives a block up after four lost workers; it is handed out this often.
ATTEMPTS = 2
COUNT_EVERY = 2.0


def make_engine(
    scheduler: str | None = None, workers: int | None = None, threads: int | None = None
) -> Callable[[Session], None]:
    """Engine for :func:`rattlesweep.sweeps.old.run.run_sweep`.

    Parameters
    ----------
    scheduler : str, optional
        Address of a scheduler that exists; by default a cluster of processes on this machine, which
        lives as long as the sweep.
    workers : int, optional
        Processes of that cluster; by default as many as fill the machine.
    threads : int, optional
        Threads of a worker's kernel; by default 1 in that cluster, elsewhere as many as the worker
        was given (``dask worker --nthreads``).
    """
    try:
        import cryptography  # noqa: F401
        import distributed  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            f"--engine dask: needs Dask ({error}); install it with "
            "`pip install 'rattlesweep[dask]'`"
        ) from None
    if scheduler is not None and workers is not None:
        raise ConfigError("--workers: the workers of --scheduler are those that it has")

    def work_off(session: Session) -> None:
        if scheduler is not None:
            reach(scheduler)
        # Workers on this machine, or on others that share its cache, then find the kernel compiled.
        session.result.load_seconds = load_kernel(session.plan.config)
        with ExitStack() as stack:
            stack.enter_context(quiet())
            if scheduler is None:
                client = stack.enter_context(embedded(workers, threads or 1))
            else:
                client = stack.enter_context(existing(scheduler))
            directory = session.store.directory
            if session.shard is None:
                remove_orders(directory.resolve())
            order = place_order(session.output, threads or (None if scheduler else 1))
            # Taken away first: workers hear it and drop their blocks.
            stack.callback(order.unlink, missing_ok=True)
            _Driver(session, client, order).work_off()

    return work_off


class _Driver:
    """Hands out blocks and keeps their receipts."""

    def __init__(self, session: Session, client: Client, order: Path) -> None:
        from distributed import as_completed

        self._session, self._client, self._order = session, client, order
        costs = session.costs
        # The dearest first, so that no worker begins one when the others are done.
        blocks = sorted(session.pending, key=lambda block: (-costs.of(block), block.index))
        self._pending = deque(blocks)
        self._flying: dict[Future, Block] = {}
        self._completed = as_completed(loop=client.loop)
        self._killed: Counter[int] = Counter()
        self._workers = 0
        self._due = 0.0
        self._seen = time.monotonic()
        self._cpus = {machine()["cpu"]}

    def work_off(self) -> None:
        """Have all pending blocks done, or as many as there is time for."""
        try:
            self._work_off()
        except BaseException as error:
            # A request, not an error: what has ended is kept.
            if not isinstance(error, Exception):
                self._call_off()
            raise
        if self._pending or self._flying:
            self._call_off()
            self._session.stop()

    def _work_off(self) -> None:
        session = self._session
        while self._pending or self._flying:
            self._connected()
            self._count()
            self._hand_out()
            if session.too_late(session.result.done > 0 or not self._workers):
                break
            time.sleep(POLL)
            for future in self._completed.next_batch(block=False):
                self._look_at(self._flying.pop(future), future)
            session.tick()

    def _call_off(self) -> None:
        """Keep what the workers have of the blocks under way."""
        if not self._flying:
            return
        call_off(self._order)
        end = time.monotonic() + GATHER
        while self._flying and time.monotonic() < end and self._client.status == "running":
            for future in self._completed.next_batch(block=False):
                block = self._flying.pop(future)
                with suppress(Exception):  # a worker that could not do it has nothing
                    self._keep(block, future.result(timeout=ANSWER))
            time.sleep(POLL)

    def _hand_out(self) -> None:
        # Not all at once: a worker would take as many blocks as it has threads, and its kernel
        # works on one at a time.
        while self._pending and len(self._flying) < AHEAD * self._workers:
            block = self._pending.popleft()
            self._session.forget([block.index])
            future = self._client.submit(
                do_block,
                str(self._order),
                block.index,
                block.index in self._session.begun,
                pure=False,
            )
            self._flying[future] = block
            self._completed.add(future)

    def _count(self) -> None:
        """Count the workers, now and then."""
        from distributed import TimeoutError as Late

        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + COUNT_EVERY
        try:
            cores = self._client.sync(self._client.scheduler.ncores, callback_timeout=ANSWER)
        except (OSError, Late) as error:
            raise self._scheduler_lost() from error
        if cores and self._session.tracker.begun is None:
            self._session.tracker.begin()
        if self._workers or cores:
            self._seen = now
        elif now - self._seen > WORKERLESS:
            where = self._client.scheduler.address
            raise OutputError(
                f"the scheduler at {where} has had no worker for {WORKERLESS:.0f} s; start "
                f"some with `dask worker {where}`, and the same command resumes from there"
            )
        self._workers = len(cores)

    def _connected(self) -> None:
        """Wait while Dask tries to find a lost scheduler again."""
        client = self._client
        end = time.monotonic() + RETURN
        while client.status == "connecting" and time.monotonic() < end:
            time.sleep(POLL)
            self._session.tick()
            if self._session.too_late():
                return
        if client.status != "running":
            raise self._scheduler_lost()

    def _scheduler_lost(self) -> OutputError:
        return OutputError(
            f"the scheduler at {self._client.scheduler.address} is lost; completed work is kept, "
            "and with a new one the same command resumes from there"
        )

    def _look_at(self, block: Block, future: Future) -> None:
        from distributed import CancelledError, KilledWorker
        from distributed import TimeoutError as Late

        try:
            answer = future.result(timeout=ANSWER)
        except KilledWorker as error:
            self._killed[block.index] += 1
            if self._killed[block.index] >= ATTEMPTS:
                raise OutputError(
                    f"block {block.index} is given up: workers that have it are lost again and "
                    f"again, the last one was {error.last_worker.address}; their logs say why, "
                    "want of memory perhaps, which a smaller block_size in a new output avoids"
                ) from error
            self._pending.append(block)
        except (CancelledError, Interrupted, Late, OSError):
            # The scheduler was lost and found again; the worker was told to close; or it is lost or
            # silent and its receipt with it, but the block may be there: the next one finds it.
            self._pending.append(block)
        except ModuleNotFoundError as error:
            raise OutputError(
                f"a worker cannot import rattlesweep ({error}); give all workers the environment "
                "of the driver"
            ) from error
        else:
            self._keep(block, answer)

    def _keep(self, block: Block, answer: Answer) -> None:
        session = self._session
        session.result.lost += answer.lost
        receipt = answer.receipt
        if receipt is None:
            if answer.columns is None or session.output.finished(block):
                return
            receipt = session.prepare(block).write(answer.columns)
        session.wrote(block, receipt, answer.rows, answer.seconds)
        if answer.cpu not in self._cpus:
            self._cpus.add(answer.cpu)
            session.result.remarks.append(
                f"workers have other processors ({answer.cpu}) than the driver: last bits may "
                "differ"
            )
