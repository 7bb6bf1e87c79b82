"""Every column of the two tables in one place, and tables as Parquet files.

`runs` has one row a run, `summary` one row a case.  The names are fixed, since scripts written
against today's tables must read next year's.  Each page of a file carries a checksum, which every
reader here verifies.
"""

import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError, DamagedError, OutputError
from rattlesweep.sweeps.files import reason, streamed_file

TIME, RATE, ENERGY, FORCE = "sqrt(a/g)", "sqrt(g/a)", "M g a", "M g"
DAMPING = "M a^2 sqrt(g/a)"
F64, I32, I64, FLAG, TEXT = pa.float64(), pa.int32(), pa.int64(), pa.bool_(), pa.string()
# "element" is what Parquet calls it: a schema then comes back as it was written.
SERIES = pa.list_(pa.field("element", F64))


def field(name: str, kind: pa.DataType, unit: str, words: str, nullable: bool = True) -> pa.Field:
    """Return a column with its unit (``"1"`` for a pure number or a word) and its meaning."""
    return pa.field(name, kind, nullable, metadata={"unit": unit, "description": words})


required = partial(field, nullable=False)

# Columns of `runs` in their order, by what they belong to; set as a table.
# fmt: off
RUNS: dict[str, tuple[pa.Field, ...]] = {
    "keys": (
        required("case", I32, "1", "number of the case, from 0"),
        required("sample", I64, "1", "number of the run within its case, from 0"),
    ),
    "body": (
        required("alpha", F64, "1", "I_xx / (M a^2) + 1"),
        required("beta", F64, "1", "I_yy / (M a^2) + 1"),
        required("gamma", F64, "1", "I_zz / (M a^2)"),
        required("theta", F64, "1", "larger principal curvature at the bottom, times a"),
        required("phi", F64, "1", "smaller principal curvature at the bottom, times a"),
        required("xi", F64, "rad", "skew angle from the axes of inertia to those of curvature"),
        field("f_sd", F64, "1", "I_yy / I_zz; null unless the source draws it"),
    ),
    "launch": (
        required("n_i", F64, RATE, "initial spin, positive = unsteady direction"),
        required("omega_xy0", F64, RATE, "initial rate of the oscillation"),
        field("psi", F64, "rad", "direction of that rate from the x axis"),
    ),
    "theory": (
        field("omega_p", F64, RATE, "pitch frequency without spin"),
        field("omega_r", F64, RATE, "roll frequency without spin"),
        field("K_p", F64, "1", "asymmetric torque coefficient of pitch"),
        field("K_r", F64, "1", "asymmetric torque coefficient of roll"),
        field("n_c1", F64, RATE, "Bondi's threshold spin of the steady direction; null: none"),
        field("n_0", F64, RATE, "spin that would hold all the energy"),
        field("t_rgh", F64, TIME, "reversal time of Garcia and Hubbard's theory; null: none"),
    ),
    "result": (
        required("t_end", F64, TIME, "time reached"),
        field("t_r", F64, TIME, "first zero of the spin by t_end; null: none, or the body is dead"),
        field("type", TEXT, "1", "R, SS, SW, unclassified or D; null where status is not ok"),
        required("status", TEXT, "1", "ok, or a word for what went wrong"),
        field("n_end", F64, RATE, "spin at t_end; with classify.early, where it settles"),
        required("n_steps", I64, "1", "accepted steps of the integrator"),
        field("energy_drift", F64, "1", "relative change of energy at t_end"),
    ),
    "observation": (
        field("amp_growth", F64, "1", "largest growth of the amplitude between two windows"),
        field("n_departure", F64, "1", "largest fractional loss of spin at any step, 1 - n/n_i"),
        required("near_tangencies", I32, "1", "extrema of the spin too near zero to be decided"),
    ),
    "surface": (
        field("c", F64, "a", "vertical semi-axis of the ellipsoid below; null: a paraboloid"),
    ),
    "dissipation": (
        required("sigma", F64, DAMPING, "torque -sigma omega"),
        required("rolling", F64, "a", "lever of the rolling resistance"),
        field("growth", F64, RATE, "growth rate of the oscillation at n_i; null if rolling"),
        field("n_growth", F64, RATE, "spin at which it outgrows its damping; null if rolling"),
        field("energy_left", F64, "1", "fraction of the launch's energy that is left at t_end"),
    ),
    # What `record` asks for, by its words; a run that failed at launch has nothing to record.
    "energy": (
        field("energy_0", F64, ENERGY, "energy at launch"),
        field("energy_drift_max", F64, "1", "largest relative change of energy at any step"),
    ),
    "contact": (
        field("contact_ratio_max", F64, "1", "largest F_perp / F_parallel at the contact"),
        field("contact_normal_min", F64, FORCE, "smallest F_parallel; negative = lift-off"),
    ),
    "windows": (
        field("window_t", F64, TIME, "length of one window"),
        field("window_amplitude", SERIES, RATE, "amplitude of the relevant mode, by window"),
        field("window_n_min", SERIES, RATE, "smallest spin, by window"),
        field("window_n_max", SERIES, RATE, "largest spin, by window"),
    ),
    "lyapunov": (
        field("lyapunov", F64, RATE, "largest Lyapunov exponent over the whole run, or up to t_r"),
        field("lyapunov_late", F64, RATE, "the same over the second half; null: too short to tell"),
        field("chaotic", FLAG, "1", "lyapunov_late * t_end / 2 > 10; null: too short to tell"),
    ),
    "volume": (
        field("volume_rate", F64, RATE, "mean rate of the logarithm of phase volume over the run"),
    ),
    "error": (
        field("t_r_error", F64, TIME, "estimate of the largest error of t_r; null: no t_r"),
        field("type_sure", FLAG, "1", "whether errors of such a size leave the type as it is"),
        field("amp_growth_error", F64, "1", "10 times the change in a looser run; null: unknown"),
        field("n_departure_error", F64, "1", "the same of n_departure"),
    ),
    "tol": (field("tol", F64, "1", "tolerance at which the run was integrated"),),
    "reversals": (
        field("n_turns", I32, "1", "times that the spin went from beyond n_i/4 to beyond -n_i/4"),
        field("turn_times", SERIES, TIME, "first zero in each of the first eight turns"),
        field("spin_after_turn", SERIES, RATE, "largest size of the spin until the next turn"),
    ),
    # Where both errors and reversals are recorded.
    "turns": (
        field("reversals_sure", I32, "1", "how many of the first turns are right to 1e-3"),
        field("reversal_times_error", SERIES, TIME, "errors of turn_times; null: unknown"),
    ),
}
# Columns of `runs` launched from a full state, behind all others.
STATE: tuple[pa.Field, ...] = tuple(
    required(f"{vector}_{x}", F64, unit, f"initial {words}, component along the body's {x}")
    for vector, unit, words in (("omega", RATE, "angular velocity"), ("u", "1", "vertical vector"))
    for x in "xyz"
)
# Columns of `runs` of bodies whose size in SI units is known.
MEASURED: tuple[pa.Field, ...] = (
    field("t_r_s", F64, "s", "t_r in seconds"),
    required("n_i_rpm", F64, "rpm", "initial spin, positive = unsteady direction"),
)
# What a config may ask for by `record` or otherwise, with the models that cannot tell.
RECORD_PARTS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("energy", "windows", "error", "tol", "reversals", "turns"), ("gh",)),
    **dict.fromkeys(("contact", "lyapunov", "volume", "dissipation"), ("reduced", "gh")),
    "surface": (),
}
# Columns of `summary` in their order; shares are of the runs with status ok.
SUMMARY: tuple[pa.Field, ...] = (
    required("case", I32, "1", "number of the case, from 0"),
    field("K_p", F64, "1", "target of K_p, where the case has one"),
    field("K_r", F64, "1", "target of K_r, where the case has one"),
    field("n_i", F64, RATE, "initial spin; null where rows differ"),
    field("omega_xy0", F64, RATE, "initial rate; null where rows differ"),
    required("runs", I64, "1", "runs stored"),
    field("fraction_R", F64, "1", "fraction of type R"),
    field("fraction_SS", F64, "1", "fraction of type SS"),
    field("fraction_SW", F64, "1", "fraction of type SW"),
    field("fraction_unclassified", F64, "1", "fraction of unclassified"),
    field("fraction_bondi", F64, "1", "fraction beyond Bondi's threshold; null: unsteady spins"),
    field("t_r_mean", F64, TIME, "mean t_r of type R"),
    field("t_r_std", F64, TIME, "sample standard deviation (n - 1) of t_r of type R"),
    field("t_rgh_mean", F64, TIME, "mean t_rgh of the runs that have one"),
    field("t_r_over_t_rgh_mean", F64, "1", "mean of t_r / t_rgh, taken run by run, of type R"),
    field("t_r_over_t_rgh_sem", F64, "1", "standard error of that mean"),
    required("failed", I64, "1", "runs with status other than ok"),
    required("near_tangencies", I64, "1", "sum of near_tangencies over the runs"),
    # Of runs that record no error, null.
    field("sensitive", I64, "1", "runs of type R with t_r_error > 1e-6 t_r"),
    field("unsure", I64, "1", "runs whose type is not sure"),
    field("t_r_mean_error", F64, TIME, "mean t_r_error of type R"),
    # Without dissipation, null.
    field("fraction_D", F64, "1", "fraction of type D"),
    field("sigma", F64, DAMPING, "torque -sigma omega; null: no dissipation, or rows differ"),
    field("rolling", F64, "a", "lever of the rolling resistance; null likewise"),
    # Of runs that do not record contact, null.
    field("share_friction_above_0_3", F64, "1", "fraction with contact_ratio_max > 0.3"),
    field("share_friction_above_0_6", F64, "1", "fraction with contact_ratio_max > 0.6"),
    field("share_lift_off", F64, "1", "fraction with contact_normal_min < 0, which would lift off"),
)
# fmt: on

