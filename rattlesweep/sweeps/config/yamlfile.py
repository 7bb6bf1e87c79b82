"""Reads YAML 1.2 into plain Python data, and remembers where every value stands.

Works on the events of ruamel's parser rather than on its objects.  Those would stop at the first
repeated key, follow aliases, obey YAML 1.1 where a file asks for it, and accept ``1_000``.
Scalars follow the core schema of YAML 1.2 (section 10.3.2 of its specification).
"""

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    DocumentStartEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceStartEvent,
)
from ruamel.yaml.reader import ReaderError

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.sweeps.config.places import Key, Problem

# Reading takes 40 us a value or key and 1 us a character: what is larger is refused in seconds.
MAX_BYTES = 250_000
MAX_NODES = 20_000
MAX_DEPTH = 30

_WORDS = {"": None, "~": None} | {
    form: value
    for word, value in (("null", None), ("true", True), ("false", False))
    for form in (word, word.capitalize(), word.upper())
}
_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


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
        Bad values and repeated keys, which `data` leaves out; of a text that is not YAML, the one
        reason why there is no data.
    """

    data: Any = None
    positions: dict[Key, tuple[int, int]] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)


class _NotYaml(Exception):
    """The text cannot be read, for the reason and at the place that are given."""

    def __init__(self, message: str, mark: Any, key: Key = ()) -> None:
        self.problem = Problem(key, message, _position(mark))


def is_number(text: str) -> bool:
    """Whether YAML 1.2 would take `text`, without quotes, for a number."""
    return bool(_INT.fullmatch(text) or _FLOAT.fullmatch(text))


def number_problem(value: int | float, text: str) -> str | None:
    """What is wrong with a number, written as `text`, that no field could take; None if nothing."""
    if isinstance(value, float) and not math.isfinite(value):
        return f"{text} is not a finite number of 64 bits; write one below 1.8e308"
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        return (
            f"the integer {text} does not fit into 64 bits; write a smaller one, or a decimal such "
            "as 1e20 where a number is meant"
        )
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
    if len(raw) > MAX_BYTES:
        raise ConfigError(
            f"{name}: is larger than {MAX_BYTES // 1000} kB; a config is a short YAML file, and "
            "long lists of bodies go into a table"
        )
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        raise ConfigError(
            f"{name}:{line}:{column}: byte 0x{raw[error.start]:02x} is not UTF-8 text; "
            "a config is a YAML file in UTF-8"
        ) from None


def parse(text: str) -> Document:
    """Read one YAML document from `text`; of what is no YAML, the first problem alone."""
    document = Document()
    # The pure parser: the C one follows YAML 1.1.
    events = YAML(typ="safe", pure=True).parse(text)
    try:
        next(events)
        if isinstance(next(events), DocumentStartEvent):
            document.data = _Reader(document, events).value(next(events), ())
            next(events)
            if isinstance(second := next(events), DocumentStartEvent):
                message = "a second YAML document begins; keep one document in the file"
                raise _NotYaml(message, second.start_mark)
        return document
    except _NotYaml as error:
        problem = error.problem
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = Problem((), _syntax_message(error), mark and _position(mark))
    except ReaderError as error:
        before, character = text[: error.position], ord(text[error.position])
        problem = Problem(
            (),
            f"the character U+{character:04X} is not allowed in YAML; remove it",
            (before.count("\n") + 1, len(before) - before.rfind("\n")),
        )
    except Exception as error:
        # On malformed text ruamel also lets ValueError, OverflowError, IndexError ... escape.
        kind = type(error).__name__
        message = f"the text is not valid YAML ({kind} while reading it); check quotes and escapes"
        problem = Problem((), message)
    return Document(problems=[problem])


def _position(mark: Any) -> tuple[int, int]:
    return mark.line + 1, mark.column + 1


def _syntax_message(error: MarkedYAMLError) -> str:
    problem = " ".join(str(error.problem or error.context or "it cannot be read").split())
    if "'\\t'" in problem:
        return "a tab found where YAML requires spaces; indent with spaces"
    problem = problem.replace("'<stream end>'", "the end of the text")
    return f"not valid YAML ({one_line(problem, 120)}); check indentation, brackets and quotes"


@dataclass
class _Reader:
    """Puts what `events` say into `document`."""

    document: Document
    events: Iterator[Any]
    nodes: int = 0

    def value(self, event: Any, key: Key) -> Any:
        """The value that begins with `event`."""
        self.nodes += 1
        if self.nodes > MAX_NODES:
            raise _NotYaml(
                f"more than {MAX_NODES} values up to here; a config is a short YAML file, and long "
                "lists of bodies go into a table",
                event.start_mark,
            )
        if len(key) > MAX_DEPTH:
            # Also for speed: parsing takes time that grows with the square of the depth.
            message = f"more than {MAX_DEPTH} levels are nested; a config has at most 5"
            raise _NotYaml(message, event.start_mark)
        if isinstance(event, AliasEvent):
            return self.problem(
                key, event, "aliases (*name) are not supported; write the value out"
            )
        if event.tag not in (None, "!"):
            self.problem(key, event, "tags (!name) are not supported; remove it")
        elif event.anchor is not None:
            self.problem(key, event, "anchors (&name) are not supported; remove it")
        if isinstance(event, MappingStartEvent):
            return self.mapping(key)
        if isinstance(event, SequenceStartEvent):
            return self.sequence(key)
        return event.value if event.style else self.scalar(event, key)

    def problem(self, key: Key, event: Any, message: str) -> None:
        self.document.problems.append(Problem(key, message, _position(event.start_mark)))

    def sequence(self, key: Key) -> list[Any]:
        data: list[Any] = []
        for item in takewhile(_is_inside, self.events):
            child = (*key, len(data))
            self.document.positions[child] = _position(item.start_mark)
            data.append(self.value(item, child))
        return data

    def mapping(self, key: Key) -> dict[str, Any]:
        data: dict[str, Any] = {}
        for name in takewhile(_is_inside, self.events):
            if not isinstance(name, ScalarEvent) or name.anchor or name.tag not in (None, "!"):
                raise _NotYaml(
                    "a list, mapping or alias found where a key should be; write a name",
                    name.start_mark,
                    key,
                )
            # Keys are names as they are written, also where a value would be a number or null.
            child = (*key, name.value)
            if name.value in data:
                line = self.document.positions[child][0]
                self.problem(
                    child, name, f"the key is repeated (first in line {line}); keep one of the two"
                )
                kept, self.document = self.document, Document()
                self.value(next(self.events), child)
                self.document = kept
                continue
            self.document.positions[child] = _position(name.start_mark)
            data[name.value] = self.value(next(self.events), child)
        return data

    def scalar(self, event: Any, key: Key) -> Any:
        text: str = event.value
        number: int | float
        if text in _WORDS:
            return _WORDS[text]
        if _INT.fullmatch(text):
            # Length first: int() refuses thousands of digits, and is slow on hundreds.
            number = int(text, {"o": 8, "x": 16}.get(text[1:2], 10)) if len(text) < 100 else 2**64
        elif _FLOAT.fullmatch(text):
            number = float(text)
        elif _NOT_FINITE.fullmatch(text):
            number = math.nan
        else:
            return text
        if message := number_problem(number, one_line(text, 24)):
            return self.problem(key, event, message)
        return number


def _is_inside(event: Any) -> bool:
    return not isinstance(event, CollectionEndEvent)
