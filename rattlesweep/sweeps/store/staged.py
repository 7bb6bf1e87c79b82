"""The stages of a sweep that decides what to run next, told from its blocks on disk."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rattlesweep.errors import ConfigError, DamagedError
from rattlesweep.sweeps.cases.stages import borders, make_stages, n_blocks

if TYPE_CHECKING:
    import numpy as np
    import pyarrow as pa
    from numpy.typing import NDArray

    from rattlesweep.sweeps.cases.stages import Stages
    from rattlesweep.sweeps.config.schema import Config
    from rattlesweep.sweeps.store.manifest import Manifest
    from rattlesweep.sweeps.store.store import Store


class Staged:
    """Follows a sweep from stage to stage, as far as its blocks are there and whole.

    Attributes
    ----------
    stages : list of ndarray of int64
        Numbers of the runs of each stage that is known.
    done : bool
        Whether the last of them is in place, and nothing more is asked for.
    """

    def __init__(self, store: Store, decide: Stages, size: int, sweep: str) -> None:
        self._store, self._decide, self._size, self._sweep = store, decide, size, sweep
        self.stages: list[NDArray[np.int64]] = [decide.first()]
        self.done = False

    @classmethod
    def of(
        cls, store: Store, config: Config, cases: int, samples: int, sweep: str
    ) -> Staged | None:
        """That of a config with so many cases and samples; None if it has no stages."""
        decide = make_stages(config, cases, samples)
        return None if decide is None else cls(store, decide, config.block_size, sweep)

    def advance(self) -> bool:
        """Take all stages that are in place; whether there are new ones."""
        known = len(self.stages)
        while not self.done and (tables := self._last()) is not None:
            for table in tables:
                for rows in table.select(list(self._decide.columns)).to_batches():
                    self._decide.add(rows)
            following = self._decide.next()
            if len(following):
                self.stages.append(following)
            else:
                self.done = True
        return len(self.stages) > known

    def _last(self) -> list[pa.Table] | None:
        """Rows of the last stage that is known, block by block; None if one is not whole."""
        sizes, tables = [len(stage) for stage in self.stages], []
        first, stop = n_blocks(sizes[:-1], self._size), n_blocks(sizes, self._size)
        for index in range(first, stop):
            try:
                file = self._store.read_block(index)
            except DamagedError:
                return None
            span = None if file.note is None else (file.note.first, file.note.stop)
            if not (file.complete and file.note and file.note.sweep == self._sweep
                    and span == borders(sizes, self._size, index)):  # fmt: skip
                return None
            tables.append(file.table())
        return tables


def refuse_stages(manifest: Manifest, where: object, what: str) -> None:
    """Refuse what goes only where all runs are done.

    Raises
    ------
    ConfigError
        The sweep decided what to run.
    """
    if manifest.stages:
        key = "bodies.refine" if manifest.config.stop is None else "stop"
        raise ConfigError(f"{where}: {key} chose its runs by what came out, so {what}")
