"""What a sweep's blocks take on disk and in memory, and in time beside the kernel.

Measured on runs of the pilot, encoded as they would be written; nothing is written.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.integrate.batch import N_WINDOWS
from rattlesweep.integrate.lanes import columns as C
from rattlesweep.sweeps.blocks.block import columns_of, prepare_runs
from rattlesweep.sweeps.tables.arrow import build_table, encode, open_sealed
from rattlesweep.sweeps.tables.columns import RUNS, runs_schema

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.sweeps.cases.plan import Plan
    from rattlesweep.sweeps.forecast.pilot import Pilot

    Columns = Mapping[str, Any]

# Rows of a block that are prepared and encoded.
ROWS = 4096
# Bytes beside the blocks: of any sweep, a case and a block.
BESIDE, BESIDE_CASE, BESIDE_BLOCK = 9_500, 110, 150
GIVEN = ("keys", "body", "launch", "theory")


@dataclass(frozen=True)
class Footprint:
    """Measured: ``block_*`` for a block whatever its size, ``row_*`` for each of its rows.

    Attributes
    ----------
    start_seconds : float
        Paid once in a process, by the first table.
    prepare_seconds, type_seconds, row_seconds : float
        To prepare a row, to type it, and to write it.
    row_memory : float
        Bytes of a row when most is held: a block in the kernel, the next one prepared, the one
        before being written.
    base_memory : int
        Bytes of the process before it begins.
    """

    start_seconds: float
    prepare_seconds: float
    type_seconds: float
    block_seconds: float
    row_seconds: float
    block_bytes: float
    row_bytes: float
    row_memory: float
    base_memory: int

    def bytes_of(self, plan: Plan) -> int:
        """Bytes of all files of a sweep."""
        beside = BESIDE + BESIDE_CASE * len(plan.cases) + BESIDE_BLOCK * plan.n_blocks
        return round(beside + plan.n_blocks * self.block_bytes + plan.runs * self.row_bytes)

    def memory_of(self, plan: Plan) -> int:
        """Bytes of memory at most."""
        rows = min(plan.block_size, plan.runs)
        # The summary gathers two numbers of each run of a case, and sorts them out.
        return round(self.base_memory + rows * self.row_memory + 32 * plan.samples)


def measure(plan: Plan, pilot: Pilot) -> Footprint:
    """Prepare, type and encode some rows."""
    config = plan.config
    schema = runs_schema(config.record, config.model)
    given = [column.name for part in GIVEN for column in RUNS[part]]
    base = _resident() - _bytes(pilot.launches) - _bytes(pilot.batch)
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
    rows = len(launches.case)
    prepare_seconds, type_seconds, start_seconds = np.diff(times) / [rows, rows, 1]
    outputs = pilot.columns or inputs
    results = [name for name in schema.names if name not in given and name in outputs]
    one = _encoded({**inputs, **outputs}, [*given, *results], schema, 1)
    # Columns are written one by one, so each may be measured where it is true to life: what is
    # given on neighbours in a block, which may share bodies; what comes out on runs of any kind.
    slopes = np.zeros(3)
    for columns, names in ((inputs, given), (outputs, results)):
        if (count := len(columns["case"])) > 1:
            more = _encoded(columns, names, schema, count) - _encoded(columns, names, schema, 1)
            slopes += np.maximum(more, 0.0) / (count - 1)
    prepared = (_bytes(launches) + _bytes(batch)) / rows
    kernel = 0
    if batch is not None:
        kernel = 8 * (C.FIRST_STATE + batch.y0.shape[1] + C.N_PLAN + C.N_COUNTS + 2)
        kernel += 24 * N_WINDOWS * ("windows" in config.record)
    blocks = min(plan.n_blocks, 3)
    # While a block is prepared, as much again comes and goes.
    held = (blocks + 1) * prepared + min(blocks, 2) * kernel + slopes[2] + 3 * slopes[0]
    return Footprint(
        start_seconds=start_seconds,
        prepare_seconds=prepare_seconds,
        type_seconds=type_seconds,
        block_seconds=float(one[1]),
        row_seconds=float(slopes[1]),
        block_bytes=float(one[0]),
        row_bytes=float(slopes[0]),
        row_memory=float(held),
        base_memory=max(0, base),
    )


def _encoded(
    columns: Columns, names: list[str], schema: pa.Schema, rows: int
) -> NDArray[np.float64]:
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
