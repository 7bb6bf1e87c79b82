"""Conditions on runs, such as ``type == "SW" and K_r < 0.005``.

A condition is written as for ``DataFrame.query``, but pandas never sees its text, as it
would run any code in it.  Here the text becomes a syntax tree, of which only the kinds
of nodes that a condition may hold are evaluated.
"""

from __future__ import annotations

import ast
import operator
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import TypeAlias

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.words.errors import ConfigError, not_one_of, one_line

Constant: TypeAlias = "bool | int | float | str"
_Value: TypeAlias = "Constant | list[Constant] | pd.Series"

ADVICE = 'write a pandas query, as in type == "SW" and K_r < 0.005'
ALLOWED = (
    "it may hold columns, numbers, texts, comparisons, arithmetic, and, or, not, in, "
    "the functions abs, sqrt, log, exp and the methods isna, notna, isin, between"
)
# Methods of columns that a condition may call; others might write files.
_METHODS = ("isna", "notna", "isin", "between")
FUNCTIONS: Mapping[str, np.ufunc] = {
    "abs": np.abs,
    "sqrt": np.sqrt,
    "log": np.log,
    "exp": np.exp,
}
Operator: TypeAlias = Callable[[_Value, _Value], _Value]
ARITHMETIC: Mapping[type[ast.operator], tuple[str, Operator]] = {
    ast.Add: ("+", operator.add),
    ast.Sub: ("-", operator.sub),
    ast.Mult: ("*", operator.mul),
    ast.Div: ("/", operator.truediv),
    ast.FloorDiv: ("//", operator.floordiv),
    ast.Mod: ("%", operator.mod),
    ast.Pow: ("**", operator.pow),
}
COMPARISONS: Mapping[type[ast.cmpop], Operator] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
# Powers of whole numbers with larger exponents could fill the memory for hours.
MOST_EXPONENT = 100
# What Python reads otherwise than pandas: a name in backticks (the group), and the
# signs for `and` and `or`.  Texts in quotes match first, so that none is found in them.
PANDAS_SIGNS = re.compile(r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|`([^`]*)`|[&|]""")
# An assignment, where a comparison is meant.
SINGLE_EQUALS = re.compile(r"(?<![=<>!])=(?!=)")


@dataclass(frozen=True)
class Where:
    """A condition, and the columns that it reads."""

    text: str
    tree: ast.expr
    columns: tuple[str, ...]

    def filter(self, rows: pa.RecordBatch) -> pa.RecordBatch:
        """Return the rows that meet the condition; raise a ConfigError for a wrong one.

        A null meets no comparison but ``!=``.
        """
        # Columns of flags keep their type where some are null; pandas would make them
        # objects.  In other columns a null becomes NaN or None, which meets nothing.
        flags = {pa.bool_(): pd.BooleanDtype()}
        table = pa.table(rows.select(list(self.columns)))
        frame = table.to_pandas(types_mapper=flags.get)
        try:
            with np.errstate(all="ignore"):
                met = _Evaluation(frame, rows.schema).value(self.tree)
        except RecursionError:
            raise refusal(self.text, "it is nested too deeply") from None
        except (ArithmeticError, TypeError, ValueError) as error:
            raise refusal(self.text, str(error)) from None
        if not isinstance(met, pd.Series) or _kind(met) != "condition":
            raise refusal(self.text, "it is no condition on columns")
        return rows.filter(pa.array(met.fillna(False).to_numpy(bool)))


def parse_where(text: str, schema: pa.Schema) -> Where:
    """Return a condition on the columns of a schema, or raise a ConfigError."""
    text = str(text)
    if not text.strip():
        raise refusal(text, "it is empty")
    python = PANDAS_SIGNS.sub(_in_python, " ".join(text.split())).strip()
    try:
        # Python warns of doubtful escapes and numbers, which are none of ours.
        with warnings.catch_warnings(action="ignore"):
            tree = ast.parse(python, mode="eval").body
    except SyntaxError as error:
        # The first sentence only, as Python's own advice goes on to name ":=".
        reason = error.msg.partition(".")[0]
        if SINGLE_EQUALS.search(python):
            reason += "; compare with == instead of ="
        raise refusal(text, reason) from None
    except (RecursionError, MemoryError):
        raise refusal(text, "it is nested too deeply") from None
    except ValueError as error:
        raise refusal(text, str(error)) from None
    names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    columns = tuple(name for name in schema.names if name in names)
    where = Where(text, tree, columns)
    # Without rows, this finds all mistakes but those that depend on single values.
    where.filter(pa.RecordBatch.from_pylist([], schema=schema))
    return where


def refusal(text: str, reason: str) -> ConfigError:
    """Return the error that refuses a condition for a reason."""
    what = f"where {one_line(text, 200)}".rstrip()
    return ConfigError(f"{what}: {one_line(reason, 400)}; {ADVICE}")


def _in_python(sign: re.Match[str]) -> str:
    """Return what Python writes for a sign of pandas; texts stay as they are."""
    name_in_backticks = sign[1]
    if name_in_backticks is not None:
        return f" {name_in_backticks} "
    # Like pandas: `a > 1 & b > 2` means `a > 1 and b > 2`.
    return {"&": " and ", "|": " or "}.get(sign[0], sign[0])


class _Evaluation:
    """The evaluation of a syntax tree on the columns of a frame."""

    def __init__(self, frame: pd.DataFrame, schema: pa.Schema) -> None:
        self.frame = frame
        self.schema = schema

    def value(self, node: ast.expr) -> _Value:
        """Return the value of a node, by the method for its kind."""
        match node:
            case ast.Constant(value=bool() | int() | float() | str() as constant):
                return constant
            case ast.Name(id=name):
                return self.column(name)
            case ast.List(elts=nodes) | ast.Tuple(elts=nodes) | ast.Set(elts=nodes):
                return self.members(nodes)
            case ast.BoolOp():
                return self.joined(node)
            case ast.UnaryOp():
                return self.unary(node)
            case ast.BinOp():
                return self.arithmetic(node)
            case ast.Compare():
                return self.comparison(node)
            case ast.Call(func=ast.Name(id=name)):
                return self.function(name, node)
            case ast.Call(func=ast.Attribute(value=receiver, attr=name)):
                return self.method(receiver, name, node)
            case _:
                raise ValueError(ALLOWED)

    def column(self, name: str) -> pd.Series:
        """Return a column by its name."""
        if name not in self.schema.names:
            raise ValueError(not_one_of(name, self.schema.names))
        if pa.types.is_list(self.schema.field(name).type):
            raise ValueError(f"{name} holds a list for each run")
        return self.frame[name]

    def members(self, nodes: list[ast.expr]) -> list[Constant]:
        """Return the numbers or texts of a list."""
        members: list[Constant] = []
        for node in nodes:
            value = self.value(node)
            if isinstance(value, pd.Series | list):
                raise ValueError("a list holds numbers or texts, not columns")
            members.append(value)
        return members

    def joined(self, node: ast.BoolOp) -> _Value:
        """Return conditions joined by `and` or `or`."""
        if isinstance(node.op, ast.And):
            word = "and"
            join = operator.and_
        else:
            word = "or"
            join = operator.or_
        conditions = [self.value(operand) for operand in node.values]
        if any(_kind(condition) != "condition" for condition in conditions):
            raise ValueError(f"{word} needs conditions on both sides")
        return reduce(join, conditions)

    def unary(self, node: ast.UnaryOp) -> _Value:
        """Return a condition negated, or a number with its sign."""
        operand = self.value(node.operand)
        if isinstance(node.op, ast.Not | ast.Invert):
            if _kind(operand) != "condition":
                raise ValueError("not needs a condition")
            if isinstance(operand, pd.Series):
                return ~operand
            return not operand
        _check_numbers("a sign", operand)
        if isinstance(node.op, ast.UAdd):
            return operand
        return operator.mul(operand, -1)

    def arithmetic(self, node: ast.BinOp) -> _Value:
        """Return the result of arithmetic on numbers and columns of numbers."""
        if type(node.op) not in ARITHMETIC:
            raise ValueError(ALLOWED)
        symbol, function = ARITHMETIC[type(node.op)]
        left = self.value(node.left)
        right = self.value(node.right)
        _check_numbers(symbol, left, right)
        if isinstance(node.op, ast.Pow):
            limit = MOST_EXPONENT
            if not isinstance(right, int | float) or abs(right) > limit:
                raise ValueError(f"exponents are numbers from -{limit} to {limit}")
            # Powers of floats overflow to infinity; those of whole numbers would wrap.
            left = operator.mul(left, np.float64(1.0))
        return function(left, right)

    def comparison(self, node: ast.Compare) -> _Value:
        """Return a chain of comparisons, such as ``0 < a < 1``."""
        values = [self.value(each) for each in (node.left, *node.comparators)]
        # `0 < a < 1` is `0 < a` and `a < 1`.
        comparisons = [
            _compared(first, type(sign), second)
            for first, sign, second in zip(
                values[:-1], node.ops, values[1:], strict=True
            )
        ]
        return reduce(operator.and_, comparisons)

    def function(self, name: str, node: ast.Call) -> _Value:
        """Return a function of a number or of a column of numbers."""
        if name not in FUNCTIONS:
            raise ValueError(f"{name} is none of the functions {', '.join(FUNCTIONS)}")
        if len(node.args) != 1 or node.keywords:
            raise ValueError(f"{name} takes one number or column")
        argument = self.value(node.args[0])
        _check_numbers(name, argument)
        return FUNCTIONS[name](argument)

    def method(self, receiver: ast.expr, name: str, node: ast.Call) -> _Value:
        """Return what one of the methods in _METHODS says about a column."""
        if name not in _METHODS:
            raise ValueError(f".{name} is none of .{', .'.join(_METHODS)}")
        column = self.value(receiver)
        if not isinstance(column, pd.Series):
            raise ValueError(f".{name} is a method of columns only")
        arguments = [self.value(argument) for argument in node.args]
        keywords = {str(word.arg): self.value(word.value) for word in node.keywords}
        return getattr(column, name)(*arguments, **keywords)


def _compared(first: _Value, sign: type[ast.cmpop], second: _Value) -> _Value:
    """Return one comparison; with a list on its right side, a membership."""
    if isinstance(second, list):
        # As in pandas, == and != with a list mean `in` and `not in`.
        if not isinstance(first, pd.Series):
            raise ValueError("only a column may be in a list")
        if sign in (ast.In, ast.Eq):
            return first.isin(second)
        if sign in (ast.NotIn, ast.NotEq):
            return ~first.isin(second)
        raise ValueError("a list goes with in, not in, == and !=")
    if sign in (ast.In, ast.NotIn):
        raise ValueError("in needs a list, as in sample in [1, 3]")
    if sign not in COMPARISONS:
        raise ValueError(ALLOWED)
    kinds = {_kind(first), _kind(second)}
    # A number and a condition can be compared, as True is 1.
    if "text" in kinds and len(kinds) > 1:
        raise ValueError(f"it compares a {_kind(first)} with a {_kind(second)}")
    return COMPARISONS[sign](first, second)


def _kind(value: _Value) -> str:
    """Return what a value or each value of a column is; refuse a list."""
    if isinstance(value, list):
        raise ValueError(ALLOWED)
    if isinstance(value, pd.Series):
        if pd.api.types.is_bool_dtype(value):
            return "condition"
        return "number" if pd.api.types.is_numeric_dtype(value) else "text"
    if isinstance(value, bool | np.bool_):
        return "condition"
    return "text" if isinstance(value, str) else "number"


def _check_numbers(what: str, *values: _Value) -> None:
    """Refuse texts and conditions where numbers are needed."""
    if any(_kind(value) != "number" for value in values):
        raise ValueError(f"{what} needs numbers")
