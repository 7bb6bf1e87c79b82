"""Tables of measured data: columns of numbers by name, as programs write them.

A text is understood by its first lines: where its header is, what separates the columns
and what the decimal sign is.  Then only the columns that are needed are read.
"""

from __future__ import annotations

import csv
import io
import os
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.design.tables import (
    COMMENT,
    SAMPLED,
    SEPARATORS,
    announce,
    decimal_sign,
    encoding_of,
    read_table,
    table_file,
)
from rattlesweep.words.errors import ConfigError, one_line

if TYPE_CHECKING:
    import pandas as pd

BLANK = " "  # separates columns where nothing else does
_NAMES_OF = {**SEPARATORS, BLANK: "blanks"}
# What the first cell of a row holds: a number, a date or a time, or nothing known.
_NUMBER = re.compile(
    r"[-+]?[.,]?\d[\d.,]*(?:e[-+]?\d+)?|\d+[-/:].*|[-+]?(?:nan|inf|na)", re.IGNORECASE
)
# A number with a decimal comma whose columns are separated by commas, too.
_TWO_COMMAS = re.compile(r"([-+]?\d+),(\d+(?:E[-+]?\d+)?)(?=,|\s*$)", re.MULTILINE)
_DECLARED = re.compile(r"sep=.", re.IGNORECASE)  # a first line for spreadsheets
_QUOTED = re.compile(r'"[^"]*"')
ZIP = b"PK\x03\x04"
OLD_EXCEL = b"\xd0\xcf\x11\xe0"
LARGEST_MEMBER = 500_000_000  # bytes of a table in an archive, unpacked
MOST_MEMBERS = 1000
EMPTY = "is empty; export it again, with the rows of the film or of the sensor"


class Sheet(Protocol):
    """A table with named columns, of which some are read."""

    @property
    def place(self) -> str:
        """What begins messages about the table."""

    @property
    def names(self) -> list[str]:
        """Names of the columns."""

    def read(self, columns: Sequence[int]) -> list[Floats]:
        """Return columns by number as floats, NaN where a cell is empty.

        Raises a ConfigError about the first cell that is no number.
        """

    @property
    def has_rows(self) -> bool:
        """Whether there is any row below the header."""


@dataclass(frozen=True)
class FrameSheet:
    """A table in memory."""

    place: str
    frame: pd.DataFrame

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return [str(name).strip() for name in self.frame]

    def read(self, columns: Sequence[int]) -> list[Floats]:
        """Return columns as floats; see :class:`Sheet`."""
        return [
            _as_numbers(self.place, self.names[column], self.frame.iloc[:, column])
            for column in columns
        ]

    @property
    def has_rows(self) -> bool:
        """Whether there is any row."""
        return len(self.frame) > 0


@dataclass(frozen=True)
class TextSheet:
    """A table of a text, whose rows are read when they are asked for."""

    place: str
    names: list[str]
    rows: str
    separator: str
    decimal: str
    width: int  # cells of a row, at most

    def read(self, columns: Sequence[int]) -> list[Floats]:
        """Return columns as floats; see :class:`Sheet`."""
        try:
            frame = self._parsed(columns, float)
            return [frame[column].to_numpy(float) for column in columns]
        except ValueError:
            # Some cell is no number, and is found among the texts.
            frame = self._parsed(columns, str)
        return [
            _as_numbers(
                self.place,
                self.names[column],
                frame[column].str.replace(self.decimal, ".", regex=False),
            )
            for column in columns
        ]

    @property
    def has_rows(self) -> bool:
        """Whether there is any row below the header."""
        return self.rows.strip() != ""

    def _parsed(self, columns: Sequence[int], kind: type) -> pd.DataFrame:
        import pandas as pd

        if not self.has_rows:
            return pd.DataFrame({column: [] for column in columns}, dtype=kind)
        try:
            return pd.read_csv(
                io.StringIO(self.rows),
                sep=self.separator,
                decimal=self.decimal,
                header=None,
                names=range(self.width),
                usecols=sorted(columns),
                dtype=kind,
                index_col=False,
                skipinitialspace=self.separator != BLANK,
            )
        except pd.errors.ParserError as error:
            reason = one_line(str(error).split("\n")[0], 200)
            raise ConfigError(
                f"{self.place}: cannot be read as a table ({reason})"
            ) from None


