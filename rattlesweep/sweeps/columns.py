"""The columns of the tables `runs` (a row per run) and `summary` (a row per case).

The names are fixed, so that scripts written against today's tables read next year's.
"""

from collections.abc import Collection, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError

TIME, RATE, ENERGY, FORCE = "sqrt(a/g)", "sqrt(g/a)", "M g a", "M g"
DAMPING = "M a^2 sqrt(g/a)"
F64, I32, I64, FLAG, TEXT = (
    pa.float64(),
    pa.int32(),
    pa.int64(),
    pa.bool_(),
    pa.string(),
)
# "element" is Parquet's own name, with which a schema is read as it was written.
SERIES = pa.list_(pa.field("element", F64))


def field(
    name: str, kind: pa.DataType, unit: str, words: str, nullable: bool = True
) -> pa.Field:
    """Return a column with its unit (``"1"`` for a pure number or a word) and its
    meaning.
    """
    return pa.field(name, kind, nullable, metadata={"unit": unit, "description": words})


required = partial(field, nullable=False)

# Columns of `runs` in order, in groups.
RUNS: dict[str, tuple[pa.Field, ...]] = {
    "keys": (
        required("case", I32, "1", "number of the case, from 0"),
        required("sample", I64, "1", "number of the run within its case, from 0"),
    ),
    "body": (
        required("alpha", F64, "1", "I_xx / (M a^2) + 1"),
        required("beta", F64, "1", "I_yy / (M a^2) + 1"),
        required("gamma", F64, "1", "I_zz / (M a^2)"),
        required(
            "theta", F64, "1", "larger principal curvature at the bottom, times a"
        ),
        required("phi", F64, "1", "smaller principal curvature at the bottom, times a"),
        required(
            "xi",
            F64,
            "rad",
            "skew angle from the axes of inertia to those of curvature",
        ),
        field("f_sd", F64, "1", "I_yy / I_zz; null unless the source has it"),
    ),
    "launch": (
        required(
            "n_i", F64, RATE, "initial spin; positive: unsteady direction if xi < 0"
        ),
        required("omega_xy0", F64, RATE, "initial rate of the oscillation"),
        field("psi", F64, "rad", "direction of the oscillation from the x axis"),
    ),
    "theory": (
        field("omega_p", F64, RATE, "pitch frequency without spin"),
        field("omega_r", F64, RATE, "roll frequency without spin"),
        field("K_p", F64, "1", "asymmetric torque coefficient of pitch"),
        field("K_r", F64, "1", "asymmetric torque coefficient of roll"),
        field(
            "n_c1",
            F64,
            RATE,
            "Bondi's threshold spin of the steady direction; null: none",
        ),
        field("n_0", F64, RATE, "spin if all energy were spin"),
        field(
            "t_rgh",
            F64,
            TIME,
            "reversal time of Garcia and Hubbard's theory; null: none",
        ),
    ),
    "result": (
        required("t_end", F64, TIME, "time reached"),
        field(
            "t_r",
            F64,
            TIME,
            "first zero of the spin by t_end; null: none, or the body is dead",
        ),
        field(
            "type", TEXT, "1", "R, SS, SW, unclassified or D; null if status is not ok"
        ),
        required("status", TEXT, "1", "ok, or a word for what went wrong"),
        field(
            "n_end",
            F64,
            RATE,
            "spin at t_end; if classify.early ended the run, its limit",
        ),
        required("n_steps", I64, "1", "accepted steps of the integrator"),
        field("energy_drift", F64, "1", "relative change of energy at t_end"),
    ),
    "observation": (
        field(
            "amp_growth",
            F64,
            "1",
            "largest growth of the amplitude between two windows",
        ),
        field(
            "n_departure",
            F64,
            "1",
            "largest fractional loss of spin at any step, 1 - n/n_i",
        ),
        required(
            "near_tangencies",
            I32,
            "1",
            "extrema so near zero that the spin may cross it",
        ),
    ),
    "surface": (
        field(
            "c",
            F64,
            "a",
            "vertical semi-axis of the ellipsoid below; null: a paraboloid",
        ),
    ),
    "dissipation": (
        required("sigma", F64, DAMPING, "torque -sigma omega"),
        required("rolling", F64, "a", "lever of the rolling resistance"),
        field(
            "growth",
            F64,
            RATE,
            "growth rate of the oscillation at n_i; null if rolling > 0",
        ),
        field(
            "n_growth",
            F64,
            RATE,
            "spin at which growth balances damping; null if rolling > 0",
        ),
        field("energy_left", F64, "1", "fraction of the initial energy left at t_end"),
    ),
    # By the words of `record`; null for a run that failed at launch.
    "energy": (
        field("energy_0", F64, ENERGY, "energy at launch"),
        field(
            "energy_drift_max",
            F64,
            "1",
            "largest relative change of energy at any step",
        ),
    ),
    "contact": (
        field(
            "contact_ratio_max", F64, "1", "largest F_perp / F_parallel at the contact"
        ),
        field(
            "contact_normal_min", F64, FORCE, "smallest F_parallel; negative: lift-off"
        ),
    ),
    "windows": (
        field("window_t", F64, TIME, "length of one window"),
        field(
            "window_amplitude",
            SERIES,
            RATE,
            "amplitude of the relevant mode, by window",
        ),
        field("window_n_min", SERIES, RATE, "smallest spin, by window"),
        field("window_n_max", SERIES, RATE, "largest spin, by window"),
    ),
    "lyapunov": (
        field(
            "lyapunov",
            F64,
            RATE,
            "largest Lyapunov exponent over the whole run, or up to t_r",
        ),
        field(
            "lyapunov_late",
            F64,
            RATE,
            "Lyapunov exponent of the second half; null: too short",
        ),
        field(
            "chaotic", FLAG, "1", "lyapunov_late * t_end / 2 > 10; null: run too short"
        ),
    ),
    "volume": (
        field(
            "volume_rate",
            F64,
            RATE,
            "mean rate of the logarithm of phase volume over the run",
        ),
    ),
    "error": (
        field(
            "t_r_error", F64, TIME, "estimated bound of the error of t_r; null: no t_r"
        ),
        field("type_sure", FLAG, "1", "whether the type is the same within the errors"),
        field(
            "amp_growth_error", F64, "1", "estimated error of amp_growth; null: unknown"
        ),
        field(
            "n_departure_error",
            F64,
            "1",
            "estimated error of n_departure; null: unknown",
        ),
    ),
    "tol": (field("tol", F64, "1", "tolerance at which the run was integrated"),),
    "reversals": (
        field("n_turns", I32, "1", "turns, from a spin beyond n_i/4 to beyond -n_i/4"),
        field(
            "turn_times", SERIES, TIME, "first zero in each of the first eight turns"
        ),
        field(
            "spin_after_turn", SERIES, RATE, "largest absolute spin until the next turn"
        ),
    ),
    # Where both errors and reversals are recorded.
    "turns": (
        field(
            "reversals_sure",
            I32,
            "1",
            "first turns with an error below 1e-3; at most eight",
        ),
        field(
            "reversal_times_error",
            SERIES,
            TIME,
            "estimated error of turn_times; null: unknown",
        ),
    ),
}
# Further columns of `runs` launched from a full state.
STATE: tuple[pa.Field, ...] = tuple(
    required(
        f"{vector}_{x}", F64, unit, f"initial {words}, component along the body's {x}"
    )
    for vector, unit, words in (
        ("omega", RATE, "angular velocity"),
        ("u", "1", "vertical vector"),
    )
    for x in "xyz"
)
# Further columns of `runs` of bodies with a known size.
MEASURED: tuple[pa.Field, ...] = (
    field("t_r_s", F64, "s", "t_r in seconds"),
    required(
        "n_i_rpm", F64, "rpm", "n_i in turns a minute, counterclockwise from above"
    ),
)
# Optional groups of columns, with the models that do not have them.
RECORD_PARTS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(
        ("energy", "windows", "error", "tol", "reversals", "turns"), ("gh",)
    ),
    **dict.fromkeys(
        ("contact", "lyapunov", "volume", "dissipation"), ("reduced", "gh")
    ),
    "surface": (),
}
# Columns of `summary` in order; fractions are of the runs with status ok.
SUMMARY = pa.schema(
    (
        required("case", I32, "1", "number of the case, from 0"),
        field("K_p", F64, "1", "target of K_p, where the case has one"),
        field("K_r", F64, "1", "target of K_r, where the case has one"),
        field("n_i", F64, RATE, "initial spin; null where rows differ"),
        field("omega_xy0", F64, RATE, "initial rate; null where rows differ"),
        required("runs", I64, "1", "number of stored runs"),
        # Null unless the size of the bodies is known.
        field("n_i_rpm", F64, "rpm", "initial spin; null where rows differ"),
        # Null unless given in these units, and the sizes of the bodies differ.
        field("omega_xy0_rpm", F64, "rpm", "initial oscillation"),
        field("sigma_N_m_s", F64, "N m s", "torque -sigma omega"),
        field("rolling_m", F64, "m", "lever of the rolling resistance"),
        field("fraction_R", F64, "1", "fraction of type R"),
        field("fraction_SS", F64, "1", "fraction of type SS"),
        field("fraction_SW", F64, "1", "fraction of type SW"),
        field("fraction_unclassified", F64, "1", "fraction of unclassified runs"),
        field(
            "fraction_bondi",
            F64,
            "1",
            "fraction beyond Bondi's threshold; null: unsteady spins",
        ),
        field("t_r_mean", F64, TIME, "mean t_r of type R"),
        field(
            "t_r_s_mean", F64, "s", "mean t_r of type R in seconds, if sizes are known"
        ),
        field(
            "t_r_std", F64, TIME, "sample standard deviation (n - 1) of t_r of type R"
        ),
        field("t_rgh_mean", F64, TIME, "mean t_rgh of the runs that have one"),
        field(
            "t_r_over_t_rgh_mean", F64, "1", "mean of t_r / t_rgh over runs of type R"
        ),
        field("t_r_over_t_rgh_sem", F64, "1", "standard error of that mean"),
        required("failed", I64, "1", "number of runs with a status other than ok"),
        required("near_tangencies", I64, "1", "sum of near_tangencies over the runs"),
        # Null unless errors are recorded.
        field(
            "sensitive", I64, "1", "number of runs of type R with t_r_error > 1e-6 t_r"
        ),
        field("unsure", I64, "1", "number of runs whose type is not sure"),
        field("t_r_mean_error", F64, TIME, "mean t_r_error of type R"),
        # Null without dissipation.
        field("fraction_D", F64, "1", "fraction of type D"),
        field(
            "sigma",
            F64,
            DAMPING,
            "torque -sigma omega; null: no dissipation, or rows differ",
        ),
        field("rolling", F64, "a", "lever of the rolling resistance; null likewise"),
        # Null unless contact is recorded.
        field(
            "share_friction_above_0_3",
            F64,
            "1",
            "fraction with contact_ratio_max > 0.3",
        ),
        field(
            "share_friction_above_0_6",
            F64,
            "1",
            "fraction with contact_ratio_max > 0.6",
        ),
        field(
            "share_lift_off",
            F64,
            "1",
            "fraction with contact_normal_min < 0, which would lift off",
        ),
    )
)


