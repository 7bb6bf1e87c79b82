"""A condition on runs, as people write it, made an expression that Arrow evaluates.

``type = 'SW' and K_r < 0.005``, ``not (case in (1, 2) or t_r is null)``,
``lyapunov_late * t_end / 2 > 10``: columns, numbers, 'words', ``= != < <= > >=``, ``in``,
``is null``, ``true false``, ``and or not``, ``+ - * / **``, ``abs()``, brackets.  As in SQL a
comparison with null is neither true nor false, and a run is chosen only where the whole is true.

Python's own parser reads it, once SQL's few words are Python's.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.sweeps.config.messages import nearest

_TOKEN = re.compile(
    r"""(?P<word>'(?:[^']|'')*'|"[^"]*") | (?P<sign><>|[<>!=]=|=) | (?P<name>[^\W\d]\w*)
    | (?P<break>[\r\n]) | (?P<other>[^\w\s.<>(),+*/-])""",
    re.VERBOSE,
)
_PYTHON = {"=": "==", "<>": "!=", "null": "None", "true": "True", "false": "False"}
_KEYWORDS = ("and", "or", "not", "in", "is")
_COMPARED: dict[type, Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq, ast.NotEq: operator.ne,
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge,
}  # fmt: skip
_ARITHMETIC: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.Pow: pc.power,
}  # fmt: skip


@dataclass(frozen=True)
class Condition:
    """What runs are to be like."""

    expression: Any  # for :meth:`pyarrow.Table.filter` and the like
    columns: tuple[str, ...]  # that it looks at
    text: str  # as it was written


def parse_condition(text: str, schema: pa.Schema, option: str = "--where") -> Condition:
    """Read a condition on columns; complaints begin with the ``option`` that it was given by."""
    translator, text = _Translator(schema), text.strip()
    shown = one_line(text, 200)
    try:
        if not text:
            raise _Unreadable("is empty; type = 'SW' and K_r < 0.005 is an example")
        expression = translator.condition(_parse(_TOKEN.sub(_python, text)))
    except _Unreadable as error:
        raise ConfigError(f"{option} {shown}: {error}") from None
    except (MemoryError, RecursionError):
        raise ConfigError(f"{option} {shown}: is nested too deep") from None
    return Condition(expression, tuple(dict.fromkeys(translator.columns)), shown)


class _Unreadable(ValueError):
    """What is wrong with a condition."""


def _python(token: re.Match[str]) -> str:
    """A token of SQL as Python writes it."""
    text = token[0]
    match token.lastgroup:
        case "word":
            return repr(text[1:-1].replace("''", "'"))
        case "break":
            return " "
        case "other":
            rest = one_line(token.string[token.start() :], 20)
            raise _Unreadable(f"cannot read {rest!r}")
    if text.lower() in _KEYWORDS:
        return text.lower()
    return _PYTHON.get(text.lower(), text)


def _parse(text: str) -> ast.expr:
    try:
        return ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError) as error:
        # Where something is missing at the end, it is 0.
        place = getattr(error, "offset", 1)
        rest = one_line(text[place - 1 :].strip(), 20) if place else ""
        raise _Unreadable(f"cannot read {rest!r}" if rest else "ends too early") from None


class _Translator(ast.NodeVisitor):
    """Makes Arrow's expressions of Python's."""

    def __init__(self, schema: pa.Schema) -> None:
        self._schema = schema
        self.columns: list[str] = []

    def condition(self, node: ast.expr) -> Any:
        """An expression that is true or false."""
        match node:
            case ast.BoolOp(op, values):
                join = operator.and_ if isinstance(op, ast.And) else operator.or_
                return _joined(join, [self.condition(value) for value in values])
            case ast.UnaryOp(ast.Not(), inner):
                return ~self.condition(inner)
            case ast.Compare(left, signs, others):
                sides = [left, *others]
                pairs = zip(sides, signs, others, strict=False)
                return _joined(operator.and_, [self._compared(*pair) for pair in pairs])
        raise _Unreadable(
            f"{_shown(node)} is no condition; compare it, by =, !=, <, <=, >, >=, in or is null"
        )

    def _compared(self, left: ast.expr, sign: ast.cmpop, right: ast.expr) -> Any:
        match sign:
            case ast.Is() | ast.IsNot():
                if not (isinstance(right, ast.Constant) and right.value is None):
                    raise _Unreadable(f"null is needed after is, not {_shown(right)}")
                value, _ = self._value(left)
                return value.is_null() if isinstance(sign, ast.Is) else value.is_valid()
            case ast.In() | ast.NotIn():
                among = right.elts if isinstance(right, ast.Tuple) else [right]
                if not among:
                    raise _Unreadable("a list after in is empty")
                found = _joined(operator.or_, [self._compared(left, ast.Eq(), e) for e in among])
                return found if isinstance(sign, ast.In) else ~found
        (a, kind), (b, other) = self._value(left), self._value(right)
        if kind != other:
            (kind, one), (other, two) = sorted([(kind, left), (other, right)], key=lambda p: p[0])
            raise _Unreadable(
                f"{_shown(one)} is a {kind} and {_shown(two)} a {other}; they cannot be compared"
            )
        if kind != "number" and not isinstance(sign, ast.Eq | ast.NotEq):
            raise _Unreadable(
                f"{kind}s are = or !=, not < or >, as {_shown(left)} and {_shown(right)} are here"
            )
        return _COMPARED[type(sign)](a, b)

    def _value(self, node: ast.expr) -> tuple[Any, str]:
        """An expression, and whether it is a ``number``, a ``word`` or a ``flag``."""
        match node:
            case ast.Name(name):
                return self._column(name)
            case ast.Constant(str(word)):
                return pc.scalar(word), "word"
            case ast.Constant(bool(flag)):
                return pc.scalar(flag), "flag"
            case ast.Constant(int(number) | float(number)):
                # Whole numbers keep all their digits, if Arrow has as many.
                return pc.scalar(number if abs(number) < 2**63 else float(number)), "number"
            case ast.UnaryOp(ast.USub(), ast.Constant(int(number) | float(number))):
                return self._value(ast.Constant(-number))
            case ast.UnaryOp(ast.USub(), inner):
                return pc.negate(self._number(inner)), "number"
            case ast.UnaryOp(ast.UAdd(), inner):
                return self._number(inner), "number"
            case ast.BinOp(left, op, right) if type(op) in _ARITHMETIC:
                return _ARITHMETIC[type(op)](self._number(left), self._number(right)), "number"
            case ast.Call(ast.Name("abs"), [inner], []):
                return pc.abs(self._number(inner)), "number"
        raise _Unreadable(f"a column, a number or a 'word' is needed, not {_shown(node)}")

    def _number(self, node: ast.expr) -> Any:
        value, kind = self._value(node)
        if kind != "number":
            raise _Unreadable(f"{_shown(node)} is a {kind}; there is no arithmetic with {kind}s")
        # Whole numbers would overflow, and their quotients be cut.
        return value.cast(pa.float64(), safe=False)

    def _column(self, name: str) -> tuple[Any, str]:
        if name not in self._schema.names:
            near = nearest(name, self._schema.names)
            hint = f"did you mean {near}?" if near else f"there are {', '.join(self._schema.names)}"
            raise _Unreadable(f"{one_line(name, 40)} is no column; {hint}")
        type_ = self._schema.field(name).type
        if not (pa.types.is_string(type_) or pa.types.is_primitive(type_)):
            raise _Unreadable(f"{name} holds several numbers a run; they cannot be compared")
        self.columns.append(name)
        kinds = {pa.string(): "word", pa.bool_(): "flag"}
        return pc.field(name), kinds.get(type_, "number")


def _joined(join: Callable[[Any, Any], Any], parts: list[Any]) -> Any:
    """Parts joined in pairs: a long chain would be too deep for Arrow."""
    while len(parts) > 1:
        pairs = zip(parts[::2], parts[1::2], strict=False)
        parts = [join(*pair) for pair in pairs] + parts[len(parts) & ~1 :]
    return parts[0]


def _shown(node: ast.expr) -> str:
    return "null" if ast.unparse(node) == "None" else one_line(ast.unparse(node), 40)