def _as_numbers(place: str, name: str, cells: pd.Series[Any]) -> Floats:
    """Return cells as floats, NaN where one is empty; raise if one is no number."""
    import pandas as pd

    numbers = pd.to_numeric(cells, errors="coerce")
    for row in np.flatnonzero(numbers.isna() & cells.notna())[:1]:
        cell = one_line(str(cells.iloc[row]), 40)
        raise ConfigError(f"{place}: row {row + 1}: {name} is {cell}, not a number")
    values: Floats = numbers.to_numpy(float)
    return values


def open_sheet(
    source: str | os.PathLike[str] | pd.DataFrame | Mapping[str, Sequence[float]],
) -> Sheet:
    """Return a table in memory or in a file: CSV, Parquet, a ZIP archive or Excel."""
    import pandas as pd

    place = "data"
    try:
        if not isinstance(source, str | os.PathLike):
            return FrameSheet(place, pd.DataFrame(source))
        place = one_line(os.fspath(source), 200)
        return _sheet_of_file(table_file(source, place), place)
    except ConfigError:
        raise
    except Exception as error:  # pandas raises many kinds
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise ConfigError(
            f"{place}: cannot be read as a table ({one_line(reason, 200)})"
        ) from None


def _sheet_of_file(file: Path, place: str) -> Sheet:
    if file.is_dir() or file.suffix.lower() in (".parquet", ".pq"):
        return FrameSheet(place, read_table(file, place).to_pandas())
    announce(file)
    content = file.read_bytes()
    if content.startswith(OLD_EXCEL):
        return _sheet_of_excel(file, place)
    if content.startswith(ZIP):
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if "[Content_Types].xml" in archive.namelist():
                return _sheet_of_excel(file, place)
            return _sheet_of_archive(archive, place)
    return sheet_of_text(place, content)


def _sheet_of_excel(file: Path, place: str) -> Sheet:
    """Return the first sheet of an Excel file."""
    import pandas as pd

    try:
        frame = pd.read_excel(file, engine="calamine")
    except ImportError:
        raise ConfigError(
            f"{place}: is a file of Excel; export it as CSV, or install "
            "rattlesweep[excel]"
        ) from None
    return FrameSheet(place, frame)


def _sheet_of_archive(archive: zipfile.ZipFile, place: str) -> Sheet:
    """Return the table of an archive as phyphox and Sensor Logger write them.

    It is the only one, or the one that is named after the gyroscope.
    """
    members = archive.infolist()
    if len(members) > MOST_MEMBERS:
        raise ConfigError(
            f"{place}: holds {len(members):,} files; give the table of the gyroscope "
            "alone"
        )
    tables = [
        member
        for member in members
        if Path(member.filename).suffix.lower() in (".csv", ".txt", ".tsv")
        and "meta" not in member.filename.lower()
    ]
    named = [
        member
        for member in tables
        if re.search(r"gyro|drehrate|rotation", Path(member.filename).stem, re.I)
        and "uncalibrated" not in member.filename.lower()
    ]
    chosen = tables
    if len(tables) > 1 and named:
        chosen = named
    if len(chosen) != 1:
        listed = ", ".join(member.filename for member in members)
        raise ConfigError(
            f"{place}: holds {one_line(listed, 200) or 'no file'}; give the table of "
            "the gyroscope or of the marks alone"
        )
    (member,) = chosen
    if member.file_size > LARGEST_MEMBER:
        raise ConfigError(
            f"{place}: {one_line(member.filename)} is {member.file_size / 1e9:.1f} GB; "
            f"up to {LARGEST_MEMBER / 1e9:g} GB is allowed"
        )
    with archive.open(member) as stream:
        # The size that an archive states may be wrong.
        content = stream.read(LARGEST_MEMBER)
    return sheet_of_text(f"{place}: {one_line(member.filename)}", content)


class _Line(NamedTuple):
    """A line of a text that is not empty, and where it begins and ends."""

    text: str
    begin: int
    end: int


