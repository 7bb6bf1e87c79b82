"""A sweep of bodies that are in memory: their table is kept in the output directory."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.arrow import ContentHash, build_table, encode
from rattlesweep.sweeps.bodies.table import COLUMNS, columns_of
from rattlesweep.sweeps.columns import RUNS, STATE
from rattlesweep.sweeps.config.load import parse_config
from rattlesweep.sweeps.files import replace_file
from rattlesweep.sweeps.old.output import examine
from rattlesweep.sweeps.old.store import Store
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.plausible import checked_plan


def keep_bodies(
    bodies: pd.DataFrame, output: Path | None, keys: Mapping[str, Any]
) -> tuple[Plan, Path, Path, list[str]]:
    """Plan a sweep of the rows of a table and keep them in its directory.

    Nothing is written there unless the whole sweep could begin. Returns the plan, where the runs
    go, where the table is, and the doubts of `checked_plan`.
    """
    if "bodies" in keys:
        raise ConfigError("bodies: the DataFrame gives them already; leave the key out")
    columns = columns_of(bodies, "bodies")[0]
    fields = {column.name: column for part in (*RUNS.values(), STATE) for column in part}
    schema = pa.schema([fields[name].with_nullable(True) for name in COLUMNS if name in columns])
    table = build_table(columns, schema)
    digest = ContentHash(schema)
    digest.update(table)
    # By its content: no other table is taken for it, wherever the sweep is looked at from.
    name = f"bodies-{digest.hexdigest()[:16]}.parquet"
    config = parse_config({**keys, "bodies": {"source": "table", "path": name}})
    directory = output or Path(config.directory)
    data = encode(table)
    if (kept := directory / name).exists():
        # Equal tables are not equal bytes for every version of Arrow.
        data = kept.read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder)
        (trial / name).write_bytes(data)
        plan, doubts = checked_plan(config, trial)
        examine(plan, directory, trial)
    store = Store(directory)
    store.prepare()
    if not kept.exists():
        replace_file(kept, data)
    return plan, directory, directory.resolve(), doubts
