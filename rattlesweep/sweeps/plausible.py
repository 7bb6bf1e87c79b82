"""Plans that were checked: theory judges a few thousand runs, and nothing is integrated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Flags, Floats, Integers, take
from rattlesweep.errors import ConfigError
from rattlesweep.physics import theory
from rattlesweep.sweeps.bodies import Bodies, Source
from rattlesweep.sweeps.bodies.sources import SdBodies, bodies_at, ranges_of
from rattlesweep.sweeps.bodies.table import frame_bodies
from rattlesweep.sweeps.columns import write_parquet
from rattlesweep.sweeps.config import Key
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.config.schema import Config, SdSource
from rattlesweep.sweeps.files import explained
from rattlesweep.sweeps.launches import Launches, prepare
from rattlesweep.sweeps.plan import Plan, examine, make_plan

if TYPE_CHECKING:
    import pandas as pd

RUNS = 4096  # that stand for a sweep
DRAWN = 65_536  # bodies drawn to see which targets are within reach
SEED = 2017


def plan_frame(
    frame: pd.DataFrame, output: Path | None, keys: Mapping[str, Any]
) -> tuple[Plan, Path, Path, list[str]]:
    """Plan a sweep of a DataFrame's rows and keep them in its directory if it could begin."""
    if "bodies" in keys:
        raise ConfigError("bodies: the DataFrame gives them already; leave the key out")
    source = frame_bodies(frame)
    # By its content: no other table is taken for it.
    name = f"bodies-{source.content_hash[:16]}.parquet"
    surface = {"surface": "ellipsoid"} if source.has_semi_axes else {}
    config = parse_config({**keys, "bodies": {"source": "table", "path": name} | surface})
    directory = output or Path(config.directory)
    assert config.bodies.source == "table"
    plan, warnings = checked_plan(config, source=source.with_surface(config.bodies))
    examine(plan, directory)
    if not (path := directory / name).exists():
        with explained(f"cannot write in {directory}"):
            directory.mkdir(parents=True, exist_ok=True)
        write_parquet(pa.table(source.columns | source.carried), path)
    return plan, directory, directory.resolve(), warnings


def checked_plan(
    config: Config, base: Path | None = None, source: Source | None = None
) -> tuple[Plan, list[str]]:
    """Return the plan of a config and its warnings; raise a ConfigError if no run can be right."""
    with config.locating():
        plan = make_plan(config, base, source)
        warnings = check_physics(plan)
        if isinstance(plan.source, SdBodies):
            plan.source.check_targets()
    return plan, warnings


def check_physics(plan: Plan) -> list[str]:
    """Return the warnings about a plan; raise a ConfigError if no run of it can be right."""
    config, words = plan.config, f"the {plan.runs} runs"
    with np.errstate(all="ignore"):
        if isinstance(config.bodies, SdSource):
            plan = replace(plan, source=DrawnBodies(config, config.bodies))
            words = f"{min(plan.runs, RUNS)} runs drawn from the ranges"
        elif plan.runs > RUNS:
            words = f"{RUNS} of the {plan.runs} runs"
        runs = np.linspace(0, plan.runs - 1, min(plan.runs, RUNS)).astype(np.int64)
        launches = prepare(plan, *np.divmod(runs, plan.samples))
        return [config.line(*found) for found in _doubts(config, launches, words)]


def _doubts(config: Config, launches: Launches, words: str) -> Iterator[tuple[Key, str]]:
    """Yield what makes little sense of some runs, by keys; raise if none has a horizon."""

    def told(mask: Flags) -> str:
        many = f"{'all' if mask.all() else mask.sum()} of {words}"
        return many if len(mask) > 1 else "the only run"

    t_end, t_rgh, horizon = launches.t_end, launches.gh.t_rgh, config.horizon
    endless, early = ~np.isfinite(t_end), t_end < t_rgh  # without spin there is no t_rGH but NaN
    if endless.any():
        name, unit = ("t_rgh", "t_rGH") if horizon.t_rgh else ("t_decay", "gamma/sigma")
        message = f"{name} times {unit} is not a finite time in {told(endless)}; give t as well"
        if endless.all():
            raise ConfigError([config.line(("horizon", name), message)])
        yield ("horizon", name), message
    elif early.mean() >= 0.5 and horizon.t_decay is None:
        own = launches.bodies.t_end is not None
        key = ("bodies", "path") if own else ("horizon", "t" if horizon.t else "t_rgh")
        message = "the horizon comes before t_rGH, the time of reversal by theory, in "
        message += f"{told(early)}, and few will be of type R; give t_rgh above 1, or t above "
        yield key, f"{message}{np.nanmedian(t_rgh):.3g}, the median of t_rGH"


class DrawnBodies:
    """Random bodies, drawn in NumPy; the compiled sampler may redraw for hours."""

    samples, fields = RUNS, ()

    def __init__(self, config: Config, source: SdSource) -> None:
        ranges, target = ranges_of(source), source.target
        points = np.random.default_rng(SEED).random((len(ranges), DRAWN))
        self._bodies = b = bodies_at(points, ranges)
        if target is None:
            return
        *_, K_p, K_r = theory.torque_coefficients(b.alpha, b.beta, b.theta, b.phi, b.xi)
        found = K_p if target.name == "K_p" else K_r
        low, high = np.nanmin(found), np.nanmax(found)
        for value in target.values:
            if abs(value - np.clip(value, low, high)) > target.rel_tol * value:
                message = f"{value:g} is out of reach: in {DRAWN} bodies drawn from the ranges "
                message += f"{target.name} lies between {low:.4g} and {high:.4g}"
                raise ConfigError(config.line(("bodies", "target", target.name), message))

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some runs."""
        return take(self._bodies, sample)
