"""Every column of the two tables, in one place.

`runs` has one row a run, `summary` one row a case. The names are fixed, since scripts written
against today's tables must read next year's; each is written once, here, with its unit and its
meaning, and both schemas are made from these rows.

M = a = g = 1, so times are in sqrt(a/g), spins and rates in sqrt(g/a), energies in M g a.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import pyarrow as pa

from rattlesweep.errors import ConfigError

TIME = "sqrt(a/g)"
RATE = "sqrt(g/a)"
ENERGY = "M g a"
FORCE = "M g"

_F64, _I32, _I64, _TEXT = pa.float64(), pa.int32(), pa.int64(), pa.string()
# "element" is what Parquet calls it: a schema then comes back as it was written.
_SERIES = pa.list_(pa.field("element", pa.float64()))


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Parameters
    ----------
    name
        Its name in the file.
    type
        Its Arrow type.
    unit
        Unit as text: ``"1"`` for a pure number or a word.
    description
        A few words for whoever opens the table.
    nullable
        Whether a row may have no value here.
    repeats
        Whether few values fill many rows, so that a dictionary makes the file smaller.
    group
        What it belongs to: keys, body, launch, theory, result, observation, or a `record` part.
    part
        The word in `record` that asks for it; ``None`` where it is always there.
    """

    name: str
    type: pa.DataType
    unit: str
    description: str
    nullable: bool = False
    repeats: bool = False
    group: str = ""
    part: str | None = None

    @property
    def field(self) -> pa.Field:
        """The Arrow field, with `unit` and `description` in its metadata."""
        metadata = {"unit": self.unit, "description": self.description}
        return pa.field(self.name, self.type, nullable=self.nullable, metadata=metadata)


def _group(group: str, *columns: Column, part: str | None = None) -> tuple[Column, ...]:
    return tuple(replace(column, group=group, part=part) for column in columns)


def _extra(part: str, *columns: Column) -> tuple[Column, ...]:
    # Nullable throughout: a run that failed at launch has nothing to record.
    return _group(part, *(replace(column, nullable=True) for column in columns), part=part)


RUNS: tuple[Column, ...] = (
    *_group(
        "keys",
        Column("case", _I32, "1", "number of the case, from 0", repeats=True),
        Column("sample", _I64, "1", "number of the run within its case, from 0"),
    ),
    *_group(
        "body",
        Column("alpha", _F64, "1", "I_xx / (M a^2) + 1"),
        Column("beta", _F64, "1", "I_yy / (M a^2) + 1"),
        Column("gamma", _F64, "1", "I_zz / (M a^2)"),
        Column("theta", _F64, "1", "larger principal curvature at the bottom, times a"),
        Column("phi", _F64, "1", "smaller principal curvature at the bottom, times a"),
        Column("xi", _F64, "rad", "skew angle from the axes of inertia to those of curvature"),
        Column("f_sd", _F64, "1", "I_yy / I_zz; null unless the source draws it", nullable=True),
    ),
    *_group(
        "launch",
        Column("n_i", _F64, RATE, "initial spin, positive = unsteady direction", repeats=True),
        Column("omega_xy0", _F64, RATE, "initial rate of the oscillation", repeats=True),
        Column("psi", _F64, "rad", "direction of that rate from the x axis", nullable=True),
    ),
    *_group(
        "theory",
        Column("omega_p", _F64, RATE, "pitch frequency without spin", nullable=True),
        Column("omega_r", _F64, RATE, "roll frequency without spin", nullable=True),
        Column("K_p", _F64, "1", "asymmetric torque coefficient of pitch", nullable=True),
        Column("K_r", _F64, "1", "asymmetric torque coefficient of roll", nullable=True),
        Column(
            "n_c1",
            _F64,
            RATE,
            "Bondi's threshold spin of the steady direction; null: no threshold",
            nullable=True,
        ),
        Column("n_0", _F64, RATE, "spin that would hold all the energy", nullable=True),
        Column(
            "t_rgh",
            _F64,
            TIME,
            "Garcia and Hubbard's reversal time of this spin direction; null: no reversal",
            nullable=True,
        ),
    ),
    *_group(
        "result",
        Column("t_end", _F64, TIME, "time reached"),
        Column("t_r", _F64, TIME, "first zero of the spin; null: none by t_end", nullable=True),
        Column(
            "type",
            _TEXT,
            "1",
            "R, SS, SW or unclassified; null where status is not ok",
            nullable=True,
            repeats=True,
        ),
        Column("status", _TEXT, "1", "ok, or a word for what went wrong", repeats=True),
        Column("n_end", _F64, RATE, "spin at t_end", nullable=True),
        Column("n_steps", _I64, "1", "accepted steps of the integrator"),
        Column("energy_drift", _F64, "1", "relative change of energy at t_end", nullable=True),
    ),
    *_group(
        "observation",
        Column(
            "amp_growth",
            _F64,
            "1",
            "largest ratio of the windowed amplitude of the relevant oscillation to its smallest "
            "earlier value, minus 1",
            nullable=True,
        ),
        Column(
            "n_departure",
            _F64,
            "1",
            "largest fractional loss of spin, the maximum over time of 1 - n/n_i",
            nullable=True,
        ),
        Column(
            "near_tangencies",
            _I32,
            "1",
            "extrema of the spin so near zero that the tolerance cannot tell whether it reversed",
            repeats=True,
        ),
    ),
    *_extra(
        "energy",
        Column("energy_0", _F64, ENERGY, "energy at launch"),
        Column("energy_drift_max", _F64, "1", "largest relative change of energy at any step"),
    ),
    *_extra(
        "contact",
        Column("contact_ratio_max", _F64, "1", "largest F_perp / F_parallel at the contact"),
        Column("contact_normal_min", _F64, FORCE, "smallest F_parallel; negative = lift-off"),
    ),
    *_extra(
        "windows",
        Column("window_t", _F64, TIME, "length of one window", repeats=True),
        Column("window_amplitude", _SERIES, RATE, "amplitude of the relevant mode, by window"),
        Column("window_n_min", _SERIES, RATE, "smallest spin, by window"),
        Column("window_n_max", _SERIES, RATE, "largest spin, by window"),
    ),
    *_extra(
        "lyapunov",
        Column(
            "lyapunov",
            _F64,
            RATE,
            "largest Lyapunov exponent, apart from the zeros of the flow and the energy, over the "
            "whole run; of a run that reverses, the finite-time one up to t_r",
        ),
        Column(
            "lyapunov_late",
            _F64,
            RATE,
            "the same over the second half of the run; null: too short to tell",
        ),
    ),
)
"""Columns of `runs` in their order."""