# Columns whose few values are smaller in a dictionary.
REPEATING = {"case", "n_i", "omega_xy0", "type", "status", "near_tangencies", "window_t"}
ROW_GROUP = 1 << 17  # rows: about 30 MB decoded, so that readers can stream a large file


def runs_schema(
    record: Collection[str] = (), model: str = "full", extra: Iterable[pa.Field] = ()
) -> pa.Schema:
    """Return the schema of `runs` with some parts of `RECORD_PARTS`, and a source's columns."""
    if wrong := [part for part in sorted(record) if model in RECORD_PARTS[part]]:
        raise ConfigError(f"record: the model {model!r} has no {wrong[0]!r} to record")
    asked = [part for part in RUNS if part not in RECORD_PARTS or part in record]
    return pa.schema([*(column for part in asked for column in RUNS[part]), *extra])


def summary_schema() -> pa.Schema:
    """Return the Arrow schema of `summary`."""
    return pa.schema(SUMMARY)


def same_schema(one: pa.Schema, other: pa.Schema) -> bool:
    """Return whether names, types, nulls and units are the same; descriptions may differ."""
    units = [[(f.metadata or {}).get(b"unit", b"") for f in schema] for schema in (one, other)]
    return one.equals(other) and units[0] == units[1]


def build_table(columns: Mapping[str, Any], schema: pa.Schema) -> pa.Table:
    """Make a table from arrays (NaN is null), or codes and words (a negative code is null)."""
    arrays = [_to_arrow(columns[field.name], field.type) for field in schema]
    table = pa.Table.from_arrays(arrays, schema=schema.remove_metadata())
    for field in table.schema:
        if not field.nullable and table.column(field.name).null_count:
            raise ValueError(f"internal error: column {field.name} has rows that are not finite")
    return table


