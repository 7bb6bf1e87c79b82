"""Run a sweep: block after block through the kernel, each written when it is whole.

The kernel runs in a thread of its own, without the interpreter's lock.  Meanwhile the main thread
writes the block before, prepares the one after, reports progress and hears Ctrl-C.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.integrate.batch import Control, available_threads
from rattlesweep.integrate.kernels import kernel
from rattlesweep.sweep.blocks import STATUS_WORDS, Interrupted, finish_block, prepare_block
from rattlesweep.sweep.columns import runs_schema
from rattlesweep.sweep.config import differences, physics_part, resolved
from rattlesweep.sweep.errors import ConfigError
from rattlesweep.sweep.launches import prepare
from rattlesweep.sweep.plan import Block, Plan
from rattlesweep.sweep.provenance import identity, new_manifest, now, read_manifest
from rattlesweep.sweep.retype import retype_blocks
from rattlesweep.sweep.store import Store
from rattlesweep.sweep.summary import summarise

if TYPE_CHECKING:
    import pyarrow as pa

# Runs by which the cost of a case is judged before it is run.
PILOT = 16
POLL = 0.1
# How long a stop waits for the kernel; it answers within a millisecond, a compilation does not.
PATIENCE = 0.5


@dataclass(frozen=True)
class Progress:
    """How far a sweep is.

    Attributes
    ----------
    fraction : float
        Of the expected cost, blocks found on disk included.
    runs, total : int
        Runs done, and all runs.
    elapsed : float
        Seconds since the start.
    left : float or None
        Estimated seconds left; None as long as there is nothing to judge by.
    """

    fraction: float
    runs: int
    total: int
    elapsed: float
    left: float | None


@dataclass
class Report:
    """What a sweep came to."""

    directory: Path
    runs: int = 0
    resumed_runs: int = 0
    seconds: float = 0.0
    kernel_seconds: float = 0.0
    load_seconds: float = 0.0
    failed: Counter[str] = field(default_factory=Counter)
    summary: pa.Table | None = None


class _Task(threading.Thread):
    """One call in a thread that does not keep the process alive."""

    def __init__(self, call: Callable[[], Mapping[str, Any]]) -> None:
        super().__init__(daemon=True, name="rattlesweep-kernel")
        self._call = call
        self._error: BaseException | None = None
        self._value: Mapping[str, Any] | None = None
        self.seconds = 0.0
        self.start()

    def run(self) -> None:
        start = time.perf_counter()
        try:
            self._value = self._call()
        except BaseException as error:
            self._error = error
        self.seconds = time.perf_counter() - start

    def value(self) -> Mapping[str, Any]:
        if self._error is not None:
            raise self._error
        assert self._value is not None
        return self._value


class _Meter:
    """Progress, weighted by what the runs are expected to cost."""

    def __init__(self, plan: Plan, report: Callable[[Progress], None]) -> None:
        self._plan = plan
        self._report = report
        self._case_cost = _case_costs(plan)
        self._total = float(self._case_cost.sum()) * plan.samples
        self._start = time.perf_counter()
        self._done = 0.0
        self._skipped = 0.0
        self._runs = 0
        self._begun: float | None = None

    def cost(self, block: Block) -> float:
        """Expected cost of a block."""
        cases, counts = np.unique(self._plan.runs_of(block)[0], return_counts=True)
        return float(self._case_cost[cases] @ counts)

    def skip(self, block: Block) -> None:
        """Count a block found on disk."""
        self._skipped += self.cost(block)
        self._runs += block.rows

    def finish(self, block: Block) -> None:
        """Count a block that is done."""
        self._done += self.cost(block)
        self._runs += block.rows

    def tick(self, block: Block | None = None, control: Control | None = None) -> None:
        """Report, with what the kernel says of the block under way."""
        done, runs = self._done, self._runs
        if block is not None and control is not None and control.total > 0:
            done += self.cost(block) * min(1.0, control.done / control.total)
            runs += control.runs_done
        elapsed = time.perf_counter() - self._start
        left = None
        if done > 0:
            # From the first sign of life on: compilation says nothing of what is left.
            if self._begun is None:
                self._begun = max(0.0, elapsed - POLL)
            left = (self._total - self._skipped - done) * (elapsed - self._begun) / done
        fraction = min(1.0, (done + self._skipped) / self._total) if self._total > 0 else 1.0
        self._report(Progress(fraction, runs, self._plan.runs, elapsed, left))


def _case_costs(plan: Plan) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Expected cost of one run of each case, from a few samples spread over it."""
    if plan.config.model == "gh":
        return np.ones(len(plan.cases))
    picks = PILOT if len(plan.cases) > 1 else 16 * PILOT
    samples = np.unique(np.linspace(0, plan.samples - 1, min(picks, plan.samples)).astype(int))
    case = np.repeat(np.arange(len(plan.cases)), len(samples))
    launches = prepare(plan, case, np.tile(samples, len(plan.cases)))
    # Steps go with the oscillations of the full dynamics, and with the spin's of the reduced one.
    if plan.config.model == "full":
        cost = launches.t_end * launches.modes.omega_p
    else:
        cost = launches.t_end * launches.n_0 * np.abs(launches.modes.K_p)
    cost = np.where(np.isfinite(cost), cost, 0.0).reshape(len(plan.cases), -1)
    mean: np.ndarray[Any, np.dtype[np.float64]] = cost.mean(axis=1)
    return mean


