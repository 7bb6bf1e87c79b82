"""Conditions on runs, such as ``type == "SW" and K_r < 0.005``, as pandas' query has them.

The text is Python: columns, numbers, 'words', comparisons, ``in [...]``, ``and or not``,
arithmetic, ``abs()`` and a few other functions, and ``t_r.isna()``. It is parsed first, and nothing
else gets to pandas: no attributes, no other calls, no variables.
"""

from __future__ import annotations

import ast
import warnings
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.sweeps.config.messages import nearest

MOST_CHARACTERS = 2000
FUNCTIONS = ("abs", "sqrt", "exp", "log", "log10", "sin", "cos")
TESTS = ("isna", "notna", "isnull", "notnull")
_ALLOWED = (
    ast.Expression, ast.BoolOp, ast.And, ast.Or, ast.UnaryOp, ast.Not, ast.USub, ast.UAdd,
    ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Mod, ast.Pow, ast.BitAnd, ast.BitOr,
    ast.Invert, ast.Compare, ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.In, ast.NotIn,
    ast.Name, ast.Load, ast.Constant, ast.List, ast.Tuple,
)  # fmt: skip


@dataclass(frozen=True)
class Where:
    """A condition that was parsed and found harmless."""

    text: str  # as it was written
    columns: tuple[str, ...]  # that it reads
    query: str  # for pandas
    option: str  # that it was given by

    def filter(self, rows: pa.RecordBatch) -> pa.RecordBatch:
        """Return the rows for which the condition is true; a comparison with null is not."""
        frame = pa.table(rows.select(list(self.columns))).to_pandas(
            types_mapper={pa.bool_(): pd.BooleanDtype()}.get
        )
        try:
            with np.errstate(all="ignore"), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = frame.eval(self.query, engine="python", parser="pandas")
                is_bool = isinstance(found, pd.Series) and pd.api.types.is_bool_dtype(found)
        except Exception as error:  # pandas has no common class for what it raises
            why = one_line(str(error.args[-1] if error.args else error), 200)
            raise ConfigError(self._sentence(f"cannot be evaluated ({why})")) from None
        if not is_bool:
            raise ConfigError(self._sentence("is no condition on columns; compare some"))
        return rows.filter(pa.array(found.fillna(False).to_numpy(bool)))

    def _sentence(self, what: str, example: bool = False) -> str:
        more = '; write a pandas query, as in type == "SW" and K_r < 0.005' if example else ""
        return f"{self.option} {one_line(self.text, 200)}: {what}{more}"


def parse_where(text: str, schema: pa.Schema, option: str = "--where") -> Where:
    """Check a condition on the columns of a schema.

    Raises
    ------
    ConfigError
        If the text is empty, too long, no expression, holds more than comparisons and arithmetic,
        or names something that is no column; the message is one sentence.
    """
    text = text.strip()
    where = Where(text, (), "", option)
    if not text:
        raise ConfigError(where._sentence("is empty", True))
    if len(text) > MOST_CHARACTERS:
        raise ConfigError(
            where._sentence(f"has {len(text)} characters; at most {MOST_CHARACTERS} are read")
        )
    try:
        tree = ast.parse(text.replace("\n", " ").replace("\r", " "), mode="eval")
        columns = _columns(tree, schema)
        return Where(text, columns, ast.unparse(_Floats().visit(tree)), option)
    except SyntaxError as error:
        rest = one_line((error.text or "")[max(0, (error.offset or 1) - 1) :].strip(), 20)
        raise ConfigError(where._sentence(f"cannot be read near {rest!r}", True)) from None
    except (MemoryError, RecursionError):
        raise ConfigError(where._sentence("is nested too deep")) from None
    except (ValueError, OverflowError) as error:
        raise ConfigError(where._sentence(str(error.args[-1]))) from None


def _columns(tree: ast.Expression, schema: pa.Schema) -> tuple[str, ...]:
    """Return the columns that an expression names; raise a ValueError if it does anything else."""
    called: set[int] = set()
    found: list[str] = []
    for node in ast.walk(tree):  # a call comes before what it calls
        match node:
            case ast.Call(ast.Name(name) as function, [_], []) if name in FUNCTIONS:
                called.add(id(function))
                continue
            case ast.Call(ast.Attribute(ast.Name(), test) as function, [], []) if test in TESTS:
                called.add(id(function))
                continue
            case ast.Name(name) if id(node) not in called:
                if name not in schema.names:
                    near = nearest(name, schema.names)
                    hint = (
                        f"did you mean {near}?" if near else f"there are {', '.join(schema.names)}"
                    )
                    raise ValueError(f"{one_line(name, 40)} is no column; {hint}")
                if pa.types.is_list(schema.field(name).type):
                    raise ValueError(f"{name} holds several numbers a run and cannot be compared")
                found.append(name)
            case ast.Constant(value) if not isinstance(value, str | int | float):
                raise ValueError(f"{value!r} cannot be compared; column.isna() tests for null")
        if id(node) not in called and not isinstance(node, _ALLOWED):
            shown = ast.unparse(node) if isinstance(node, ast.expr) else type(node).__name__
            raise ValueError(f"{one_line(shown, 40)!r} is not allowed in a condition")
    if not found:
        raise ValueError("names no column")
    return tuple(dict.fromkeys(found))


class _Floats(ast.NodeTransformer):
    """Make whole numbers in arithmetic floating ones: powers of whole numbers may take for ever."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        for side in ("left", "right"):
            match getattr(node, side):
                case ast.Constant(int(number)):
                    setattr(node, side, ast.Constant(float(number)))
                case ast.UnaryOp(sign, ast.Constant(int(number))):
                    setattr(node, side, ast.UnaryOp(sign, ast.Constant(float(number))))
        return node
