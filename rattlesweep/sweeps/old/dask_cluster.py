"""Clusters for the Dask engine: one of processes on this machine, or one that is there."""

from __future__ import annotations

import asyncio
import logging
import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import resource_tracker
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from rattlesweep.errors import OutputError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.sweeps.old import dask_worker as daskworker

if TYPE_CHECKING:
    from distributed import Client

# Seconds in which a scheduler must be reached.
REACH = 5.0
# Seconds without an answer after which a scheduler, and a receipt, are given up.
ANSWER = 20.0
# Seconds of silence after which the embedded cluster replaces a worker.
SILENCE = "30s"


@contextmanager
def embedded(workers: int | None, threads: int) -> Iterator[Client]:
    """A cluster of processes on this machine."""
    import dask
    from distributed import Client, LocalCluster

    count = workers or max(1, available_threads() // threads)
    with ExitStack() as stack:
        # Dask's own place is one that another user may have made, and it is on the path: whatever
        # lies there would be imported.
        scratch = stack.enter_context(
            TemporaryDirectory(prefix="rattlesweep-dask-", ignore_cleanup_errors=True)
        )
        settings = {
            "temporary-directory": scratch,
            "distributed.scheduler.worker-ttl": SILENCE,
            "distributed.scheduler.http.routes": [],
            "distributed.worker.http.routes": [],
            "distributed.worker.preload": [daskworker.__name__],
            "distributed.worker.profile.enabled": False,
        }
        stack.enter_context(dask.config.set(settings))
        with _no_interrupt_for_children():
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=count,
                    # A second thread prepares the next block while the kernel runs.
                    threads_per_worker=max(2, threads),
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address=None,
                    # Any port: by itself it warns where another cluster has taken 8787.
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                    memory_limit=0,
                    # Whoever reaches a port without this may run anything as this user.
                    security=True,
                    silence_logs=logging.CRITICAL,
                )
            )
            client = stack.enter_context(Client(cluster, set_as_default=False))
        daskworker.leave_path()
        yield client


def reach(address: str) -> None:
    """Look whether a scheduler answers: Dask's client would be silent for long, and then hang."""
    from distributed.comm import connect
    from distributed.security import Security

    async def shake_hands() -> None:
        with_ = Security().get_connection_args("client")
        comm = await asyncio.wait_for(connect(address, timeout=REACH, **with_), REACH)
        await comm.close()

    try:
        asyncio.run(shake_hands())
    except Exception as error:  # what answers may be anything, and say anything
        raise _nobody_at(address, error) from error


def _nobody_at(address: str, error: Exception) -> OutputError:
    return OutputError(
        f"--scheduler {address}: no Dask scheduler answers there ({type(error).__name__}); "
        "give an address such as tcp://host:8786"
    )


@contextmanager
def existing(address: str) -> Iterator[Client]:
    """A client of a scheduler that somebody else looks after."""
    from distributed import Client

    try:
        client = Client(address, timeout=ANSWER, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise _nobody_at(address, error) from error
    try:
        yield client
    finally:
        with suppress(OSError, TimeoutError):
            client.close(timeout=5)


@contextmanager
def _no_interrupt_for_children() -> Iterator[None]:
    """Let threads, and the processes that they start, not be hit by Ctrl-C, which is the driver's.

    A terminal sends it to all. What is blocked stays blocked in everything that is started here,
    and in what Dask starts later in place of a lost worker.
    """
    if threading.current_thread() is not threading.main_thread() or not hasattr(
        signal, "pthread_sigmask"
    ):
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
def quiet() -> Iterator[None]:
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
