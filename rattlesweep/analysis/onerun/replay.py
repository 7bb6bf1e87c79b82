"""Find a stored run, prove that it is reproduced, and prepare it for a trajectory."""
# ruff: noqa: D102 - the names are enough

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
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.physics.si import Units
from rattlesweep.sweeps.launches import Launches, make_batch, prepare
from rattlesweep.sweeps.plan import Plan, stored_plan
from rattlesweep.sweeps.stored import Stored, keys_of, open_stored
from rattlesweep.sweeps.verify import differing_rows


@dataclass(frozen=True)
class StoredRun:
    """A run that an output directory stores."""

    stored: Stored
    row: pa.Table  # one row with all columns

    @cached_property
    def values(self) -> dict[str, Any]:
        found: dict[str, Any] = self.row.to_pylist()[0]
        return found

    @property
    def name(self) -> str:
        return f"case {self.values['case']}, sample {self.values['sample']}"

    @property
    def title(self) -> str:
        kind = f", type {self.values['type']}" if self.values["type"] else ""
        return f"{self.stored.config.name}: {self.name}{kind}"

    @property
    def proof(self) -> str:
        """The result of :meth:`prove` in one line."""
        row = self.values
        if row["status"] != "ok":
            return f"{self.name}: status {row['status']} as stored, bit for bit"
        error = (
            f" +- {row['t_r_error']:.2g}" if row.get("t_r_error") is not None else ""
        )
        t_r = "no reversal" if row["t_r"] is None else f"t_r {row['t_r']!r}{error}"
        return f"{self.name}: {t_r} and type {row['type']} as stored, bit for bit"

    def prove(self) -> None:
        """Integrate the run as the sweep did; raise an OutputError if its row
        differs.
        """
        for _, _, names in differing_rows(self._planned[0], self.row, threads=1):
            listed = ", ".join(names[:6]) + " and others" * (len(names) > 6)
            raise OutputError(
                f"{self.name} differs from its stored row in {listed}; see "
                "rattlesweep verify"
            )

    @cached_property
    def _planned(self) -> tuple[Plan, Launches]:
        plan = stored_plan(self.stored)
        return plan, prepare(plan, *keys_of(self.row))

    @property
    def units(self) -> Units | None:
        """The units of its body, None if its size is not known."""
        return take(self._planned[1].bodies.units, 0)  # type: ignore[arg-type]

    def prepare(self, t_end: float | None = None) -> PreparedRun:
        """Return the run up to ``t_end`` or the sweep's horizon, with its own
        tolerance.
        """
        launches, config = self._planned[1], self.stored.config
        if t_end is not None:
            launches = replace(launches, horizon=np.array([t_end]))
        if self.values.get("tol") is not None:
            tolerance = {"accuracy": None, "tol": self.values["tol"]}
            own = config.integrator.model_copy(update=tolerance)
            config = config.model_copy(update={"integrator": own})
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
    if [case is None, sample is None] != 2 * [where is not None]:
        raise ConfigError("which run? give case and sample, or where")
    condition = None if where is None else parse_where(where, stored.schema)
    mine = (pc.field("case") == case) & (pc.field("sample") == sample)
    for rows in stored.batches():
        found = (
            pa.table(condition.filter(rows))
            if condition
            else pa.table(rows).filter(mine)
        )
        if len(found):
            return StoredRun(stored, found.slice(0, 1))
    if case is None or sample is None:
        raise ConfigError(f"where {where}: {directory} stores no such run")
    if not (0 <= case < len(stored.cases) and 0 <= sample < stored.samples):
        last = f"{len(stored.cases) - 1} and the samples 0 to {stored.samples - 1}"
        raise ConfigError(
            f"case {case}, sample {sample}: {directory} has the cases 0 to {last}"
        )
    raise OutputError(f"case {case}, sample {sample} is not stored yet in {directory}")