def ragged(values: Floats, counts: Integers) -> pa.Array:
    """Make a column of the first ``counts[i]`` entries of ``values[i]``; a negative one is null."""
    offsets = np.cumsum(np.append(0, np.maximum(counts, 0)), dtype=np.int32)
    kept = _to_arrow(values[np.arange(values.shape[1]) < counts[:, None]], F64)
    return pa.ListArray.from_arrays(pa.array(offsets), kept, mask=pa.array(counts < 0))


def _to_arrow(values: Any, kind: pa.DataType) -> pa.Array:
    if isinstance(values, tuple):
        codes, words = values
        values = np.array([*words, None], dtype=object)[codes]
    if isinstance(values, pa.Array | pa.ChunkedArray):
        return values.cast(kind)
    if pa.types.is_floating(kind):
        values = np.where(np.isfinite(values), values, np.nan)
    return pa.array(values, kind, from_pandas=True)


def floats(column: pa.Array) -> Floats:
    """Return a column of numbers; null is NaN."""
    return np.asarray(column.to_numpy(zero_copy_only=False).astype(float))


def write_parquet(table: pa.Table, path: Path, metadata: Mapping[str, str] | None = None) -> None:
    """Write a table, and words beside its schema; equal tables give equal files."""
    # Chunk borders would move page borders.
    table = table.combine_chunks().replace_schema_metadata(dict(metadata or {}) or None)
    with streamed_file(path) as file:
        encode(table, file)


def encode(table: pa.Table, sink: Any) -> None:
    """Write a table as Parquet, with page checksums, to an open file."""
    repeating = [name for name in table.schema.names if name in REPEATING]
    pq.write_table(
        table, sink, row_group_size=ROW_GROUP, version="2.6", compression="zstd",
        use_dictionary=repeating, write_page_checksum=True,
    )  # fmt: skip


@contextmanager
def parquet_file(path: Path) -> Iterator[pq.ParquetFile]:
    """Open a Parquet file whose pages are verified as they are read; raise a DamagedError."""
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            yield file
    except MemoryError:
        raise  # Arrow's own is an ArrowException too, and says nothing about the file
    except (pa.ArrowException, OSError, EOFError, UnicodeDecodeError) as error:
        # Arrow raises OSError, without a number, for pages and footers that are not as they were.
        if isinstance(error, OSError) and error.errno is not None:
            raise OutputError(f"cannot read {path}: {os.strerror(error.errno)}") from error
        raise DamagedError(f"{path} is damaged: {reason(error)}") from error


def read_parquet(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Return the rows of a Parquet file, with its metadata; errors as for :func:`parquet_file`."""
    with parquet_file(path) as file:
        rows = file.read(None if columns is None else list(columns))
        if len(rows) != file.metadata.num_rows:
            raise pa.ArrowInvalid("its footer contradicts itself")
        return rows
