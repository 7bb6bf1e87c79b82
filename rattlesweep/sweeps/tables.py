"""Tables of users: CSV in its usual dialects, Parquet, and folders of Parquet files."""

import csv as dialects
import io
import os
import re
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as pq

from rattlesweep.errors import ConfigError, one_line

LARGE = 3e8  # bytes of a file that takes seconds to read
SAMPLED = 1_000_000  # bytes from which separator and decimal sign are inferred
SEPARATORS = {"\t": "tabs", ";": "semicolons", ",": "commas"}
COMMA_DECIMAL = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")
POINT_DECIMAL = re.compile(r"[-+]?\d*\.\d+(?:[eE][-+]?\d+)?")


def read_table(path: str | os.PathLike[str], where: str) -> pa.Table:
    """Read a CSV file, a Parquet file or a folder of Parquet files.

    CSV may have commas, semicolons or tabs between its columns, and with the latter two
    also decimal commas.  Names of columns lose the blanks around them.  Messages of a
    ConfigError begin with `where`.
    """
    file = Path(path)
    # Unlike methods of a path, these take names that no system allows.
    if not (os.path.isdir(file) or os.path.isfile(file)):
        what = "no such file"
        if os.path.exists(file):
            what = "is not a file"
        raise ConfigError(f"{where}: {what}; give the path of a CSV or Parquet table")
    try:
        _announce(file)
        if file.is_dir() or file.suffix.lower() in (".parquet", ".pq"):
            return pq.read_table(file, page_checksum_verification=True)
        return _read_csv(file, where)
    except ConfigError:
        raise
    except Exception as error:  # pyarrow raises many kinds
        raise unreadable(where, error) from None


def unreadable(where: str, error: Exception) -> ConfigError:
    """Return the error about something that is no table."""
    reason = one_line(str(error).split("\n")[0] or type(error).__name__, 200)
    return ConfigError(f"{where}: cannot be read as a table ({reason})")


def _announce(file: Path) -> None:
    """Tell that a large table is being read."""
    files = [file]
    if file.is_dir():
        files = list(file.rglob("*"))
    size = sum(each.stat().st_size for each in files)
    if size > LARGE:
        name = one_line(str(file), 200)
        print(f"reading {name}, {size / 1e9:.1f} GB", file=sys.stderr)


def _read_csv(file: Path, where: str) -> pa.Table:
    with open(file, "rb") as stream:
        head = stream.read(SAMPLED).decode("utf-8-sig", errors="replace")
    separator = _separator(head, where)
    decimal = _decimal_sign(head, separator, where)
    # Types are inferred from the first block, so one block takes the whole file.
    block = min(file.stat().st_size + 1, 2**31 - 1)
    try:
        table = csv.read_csv(
            file,
            csv.ReadOptions(block_size=block),
            csv.ParseOptions(delimiter=separator),
            csv.ConvertOptions(strings_can_be_null=True, decimal_point=decimal),
        )
    except pa.ArrowInvalid as error:
        counts = re.search(r"Expected (\d+) columns, got (\d+)", str(error))
        if counts is None:
            raise
        raise ConfigError(
            f"{where}: cannot be read as a table: its header has {counts[1]} columns "
            f"and a row {counts[2]}, separated by {SEPARATORS[separator]}; if commas "
            "are decimal signs, separate the columns by semicolons"
        ) from None
    return table.rename_columns([name.strip() for name in table.column_names])


def _separator(head: str, where: str) -> str:
    """Return the separator of the columns, by the first line that is not empty."""
    header = next((line for line in head.splitlines() if line.strip()), "")
    used = [separator for separator in SEPARATORS if separator in header]
    if len(used) > 1:
        names = " and ".join(SEPARATORS[separator] for separator in used)
        raise ConfigError(
            f"{where}: its first line has {names}; separate the columns by one of them"
        )
    if used:
        return used[0]
    if len(header.split()) > 1 and '"' not in header:
        raise ConfigError(
            f"{where}: the columns of its first line are separated by blanks; separate "
            "them by commas, semicolons or tabs"
        )
    return ","


def _decimal_sign(head: str, separator: str, where: str) -> str:
    """Return the decimal sign of the numbers."""
    if separator == ",":
        return "."
    commas = set()
    points = set()
    for line, cells in enumerate(
        dialects.reader(io.StringIO(head), delimiter=separator)
    ):
        for cell in cells:
            if COMMA_DECIMAL.fullmatch(cell.strip()):
                commas.add(line)
            elif POINT_DECIMAL.fullmatch(cell.strip()):
                points.add(line)
    if commas and points:
        raise ConfigError(
            f"{where}: line {min(commas) + 1} has a decimal comma and line "
            f"{min(points) + 1} a decimal point; write all numbers in one way"
        )
    if commas:
        return ","
    return "."
