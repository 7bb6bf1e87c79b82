"""How far a sweep is, weighted by what its runs are expected to cost."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rattlesweep.integrate.task import POLL

if TYPE_CHECKING:
    from rattlesweep.integrate.batch import Control
    from rattlesweep.sweeps.cases.costs import Costs
    from rattlesweep.sweeps.cases.plan import Block


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


class Tracker:
    """Counts what is done, and says how long the rest will take.

    Parameters
    ----------
    costs : Costs
    blocks : sequence of Block
        All that are to be done, those on disk included.
    there : mapping
        Rows that need not be integrated, by the numbers of the blocks.
    report : callable
        Called with a :class:`Progress` at each tick.
    """

    def __init__(
        self,
        costs: Costs,
        blocks: list[Block],
        there: dict[int, int],
        report: Callable[[Progress], None],
    ) -> None:
        self._report = report
        whole = {block.index: costs.of(block) for block in blocks}
        self._rows = {block.index: block.rows - there.get(block.index, 0) for block in blocks}
        self._costs = {b.index: whole[b.index] * self._rows[b.index] / b.rows for b in blocks}
        self._total, self._left = sum(whole.values()), sum(self._costs.values())
        self._all_runs = sum(block.rows for block in blocks)
        self._runs = self._all_runs - sum(self._rows.values())
        self._done = 0.0
        self._start = time.perf_counter()
        self._begun: float | None = None

    def begin(self) -> None:
        """Say that work begins now; otherwise the first sign of life says so."""
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
            # From the first sign of life on: compilation says nothing of what is left.
            if self._begun is None:
                self._begun = max(0.0, elapsed - POLL)
            # Rounding may have done exceed the whole by a last bit.
            left = max(0.0, self._left - done) * (elapsed - self._begun) / done
        fraction = 1.0
        if self._total > 0:
            fraction = min(1.0, 1.0 - (self._left - done) / self._total)
        progress = Progress(fraction, runs, self._all_runs, elapsed, left)
        self._report(progress)
        return progress
