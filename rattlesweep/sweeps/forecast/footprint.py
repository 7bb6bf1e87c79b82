"""What a sweep's blocks weigh, on disk and in memory, and how long they take beside the kernel.

Measured on runs of the pilot, encoded as they would be written; nothing is written.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from rattlesweep.integrate.batch import N_WINDOWS, expected_cost
from rattlesweep.integrate.lanes import columns as C
from rattlesweep.sweeps.blocks.block import Interrupted, finish_block, prepare_runs
from rattlesweep.sweeps.tables.arrow import build_table, encode, open_sealed
from rattlesweep.sweeps.tables.columns import RUNS, runs_schema

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.sweeps.cases.plan import Plan
    from rattlesweep.sweeps.cases.pool import Integers, Pool
    from rattlesweep.sweeps.forecast.pilot import Pilot

    Columns = Mapping[str, Any]

# Runs that are done to the end and encoded, and rows of a block whose inputs are.
ENDED, ROWS = 256, 4096
# Seconds that those may take.
AT_MOST = 0.1
# Bytes beside the blocks: of any sweep, a case and a block.
BESIDE, BESIDE_CASE, BESIDE_BLOCK = 9_500, 110, 150
# Arrays that come and go while a block is prepared, in units of what stays of it.
PASSING = 1.0
GIVEN = ("keys", "body", "launch", "theory")


@dataclass(frozen=True)
class Footprint:
    """Measured: ``block_*`` for a block whatever its size, ``row_*`` for each of its rows.

    Attributes
    ----------
    start_seconds : float
        Paid once in a process, by the first table.
    type_seconds : float
        To type a row, and for the model ``gh`` to solve it.
    row_memory : float
        Bytes of a row at the moment when most is held: a block in the kernel, the next one
        prepared, the one before being written.
    base_memory : int
        Bytes of the process before it begins.
    """

    start_seconds: float
    block_seconds: float
    row_seconds: float
    type_seconds: float
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


def weigh(plan: Plan, pool: Pool, pilot: Pilot) -> Footprint:
    """Do and encode some runs."""
    config = plan.config
    schema = runs_schema(config.record, config.model)
    given = [column.name for part in GIVEN for column in RUNS[part]]
    results = [name for name in schema.names if name not in given]
    case, sample = _of_a_block(plan, pool)
    inputs, type_seconds = _closed_form(pool.plan, case, sample)
    begin = time.perf_counter()
    _encoded(inputs, given, schema, 1)
    start_seconds = time.perf_counter() - begin
    rows = np.unique(np.linspace(0, pool.cost.size - 1, ENDED).astype(np.int64))
    outputs = _ended(pool, pilot, rows) or inputs
    one = _encoded({**inputs, **outputs}, schema.names, schema, 1)
    # Columns are written one by one, so each may be measured where it is true to life: what is
    # given on neighbours in a block, which may share bodies; what comes out on runs of any kind.
    slopes = np.zeros(3)
    for columns, names in ((inputs, given), (outputs, results)):
        count = len(columns["case"])
        if count > 1:
            more = _encoded(columns, names, schema, count) - _encoded(columns, names, schema, 1)
            slopes += np.maximum(more, 0.0) / (count - 1)
    launched, kernel = _bytes(pool.launches) / pool.cost.size, 0
    if pool.batch is not None:
        launched += _bytes(pool.batch) / pool.cost.size
        kernel = 8 * (C.FIRST_STATE + pool.batch.y0.shape[1] + C.N_PLAN + C.N_COUNTS + 2)
        kernel += 24 * N_WINDOWS * ("windows" in config.record)
    # At once: a block in the kernel, the next one prepared, the one before being written.
    blocks = min(plan.n_blocks, 3)
    held = (blocks + PASSING) * launched + min(blocks, 2) * kernel
    held += slopes[2] + 3 * slopes[0]
    return Footprint(
        start_seconds=start_seconds,
        block_seconds=float(one[1]),
        row_seconds=float(slopes[1]),
        type_seconds=type_seconds,
        block_bytes=float(one[0]),
        row_bytes=float(slopes[0]),
        row_memory=float(held),
        base_memory=max(0, _resident() - _bytes(pool.launches) - _bytes(pool.batch)),
    )


def _of_a_block(plan: Plan, pool: Pool) -> tuple[Integers, Integers]:
    """Rows as they follow one another in a block in the middle, as far as bodies are cheap."""
    case, sample = plan.runs_of(plan.block(plan.n_blocks // 2))
    if pool.plan is not plan:
        # The bodies of a target come again in its next case, which makes the file smaller.
        cases, counts = np.unique(case, return_counts=True)
        counts = np.minimum(counts, pool.per_case)
        case = np.repeat(cases, counts)
        sample = np.concatenate([np.arange(count) for count in counts])
    return case[:ROWS], sample[:ROWS]


def _closed_form(plan: Plan, case: Integers, sample: Integers) -> tuple[Columns, float]:
    """Columns as the model `gh` has them, and the seconds it takes to make a row of them."""
    launches, _ = prepare_runs(plan, case, sample)
    config = plan.config.model_copy(update={"model": "gh", "record": []})
    begin = time.perf_counter()
    return finish_block(config, launches, None), (time.perf_counter() - begin) / len(case)


def _ended(pool: Pool, pilot: Pilot, rows: Integers) -> Columns | None:
    """Columns of some runs; horizons are cut where they would take more than a tenth of a second.

    Returns
    -------
    mapping or None
        None where nothing is integrated, or even short runs take too long.
    """
    launches, batch = prepare_runs(pool.plan, pool.launches.case[rows], pool.launches.sample[rows])
    if batch is None:
        return None
    known = ~np.isnan(pilot.work)
    pace = float(np.quantile(pilot.paces(known), 0.9)) if known.any() else 1.0
    most = AT_MOST / (pilot.turn * pace * (1 + len(rows) / pilot.lanes))
    swings = expected_cost(batch)
    for cut in (most, most / 100):
        part = np.minimum(1.0, cut / np.where(swings > 0, swings, np.inf))
        try:
            return pilot.finish(launches, replace(batch, t_end=batch.t_end * part), 10 * AT_MOST)
        except Interrupted:
            continue
    return None


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


__all__ = ["Footprint", "weigh"]
