"""Moved to `store.blockfile` and `store.manifest`; until all have followed."""

from rattlesweep.sweeps.store.blockfile import Note
from rattlesweep.sweeps.store.manifest import Receipt, count_failed

__all__ = ["Note", "Receipt", "count_failed"]
