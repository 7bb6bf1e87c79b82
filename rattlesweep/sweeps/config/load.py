"""Configs: read them, check them, compare them."""

import copy
import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import Any

from pydantic import ValidationError

from rattlesweep.errors import ConfigError, one_line
from rattlesweep.sweeps.config import yamlfile
from rattlesweep.sweeps.config.messages import describe
from rattlesweep.sweeps.config.places import (
    MAX_TOLD,
    Key,
    Origin,
    Places,
    Problem,
    dotted,
    value_at,
)
from rattlesweep.sweeps.config.schema import Config
from rattlesweep.sweeps.config.validation import problems_of

NOT_PHYSICS = ("name", "output", "classify", "block_size")
"""Keys that change no stored number."""

FORMAT_1 = {
    "Config": ("seed", "model", "horizon", "integrator", "record"),
    "SdSource": ("samples", "ranges"),
    "SdRanges": ("gamma", "f_sd", "theta", "phi", "minus_xi_deg"),
    "Target": ("rel_tol", "max_draws"),
    "PresetSource": ("overrides",),
    "Spin": ("psi",),
    "Integrator": ("method",),
}
"""Keys that enter the hash of a config even where they have their default value.

Complete for all time: a key that is added later enters only where it differs from its default, so
that the hashes, and with them the directories, of configs that do not use it stay valid.
"""


