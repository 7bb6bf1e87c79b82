"""From a config to its cases and samples.

A case is one combination of target, ``n_i`` and ``omega_xy0``, and of the dissipation where it has
several values; a run is one sample of a case, and its key is ``(case, sample)``.  What becomes of a
run follows from the config and its key alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.physics.launch import spin_and_oscillation
from rattlesweep.sweeps.bodies.protocol import Scale, Source
from rattlesweep.sweeps.bodies.sources import make_source
from rattlesweep.sweeps.bodies.table import KEYS, LOSSES, TableBodies, check_quantity
from rattlesweep.sweeps.cases import Case
from rattlesweep.sweeps.columns import STATE, runs_schema
from rattlesweep.sweeps.config.schema import TABLE, Config, SdSource, clashes
from rattlesweep.units import Quantity

MAX_RUNS = 10**9
"""Runs of a sweep; what is done of them is held as one byte each."""


@dataclass(frozen=True)
class Plan:
    """Runs that a config asks for.

    Attributes
    ----------
    config : Config
    source : Source
        Where the bodies come from.
    cases : tuple of Case
        Numbered from 0; a directory may hold them in another order than the config.
    extra : tuple of pa.Field
        Columns that the bodies and launches bring along.
    """

    config: Config
    source: Source
    cases: tuple[Case, ...]
    extra: tuple[pa.Field, ...] = ()

    @cached_property
    def schema(self) -> pa.Schema:
        """Arrow schema of the runs."""
        return runs_schema(self.config.parts, self.config.model, self.extra)

    @property
    def samples(self) -> int:
        """Number of samples of each case."""
        return self.source.samples

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of cases and samples."""
        return len(self.cases), self.samples

    @property
    def runs(self) -> int:
        """Number of runs, if none is left out."""
        return len(self.cases) * self.samples

    @cached_property
    def targets(self) -> Floats:
        """Target of each case, NaN without one."""
        return np.array([np.nan if c.target is None else c.target for c in self.cases])

    def with_cases(self, cases: Sequence[Case]) -> Plan:
        """Return the same plan with its cases in another order."""
        return replace(self, cases=tuple(cases))


def make_plan(config: Config, base: Path | None = None, source: Source | None = None) -> Plan:
    """Return the plan of a config; a ConfigError says if its parts do not go together.

    A relative path of a table is looked up from the working directory and then from `base`;
    `source` takes the place of the config's own bodies.
    """
    source = source or make_source(config, base)
    table = source if isinstance(source, TableBodies) else None
    if table is not None:
        config = _with_losses(config, table.losses)
    runs_schema(config.parts, config.model)  # refuses what the model cannot record
    targets: list[tuple[str | None, float | None]] = [(None, None)]
    if isinstance(config.bodies, SdSource) and config.bodies.target is not None:
        aim = config.bodies.target
        targets = [(aim.name, value) for value in aim.values]
    units = _Units(config, source)
    launches: list[tuple[float | None, float | None]] = [(None, None)]
    extra: tuple[pa.Field, ...] = ()
    if table is not None and table.has_launch:
        extra = STATE if table.has_state else ()
        n_i, t_end = table.columns["n_i"], table.columns.get("t_end")
        _check_launches(config, table.has_state, n_i, t_end, " (row {} of the table)")
    elif config.launch is not None:
        n_i, omega_xy0, _ = spin_and_oscillation(config.launch.omega, config.launch.u)
        launches = [(float(n_i), float(omega_xy0))]
        extra = STATE
        _check_launches(config, True, np.array([n_i]))
    elif (spin := config.spin) is not None:
        spins, pushes = units.lost("n_i", spin.n_i), units.lost("omega_xy0", spin.omega_xy0)
        launches = list(product(spins, pushes))
        _check_launches(config, False, np.array(spin.n_i))
    else:
        raise ConfigError(
            "spin: missing; the table has no columns n_i and omega_xy0, so the config must "
            "give spin.n_i and spin.omega_xy0"
        )
    losses: list[tuple[float | None, float | None]] = [(None, None)]
    if lost := config.dissipation:
        sigma, rolling = (units.lost(name, lost.values(name)) for name in LOSSES)
        losses = list(product(sigma, rolling))
    combinations = product(targets, launches, losses)
    cases = tuple(
        Case(number, *target, *launch, *loss)
        for number, (target, launch, loss) in enumerate(combinations)
    )
    plan = Plan(config, source, cases, extra + source.fields)
    if plan.runs > MAX_RUNS:
        told = f"{len(cases)} cases of {plan.samples} samples are {plan.runs:.3g} runs"
        raise ConfigError(f"bodies: {told}; at most {MAX_RUNS:.0e} are possible in one sweep")
    return plan


