"""The executor of many machines: the workers of a Dask cluster compute blocks.

The driver, which is this process, sends out blocks and writes the tables that come
back, so that workers need no disk in common with it.  When a worker is lost, others
compute its blocks.
"""

from __future__ import annotations

import asyncio
import logging
import pickle
import signal
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, TypedDict

import pyarrow as pa

from rattlesweep.arrays import Integers
from rattlesweep.compiling.loading import program_hash
from rattlesweep.design.plan import Plan
from rattlesweep.kernel.task import POLL, Control, Task
from rattlesweep.kernel.threads import available_threads
from rattlesweep.store.provenance import versions
from rattlesweep.words.errors import ConfigError, OutputError, one_line
from rattlesweep.work.block import load_kernel, prepare_runs, start_block
from rattlesweep.work.job import Job, Keys, OutOfTime
from rattlesweep.work.run import Executor

if TYPE_CHECKING:
    from distributed import Client, Future, Security

BLOCKS_PER_WORKER = 2  # at a time: one is computed while the next is prepared
CONNECT_TIMEOUT = 5.0  # seconds for the first contact with a scheduler
ANSWER_TIMEOUT = 20.0  # seconds for a scheduler's answer, or a table on its way
REFRESH = 2.0  # seconds between two requests for the list of workers
WORKER_TIMEOUT = 120.0  # seconds without any worker
RESUMES = "the same command resumes from there"
# Packages on which the bits of the results depend.
NUMERIC = ("rattlesweep", "numpy", "numba", "llvmlite", "scipy")
LOGGERS = (
    "distributed",
    "distributed.client",
    "tornado",
    "tornado.application",
    "asyncio",
)


class BlockOrder(TypedDict):
    """What all blocks of a sweep have in common."""

    versions: dict[str, str]  # of the driver
    sources: str  # a hash of the driver's
    threads: int | None  # for each block; None for those of the worker
    plan: bytes  # pickled


def make_executor(scheduler: str | None, threads: int | None = None) -> Executor:
    """Return an executor that uses a scheduler's workers, or starts some here."""
    try:
        from distributed import Security

        security = Security.temporary() if scheduler is None else None
    except ImportError as error:
        raise ConfigError(
            f"--executor dask: needs Dask ({error}); `pip install 'rattlesweep[dask]'`"
        ) from None
    for name in LOGGERS:  # errors that matter are raised here, in one sentence
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if scheduler is not None:
        with connected(scheduler):
            pass  # so that an address is refused before the output directory is created

    def executor(job: Job, blocks: Iterator[Keys]) -> None:
        cluster = _embedded(security, threads or 2)
        if scheduler is not None:
            cluster = connected(scheduler)
        with cluster as client:
            # Workers that share this machine's cache then find the kernels compiled.
            loading = Task(lambda _: load_kernel(job.plan.config))
            loading.wait(lambda _: job.tick())
            Driver(job, blocks, client, threads).work()

    return executor


