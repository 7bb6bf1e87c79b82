"""From a config to its cases and samples, and to the directory that holds their runs.

A case is one combination of target, ``n_i``, ``omega_xy0`` and dissipation.  A run is
one sample of a case and has the key ``(case, sample)``; its row follows from config and
key alone.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.physics.theory import spin_and_oscillation
from rattlesweep.sweeps.bodies import Source
from rattlesweep.sweeps.bodies.sources import make_source
from rattlesweep.sweeps.bodies.table import LOSSES, TableBodies, check_value
from rattlesweep.sweeps.columns import STATE, runs_schema
from rattlesweep.sweeps.config.read import (
    differences,
    fixed_part,
    physics_hash,
    resolved,
)
from rattlesweep.sweeps.config.schema import Config, SdSource, clashes
from rattlesweep.sweeps.files import explained
from rattlesweep.sweeps.locks import LOCKS, at_work
from rattlesweep.sweeps.provenance import command_line, machine, now, versions
from rattlesweep.sweeps.stored import (
    FOLDER,
    FORMAT,
    MANIFEST,
    Case,
    Design,
    Stored,
    open_stored,
)
from rattlesweep.units import Quantity

MAX_RUNS = 10**9  # in a sweep, which holds one byte for each of them
# Keys of the config that may have SI units, by the columns that they set.
KEYS = {
    "n_i": "spin.n_i",
    "omega_xy0": "spin.omega_xy0",
    "t_end": "horizon.t",
    "sigma": "dissipation.sigma",
    "rolling": "dissipation.rolling",
}


@dataclass(frozen=True)
class Plan(Design):
    """The runs of a config, with the source of their bodies."""

    source: Source

    @cached_property
    def targets(self) -> Floats:
        """Target of each case, NaN without one."""
        return np.array([case.target for case in self.cases], float)


def make_plan(
    config: Config, base: Path | None = None, rows: TableBodies | None = None
) -> Plan:
    """Return the plan of a config; its table is `rows`, or searched for here and in
    `base`.
    """
    source = make_source(config, base, rows)
    table: Mapping[str, Floats] = {}
    if isinstance(source, TableBodies):
        table, config = source.columns, _with_losses(config, source.losses)
    runs_schema(config.parts, config.model)  # refuses what the model cannot record
    values = _natural(config, source)
    targets: list[tuple[str | None, float | None]] = [(None, None)]
    if (
        isinstance(config.bodies, SdSource)
        and (aim := config.bodies.target) is not None
    ):
        targets = [(aim.name, value) for value in aim.values]
    none: list[tuple[float | None, float | None]] = [(None, None)]
    launches = losses = none
    own_end = np.array([np.nan])
    if "n_i" in table:
        n_i, own_end = table["n_i"], table.get("t_end", own_end)
    elif config.launch is not None:
        spin, swing, *_ = spin_and_oscillation(config.launch.omega, config.launch.u)
        launches, n_i = [(float(spin), float(swing))], np.array([spin])
    elif config.spin is not None:
        launches = list(product(values["n_i"], values["omega_xy0"]))
        n_i = np.array(config.spin.n_i)
    else:
        lacks = "the table has no columns n_i and omega_xy0"
        raise ConfigError(f"spin: missing; {lacks}, so the config must give them")
    is_state = "u_x" in table or ("n_i" not in table and config.launch is not None)
    _check_launches(config, is_state, n_i, own_end)
    if config.dissipation:
        losses = list(product(values["sigma"], values["rolling"]))
    made = enumerate(product(targets, launches, losses))
    cases = tuple(Case(number, *a, *b, *c) for number, (a, b, c) in made)
    extra = (STATE if is_state else ()) + source.fields
    plan = Plan(config, cases, source.samples, extra, source)
    if plan.runs > MAX_RUNS:
        told = f"{len(cases)} cases of {plan.samples} samples are {plan.runs:.3g} runs"
        raise ConfigError(
            f"bodies: {told}; at most {MAX_RUNS:.0e} are possible in one sweep"
        )
    return plan


def _with_losses(config: Config, own: Mapping[str, list[float | str]]) -> Config:
    """Return the config with the dissipation of a table's columns."""
    given = config.dissipation
    for name in LOSSES:
        values, column = config.settings[name], f"column {name}"
        if None in values and name not in own:
            raise ConfigError(
                f"dissipation.{name}: the table has no {column}; give a number"
            )
        if len(values) > 1 and name in own:
            told = f"there are several values, and the table has a {column}"
            raise ConfigError(f"dissipation.{name}: {told}; keep one of them")
    config = config.model_copy(
        update={"dissipation": given.model_copy(update=dict(own))}
    )
    if own and (wrong := [": ".join(one) for one in clashes(config)]):
        raise ConfigError(
            f"bodies.path: with the table's columns: {one}" for one in wrong
        )
    return config


