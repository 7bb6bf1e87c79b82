"""Tables of users: CSV in its usual dialects, Parquet, and folders of Parquet files."""

import codecs
import contextlib
import csv as dialects
import io
import math
import os
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as csv
import pyarrow.parquet as pq

from rattlesweep.arrays import EXACT_WHOLE
from rattlesweep.system.files import as_path, open_regular
from rattlesweep.words.errors import ConfigError, one_line

LARGE = 3e8  # bytes of a file that takes seconds to read
MAGIC = b"PAR1"  # begins a Parquet file
HIDDEN = (".", "_")
MOST_FILES = 10_000  # in a folder
SAMPLED = 1_000_000  # bytes from which separator and decimal sign are inferred
COMMENT = "#"  # begins lines before the header that are no part of the table
SEPARATORS = {"\t": "tabs", ";": "semicolons", ",": "commas"}
COMMA_DECIMAL = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")
POINT_DECIMAL = re.compile(r"[-+]?\d*\.\d+(?:[eE][-+]?\d+)?")
_WHOLE = re.compile(r"0|-?[1-9]\d*", re.ASCII)


def of_all(name: str) -> bool:
    """Return that a column is read by its looks, and that all files need it."""
    return True


def read_table(
    path: str | os.PathLike[str],
    where: str,
    by_looks: Callable[[str], bool] = of_all,
    needed: Callable[[str], bool] = of_all,
) -> pa.Table:
    """Read a CSV file, a Parquet file or a folder of Parquet files.

    CSV may have commas, semicolons or tabs between its columns, and with the latter two
    also decimal commas.  Lines that begin with ``#`` may stand before the header.
    Names of columns lose the blanks around them.  Messages of a ConfigError begin with
    `where`.

    A cell of a CSV column may look like a number, or like none (``NA``).  Columns of
    names for which `by_looks` is false keep what is written: they are numbers only if
    each cell is written as a number is printed.  A folder has the columns of all its
    files; one that is `needed` must be in all files or in none.
    """
    file = table_file(path, where)
    try:
        if file.is_dir():
            _check_folder(file, where)
        announce(file)
        if file.is_dir():
            return _read_folder(file, where, needed)
        if file.suffix.lower() in (".parquet", ".pq"):
            return pq.read_table(file, page_checksum_verification=True)
        return _read_csv(file, where, by_looks)
    except ConfigError:
        raise
    except Exception as error:  # pyarrow raises many kinds
        raise unreadable(where, error) from None


def table_file(path: str | os.PathLike[str], where: str) -> Path:
    """Return the path of a table; raise a ConfigError if there is no file or folder."""
    file = as_path(path, where)
    # Unlike methods of a path, these take names that no system allows.
    if not (os.path.isdir(file) or os.path.isfile(file)):
        what = "no such file"
        if os.path.exists(file):
            what = "is not a file"
        raise ConfigError(f"{where}: {what}; give the path of a CSV or Parquet table")
    return file


def unreadable(where: str, error: Exception) -> ConfigError:
    """Return the error about something that is no table."""
    reason = one_line(str(error).split("\n")[0] or type(error).__name__, 200)
    return ConfigError(f"{where}: cannot be read as a table ({reason})")


def _check_folder(folder: Path, where: str) -> None:
    """Refuse a folder of other things before all of it is searched."""
    count = 0
    for place, folders, names in os.walk(folder):
        # Arrow leaves out what begins so.
        folders[:] = [name for name in folders if not name.startswith(HIDDEN)]
        count += len(folders)
        for name in names:
            if name.startswith(HIDDEN):
                continue
            count += 1
            path = Path(place, name)
            with open_regular(path) as file:
                if file.read(len(MAGIC)) != MAGIC:
                    raise ConfigError(
                        f"{where}: is a folder with {one_line(str(path), 200)}, no "
                        "Parquet file; give one of Parquet files"
                    )
        if count > MOST_FILES:
            raise ConfigError(
                f"{where}: is a folder of more than {MOST_FILES:,} files; put them "
                "into one"
            )


def announce(file: Path) -> None:
    """Tell that a large table is being read."""
    files = [file]
    if file.is_dir():
        files = list(file.rglob("*"))
    size = sum(each.stat().st_size for each in files)
    if size > LARGE:
        name = one_line(str(file), 200)
        print(f"reading {name}, {size / 1e9:.1f} GB", file=sys.stderr)


def _read_folder(folder: Path, where: str, needed: Callable[[str], bool]) -> pa.Table:
    """Read all files of a folder; null where a file lacks a column of another one."""
    import pyarrow.dataset as ds

    parts = ds.dataset(str(folder), format="parquet", partitioning="hive")
    tables: dict[str, pa.Table] = {}
    for part in parts.get_fragments():
        table = pq.read_table(part.path, page_checksum_verification=True)
        # A folder such as n_i=0.1 stands for a column of its files.
        for name, value in ds.get_partition_keys(part.partition_expression).items():
            if name not in table.column_names:
                kind = parts.schema.field(name).type
                column = pa.array([value] * len(table), kind)
                table = table.append_column(name, column)
        tables[os.path.relpath(part.path, folder)] = table
    if not tables:
        raise ConfigError(f"{where}: the folder has no Parquet file; give another one")
    holders: dict[str, str] = {}
    for file, table in tables.items():
        for name in table.column_names:
            holders.setdefault(name, file)
    columns = {}
    for name, holder in holders.items():
        for file, table in tables.items():
            if name not in table.column_names and needed(name):
                raise ConfigError(
                    f"{where}: {file} has no column {one_line(name)}, which {holder} "
                    "has; give it to all files or to none"
                )
        columns[name] = _joined(name, tables, where)
    return pa.table(columns)


