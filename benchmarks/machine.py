"""What the scripts of this folder share: machine, clocks, configs and their runs."""

from __future__ import annotations

import os
import platform
import statistics
import time
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.config.read import load_config
from rattlesweep.design.plan import Plan, make_plan
from rattlesweep.work.block import prepare_runs

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rattlesweep.kernel.outcome import Batch
    from rattlesweep.rows.prepared import PreparedRuns

ROOT = Path(__file__).resolve().parents[1]
CONFIGS = ROOT / "configs"


def heading(*packages: str) -> str:
    """Return processor, load, system and versions in one line."""
    names = ("rattlesweep", "numpy", "numba", "llvmlite", *packages)
    versions = ", ".join(f"{name} {version(name)}" for name in names)
    load = "unknown"
    if hasattr(os, "getloadavg"):
        load = f"{os.getloadavg()[0]:.1f}"
    system = f"{platform.system()} {platform.release()}"
    python = f"Python {platform.python_version()}"
    return (
        f"{processor()}, {os.cpu_count()} processors, load {load}, {system}, {python}, "
        f"{versions}"
    )


def processor() -> str:
    """Return the name of the processor, where the system tells."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def in_turns(
    calls: Mapping[str, Callable[[], Any]],
    rounds: int,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, float]:
    """Return the median seconds of calls that take turns.

    A round before the first one loads and compiles. The processor time hardly depends
    on other work on the machine.
    """
    spent: dict[str, list[float]] = {name: [] for name in calls}
    for number in range(rounds + 1):
        for name, call in calls.items():
            begin = clock()
            call()
            if number > 0:
                spent[name].append(clock() - begin)
    return {name: statistics.median(seconds) for name, seconds in spent.items()}


def plan_of(config: str, *settings: str) -> Plan:
    """Return the plan of a shipped config with some settings."""
    return make_plan(load_config(CONFIGS / config, list(settings)))


def all_runs(plan: Plan) -> tuple[PreparedRuns, Batch]:
    """Return all runs of a plan, ready to be integrated."""
    keys = np.divmod(np.arange(plan.runs), plan.samples)
    launches, batch = prepare_runs(plan, *keys)
    assert batch is not None
    return launches, batch
