"""How far a sweep is, and how long it will take."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from rattlesweep.sweeps.engines.progress import Progress, Tracker


def test_the_time_left_never_falls_below_zero():
    """Costs add up to a last bit more in another order, here 1e-15."""
    blocks: Any = [SimpleNamespace(index=i, rows=5) for i in range(10)]
    cost = [0.7, 0.7, 0.1, 0.3, 0.6, 0.7, 0.7, 0.3, 0.7, 0.3]
    costs: Any = SimpleNamespace(of=lambda block: cost[block.index])
    seen: list[Progress] = []
    tracker = Tracker(costs, blocks, dict.fromkeys(range(10), 5), seen.append)
    tracker.begin()
    for block in reversed(blocks):
        tracker.finish(block)
        tracker.tick()
    assert all(p.left is not None and p.left >= 0 for p in seen)
    assert [p.fraction for p in seen] == sorted(p.fraction for p in seen)
    assert (seen[-1].fraction, seen[-1].runs) == (1.0, 50)
