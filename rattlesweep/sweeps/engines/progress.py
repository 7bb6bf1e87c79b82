"""How far a sweep is, weighted by what its runs are expected to cost."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rattlesweep.integrate.batch import Control
    from rattlesweep.sweeps.cases.costs import Costs
    from rattlesweep.sweeps.cases.plan import Block


@dataclass(frozen=True)
class Progress:
    """How far a sweep is."""

    fraction: float  # of the expected cost, blocks found on disk included
    runs: int  # done
    total: int  # runs
    elapsed: float  # seconds since the start
    left: float | None  # seconds, estimated; None as long as there is nothing to judge by


class Tracker:
    """Counts what is done of `blocks`, and says how long the rest will take.

    `left` are the runs to integrate, by the numbers of the blocks that are not in place; `report`
    is called with a :class:`Progress` at each tick.
    """

    def __init__(
        self,
        costs: Costs,
        blocks: list[Block],
        left: Mapping[int, int],
        report: Callable[[Progress], None],
    ) -> None:
        self._report, self._rows = report, left
        whole = {block.index: costs.of(block) for block in blocks}
        self._costs = {
            block.index: whole[block.index] * left[block.index] / block.rows
            for block in blocks
            if block.index in left
        }
        self._total, self._left = sum(whole.values()), sum(self._costs.values())
        self._all_runs = sum(block.rows for block in blocks)
        self._runs = self._all_runs - sum(left.values())
        self._done = 0.0
        self._start = time.perf_counter()
        self._begun = 0.0

    def begin(self) -> None:
        """Say that work begins now: what came before, such as compilation, is no rate."""
        self._begun = time.perf_counter() - self._start

    def finish(self, block: Block) -> None:
        """Count a block that is done."""
        self._done += self._costs[block.index]
        self._runs += self._rows[block.index]

    def tick(self, block: Block | None = None, control: Control | None = None) -> Progress:
        """Report, with what the kernel says of the block under way."""
        done, runs = self._done, self._runs
        if block is not None and control is not None and control.total > 0:
            done += self._costs[block.index] * min(1.0, control.done / control.total)
            runs += control.runs_done
        elapsed = time.perf_counter() - self._start
        left = None
        if done > 0:
            # Rounding may have done exceed the whole by a last bit.
            left = max(0.0, self._left - done) * (elapsed - self._begun) / done
        fraction = 1.0
        if self._total > 0:
            fraction = min(1.0, 1.0 - (self._left - done) / self._total)
        progress = Progress(fraction, runs, self._all_runs, elapsed, left)
        self._report(progress)
        return progress
