"""A sweep that is on disk, opened; the way in for everything that reads one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.config.bodies import TableSource
from rattlesweep.sweeps.store.blockfile import Note
from rattlesweep.sweeps.store.manifest import Manifest
from rattlesweep.sweeps.store.provenance import identity
from rattlesweep.sweeps.store.staged import Staged
from rattlesweep.sweeps.store.store import Store

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.sweeps.cases.plan import Plan
    from rattlesweep.sweeps.config.schema import Config


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
    def staged(self) -> Staged | None:
        """What it has decided so far; None if it does all runs."""
        manifest = self.manifest
        staged = Staged.of(
            self.store, manifest.config, len(manifest.cases), manifest.samples, manifest.config_hash
        )
        if staged is not None:
            staged.advance()
        return staged

    def numbers(self, index: int) -> NDArray[np.int64] | None:
        """Numbers of the runs of a block; None where stages before it are not whole."""
        first, stop = self.manifest.borders(index)
        if self.staged is None:
            return np.arange(first, stop)
        numbers = np.concatenate(self.staged.stages)
        return numbers[first:stop] if stop <= len(numbers) else None

    @cached_property
    def plan(self) -> Plan:
        """What its runs can be had again from.

        Raises
        ------
        ConfigError
            Its table of bodies is not there, or has changed.
        """
        # Numba, which most readers of a sweep do without.
        from rattlesweep.sweeps.cases.plan import make_plan

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
        return plan if self.staged is None else replace(plan, stages=tuple(self.staged.stages))


def open_stored(directory: Path | str) -> Stored:
    """Open an output directory; errors as for `Store.read_manifest`."""
    store = Store(directory)
    return Stored(store, store.read_manifest())