def _natural(config: Config, source: Source) -> dict[str, list[float | None]]:
    """Return spins and losses in units of the bodies, or in SI units where the bodies
    differ.
    """
    if not config.in_si:
        return config.settings
    count = (
        source.samples if isinstance(source, TableBodies) else min(source.samples, 64)
    )
    units = source.bodies(np.nan, np.arange(count)).units

    def convert(name: str, value: float | None) -> float | None:
        if not isinstance(value, Quantity):
            return value
        told = f"{KEYS[name]}: {value.text}"
        natural = np.atleast_1d(
            np.nan if units is None else units.natural(value, value.kind)
        )
        if np.isnan(natural).any():
            advice = "give columns height_m and mass_kg"
            raise ConfigError(
                f"{told} needs the size of the bodies; {advice}, or a number in the "
                "bodies' own units"
            )
        if broken := check_value(name, natural):
            own = f"is {natural[broken[0]]:g} in units of the body"
            raise ConfigError(f"{told} {own}; {broken[1]}")
        return float(natural[0]) if natural.min() == natural.max() else None

    found = dict(config.settings)
    for name, given in config.settings.items():
        found[name] = [convert(name, value) for value in given]
        if any(
            x is None and y is not None for x, y in zip(found[name], given, strict=True)
        ):
            if not all(isinstance(value, Quantity) for value in given):
                told = "the sizes of the bodies differ, and some values have no unit"
                raise ConfigError(
                    f"{KEYS[name]}: {told}; give all of them with units, or none"
                )
            found[name] = given
    return found


def _check_launches(
    config: Config, is_state: bool, n_i: Floats, own_end: Floats
) -> None:
    """Refuse launches that the model cannot have, or that have no horizon of any
    kind.
    """
    model, horizon = config.model, config.horizon
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
        which = f" ({np.argmax(endless) + 1} of {len(n_i)})" if len(n_i) > 1 else ""
        told = f"missing; a launch without spin{which} has no t_rGH"
        raise ConfigError(
            f"horizon.t: {told}, so give horizon: {{t: TIME}} in sqrt(a/g)"
        )


def stored_plan(stored: Stored) -> Plan:
    """Return the plan from which stored runs can be computed again."""
    base = stored.manifest["base"] or "."
    if (stored.directory / getattr(stored.config.bodies, "path", "..none")).exists():
        base = stored.directory  # a directory may have been moved with its table
    plan = replace(make_plan(stored.config, Path(base)), cases=stored.cases)
    check_same(stored, describe(plan, stored.directory))
    return replace(
        plan, config=plan.config.model_copy(update={"classify": stored.thresholds})
    )


