"""Read a table of bodies (CSV or Parquet) and check every row."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.arrays import Flags, Floats
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.physics.body import PARAMETERS, violations
from rattlesweep.physics.launch import spin_and_oscillation
from rattlesweep.sweeps.bodies.measured import (
    BODY,
    INPUT,
    Measured,
    own_columns,
    refuse_row,
    require,
    without_units,
)
from rattlesweep.sweeps.columns import MEASURED
from rattlesweep.sweeps.config.fields import MAX_SPEED, MAX_TIME
from rattlesweep.sweeps.config.schema import unit

LAUNCH = ("n_i", "omega_xy0")
OMEGA, U = ("omega_x", "omega_y", "omega_z"), ("u_x", "u_y", "u_z")
LOSSES = ("sigma", "rolling")
NULLABLE = ("t_end", "psi", "f_sd", "t_r", "c", "t_end_s", "c_m")
COLUMNS = (*PARAMETERS, *LAUNCH, *OMEGA, *U, *NULLABLE[:5], *LOSSES)
# Of an output table, both the full state and the spin it has are there; so far may they differ.
SPIN_SLACK = 1e-9

# Of columns that are no body's: what is wrong with a value, and what is wanted.
RULES: tuple[tuple[str, Callable[[Floats], Flags], str], ...] = (
    *((name, lambda x: np.abs(x) > MAX_SPEED, f"at most {MAX_SPEED:g} is allowed")
      for name in (*LAUNCH, *OMEGA, "sigma")),
    *((name, lambda x: x <= 0, "it must be positive")
      for name in ("t_end", *BODY, "gravity_m_s2")),
    ("t_end", lambda t_end: t_end > MAX_TIME, f"at most {MAX_TIME:g} is allowed"),
    *((name, lambda loss: loss < 0, "it must be at least 0") for name in LOSSES),
    ("rolling", lambda rolling: rolling > 1, "at most 1 is allowed"),
)  # fmt: skip
# And where there is no full state, which may have no oscillation.
SPIN_RULES = (("omega_xy0", lambda omega: omega <= 0, "it must be positive"),)

# Types of a Parquet file that are taken.
NUMBERS = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal, pa.types.is_string,
           pa.types.is_large_string, pa.types.is_null)  # fmt: skip


def check_value(name: str, values: Floats) -> tuple[int, str] | None:
    """The place of the first value, of a flat array, that breaks a rule, and what is wanted."""
    for column, is_wrong, wanted in (*RULES, *SPIN_RULES):
        if column == name and (bad := is_wrong(values)).any():
            return int(np.argmax(bad)), wanted
    return None


def read_table(path: str, base: Path | None = None) -> tuple[dict[str, Floats], Measured]:
    """Read bodies from a CSV or Parquet file, or a directory of such, here or under `base`.

    Whatever is wrong is a ConfigError that names the row.

    Returns
    -------
    columns : dict
        ``alpha .. xi``; ``n_i``, ``omega_xy0`` and ``psi`` where the table has a launch,
        and ``omega_x .. u_z`` where it is a full state, which says the others; ``sigma`` and
        ``rolling`` where it has them;
        ``t_end`` where it has one, NaN for rows that have a ``t_r``: in an output table the
        ``t_end`` of a run that reversed is its result, not its horizon.
    measured : Measured
        What else belongs to the rows.
    """
    where = f"bodies.path: {one_line(path, 200)}"
    file = Path(path)
    # os.path.exists, as a name that is too long is no error to it.
    if not os.path.exists(file) and base is not None and os.path.exists(base / path):
        file = base / path
    if not os.path.exists(file):
        raise ConfigError(f"{where}: no such file; give the path of a CSV or Parquet table")
    try:
        parquet = file.is_dir() or file.suffix.lower() in (".parquet", ".pq")
        frame = _read_parquet(file, where) if parquet else _read_csv(file, where)
    except ConfigError:
        raise
    except Exception as error:  # pandas and pyarrow raise many kinds
        reason = one_line(str(error).split("\n")[0] or type(error).__name__, 200)
        raise ConfigError(f"{where}: cannot be read as a table ({reason})") from None
    columns, second = columns_of(frame, where)
    found = own_columns(frame, (*COLUMNS, *INPUT), where)
    more = () if second is None else MEASURED
    return columns, replace(found, second=second, fields=(*found.fields, *more))


def columns_of(frame: pd.DataFrame, where: str) -> tuple[dict[str, Floats], Floats | None]:
    """Columns as :func:`read_table` gives them, and the unit of time in seconds where it is known.

    `where` is what a complaint begins with.
    """
    _check_repeats(frame.columns.tolist(), where)
    if not len(frame):
        raise ConfigError(f"{where}: the table has no rows; give at least one body")
    columns = {}
    for name in (name for name in (*COLUMNS, *INPUT) if name in frame.columns):
        if (kind := frame[name].dtype).kind not in "iufO":
            raise ConfigError(f"{where}: the column {name} is of type {kind}; numbers are wanted")
        columns[name] = _numbers(frame[name], name, where)
    _check_rows(columns, where)
    columns, second = without_units(columns, where)
    require(PARAMETERS, columns, where, f"{' '.join(PARAMETERS)} are wanted")
    state = [name for name in (*OMEGA, *U) if name in columns]
    if state:
        require((*OMEGA, *U), state, where, f"a full state has {' '.join((*OMEGA, *U))}")
    lone = [name for name in LAUNCH if name in columns]
    if len(lone) == 1 and not state:
        raise ConfigError(
            f"{where}: {lone[0]} stands alone; give both n_i and omega_xy0, or neither"
        )
    _check_rows(columns, where)
    columns = {name: columns[name] for name in COLUMNS if name in columns}
    reversal = columns.pop("t_r", None)
    if reversal is not None and "t_end" in columns:
        columns["t_end"] = np.where(np.isfinite(reversal), np.nan, columns["t_end"])
    if state:
        columns |= launched_from(columns, where)
    if "n_i" not in columns or not np.isfinite(columns.get("psi", np.array(np.nan))).all():
        columns.pop("psi", None)
    return columns, second


def launched_from(columns: dict[str, Floats], where: str) -> dict[str, Floats]:
    """The launch that full states are, with ``u`` of length 1.

    A row that is none, or says another spin beside, is refused in a line that begins with `where`.
    """
    omega, u = (np.stack([columns[x] for x in names], axis=1) for names in (OMEGA, U))
    for row in range(len(u)):
        try:
            u[row] = unit(u[row].tolist())
        except ValueError as error:
            raise ConfigError(f"{where}: row {row + 1}: u: {error}") from None
    n_i, omega_xy0, psi = spin_and_oscillation(omega, u)
    still = (omega == 0).all(axis=1) & (u[:, 2] == -1)
    refuse_row(where, still, "the body stands upright and at rest; give it an angular velocity")
    other = columns.get("n_i", n_i)
    wrong = np.abs(other - n_i) > SPIN_SLACK * np.linalg.norm(omega, axis=1)
    told = "n_i is {:g}, and the spin of the full state {:g}; leave n_i and omega_xy0 out"
    refuse_row(where, wrong, told, other, n_i)
    lengths = {name: u[:, k] for k, name in enumerate(U)}
    return {"n_i": n_i, "omega_xy0": omega_xy0, "psi": psi} | lengths


def _read_csv(file: Path, where: str) -> pd.DataFrame:
    # As text first, so that a wrong cell can be quoted with its row; the head as a row like any,
    # as pandas renames columns that repeat, and moves all by one where rows have a cell more.
    frame = pd.read_csv(file, header=None, dtype=str, skipinitialspace=True)
    names = frame.iloc[0].tolist()
    _check_repeats(names, where)
    frame = frame.iloc[1:]
    named = [name for name in names if isinstance(name, str) and name.strip()]
    return pd.DataFrame({n: frame[names.index(n)] for n in named}, frame.index)


def _read_parquet(file: Path, where: str) -> pd.DataFrame:
    data = pq.ParquetDataset(file)
    _check_repeats(data.schema.names, where)
    names = []
    for name in data.schema.names:
        kind = data.schema.field(name).type
        inner = kind.value_type if pa.types.is_dictionary(kind) else kind
        # Text may hold numbers; pandas would make some of times, truth values and bytes too.
        if any(is_kind(inner) for is_kind in NUMBERS):
            names.append(name)
        elif name in (*COLUMNS, *INPUT):
            raise ConfigError(f"{where}: the column {name} is of type {kind}; numbers are wanted")
    table = data.read(columns=names)
    return pd.DataFrame({name: table.column(name).to_pandas() for name in names})


def _check_repeats(names: list[str], where: str) -> None:
    for name in dict.fromkeys(names):
        if names.count(name) > 1:
            raise ConfigError(
                f"{where}: there are {names.count(name)} columns {name}; keep one of them"
            )


def _numbers(series: pd.Series[str], name: str, where: str) -> Floats:
    values = pd.to_numeric(series, errors="coerce").to_numpy(dtype=float)
    bad = ~np.isfinite(values)
    if name in NULLABLE:
        bad &= ~series.isna().to_numpy()
    if bad.any():
        cells = [
            "empty" if empty else repr(str(cell)[:40])
            for cell, empty in zip(series, series.isna(), strict=True)
        ]
        refuse_row(where, bad, name + " is {}; a finite number is needed", cells)
    return values


def _check_rows(columns: dict[str, Floats], where: str) -> None:
    worst: list[tuple[int, str]] = []
    if all(name in columns for name in PARAMETERS):
        worst += violations(**{name: columns[name] for name in PARAMETERS})
    for name, is_wrong, wanted in RULES if "u_x" in columns else (*RULES, *SPIN_RULES):
        # NaN, where it may stand, is no value, and breaks no rule.
        if name in columns and (bad := is_wrong(columns[name])).any():
            row = int(np.argmax(bad))
            worst.append((row, f"{name} is {columns[name][row]:g}; {wanted}"))
    if worst:
        row, sentence = min(worst)
        raise ConfigError(f"{where}: row {row + 1}: {sentence}")
