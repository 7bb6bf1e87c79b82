"""Configs: read them, check them, compare them."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from numbers import Integral, Real
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.sweeps.config.messages import (
    Key,
    Places,
    describe,
    dotted,
    nearest,
    not_one_of,
    quoted,
)
from rattlesweep.sweeps.config.schema import (
    SOURCES,
    Clashes,
    Config,
    Dissipation,
    as_number,
    clashes,
)

# Larger files take seconds to parse; aliases may stand for far more values than a file has.
MAX_BYTES, MAX_VALUES = 250_000, 20_000
# Problems told in full; the rest is counted.
MAX_TOLD = 20

Problem = tuple[int | str | None, Key, str]
"""Line or ``--set`` text, key, and sentence."""


def load_config(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Config:
    """Read a config file (YAML 1.2); without a name, it is named after the file.

    `overrides` are ``KEY=VALUE`` texts with dotted keys and YAML values, such as
    ``bodies.samples=10``; they replace values of the file, and later ones earlier ones.
    A ConfigError has everything that is wrong, one line each: ``file:line: key: sentence``.
    """
    file = one_line(os.fspath(path), 200)
    data, lines, problems = read_yaml(_read_text(path, file))
    if not isinstance(data, dict):
        line, _, sentence = problems[0] if problems else (1, (), "")
        empty = data is None and "the file is empty; it needs at least bodies and spin"
        sentence = sentence or empty or f"{describe(data)} is found; write key: value lines"
        raise ConfigError(f"{file}:{line}: {sentence}")
    stem = "".join(c if c.isprintable() and c != "\\" else "_" for c in Path(path).stem)
    return _check(data, overrides, file, {(): 1, **lines}, problems, stem)


def parse_config(data: Mapping[str, Any]) -> Config:
    """Check a config given as Python data.

    Tuples count as lists, and NumPy's numbers as Python's. A ConfigError has everything that is
    wrong, one line each: ``key: sentence``.
    """
    return override_config(data, ())


def override_config(data: Mapping[str, Any], overrides: Sequence[str]) -> Config:
    """Check a config given as Python data, with some keys replaced by ``KEY=VALUE`` texts."""
    plain = _plain(data)
    if not isinstance(plain, dict):
        raise ConfigError(f"{describe(plain)} is given for a config; give a dict")
    return _check(plain, overrides, None, {}, [])


def config_json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a config."""
    schema = Config.model_json_schema()
    # This keyword belongs to OpenAPI and not to JSON Schema.
    del schema["properties"]["bodies"]["discriminator"]
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "rattlesweep config"
    for model in (schema, *schema["$defs"].values()):
        for key in model["properties"].values():
            key["description"] = " ".join(key["description"].split())
    return schema


def resolved(config: Config) -> dict[str, Any]:
    """Return the config as plain data that JSON can hold, with all defaults filled in."""
    return config.model_dump(mode="json", exclude_none=True) | {"output": config.directory}


