"""From a config to cases and blocks.

A case is one combination of target, ``n_i`` and ``omega_xy0``; its runs are the samples of
the source.  Runs are numbered case by case, and a block is a fixed slice of these numbers: its rows
depend on the config and on the block's number alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.cases.sources import Source, TableBodies, make_source
from rattlesweep.sweeps.config.bodies import SdSource
from rattlesweep.sweeps.config.schema import Config

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


# Files in one directory, all of which are looked at as a sweep begins: some seconds.
MAX_BLOCKS = 100_000


@dataclass(frozen=True)
class Case:
    """One case; ``group`` is the place of its target in the target list."""

    index: int
    group: int
    target_name: str | None
    target: float | None
    n_i: float | None
    omega_xy0: float | None


@dataclass(frozen=True)
class Block:
    """A slice of the run numbers, ``first <= run < stop``."""

    index: int
    first: int
    stop: int

    @property
    def rows(self) -> int:
        """Number of runs."""
        return self.stop - self.first


@dataclass(frozen=True)
class Plan:
    """What a config comes to."""

    config: Config
    source: Source
    cases: tuple[Case, ...]
    block_size: int

    @property
    def samples(self) -> int:
        """Samples of each case."""
        return self.source.samples

    @property
    def runs(self) -> int:
        """Number of runs of the sweep."""
        return self.samples * len(self.cases)

    @property
    def n_blocks(self) -> int:
        """Number of blocks."""
        return -(-self.runs // self.block_size)

    def block(self, index: int) -> Block:
        """One block."""
        size = self.block_size
        return Block(index, index * size, min((index + 1) * size, self.runs))

    def runs_of(self, block: Block) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Case and sample numbers of a block's runs."""
        case, sample = np.divmod(np.arange(block.first, block.stop), self.samples)
        return case, sample


def make_plan(config: Config, base: Path | None = None) -> Plan:
    """Cases, source (:func:`rattlesweep.sweeps.cases.sources.make_source`) and blocks of a config.

    Raises
    ------
    ConfigError
        If the source cannot deliver, nothing says how to launch, the model and the recordings do
        not go together, or there would be too many blocks.
    """
    from rattlesweep.sweeps.tables.columns import runs_schema

    runs_schema(config.record, config.model)
    source = make_source(config, base)
    targets: list[tuple[str | None, float | None]] = [(None, None)]
    if isinstance(config.bodies, SdSource) and config.bodies.target is not None:
        aim = config.bodies.target
        targets = [(aim.name, value) for value in aim.values]
    launches: list[tuple[float | None, float | None]] = [(None, None)]
    if not (isinstance(source, TableBodies) and source.has_launch):
        if config.spin is None:
            raise ConfigError(
                "spin: missing; the table has no columns n_i and omega_xy0, so the config must "
                "give spin.n_i and spin.omega_xy0"
            )
        launches = list(product(config.spin.n_i, config.spin.omega_xy0))
    groups = product(enumerate(targets), launches)
    cases = tuple(
        Case(index, group, *target, *launch)
        for index, ((group, target), launch) in enumerate(groups)
    )
    plan = Plan(config, source, cases, config.block_size)
    if plan.n_blocks > MAX_BLOCKS:
        raise ConfigError(
            f"block_size: {plan.runs} runs make {plan.n_blocks} blocks of {plan.block_size} runs, "
            f"each a file; at most {MAX_BLOCKS} are possible, so take fewer samples, fewer cases, "
            "or larger blocks"
        )
    return plan
