"""Conditions on runs, such as ``type == "SW" and K_r < 0.005``: pandas' query, file by file."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.sweeps.config import not_one_of

# Methods of a column that a condition may call; others might write files.
METHODS = ("isna", "notna", "isin", "between")


@dataclass(frozen=True)
class Where:
    """A condition, and the columns that it reads."""

    text: str
    columns: tuple[str, ...]
    option: str  # that it was given by

    def filter(self, rows: pa.RecordBatch) -> pa.RecordBatch:
        """Return the rows for which it is true; raise a ConfigError if pandas cannot say."""
        frame = pa.table(rows.select(list(self.columns))).to_pandas(
            types_mapper={pa.bool_(): pd.BooleanDtype()}.get
        )
        query = " ".join(self.text.split())
        try:
            for method in re.findall(r"[^\d\s.]\w*\s*\.\s*([A-Za-z_]\w*)", _unquoted(query)):
                if method not in METHODS:
                    raise ValueError(f".{method} is none of .{', .'.join(METHODS)}")
            with np.errstate(all="ignore"):
                # No names but the columns.
                found = frame.eval(query, engine="python", local_dict={}, global_dict={})
            if not (isinstance(found, pd.Series) and pd.api.types.is_bool_dtype(found)):
                raise ValueError("it is no condition on columns")
        except Exception as error:  # pandas has no common class for what it raises
            why = error.msg if isinstance(error, SyntaxError) else str([*error.args, ""][0])
            if unknown := re.fullmatch(r"name '(\w+)' is not defined", why):
                why = not_one_of(unknown[1], rows.schema.names)
            raise ConfigError(
                f"{self.option} {one_line(self.text, 200)}: {one_line(why, 400)}; write a pandas "
                'query, as in type == "SW" and K_r < 0.005'
            ) from None
        return rows.filter(pa.array(found.fillna(False).to_numpy(bool)))


def parse_where(text: str, schema: pa.Schema, option: str = "--where") -> Where:
    """Return a condition on the columns of a schema; raise a ConfigError if the text is none."""
    words = re.findall(r"[A-Za-z_]\w*", _unquoted(text))
    where = Where(text, tuple(name for name in schema.names if name in words), option)
    where.filter(pa.RecordBatch.from_pylist([], schema=schema))  # of no rows, to check the text
    return where


def _unquoted(text: str) -> str:
    return re.sub(r"'[^']*'|\"[^\"]*\"", "''", text)
