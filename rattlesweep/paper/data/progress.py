"""How data modules say how far they are."""

from __future__ import annotations

from collections.abc import Callable

# Told the share that is done and a few words; may raise to stop the work.
Progress = Callable[[float, str], None]


def between(progress: Progress, low: float, high: float) -> Progress:
    """Progress of a part, which is the share from ``low`` to ``high`` of something larger."""
    return lambda share, words: progress(low + (high - low) * share, words)
