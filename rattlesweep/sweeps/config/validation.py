"""Says in plain sentences, key by key, what pydantic found wrong with data of some model."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from rattlesweep.sweeps.config.messages import (
    fold,
    nearest,
    not_one_of,
    out_of_range,
    quoted,
    wrong_kind,
)
from rattlesweep.sweeps.config.places import MAX_TOLD, Key, Places, Problem, value_at

Models = list[type[BaseModel]]

# A word like one of another section must be more like it than one of its own.
ALIKE_ELSEWHERE = 0.8

_WANTED = {
    "float_type": "a number",
    "float_parsing": "a number",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "string_type": "text",
    "list_type": "a list",
    "dict_type": "a mapping",
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
}

_LIMITS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}


def problems_of(
    error: ValidationError, model: type[BaseModel], data: Any, known: set[Key], places: Places
) -> tuple[list[Problem], int]:
    """Errors of a validation of `data` as one plain sentence each, and how many more there are.

    Of keys in `known`, and of what is below them, enough is said already; of the others the first
    `MAX_TOLD` by their `places` are put in words.
    """
    every = [(*_walk(one, model, data), one) for one in error.errors(include_url=False)]
    unknown: dict[Key, list[str]] = {}
    for key, _, one in every:
        if one["type"] == "extra_forbidden":
            unknown.setdefault(key[:-1], []).append(str(key[-1]))
    found = [
        (key, models, one)
        for key, models, one in every
        if not any(key[:depth] in known for depth in range(len(key) + 1))
        # What is missing stands there under a misspelt name, which is told.
        and not (one["type"] == "missing" and nearest(str(key[-1]), unknown.get(key[:-1], ())))
    ]
    found.sort(key=lambda item: places.rank(Problem(item[0], "")))
    source = value_at(data, ("bodies", "source"))
    homes = _homes(model, source if isinstance(source, str) else None)
    told = [_problem(key, models, one, homes) for key, models, one in found[:MAX_TOLD]]
    return list(dict.fromkeys(told)), max(0, len(found) - MAX_TOLD)


def _walk(error: Any, model: type[BaseModel], data: Any) -> tuple[Key, Models]:
    """The key of an error, and the models that may stand there, or around a wrong key.

    Pydantic's location names tags too, and places in lists that are made of other data.
    """
    here: Models = [model]
    key: Key = ()
    *outer, last = error["loc"] or [""]
    for part in outer if error["type"] == "extra_forbidden" else error["loc"]:
        fields = [m.model_fields[part].annotation for m in here if part in m.model_fields]
        if fields or (isinstance(part, int) and isinstance(value_at(data, key), list)):
            key = (*key, part)
            here = [one for inside in fields for one in models_in(inside)]
        else:
            here = [one for one in here if part in (one.__name__, *_sources([one]))]
    # The user's own word comes last; it may well look like a tag.
    return ((*key, str(last)) if error["type"] == "extra_forbidden" else key), here


def models_in(annotation: Any) -> Models:
    """The models inside unions and annotations."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    inner = get_args(annotation)
    inner = inner[:1] if hasattr(annotation, "__metadata__") else inner
    return [model for one in inner for model in models_in(one)]


def _sources(models: Models) -> list[str]:
    """The words by which a key `source` chooses among models."""
    fields = [model.model_fields.get("source") for model in models]
    return [word for field in fields if field for word in get_args(field.annotation)]


def _problem(key: Key, models: Models, error: Any, homes: dict[str, tuple[str, ...]]) -> Problem:
    kind, value = error["type"], error["input"]
    if kind == "extra_forbidden":
        names = [name for model in models for name in model.model_fields]
        return Problem(key, unknown_key(str(key[-1]), names, homes))
    if kind == "union_tag_not_found" and isinstance(value, dict):
        if near := nearest("source", map(str, value)):
            return Problem((*key, near), f'unknown key {quoted(near)}; did you mean "source"?')
        words = ", ".join(_sources(models))
        return Problem((*key, "source"), f"the key is missing; it must be one of {words}")
    if kind == "union_tag_invalid" and isinstance(value, dict):
        return Problem((*key, "source"), not_one_of(value["source"], _sources(models)))
    if kind == "missing" and key == ("bodies",):
        return Problem(key, "the key is missing; say with it where parameter sets come from")
    return Problem(key, _sentence(kind, value, error.get("ctx", {})))


def _sentence(kind: str, value: Any, context: dict[str, Any]) -> str:
    if kind == "missing":
        return "the key is missing; add it"
    if kind == "value_error":
        return str(context["error"])
    if kind == "literal_error":
        choices = context["expected"].replace(" or ", ", ").split(", ")
        return not_one_of(value, [choice.strip("'") for choice in choices])
    if kind in _LIMITS:
        name, bound = _LIMITS[kind]
        return out_of_range(f"{value!r}", bound, context[name])
    if kind in ("too_short", "too_long"):
        bound = "least" if kind == "too_short" else "most"
        limit = context["min_length" if kind == "too_short" else "max_length"]
        return f"the list has {context['actual_length']} values; give at {bound} {limit}"
    if kind == "string_too_short":
        return "the text is empty; write at least one character"
    if kind == "finite_number":
        return f"{value!r} is not a finite number; write a finite one"
    # The last is reached by nothing known; still it is never pydantic's words.
    return wrong_kind(value, _WANTED.get(kind, "what the schema allows"))


def unknown_key(key: str, names: Sequence[str], homes: dict[str, tuple[str, ...]]) -> str:
    """What an unknown key may have been meant to be: one of `names`, or one of another section."""
    unknown = f"unknown key {quoted(key)}"
    if fold(key) not in map(fold, names) and key in homes:
        return f"{unknown} here; it belongs {_section(homes[key])}"
    if near := nearest(key, names):
        return f"{unknown}; did you mean {quoted(near)}?"
    if far := nearest(key, homes, ALIKE_ELSEWHERE):
        return f"{unknown}; did you mean {quoted(far)}, {_section(homes[far])}?"
    if not names:
        return f"{unknown}; remove it"
    return f"{unknown}; the keys allowed here are {', '.join(names)}"


def _section(homes: tuple[str, ...]) -> str:
    return " or ".join(f"under {home}" if home else "at the top level" for home in homes)


@cache
def _homes(root: type[BaseModel], source: str | None) -> dict[str, tuple[str, ...]]:
    """Sections in which each key is at home, by key; left out where they are too many to tell."""
    found: dict[str, list[str]] = {}

    def collect(model: type[BaseModel], path: str) -> None:
        for name, field in model.model_fields.items():
            homes = found.setdefault(name, [])
            if path not in homes:
                homes.append(path)
            inside = models_in(field.annotation)
            for inner in [one for one in inside if source in _sources([one])] or inside:
                collect(inner, f"{path}.{name}".removeprefix("."))

    collect(root, "")
    return {key: tuple(homes) for key, homes in found.items() if len(homes) <= 3}
