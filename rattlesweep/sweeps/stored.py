"""Adapter until the folder of rows is here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa

from rattlesweep.sweeps.counts import columns_for
from rattlesweep.sweeps.old.manifest import StoredCase
from rattlesweep.sweeps.old.stored import Stored as Old
from rattlesweep.sweeps.old.stored import open_stored as old_open
from rattlesweep.sweeps.config.schema import Classify, Config


class Case:
    def __init__(self, index: int, case: StoredCase) -> None:
        self.index = index
        self.target_name, self.target = case.target_name, case.target
        self.n_i, self.omega_xy0 = case.n_i, case.omega_xy0
        self.sigma, self.rolling = case.sigma or 0.0, case.rolling or 0.0


class Stored:
    """A sweep on disk."""

    def __init__(self, old: Old) -> None:
        self.old = old
        self.directory: Path = old.directory
        self.config: Config = old.config
        self.cases = tuple(Case(k, case) for k, case in enumerate(old.manifest.cases))
        self.samples: int = old.manifest.samples
        self.hash: str = old.manifest.config_hash
        self.schema: pa.Schema = old.manifest.schema
        self.manifest: dict[str, Any] = old.manifest.dump()

    @property
    def thresholds(self) -> Classify:
        changed = self.old.manifest.classified
        return self.config.classify.model_copy(update=changed.now if changed else {})

    def files(self) -> list[Path]:
        return sorted((self.directory / "runs").glob("*.parquet"))

    def read(self, columns: Sequence[str] | None = None) -> pa.Table:
        wanted = self.schema if columns is None else pa.schema([self.schema.field(n) for n in columns])
        return pa.Table.from_batches(list(self.batches(columns)), wanted)

    def batches(self, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        names = self.schema.names if columns is None else list(columns)
        for batch in self.old.store.iter_batches(names, complete=False):
            yield pa.RecordBatch.from_arrays(
                [batch.column(n) for n in names],
                schema=pa.schema([self.schema.field(n) for n in names]),
            )

    def count(self) -> int:
        return sum(batch.num_rows for batch in self.batches(["case"]))

    def summary(self) -> pa.Table:
        from rattlesweep.sweeps.summary import summarise

        store = self.old.store
        if store.summary_path.exists():
            return store.read_summary()
        return summarise(store, self.old.manifest.cases, columns_for(self.config))

    @cached_property
    def plan(self) -> Any:
        return self.old.plan


def open_stored(directory: Path | str) -> Stored:
    return Stored(old_open(directory))
