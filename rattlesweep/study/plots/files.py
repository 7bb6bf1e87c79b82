"""Where pictures and their data go."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rattlesweep.errors import ConfigError
from rattlesweep.study.style import FORMATS, encode
from rattlesweep.sweeps.store.atomic import replace_file

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.figure import Figure

TABLES = ("csv", "parquet")


def named_outputs(texts: Sequence[str]) -> list[Path]:
    """Files for a picture, each of a kind that its name tells.

    Raises
    ------
    ConfigError
        A name ends otherwise.
    """
    return [_ending(text, "--output", FORMATS) for text in texts]


def named_data(text: str | None) -> Path | None:
    """File for the numbers of a picture.

    Raises
    ------
    ConfigError
        Its name does not end in .csv or .parquet.
    """
    return None if text is None else _ending(text, "--data", TABLES)


def _ending(text: str, option: str, kinds: Sequence[str]) -> Path:
    path = Path(text)
    if path.suffix.lower().removeprefix(".") not in kinds:
        wanted = f"{', '.join(f'.{kind}' for kind in kinds[:-1])} or .{kinds[-1]}"
        raise ConfigError(f"{option} {text}: the name must end in {wanted}")
    return path


def parse_size(text: str | None) -> tuple[float, float] | None:
    """Width and height in inches from ``W,H``.

    Raises
    ------
    ConfigError
        It is not two numbers between 1 and 60.
    """
    if text is None:
        return None
    try:
        width, height = (float(word) for word in text.split(","))
    except ValueError:
        width = height = 0.0
    if not (1 <= width <= 60 and 1 <= height <= 60):
        raise ConfigError(
            f"--size {text}: give width and height in inches, each from 1 to 60, as in 7,4.5"
        )
    return width, height


def parse_limits(option: str, text: str | None) -> tuple[float, float] | None:
    """Ends of an axis from ``LOW,HIGH``.

    Raises
    ------
    ConfigError
        It is not two finite numbers, the first of them smaller.
    """
    if text is None:
        return None
    try:
        low, high = (float(word) for word in text.split(","))
    except ValueError:
        low = high = 0.0
    if not -math.inf < low < high < math.inf:
        raise ConfigError(f"{option} {text}: give the lower and the upper end, as in 0.01,0.1")
    return low, high


def write_figure(figure: Figure, paths: Sequence[Path], dpi: float) -> None:
    """Write a figure to some files, each in one step.

    Raises
    ------
    OutputError
        One of them cannot be written.
    """
    for path in paths:
        replace_file(path, encode(figure, path.suffix.lower().removeprefix("."), dpi))


def write_data(table: pa.Table, path: Path) -> None:
    """Write a table as CSV or Parquet, in one step; errors as for `write_figure`."""
    import pyarrow.csv as csv
    import pyarrow.parquet as parquet

    buffer = io.BytesIO()
    if path.suffix.lower() == ".csv":
        csv.write_csv(table, buffer)
    else:
        parquet.write_table(table, buffer)
    replace_file(path, buffer.getvalue())