def _joined(name: str, tables: dict[str, pa.Table], where: str) -> pa.ChunkedArray:
    """Return a column of all tables, of a type that holds the values of each."""
    parts = []
    types: dict[str, str] = {}
    for file, table in tables.items():
        column = pa.nulls(len(table))
        if name in table.column_names:
            column = table.column(name)
            if pa.types.is_dictionary(column.type):
                column = column.cast(column.type.value_type)
            types.setdefault(str(column.type), file)
        parts.append(pa.table({name: column}))
    try:
        return pa.concat_tables(parts, promote_options="permissive").column(name)
    except pa.ArrowException:
        # Texts beside numbers, or whole numbers that no float holds.
        listed = " and ".join(f"{kind} in {file}" for kind, file in types.items())
        raise ConfigError(
            f"{where}: the column {one_line(name)} is {listed}; write it with one type"
        ) from None


def _read_csv(file: Path, where: str, by_looks: Callable[[str], bool]) -> pa.Table:
    encoding = encoding_of(file.read_bytes())
    with open(file, encoding=encoding, errors="replace", newline="") as stream:
        head = stream.read(SAMPLED)
    if not head.strip():
        raise ConfigError(
            f"{where}: is empty; give a table with a header and rows of numbers"
        )
    if "\0" in head:
        raise ConfigError(
            f"{where}: cannot be read as a table: it has zero bytes, as UTF-16 without "
            "a byte order mark or no text has; save it as UTF-8"
        )
    source: Path | pa.BufferReader = file
    size = file.stat().st_size
    if head.startswith(COMMENT):
        text = _without_comments(file.read_text(encoding=encoding))
        head = text[:SAMPLED]
        content = text.encode()
        source = pa.BufferReader(content)
        size = len(content)
        encoding = "utf-8"
    separator = _separator(head, where)
    decimal = "."
    if separator != ",":
        decimal = decimal_sign(
            dialects.reader(io.StringIO(head), delimiter=separator), where
        )
    header = next(filter(None, dialects.reader(io.StringIO(head), delimiter=separator)))
    copied = [name for name in header if not by_looks(name.strip())]
    # Types are inferred from the first block, so one block takes the whole file, of
    # which a byte may become three in UTF-8.
    block = min(3 * size + 1, 2**31 - 1)
    converting = csv.ConvertOptions(
        decimal_point=decimal, column_types=dict.fromkeys(copied, pa.string())
    )
    try:
        table = csv.read_csv(
            source,
            csv.ReadOptions(block_size=block, encoding=encoding.removesuffix("-sig")),
            csv.ParseOptions(delimiter=separator),
            converting,
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
    columns = []
    names = []
    for name, column in zip(table.column_names, table.columns, strict=True):
        names.append(name.strip())
        if name in copied:
            column = _as_written(_null_where(column, [""]), decimal)
        elif pa.types.is_string(column.type):
            column = _null_where(column, converting.null_values)
        columns.append(column)
    return pa.table(columns, names)


def encoding_of(text: bytes) -> str:
    """Return how a text is encoded: UTF-16 by its first bytes, UTF-8, or Windows' own.

    The latter is Latin-1 with more characters, and a few bytes that are none.
    """
    if text.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    for encoding in ("utf-8-sig", "cp1252"):
        with contextlib.suppress(UnicodeDecodeError):
            text.decode(encoding)
            return encoding
    return "latin-1"


def _null_where(column: pa.ChunkedArray, words: list[str]) -> pa.ChunkedArray:
    """Return texts, of which some words stand for empty cells."""
    is_null = pc.is_in(column, pa.array(words))
    return pc.if_else(is_null, pa.scalar(None, pa.string()), column)


def _as_written(column: pa.ChunkedArray, decimal: str) -> pa.ChunkedArray:
    """Return texts as numbers if these are printed as the texts, else as they are.

    So 007, 1.10, 1E5, 1234e567 and inf stay what they are.
    """
    cells = column.drop_null().to_pylist()
    if not cells:
        return column
    if all(_WHOLE.fullmatch(cell) for cell in cells):
        largest = max(abs(int(cell)) for cell in cells)
        return column.cast(pa.int64()) if largest < 2**63 else column
    if all(_is_printed(cell, decimal) for cell in cells):
        return pc.replace_substring(column, decimal, ".").cast(pa.float64())
    return column


def _is_printed(cell: str, decimal: str) -> bool:
    """Return whether a cell is what a float is printed as, or an exact whole number."""
    if _WHOLE.fullmatch(cell):
        return abs(int(cell)) <= EXACT_WHOLE
    text = cell.replace(decimal, "p").replace(".", "").replace("p", ".")
    try:
        number = float(text)
    except ValueError:
        return False
    return repr(number).replace(".", decimal) == cell and math.isfinite(number)


def _without_comments(text: str) -> str:
    """Return a table without the lines before it that begin with ``#``.

    The last of these is its header if it has the columns of the first row of numbers.
    """
    lines = text.splitlines(keepends=True)
    count = 0
    while count < len(lines) and lines[count].startswith(COMMENT):
        count += 1
    rest = lines[count:]
    if count and rest:
        last = lines[count - 1].lstrip(COMMENT).lstrip()
        has_numbers = re.match(r"[-+.\d]", rest[0].strip()) is not None
        shapes = [
            [line.count(separator) for separator in SEPARATORS]
            for line in (last, rest[0])
        ]
        if has_numbers and shapes[0] == shapes[1]:
            rest.insert(0, last)
    return "".join(rest)


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


def decimal_sign(rows: Iterable[list[str]], where: str) -> str:
    """Return the decimal sign of the numbers in some rows."""
    commas = set()
    points = set()
    for line, cells in enumerate(rows):
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
