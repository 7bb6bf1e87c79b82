"""From a config to its cases and samples, with the source of their bodies.

The row of a run follows from the config and its key alone.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.config.body_sources import MeshSource, SdSource, TableSource
from rattlesweep.config.clashes import (
    SETTING_KEYS,
    clashes_of_actions,
    numbers_without_unit,
)
from rattlesweep.config.schema import Config
from rattlesweep.design.bodies import Source
from rattlesweep.design.bodies.meshes import MeshBodies
from rattlesweep.design.bodies.sources import make_source
from rattlesweep.design.bodies.table import TableBodies, check_value
from rattlesweep.design.cases import MAX_RUNS, Case, Design
from rattlesweep.physics.si import Units
from rattlesweep.physics.theory import spin_and_oscillation
from rattlesweep.rows.columns import STATE_FIELDS, runs_schema
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import ACTING, INITIAL_RATES
from rattlesweep.words.units import Setting

# Bodies that are looked at to see whether their sizes differ.
_MOST_SIZES = 64
# Horizon of launches that have none of their own.
NO_END = np.array([np.nan])
# The values of each column that cases combine; none where a table has the column.
_Values = dict[str, list[Setting]]


@dataclass(frozen=True)
class Plan(Design):
    """The runs of a config, with the source of their bodies."""

    source: Source

    @cached_property
    def targets(self) -> Floats:
        """What the source needs to make the bodies of each case.

        The target of the torque coefficient, or the number of the mesh; NaN without.
        """
        if isinstance(self.config.bodies, MeshSource):
            paths = list(self.config.bodies.path)
            numbers = [paths.index(case.mesh or "") for case in self.cases]
            return np.array(numbers, float)
        return np.array([case.target for case in self.cases], float)


def make_plan(
    config: Config, base: Path | None = None, rows: TableBodies | None = None
) -> Plan:
    """Return the plan of a config.

    A table of bodies is `rows`, or else a file, which is searched for in the working
    directory and in `base`.  Raises a ConfigError for what cannot be run.
    """
    source = make_source(config, base, rows)
    # What a table has row by row replaces keys of the config.
    table: Mapping[str, Floats] = {}
    if isinstance(source, TableBodies):
        is_file = isinstance(config.bodies, TableSource) and config.bodies.path
        if source.units is not None and is_file:
            # Only now is it known that the bodies have a size.
            problems = [f"{key}: {text}" for key, text in numbers_without_unit(config)]
            if problems:
                raise ConfigError(problems)
        table = source.columns
        config = _with_losses(config, source.losses)
    # This refuses what the model cannot record.
    runs_schema(config.parts, config.model)
    values = _natural(config, source)
    launches, n_i = _launches(config, table, values)
    is_state = "u_x" in table or ("n_i" not in table and config.launch is not None)
    _check_launches(config, is_state, n_i, _own_ends(table))
    # The cases are all combinations of meshes, targets, launches and losses.
    targets: list[tuple[str | None, float | None]] = [(None, None)]
    if isinstance(config.bodies, SdSource) and config.bodies.target is not None:
        target = config.bodies.target
        targets = [(target.name, value) for value in target.values]
    losses: list[dict[str, Setting]] = [{}]
    if config.acting:
        losses = _combinations(config.acting.values, values)
    meshes: list[str | None] = [None]
    if isinstance(config.bodies, MeshSource):
        meshes = [*config.bodies.path]
    cases: list[Case] = []
    for mesh, (name, value), launch, loss in product(meshes, targets, launches, losses):
        case = Case.of(len(cases), name, value, launch | loss)
        cases.append(replace(case, mesh=mesh))
    extra = source.fields
    if is_state:
        extra = STATE_FIELDS + extra
    plan = Plan(config, tuple(cases), source.samples, extra, source)
    if plan.runs > MAX_RUNS:
        raise ConfigError(
            f"bodies: {len(cases)} cases of {plan.samples} samples are {plan.runs:.3g} "
            f"runs; at most {MAX_RUNS:.0e} are possible in one sweep"
        )
    return plan


def _launches(
    config: Config, table: Mapping[str, Floats], values: _Values
) -> tuple[list[dict[str, Setting]], Floats]:
    """Return the launches of the cases, and the spins of all launches.

    If each row of the table has its own launch, there is one launch without values.
    """
    if "n_i" in table:
        return [{}], table["n_i"]
    if config.launch is not None:
        state = config.launch
        spin, swing, _psi = spin_and_oscillation(state.omega, state.u)
        launch = {"n_i": Setting(float(spin)), "omega_xy0": Setting(float(swing))}
        return [launch], np.array([spin])
    if config.spin is not None:
        return _combinations(INITIAL_RATES, values), np.array(config.spin.n_i)
    raise ConfigError(
        "spin: missing; the table has no columns n_i and omega_xy0, so the config "
        "must give them"
    )


def _own_ends(table: Mapping[str, Floats]) -> Floats:
    """Return the horizons that a table gives its launches, NaN where it has none."""
    ends = table.get("t_end", NO_END)
    if "n_i" in table:
        return ends
    # Each launch of the config meets each row.  A row without an end makes this NaN, as
    # the launch then has none for that row.
    return np.array([ends.min()])


def _combinations(names: Iterable[str], values: _Values) -> list[dict[str, Setting]]:
    """Return every combination of the values of some columns."""
    names = list(names)
    combinations = product(*(values[name] for name in names))
    return [dict(zip(names, each, strict=True)) for each in combinations]


def _with_losses(config: Config, columns: Mapping[str, list[float | str]]) -> Config:
    """Return the config with what acts on bodies by a table's columns."""
    # A setting without a value is the word `table`, which stands for a column.
    from_table = Setting()
    for name in ACTING:
        values = config.settings.get(name, [])
        if from_table in values and name not in columns:
            raise ConfigError(
                f"{SETTING_KEYS[name]}: the table has no column {name}; give a number"
            )
        if len(values) > 1 and name in columns:
            raise ConfigError(
                f"{SETTING_KEYS[name]}: there are several values, and the table has a "
                f"column {name}; keep one of them"
            )
    shakes = columns.get("base_acceleration", [0.0]) != [0.0]
    if shakes and config.base is None and "base_frequency" not in columns:
        raise ConfigError(
            "bodies: the column base_acceleration needs the column base_frequency"
        )
    config = config.with_columns(columns)
    where = ""
    if columns and isinstance(config.bodies, TableSource) and config.bodies.path:
        # Otherwise they are arguments of a call.
        where = f"bodies.path: with {' and '.join(columns)} of the table: "
    problems = [f"{where}{key}: {text}" for key, text in clashes_of_actions(config)]
    if problems:
        raise ConfigError(problems)
    return config