@contextmanager
def connected(address: str) -> Iterator[Client]:
    """Connect to a scheduler that is already running."""
    from distributed import Client
    from distributed.comm import connect
    from distributed.security import Security

    async def shake_hands() -> None:
        arguments = Security().get_connection_args("client")
        async with asyncio.timeout(CONNECT_TIMEOUT):
            comm = await connect(address, timeout=CONNECT_TIMEOUT, **arguments)
            await comm.close()

    try:
        # Dask's client hangs if another program listens there.
        asyncio.run(shake_hands())
        client = Client(address, timeout=ANSWER_TIMEOUT, set_as_default=False)
    except Exception as error:  # the other side may send anything
        raise OutputError(
            f"--scheduler {address}: no Dask scheduler answers there "
            f"({type(error).__name__}); give an address such as tcp://host:8786"
        ) from error
    try:
        yield client
    finally:
        with suppress(OSError, TimeoutError):
            client.close(timeout=5)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C, where the system can, for children that start in the body.

    A terminal sends Ctrl-C to all processes, and those children ignore it.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    # The first child would start the resource tracker, which unblocks Ctrl-C.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _embedded(security: Security | None, threads: int) -> Iterator[Client]:
    """Start workers with `threads` threads each on this machine, protected by TLS."""
    import dask
    from distributed import Client, LocalCluster

    # Without pages about the cluster, which others on this machine could open.
    no_pages = {
        "distributed.scheduler.http.routes": list[str](),
        "distributed.worker.http.routes": list[str](),
    }
    with dask.config.set(no_pages):
        with _interrupts_blocked():
            cluster = LocalCluster(
                n_workers=max(1, available_threads() // threads),
                threads_per_worker=max(2, threads),
                host="127.0.0.1",
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                dashboard_address=None,
                memory_limit=0,
                security=security,
                silence_logs=logging.CRITICAL,
            )
        with cluster, Client(cluster, set_as_default=False) as client:
            yield client


class Driver:
    """Sends out blocks and writes the rows that come back, until all are done."""

    def __init__(
        self, job: Job, blocks: Iterator[Keys], client: Client, threads: int | None
    ) -> None:
        import dask

        self._job = job
        self._blocks = blocks
        self._client = client
        self._threads = threads
        # Blocks sent out, with the worker that each is meant for.
        self._flying: dict[Future, tuple[Keys, str]] = {}
        self._lost: list[Keys] = []  # blocks that were lost with their worker
        self._workers: dict[str, int] = {}  # threads by address
        self._refresh = 0.0  # time of the next list of workers
        self._seen = time.monotonic()  # time when there was a worker
        order: BlockOrder = {
            "versions": versions(),
            "sources": program_hash(),
            "threads": threads,
            "plan": pickle.dumps(job.plan),
        }
        # If all workers that have the result of this task are lost, Dask computes it
        # again.
        quiet = {"distributed.admin.large-graph-warning-threshold": "1TB"}
        with dask.config.set(quiet):
            self._order = client.submit(dict, order, pure=False)

    def work(self) -> None:
        """Keep all workers busy until no block is left."""
        try:
            while True:
                self._look_at_workers()
                self._send()
                if self._workers and not self._flying:
                    return
                time.sleep(POLL)
                self._receive()
                self._job.tick()
        finally:
            self._flying.clear()  # Dask cancels tasks without a reference to a future

    def _look_at_workers(self) -> None:
        """Note who works; raise an OutputError if nobody has for a long time."""
        now = time.monotonic()
        if now >= self._refresh or self._client.status != "running":
            self._workers = _workers(self._client)
            self._refresh = now + REFRESH
        if self._workers:
            self._job.threads = self._threads or max(self._workers.values())
            self._job.begin()
            self._seen = now
        elif now - self._seen > WORKER_TIMEOUT:
            where = self._client.scheduler.address
            raise OutputError(
                f"the scheduler at {where} has had no worker for "
                f"{WORKER_TIMEOUT:.0f} s; start some with `dask worker {where}`, "
                f"and {RESUMES}"
            )

    def _send(self) -> None:
        """Send blocks to the workers that have the fewest."""
        while len(self._flying) < BLOCKS_PER_WORKER * len(self._workers):
            keys = self._lost.pop() if self._lost else next(self._blocks, None)
            if keys is None:
                return
            # Dask itself would send a worker as many blocks as it has threads.
            load = Counter(address for _, address in self._flying.values())
            address = min(self._workers, key=load.__getitem__)
            future = self._client.submit(
                do_block,
                self._order,
                *keys,
                workers=address,
                allow_other_workers=True,
                pure=False,
            )
            self._flying[future] = keys, address

    def _receive(self) -> None:
        """Write the rows of the blocks that are done; keep lost blocks for later."""
        for future in [future for future in self._flying if future.done()]:
            keys, _ = self._flying.pop(future)
            table, seconds = _result(future, keys)
            if len(table) < len(keys[0]):
                self._lost.append(keys)
            else:
                self._job.write(table, seconds)


def _workers(client: Client) -> dict[str, int]:
    """Return the threads of the workers by address."""
    with suppress(OSError, TimeoutError):
        if client.status == "running":
            return dict(client.sync(client.nthreads, callback_timeout=ANSWER_TIMEOUT))
    raise OutputError(
        f"the scheduler at {client.scheduler.address} is lost; completed runs are "
        f"kept, and with a new one {RESUMES}"
    )


_kernel = threading.Lock()  # one kernel at a time in a process


@lru_cache(maxsize=1)
def _unpack(plan: bytes) -> Plan:
    """Return a plan; the bodies that it has drawn are kept for the next block."""
    return pickle.loads(plan)


def do_block(
    order: BlockOrder, case: Integers, sample: Integers
) -> tuple[pa.Table, float]:
    """Compute a block on a worker; return its rows, and the seconds of the kernel."""
    from distributed import Status, get_worker

    worker = get_worker()
    state = worker.state.tasks.get(worker.get_current_task())

    def watch(control: Control | None = None) -> None:
        closing = worker.status in (Status.closing, Status.closed)
        if closing or state is None or state.state == "cancelled":
            raise OutOfTime  # nobody waits for the block any more

    try:
        _check_same_program(order)
        plan = _unpack(order["plan"])
        prepared = prepare_runs(plan, case, sample)
        while not _kernel.acquire(timeout=POLL):
            watch()
        try:
            load_kernel(plan.config)  # not while another thread uses a kernel
            threads = order["threads"] or worker.state.nthreads
            task = start_block(plan, prepared, threads)
            return task.wait(watch), task.seconds
        finally:
            _kernel.release()
    except OutOfTime:
        return pa.table({}), 0.0
    except ConfigError:
        raise
    except Exception as error:
        problem = f"{type(error).__name__}: {error}"
        if isinstance(error, OutputError):
            problem = str(error)
        # Without its cause, which may not be picklable.
        raise OutputError(
            f"the worker at {worker.address} on {socket.gethostname()}: "
            f"{one_line(problem, 500)}"
        ) from None


def _check_same_program(order: BlockOrder) -> None:
    """Raise an OutputError if results would differ from those of the driver."""
    worker = versions()
    driver = order["versions"]
    differences = []
    for name in NUMERIC:
        if worker[name] != driver[name]:
            differences.append(f"{name} {worker[name]} there, {driver[name]} here")
    if not differences and program_hash() != order["sources"]:
        differences.append(
            f"rattlesweep {driver['rattlesweep']} has other sources there than here"
        )
    if differences:
        which = "; ".join(differences)
        raise OutputError(
            f"its results would differ from the driver's: {which}; give all workers "
            "the driver's environment"
        )


def _result(future: Future, keys: Keys) -> tuple[pa.Table, float]:
    """Return what :func:`do_block` returned; no rows if it was lost with its worker."""
    from distributed import CancelledError

    try:
        table, seconds = future.result(timeout=ANSWER_TIMEOUT)
    except (CancelledError, TimeoutError, OSError):
        return pa.table({}), 0.0
    except (ConfigError, OutputError):
        raise
    # Workers are lost again and again, or have another environment.
    except Exception as error:
        problem = one_line(f"{type(error).__name__}: {error}", 200)
        case, sample = keys
        raise OutputError(
            f"the block that begins with case {case[0]}, sample {sample[0]} cannot be "
            f"done ({problem}); the logs of the workers may say why"
        ) from error
    return table, seconds
