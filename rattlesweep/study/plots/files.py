"""Where pictures and their data go."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rattlesweep.study.style import encode
from rattlesweep.sweeps.store.atomic import replace_file

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.figure import Figure


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
