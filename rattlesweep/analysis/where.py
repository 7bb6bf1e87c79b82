"""Conditions on runs, such as ``type == "SW" and K_r < 0.005``: pandas' query, file by file."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.sweeps.config.messages import nearest

METHODS = ("isna", "notna", "isin", "between")
"""Methods of a column that a condition may call; others might write files."""


@dataclass(frozen=True)
class Where:
    """A condition, and the columns that it reads."""

    text: str
    columns: tuple[str, ...]
    option: str  # that it was given by

    def filter(self, rows: pa.RecordBatch) -> pa.RecordBatch:
        """Return the rows for which the condition is true; a comparison with null is not.

        Raises
        ------
        ConfigError
            If pandas cannot evaluate it.
        """
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
                raise ValueError("it is no condition on columns; compare some")
        except Exception as error:  # pandas has no common class for what it raises
            why = error.msg if isinstance(error, SyntaxError) else str([*error.args, ""][0])
            why = one_line(" ".join(why.split()), 200)
            if unknown := re.fullmatch(r"name '(\w+)' is not defined", why):
                near = nearest(unknown[1], rows.schema.names)
                known = ", ".join(rows.schema.names)
                hint = f"did you mean {near}?" if near else f"there are {known}"
                why = f"{unknown[1]} is no column; {hint}"
            raise ConfigError(
                f"{self.option} {one_line(self.text, 200)}: {why}; write a pandas query, as in "
                'type == "SW" and K_r < 0.005'
            ) from None
        return rows.filter(pa.array(found.fillna(False).to_numpy(bool)))


def parse_where(text: str, schema: pa.Schema, option: str = "--where") -> Where:
    """Check a condition on the columns of a schema.

    Raises
    ------
    ConfigError
        If the text is no condition on columns; the message is one sentence.
    """
    words = re.findall(r"[A-Za-z_]\w*", _unquoted(text))
    where = Where(text, tuple(name for name in schema.names if name in words), option)
    # On no rows, for what is wrong with the text alone.
    where.filter(pa.RecordBatch.from_pylist([], schema=schema))
    return where


def _unquoted(text: str) -> str:
    return re.sub(r"'[^']*'|\"[^\"]*\"", "''", text)
