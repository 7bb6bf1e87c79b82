"""The engine of many machines: the workers of a Dask cluster compute blocks.

The driver, which is this process, hands out blocks, a few more than there are workers, and writes the tables that come back, so
that workers need no disk in common with it.  Blocks of a worker that is lost are left to Dask's scheduler, which hands them to
another one: a block depends on its keys alone.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import pickle
import signal
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, partial
from multiprocessing import resource_tracker
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple
from uuid import uuid4

import pyarrow as pa

import rattlesweep
from rattlesweep.errors import ConfigError, OutputError, one_line
from rattlesweep.integrate.batch import Control, available_threads
from rattlesweep.integrate.task import POLL, Task
from rattlesweep.sweeps.block import compute, load_kernel, prepare_runs
from rattlesweep.sweeps.job import Job, Keys, OutOfTime
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.provenance import machine, versions

if TYPE_CHECKING:
    from distributed import Client, Future

    from rattlesweep.sweeps.run import Engine

AHEAD = 2
"""Blocks handed out for each worker: one under way and one that is prepared meanwhile."""
GATHER = 5.0
"""Seconds for which a stop waits for the rows of blocks under way."""
REACH = 5.0
"""Seconds within which a scheduler must be reached."""
ANSWER = 20.0
"""Seconds without an answer after which a scheduler, or a table on its way, is given up."""
SILENCE = "30s"
"""Time of silence after which the embedded cluster replaces a worker."""
COUNT_EVERY = 2.0
"""Seconds between two looks at the workers."""
WORKERLESS = 120.0
"""Seconds for which there may be no worker."""
MOST_PLANS = 4
"""Plans that a worker remembers."""
NUMERIC = ("numpy", "numba", "llvmlite", "scipy")
"""Packages on whose versions the bits depend."""


def make_engine(
    scheduler: str | None = None, workers: int | None = None, threads: int | None = None
) -> Engine:
    """Return an engine for :func:`rattlesweep.sweeps.run.run_sweep`.

    Parameters
    ----------
    scheduler : str, optional
        Address of a scheduler, such as ``tcp://host:8786``; by default a cluster of processes on this machine, which lives as
        long as the session.
    workers : int, optional
        Processes of that cluster; by default as many as fill the machine.
    threads : int, optional
        Threads of a worker's kernel; by default 1 in that cluster, elsewhere as many as the worker was given
        (``dask worker --nthreads``).

    Raises
    ------
    ConfigError
        If Dask is missing, or `workers` are asked of a cluster that is there.
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
    driver: _Driver | None = None

    def engine(job: Job, blocks: Iterator[Keys]) -> Iterator[pa.Table]:
        nonlocal driver
        if driver is None or driver.job is not job:  # else the next wave of the same session
            job.resources.enter_context(_quiet())
            if scheduler is None:
                client = job.resources.enter_context(embedded(workers, threads or 1))
            else:
                client = job.resources.enter_context(_existing(scheduler))
            driver = _Driver(job, client, threads or (None if scheduler else 1))
            # Workers on this machine, or on others that share its cache, then find it compiled.
            job.load_seconds += Task(lambda _: load_kernel(job.plan.config)).wait(
                lambda _: job.tick()
            )
        return driver.work_off(blocks)

    return engine


# --------------------------------------------------------------------- driver


