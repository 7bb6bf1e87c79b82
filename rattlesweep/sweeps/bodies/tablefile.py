"""Read a table of bodies, from a CSV file, Parquet or a DataFrame, into Arrow columns."""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.parquet as pq

from rattlesweep.errors import ConfigError, one_line

if TYPE_CHECKING:
    import pandas as pd

MAX_ROWS = 10**7
MAX_COLUMNS = 1000
LONGEST_HEAD = 1 << 20
PIECE = 1 << 24
ANYTHING = pa.large_string()


def read_table(path: str, base: Path | None, where: str) -> pa.Table:
    """Read a CSV file, a Parquet file, or a directory of such, given here or under `base`.

    All columns of a CSV are text.  The rows of a directory of runs are in the order of cases and
    samples, however they are spread over its files.

    Raises
    ------
    ConfigError
        If there is no such table, or if it is too large; begins with `where`.
    """
    try:
        file = Path(path)
        # os.path.exists takes a name that is too long for one of no file.
        if not os.path.exists(file) and base is not None:
            file = base / path
        if not os.path.exists(file):
            raise ConfigError(f"{where}: no such file; give the path of a CSV or Parquet table")
        if file.is_dir() or (file.is_file() and file.suffix.lower() in (".parquet", ".pq")):
            return _read_parquet(file, where)
        if file.is_file():
            return _read_csv(file, where)
        raise ConfigError(f"{where}: is no regular file; give a CSV or Parquet table")
    except ConfigError:
        raise
    except Exception as error:  # pyarrow raises many kinds
        reason = one_line(str(error).split("\n")[0] or type(error).__name__, 200)
        raise ConfigError(f"{where}: cannot be read as a table ({reason})") from None


def _read_csv(file: Path, where: str) -> pa.Table:
    from pyarrow import csv as arrow_csv

    skipped, rows = 0, 0
    with open(file, "rb") as data:
        head = data.readline(LONGEST_HEAD)
        while head and not head.strip():
            skipped, head = skipped + 1, data.readline(LONGEST_HEAD)
        if len(head) == LONGEST_HEAD:
            raise ValueError("its first line has no end")
        begin = data.tell()
        # At once, as it takes long to read all of it.
        while (piece := data.read(PIECE)) and rows <= MAX_ROWS:
            if b"\0" in piece:
                raise ValueError("it is no text: there is a byte 0 in it")
            rows += piece.count(b"\n")
        if b"\0" in head:
            raise ValueError("it is no text: there is a byte 0 in it")
        empty = data.tell() == begin
    names = [name.strip() for name in next(csv.reader([head.decode("utf-8-sig")]), [])]
    named = [name for name in names if name]
    _check_size(named, rows, where)
    if empty:
        return pa.table({name: pa.array([], ANYTHING) for name in named})
    bad: list[str] = []

    def odd(row: arrow_csv.InvalidRow) -> str:
        number, cells = row.number - skipped - 1, row.actual_columns
        bad.append(f"row {number}: {cells} cells, where the first line has {row.expected_columns}")
        return "skip"

    table = arrow_csv.read_csv(
        file,
        # One thread knows the numbers of rows.
        arrow_csv.ReadOptions(use_threads=False, column_names=names, skip_rows=skipped + 1),
        arrow_csv.ParseOptions(newlines_in_values=True, invalid_row_handler=odd),
        arrow_csv.ConvertOptions(
            column_types=dict.fromkeys(named, ANYTHING),
            strings_can_be_null=True,
            include_columns=named,
        ),
    )
    if bad:
        raise ValueError(bad[0])
    return table


def _read_parquet(file: Path, where: str) -> pa.Table:
    data = pq.ParquetDataset(file)
    _check_size(data.schema.names, 0, where)
    _check_size([], sum(part.count_rows() for part in data.fragments), where)
    table = data.read()
    if file.is_dir() and {"case", "sample"} <= set(table.column_names):
        table = table.sort_by([("case", "ascending"), ("sample", "ascending")])
    return table.replace_schema_metadata(None)


def table_of(frame: pd.DataFrame, where: str) -> pa.Table:
    """Return a DataFrame as Arrow columns; what is of no one type becomes text."""
    names = [str(name) for name in frame.columns]
    _check_size(names, len(frame), where)
    columns = {}
    for place, name in enumerate(names):
        series = frame.iloc[:, place]
        try:
            columns[name] = pa.array(series, from_pandas=True)
        except (pa.ArrowException, TypeError, ValueError):
            text = [None if value is None or value != value else str(value) for value in series]
            columns[name] = pa.array(text, ANYTHING)
    return pa.table(columns)


def _check_size(names: list[str], rows: int, where: str) -> None:
    if len(names) > MAX_COLUMNS:
        raise ConfigError(
            f"{where}: the table has {len(names)} columns; at most {MAX_COLUMNS} can be read, so "
            "leave out what the sweep does not need"
        )
    if rows > MAX_ROWS:
        raise ConfigError(
            f"{where}: the table has more than {MAX_ROWS} rows; divide it into several sweeps"
        )
    for name in dict.fromkeys(names):
        if names.count(name) > 1:
            raise ConfigError(
                f"{where}: there are {names.count(name)} columns {one_line(name)}; keep one of them"
            )
