"""Read a table of bodies, from a CSV file, Parquet or a DataFrame, into Arrow columns."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.errors import ConfigError, one_line

if TYPE_CHECKING:
    import pandas as pd


def read_table(path: str, base: Path | None, where: str) -> pa.Table:
    """Read a CSV file, a Parquet file, or a directory of such, given here or under `base`.

    All columns of a CSV are text.  The rows of a directory of runs are in the order of cases and
    samples, however they are spread over its files.

    Raises
    ------
    ConfigError
        If there is no such table; begins with `where`.
    """
    file = Path(path)
    # os.path.exists returns False for a name that is too long.
    if not os.path.exists(file) and base is not None:
        file = base / path
    if not (os.path.isdir(file) or os.path.isfile(file)):
        raise ConfigError(f"{where}: no such file; give the path of a CSV or Parquet table")
    try:
        if file.is_dir() or file.suffix.lower() in (".parquet", ".pq"):
            table = _plain(pq.ParquetDataset(file).read())
            if file.is_dir() and {"case", "sample"} <= set(table.column_names):
                table = table.sort_by([("case", "ascending"), ("sample", "ascending")])
            return table
        return _read_csv(file, where)
    except ConfigError:
        raise
    except Exception as error:  # pandas and pyarrow raise many kinds
        reason = one_line(str(error).split("\n")[0] or type(error).__name__, 200)
        raise ConfigError(f"{where}: cannot be read as a table ({reason})") from None


def _read_csv(file: Path, where: str) -> pa.Table:
    import pandas as pd

    # As text, so that a wrong cell can be quoted; and the names as a row like any other, since
    # pandas renames columns that repeat, and shifts all columns if rows have a cell more.
    frame = pd.read_csv(file, header=None, dtype=str, skipinitialspace=True)
    names = frame.iloc[0].fillna("").str.strip()
    frame = frame.iloc[1:, (names != "").to_numpy()]
    return table_of(frame.set_axis(names[names != ""].tolist(), axis=1), where)


def table_of(frame: pd.DataFrame, where: str) -> pa.Table:
    """Return a DataFrame as Arrow columns; a column of mixed types becomes text."""
    for name, count in Counter(map(str, frame.columns)).items():
        if count > 1:
            told = f"there are {count} columns {one_line(name)}; keep one of them"
            raise ConfigError(f"{where}: {told}")
    try:
        table = pa.Table.from_pandas(frame, preserve_index=False)
    except (pa.ArrowException, TypeError, ValueError):
        mixed = {name: "str" for name in frame.columns if frame[name].dtype == object}
        table = pa.Table.from_pandas(frame.astype(mixed), preserve_index=False)
    return _plain(table)


def _plain(table: pa.Table) -> pa.Table:
    """Return a table whose columns of categories are columns of their values."""
    kinds = {f.name: f.type.value_type for f in table.schema if pa.types.is_dictionary(f.type)}
    columns = zip(table.column_names, table.columns, strict=True)
    return pa.table({name: c.cast(kinds[name]) if name in kinds else c for name, c in columns})
