"""Reads YAML 1.2 into plain Python data, and remembers where every value stands.

Works on ruamel's nodes rather than on its objects.  Those would stop at the first repeated key,
follow aliases, obey YAML 1.1 where a file asks for it, and accept ``1_000``.
Scalars follow the core schema of YAML 1.2 (section 10.3.2 of its specification).
"""

import math
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.events import AliasEvent
from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode
from ruamel.yaml.reader import ReaderError

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.sweeps.config.places import Key, Problem

# Reading takes 40 us a value and 1 us a character: what is larger is refused in a second.
MAX_BYTES = 250_000
MAX_NODES = 20_000
MAX_DEPTH = 30

_NULL = re.compile(r"|~|null|Null|NULL")
_TRUE = re.compile(r"true|True|TRUE")
_FALSE = re.compile(r"false|False|FALSE")
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
        Bad values and repeated keys. `data` leaves them out and can be looked at further.
    broken
        Whether the text is not YAML, as the one problem says; there is no data then.
    """

    data: Any = None
    positions: dict[Key, tuple[int, int]] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    broken: bool = False


class _NotYaml(Exception):
    """The text cannot be read, for the reason and at the mark that are given."""

    def __init__(self, message: str, mark: Any = None, key: Key = ()) -> None:
        super().__init__(message)
        self.problem = Problem(key, message, None if mark is None else _position(mark))


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
        # The pure parser: the C one follows YAML 1.1.
        yaml = YAML(typ="safe", pure=True)
        yaml.Composer = _Composer
        if (node := _composed(yaml, text)) is not None:
            document.data = _Reader(document, yaml.composer.refused).value(node, ())
    except _NotYaml as error:
        return Document(problems=[error.problem], broken=True)
    return document


def _position(mark: Any) -> tuple[int, int]:
    return mark.line + 1, mark.column + 1


class _Composer(Composer):
    """Makes nodes of a text: of a bounded number and depth, and none out of aliases."""

    def __init__(self, loader: Any = None) -> None:
        super().__init__(loader)
        self.warn_double_anchors = False
        self.nodes = self.level = 0
        # What is no part of a config, by the identity of the node that has it.
        self.refused: dict[int, str] = {}

    def compose_document(self) -> Any:
        event = self.parser.peek_event()
        if event.version is not None and tuple(event.version) != (1, 2):
            raise _NotYaml(
                "the %YAML line asks for another version; remove it, as configs are YAML 1.2",
                event.start_mark,
            )
        return super().compose_document()

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.parser.peek_event()
        mark = event.start_mark
        self.nodes += 1
        if self.nodes > MAX_NODES:
            raise _NotYaml(
                f"more than {MAX_NODES} keys and values up to here; a config is a short YAML "
                "file, and long lists of bodies go into a table",
                mark,
            )
        if isinstance(event, AliasEvent):
            self.parser.get_event()
            node = ScalarNode(None, "", mark, mark)
            self.refused[id(node)] = "aliases (*name) are not supported; write the value out"
            return node
        if self.level > MAX_DEPTH:
            # Also for speed: the parser takes time that grows with the square of the depth.
            raise _NotYaml(f"more than {MAX_DEPTH} levels are nested; a config has at most 5", mark)
        self.level += 1
        node = super().compose_node(parent, index)
        self.level -= 1
        if event.anchor is not None:
            self.refused[id(node)] = "anchors (&name) are not supported; remove it"
        if event.tag not in (None, "!"):
            self.refused[id(node)] = "tags (!name) are not supported; remove it"
        return node


def _composed(yaml: YAML, text: str) -> Any:
    """The root node of `text`, None if it is empty; whatever goes wrong becomes a `_NotYaml`."""
    try:
        return yaml.compose(text)
    except _NotYaml:
        raise
    except MarkedYAMLError as error:
        raise _NotYaml(_syntax_message(error), error.problem_mark or error.context_mark) from None
    except ReaderError as error:
        before, character = text[: error.position], ord(text[error.position])
        broken = _NotYaml(f"the character U+{character:04X} is not allowed in YAML; remove it")
        place = before.count("\n") + 1, len(before) - before.rfind("\n")
        broken.problem = broken.problem._replace(position=place)
        raise broken from None
    except Exception as error:
        # On malformed text ruamel also lets ValueError, OverflowError, IndexError ... escape.
        raise _NotYaml(
            f"the text is not valid YAML ({type(error).__name__} while reading it); "
            "check its quotes and escapes"
        ) from None


def _syntax_message(error: MarkedYAMLError) -> str:
    problem = " ".join(str(error.problem or error.context or "it cannot be read").split())
    if "'\\t'" in problem:
        return "a tab found where YAML requires spaces; indent with spaces"
    if "another document" in problem:
        return "a second YAML document begins; keep one document in the file"
    problem = problem.replace("'<stream end>'", "the end of the text")
    return f"not valid YAML ({one_line(problem, 120)}); check indentation, brackets and quotes"


@dataclass
class _Reader:
    """Turns nodes into the data of `document`; `refused` has what is wrong with some of them."""

    document: Document
    refused: dict[int, str]

    def value(self, node: Any, key: Key) -> Any:
        if message := self.refused.get(id(node)):
            self.problem(key, node, message)
        if isinstance(node, MappingNode):
            return self.mapping(node, key)
        if isinstance(node, SequenceNode):
            for index, item in enumerate(node.value):
                self.document.positions[*key, index] = _position(item.start_mark)
            return [self.value(item, (*key, index)) for index, item in enumerate(node.value)]
        return node.value if node.style else self.scalar(node, key)

    def problem(self, key: Key, node: Any, message: str) -> None:
        self.document.problems.append(Problem(key, message, _position(node.start_mark)))

    def mapping(self, node: MappingNode, key: Key) -> dict[str, Any]:
        data: dict[str, Any] = {}
        for name, value in node.value:
            if not isinstance(name, ScalarNode) or id(name) in self.refused:
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
                continue
            self.document.positions[child] = _position(name.start_mark)
            data[name.value] = self.value(value, child)
        return data

    def scalar(self, node: ScalarNode, key: Key) -> Any:
        text: str = node.value
        if _NULL.fullmatch(text):
            return None
        if _TRUE.fullmatch(text):
            return True
        if _FALSE.fullmatch(text):
            return False
        number: int | float
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
            return self.problem(key, node, message)
        return number
