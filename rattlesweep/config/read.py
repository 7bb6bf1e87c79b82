"""Configs: read them, check them, compare them."""

import hashlib
import json
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from rattlesweep.arrays import refuse_foreign_units, unmasked
from rattlesweep.config import Key, KeyPlaces, spell
from rattlesweep.config.body_sources import SdSource, TableSource
from rattlesweep.config.clashes import clashes
from rattlesweep.config.keys import Base
from rattlesweep.config.problems import key_and_sentence
from rattlesweep.config.schema import Config
from rattlesweep.system.files import as_path, read_regular, reason
from rattlesweep.words.errors import ConfigError, describe, one_line
from rattlesweep.words.units import is_measured, quantity_text

MAX_BYTES = 1_000_000  # of a file
MAX_VALUES = 20_000  # a few aliases can expand to far more values than a file has
LINE_ENDS = "\n\r\x85\u2028\u2029"
TOO_MANY = f"more than {MAX_VALUES} values; use linspace, logspace or a table"
MOST_BITS = 1000  # of a whole number, so that it has a floating-point value
MAX_TOLD = 20  # problems that are listed


def _whole(text: str) -> int:
    number = int(text, 0)
    if number.bit_length() > MOST_BITS:
        raise ValueError("larger than any number")
    return number


NULLS: dict[str, None] = dict.fromkeys(("", "~", "null"))
BOOLS = {"true": True, "false": False}
# Converters by the YAML type; values of other types, such as dates, stay text.
SCALARS: dict[str, Callable[[str], object]] = {
    "null": lambda text: NULLS[text.lower()],
    # By %YAML 1.1 or a tag, yes and on would be true, too; they stay texts.
    "bool": lambda text: BOOLS[text.lower()],
    "int": _whole,
    "float": float,
}

HALF_CHARACTER = re.compile("[\ud800-\udfff]")  # of a pair of surrogates

_T = TypeVar("_T", bound=Base)
_Problem = tuple[int | str | None, Key, str]  # line or --set text, key, message