def load_config(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Config:
    """Read a config file (YAML 1.2).

    `overrides` are ``KEY=VALUE`` texts with dotted keys and YAML values, such as
    ``bodies.samples=10``; they replace what the file says, the last one where several name one key.
    A ConfigError has everything that is wrong, one line each: file, line, column, key, sentence.
    """
    file = one_line(os.fspath(path), 200)
    document = yamlfile.parse(yamlfile.read_text(path))
    data = document.data
    origins: dict[Key, Origin] = {(): (1, 1), **document.positions}
    places = Places(file, origins)
    if data is None and document.problems:
        raise ConfigError(places.lines(document.problems))
    if data is None:
        raise ConfigError(f"{file}:1:1: the file is empty; it needs at least bodies and spin")
    if not isinstance(data, dict):
        raise ConfigError(
            f"{file}:1:1: {describe(data)} found where a mapping is needed; write key: value lines"
        )
    refused = [line for text in overrides for line in _override(data, origins, text)]
    return _checked(data, document.problems, places, refused)


def parse_config(data: Mapping[str, Any]) -> Config:
    """Check a config given as Python data, in which tuples count as lists and NumPy's numbers too.

    A ConfigError has everything that is wrong, one line each: key and sentence.
    """
    problems: list[Problem] = []
    read = _as_read(data, (), problems)
    if not isinstance(read, dict):
        raise ConfigError(f"{describe(read)} found where a mapping is needed; give a dict")
    return _checked(read, problems, Places())


def override_config(data: Mapping[str, Any], overrides: Sequence[str]) -> Config:
    """Check a config given as Python data, with some keys replaced by ``KEY=VALUE`` texts."""
    changed = copy.deepcopy(dict(data))
    origins: dict[Key, Origin] = {}
    refused = [line for text in overrides for line in _override(changed, origins, text)]
    return _checked(changed, [], Places(None, origins), refused)


def config_json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a config."""
    schema = Config.model_json_schema()
    # Of OpenAPI, and not of JSON Schema.
    del schema["properties"]["bodies"]["discriminator"]
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "rattlesweep config"
    for model in (schema, *schema["$defs"].values()):
        for key in model["properties"].values():
            key["description"] = " ".join(key["description"].split())
    return schema


def resolved(config: Config) -> dict[str, Any]:
    """The config as plain data that JSON can hold, with all defaults filled in."""
    data = config.model_dump(mode="json", exclude_none=True)
    return data | {"output": config.directory}


def fixed_part(data: Mapping[str, Any]) -> dict[str, Any]:
    """What of a resolved config determines the numbers of a run with a given key."""
    part = {
        k: v
        for k, v in data.items()
        if k not in ("name", "output", "classify", "block_size", "stop")
    }
    if data.get("classify", {}).get("early"):
        part["classify"] = {"early": True}
    part["integrator"] = {k: v for k, v in part["integrator"].items() if k != "max_steps"}
    bodies = {k: v for k, v in part["bodies"].items() if k not in ("samples", "refine")}
    if bodies.get("target"):
        bodies["target"] = {
            k: ([] if k in ("K_r", "K_p") else v) for k, v in bodies["target"].items()
        }
    part["bodies"] = bodies
    if part.get("spin"):
        part["spin"] = part["spin"] | {"n_i": [], "omega_xy0": []}
    part["dissipation"] = {k: bool(v) for k, v in part["dissipation"].items()}
    return part


def physics_hash(config: Config) -> str:
    """SHA-256, in hex, of everything in the config that determines the stored numbers."""
    text = json.dumps(
        fixed_part(resolved(config)), sort_keys=True, separators=(",", ":"), allow_nan=False
    )
    return hashlib.sha256(text.encode()).hexdigest()


def differences(a: dict[str, Any], b: dict[str, Any]) -> list[str]:
    """Dotted keys in which two resolved configs differ, each with both values."""
    left, right = _flat(a), _flat(b)
    keys = [*left, *(key for key in right if key not in left)]
    return [
        f"{key}: {left.get(key, 'not set')} against {right.get(key, 'not set')}"
        for key in keys
        if left.get(key) != right.get(key)
    ]


def _flat(data: Any, prefix: str = "") -> dict[str, str]:
    if not isinstance(data, dict) or (not data and prefix):
        return {prefix: json.dumps(data)}
    flat: dict[str, str] = {}
    for key, value in data.items():
        flat |= _flat(value, f"{prefix}.{key}" if prefix else str(key))
    return flat


def _checked(
    data: dict[str, Any], problems: list[Problem], places: Places, refused: Sequence[str] = ()
) -> Config:
    """The config, or a ConfigError with `problems`, what validation finds, and `refused`."""
    config, more = None, 0
    try:
        config = Config.model_validate(data)
    except ValidationError as error:
        # A bad value is null in `data`; that null cannot stand there is no news.
        known = {problem.key for problem in problems if value_at(data, problem.key) is None}
        found, more = problems_of(error, Config, data, known, places)
        problems = problems + found
    if problems or refused or config is None:
        raise ConfigError([*places.lines(problems, more), *refused[:MAX_TOLD]])
    return config.placed(places)


def _override(data: dict[str, Any], origins: dict[Key, Origin], text: str) -> list[str]:
    """Put one ``KEY=VALUE`` into `data`; what is wrong with it comes back."""
    origin = f"--set {one_line(text, 100)}"
    name, equals, value = text.partition("=")
    key: Key = tuple(name.strip().split("."))
    if not equals or not all(key):
        return [f"{origin}: is not KEY=VALUE; write it as in bodies.samples=10"]
    document = yamlfile.parse(value)
    if document.problems:
        return [f"{origin}: {dotted(key)}: {document.problems[0].message}"]
    here = data
    for depth, part in enumerate(key[:-1], start=1):
        if here.get(str(part)) is None:
            here[str(part)] = {}
            origins[key[:depth]] = origin
        here = here[str(part)]
        if not isinstance(here, dict):
            return [f"{origin}: {dotted(key[:depth])} is not a mapping; set it as a whole"]
    here[str(key[-1])] = document.data
    for old in [old for old in origins if old[: len(key)] == key]:
        del origins[old]
    origins[key] = origin
    return []


def _as_read(value: Any, key: Key, problems: list[Problem]) -> Any:
    """Python data as a config file would give it; NaN and the like become problems."""
    if len(key) > yamlfile.MAX_DEPTH:
        # At once: data that holds itself has no end, and may double at each level.
        raise ConfigError(f"{dotted(key[:1])}: is nested too deeply; a config has 5 levels")
    if isinstance(value, Mapping):
        return {str(k): _as_read(v, (*key, str(k)), problems) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_as_read(v, (*key, i), problems) for i, v in enumerate(value)]
    if isinstance(value, bool):
        return value
    # NumPy's numbers are registered as these.
    if isinstance(value, Integral | Real):
        try:
            number = int(value) if isinstance(value, Integral) else float(value)
        except (OverflowError, ValueError):
            number = math.inf
        if problem := yamlfile.number_problem(number, one_line(f"{number}", 24)):
            problems.append(Problem(key, problem))
            return None
        return number
    return value
