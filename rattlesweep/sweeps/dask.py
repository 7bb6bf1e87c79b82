"""The engine of many machines: the workers of a Dask cluster compute blocks.

The driver, which is this process, hands out blocks, a few more than there are workers, and writes
the tables that come back, so that workers need no disk in common with it.  The blocks of a worker
that is lost are done by another: a block depends on its keys alone.
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
from contextlib import ExitStack, contextmanager, suppress
from functools import lru_cache, partial
from multiprocessing import resource_tracker
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from rattlesweep.arrays import Integers
from rattlesweep.errors import ConfigError, OutputError, one_line
from rattlesweep.integrate.batch import Control, available_threads
from rattlesweep.integrate.task import POLL, Task
from rattlesweep.sweeps.block import compute, load_kernel, prepare_runs
from rattlesweep.sweeps.job import Engine, Job, Keys
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.provenance import versions

if TYPE_CHECKING:
    from distributed import Client, Future

AHEAD = 2  # blocks of a worker: one under way, and one that is prepared meanwhile
# Times in seconds.
REACH = 5.0  # within which a scheduler must be reached
ANSWER = 20.0  # after which a scheduler, or a table on its way, is given up
SILENCE = 30  # after which the embedded cluster replaces a worker
LOOK_EVERY = 2.0  # between two looks at the workers
WORKERLESS = 120.0  # for which there may be no worker
NUMERIC = ("rattlesweep", "numpy", "numba", "llvmlite", "scipy")  # the bits depend on them
LOGGERS = ("distributed", "distributed.client", "tornado", "tornado.application", "asyncio")


def make_engine(
    scheduler: str | None = None, workers: int | None = None, threads: int | None = None
) -> Engine:
    """Return an engine for :func:`rattlesweep.sweeps.run.run_sweep`.

    A stop loses the blocks under way, a few seconds of work, and frees the workers.

    Parameters
    ----------
    scheduler : str, optional
        Address of a scheduler, such as ``tcp://host:8786``; by default a cluster of processes on
        this machine is started, which lives as long as the session.
    workers : int, optional
        Processes of that cluster; by default as many as fill the machine.
    threads : int, optional
        Threads of a worker's kernel; by default 1 in that cluster, elsewhere as many as the worker
        was given (``dask worker --nthreads``).

    Raises
    ------
    ConfigError
        If Dask is missing, or if both `scheduler` and `workers` are given.
    """
    try:
        import cryptography  # noqa: F401
        import distributed  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            f"--engine dask: needs Dask ({error}); install it with `pip install '.[dask]'`"
        ) from None
    if scheduler is not None and workers is not None:
        raise ConfigError("--workers: the workers of --scheduler are those that it has")
    for name in LOGGERS:  # what matters is said in one sentence
        logging.getLogger(name).setLevel(logging.CRITICAL)
    driver: _Driver | None = None

    def engine(job: Job, blocks: Iterator[Keys]) -> None:
        nonlocal driver
        if driver is None or driver.job is not job:  # else this is the session's next wave
            cluster = existing(scheduler) if scheduler else embedded(workers, threads or 1)
            client = job.resources.enter_context(cluster)
            driver = _Driver(job, client, threads or (None if scheduler else 1))
            # Workers on this machine, or on others that share its cache, then find it compiled.
            loading = Task(lambda _: load_kernel(job.plan.config))
            job.result.load_seconds += loading.wait(lambda _: job.tick())
        driver.run(blocks)

    return engine


# -- the driver --------------------------------------------------------------------------------


class _Driver:
    """Hands out the blocks of a session and takes their tables."""

    def __init__(self, job: Job, client: Client, threads: int | None) -> None:
        import dask

        self.job, self._client, self._threads = job, client, threads
        self._where = client.scheduler.address
        self._flying: dict[Future, tuple[Keys, str]] = {}  # keys and the worker meant for them
        self._waiting: list[Keys] = []
        self._workers: dict[str, int] = {}  # threads by address
        self._due, self._seen = 0.0, time.monotonic()
        # The plan is in bytes, so that the scheduler need not make sense of it.
        order = {"versions": versions(), "threads": threads, "plan": pickle.dumps(job.plan)}
        # A task of its own: a worker fetches the result once, and Dask makes it again if all
        # workers that have it are lost, as it would not with scattered data.
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
            self._order = client.submit(dict, order, pure=False)

    def run(self, blocks: Iterator[Keys]) -> None:
        """Write the rows of blocks."""
        job = self.job
        try:
            while self._hand_out(blocks):
                time.sleep(POLL)
                for future in [future for future in self._flying if future.done()]:
                    keys = self._flying[future][0]
                    answer = self._result(future, keys)
                    del self._flying[future]
                    if answer is None or len(answer[0]) < len(keys[0]):
                        self._waiting.append(keys)  # its worker was lost or closed
                        continue
                    job.worked(keys, answer[1])
                    job.write(answer[0])
                job.tick()
        finally:
            self._flying.clear()  # what nobody waits for is cancelled

    def _hand_out(self, blocks: Iterator[Keys]) -> bool:
        """Give each worker its blocks, and return whether any are under way or left."""
        self._look()
        load = Counter(address for _, address in self._flying.values())
        while True:
            keys = self._waiting.pop() if self._waiting else next(blocks, None)
            if keys is None:
                return bool(self._flying)
            address = min(self._workers, key=load.__getitem__, default=None)
            if address is None or load[address] >= AHEAD:
                self._waiting.append(keys)
                return True
            load[address] += 1
            # Left to itself, Dask gives a worker as many blocks as it has threads, of which all
            # but one would wait for the kernel.
            future = self._client.submit(
                do_block, self._order, *keys, workers=address, allow_other_workers=True, pure=False
            )
            self._flying[future] = keys, address

    def _look(self) -> None:
        """Raise an OutputError if the scheduler is lost; now and then, ask for its workers."""
        from distributed import TimeoutError as Late

        lost = OutputError(
            f"the scheduler at {self._where} is lost; completed runs are kept, and with a new one "
            "the same command resumes from there"
        )
        now = time.monotonic()
        if self._client.status != "running":
            raise lost
        if now < self._due:
            return
        self._due = now + LOOK_EVERY
        try:
            self._workers = self._client.sync(self._client.nthreads, callback_timeout=ANSWER)
        except (OSError, Late) as error:
            raise lost from error
        if self._workers:
            self._seen = now
            self.job.threads = self._threads or max(self._workers.values())
            self.job.begin()
        elif now - self._seen > WORKERLESS:
            raise OutputError(
                f"the scheduler at {self._where} has had no worker for {WORKERLESS:.0f} s; start "
                f"some with `dask worker {self._where}`, and the same command resumes from there"
            )

    def _result(self, future: Future, keys: Keys) -> tuple[pa.Table, float] | None:
        """Return what came of a block; None if it was lost together with its worker."""
        from distributed import CancelledError, KilledWorker
        from distributed import TimeoutError as Late

        try:
            answer: tuple[pa.Table, float] = future.result(timeout=ANSWER)
        except (CancelledError, Late, OSError):
            return None
        except (ConfigError, OutputError):
            raise
        except KilledWorker as error:
            raise OutputError(
                f"the block that begins with case {keys[0][0]}, sample {keys[1][0]} is given up: "
                "workers that have it are lost again and again, the last one was "
                f"{error.last_worker.address}; their logs may say why, for example a lack of memory"
            ) from error
        except Exception as error:
            raise OutputError(
                "the scheduler or a worker cannot read a block "
                f"({one_line(f'{type(error).__name__}: {error}', 200)}); give them all the "
                "environment of the driver"
            ) from error
        return answer


# -- the cluster -------------------------------------------------------------------------------


@contextmanager
def embedded(workers: int | None, threads: int) -> Iterator[Client]:
    """Start a cluster of processes on this machine, and stop it in the end."""
    import dask
    from distributed import Client, LocalCluster

    with ExitStack() as stack:
        # Dask puts its scratch directory on the path of every process.  The usual one may belong
        # to another user, whose modules would be imported.
        scratch = stack.enter_context(
            TemporaryDirectory(prefix="rattlesweep-dask-", ignore_cleanup_errors=True)
        )
        settings = {
            "temporary-directory": scratch,
            "distributed.scheduler.worker-ttl": f"{SILENCE}s",
            "distributed.scheduler.http.routes": [],
            "distributed.worker.http.routes": [],
        }
        stack.enter_context(dask.config.set(settings))
        # A terminal sends Ctrl-C to the whole group.  A signal that is blocked here stays blocked
        # in all threads and processes that come from here, and in those that replace lost workers.
        resource_tracker.ensure_running()  # else the first child starts it, which unblocks them
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=workers or max(1, available_threads() // threads),
                    # A second thread prepares the next block while the kernel runs.
                    threads_per_worker=max(2, threads),
                    host="127.0.0.1",
                    dashboard_address=None,
                    # Any port: by itself Dask warns where another cluster has taken 8787.
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                    memory_limit=0,
                    # TLS: whoever reaches a port without it may run anything as this user.
                    security=True,
                    silence_logs=logging.CRITICAL,
                )
            )
            client = stack.enter_context(Client(cluster, set_as_default=False))
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield client


@contextmanager
def existing(address: str) -> Iterator[Client]:
    """Connect to a scheduler that somebody else looks after.

    Raises
    ------
    OutputError
        If none answers.
    """
    from distributed import Client
    from distributed.comm import connect
    from distributed.security import Security

    async def shake_hands() -> None:
        arguments = Security().get_connection_args("client")
        comm = await asyncio.wait_for(connect(address, timeout=REACH, **arguments), REACH)
        await comm.close()

    try:
        asyncio.run(shake_hands())  # Dask's client hangs where something else listens
        client = Client(address, timeout=ANSWER, set_as_default=False)
    except Exception as error:  # what answers may be anything, and say anything
        raise OutputError(
            f"--scheduler {address}: no Dask scheduler answers there ({type(error).__name__}); "
            "give an address such as tcp://host:8786"
        ) from error
    try:
        yield client
    finally:
        with suppress(OSError, TimeoutError):
            client.close(timeout=5)


# -- a worker ----------------------------------------------------------------------------------

_kernel = threading.Lock()  # one kernel at a time in a process


def do_block(order: dict[str, Any], case: Integers, sample: Integers) -> tuple[pa.Table, float]:
    """Compute the runs of some keys; called by Dask on a worker.

    Returns
    -------
    rows : pyarrow.Table
        Not all of them if nobody waits for the block any more.
    seconds : float
        Time of the kernel.

    Raises
    ------
    ConfigError
        If the config asks for bodies that cannot be had.
    OutputError
        If this worker fails, or has other versions than the driver.
    """
    from distributed import Status, get_worker

    worker = get_worker()
    state = worker.state.tasks.get(worker.get_current_task())

    def unwanted() -> bool:
        closing = worker.status in (Status.closing, Status.closed)
        return closing or state is None or state.state == "cancelled"

    def watch(control: Control) -> None:
        if unwanted():
            control.stop()

    try:
        ours, theirs = versions(), order["versions"]
        if other := [name for name in NUMERIC if ours[name] != theirs[name]]:
            words = "; ".join(f"{name} {ours[name]} there, {theirs[name]} here" for name in other)
            raise OutputError(
                f"it would compute other bits: {words}; give all workers the driver's environment"
            )
        plan = _unpack(order["plan"])
        prepared = prepare_runs(plan, case, sample)
        while not _kernel.acquire(timeout=POLL):
            if unwanted():
                return plan.schema.remove_metadata().empty_table(), 0.0
        try:
            load_kernel(plan.config)  # not while another thread uses a kernel
            threads = order["threads"] or worker.state.nthreads
            task = Task(partial(compute, plan.config, plan.schema, prepared, threads))
            return task.wait(watch)[0], task.seconds
        finally:
            _kernel.release()
    except ConfigError:
        raise
    except Exception as error:
        words = str(error) if isinstance(error, OutputError) else f"{type(error).__name__}: {error}"
        me = f"the worker at {worker.address} on {socket.gethostname()}"
        raise OutputError(f"{me}: {one_line(words, 500)}") from None  # a cause may not be pickled


@lru_cache(maxsize=1)
def _unpack(plan: bytes) -> Plan:
    unpacked: Plan = pickle.loads(plan)
    return unpacked