def _natural(config: Config, source: Source) -> _Values:
    """Return spins and losses in units of the bodies.

    Where the bodies differ in size, a list that has units stays in SI units, and each
    body converts it for itself.
    """
    if not config.in_si:
        return config.settings
    # Rows of a table are at hand; bodies that are drawn are looked at in part.
    count = source.samples
    if not isinstance(source, TableBodies):
        count = min(count, _MOST_SIZES)
    if isinstance(source, MeshBodies):
        units: Units | None = source.units
    else:
        no_target = np.nan
        units = source.bodies(no_target, np.arange(count)).units
    natural: _Values = {}
    for name, values in config.settings.items():
        converted = [_convert(name, value, units) for value in values]
        if any(value.si is not None and value.natural is None for value in converted):
            # The value of the body differs from body to body, so all stay in SI units.
            if any(value.si is None for value in values):
                raise ConfigError(
                    f"{SETTING_KEYS[name]}: the sizes of the bodies differ, and some "
                    "values are in units of the bodies; give all of them in SI units, "
                    "or none"
                )
            converted = values
        natural[name] = converted
    return natural


def _convert(name: str, value: Setting, units: Units | None) -> Setting:
    """Return a value also in units of the bodies, unless that differs between them."""
    if value.si is None:
        return value
    key = f"{SETTING_KEYS[name]}: {value.si.text}"
    natural = np.array([np.nan])
    if units is not None:
        natural = np.atleast_1d(units.natural(value.si, value.si.kind))
    if np.isnan(natural).any():
        raise ConfigError(
            f"{key} needs the size of the bodies; give columns height_m and mass_kg, "
            "or a number in the bodies' own units"
        )
    broken = check_value(name, natural)
    if broken is not None:
        place, problem = broken
        raise ConfigError(
            f"{key} is {natural[place]:g} in units of the body; {problem}"
        )
    sizes_differ = natural.min() < natural.max()
    if sizes_differ:
        return value
    return Setting(float(natural[0]), value.si)


def _check_launches(
    config: Config, is_state: bool, n_i: Floats, own_end: Floats
) -> None:
    """Refuse launches that the model cannot have, or that have no horizon."""
    model = config.model
    horizon = config.horizon
    if model != "full" and is_state:
        raise ConfigError(
            f"model: {model} begins with a spin; full states are for the model full"
        )
    if model == "gh" and (n_i == 0).any():
        raise ConfigError(
            "model: gh begins with a spin, and n_i is 0; use full or reduced"
        )
    endless = (n_i == 0) & ~np.isfinite(own_end)
    if horizon.t is None and horizon.t_decay is None and endless.any():
        which = ""
        if len(n_i) > 1:
            which = f" ({np.argmax(endless) + 1} of {len(n_i)})"
        raise ConfigError(
            f"horizon.t: missing; a launch without spin{which} has no t_rGH, so give "
            "horizon: {t: TIME} in sqrt(a/g)"
        )