SUMMARY: tuple[Column, ...] = _group(
    "summary",
    Column("case", _I32, "1", "number of the case, from 0"),
    Column("K_p", _F64, "1", "target of K_p, where the case has one", nullable=True),
    Column("K_r", _F64, "1", "target of K_r, where the case has one", nullable=True),
    Column("n_i", _F64, RATE, "initial spin; null where rows differ", nullable=True),
    Column("omega_xy0", _F64, RATE, "initial rate; null where rows differ", nullable=True),
    Column("runs", _I64, "1", "runs stored"),
    Column("fraction_R", _F64, "1", "share of type R among runs with status ok", nullable=True),
    Column("fraction_SS", _F64, "1", "share of type SS among runs with status ok", nullable=True),
    Column("fraction_SW", _F64, "1", "share of type SW among runs with status ok", nullable=True),
    Column(
        "fraction_unclassified",
        _F64,
        "1",
        "share of unclassified among runs with status ok",
        nullable=True,
    ),
    Column(
        "fraction_bondi",
        _F64,
        "1",
        "share with abs(n_c1) < abs(n_i) among runs in the steady direction that have a theory; "
        "null in the unsteady direction, where no spin is stable",
        nullable=True,
    ),
    Column("t_r_mean", _F64, TIME, "mean t_r of type R", nullable=True),
    Column(
        "t_r_std",
        _F64,
        TIME,
        "sample standard deviation (n - 1) of t_r of type R; null for fewer than 2",
        nullable=True,
    ),
    Column("t_rgh_mean", _F64, TIME, "mean t_rgh of the runs that have one", nullable=True),
    Column(
        "t_r_over_t_rgh_mean",
        _F64,
        "1",
        "mean of t_r / t_rgh, taken run by run, of type R",
        nullable=True,
    ),
    Column(
        "t_r_over_t_rgh_sem",
        _F64,
        "1",
        "standard error of that mean; null for fewer than 2 runs",
        nullable=True,
    ),
    Column("failed", _I64, "1", "runs with status other than ok"),
    Column("near_tangencies", _I64, "1", "sum of near_tangencies over the runs"),
)
"""Columns of `summary` in their order."""

RECORD_PARTS: dict[str, frozenset[str]] = {
    "energy": frozenset({"full", "reduced"}),
    "contact": frozenset({"full"}),
    "windows": frozenset({"full", "reduced"}),
    "lyapunov": frozenset({"full", "reduced"}),
}
"""What `record` may ask for, with the models that can tell.

The reduced dynamics has no contact force, and the closed form no path to look at.
"""

REPEATING: frozenset[str] = frozenset(c.name for c in (*RUNS, *SUMMARY) if c.repeats)
"""Columns which a dictionary makes smaller."""


def runs_columns(record: Collection[str] = (), model: str = "full") -> tuple[Column, ...]:
    """Columns of `runs` for what a config records.

    Parameters
    ----------
    record
        Any words of `RECORD_PARTS`; their order does not matter.
    model
        ``full``, ``reduced`` or ``gh``.

    Raises
    ------
    ConfigError
        A word in `record` is unknown, or this model cannot give it.
    """
    for part in sorted(record):
        models = RECORD_PARTS.get(part)
        if models is None:
            raise ConfigError(f"record: {part!r} is none of {', '.join(RECORD_PARTS)}")
        if model not in models:
            raise ConfigError(f"record: the model {model!r} has no {part!r} to record")
    return tuple(column for column in RUNS if column.part is None or column.part in record)


def runs_schema(record: Collection[str] = (), model: str = "full") -> pa.Schema:
    """Arrow schema of `runs`, with `unit` and `description` in each field's metadata.

    Parameters
    ----------
    record, model
        As for `runs_columns`.

    Raises
    ------
    ConfigError
        A word in `record` is unknown, or this model cannot give it.
    """
    return pa.schema([column.field for column in runs_columns(record, model)])


def summary_schema() -> pa.Schema:
    """Arrow schema of `summary`, with `unit` and `description` in each field's metadata."""
    return pa.schema([column.field for column in SUMMARY])