def begin(plan: Plan, directory: Path, base: Path | None, shard: str | None) -> Stored:
    """Begin or grow the sweep of a plan in a directory that this process holds."""
    with explained(f"cannot write in {directory}"):
        (directory / FOLDER).mkdir(exist_ok=True)
    there, ours = examine(plan, directory, base)
    if there is not None:
        keys = ("cases", "samples") if shard else ("cases", "samples", "config")
        if all(ours.manifest[key] == there.manifest[key] for key in keys):
            return there
        # Shards that are at work know only the smaller sweep, whose summary they would
        # write.
        if shard and (others := at_work(directory, shard)):
            told = "is at work; the sweep can grow when it has ended"
            raise OutputError(f"{directory}: {others[0]} {told}")
        ours.manifest["started"] = there.manifest["started"]
    ours.drop_summary()
    ours.write_manifest()
    return ours


def examine(
    plan: Plan, directory: Path, base: Path | None = None
) -> tuple[Stored | None, Stored]:
    """Return the sweep that is in a directory, None without one, and what it must grow
    into.
    """
    ours = describe(plan, directory, base)
    if not (directory / MANIFEST).exists():
        check_empty(directory)
        ours.find()  # there are rows if a manifest was lost
        return None, ours
    there = open_stored(directory)
    check_same(there, ours)
    wanted, held, told = set(plan.cases), set(there.cases), ""
    if lost := [case for case in there.cases if case not in wanted]:
        told = f"runs with {lost[0]}, which the config lacks"
    elif plan.samples < there.samples:
        told = f"{there.samples} samples a case, more than the config asks for"
    if told:
        raise ConfigError(f"{directory}: holds {told}; a sweep can only grow")
    new = enumerate((case for case in plan.cases if case not in held), len(held))
    cases = (*there.cases, *(replace(case, index=number) for number, case in new))
    return there, describe(replace(plan, cases=cases), directory, base)


def describe(plan: Plan, directory: Path, base: Path | None = None) -> Stored:
    """Return the sweep of a plan as a directory would hold it; nothing is written."""
    text = f"{physics_hash(plan.config)} {getattr(plan.source, 'content_hash', '')}"
    key = hashlib.sha256(text.encode()).hexdigest()
    manifest: dict[str, Any] = {
        "format": FORMAT,
        "name": plan.config.name,
        "config": resolved(plan.config),
        "config_hash": key,
        "base": None if base is None else str(base),
        "cases": [case.dump() for case in plan.cases],
        "samples": plan.samples,
        "columns": [
            [
                f.name,
                str(f.type),
                f.nullable,
                *(f.metadata[word].decode() for word in (b"unit", b"description")),
            ]
            for f in plan.extra
        ],
        "versions": versions(),
        "machine": machine(),
        "command": command_line(),
        "started": now(),
        "written": now(),
    }
    return Stored(
        plan.config, plan.cases, plan.samples, plan.extra, directory, manifest, key
    )


def check_same(one: Stored, other: Stored) -> None:
    """Raise a ConfigError that says in what a stored sweep differs from another."""
    if one.hash != other.hash:
        parts = (fixed_part(each.config) for each in (one, other))
        what = "; ".join(differences(*parts)[:3]) or "the table of bodies has changed"
        raise ConfigError(
            f"{one.directory}: holds another sweep ({what}); give another output"
        )
    if one.schema.names != other.schema.names:
        raise ConfigError(
            f"{one.directory}: another version of rattlesweep wrote its runs, with "
            "other columns; repeat them in another directory"
        )


def check_empty(directory: Path) -> None:
    """Raise a ConfigError if a directory holds files, unless a sweep has worked
    there.
    """
    if directory.is_file():
        raise ConfigError(f"{directory}: is a file; give the path of a directory")
    if not directory.exists() or (directory / LOCKS).is_dir():
        return
    with explained(f"cannot read {directory}"):
        names = sorted(path.name for path in directory.iterdir())
    # Bodies of a DataFrame are written there before the sweep begins.
    if foreign := [name for name in names if not name.startswith((".", "bodies-"))]:
        told = (
            f"holds other files, such as {foreign[0]}; give an empty or new directory"
        )
        raise ConfigError(f"{directory}: {told}")
