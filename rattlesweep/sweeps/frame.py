"""A sweep of bodies that are in memory: their table is kept in the output directory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.arrow import write_parquet
from rattlesweep.sweeps.bodies.table import frame_bodies
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.files import explained
from rattlesweep.sweeps.plan import Plan, examine
from rattlesweep.sweeps.plausible import checked_plan


def plan_frame(
    frame: pd.DataFrame, output: Path | None, keys: Mapping[str, Any]
) -> tuple[Plan, Path, Path, list[str]]:
    """Plan a sweep of the rows of a DataFrame and keep them in its directory.

    Nothing is written there unless the whole sweep could begin.  Returns the plan, where the runs
    go, where the table is, and the doubts of `checked_plan`.
    """
    if "bodies" in keys:
        raise ConfigError("bodies: the DataFrame gives them already; leave the key out")
    source = frame_bodies(frame)
    # By its content: no other table is taken for it.
    name = f"bodies-{source.content_hash[:16]}.parquet"
    surface = {"surface": "ellipsoid"} if source.has_semi_axes else {}
    config = parse_config({**keys, "bodies": {"source": "table", "path": name} | surface})
    directory = output or Path(config.directory)
    assert config.bodies.source == "table"
    plan, doubts = checked_plan(config, source=source.with_surface(config.bodies))
    examine(plan, directory)
    if not (path := directory / name).exists():
        with explained(f"cannot write in {directory}"):
            directory.mkdir(parents=True, exist_ok=True)
        write_parquet(pa.table(source.columns | source.carried), path)
    return plan, directory, directory.resolve(), doubts
