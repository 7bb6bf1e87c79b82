"""What a report tells of the runs in numbers: failures, steps, time, read in one pass."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.sweep.store import Store
from rattlesweep.sweep.types import TYPES

_COLUMNS = ("case", "sample", "type", "status", "t_end", "n_steps", "near_tangencies")


@dataclass
class Facts:
    """Of all runs in place.

    Attributes
    ----------
    runs : int
    types, status : Counter
        Runs by type, of those that are ``ok``; runs by status.
    first : dict
        Case and sample of the first run of each status.
    time : float
        Time integrated, in ``sqrt(a/g)``.
    steps : int
        Accepted steps.
    near_tangencies : int
    bytes : int
        Of the files of the runs.
    """

    runs: int = 0
    types: Counter[str] = field(default_factory=Counter)
    status: Counter[str] = field(default_factory=Counter)
    first: dict[str, tuple[int, int]] = field(default_factory=dict)
    time: float = 0.0
    steps: int = 0
    near_tangencies: int = 0
    bytes: int = 0


def gather(store: Store) -> Facts:
    """Read the facts of a sweep.

    Raises
    ------
    OutputError
        A block is unreadable.
    """
    facts = Facts()
    for batch in store.iter_batches(_COLUMNS):
        facts.runs += batch.num_rows
        _count(facts.status, batch.column("status"))
        _count(facts.types, batch.column("type"))
        facts.time += pc.sum(batch.column("t_end"), min_count=0).as_py()
        facts.steps += pc.sum(batch.column("n_steps"), min_count=0).as_py()
        facts.near_tangencies += pc.sum(batch.column("near_tangencies"), min_count=0).as_py()
        for word in facts.status.keys() - facts.first.keys():
            place = pc.index(batch.column("status"), word).as_py()
            facts.first[word] = tuple(
                batch.column(name)[place].as_py() for name in ("case", "sample")
            )
    facts.bytes = sum(store.block_path(index).stat().st_size for index in store.block_indices())
    facts.types = Counter({name: facts.types[name] for name in TYPES})
    return facts


def _count(counter: Counter[str], column: pa.Array) -> None:
    for entry in pc.value_counts(column).to_pylist():
        if entry["values"] is not None:
            counter[entry["values"]] += entry["counts"]
