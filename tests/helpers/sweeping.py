"""Sweeps and commands, run in this process unless a test is about processes."""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from click.testing import CliRunner

from rattlesweep import cli
from rattlesweep.config.read import load_config, parse_config
from rattlesweep.design.plan import Plan, make_plan
from rattlesweep.kernel.outcome import Batch
from rattlesweep.rows.prepared import PreparedRuns
from rattlesweep.store.rows import open_stored
from rattlesweep.work.block import prepare_runs
from rattlesweep.work.run import run_sweep
from rattlesweep.work.verify import verify

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
HEAD = "alpha,beta,gamma,theta,phi,xi"
ROW = "13.04,1.522,12.28,0.6429,0.036,-0.03"
PROGRAM = Path(sys.executable).with_name("rattlesweep")


def invoke(*args: Any) -> Any:
    """Run a command in this process, and raise what it does not handle."""
    result = CliRunner().invoke(cli.main, [str(a) for a in args])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert "Traceback" not in result.output
    return result


def run(
    config: str | Path, output: Path, *sets: str, options: tuple[Any, ...] = ()
) -> Any:
    """Run a shipped config, or one at a path."""
    settings = [word for text in sets for word in ("--set", text)]
    return invoke("run", CONFIGS / config, "--output", output, *settings, *options)


def changed(config: dict[str, Any], **sections: Any) -> dict[str, Any]:
    """Return a config with some keys replaced; sections are merged."""
    result = dict(config)
    for key, value in sections.items():
        if isinstance(value, dict):
            value = config.get(key, {}) | value
        result[key] = value
    return result


def plan_of(config: str | Path | dict[str, Any], *sets: str, **changes: Any) -> Plan:
    """Plan a config: a file with settings, or a mapping with replaced keys."""
    if isinstance(config, dict):
        return make_plan(parse_config(config | changes))
    return make_plan(load_config(CONFIGS / config, sets))


def prepared(plan: Plan) -> tuple[PreparedRuns, Batch]:
    launches, batch = prepare_runs(plan, *np.divmod(np.arange(plan.runs), plan.samples))
    assert batch is not None
    return launches, batch


def sweep(
    output: Path, config: str | Path | dict[str, Any], *sets: str, **options: Any
) -> Any:
    """Run a config without the command line; `options` are those of `run_sweep`."""
    return run_sweep(plan_of(config, *sets), output, **options)


def rows(output: Path) -> pd.DataFrame:
    """Return all runs, sorted by key."""
    files = [pd.read_parquet(path) for path in (output / "runs").glob("*.parquet")]
    return pd.concat(files).sort_values(["case", "sample"], ignore_index=True)


def manifest(output: Path) -> dict[str, Any]:
    """Return the manifest, read as plain JSON."""
    data: dict[str, Any] = json.loads((output / "manifest.json").read_text())
    return data


def proved(output: Path, recompute: int = 0) -> str:
    """Verify a directory, recompute some runs, and return the hash of its rows."""
    problems = verify(output, recompute=recompute, seed=1).problems
    assert problems == [], problems
    return content_hash(output)


def content_hash(output: Path) -> str:
    """Return a hash of all rows, sorted by key, however they lie in files."""
    sink = pa.BufferOutputStream()
    pq.write_table(open_stored(output).read().combine_chunks(), sink)
    return hashlib.sha256(sink.getvalue()).hexdigest()


def tree(directory: Path) -> dict[str, bytes]:
    """Return the contents of all files in a directory; folders count as empty files."""
    contents = {}
    for path in sorted(directory.rglob("*")):
        name = str(path.relative_to(directory))
        contents[name] = path.read_bytes() if path.is_file() else b""
    return contents