class _Units:
    """The units of a sweep's bodies, where the config has values in SI units."""

    def __init__(self, config: Config, source: Source) -> None:
        self.scale: Scale | None = None
        if not (given := config.in_si):
            return
        count = source.samples if isinstance(source, TableBodies) else min(source.samples, 64)
        self.scale = source.bodies(np.nan, np.arange(count)).scale
        for name, values in given.items():
            told = f"{KEYS[name]}: {values[0].text} needs the size of the bodies"
            if self.scale is None:
                what = f"and these of source {config.bodies.source} have none"
                raise ConfigError(f"{told}, {what}; give a number in their own units")
            if np.isnan(self.scale.natural(values[0], values[0].kind)).any():
                raise ConfigError(f"{told}; add a column mass_kg to the table")

    def lost(self, name: str, values: Sequence[float | None]) -> list[float | None]:
        """Return values without units; None stands for those that differ between bodies."""
        found: list[float | None] = []
        for value in values:
            if not isinstance(value, Quantity) or self.scale is None:
                found.append(value)
                continue
            natural = self.scale.natural(value, value.kind)
            check_quantity(name, value, natural)
            same = natural.min() == natural.max()
            if not same and len(values) > 1:
                told = f"{value.text} is another number for each body, as their sizes differ"
                raise ConfigError(f"{KEYS[name]}: {told}; give it alone, or numbers without units")
            found.append(float(natural[0]) if same else None)
        return found


def _with_losses(config: Config, own: Mapping[str, float | str]) -> Config:
    """Return the config with the dissipation that a table gives for its rows."""
    given = config.dissipation
    for name in LOSSES:
        value, column = getattr(given, name), f"column {name}"
        if value == TABLE and name not in own:
            raise ConfigError(f"dissipation.{name}: the table has no {column}; give a number")
        if isinstance(value, list) and name in own:
            told = f"there are several values, and the table has a {column}"
            raise ConfigError(f"dissipation.{name}: {told}; keep one of them")
    found = given.model_copy(update=dict(own))
    if found == given:
        return config
    config = config.model_copy(update={"dissipation": found})
    if wrong := [": ".join(one) for one in clashes(config)]:
        raise ConfigError(f"bodies.path: with the table's columns: {one}" for one in wrong)
    return config


def _check_launches(
    config: Config, state: bool, n_i: Floats, t_end: Floats | None = None, which: str = ""
) -> None:
    """Raise a ConfigError for launches that no model takes or that have no horizon.

    `state` says whether they are full states; `t_end` are horizons of their own, NaN for none;
    `which` has a place for the number of a row.
    """
    model, tapped = config.model, n_i == 0
    lost = tapped if t_end is None else tapped & ~np.isfinite(t_end)
    if model != "full" and state:
        raise ConfigError(f"model: {model} begins with a spin; full states are for the model full")
    if model == "gh" and tapped.any():
        raise ConfigError("model: gh begins with a spin, and n_i is 0; take full or reduced")
    if config.horizon.t is None and config.horizon.t_decay is None and lost.any():
        told = f"missing; a launch without spin{which.format(np.argmax(lost) + 1)} has no t_rGH"
        raise ConfigError(f"horizon.t: {told}, so give horizon: {{t: TIME}} in sqrt(a/g)")