def runs_schema(
    record: Collection[str] = (), model: str = "full", extra: Iterable[pa.Field] = ()
) -> pa.Schema:
    """Return the schema of `runs` with some of `RECORD_PARTS` and `extra` columns."""
    if wrong := [part for part in sorted(record) if model in RECORD_PARTS[part]]:
        raise ConfigError(f"record: the model {model!r} cannot record {wrong[0]!r}")
    asked = [part for part in RUNS if part not in RECORD_PARTS or part in record]
    return pa.schema([*(column for part in asked for column in RUNS[part]), *extra])


def same_schema(one: pa.Schema, other: pa.Schema) -> bool:
    """Return whether schemas agree in names, types, nullability and units."""
    units = [
        [(f.metadata or {}).get(b"unit", b"") for f in schema]
        for schema in (one, other)
    ]
    return one.equals(other) and units[0] == units[1]


def build_table(columns: Mapping[str, Any], schema: pa.Schema) -> pa.Table:
    """Return a table of arrays, where NaN is null, or of codes with words, where -1 is
    null.
    """
    arrays = [_to_arrow(columns[field.name], field.type) for field in schema]
    table = pa.Table.from_arrays(arrays, schema=schema.remove_metadata())
    for field in table.schema:
        if not field.nullable and table.column(field.name).null_count:
            raise ValueError(
                f"internal error: column {field.name} has rows that are not finite"
            )
    return table


def ragged(values: Floats, counts: Integers) -> pa.Array:
    """Return a column of lists ``values[i, :counts[i]]``, null for a negative count."""
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