def open_store(plan: Plan, directory: Path, base: Path | None, threads: int) -> tuple[Store, Any]:
    """Store and manifest of a sweep, new or to be continued; nothing is written yet.

    Raises
    ------
    ConfigError
        If the directory holds the runs of another config.
    OutputError
        If it cannot be read.
    """
    store = Store(directory)
    hash_ = identity(plan, base)
    fresh = new_manifest(plan, hash_, threads)
    if not store.manifest_path.exists():
        if store.block_indices():
            raise ConfigError(
                f"{directory}: it holds runs but no manifest.json, so nothing says of which "
                "config they are; choose another output"
            )
        return store, fresh
    old = read_manifest(store)
    if old.get("config_hash") != hash_:
        changes = differences(physics_part(old["config"]), physics_part(fresh["config"]))
        what = "; ".join(changes[:3]) or "the table of bodies has changed"
        raise ConfigError(
            f"{directory}: it holds the runs of another config ({what}); choose another output or "
            "remove it"
        )
    return store, old


def run_sweep(
    plan: Plan,
    directory: Path,
    *,
    base: Path | None = None,
    threads: int | None = None,
    report: Callable[[Progress], None] = lambda progress: None,
) -> Report:
    """Run what a plan asks for and is not yet on disk.

    Parameters
    ----------
    plan : Plan
    directory : Path
        Output directory; the blocks of the same config that are whole there are kept.
    base : Path, optional
        Where a table's relative path is looked up besides the working directory.
    threads : int, optional
        Threads of the kernel.
    report : callable
        Called a few times a second with a :class:`Progress`.

    Returns
    -------
    Report

    Raises
    ------
    ConfigError, OutputError
        As :func:`open_store`, or if a file cannot be written.
    KeyboardInterrupt
        On Ctrl-C; the kernel is stopped first and whole blocks are kept.
    """
    start = time.perf_counter()
    threads = threads or available_threads()
    store, manifest = open_store(plan, directory, base, threads)
    store.prepare()
    store.remove_stale_temporaries()
    result = Report(directory)
    schema = runs_schema(plan.config.record, plan.config.model)
    meter = _Meter(plan, report)
    pending: list[Block] = []
    for index in range(plan.n_blocks):
        block = plan.block(index)
        if store.block_is_whole(index, schema, block.rows):
            meter.skip(block)
            result.resumed_runs += block.rows
        else:
            pending.append(block)
    _retype_old_blocks(plan, store, manifest, result)
    manifest["state"] = "running"
    store.write_manifest(manifest)
    meter.tick()
    if pending and plan.config.model != "gh":
        # Here and not in the thread: a compilation can then be interrupted.
        begin = time.perf_counter()
        kernel(plan.config.integrator.method, plan.config.model)
        result.load_seconds = time.perf_counter() - begin
    _work_off(plan, pending, store, schema, threads, meter, result)
    result.runs = plan.runs
    result.summary = summarise(store, plan.cases)
    store.write_summary(result.summary)
    _count_failed(store, result)
    result.seconds = time.perf_counter() - start
    manifest |= {
        "state": "complete",
        "finished": now(),
        "seconds": round(manifest.get("seconds", 0.0) + result.seconds, 3),
        "kernel_seconds": round(manifest.get("kernel_seconds", 0.0) + result.kernel_seconds, 3),
        "failed": dict(result.failed),
    }
    store.write_manifest(manifest)
    return result


def _retype_old_blocks(plan: Plan, store: Store, manifest: dict[str, Any], result: Report) -> None:
    """Give blocks of an earlier session the thresholds of this one."""
    wanted = resolved(plan.config)["classify"]
    if result.resumed_runs and manifest["config"].get("classify") != wanted:
        retype_blocks(store, plan.config.classify)
    manifest["config"] = resolved(plan.config)


def _work_off(
    plan: Plan,
    pending: list[Block],
    store: Store,
    schema: pa.Schema,
    threads: int,
    meter: _Meter,
    result: Report,
) -> None:
    """Integrate the pending blocks and write them, each while the next one runs."""
    ready = prepare_block(plan, pending[0]) if pending else None
    written: tuple[Block, Mapping[str, Any]] | None = None
    for place, block in enumerate(pending):
        assert ready is not None
        launches, batch = ready
        control = Control()
        task = _Task(
            lambda launches=launches, batch=batch, control=control: finish_block(  # type: ignore[misc]
                plan.config, launches, batch, threads=threads, control=control
            )
        )
        try:
            if written is not None:
                store.write_block(written[0].index, written[1], schema)
            ready = prepare_block(plan, pending[place + 1]) if place + 1 < len(pending) else None
            while task.is_alive():
                task.join(POLL)
                meter.tick(block, control)
            written = block, task.value()
        except BaseException as error:
            control.stop()
            task.join(PATIENCE)
            if isinstance(error, Interrupted):
                raise KeyboardInterrupt from None
            raise
        result.kernel_seconds += task.seconds
        meter.finish(block)
    if written is not None:
        store.write_block(written[0].index, written[1], schema)
    meter.tick()


def _count_failed(store: Store, result: Report) -> None:
    for batch in store.iter_batches(["status"]):
        counts = batch.column("status").value_counts()
        for entry in counts.to_pylist():
            if entry["values"] != STATUS_WORDS[0]:
                result.failed[entry["values"]] += entry["counts"]
