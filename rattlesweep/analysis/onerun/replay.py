"""Find a stored run, prove that it is reproduced, and prepare it for a trajectory."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.analysis.onerun.course import PreparedRun
from rattlesweep.analysis.where import parse_where
from rattlesweep.arrays import take
from rattlesweep.design.batches import make_batch
from rattlesweep.design.plan import Plan
from rattlesweep.design.prepare import prepare_launches
from rattlesweep.physics.si import Units
from rattlesweep.rows.prepared import PreparedRuns
from rattlesweep.store.manifest import stored_plan
from rattlesweep.store.rows import Stored, keys_of, open_stored
from rattlesweep.words.errors import ConfigError, OutputError
from rattlesweep.work.verify import differing_rows

MOST_NAMED = 6  # columns that a message names


@dataclass(frozen=True)
class StoredRun:
    """A run that an output directory stores."""

    stored: Stored
    row: pa.Table  # one row with all columns
    # Runs that meet the condition by which it was chosen.
    matches: int = 1

    @cached_property
    def values(self) -> dict[str, Any]:
        """The columns of the run by name."""
        return self.row.to_pylist()[0]

    @property
    def name(self) -> str:
        """Case and sample."""
        return f"case {self.values['case']}, sample {self.values['sample']}"

    @property
    def choice(self) -> str:
        """Case and sample, and of how many runs this is the first."""
        if self.matches == 1:
            return self.name
        return (
            f"{self.name}, the first of {self.matches:,} runs that meet the condition"
        )

    @property
    def title(self) -> str:
        """The sweep and the run, with its type if it has one."""
        title = f"{self.stored.config.name}: {self.name}"
        if self.values["type"]:
            title += f", type {self.values['type']}"
        return title

    @property
    def proof(self) -> str:
        """The result of :meth:`prove` in one line."""
        row = self.values
        if row["status"] != "ok":
            return f"{self.choice}: status {row['status']} as stored, bit for bit"
        t_r = "no reversal"
        if row["t_r"] is not None:
            t_r = f"t_r {row['t_r']!r}"
            if row.get("t_r_error") is not None:
                t_r += f" +- {row['t_r_error']:.2g}"
        return f"{self.choice}: {t_r} and type {row['type']} as stored, bit for bit"

    def prove(self) -> None:
        """Integrate the run as the sweep did; raise if its row differs."""
        plan, _ = self._planned
        for _, _, names in differing_rows(plan, self.row, threads=1):
            listed = ", ".join(names[:MOST_NAMED])
            if len(names) > MOST_NAMED:
                listed += " and others"
            raise OutputError(
                f"{self.name} differs from its stored row in {listed}; see "
                "rattlesweep verify"
            )

    @cached_property
    def _planned(self) -> tuple[Plan, PreparedRuns]:
        plan = stored_plan(self.stored)
        return plan, prepare_launches(plan, *keys_of(self.row))

    @property
    def units(self) -> Units | None:
        """The units of its body, None if its size is not known."""
        return take(self._planned[1].bodies.units, 0)  # type: ignore[arg-type]

    def prepare(self, t_end: float | None = None) -> PreparedRun:
        """Return the run up to `t_end` or its horizon, with its own tolerance."""
        _, launches = self._planned
        config = self.stored.config
        if t_end is not None:
            launches = replace(launches, horizon=np.array([t_end]))
        if self.values.get("tol") is not None:
            tolerance = {"accuracy": None, "tol": self.values["tol"]}
            integrator = config.integrator.model_copy(update=tolerance)
            config = config.model_copy(update={"integrator": integrator})
        return PreparedRun(
            config, launches, make_batch(launches, config.model), self.units
        )


def find_run(
    directory: Path,
    case: int | None = None,
    sample: int | None = None,
    where: str | None = None,
) -> StoredRun:
    """Return the run of a case and a sample, or the first that meets a condition."""
    stored = open_stored(directory)
    has_keys = case is not None and sample is not None
    has_a_key = case is not None or sample is not None
    if has_keys != has_a_key or has_keys == (where is not None):
        raise ConfigError("which run? give case and sample, or where")
    condition = None
    if where is not None:
        condition = parse_where(where, stored.schema)
    is_wanted = (pc.field("case") == case) & (pc.field("sample") == sample)
    for rows in stored.batches():
        if condition is None:
            runs = pa.table(rows).filter(is_wanted)
        else:
            runs = pa.table(condition.filter(rows))
        if len(runs):
            matches = 1
            if condition is not None:
                needed = [*condition.columns] or ["case"]
                batches = stored.batches(needed)
                matches = sum(len(condition.filter(batch)) for batch in batches)
            return StoredRun(stored, runs.slice(0, 1), matches)
    if case is None or sample is None:
        raise ConfigError(f"where {where}: {directory} stores no such run")
    if not (0 <= case < len(stored.cases) and 0 <= sample < stored.samples):
        raise ConfigError(
            f"case {case}, sample {sample}: {directory} has the cases 0 to "
            f"{len(stored.cases) - 1} and the samples 0 to {stored.samples - 1}"
        )
    raise OutputError(f"case {case}, sample {sample} is not stored yet in {directory}")