def load_config(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Config:
    """Read a config file (YAML 1.2); a config without a name is named after its file.

    `overrides` are texts such as ``bodies.samples=10``; of several for one key the last
    wins.  A ConfigError lists all mistakes, one a line: ``file:line: key: message``.
    """
    data, places, problems = read_file(path)
    if "body" in data and "bodies" not in data:
        file = one_line(os.fspath(path), 200)
        raise ConfigError(
            f"{file}: is a stone file, which fit, film, verdict, show and contact "
            "take; the config of a sweep has bodies and spin (rattlesweep init writes "
            "one)"
        )
    name = [c if c.isprintable() and c != "\\" else "_" for c in Path(path).stem]
    for text in overrides:
        places = _override(data, places, text)
    if data.get("name") is None:
        data["name"] = "".join(name)
    return checked(Config, data, places, problems)


def overridden(data: dict[str, object], texts: Sequence[str]) -> dict[str, object]:
    """Return a config with ``KEY=VALUE`` put into it; `data` is changed."""
    for text in texts:
        _override(data, KeyPlaces(), text)
    return data


def read_file(
    path: str | os.PathLike[str],
) -> tuple[dict[str, object], KeyPlaces, list[_Problem]]:
    """Return the mapping in a YAML file, the places of its keys, and repeated keys."""
    file = one_line(os.fspath(path), 200)
    place = as_path(path, "config")
    try:
        text = read_regular(place, MAX_BYTES).decode("utf-8-sig")
    except (OSError, ValueError) as error:
        why = one_line(reason(error), 200)
        raise ConfigError(
            f"{file}: {why}; give the path of a config in UTF-8"
        ) from None
    data, lines, problems = read_yaml(text)
    if not isinstance(data, dict):
        if not problems:
            message = f"the file holds {describe(data)}; write key: value lines"
            problems = [(1, (), message)]
        line, _, message = problems[0]
        raise ConfigError(f"{file}:{line}: {message}")
    return data, KeyPlaces(file, {(): 1, **lines}), problems


def parse_config(
    data: Mapping[str, object],
    overrides: Sequence[str] = (),
    bodies: TableSource | None = None,
) -> Config:
    """Check a config given as Python data, which may have tuples and NumPy's types.

    `bodies` is the section of bodies that are in memory.
    """
    try:
        text = json.dumps(_plain({**data}, ()), default=str)
    except (TypeError, ValueError, RecursionError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(
            f"the config is not plain data ({error}); give a dict"
        ) from None
    plain = json.loads(text)
    if HALF_CHARACTER.search(json.dumps(plain, ensure_ascii=False)):
        raise ConfigError("a text has half of a character; write all of it")
    places = KeyPlaces()
    for override in overrides:
        places = _override(plain, places, override)
    if bodies is not None:
        plain["bodies"] = bodies
    return checked(Config, plain, places, [])


def _plain(value: Any, key: Key) -> Any:
    """Return data of a config without NumPy's arrays and without quantities of Pint."""
    where = spell(key)
    if isinstance(value, Mapping):
        return {name: _plain(item, (*key, str(name))) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, (*key, place)) for place, item in enumerate(value)]
    if is_measured(value):
        try:
            return quantity_text(value)
        except ValueError as error:
            raise ConfigError(f"{where}: {error}") from None
    if hasattr(value, "tolist"):
        refuse_foreign_units(where, value)
        return unmasked(where, value).tolist()
    return value


def config_json_schema() -> dict[str, object]:
    """Return the JSON Schema (draft 2020-12) of a config."""
    schema = Config.model_json_schema()
    del schema["properties"]["bodies"]["discriminator"]  # a keyword of OpenAPI
    draft = "https://json-schema.org/draft/2020-12/schema"
    return schema | {"$schema": draft, "title": "rattlesweep config"}


def resolved(config: Config) -> dict[str, Any]:
    """Return the config as JSON data with all defaults filled in."""
    return config.model_dump(mode="json", exclude_none=True) | {
        "output": config.directory
    }


def fixed_part(config: Config) -> dict[str, Any]:
    """Return the part of a config that, with its key, determines a run's results."""
    thresholds = {"ss_growth", "sw_departure"}
    if not config.dissipation:
        # Otherwise it decides which zeros of the spin are reversals.
        thresholds.add("dead_energy")
    free: dict[str, bool | set[str] | dict[str, bool | set[str]]] = {
        "name": True,
        "output": True,
        "stop": True,
        "dissipation": True,
        "base": True,
        "spin": {"n_i", "omega_xy0"},
        "classify": thresholds,
        # A run that ends within max_steps does not depend on it.
        "integrator": {"max_steps"},
        # A table is identified by its content, not by its path.
        "bodies": {
            "samples": True,
            "refine": True,
            "path": True,
            "target": {"K_p", "K_r"},
        },
    }
    fixed = config.model_dump(mode="json", exclude_none=True, exclude=free)
    if isinstance(config.bodies, SdSource) and config.bodies.target is not None:
        fixed["bodies"]["target"]["coefficient"] = config.bodies.target.name
    laws = [config.acting.law]
    if config.dissipation.slides:
        laws.append("sliding")
    fixed["dissipation"] = "_".join(laws)
    return fixed


def physics_hash(config: Config) -> str:
    """Return the SHA-256, in hex, of the :func:`fixed_part` of a config."""
    text = json.dumps(
        fixed_part(config), sort_keys=True, separators=(",", ":"), allow_nan=False
    )
    return hashlib.sha256(text.encode()).hexdigest()


def differences(
    a: Mapping[str, object], b: Mapping[str, object], *, within: str = ""
) -> list[str]:
    """Return a line for each dotted key in which two configs (plain data) differ."""
    lines = []
    for key in {**a, **b}:
        left = a.get(key)
        right = b.get(key)
        if isinstance(left, dict) and isinstance(right, dict):
            lines += differences(left, right, within=f"{within}{key}.")
        elif left != right:
            lines.append(f"{within}{key}: {_shown(left)} against {_shown(right)}")
    return lines


def _shown(value: object) -> str:
    """Return a value as JSON; None, for a key that is not set, in words."""
    if value is None:
        return "not set"
    return json.dumps(value)


def read_yaml(text: str) -> tuple[object, dict[Key, int], list[_Problem]]:
    """Return the data of a YAML text, the line of each key and item, and problems."""
    # Each value but the first follows a comma or the end of a line.  The parser reads
    # 5,000 values in a second, so they are counted before.
    lines = sum(map(text.count, LINE_ENDS)) - text.count("\r\n")
    if max(text.count(","), lines) > MAX_VALUES:
        return None, {}, [(1, (), TOO_MANY)]
    reader = _Reader()
    try:
        # The parser written in C follows YAML 1.1.
        root = YAML(typ="safe", pure=True).compose(text)
        if root is None:
            return None, {}, []
        return reader.read(root, ()), reader.lines, reader.problems
    except Exception as error:
        # Malformed text raises ValueError, RecursionError, IndexError and others.
        mark = getattr(error, "problem_mark", None)
        mark = mark or getattr(error, "context_mark", None)
        line = 1 if mark is None else mark.line + 1
        problem = str(getattr(error, "problem", None) or error or type(error).__name__)
        message = (
            f"cannot be read as YAML ({one_line(problem, 200)}); check brackets, "
            "quotes and indents"
        )
        return None, {}, [(line, (), message)]


class _Reader:
    """Conversion of YAML nodes to data, with the lines of keys and the repeated ones.

    The conversion of ruamel.yaml stops at the first repeated key and loses the lines.
    """

    def __init__(self) -> None:
        self.lines: dict[Key, int] = {}
        self.problems: list[_Problem] = []

    def read(self, node: Node, key: Key) -> object:
        """Return the data of a node at a key."""
        if len(self.lines) > MAX_VALUES:  # by aliases
            raise ValueError(f"more than {MAX_VALUES} values")
        if isinstance(node, SequenceNode):
            return self._read_list(node, key)
        if isinstance(node, MappingNode):
            return self._read_mapping(node, key)
        kind = str(node.tag).rpartition(":")[2]
        text = self._text_of(node, key)
        with suppress(ValueError, KeyError):
            return SCALARS.get(kind, str)(text)
        return text

    def _text_of(self, node: Node, key: Key) -> str:
        """Return the text of a node; JSON has large characters as two halves."""
        text: str = node.value
        try:
            return text.encode("utf-16", "surrogatepass").decode("utf-16")
        except UnicodeDecodeError:
            line = node.start_mark.line + 1
            message = "the text has half of a character; write all of it"
            self.problems.append((line, key, message))
            return text.encode("ascii", "backslashreplace").decode()

    def _read_list(self, node: SequenceNode, key: Key) -> list[object]:
        for place, item in enumerate(node.value):
            self.lines[(*key, place)] = item.start_mark.line + 1
        return [self.read(item, (*key, place)) for place, item in enumerate(node.value)]

    def _read_mapping(self, node: MappingNode, key: Key) -> dict[str, object]:
        data: dict[str, object] = {}
        for name, value in node.value:
            word = self._text_of(name, key) if isinstance(name, ScalarNode) else "?"
            line = name.start_mark.line + 1
            child = (*key, word)
            if word == "<<":
                message = "YAML 1.2 has no merge keys; write the keys themselves"
                self.problems.append((line, child, message))
                merged = self.read(value, child)
                # They count below, so that none of them is called missing.
                if isinstance(merged, dict):
                    data = merged | data
            elif word in data:
                message = (
                    f"the key is repeated (first in line {self.lines[child]}); keep one"
                )
                self.problems.append((line, child, message))
            else:
                self.lines[child] = line
                data[word] = self.read(value, child)
        return data


def checked(
    model: type[_T], data: object, places: KeyPlaces, problems: list[_Problem]
) -> _T:
    """Return data as a model, or raise a ConfigError with all of its problems."""
    try:
        config = model.model_validate(data)
    except ValidationError as error:
        wrong = [key_and_sentence(each, model, data) for each in error.errors()]
    else:
        wrong = []
        if isinstance(config, Config):
            config._places = places
            wrong = [
                (tuple(name.split(".")), message) for name, message in clashes(config)
            ]
    problems = problems + [(places.origin(key), key, text) for key, text in wrong]
    if not problems:
        return config

    def place(problem: _Problem) -> float:
        # In the order of the file, followed by those of --set.
        origin = problem[0]
        return origin if isinstance(origin, int) else math.inf

    lines = []
    for origin, key, text in sorted(problems, key=place):
        line = places.line(key, text, origin)
        if line not in lines:
            lines.append(line)
    if len(lines) > MAX_TOLD:
        lines = [*lines[:MAX_TOLD], f"and {len(lines) - MAX_TOLD} more"]
    raise ConfigError(lines)


def _override(data: dict[str, object], places: KeyPlaces, text: str) -> KeyPlaces:
    """Put one ``KEY=VALUE`` into `data`; return the places with its key."""
    origin = f"--set {one_line(text, 100)}"
    name, equals, value = text.partition("=")
    key = tuple(name.strip().split("."))
    if not equals or not all(key):
        raise ConfigError(f"{origin}: is not KEY=VALUE, such as bodies.samples=10")
    parsed, _, problems = read_yaml(value)
    if problems:
        raise ConfigError(f"{origin}: {problems[0][2]}")
    if parsed is None and "null" not in value.lower() and "~" not in value:
        # As of a shell variable that is not set.
        raise ConfigError(
            f"{origin}: has no value; give one, or null for the default of {name}"
        )
    section = data
    for part in key[:-1]:
        inner = section.get(part)
        if inner is None:
            inner = section[part] = {}
        if not isinstance(inner, dict):
            raise ConfigError(f"{origin}: {part} is not a mapping; set all of it")
        section = inner
    section[key[-1]] = parsed
    # The lines of what is replaced are no longer its place.
    origins = {
        place: line
        for place, line in places.origins.items()
        if place[: len(key)] != key
    }
    return KeyPlaces(places.file, origins | {key: origin})
