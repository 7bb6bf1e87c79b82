"""A sweep that is on disk, opened; the way in for everything that reads one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Integers
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.decide import borders, make_stages, n_blocks
from rattlesweep.sweeps.config.bodies import TableSource
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.old.blockfile import Note
from rattlesweep.sweeps.old.manifest import Manifest
from rattlesweep.sweeps.provenance import identity
from rattlesweep.sweeps.old.store import Store

if TYPE_CHECKING:
    from rattlesweep.sweeps.plan import Plan


class Staged:
    """Follows a sweep that decides what to run next, as far as its blocks are there and whole.

    One that does all runs has no stages, and nothing to be decided. `config`, `cases` and `samples`
    are those of the sweep, `sweep` is its identity.
    """

    def __init__(self, store: Store, config: Config, cases: int, samples: int, sweep: str) -> None:
        self._store, self._size, self._sweep = store, config.block_size, sweep
        self._decide = make_stages(config, cases, samples)
        # Numbers of the runs of each stage that is known.
        self.stages: list[Integers] = [] if self._decide is None else [self._decide.first()]
        # Whether the last of them is in place, and nothing more is asked for.
        self.done = self._decide is None
        self.advance()

    def advance(self) -> bool:
        """Take all stages that are in place; whether there are new ones."""
        known, decide = len(self.stages), self._decide
        while decide is not None and not self.done and (tables := self._last()) is not None:
            for table in tables:
                for rows in table.select(list(decide.columns)).to_batches():
                    decide.add(rows)
            following = decide.next()
            if len(following):
                self.stages.append(following)
            else:
                self.done = True
        return len(self.stages) > known

    def of(self, plan: Plan) -> Plan:
        """The plan with the stages that are known."""
        return replace(plan, stages=tuple(self.stages))

    def _last(self) -> list[pa.Table] | None:
        """Rows of the last stage that is known, block by block; None if one is not whole."""
        sizes, tables = [len(stage) for stage in self.stages], []
        for index in range(n_blocks(sizes[:-1], self._size), n_blocks(sizes, self._size)):
            runs = (self._sweep, *borders(sizes, self._size, index))
            file = self._store.find_block(index, runs)
            if file is None or not file.complete:
                return None
            tables.append(file.table())
        return tables


@dataclass(frozen=True)
class Stored:
    """A sweep on disk: its files, and what its manifest says."""

    store: Store
    manifest: Manifest

    @property
    def directory(self) -> Path:
        """Where it is."""
        return self.store.directory

    @property
    def config(self) -> Config:
        """The config of its runs."""
        return self.manifest.config

    def present(self) -> list[int]:
        """Numbers of its blocks of which there is a file, whole or not."""
        return [index for index in self.store.block_indices() if index < self.manifest.blocks]

    def note(self, index: int) -> Note:
        """What the file of a block has to say of itself."""
        manifest = self.manifest
        return Note.of(manifest.config, manifest.config_hash, manifest.borders(index))

    @cached_property
    def staged(self) -> Staged:
        """What it has decided so far."""
        m = self.manifest
        return Staged(self.store, m.config, len(m.cases), m.samples, m.config_hash)

    def refuse_stages(self, what: str) -> None:
        """Refuse (ConfigError) what goes only where all runs are done, and none were chosen."""
        if self.manifest.stages:
            key = "bodies.refine" if self.config.stop is None else "stop"
            raise ConfigError(f"{self.directory}: {key} chose its runs by what came out, so {what}")

    def numbers(self, index: int) -> Integers | None:
        """Numbers of the runs of a block; None where stages before it are not whole."""
        first, stop = self.manifest.borders(index)
        if not (stages := self.staged.stages):
            return np.arange(first, stop)
        numbers = np.concatenate(stages)
        return numbers[first:stop] if stop <= len(numbers) else None

    @cached_property
    def plan(self) -> Plan:
        """What its runs can be had again from; a ConfigError if its table of bodies has changed."""
        # Numba, which most readers of a sweep do without.
        from rattlesweep.sweeps.plan import make_plan

        base = None if self.manifest.base is None else Path(self.manifest.base)
        bodies = self.config.bodies
        if isinstance(bodies, TableSource) and (self.directory / bodies.path).exists():
            base = self.directory  # which may have moved since
        plan = make_plan(self.config, base)
        if identity(plan, base) != self.manifest.config_hash:
            raise ConfigError(
                f"{self.directory}: its table of bodies has changed, so its runs cannot be had "
                "again"
            )
        return self.staged.of(plan)


def open_stored(directory: Path | str) -> Stored:
    """Open an output directory; errors as for `Store.read_manifest`."""
    store = Store(directory)
    return Stored(store, store.read_manifest())
