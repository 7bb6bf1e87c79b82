"""Shares of a sweep: which blocks are whose."""

from __future__ import annotations

import heapq
import re
from dataclasses import dataclass

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.cost import Costs
from rattlesweep.sweeps.plan import Block, Plan


@dataclass(frozen=True)
class Shard:
    """Share ``index`` of ``count``, counted from 0 as job arrays count."""

    index: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read ``I/N``; a ValueError says what is wrong with it."""
        match = re.fullmatch(r"\s*(\d{1,9})\s*/\s*(\d{1,9})\s*", text)
        if not match:
            raise ValueError("is not I/N; write it as in --shard 0/4")
        index, count = int(match[1]), int(match[2])
        if index >= count:
            raise ValueError(
                "there is no such share; I runs from 0 to N-1"
                + (f", so from 0 to {count - 1}" if count else "")
            )
        return cls(index, count)

    @property
    def name(self) -> str:
        """For files."""
        return f"shard-{self.index}-of-{self.count}"

    def __str__(self) -> str:
        """As it is typed."""
        return f"{self.index}/{self.count}"


def refuse_stages(plan: Plan) -> None:
    """Refuse to share out a sweep that decides what to run next."""
    if plan.stages:
        raise ConfigError(
            f"{plan.stages_by}: what is run next depends on all runs before, so there are no "
            "shares that know nothing of each other; use all cores, or --engine dask"
        )


def deal(plan: Plan, count: int, costs: Costs) -> list[list[Block]]:
    """Blocks of each of so many shares, in order.

    The dearest block goes to the share that has least so far, and so on. Costs are
    counted in 1e-4 of the dearest, so that machines whose sines differ in the last bit deal alike.
    """
    blocks = [plan.block(index) for index in range(plan.n_blocks)]
    if count == 1:
        return [blocks]
    refuse_stages(plan)
    expected = [costs.of(block) for block in blocks]
    unit = max(expected) / 1e4 or 1.0
    weights = [max(1, round(cost / unit)) for cost in expected]
    totals = [(0, place) for place in range(min(count, len(blocks)))]
    shares: list[list[Block]] = [[] for _ in range(count)]
    for block in sorted(blocks, key=lambda block: (-weights[block.index], block.index)):
        total, place = heapq.heappop(totals)
        heapq.heappush(totals, (total + weights[block.index], place))
        shares[place].append(block)
    return [sorted(share, key=lambda block: block.index) for share in shares]
