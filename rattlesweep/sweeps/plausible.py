"""Checked plans: theory judges a sample of the runs before anything is integrated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Flags
from rattlesweep.errors import ConfigError
from rattlesweep.physics import theory
from rattlesweep.sweeps.bodies.sources import SdBodies, bodies_at, ranges_of
from rattlesweep.sweeps.bodies.table import (
    Frame,
    TableBodies,
    frame_bodies,
    unknown_columns,
)
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.config.schema import Config, SdSource
from rattlesweep.sweeps.files import probe_directory
from rattlesweep.sweeps.launches import Launches, prepare
from rattlesweep.sweeps.parquet import write_parquet
from rattlesweep.sweeps.plan import Plan, examine, make_plan

MOST_RUNS = 4096  # runs that are judged
BODIES_DRAWN = 65_536  # bodies drawn to find the range of a target's coefficient
SEED = 2017


def plan_frame(
    frame: Frame, output: Path | None, keys: Mapping[str, Any]
) -> tuple[Plan, Path, Path, list[str]]:
    """Plan a sweep of a DataFrame, and store its rows in the output directory."""
    if "bodies" in keys:
        raise ConfigError("bodies: the DataFrame has the bodies; leave the key out")
    source = frame_bodies(frame)
    # Named by its content, so that it is never confused with another table.
    name = f"bodies-{source.content_hash[:16]}.parquet"
    bodies = {"source": "table", "path": name, "surface": source.surface}
    config = parse_config({**keys, "bodies": bodies})
    directory = output or Path(config.directory)
    plan, warnings = checked_plan(config, rows=source)
    examine(plan, directory)
    if not (path := directory / name).exists():
        probe_directory(directory)
        write_parquet(pa.table(source.columns | source.carried), path)
    return plan, directory, directory.resolve(), warnings


def checked_plan(
    config: Config, base: Path | None = None, rows: TableBodies | None = None
) -> tuple[Plan, list[str]]:
    """Return the plan of a config and warnings; raise a ConfigError if no run makes
    sense.
    """
    with config.locating():
        plan = make_plan(config, base, rows)
        warnings = check_physics(plan)
        if own := unknown_columns(getattr(plan.source, "carried", ())):
            warnings.append(f"bodies: columns carried along: {', '.join(own)}")
        if isinstance(plan.source, SdBodies):
            plan.source.check_targets()
    return plan, warnings


def check_physics(plan: Plan) -> list[str]:
    """Return warnings about a plan; raise a ConfigError if no run of it makes sense."""
    config, which = plan.config, f"the {plan.runs} runs"
    with config.locating(), np.errstate(all="ignore"):
        if isinstance(config.bodies, SdSource):
            plan = replace(plan, source=_drawn_bodies(config.bodies), samples=MOST_RUNS)
            which = f"{min(plan.runs, MOST_RUNS)} runs drawn from the ranges"
        elif plan.runs > MOST_RUNS:
            which = f"{MOST_RUNS} of the {plan.runs} runs"
        runs = np.linspace(0, plan.runs - 1, min(plan.runs, MOST_RUNS)).astype(np.int64)
        launches = prepare(plan, *np.divmod(runs, plan.samples))
        return [config.located(warning) for warning in _doubts(config, launches, which)]


def _doubts(config: Config, launches: Launches, which: str) -> Iterator[str]:
    """Yield warnings about horizons; raise a ConfigError if no run has one."""

    def told(mask: Flags) -> str:
        share = f"{'all' if mask.all() else mask.sum()} of {which}"
        return share if len(mask) > 1 else "the only run"

    t_end, t_rgh, horizon = launches.horizon, launches.gh.t_rgh, config.horizon
    endless = ~np.isfinite(t_end)
    early = t_end < t_rgh  # false without spin, where t_rGH is NaN
    if endless.any():
        name, unit = ("t_rgh", "t_rGH") if horizon.t_rgh else ("t_decay", "gamma/sigma")
        problem = f"{name} times {unit} is not a finite time in {told(endless)}"
        problem += "; give t as well"
        if endless.all():
            raise ConfigError(f"horizon.{name}: {problem}")
        yield f"horizon.{name}: {problem}"
    elif early.mean() >= 0.5 and horizon.t_decay is None:
        key = "horizon.t" if horizon.t else "horizon.t_rgh"
        key = key if launches.bodies.t_end is None else "bodies.path"
        yield (
            f"{key}: the horizon comes before t_rGH, the reversal time of theory, in "
            f"{told(early)}, so few will be of type R; give t_rgh above 1, or t above "
            f"{np.nanmedian(t_rgh):.3g}, the median of t_rGH"
        )


def _drawn_bodies(source: SdSource) -> TableBodies:
    """Return bodies drawn by NumPy, without targets, for which the sampler may take
    hours.
    """
    ranges, target = ranges_of(source), source.target
    points = np.random.default_rng(SEED).random((len(ranges), BODIES_DRAWN))
    b = bodies_at(points, ranges)
    if target is not None:
        *_, K_p, K_r = theory.torque_coefficients(b.alpha, b.beta, b.theta, b.phi, b.xi)
        found = K_p if target.name == "K_p" else K_r
        low, high = np.nanmin(found), np.nanmax(found)
        for value in target.values:
            if abs(value - np.clip(value, low, high)) > target.rel_tol * value:
                where = f"{BODIES_DRAWN} bodies drawn from the ranges"
                raise ConfigError(
                    f"bodies.target.{target.name}: {value:g} is out of reach: in "
                    f"{where} {target.name} lies between {low:.4g} and {high:.4g}"
                )
    return TableBodies(
        {k: column for k, column in vars(b).items() if isinstance(column, np.ndarray)}
    )
