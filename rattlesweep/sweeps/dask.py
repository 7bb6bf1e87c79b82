"""The engine of many machines: the workers of a Dask cluster compute blocks.

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
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from rattlesweep.arrays import Integers
from rattlesweep.errors import ConfigError, OutputError, one_line
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.task import POLL, Task
from rattlesweep.sweeps.block import load_kernel, prepare_runs, start_block
from rattlesweep.sweeps.job import Job, Keys, OutOfTime
from rattlesweep.sweeps.provenance import versions
from rattlesweep.sweeps.run import Engine

if TYPE_CHECKING:
    from distributed import Client, Future

BLOCKS_PER_WORKER = 2  # at a time: one is computed while the next is prepared
CONNECT_TIMEOUT = 5.0  # seconds for the first contact with a scheduler
ANSWER_TIMEOUT = 20.0  # seconds for a scheduler's answer, or a table on its way
REFRESH = 2.0  # seconds between two requests for the list of workers
WORKER_TIMEOUT = 120.0  # seconds without any worker
NUMERIC = (
    "rattlesweep",
    "numpy",
    "numba",
    "llvmlite",
    "scipy",
)  # the bits depend on them
LOGGERS = (
    "distributed",
    "distributed.client",
    "tornado",
    "tornado.application",
    "asyncio",
)


def make_engine(scheduler: str | None, threads: int | None = None) -> Engine:
    """Return an engine that uses the workers of a scheduler, or starts some on this
    machine.
    """
    try:
        from distributed import Security

        security = Security.temporary() if scheduler is None else None
    except ImportError as error:
        raise ConfigError(
            f"--engine dask: needs Dask ({error}); `pip install '.[dask]'`"
        ) from None
    for name in LOGGERS:  # errors that matter are raised here, in one sentence
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if scheduler:
        with connected(scheduler):
            pass  # so that an address is refused before the output directory is created

    def engine(job: Job, blocks: Iterator[Keys]) -> None:
        with (
            connected(scheduler)
            if scheduler
            else embedded(security, threads or 2) as client
        ):
            # Workers that share this machine's cache then find the kernels compiled.
            Task(lambda _: load_kernel(job.plan.config)).wait(lambda _: job.tick())
            _spread(job, blocks, client, threads)

    return engine


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
        asyncio.run(
            shake_hands()
        )  # Dask's client hangs if another program listens there
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
def embedded(security: Any, threads: int) -> Iterator[Client]:
    """Start workers of so many threads on this machine, closed to other users by
    TLS.
    """
    import dask
    from distributed import Client, LocalCluster

    workers = max(1, available_threads() // threads)
    closed = {
        f"distributed.{part}.http.routes": list[str]()
        for part in ("scheduler", "worker")
    }
    # A terminal sends Ctrl-C to all processes.  Children that start while it is blocked
    # ignore it.
    # otherwise the first child starts it, which unblocks it
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    with dask.config.set(closed):
        try:
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=max(2, threads),
                host="127.0.0.1",
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                dashboard_address=None,
                memory_limit=0,
                security=security,
                silence_logs=logging.CRITICAL,
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        with cluster, Client(cluster, set_as_default=False) as client:
            yield client


def _spread(
    job: Job, blocks: Iterator[Keys], client: Client, threads: int | None
) -> None:
    """Send out blocks and write the rows that come back, until all are done."""
    import dask

    flying: dict[
        Future, tuple[Keys, str]
    ] = {}  # blocks sent out, with the worker meant for each
    again: list[Keys] = []  # blocks that were lost with their worker
    workers: dict[str, int] = {}  # threads by address
    refresh, seen = (
        0.0,
        time.monotonic(),
    )  # time of the next list of workers, and of the last one
    order = {"versions": versions(), "threads": threads, "plan": pickle.dumps(job.plan)}
    # If all workers that have the result of this task are lost, Dask computes it again.
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
        shared = client.submit(dict, order, pure=False)
    try:
        while True:
            if (now := time.monotonic()) >= refresh or client.status != "running":
                workers, refresh = _workers(client), now + REFRESH
            if workers:
                job.threads, seen = threads or max(workers.values()), now
                job.begun = job.begun or now
            elif now - seen > WORKER_TIMEOUT:
                where = client.scheduler.address
                raise OutputError(
                    f"the scheduler at {where} has had no worker for "
                    f"{WORKER_TIMEOUT:.0f} s; start some with `dask worker {where}`, "
                    "and the same command resumes from there"
                )
            while len(flying) < BLOCKS_PER_WORKER * len(workers):
                keys = again.pop() if again else next(blocks, None)
                if keys is None:
                    break
                # Dask itself would send a worker as many blocks as it has threads.
                load = Counter(address for _, address in flying.values())
                address = min(workers, key=load.__getitem__)
                future = client.submit(
                    do_block,
                    shared,
                    *keys,
                    workers=address,
                    allow_other_workers=True,
                    pure=False,
                )
                flying[future] = keys, address
            if workers and not flying:
                return
            time.sleep(POLL)
            for future in [future for future in flying if future.done()]:
                keys, _ = flying.pop(future)
                table, seconds = _result(future, keys)
                if len(table) < len(keys[0]):
                    again.append(keys)
                else:
                    job.write(table, seconds)
            job.tick()
    finally:
        flying.clear()  # Dask cancels tasks without a reference to their future


def _workers(client: Client) -> dict[str, int]:
    """Return the threads of the workers by address."""
    with suppress(OSError, TimeoutError):
        if client.status == "running":
            return dict(client.sync(client.nthreads, callback_timeout=ANSWER_TIMEOUT))
    raise OutputError(
        f"the scheduler at {client.scheduler.address} is lost; completed runs are "
        "kept, and with a new one the same command resumes from there"
    )


_kernel = threading.Lock()  # one kernel at a time in a process
_unpack = lru_cache(maxsize=1)(pickle.loads)


def do_block(
    order: dict[str, Any], case: Integers, sample: Integers
) -> tuple[pa.Table, float]:
    """Compute a block on a worker; return its rows, and the seconds of the kernel."""
    from distributed import Status, get_worker

    worker = get_worker()
    state = worker.state.tasks.get(worker.get_current_task())

    def watch(_: Any = None) -> None:
        closing = worker.status in (Status.closing, Status.closed)
        if closing or state is None or state.state == "cancelled":
            raise OutOfTime  # nobody waits for the block any more

    try:
        ours, theirs = versions(), order["versions"]
        if other := [name for name in NUMERIC if ours[name] != theirs[name]]:
            differ = "; ".join(
                f"{name} {ours[name]} there, {theirs[name]} here" for name in other
            )
            told = f"its results would differ in their last bits: {differ}"
            raise OutputError(f"{told}; give all workers the driver's environment")
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
        words = (
            str(error)
            if isinstance(error, OutputError)
            else f"{type(error).__name__}: {error}"
        )
        me = f"the worker at {worker.address} on {socket.gethostname()}"
        raise OutputError(
            f"{me}: {one_line(words, 500)}"
        ) from None  # a cause may not be picklable


def _result(future: Future, keys: Keys) -> tuple[pa.Table, float]:
    """Return what :func:`do_block` returned; no rows if it was lost with its worker."""
    from distributed import CancelledError

    try:
        table, seconds = future.result(timeout=ANSWER_TIMEOUT)
    except (CancelledError, TimeoutError, OSError):
        return pa.table({}), 0.0
    except (ConfigError, OutputError):
        raise
    except (
        Exception
    ) as error:  # workers are lost again and again, or have another environment
        words = one_line(f"{type(error).__name__}: {error}", 200)
        raise OutputError(
            f"the block that begins with case {keys[0][0]}, sample {keys[1][0]} cannot "
            f"be done ({words}); the logs of the workers may say why"
        ) from error
    return table, seconds
