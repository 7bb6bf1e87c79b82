"""Plans that can be run: whatever would refuse a sweep is asked before it begins."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from rattlesweep.config.read import parse_config
from rattlesweep.config.schema import Config
from rattlesweep.design.bodies.meshes import MeshBodies
from rattlesweep.design.bodies.sources import SdBodies
from rattlesweep.design.bodies.table import (
    Frame,
    TableBodies,
    frame_bodies,
    unknown_columns,
)
from rattlesweep.design.plan import Plan, make_plan
from rattlesweep.design.plausible import (
    check_physics,
)
from rattlesweep.store.manifest import examine
from rattlesweep.store.parquet import write_parquet
from rattlesweep.system.files import as_path, probe_directory
from rattlesweep.words.errors import ConfigError
from rattlesweep.work.block import check_computable


def plan_frame(
    frame: Frame, output: Path | None, keys: Mapping[str, object]
) -> tuple[Plan, Path, Path, list[str]]:
    """Plan a sweep of a DataFrame, and store its rows in the output directory."""
    if "bodies" in keys:
        raise ConfigError("bodies: the DataFrame has the bodies; leave the key out")
    source = frame_bodies(frame)
    # Named by its content, so that it is never confused with another table.
    name = f"bodies-{source.content_hash[:16]}.parquet"
    bodies = {"source": "table", "path": name, "surface": source.surface}
    config = parse_config({**keys, "bodies": bodies})
    directory = output or as_path(config.directory, "output")
    plan, warnings = checked_plan(config, rows=source)
    examine(plan, directory)
    path = directory / name
    if not path.exists():
        probe_directory(directory)
        write_parquet(source.as_table, path)
    return plan, directory, directory.resolve(), warnings


def checked_plan(
    config: Config, base: Path | None = None, rows: TableBodies | None = None
) -> tuple[Plan, list[str]]:
    """Return the plan of a config and warnings.

    Raise a ConfigError if no run makes sense.
    """
    with config.locating():
        plan = make_plan(config, base, rows)
        check_computable(plan)
        warnings = check_physics(plan)
        carried = unknown_columns(getattr(plan.source, "carried", ()))
        if carried:
            warnings.append(f"bodies: columns carried along: {', '.join(carried)}")
        if isinstance(plan.source, MeshBodies):
            warnings += map(config.located, plan.source.doubts)
        if isinstance(plan.source, SdBodies):
            plan.source.check_targets()
    return plan, warnings
