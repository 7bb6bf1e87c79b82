"""From a config to cases and blocks.

A case is one combination of target, ``n_i`` and ``omega_xy0``, and of the dissipation where it has
several values; its runs are the samples of the source.  Runs are numbered case by case, and a block
is a fixed slice of these numbers: its rows depend on the config and on the block's number alone.  A
sweep that decides what to run next does so in stages (:mod:`rattlesweep.sweeps.decide`), each
with blocks of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.physics.launch import spin_and_oscillation
from rattlesweep.sweeps.bodies.protocol import Source
from rattlesweep.sweeps.bodies.sources import make_source
from rattlesweep.sweeps.bodies.table import TableBodies
from rattlesweep.sweeps.columns import STATE, runs_schema
from rattlesweep.sweeps.config.bodies import SdSource
from rattlesweep.sweeps.config.fields import TABLE
from rattlesweep.sweeps.config.load import parse_config
from rattlesweep.sweeps.config.schema import Config, Dissipation
from rattlesweep.sweeps.decide import borders, make_stages, n_blocks

# Files in one directory, all of which are looked at as a sweep begins: some seconds.
MAX_BLOCKS = 100_000


@dataclass(frozen=True)
class Case:
    """One combination of target, launch and dissipation; None is for the rows of a table to say."""

    index: int
    target_name: str | None
    target: float | None
    n_i: float | None
    omega_xy0: float | None
    sigma: float | None = None
    rolling: float | None = None


@dataclass(frozen=True)
class Block:
    """A slice of the runs by their places in the sweep, ``first <= place < stop``."""

    index: int
    first: int
    stop: int

    @property
    def rows(self) -> int:
        """Number of runs."""
        return self.stop - self.first


@dataclass(frozen=True)
class Plan:
    """What a config comes to.

    Attributes
    ----------
    extra : tuple of pa.Field
        Columns that its bodies and launches bring along.
    stages : tuple of ndarray of int64
        Numbers of the runs of each stage that is known; empty where all runs are done in one.
    """

    config: Config
    source: Source
    cases: tuple[Case, ...]
    extra: tuple[pa.Field, ...] = ()
    stages: tuple[Integers, ...] = ()

    @property
    def schema(self) -> pa.Schema:
        """Of its runs."""
        return runs_schema(self.config.parts, self.config.model, self.extra)

    @property
    def block_size(self) -> int:
        """Runs of a block, but for the last of a stage."""
        return self.config.block_size

    @property
    def samples(self) -> int:
        """Samples of each case."""
        return self.source.samples

    @cached_property
    def targets(self) -> Floats:
        """Target of each case; NaN without one."""
        return np.array([c.target for c in self.cases], float)

    @property
    def runs(self) -> int:
        """Number of runs of the sweep, as far as its stages are known."""
        return sum(self.sizes)

    @property
    def sizes(self) -> list[int]:
        """Runs of each stage."""
        return [len(s) for s in self.stages] or [self.samples * len(self.cases)]

    @property
    def stages_by(self) -> str:
        """The key of the config by which there are stages."""
        return "bodies.refine" if self.config.stop is None else "stop"

    @property
    def whole(self) -> Plan:
        """All runs that there may be, in one stage."""
        return replace(self, stages=())

    @property
    def n_blocks(self) -> int:
        """Number of blocks."""
        return n_blocks(self.sizes, self.block_size)

    def block(self, index: int) -> Block:
        """One block."""
        return Block(index, *borders(self.sizes, self.block_size, index))

    def runs_of(self, block: Block) -> tuple[Integers, Integers]:
        """Case and sample numbers of a block's runs."""
        return self.runs_at(np.arange(block.first, block.stop))

    def runs_at(self, places: Integers) -> tuple[Integers, Integers]:
        """Case and sample numbers of runs by their places in the sweep."""
        numbers = np.concatenate(self.stages)[places] if self.stages else places
        case, sample = np.divmod(numbers, self.samples)
        return case, sample

    def place(self, case: int, sample: int) -> int | None:
        """Place of a run in the sweep; None if it is not one of it."""
        number = case * self.samples + sample
        if not self.stages:
            return number
        found = np.flatnonzero(np.concatenate(self.stages) == number)
        return int(found[0]) if len(found) else None

    def block_of(self, place: int) -> int:
        """Number of the block with the run at a place."""
        index = 0
        for runs in self.sizes:
            if place < runs:
                return index + place // self.block_size
            index, place = index + -(-runs // self.block_size), place - runs
        raise IndexError(place)


def make_plan(config: Config, base: Path | None = None, source: Source | None = None) -> Plan:
    """Cases, source (:func:`rattlesweep.sweeps.bodies.sources.make_source`) and blocks of a config.

    Another `source` may take the place of its own.
    """
    source = source or make_source(config, base)
    if isinstance(source, TableBodies):
        config = _with_losses(config, source.losses)
    runs_schema(config.parts, config.model)
    targets: list[tuple[str | None, float | None]] = [(None, None)]
    if isinstance(config.bodies, SdSource) and config.bodies.target is not None:
        aim = config.bodies.target
        targets = [(aim.name, value) for value in aim.values]
    launches: list[tuple[float | None, float | None]] = [(None, None)]
    extra: tuple[pa.Field, ...] = ()
    if isinstance(source, TableBodies) and source.has_launch:
        extra = STATE if source.has_state else ()
        n_i, t_end = source.columns["n_i"], source.columns.get("t_end")
        _check_launches(config, source.has_state, n_i, t_end, " (row {} of the table)")
    elif config.launch is not None:
        n_i, omega_xy0, _ = spin_and_oscillation(config.launch.omega, config.launch.u)
        launches = [(float(n_i), float(omega_xy0))]
        extra = STATE
        _check_launches(config, True, np.array([n_i]))
    elif config.spin is not None:
        launches = list(product(config.spin.n_i, config.spin.omega_xy0))
        _check_launches(config, False, np.array(config.spin.n_i))
    else:
        raise ConfigError(
            "spin: missing; the table has no columns n_i and omega_xy0, so the config must "
            "give spin.n_i and spin.omega_xy0"
        )
    if isinstance(source, TableBodies):
        extra += source.fields
    losses = config.dissipation.cases if config.dissipation else [(None, None)]
    cases = tuple(
        Case(index, *target, *launch, *loss)
        for index, (target, launch, loss) in enumerate(product(targets, launches, losses))
    )
    stages = make_stages(config, len(cases), source.samples)
    first = () if stages is None else (stages.first(),)
    plan = Plan(config, source, cases, extra, first)
    if plan.n_blocks > MAX_BLOCKS:
        raise ConfigError(
            f"block_size: {plan.runs} runs make {plan.n_blocks} blocks of {plan.block_size} runs, "
            f"each a file; at most {MAX_BLOCKS} are possible, so take fewer samples, fewer cases, "
            "or larger blocks"
        )
    return plan


def _with_losses(config: Config, own: Mapping[str, float | str]) -> Config:
    """The config of a table that says the dissipation of its rows."""
    given = config.dissipation
    for name in Dissipation.model_fields:
        if getattr(given, name) == TABLE and name not in own:
            raise ConfigError(
                f"dissipation.{name}: the table has no column {name}; add it, or give a number"
            )
        if isinstance(getattr(given, name), list) and name in own:
            raise ConfigError(
                f"dissipation.{name}: there are several values, and the table has a column {name}; "
                "keep one of them"
            )
    found = given.model_copy(update=dict(own))
    if found == given:
        return config
    try:
        data = config.model_dump() | {"dissipation": found.model_dump()}
        return parse_config(data).placed(config.places)
    except ConfigError as error:
        words = [f"bodies.path: with the table's columns: {line}" for line in error.messages]
        raise ConfigError(words) from None


def _check_launches(
    config: Config, state: bool, n_i: Floats, t_end: Floats | None = None, which: str = ""
) -> None:
    """Refuse launches that go with no model, or have no horizon.

    `state` says whether they are full states, `t_end` are horizons of their own, NaN for none, and
    `which` has a place for the number of a row.
    """
    model, tapped = config.model, n_i == 0
    lost = tapped if t_end is None else tapped & ~np.isfinite(t_end)
    if model != "full" and state:
        raise ConfigError(
            f"model: {model} begins with a spin and an oscillation; launches from a full state are "
            "for the model full"
        )
    if model == "gh" and tapped.any():
        raise ConfigError(
            "model: gh begins with a spin, and n_i is 0; take the model full or reduced"
        )
    if config.horizon.t is None and config.horizon.t_decay is None and lost.any():
        raise ConfigError(
            f"horizon.t: missing; a launch without spin{which.format(np.argmax(lost) + 1)} has no "
            "t_rGH, so give horizon: {t: TIME} in sqrt(a/g)"
        )