def sheet_of_text(place: str, content: bytes) -> Sheet:
    """Return the table of a text; its header is the line above the first numbers.

    What stands above the header, such as names of marks, comments and empty lines, is
    left out.
    """
    text = content.decode(encoding_of(content), errors="replace")
    if not text.strip():
        raise ConfigError(f"{place}: {EMPTY}")
    if "\0" in text[:SAMPLED]:
        raise ConfigError(
            f"{place}: cannot be read as a table: it has zero bytes, as UTF-16 without "
            "a byte order mark or no text has; save it as UTF-8"
        )
    lines = list(_lines(text))
    first = next((row for row, line in enumerate(lines) if _is_row(line.text)), None)
    if first == 0:
        raise ConfigError(
            f"{place}: line 1 is {one_line(lines[0].text)}, and a header with the "
            "names of the columns is needed above the numbers, such as t_s,angle_deg"
        )
    if first is None:
        # Without a row, the header is the line with most names.
        counts = [len(_cells_of(line.text)) for line in lines]
        header = counts.index(max(counts))
    else:
        header = first - 1
    sample = [line.text for line in lines[header + 1 :]]
    head = lines[header].text.lstrip(COMMENT).strip("\r\n")
    separator = _separator(place, head, sample)
    (names,) = csv.reader([head], delimiter=separator)
    names = [" ".join(name.split()) for name in names]
    rows = text[lines[header].end :]
    cells = list(csv.reader(sample, delimiter=separator))
    named = max(place for place, name in enumerate(["?", *names]) if name)
    if separator == "," and cells and all(len(row) == 2 * named for row in cells):
        # Tracker writes decimal commas between commas if it is told so.
        rows = _TWO_COMMAS.sub(r"\1.\2", rows)
        cells = [
            line.split(",")
            for line in _TWO_COMMAS.sub(r"\1.\2", "\n".join(sample)).split("\n")
        ]
    last = rows[rows.rstrip().rfind("\n") + 1 :].rstrip("\r\n")
    if last.strip():
        cells += csv.reader([last], delimiter=separator)
    for row in cells:
        if len(row) < named or any(cell.strip() for cell in row[len(names) :]):
            raise ConfigError(
                f"{place}: cannot be read as a table: its header has {named} columns "
                f"and a row {len(row)}, separated by {_NAMES_OF[separator]}; if commas "
                "are decimal signs, separate the columns by semicolons"
            )
    width = max(map(len, cells), default=len(names))
    above: list[list[str]] = [[]] * text.count("\n", 0, lines[header].end)
    decimal = decimal_sign([*above, *cells], place)
    return TextSheet(place, names, rows, separator, decimal, width)


def _lines(text: str) -> Iterator[_Line]:
    """Yield the lines of the beginning of a text that are not empty."""
    # Up to the end of a line, and the next one: a header may be long.
    after = text.find("\n", SAMPLED)
    after = text.find("\n", after + 1) if after >= 0 else -1
    sampled = len(text)
    if after >= 0:
        sampled = after + 1
    begin = 0
    for line in text[:sampled].splitlines(keepends=True):
        end = begin + len(line)
        if line.strip() and not _DECLARED.fullmatch(line.strip()):
            yield _Line(line.strip("\r\n"), begin, end)
        begin = end


def _cells_of(line: str) -> list[str]:
    """Return the cells of a line that are not empty, whatever separates them."""
    return [cell for cell in re.split(r"[\t;,]", line.replace('"', "")) if cell.strip()]


def _is_row(line: str) -> bool:
    """Return whether a line begins with a number."""
    first = next(iter(_cells_of(line)), "").strip()
    words = first.split(BLANK)
    return _NUMBER.fullmatch(words[0]) is not None and (
        len(words) == 1 or all(_NUMBER.fullmatch(word) for word in words if word)
    )


def _separator(place: str, header: str, rows: list[str]) -> str:
    """Return what separates the columns of a header and of the rows below."""
    outside = _QUOTED.sub("", header)
    used = [separator for separator in SEPARATORS if separator in outside]
    if len(used) > 1:
        names = " and ".join(SEPARATORS[separator] for separator in used)
        raise ConfigError(
            f"{place}: its header has {names}; separate the columns by one of them"
        )
    if used:
        return used[0]
    if BLANK in outside.strip() and all(BLANK in row for row in islice(rows, 3)):
        return BLANK
    return ","
