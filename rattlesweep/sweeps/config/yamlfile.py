"""Reads YAML 1.2 into plain Python data, and remembers where every value stands.

Works on the parser's events rather than on ruamel's round-trip objects. Those would stop at the
first repeated key, follow aliases, obey YAML 1.1 where a file asks for it, and accept ``1_000``.
Scalars follow the core schema of YAML 1.2 (section 10.3.2 of its specification).
"""

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from rattlesweep.errors import ConfigError, one_line

Key = tuple[str | int, ...]
"""Where a value stands in nested data: ``("bodies", "ranges", "theta", 1)``."""

# The parser takes 20 us a value and 1 us a character: what is larger is refused in a second.
MAX_BYTES = 250_000
MAX_EVENTS = 20_000
MAX_DEPTH = 30

_NULL = re.compile(r"|~|null|Null|NULL")
_TRUE = re.compile(r"true|True|TRUE")
_FALSE = re.compile(r"false|False|FALSE")
_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


class Problem(NamedTuple):
    """One thing wrong with the value at `key`, which stands at `position` where that is known."""

    key: Key
    message: str
    position: tuple[int, int] | None = None


@dataclass
class Document:
    """What a YAML text holds.

    Attributes
    ----------
    data
        Plain data: dict, list, str, int, float, bool, None. None also stands in for a bad value.
    positions
        Line and column, from 1, of each key of a mapping and each item of a list.
    problems
        Bad values and repeated keys. `data` leaves them out and can be looked at further.
    broken
        Whether reading stopped at a problem, the last one; what comes behind it is not known.
    """

    data: Any = None
    positions: dict[Key, tuple[int, int]] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    broken: bool = False


class _Stop(Exception):
    """Reading cannot go on behind this problem."""

    def __init__(self, message: str, mark: Any = None, key: Key = ()) -> None:
        super().__init__(message)
        self.problem = Problem(key, message, _position(mark))


def is_number(text: str) -> bool:
    """Whether YAML 1.2 would take `text`, without quotes, for a number."""
    return bool(_INT.fullmatch(text) or _FLOAT.fullmatch(text))


def number_problem(value: int | float) -> str | None:
    """What is wrong with a number that no field could take; None if all is well."""
    if isinstance(value, float) and not math.isfinite(value):
        return f"{value} is not a finite number; write a finite one"
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        return "the integer does not fit into 64 bits; write a smaller one"
    return None


def read_text(path: str | os.PathLike[str]) -> str:
    """The text of a file, or a ConfigError that says why there is none."""
    name = one_line(str(path), 200)
    try:
        with Path(path).open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise ConfigError(f"{name}: there is no such file; give the path of a config") from None
    except IsADirectoryError:
        raise ConfigError(f"{name}: is a directory; give the path of a config in it") from None
    except (OSError, ValueError) as error:
        reason = one_line(getattr(error, "strerror", None) or str(error))
        raise ConfigError(f"{name}: cannot be read ({reason}); give a readable file") from None
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        # A file cut at the limit may end inside a character; its size is then the better message.
        if len(raw) <= MAX_BYTES:
            line = raw.count(b"\n", 0, error.start) + 1
            column = error.start - raw.rfind(b"\n", 0, error.start)
            raise ConfigError(
                f"{name}:{line}:{column}: byte 0x{raw[error.start]:02x} is not UTF-8 text; "
                "a config is a YAML file in UTF-8"
            ) from None
    if len(raw) > MAX_BYTES:
        raise ConfigError(
            f"{name}: is larger than {MAX_BYTES // 1000} kB; a config is a short YAML file, and "
            "long lists of bodies go into a table"
        )
    return text


def parse(text: str) -> Document:
    """Read one YAML document from `text`.

    A text that is not YAML yields no data and is marked as broken.
    """
    document = Document()
    try:
        _Builder(text, document).build()
    except _Stop as stop:
        document.data = None
        document.broken = True
        document.problems.append(stop.problem)
    return document


def _position(mark: Any) -> tuple[int, int] | None:
    return None if mark is None else (mark.line + 1, mark.column + 1)


