"""Moved to `store.output`; until all have followed."""

from rattlesweep.sweeps.store.output import Output as Opened
from rattlesweep.sweeps.store.output import examine

__all__ = ["Opened", "examine"]
