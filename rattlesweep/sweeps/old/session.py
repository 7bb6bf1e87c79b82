"""A process at work in an output directory: what it finds, what is left to do, what it notes."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.integrate.batch import Control
from rattlesweep.sweeps.cost import Costs
from rattlesweep.sweeps.plan import Block, Plan
from rattlesweep.sweeps.shards import Shard, deal
from rattlesweep.sweeps.old.progress import Progress, Result, Tracker
from rattlesweep.sweeps.old.remainder import Remainder
from rattlesweep.sweeps.old.retype import retype_block
from rattlesweep.sweeps.old.blockfile import Note
from rattlesweep.sweeps.old.manifest import (
    Expected,
    Manifest,
    Receipt,
    SessionProgress,
    SessionRecord,
)
from rattlesweep.sweeps.old.output import Output
from rattlesweep.sweeps.provenance import now, peak_memory
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.arrow import same_schema

# Seconds for which a session in which no run has ended yet goes on after its time is up, so that
# the same command again and again comes to an end, however short the time.
GRACE = 5.0
# Seconds between two notes in the manifest; more where writing it takes long.
NOTE_EVERY = 10.0
# Sessions that the manifest remembers.
REMEMBERED = 1000


@dataclass
class Session:
    """A process's share of a sweep, while it holds it: what an engine works off."""

    output: Output
    shard: Shard | None
    threads: int
    result: Result
    report: Callable[[Progress], None]
    deadline: float | None  # of time.monotonic, after which no work is to be done
    # Blocks that are not in place, or are to be done again in part.
    pending: list[Block] = field(default_factory=list)
    # Those found whole or written by this session.
    receipts: dict[int, Receipt] = field(default_factory=dict)
    # By the numbers of pending blocks of which there are rows already: how many need not be
    # integrated.
    begun: dict[int, int] = field(default_factory=dict)
    # Numbers of complete blocks with types of other thresholds or columns of before, and with
    # failed runs to do again.
    retype: list[int] = field(default_factory=list)
    retry: list[int] = field(default_factory=list)
    # Blocks about to be written anew: the manifest is to have no receipt of them.
    _forgotten: set[int] = field(default_factory=set)
    _due: float = 0.0

    def __post_init__(self) -> None:
        shard, self.costs = self.shard, Costs(self.plan)
        shares = deal(self.plan, 1 if shard is None else shard.count, self.costs)
        self.blocks = shares[0 if shard is None else shard.index]  # all of the share
        self._record = SessionRecord(
            # Two of a process may begin in the same second.
            started=now("microseconds"),
            state="running",
            shard=None if shard is None else str(shard),
            host=socket.gethostname(),
            pid=os.getpid(),
            threads=self.threads,
        )

    @property
    def store(self) -> Store:
        """Its directory."""
        return self.output.store

    @property
    def plan(self) -> Plan:
        """What is to be done."""
        return self.output.plan

    @property
    def runs(self) -> int:
        """Runs of the share that are in place."""
        parts = [rows for index, rows in self.begun.items() if index not in self.receipts]
        return sum(receipt.rows for receipt in self.receipts.values()) + sum(parts)

    # ------------------------------------------------------------ what is there

    def scan(self) -> None:
        """Read every block of the share, and sort out what is left to do.

        A ConfigError if blocks were done under another limit of steps that shows in their rows, or,
        of a shard, have types of other thresholds, which only the whole sweep may change.
        """
        self._sort_out(self.blocks)
        if self.shard is not None and self.retype:
            raise ConfigError(
                f"{self.store.directory}: its types are of other thresholds; a shard cannot change "
                "them, `rattlesweep classify` can"
            )

    def advance(self) -> bool:
        """Go on to what is to be done next; whether there is anything."""
        staged = self.output.staged
        if staged is None or not staged.advance():
            return False
        known = len(self.blocks)
        self.output = replace(self.output, plan=staged.of(self.plan))
        self.costs = self.costs.following(self.plan)
        self.blocks += [self.plan.block(index) for index in range(known, self.plan.n_blocks)]
        self.pending = []
        self._sort_out(self.blocks[known:])
        self._note()
        return True

    def _sort_out(self, blocks: list[Block]) -> None:
        """Read blocks, and sort out what is left to do of them."""
        schema, manifest = self.plan.schema, self.output.manifest
        for block in blocks:
            wanted = self.output.note(block)
            old = None if manifest is None else manifest.receipts.get(block.index)
            found = self.store.find_block(block.index, wanted.runs)
            if (
                found is None
                or found.note is None
                or found.receipt.rows > block.rows
                or not same_schema(found.schema, schema)
                or (old is not None and old.sha256 != found.receipt.sha256)
            ):
                self.pending.append(block)
                self._forgotten.add(block.index)
                continue
            self._check_limit(found.note, wanted, found.receipt)
            retry = bool(found.receipt.failed) and self.output.retry_failed
            if retry or not found.complete:
                self.pending.append(block)
                again = sum(found.receipt.failed.values()) if retry else 0
                self.begun[block.index] = found.receipt.rows - again
            if not found.complete:
                self._forgotten.add(block.index)
                self.result.resumed_runs += self.begun[block.index]
                continue
            self.receipts[block.index] = found.receipt.took(None if old is None else old.seconds)
            self.result.resumed_runs += block.rows
            aged = found.lacks_columns and self.shard is None
            if aged or found.note.classify != wanted.classify:
                self.retype.append(block.index)
            if retry:
                self.retry.append(block.index)

    def _check_limit(self, old: Note, new: Note, receipt: Receipt) -> None:
        where = f"{self.store.directory}: "
        if old.max_steps > new.max_steps:
            raise ConfigError(
                f"{where}its runs were done with integrator.max_steps {old.max_steps}, which may "
                f"only grow; {new.max_steps} needs another output"
            )
        more = old.max_steps < new.max_steps and "step_limit" in receipt.failed
        if more and not self.output.retry_failed:
            raise ConfigError(
                f"{where}some of its runs ended at integrator.max_steps {old.max_steps}; to do "
                f"them again with {new.max_steps}, add --retry-failed"
            )

    def missing(self) -> int:
        """How many blocks of the whole sweep are not there, or not all of them.

        An OutputError if one is gone that this session has found or written.
        """
        there = set(self.store.block_indices())
        if gone := self.receipts.keys() - there:
            raise OutputError(
                f"{self.store.block_path(min(gone))} was in place and has vanished"
                f"{f', and {len(gone) - 1} more blocks' if len(gone) > 1 else ''}: something else "
                "removes files there; the same command does them again"
            )
        others = [index for index in range(self.plan.n_blocks) if index not in self.receipts]
        # Of other shards: what was stopped has left rows, but not a block.
        return len(
            [index for index in others if index not in there]
            or [index for index in others if not self.store.is_complete(index)]
        )

    # -------------------------------------------------- what is done, for the engines

    def track(self) -> None:
        """Begin to count what is done of the blocks that are known."""
        left = {block.index: block.rows - self.begun.get(block.index, 0) for block in self.pending}
        self.tracker = Tracker(self.costs, self.blocks, left, self.report)
        self.tick()

    def tick(self, block: Block | None = None, control: Control | None = None) -> None:
        """Report progress, and note it down now and then."""
        progress = self.tracker.tick(block, control)
        if (start := time.monotonic()) >= self._due:
            self._record.progress = SessionProgress(**asdict(progress), at=now())
            self._note()
            end = time.monotonic()
            self._due = end + max(NOTE_EVERY, 50 * (end - start))

    def too_late(self, some_done: bool = True) -> bool:
        """Whether to stop; a session in which no run has ended yet is given a little longer."""
        if self.deadline is None or time.monotonic() < self.deadline:
            return False
        begun = self.tracker.begun
        return some_done or (begun is not None and time.monotonic() >= begun + GRACE)

    def stop(self) -> None:
        """Say that the time was up."""
        if self.result.done:
            self.result.stopped = "the time is up"
        else:
            self.result.stopped = "the time was up before one run had ended, give more"

    def prepare(self, block: Block) -> Remainder:
        """What is left to do of a pending block."""
        return Remainder.prepare(self.output, block, block.index in self.begun)

    def wrote(self, block: Block, receipt: Receipt, rows: int, seconds: float | None) -> None:
        """Count a block into which so many new rows were written; not all, if it was stopped."""
        index, result = block.index, self.result
        result.done += rows
        result.kernel_seconds += seconds or 0.0
        if index in self.retry:
            result.retried += rows
        if not self.output.note(block).is_whole(receipt.rows):
            self.begun[index] = receipt.rows
            return
        if self.begun.pop(index, None) is not None or seconds is None:
            # Not all of its runs were integrated just now.
            seconds = self.receipts[index].seconds if index in self.receipts else None
        self._keep(index, receipt.took(seconds))
        result.blocks += 1
        self.tracker.finish(block)

    def renew_types(self) -> None:
        """Type the runs of blocks again whose types are of other thresholds."""
        self.forget(self.retype)
        for index in self.retype:
            file = self.store.read_block(index)
            receipt, _ = retype_block(self.store, index, file, self.plan.config.classify)
            self._keep(index, receipt.took(self.receipts[index].seconds))

    def _keep(self, index: int, receipt: Receipt) -> None:
        self.receipts[index] = receipt
        self._forgotten.discard(index)

    # --------------------------------------------------------- what is noted

    def begin(self) -> None:
        """Say in the manifest that this session is at work."""

        def change(manifest: Manifest) -> None:
            manifest.state, manifest.config = "running", self.plan.config
            manifest.classified = None

        self._note(change)
        self._due = time.monotonic() + NOTE_EVERY

    def expect(self, forecast: Callable[[], dict[str, Any] | None]) -> None:
        """Keep what the sweep is expected to take, if nobody has before and it can be told."""
        known = self.output.manifest and self.output.manifest.expected
        if known or (expected := forecast()) is None:
            return

        def change(manifest: Manifest) -> None:
            manifest.expected = manifest.expected or Expected.model_validate(expected)

        self._note(change)

    def forget(self, indices: Iterable[int]) -> None:
        """Take receipts out of the manifest before their blocks are replaced, if there are any."""
        if old := self.receipts.keys() & indices:
            self._forgotten |= old
            self._note()

    def end(self, state: Literal["complete", "stopped"]) -> None:
        """Write down how the session ended, and whether the whole sweep is done."""
        record, result = self._record, self.result
        record.finished, record.state, record.progress = now(), state, None
        record.blocks, record.peak_memory = result.blocks, peak_memory()
        for name in ("seconds", "load_seconds", "kernel_seconds"):
            setattr(record, name, round(getattr(result, name), 3))

        def change(manifest: Manifest) -> None:
            others = [other.state for other in manifest.sessions if other.key != record.key]
            if state == "complete" and result.summary is not None:
                manifest.state, manifest.finished = "complete", now()
            elif manifest.state == state == "complete":
                pass  # Another share ended since this one looked, and found all blocks there.
            elif "running" in others:
                manifest.state = "running"
            else:
                # A share may be complete where the sweep is not.
                manifest.state = "partial" if state == "complete" else state
            manifest.add_up()
            manifest.peak_memory = record.peak_memory

        self._note(change)

    def _note(self, change: Callable[[Manifest], None] = lambda manifest: None) -> None:
        """Put what this session knows by now into the manifest, which may have been removed."""
        plan, mine = self.plan, self._record

        def enter(manifest: Manifest) -> None:
            if plan.stages:
                manifest.stages, manifest.runs = plan.sizes, plan.runs
                manifest.blocks = plan.n_blocks
            known = manifest.receipts | self.receipts
            manifest.receipts = {k: v for k, v in known.items() if k not in self._forgotten}
            sessions = {other.key: other for other in manifest.sessions[-REMEMBERED:]}
            manifest.sessions = [*(sessions | {mine.key: mine}).values()]
            change(manifest)

        hash_, base = self.output.hash_, self.output.base
        self.store.update_manifest(enter, lambda: Manifest.begin(plan, hash_, base))
