"""What a report tells of the runs: all that it needs, from one pass over the files."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from queue import Queue
from typing import TypeVar

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import OutputError
from rattlesweep.sweeps.store.store import Store
from rattlesweep.sweeps.tables.types import TYPES

T = TypeVar("T")
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
    for batch in store.iter_batches(_COLUMNS, complete=True):
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


# ------------------------------------------------------------------ one pass for all


class _Reader(Store):
    """The store as one of several readers sees it that go through the rows together."""

    def __init__(self, store: Store) -> None:
        super().__init__(store.directory)
        self.pieces: Queue[pa.RecordBatch | BaseException | None] = Queue(maxsize=1)
        self.gone = False

    def iter_batches(
        self, columns: Sequence[str] | None = None, *, complete: bool = True
    ) -> Iterator[pa.RecordBatch]:
        """Yield what the common pass hands over, of complete blocks; can be called once."""
        while (batch := self.pieces.get()) is not None:
            if isinstance(batch, BaseException):
                raise batch
            absent = set(columns or ()).difference(batch.schema.names)
            if absent:
                raise OutputError(f"{self.runs} has no column {', '.join(sorted(absent))}")
            yield batch if columns is None else batch.select(list(columns))
        # The end stays in place for whoever looks for it once more.
        self.pieces.put(None)


def read_once(store: Store, jobs: Sequence[Callable[[Store], T]]) -> list[T | BaseException]:
    """Results of jobs that each go through all rows, from a single pass over the files.

    Memory does not grow with the rows: the jobs wait for each other, piece by piece.

    Parameters
    ----------
    store : Store
    jobs : sequence of callable
        Each gets a store whose ``iter_batches`` it calls at most once.

    Returns
    -------
    list
        What each returned or raised; all raise what makes the files unreadable.
    """
    readers = [_Reader(store) for _ in jobs]
    results: list[T | BaseException] = [RuntimeError("the job did not run")] * len(jobs)

    def work(place: int) -> None:
        try:
            results[place] = jobs[place](readers[place])
        except BaseException as error:
            results[place] = error
        readers[place].gone = True
        # The pass may be waiting to hand over a piece that nobody wants any more.
        while readers[place].pieces.get() is not None:
            pass

    team = [threading.Thread(target=work, args=(k,), daemon=True) for k in range(len(jobs))]
    for thread in team:
        thread.start()
    failure: BaseException | None = None
    try:
        for batch in store.iter_batches(complete=True):
            for reader in readers:
                if not reader.gone:
                    reader.pieces.put(batch)
            if all(reader.gone for reader in readers):
                break
    except BaseException as error:
        failure = error
    for reader in readers:
        if failure is not None and not reader.gone:
            reader.pieces.put(failure)
        reader.pieces.put(None)
    for thread in team:
        thread.join()
    if failure is not None and not isinstance(failure, Exception):
        raise failure
    return results