def _events(text: str) -> Iterator[Any]:
    """Parser events of `text`; whatever goes wrong in the parser becomes a `_Stop`."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError
    from ruamel.yaml.reader import ReaderError

    try:
        # The pure parser: the C one follows YAML 1.1.
        for count, event in enumerate(YAML(typ="safe", pure=True).parse(text)):
            if count == MAX_EVENTS:
                raise _Stop(
                    f"more than {MAX_EVENTS} keys and values up to here; a config is a short YAML "
                    "file, and long lists of bodies go into a table",
                    event.start_mark,
                )
            yield event
    except MarkedYAMLError as error:
        raise _Stop(_syntax_message(error), error.problem_mark or error.context_mark) from None
    except ReaderError as error:
        before = text[: error.position]
        stop = _Stop(
            f"the character U+{ord(text[error.position]):04X} is not allowed in YAML; remove it"
        )
        column = len(before) - before.rfind("\n")
        stop.problem = stop.problem._replace(position=(before.count("\n") + 1, column))
        raise stop from None
    except _Stop:
        raise
    except Exception as error:
        # On malformed text ruamel also lets ValueError, OverflowError, IndexError ... escape.
        raise _Stop(
            f"the text is not valid YAML ({type(error).__name__} while reading it); "
            "check its quotes and escapes"
        ) from None


def _too_deep(event: Any) -> _Stop:
    # Also for speed: the parser takes time that grows with the square of the depth.
    message = f"more than {MAX_DEPTH} levels are nested; a config has at most 5"
    return _Stop(message, event.start_mark)


def _syntax_message(error: Any) -> str:
    problem = " ".join(str(error.problem or error.context or "it cannot be read").split())
    if "'\\t'" in problem:
        return "a tab found where YAML requires spaces; indent with spaces"
    if "another document" in problem:
        return "a second YAML document begins; keep one document in the file"
    if "undefined alias" in problem:
        return "aliases (*name) are not supported; write the value out"
    problem = problem.replace("'<stream end>'", "the end of the text")
    return f"not valid YAML ({one_line(problem, 120)}); check indentation, brackets and quotes"


class _Builder:
    """Turns parser events into a `Document`."""

    def __init__(self, text: str, document: Document) -> None:
        self.events = _events(text)
        self.document = document

    def build(self) -> None:
        found = False
        for event in self.events:
            kind = type(event).__name__
            if kind == "DocumentStartEvent":
                if found:
                    raise _Stop(
                        "a second YAML document begins; keep one document in the file",
                        event.start_mark,
                    )
                if event.version is not None and tuple(event.version) != (1, 2):
                    raise _Stop(
                        "the %YAML line asks for another version; remove it, as configs are "
                        "YAML 1.2",
                        event.start_mark,
                    )
                found = True
                self.document.data = self._node(next(self.events), ())

    def _report(self, key: Key, event: Any, message: str) -> None:
        self.document.problems.append(Problem(key, message, _position(event.start_mark)))

    def _place(self, key: Key, event: Any) -> None:
        self.document.positions[key] = (event.start_mark.line + 1, event.start_mark.column + 1)

    def _node(self, event: Any, key: Key) -> Any:
        kind = type(event).__name__
        if kind == "AliasEvent":
            self._report(key, event, "aliases (*name) are not supported; write the value out")
            return None
        if len(key) > MAX_DEPTH:
            raise _too_deep(event)
        if event.anchor is not None:
            self._report(key, event, "anchors (&name) are not supported; remove it")
        if event.tag not in (None, "!"):
            self._report(key, event, "tags (!name) are not supported; remove it")
        if kind == "MappingStartEvent":
            return self._mapping(key)
        if kind == "SequenceStartEvent":
            return self._list(key)
        return self._scalar(event, key)

    def _mapping(self, key: Key) -> dict[str, Any]:
        data: dict[str, Any] = {}
        while type(event := next(self.events)).__name__ != "MappingEndEvent":
            if type(event).__name__ != "ScalarEvent":
                raise _Stop(
                    "a list, mapping or alias found where a key should be; write a name",
                    event.start_mark,
                    key,
                )
            # Keys are names as they are written, also where a value would be a number or null.
            name = event.value
            child = (*key, name)
            if name in data:
                line = self.document.positions[child][0]
                self._report(
                    child, event, f"the key is repeated (first in line {line}); keep one of the two"
                )
                self._skip(next(self.events))
                continue
            self.document.positions[child] = (
                event.start_mark.line + 1,
                event.start_mark.column + 1,
            )
            data[name] = None
            data[name] = self._node(next(self.events), child)
        return data

    def _skip(self, event: Any) -> None:
        depth = 0
        while True:
            kind = type(event).__name__
            depth += kind in ("MappingStartEvent", "SequenceStartEvent")
            depth -= kind in ("MappingEndEvent", "SequenceEndEvent")
            if depth == 0:
                return
            if depth > MAX_DEPTH:
                raise _too_deep(event)
            event = next(self.events)

    def _list(self, key: Key) -> list[Any]:
        data: list[Any] = []
        while type(event := next(self.events)).__name__ != "SequenceEndEvent":
            child = (*key, len(data))
            self.document.positions[child] = (
                event.start_mark.line + 1,
                event.start_mark.column + 1,
            )
            data.append(self._node(event, child))
        return data

    def _scalar(self, event: Any, key: Key) -> Any:
        text: str = event.value
        if event.style is not None:
            return text
        if _NULL.fullmatch(text):
            return None
        if _TRUE.fullmatch(text):
            return True
        if _FALSE.fullmatch(text):
            return False
        if _NOT_FINITE.fullmatch(text):
            self._report(key, event, f"{text} is not a finite number; write a finite one")
            return None
        if _INT.fullmatch(text):
            # Length first: int() refuses thousands of digits, and is slow on hundreds.
            value = int(text, {"o": 8, "x": 16}.get(text[1:2], 10)) if len(text) < 100 else 2**64
            if number_problem(value):
                self._report(
                    key,
                    event,
                    f"the integer {one_line(text, 24)} does not fit into 64 bits; "
                    "write a smaller one, or a decimal such as 1e20 where a number is meant",
                )
                return None
            return value
        if _FLOAT.fullmatch(text):
            number = float(text)
            if math.isinf(number):
                self._report(
                    key,
                    event,
                    f"{one_line(text, 24)} is too large for a number; write one below 1.8e308",
                )
                return None
            return number
        return text
