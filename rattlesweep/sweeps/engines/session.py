"""A process at work in an output directory: what it finds, what is left to do, what it notes.

And how it takes hold of that directory, and makes it one of the sweep that is to go on there.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rattlesweep.errors import ConfigError, DamagedError, OutputError
from rattlesweep.sweeps.cases.costs import Costs
from rattlesweep.sweeps.cases.plan import Block, Plan
from rattlesweep.sweeps.cases.shards import Shard, deal
from rattlesweep.sweeps.store.atomic import explained
from rattlesweep.sweeps.store.blockfile import Note
from rattlesweep.sweeps.store.growth import finish_growth, grow, remove_growth
from rattlesweep.sweeps.store.locks import hold
from rattlesweep.sweeps.store.manifest import (
    Expected,
    Manifest,
    Receipt,
    SessionProgress,
    SessionRecord,
)
from rattlesweep.sweeps.store.output import Output, examine, put_in_order
from rattlesweep.sweeps.store.provenance import now, peak_memory, table_files
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.store.stored import Staged, follow_stages
from rattlesweep.sweeps.tables.arrow import same_schema

if TYPE_CHECKING:
    from rattlesweep.sweeps.engines.job import Progress, Result

# Seconds between two notes in the manifest; more where writing it takes long.
NOTE_EVERY = 10.0
# Sessions that the manifest remembers.
REMEMBERED = 1000


@dataclass
class Session:
    """A process's share of a sweep, while it holds it."""

    output: Output
    shard: Shard | None
    threads: int
    costs: Costs  # expected, of the plan's blocks
    blocks: list[Block]  # all of the share
    staged: Staged | None  # of a sweep that decides what to run next
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
    kept: int = 0  # runs found on disk
    # Blocks about to be written anew: the manifest is to have no receipt of them.
    _forgotten: set[int] = field(default_factory=set)
    _due: float = 0.0

    def __post_init__(self) -> None:
        self._record = SessionRecord(
            started=now(),
            state="running",
            shard=None if self.shard is None else str(self.shard),
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

    @property
    def left(self) -> dict[int, int]:
        """Runs to integrate of each pending block, by its number."""
        return {block.index: block.rows - self.begun.get(block.index, 0) for block in self.pending}

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
        if self.staged is None or not self.staged.advance():
            return False
        known = len(self.blocks)
        plan = self.staged.of(self.plan)
        self.output = replace(self.output, plan=plan)
        self.costs = self.costs.following(plan)
        self.blocks += [plan.block(index) for index in range(known, plan.n_blocks)]
        self.pending = []
        self._sort_out(self.blocks[known:])
        self.store.update_manifest(self._enter_stages, self._blank)
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
                continue
            self._check_limit(found.note, wanted, found.receipt)
            retry = bool(found.receipt.failed) and self.output.retry_failed
            if retry or not found.complete:
                self.pending.append(block)
                again = sum(found.receipt.failed.values()) if retry else 0
                self.begun[block.index] = found.receipt.rows - again
            if not found.complete:
                self.kept += self.begun[block.index]
                continue
            self.receipts[block.index] = found.receipt.took(None if old is None else old.seconds)
            self.kept += block.rows
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

    # --------------------------------------------------------- what is noted

    def begin(self) -> None:
        """Say in the manifest that this session is at work."""

        def change(manifest: Manifest) -> None:
            manifest.state, manifest.config = "running", self.plan.config
            self._enter_stages(manifest)
            # Of files that were not found as they were written.
            manifest.forget(b.index for b in self.pending if b.index not in self.receipts)
            manifest.clear("classified")
            manifest.sessions = [*self._others(manifest)[-REMEMBERED:], self._record]

        if self.output.manifest is None and self.store.has_manifest():
            try:
                self.store.read_manifest()  # which another shard may have mended meanwhile
            except DamagedError:
                self.store.write_manifest(self._blank())
        self.store.update_manifest(change, self._blank)
        self._due = time.monotonic() + NOTE_EVERY

    def _blank(self) -> Manifest:
        """A manifest with all that this session knows: it may be removed while that is at work."""
        manifest = Manifest.begin(self.plan, self.output.hash_, self.output.base)
        manifest.receipts, manifest.sessions = dict(self.receipts), [self._record]
        return manifest

    def _others(self, manifest: Manifest) -> list[SessionRecord]:
        return [session for session in manifest.sessions if session.key != self._record.key]

    def expect(self, forecast: Callable[[], dict[str, Any] | None]) -> None:
        """Keep what the sweep is expected to take, if nobody has before and it can be told."""
        known = self.output.manifest and self.output.manifest.expected
        if known or (expected := forecast()) is None:
            return

        def change(manifest: Manifest) -> None:
            manifest.expected = manifest.expected or Expected.model_validate(expected)

        self.store.update_manifest(change, self._blank)

    def forget(self, indices: list[int]) -> None:
        """Take receipts out of the manifest before their blocks are replaced, if there are any."""
        if old := [index for index in indices if index in self.receipts]:
            self._forgotten.update(old)
            self.store.update_manifest(lambda manifest: manifest.forget(old), self._blank)

    def wrote(self, index: int, receipt: Receipt, seconds: float | None = None) -> bool:
        """Keep the receipt of a block that was written, if it is whole; whether it is."""
        if not self.output.note(self.plan.block(index)).is_whole(receipt.rows):
            self.begun[index] = receipt.rows
            return False
        if self.begun.pop(index, None) is not None or seconds is None:
            # Not all of its runs were integrated just now.
            seconds = self.receipts[index].seconds if index in self.receipts else None
        self.receipts[index] = receipt.took(seconds)
        self._forgotten.discard(index)
        return True

    def missing(self) -> list[int]:
        """Numbers of the blocks of the whole sweep that are not there, or not all of them.

        An OutputError if one is gone that this session has found or written.
        """
        plan, there = self.plan, set(self.store.block_indices())
        if gone := [index for index in self.receipts if index not in there]:
            raise OutputError(
                f"{self.store.block_path(min(gone))} was in place and has vanished"
                f"{f', and {len(gone) - 1} more blocks' if len(gone) > 1 else ''}: something else "
                "removes files there; the same command does them again"
            )
        others = [index for index in range(plan.n_blocks) if index not in self.receipts]
        # Of other shards: what was stopped has left rows, but not a block.
        return [index for index in others if index not in there] or [
            index for index in others if not self.store.is_complete(index)
        ]

    def note(self, progress: Progress) -> None:
        """Write receipts and progress down, if it is time to."""
        if time.monotonic() >= self._due:
            start = time.monotonic()
            self._record.progress = SessionProgress(**asdict(progress), at=now())
            self.store.update_manifest(self._enter, self._blank)
            self._due = time.monotonic() + max(NOTE_EVERY, 50 * (time.monotonic() - start))

    def end(self, state: str, result: Result) -> None:
        """Write down how the session ended, and whether the whole sweep is done."""
        fields = self._record.model_dump(exclude_unset=True, exclude={"progress"})
        fields |= {"finished": now(), "state": state, "blocks": result.blocks}
        for name in ("seconds", "load_seconds", "kernel_seconds"):
            fields[name] = round(getattr(result, name), 3)
        self._record = SessionRecord(**fields, peak_memory=peak_memory())

        def change(manifest: Manifest) -> None:
            self._enter(manifest)
            if state == "complete" and result.summary is not None:
                manifest.state, manifest.finished = "complete", now()
            elif manifest.state == state == "complete":
                pass  # Another share ended since this one looked, and found all blocks there.
            elif any(session.state == "running" for session in self._others(manifest)):
                manifest.state = "running"
            else:
                # A share may be complete where the sweep is not.
                manifest.state = "partial" if state == "complete" else self._record.state
            manifest.add_up()
            manifest.peak_memory = self._record.peak_memory

        self.store.update_manifest(change, self._blank)

    def _enter_stages(self, manifest: Manifest) -> None:
        """Put the stages that are known by now into the manifest."""
        plan = self.plan
        if plan.stages:
            manifest.stages, manifest.runs, manifest.blocks = plan.sizes, plan.runs, plan.n_blocks

    def _enter(self, manifest: Manifest) -> None:
        """Put what this session knows by now into the manifest."""
        manifest.receipts |= {
            index: receipt
            for index, receipt in self.receipts.items()
            if index not in self._forgotten
        }
        mine = self._record
        manifest.sessions = [mine if s.key == mine.key else s for s in manifest.sessions]


# ------------------------------------------------------------ how it takes hold of a directory


@contextmanager
def open_session(
    plan: Plan,
    directory: Path,
    base: Path | None,
    threads: int,
    *,
    shard: Shard | None = None,
    fresh: bool = False,
    retry_failed: bool = False,
) -> Iterator[Session]:
    """Take hold of a directory, or of a share of it; first remove its runs if `fresh`."""
    if not fresh:
        examine(plan, directory, base)  # before anything is made there
    store = Store(directory)
    store.prepare()
    with hold(directory, None if shard is None else shard.name) as alone:
        if fresh:
            _start_over(store, plan, base)
        store.remove_stale_temporaries(alone)
        output = examine(plan, directory, base)
        half = output.manifest is not None and bool(output.manifest.growing)
        if shard is None:
            output = _grown(output, half)
        elif half or output.growth is not None:
            raise ConfigError(
                f"{directory}: holds fewer samples or cases, and a share cannot add to them; run "
                "it without --shard, or merge the shares and do so there"
            )
        plan = output.plan
        if plan.stages and retry_failed:
            raise ConfigError(
                f"--retry-failed: {plan.stages_by} has chosen the runs by what came out, "
                "failed ones too; repeat them in another output"
            )
        staged = follow_stages(store, plan, output.hash_)
        plan = plan if staged is None else staged.of(plan)
        output = replace(output, plan=plan, retry_failed=retry_failed)
        output.remarks.extend(put_in_order(output))
        costs = Costs(plan)
        shares = deal(plan, 1 if shard is None else shard.count, costs)
        blocks = shares[0 if shard is None else shard.index]
        yield Session(output, shard, threads, costs, blocks, staged)


def _grown(output: Output, half: bool) -> Output:
    """What the directory is once it is one of this sweep; `half`: one has begun to make it so."""
    if half:
        finish_growth(output.store)
    else:
        remove_growth(output.store)
    if output.growth is not None and output.manifest is not None:
        grow(output.store, output.manifest, output.plan, output.hash_, output.growth)
    elif not half:
        return output
    again = examine(output.plan, output.store.directory, output.base)
    return replace(again, remarks=output.remarks)


def _start_over(store: Store, plan: Plan, base: Path | None) -> None:
    """Remove the files of a sweep, and only those; not what this one is to begin from."""
    # The manifest first: without it, what is left is nobody's.
    blocks = map(store.block_path, store.block_indices())
    files = [store.manifest_path, store.summary_path, *blocks]
    removed = {path.resolve() for path in files}
    for path in table_files(plan, base):
        if path.resolve() in removed:
            raise ConfigError(
                f"--fresh: would remove {path}, which this sweep takes its bodies from; choose "
                "another output"
            )
    with explained(f"cannot remove the runs in {store.directory}"):
        for path in files:
            path.unlink(missing_ok=True)