class _Driver:
    """Hands out the blocks of a session and takes their tables."""

    def __init__(self, job: Job, client: Client, threads: int | None) -> None:
        import dask

        self.job, self._client, self._threads = job, client, threads
        self._token = uuid4().hex
        self._flying: dict[Future, tuple[Keys, str]] = {}  # keys, and the worker meant for them
        self._waiting: list[Keys] = []
        self._workers: dict[str, int] = {}
        self._due, self._seen = 0.0, time.monotonic()
        self._cpus = {machine()["cpu"]}
        # A task of its own: each worker fetches the plan once, and Dask makes it again when all that have it are lost.  In bytes:
        # the scheduler reads the arguments of tasks, and need not make sense of a plan.
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
            self._order = client.submit(
                dict,
                token=self._token,
                essentials=essentials(),
                threads=threads,
                plan=pickle.dumps(job.plan),
                pure=False,
            )

    def work_off(self, blocks: Iterator[Keys]) -> Iterator[pa.Table]:
        """Yield the rows of blocks; after a stop, those of the runs that have ended."""
        job = self.job
        try:
            while self._hand_out(blocks):
                time.sleep(POLL)
                for future in [future for future in self._flying if future.done()]:
                    answer = self._result(future)
                    keys, _ = self._flying.pop(future)
                    if answer is None or len(answer.table) < len(keys[0]):
                        self._waiting.append(keys)  # its worker was lost or closed
                        continue
                    job.worked(keys, answer.seconds)
                    yield answer.table
                if job.over(some_done=not self._workers):
                    raise OutOfTime
                job.tick()
        except BaseException as error:
            # A stop is a request and no failure: what has ended is kept.
            if isinstance(error, OutOfTime) or not isinstance(error, (Exception, GeneratorExit)):
                yield from self._ended()
            with suppress(Exception):
                self._client.cancel(list(self._flying))
            self._flying.clear()
            raise

    def _hand_out(self, blocks: Iterator[Keys]) -> bool:
        """Give each worker its blocks, and return whether there are any under way or left."""
        self._look()
        at = Counter(address for _, address in self._flying.values())
        while True:
            keys = self._waiting.pop() if self._waiting else next(blocks, None)
            if keys is None:
                return bool(self._flying)
            address = min(self._workers, key=at.__getitem__, default=None)
            if address is None or at[address] >= AHEAD:
                self._waiting.append(keys)
                return True
            at[address] += 1
            # To a certain worker: else Dask hands out as many as a worker has threads, of which all but one would wait for the
            # kernel, and only to workers that have the plan already.
            future = self._client.submit(
                do_block,
                self._order,
                *keys,
                workers=[address],
                allow_other_workers=True,
                pure=False,
            )
            self._flying[future] = keys, address

    def _look(self) -> None:
        """Look whether the scheduler is there and, now and then, which workers it has."""
        from distributed import TimeoutError as Late

        client, now = self._client, time.monotonic()
        where = client.scheduler.address if client.scheduler else "its address"
        lost = OutputError(
            f"the scheduler at {where} is lost; the runs that it has done are kept, and with a new "
            "one the same command resumes from there"
        )
        if client.status != "running":
            raise lost
        if now < self._due:
            return
        self._due = now + COUNT_EVERY
        try:
            self._workers = client.sync(client.nthreads, callback_timeout=ANSWER)
        except (OSError, Late) as error:
            raise lost from error
        if self._workers:
            self._seen = now
            self.job.threads = self._threads or max(self._workers.values())
            self.job.workers = len(self._workers)
            self.job.begin()
        elif now - self._seen > WORKERLESS:
            raise OutputError(
                f"the scheduler at {where} has had no worker for {WORKERLESS:.0f} s; start some "
                f"with `dask worker {where}`, and the same command resumes from there"
            )

    def _result(self, future: Future) -> Answer | None:
        """Return what came of a block; None if it is to be done again."""
        from distributed import CancelledError, KilledWorker
        from distributed import TimeoutError as Late

        try:
            answer: Answer = future.result(timeout=ANSWER)
        except KilledWorker as error:
            case, sample = (int(keys[0]) for keys in self._flying[future][0])
            raise OutputError(
                f"the block that begins with case {case}, sample {sample} is given up: workers "
                f"that have it are lost again and again, the last one was "
                f"{error.last_worker.address}; their logs say why, want of memory perhaps"
            ) from error
        except (CancelledError, Late, OSError):
            return None
        except (ConfigError, OutputError):
            raise
        except Exception as error:
            words = one_line(f"{type(error).__name__}: {error}", 200)
            raise OutputError(
                f"the scheduler or a worker cannot take a block ({words}); give them all the "
                "environment of the driver"
            ) from error
        if answer.cpu not in self._cpus:
            self._cpus.add(answer.cpu)
            self.job.remarks.append(
                f"workers have other processors ({answer.cpu}) than the driver: last bits may "
                "differ"
            )
        return answer

    def _ended(self) -> Iterator[pa.Table]:
        """Stop the blocks under way and yield the rows of their runs that have ended."""
        client, end = self._client, time.monotonic() + GATHER
        with suppress(Exception):
            client.sync(
                client.run, stop, self._token, on_error="ignore", callback_timeout=GATHER / 2
            )
        while self._flying and time.monotonic() < end and client.status == "running":
            for future in [future for future in self._flying if future.done()]:
                answer = None
                with suppress(Exception):  # a block that failed has no rows
                    answer = self._result(future)
                del self._flying[future]
                if answer is not None:
                    self.job.lost += answer.lost
                    yield answer.table
            time.sleep(POLL)


# -------------------------------------------------------------------- cluster


