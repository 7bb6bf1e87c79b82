"""What a sweep's blocks take on disk and in memory, and in time beside the kernel.

Measured on runs of the pilot, encoded as they would be written; nothing is written. And what of
that this machine has not.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Floats
from rattlesweep.integrate.batch import N_WINDOWS
from rattlesweep.integrate.lanes import columns as C
from rattlesweep.sweeps.block import columns_of, prepare_runs
from rattlesweep.sweeps.plan import Plan
from rattlesweep.sweeps.old.pilot import Pilot
from rattlesweep.sweeps.arrow import build_table, encode, open_sealed
from rattlesweep.sweeps.columns import RUNS

Columns = Mapping[str, Any]

# Rows of a block that are prepared and encoded.
ROWS = 4096
# Bytes beside the blocks: of any sweep, a case and a block.
BESIDE, BESIDE_CASE, BESIDE_BLOCK = 11_500, 110, 150
GIVEN = ("keys", "body", "launch", "theory")


@dataclass(frozen=True)
class Footprint:
    """What the whole sweep takes beside the kernel."""

    bytes: int  # of all files
    memory: int  # bytes at most
    start_seconds: float  # paid once in a process, by the first table
    prepare_seconds: float  # for all rows
    type_seconds: float
    write_seconds: float  # rest on the disk aside


def measure(plan: Plan, pilot: Pilot) -> Footprint:
    """Prepare, type and encode some rows."""
    config, base = plan.config, _resident()
    schema = plan.schema
    given = [column.name for part in GIVEN for column in RUNS[part]]
    # Rows as they follow one another in a block in the middle, as far as bodies are cheap.
    case, sample = plan.runs_of(plan.block(plan.n_blocks // 2))
    cheap = sample < pilot.each if pilot.small is not plan else np.ones(len(case), dtype=bool)
    case, sample = (case[cheap], sample[cheap]) if cheap.any() else (pilot.case, pilot.sample)
    times = [time.perf_counter()]
    launches, batch = prepare_runs(pilot.small, case[:ROWS], sample[:ROWS])
    times.append(time.perf_counter())
    closed = config.model_copy(update={"model": "gh", "record": []})
    inputs = columns_of(closed, launches, None, None)
    times.append(time.perf_counter())
    _encoded(inputs, given, schema, 1)
    times.append(time.perf_counter())
    prepare_seconds, type_seconds, start_seconds = np.diff(times).tolist()
    outputs = pilot.columns or inputs
    results = [name for name in schema.names if name not in given and name in outputs]
    block = _encoded({**inputs, **outputs}, [*given, *results], schema, 1)
    # Columns are written one by one, so each may be measured where it is true to life: what is
    # given on neighbours in a block, which may share bodies; what comes out on runs of any kind.
    row = np.zeros(3)
    for columns, names in ((inputs, given), (outputs, results)):
        if (count := len(columns["case"])) > 1:
            more = _encoded(columns, names, schema, count) - _encoded(columns, names, schema, 1)
            row += np.maximum(more, 0.0) / (count - 1)
    for part in {"error", "tol"}.intersection(config.parts):  # which the pilot leaves out
        row[[0, 2]] += sum(column.type.bit_width / 8 for column in RUNS[part])
    rows, at_once, blocks = len(launches.case), min(plan.block_size, plan.runs), plan.n_blocks
    kernel = 0
    if batch is not None:
        kernel = 8 * (C.FIRST_STATE + batch.y0.shape[1] + C.N_PLAN + C.N_COUNTS + 2)
        kernel *= 1 + len({"error", "tol"}.intersection(config.parts))
        kernel += 24 * N_WINDOWS * ("windows" in config.record)
        kernel += 16 * N_WINDOWS * ("reversals" in config.record)
    # Most is held with a block in the kernel, the next one prepared, for which as much again comes
    # and goes, and the one before being written.
    held = (min(blocks, 3) + 1) * (_bytes(launches) + _bytes(batch)) / rows
    held += min(blocks, 2) * kernel + row[2] + 3 * row[0]
    beside = BESIDE + BESIDE_CASE * len(plan.cases) + BESIDE_BLOCK * blocks
    return Footprint(
        bytes=round(beside + blocks * block[0] + plan.runs * row[0]),
        # The summary gathers two numbers of each run of a case, and sorts them out.
        memory=round(base + at_once * held + 32 * plan.samples),
        start_seconds=start_seconds,
        prepare_seconds=plan.runs / rows * prepare_seconds,
        type_seconds=plan.runs / rows * type_seconds,
        write_seconds=float(blocks * block[1] + plan.runs * row[1]),
    )


def _encoded(columns: Columns, names: list[str], schema: pa.Schema, rows: int) -> Floats:
    """Bytes in the file, seconds to make and to prove it, and bytes of the table in memory."""
    part = {name: _head(columns[name], rows) for name in names}
    begin = time.perf_counter()
    table = build_table(part, pa.schema([schema.field(name) for name in names]))
    data = encode(table)
    open_sealed(data)
    return np.array([len(data), time.perf_counter() - begin, table.nbytes])


def _head(values: Any, rows: int) -> Any:
    return (values[0][:rows], values[1]) if isinstance(values, tuple) else values[:rows]


def _bytes(values: Any) -> int:
    """Bytes of all arrays in a dataclass."""
    if isinstance(values, np.ndarray):
        return values.nbytes
    if is_dataclass(values):
        return sum(_bytes(getattr(values, part.name)) for part in fields(values))
    return 0


def _resident() -> int:
    """Bytes of memory that this process holds; 0 where the system does not say."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0


def shortages(memory: float, size: float, directory: Path) -> list[str]:
    """Sentences on what is wanted and not there, of bytes of memory and on the directory's disk."""
    lines = []
    free = free_memory()
    if free is not None and memory > free:
        lines.append(
            f"it needs {memory / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are free; a "
            "smaller block_size needs less"
        )
    place = directory.resolve()
    while not place.exists() and place != place.parent:
        place = place.parent
    space = shutil.disk_usage(place).free
    if size > space:
        lines.append(
            f"it needs {size / 1e9:.1f} GB on disk, and {place} has {space / 1e9:.1f} GB free; "
            "choose another --output"
        )
    return lines


def free_memory() -> int | None:
    """Bytes of memory that can be had; None where the system does not say."""
    try:
        with open("/proc/meminfo") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return 1024 * int(line.split()[1])
    except (OSError, ValueError, IndexError):
        pass
    return None
