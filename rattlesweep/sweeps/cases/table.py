"""Read a table of bodies (CSV or Parquet) and check every row."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.physics.body import PARAMETERS, violations
from rattlesweep.sweeps.config.fields import MAX_SPEED

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

LAUNCH = ("n_i", "omega_xy0")
COLUMNS = (*PARAMETERS, *LAUNCH, "t_end", "psi", "f_sd", "t_r")

# Types of a Parquet file that are taken.
NUMBERS = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal, pa.types.is_string,
           pa.types.is_large_string, pa.types.is_null)  # fmt: skip


@dataclass(frozen=True)
class BodyTable:
    """Columns of a table that was found good."""

    columns: dict[str, Floats]
    rows: int


def read_table(path: str, base: Path | None = None) -> BodyTable:
    """Read bodies from a file, or from a directory of Parquet files such as ``runs``.

    Parameters
    ----------
    path : str
        CSV (with a header) or Parquet, by its ending.
    base : Path, optional
        A second directory to look in.

    Returns
    -------
    BodyTable
        ``alpha .. xi``; ``n_i``, ``omega_xy0`` and ``psi`` where the table has a launch; ``t_end``
        where it has one, NaN for rows that have a ``t_r``: in an output table the ``t_end`` of a
        run that reversed is its result, not its horizon.

    Raises
    ------
    ConfigError
        If the file cannot be read, a column is missing, or a row is wrong; the row is named.
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
    missing = [name for name in PARAMETERS if name not in frame.columns]
    if missing:
        raise ConfigError(
            f"{where}: the column {missing[0]} is missing; {' '.join(PARAMETERS)} are wanted"
        )
    if ("n_i" in frame.columns) != ("omega_xy0" in frame.columns):
        lone = "n_i" if "n_i" in frame.columns else "omega_xy0"
        raise ConfigError(f"{where}: {lone} stands alone; give both n_i and omega_xy0, or neither")
    if not len(frame):
        raise ConfigError(f"{where}: the table has no rows; give at least one body")
    columns = {
        name: _numbers(frame[name], name, where, nullable=name in ("f_sd", "t_r", "t_end", "psi"))
        for name in COLUMNS
        if name in frame.columns
    }
    _check_rows(columns, where)
    reversal = columns.pop("t_r", None)
    if reversal is not None and "t_end" in columns:
        columns["t_end"] = np.where(np.isfinite(reversal), np.nan, columns["t_end"])
    if "n_i" not in columns or not np.isfinite(columns.get("psi", np.array(np.nan))).all():
        columns.pop("psi", None)
    return BodyTable(columns, len(frame))


def _read_csv(file: Path, where: str) -> pd.DataFrame:
    # As text first, so that a wrong cell can be quoted with its row; the head as a row like any,
    # as pandas renames columns that repeat, and moves all by one where rows have a cell more.
    frame = pd.read_csv(file, header=None, dtype=str, skipinitialspace=True)
    names = frame.iloc[0].tolist()
    _check_repeats(names, where)
    frame = frame.iloc[1:]
    return pd.DataFrame({n: frame[names.index(n)] for n in COLUMNS if n in names}, frame.index)


def _read_parquet(file: Path, where: str) -> pd.DataFrame:
    data = pq.ParquetDataset(file)
    _check_repeats(data.schema.names, where)
    names = [name for name in COLUMNS if name in data.schema.names]
    for name in names:
        kind = data.schema.field(name).type
        inner = kind.value_type if pa.types.is_dictionary(kind) else kind
        # Text may hold numbers; pandas would make some of times, truth values and bytes too.
        if not any(is_kind(inner) for is_kind in NUMBERS):
            raise ConfigError(f"{where}: the column {name} is of type {kind}; numbers are wanted")
    table = data.read(columns=names)
    return pd.DataFrame({name: table.column(name).to_pandas() for name in names})


def _check_repeats(names: list[str], where: str) -> None:
    for name in COLUMNS:
        if names.count(name) > 1:
            raise ConfigError(
                f"{where}: there are {names.count(name)} columns {name}; keep one of them"
            )


def _numbers(series: pd.Series[str], name: str, where: str, *, nullable: bool) -> Floats:
    values = pd.to_numeric(series, errors="coerce").to_numpy(dtype=float)
    bad = ~np.isfinite(values) & ~(series.isna().to_numpy() if nullable else False)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        cell = series.iloc[row]
        found = "empty" if pd.isna(cell) else f"{str(cell)[:40]!r}"
        raise ConfigError(f"{where}: row {row + 1}: {name} is {found}; a finite number is needed")
    return values


def _check_rows(columns: dict[str, Floats], where: str) -> None:
    worst: list[tuple[int, str]] = list(violations(**{name: columns[name] for name in PARAMETERS}))
    for name, least, sentence in (
        ("n_i", -np.inf, "it must not be zero"),
        ("omega_xy0", 0.0, "it must be positive"),
        ("t_end", 0.0, "it must be positive"),
    ):
        # NaN, where it may stand, is no value.
        values = columns.get(name, np.array([np.nan]))
        rules = [((values == 0) | (values < least), sentence)]
        if name in LAUNCH:
            rules.append((np.abs(values) > MAX_SPEED, f"at most {MAX_SPEED:g} is allowed"))
        for bad, wanted in rules:
            if bad.any():
                row = int(np.argmax(bad))
                worst.append((row, f"{name} is {values[row]:g}; {wanted}"))
    if worst:
        row, sentence = min(worst)
        raise ConfigError(f"{where}: row {row + 1}: {sentence}")
