"""What is left to do of a block: prepared, integrated, and joined with what is there.

A session that is stopped writes the runs of its block that have ended into the block's own file. It
is a file like any other, sealed and with the same note, but has fewer rows than the block, which is
how readers tell. Whoever does the block next integrates the runs that are missing. Failed runs that
are to be done again are missing ones whose rows are kept until there are better ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.integrate.batch import Batch
from rattlesweep.integrate.task import Task
from rattlesweep.sweeps.block import Interrupted, finish_block, prepare_runs
from rattlesweep.sweeps.launches import Launches
from rattlesweep.sweeps.plan import Block
from rattlesweep.sweeps.old.blockfile import numbers_of
from rattlesweep.sweeps.old.manifest import Receipt
from rattlesweep.sweeps.old.output import Output
from rattlesweep.sweeps.arrow import build_table
from rattlesweep.sweeps.types import with_types

Columns = Mapping[str, Any]

# Seconds for which a stop waits for the runs that have ended: to be typed, not integrated.
GATHER = 10.0


@dataclass(frozen=True)
class Remainder:
    """The runs of a block that are to be integrated, ready to go."""

    output: Output
    block: Block
    old: pa.Table | None  # rows of the block that are there
    limit: int  # of steps, under which these were done
    launches: Launches
    batch: Batch | None

    @classmethod
    def prepare(cls, output: Output, block: Block, begun: bool) -> Remainder:
        """What can be done before the kernel is free: bodies, theory, initial states.

        `begun` says whether rows of the block are there.
        """
        plan = output.plan
        case, sample = plan.runs_of(block)
        old, limit = None, plan.config.integrator.max_steps
        if begun:
            file = output.store.read_block(block.index)
            limit = limit if file.note is None else file.note.max_steps
            old = with_types(file.table(), plan.config.classify)
            kept = old.filter(pc.equal(old.column("status"), "ok")) if output.retry_failed else old
            left = ~np.isin(case * plan.samples + sample, numbers_of(kept, plan.samples))
            case, sample = case[left], sample[left]
        return cls(output, block, old, limit, *prepare_runs(plan, case, sample))

    @property
    def rows(self) -> int:
        """Number of runs to integrate."""
        return len(self.launches.case)

    def integrate(self, threads: int) -> Task[Columns]:
        """Begin to integrate and type the runs, in a thread."""
        config = self.output.plan.config
        return Task(
            lambda control: finish_block(
                config, self.launches, self.batch, threads=threads, control=control
            )
        )

    def write(self, columns: Columns) -> Receipt:
        """Write the block's new rows beside those that are there; every engine does it so.

        `columns` are of all runs that were left, or of those that had ended when it was stopped.
        """
        plan, store, index = self.output.plan, self.output.store, self.block.index
        note = self.output.note(self.block)
        if self.old is None:
            return store.write_block(index, build_table(columns, plan.schema), note)
        new = build_table(columns, self.old.schema)
        others = ~np.isin(numbers_of(self.old, plan.samples), numbers_of(new, plan.samples))
        rows = pa.concat_tables([self.old.filter(pa.array(others)), new])
        rows = rows.take(pc.sort_indices(rows, [("case", "ascending"), ("sample", "ascending")]))
        if self.output.retry_failed and len(new) < self.rows:
            # Some that failed under the old limit are still there.
            note = replace(note, max_steps=self.limit)
        return store.write_block(index, rows, note)


def gather(task: Task[Columns]) -> tuple[Columns | None, int]:
    """Stop a task; columns of the runs that have ended, if any, and how many others had begun."""
    task.stop(GATHER)
    try:
        return task.value(), 0
    except Interrupted as stopped:
        return stopped.columns, stopped.lost
    except TimeoutError:
        return None, task.control.runs_begun