@contextmanager
def embedded(workers: int | None, threads: int) -> Iterator[Client]:
    """Start a cluster of processes on this machine, and stop it in the end."""
    import dask
    from distributed import Client, LocalCluster

    with ExitStack() as stack:
        # Dask puts its scratch directory on the path of every process.  The usual one may have been made by another user, who
        # would have his modules imported.
        scratch = stack.enter_context(
            TemporaryDirectory(prefix="rattlesweep-dask-", ignore_cleanup_errors=True)
        )
        settings = {
            "temporary-directory": scratch,
            "distributed.scheduler.worker-ttl": SILENCE,
            "distributed.scheduler.http.routes": [],
            "distributed.worker.http.routes": [],
            "distributed.worker.profile.enabled": False,
        }
        stack.enter_context(dask.config.set(settings))
        path = sys.path[:]
        with _no_interrupt_for_children():
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=workers or max(1, available_threads() // threads),
                    # A second thread prepares the next block while the kernel runs.
                    threads_per_worker=max(2, threads),
                    processes=True,
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
        sys.path[:] = path
        yield client


@contextmanager
def _existing(address: str) -> Iterator[Client]:
    """Connect to a scheduler that somebody else looks after."""
    from distributed import Client
    from distributed.comm import connect
    from distributed.security import Security

    async def shake_hands() -> None:
        arguments = Security().get_connection_args("client")
        comm = await asyncio.wait_for(connect(address, timeout=REACH, **arguments), REACH)
        await comm.close()

    try:
        # First by hand: where something else answers, Dask's client is silent for long and then hangs.
        asyncio.run(shake_hands())
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


@contextmanager
def _no_interrupt_for_children() -> Iterator[None]:
    """Keep Ctrl-C, which a terminal sends to the whole group, from processes that are started here.

    A blocked signal stays blocked in every thread and process that comes from here, also in those that Dask starts later in
    place of lost workers.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # Python starts this one with the first child, and thereby lets the signal through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's log off the terminal: what matters is said in one sentence."""
    noisy = ("distributed", "tornado", "asyncio")
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in noisy]
    levels = {logger: logger.level for logger in map(logging.getLogger, names)}
    for logger in levels:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in levels.items():
            logger.setLevel(level)


# --------------------------------------------------------------------- worker

_kernel = threading.Lock()  # one kernel at a time in a process
_opening = threading.Lock()
_plans: dict[str, Plan] = {}
_stopped: set[str] = set()


class Answer(NamedTuple):
    """What a worker sends back."""

    table: pa.Table  # all rows of the block; if it was stopped, those of the runs that had ended
    lost: int  # runs that had begun but not ended
    seconds: float  # of the kernel
    cpu: str  # of the worker's machine


@cache
def essentials() -> dict[str, str]:
    """Return the versions that must be equal for the bits to be: the source of this package, and what it computes with."""
    root, digest = Path(rattlesweep.__file__).parent, hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode())
        digest.update(path.read_bytes())
    known = versions()
    return {
        "rattlesweep": f"{known['rattlesweep']} ({digest.hexdigest()[:12]})",
        **{name: known[name] for name in NUMERIC},
    }


def stop(token: str) -> None:
    """Have the blocks of a driver answer with what they have; called by Dask on a worker."""
    _stopped.add(token)


def do_block(order: dict[str, Any], case: Any, sample: Any) -> Answer:
    """Compute a block; called by Dask on a worker.

    Parameters
    ----------
    order : dict
        The driver's token, what it computes with, threads of the kernel (None: the worker's) and the pickled plan.
    case, sample : ndarray of int64
        Keys of the runs.

    Raises
    ------
    ConfigError
        If the config asks for bodies that cannot be had.
    OutputError
        If this worker would compute other bits, or fails.
    """
    from distributed import Status, get_worker

    worker = get_worker()
    task = worker.state.tasks.get(worker.get_current_task())

    def unwanted() -> bool:
        # The scheduler cancels what nobody waits for any more, as when the driver is killed.
        return (
            order["token"] in _stopped
            or worker.status in (Status.closing, Status.closed)
            or task is None
            or task.state == "cancelled"
        )

    def watch(control: Control) -> None:
        if unwanted():
            control.stop()

    try:
        plan = _open(order)
        cpu = machine()["cpu"]
        prepared = prepare_runs(plan, case, sample)
        while not _kernel.acquire(timeout=POLL):
            if unwanted():
                return Answer(plan.schema.remove_metadata().empty_table(), 0, 0.0, cpu)
        try:
            # Not while another thread uses a kernel, nor as a part of the block's time.
            load_kernel(plan.config)
            threads = order["threads"] or worker.state.nthreads
            call = Task(partial(compute, plan.config, plan.schema, prepared, threads))
            table, lost = call.wait(watch)
        finally:
            _kernel.release()
    except ConfigError:
        raise
    except Exception as error:
        words = str(error) if isinstance(error, OutputError) else f"{type(error).__name__}: {error}"
        raise OutputError(
            f"the worker at {worker.address} on {socket.gethostname()}: {one_line(words, 500)}"
        ) from error
    return Answer(table, lost, call.seconds, cpu)


def _open(order: dict[str, Any]) -> Plan:
    """Return the plan of an order, if this worker can follow it."""
    with _opening:
        if order["token"] not in _plans:
            ours = essentials()
            other = [
                f"{name} {ours.get(name)} there, {version} here"
                for name, version in order["essentials"].items()
                if ours.get(name) != version
            ]
            if other:
                raise OutputError(
                    f"it would compute other bits: {'; '.join(other)}; give all workers the "
                    "environment of the driver"
                )
            while len(_plans) >= MOST_PLANS:
                del _plans[next(iter(_plans))]
            _plans[order["token"]] = pickle.loads(order["plan"])
        return _plans[order["token"]]