def fixed_part(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a resolved config that determines the numbers of a run with a given key.

    The lists of cases, the number of samples and what decides which runs there are, are left out,
    since a sweep may grow in them; so are the limit of steps, which runs that end do not notice,
    and the thresholds between types. Of the dissipation its kind stays, which chooses the kernel,
    and with it `dead_energy`, which decides which zeros of the spin are reversals.
    """
    part = _without(data, "name", "output", "stop")
    # A table is known by what it holds, wherever it lies.
    part["bodies"] = _without(data["bodies"], "samples", "refine", "path")
    if target := part["bodies"].get("target"):
        name = "K_p" if "K_p" in target else "K_r"
        part["bodies"]["target"] = {"coefficient": name, **_without(target, name)}
    if "spin" in data:
        part["spin"] = _without(data["spin"], "n_i", "omega_xy0")
    part["integrator"] = _without(data["integrator"], "max_steps")
    part["classify"] = {"early": data["classify"]["early"]}
    part["dissipation"] = {"kind": Dissipation.model_validate(data["dissipation"]).kind}
    if part["dissipation"]["kind"]:
        part["classify"]["dead_energy"] = data["classify"]["dead_energy"]
    return part


def physics_hash(config: Config) -> str:
    """Return the SHA-256, in hex, of the :func:`fixed_part` of a config."""
    part = fixed_part(resolved(config))
    text = json.dumps(part, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def differences(a: dict[str, Any], b: dict[str, Any]) -> list[str]:
    """Return dotted keys in which two resolved configs differ, each with both values."""
    left, right = _flat(a), _flat(b)
    return [
        f"{key}: {left.get(key, 'not set')} against {right.get(key, 'not set')}"
        for key in {**left, **right}
        if left.get(key) != right.get(key)
    ]


def _without(data: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {key: value for key, value in data.items() if key not in names}


def _flat(data: Any, prefix: str = "") -> dict[str, str]:
    if not isinstance(data, dict) or (not data and prefix):
        return {prefix: json.dumps(data)}
    flat: dict[str, str] = {}
    for key, value in data.items():
        flat |= _flat(value, f"{prefix}.{key}" if prefix else str(key))
    return flat


# -- files and Python data -------------------------------------------------------------------------


def _read_text(path: str | os.PathLike[str], file: str) -> str:
    try:
        raw = Path(path).read_bytes()
    except (OSError, ValueError) as error:
        reason = one_line(getattr(error, "strerror", None) or str(error))
        if isinstance(error, FileNotFoundError):
            reason = "there is no such file"
        raise ConfigError(f"{file}: {reason}; give the path of a config") from None
    if len(raw) > MAX_BYTES:
        size = f"{MAX_BYTES // 1000} kB"
        raise ConfigError(f"{file}: is larger than {size}; put long lists of bodies into a table")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{file}:{line}: is not UTF-8 text; save the file as UTF-8") from None


def read_yaml(text: str) -> tuple[Any, dict[Key, int], list[Problem]]:
    """Return the data of a YAML text, the line of each key and list item, and its problems.

    The nodes are converted here, since ruamel.yaml stops at the first repeated key.
    """
    lines: dict[Key, int] = {}
    problems: list[Problem] = []
    count = 0

    def convert(node: Node, key: Key) -> Any:
        nonlocal count
        count += 1
        if count > MAX_VALUES:
            raise ValueError(f"more than {MAX_VALUES} values")
        if isinstance(node, SequenceNode):
            for index, item in enumerate(node.value):
                lines[(*key, index)] = item.start_mark.line + 1
            return [convert(item, (*key, index)) for index, item in enumerate(node.value)]
        if not isinstance(node, MappingNode):
            return _scalar(str(node.tag).rpartition(":")[2], node.value)
        data: dict[str, Any] = {}
        for name, value in node.value:
            word = name.value if isinstance(name, ScalarNode) else "?"
            line, child = name.start_mark.line + 1, (*key, word)
            if word in data:
                first = f"first in line {lines[child]}"
                problems.append((line, child, f"the key is repeated ({first}); keep one"))
            else:
                lines[child] = line
                data[word] = convert(value, child)
        return data

    try:
        # The pure parser: the C one follows YAML 1.1.
        root = YAML(typ="safe", pure=True).compose(text)
        return None if root is None else convert(root, ()), lines, problems
    except Exception as error:  # on malformed text also ValueError, RecursionError, IndexError ...
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        line = mark.line if mark else text.count("\n", 0, getattr(error, "position", 0))
        words = getattr(error, "problem", None) or getattr(error, "context", None)
        words = str(words or error or type(error).__name__).partition("\n")[0]
        message = f"cannot be read as YAML ({words}); check indentation, brackets and quotes"
        return None, {}, [(line + 1, (), message)]


def _scalar(kind: str, text: str) -> Any:
    """Return the value of a scalar; what YAML knows beside words and numbers stays text."""
    if kind == "null":
        return None
    if kind == "bool":
        return text.lower() == "true"
    if kind == "int" and text.lstrip("+-")[:2] in ("0o", "0x", "0b"):
        return int(text.replace("_", ""), 0)
    if kind == "float" and text.lower().lstrip("+-") in (".inf", ".nan"):
        return float(text.replace(".", ""))
    return as_number(text) if kind in ("int", "float") else text


def _plain(value: Any) -> Any:
    """Return Python data as a config file would give it."""
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple) or type(value).__name__ == "ndarray":
        return [_plain(item) for item in value]
    # NumPy's numbers are registered as these.
    if isinstance(value, bool) or not isinstance(value, Real):
        return value
    return int(value) if isinstance(value, Integral) else float(value)


# -- checking --------------------------------------------------------------------------------------


def _check(
    data: dict[str, Any],
    overrides: Sequence[str],
    file: str | None,
    origins: dict[Key, int | str],
    found: list[Problem],
    name: str | None = None,
) -> Config:
    """Return the config, or raise a ConfigError with everything that is wrong."""
    places = Places(file, origins)
    refused = [line for text in overrides for line in _override(data, origins, text)]
    if name is not None:
        data.setdefault("name", name)
    sections, wrong = data, set[str | int]()
    while True:
        try:
            config = Config.model_validate(sections)
            break
        except ValidationError as error:
            # Once more without the sections that are wrong.
            for one in error.errors(include_url=False):
                wrong.add(one["loc"][0])
                found += [(places.origin(key), key, text) for key, text in _sentences(one, data)]
            right = {key: value for key, value in data.items() if key not in wrong}
            sections = {"bodies": {"source": "sd"}} | right
    known = {name: getattr(config, name) for name in Config.model_fields if name not in wrong}
    found += [(places.origin((name,)), (name,), text) for name, text in clashes(known)]
    if not found and not refused:
        config._places = places
        return config
    # In the order of the file; those of settings come last.
    found.sort(key=lambda one: one[0] if isinstance(one[0], int) else bool(one[0]) * MAX_BYTES)
    told = [places.line(key, text, origin) for origin, key, text in found]
    lines = list(dict.fromkeys([*told, *refused]))
    if (more := len(lines) - MAX_TOLD) > 0:
        head = f"{file}: " if file else ""
        lines = [*lines[:MAX_TOLD], f"{head}and {more} more; fix these first"]
    raise ConfigError(lines)


def _override(data: dict[str, Any], origins: dict[Key, int | str], text: str) -> list[str]:
    """Put one ``KEY=VALUE`` into `data`; return what is wrong with it."""
    origin = f"--set {one_line(text, 100)}"
    name, equals, value = text.partition("=")
    key: Key = tuple(name.strip().split("."))
    if not equals or not all(key):
        return [f"{origin}: is not KEY=VALUE; write it as in bodies.samples=10"]
    parsed, _, problems = read_yaml(value)
    if problems:
        return [f"{origin}: {dotted(key)}: {problems[0][2]}"]
    here = data
    for depth, part in enumerate(key[:-1], start=1):
        if here.get(str(part)) is None:
            here[str(part)] = {}
            origins[key[:depth]] = origin
        here = here[str(part)]
        if not isinstance(here, dict):
            return [f"{origin}: {dotted(key[:depth])} is not a mapping; set it as a whole"]
    here[str(key[-1])] = parsed
    for old in [old for old in origins if old[: len(key)] == key]:
        del origins[old]
    origins[key] = origin
    return []


_WANTED = {
    "float": "a number", "bool": "true or false", "int": "a whole number", "string": "text",
    "list": "a list", "dict": "a mapping", "model": "a mapping",
}  # fmt: skip
_LIMITS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}


def _sentences(error: Any, data: Any) -> Iterator[tuple[Key, str]]:
    """Yield the keys and sentences of one of pydantic's errors."""
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    key, names = _walk(error["loc"], data)
    if kind == "value_error" and isinstance(context["error"], Clashes):
        for name, sentence in context["error"].found:
            yield ((*key, name) if name else key), sentence
    elif kind == "value_error":
        yield key, str(context["error"])
    elif kind == "extra_forbidden":
        near = nearest(str(key[-1]), names)
        hint = f"did you mean {quoted(near)}?" if near else "the keys allowed here are "
        yield key, f"unknown key {quoted(str(key[-1]))}; {hint}{'' if near else ', '.join(names)}"
    elif kind == "missing":
        yield key, "the key is missing; add it"
    elif kind == "union_tag_not_found":
        if near := nearest("source", map(str, value)):
            yield (*key, near), f'unknown key {quoted(near)}; did you mean "source"?'
        else:
            yield (*key, "source"), f"the key is missing; it must be one of {', '.join(SOURCES)}"
    elif kind == "union_tag_invalid":
        yield (*key, "source"), not_one_of(value["source"], SOURCES)
    elif kind == "literal_error":
        choices = context["expected"].replace(" or ", ", ").split(", ")
        yield key, not_one_of(value, [choice.strip("'") for choice in choices])
    elif kind in _LIMITS:
        name, bound = _LIMITS[kind]
        yield key, f"{describe(value)} is out of range; it must be {bound} {context[name]:.15g}"
    elif (wanted := _WANTED.get(kind.split("_")[0])) and kind != "string_too_short":
        yield key, f"{describe(value)} is given here; write {wanted}"
    else:
        words = error["msg"].replace("Input", "it")
        yield key, f"{describe(value)} is given here; {words[0].lower()}{words[1:]}"


def _walk(location: Sequence[str | int], data: Any) -> tuple[Key, list[str]]:
    """Return the key of an error, and the keys that are allowed beside it.

    Pydantic's location has the source of bodies too, and places in lists made of other data.
    """
    key: Key = ()
    model: Any = Config
    names: list[str] = []
    for place, part in enumerate(location):
        if place == 1 and key == ("bodies",):
            model = SOURCES[str(part)]
        elif isinstance(part, str):
            key, names = (*key, part), list(model.model_fields) if model else []
            field = model.model_fields.get(part) if model else None
            model = _model(field.annotation) if field else None
        elif isinstance(value_at(data, key), list):
            key = (*key, part)
    return key, names


def value_at(data: Any, key: Sequence[str | int]) -> Any:
    """Return the value at a key of nested data; None if there is none."""
    try:
        for part in key:
            data = data[part]
    except (TypeError, KeyError, IndexError):
        return None
    return data


def _model(annotation: Any) -> type[BaseModel] | None:
    """Return the model inside a union or an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for inner in get_args(annotation) if (model := _model(inner))), None)
