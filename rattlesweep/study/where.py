"""A condition on runs, as people write it, made an expression that Arrow evaluates.

``type = 'SW' and K_r < 0.005``, ``not (case in (1, 2) or t_r is null)``: columns, numbers, 'words',
``= != < <= > >=``, ``in``, ``is null``, ``and or not``, brackets.  As in SQL a comparison with null
is neither true nor false, and a run is chosen only where the whole is true.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.sweeps.config.nearest import nearest

_TOKEN = re.compile(
    r"""\s*(?:
      (?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.]))
    | (?P<word>'(?:[^']|'')*'|"[^"]*")
    | (?P<name>[A-Za-z_]\w*)
    | (?P<sign><=|>=|==|!=|<>|[=<>(),])
    )""",
    re.VERBOSE,
)
_KEYWORDS = ("and", "or", "not", "in", "is", "null")
_SIGNS = {"==": "=", "<>": "!="}
# Python would run out of stack at some hundreds.
MAX_DEPTH = 50


@dataclass(frozen=True)
class Condition:
    """What runs are to be like.

    Attributes
    ----------
    expression : pyarrow.compute.Expression
        For :meth:`pyarrow.Table.filter` and the like.
    columns : tuple of str
        Columns that it looks at.
    """

    expression: Any
    columns: tuple[str, ...]


def parse_condition(text: str, schema: pa.Schema, option: str = "--where") -> Condition:
    """Read a condition.

    Parameters
    ----------
    text : str
    schema : pyarrow.Schema
        Columns that there are, with their types.
    option : str
        What a complaint begins with.

    Raises
    ------
    ConfigError
        If it cannot be read, or compares what cannot be compared.
    """
    return _Parser(text, schema, option).whole()


@dataclass(frozen=True)
class _Operand:
    """One side of a comparison."""

    expression: Any
    kind: str  # "number" or "word"
    shown: str
    column: bool = False


class _Parser:
    """By recursive descent: or, and, not, comparison."""

    def __init__(self, text: str, schema: pa.Schema, option: str) -> None:
        self._text, self._schema, self._option = text, schema, option
        self._columns: list[str] = []
        self._tokens: list[tuple[str, str]] = []
        self._next = self._depth = 0
        place = 0
        text = text.rstrip()
        while place < len(text):
            found = _TOKEN.match(text, place)
            if found is None:
                raise self._wrong(f"cannot read {one_line(text[place:].strip(), 20)!r}")
            kind = found.lastgroup or ""
            value = found[kind]
            if kind == "name" and value.lower() in _KEYWORDS:
                kind, value = "keyword", value.lower()
            self._tokens.append((kind, _SIGNS.get(value, value)))
            place = found.end()

    def whole(self) -> Condition:
        """Read everything."""
        if not self._tokens:
            raise self._wrong("is empty; type = 'SW' and K_r < 0.005 is an example")
        expression = self._either()
        if self._next < len(self._tokens):
            raise self._wrong(f"and or or is needed before {self._shown()}")
        return Condition(expression, tuple(dict.fromkeys(self._columns)))

    def _wrong(self, what: str) -> ConfigError:
        return ConfigError(f"{self._option} {one_line(self._text.strip(), 200)}: {what}")

    def _shown(self) -> str:
        if self._next >= len(self._tokens):
            return "the end"
        return one_line(self._tokens[self._next][1], 40)

    def _take(self, *values: str) -> str | None:
        """The next sign or keyword, if it is one of these."""
        if self._next < len(self._tokens):
            kind, value = self._tokens[self._next]
            if kind in ("sign", "keyword") and value in values:
                self._next += 1
                return value
        return None

    def _want(self, value: str, why: str) -> None:
        if self._take(value) is None:
            raise self._wrong(f"{value} is needed {why}, not {self._shown()}")

    def _either(self) -> Any:
        found = self._both()
        while self._take("or"):
            found = found | self._both()
        return found

    def _both(self) -> Any:
        found = self._negated()
        while self._take("and"):
            found = found & self._negated()
        return found

    def _negated(self) -> Any:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise self._wrong(f"is more than {MAX_DEPTH} brackets deep")
        try:
            if self._take("not"):
                return ~self._negated()
            if self._take("("):
                found = self._either()
                self._want(")", "to close the bracket")
                return found
            return self._comparison()
        finally:
            self._depth -= 1

    def _comparison(self) -> Any:
        left = self._operand()
        if self._take("is"):
            absent = self._take("not") is None
            self._want("null", "after is")
            return left.expression.is_null() if absent else left.expression.is_valid()
        unlike = self._take("not") is not None
        if self._take("in"):
            found = self._among(left)
            return ~found if unlike else found
        sign = None if unlike else self._take("=", "!=", "<", "<=", ">", ">=")
        if sign is None:
            wanted = "in" if unlike else "=, !=, <, <=, >, >=, in or is"
            raise self._wrong(f"{wanted} is needed after {left.shown}, not {self._shown()}")
        right = self._operand()
        self._alike(left, right)
        if left.kind == "word" and sign not in ("=", "!="):
            raise self._wrong(f"{left.shown} {sign} {right.shown}: words are = or !=, not {sign}")
        a, b = left.expression, right.expression
        return {"=": a.__eq__, "!=": a.__ne__, "<": a.__lt__, "<=": a.__le__,
                ">": a.__gt__, ">=": a.__ge__}[sign](b)  # fmt: skip

    def _among(self, left: _Operand) -> Any:
        self._want("(", "after in")
        found = None
        while True:
            one = self._operand()
            self._alike(left, one)
            same = left.expression == one.expression
            found = same if found is None else found | same
            if self._take(",") is None:
                break
        self._want(")", "to end the list")
        return found

    def _alike(self, left: _Operand, right: _Operand) -> None:
        """Complain of a number compared with a word, and of words that no run has."""
        if left.kind != right.kind:
            pair = [left, right] if left.kind == "number" else [right, left]
            raise self._wrong(
                f"{pair[0].shown} is a number and {pair[1].shown} a word; they cannot be compared"
            )

    def _operand(self) -> _Operand:
        if self._next >= len(self._tokens):
            raise self._wrong("ends where a column, a number or a 'word' is needed")
        kind, value = self._tokens[self._next]
        if kind == "number":
            self._next += 1
            # Whole numbers keep all their digits.
            number = int(value) if re.fullmatch(r"[-+]?\d{1,18}", value) else float(value)
            return _Operand(pc.scalar(number), "number", value)
        if kind == "word":
            self._next += 1
            plain = value[1:-1].replace("''", "'")
            return _Operand(pc.scalar(plain), "word", one_line(value, 40))
        if kind == "name":
            self._next += 1
            return self._column(value)
        raise self._wrong(f"a column, a number or a 'word' is needed, not {self._shown()}")

    def _column(self, name: str) -> _Operand:
        if name not in self._schema.names:
            near = nearest(name, self._schema.names)
            hint = f"did you mean {near}?" if near else f"there are {', '.join(self._schema.names)}"
            raise self._wrong(f"{one_line(name, 40)} is no column; {hint}")
        type_ = self._schema.field(name).type
        if pa.types.is_string(type_):
            kind = "word"
        elif pa.types.is_floating(type_) or pa.types.is_integer(type_):
            kind = "number"
        else:
            raise self._wrong(f"{name} holds several numbers a run; they cannot be compared")
        self._columns.append(name)
        return _Operand(pc.field(name), kind, name, column=True)
