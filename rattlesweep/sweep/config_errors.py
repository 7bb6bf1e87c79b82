"""Says in plain sentences what pydantic found wrong: what stands there, and what would be right."""

import difflib
import json
from collections.abc import Iterable
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from rattlesweep.sweep.yamlfile import Key, Problem, is_number, one_line


def quoted(text: str) -> str:
    """`text` in double quotes, on one line."""
    return f'"{one_line(text)}"'


def describe(value: Any) -> str:
    """What a value is, to someone who wrote it in YAML."""
    if value is None:
        return "nothing (null)"
    if isinstance(value, bool):
        return f"{json.dumps(value)} (a truth value)"
    if isinstance(value, int | float):
        return one_line(f"{value!r}")
    if isinstance(value, str):
        return f"{quoted(value)} (text)"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, dict):
        return "a mapping"
    return f"a value of type {one_line(type(value).__name__)}"


def not_one_of(text: str, names: Iterable[str]) -> str:
    """Sentence for a word that is none of `names`."""
    names = list(names)
    near = difflib.get_close_matches(text, names, 1)
    hint = f'did you mean "{near[0]}"?' if near else "choose one of them"
    return f"{quoted(text)} is not one of {', '.join(names)}; {hint}"


def _wanted(value: Any, wanted: str) -> str:
    """Sentence for a value of the wrong kind; text that looks like a number is a common one."""
    if isinstance(value, str) and "number" in wanted:
        if is_number(value):
            return f"{quoted(value)} is text; remove the quotes"
        if is_number(value.replace("_", "")):
            return f"{quoted(value)} is text in YAML 1.2; write {value.replace('_', '')}"
    if isinstance(value, int | float) and not isinstance(value, bool) and wanted == "text":
        return f"{value!r} is a number; put it in quotes to make it text"
    return f"{describe(value)} stands here; write {wanted}"


_WANTED = {
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "number_or_list": "a number or a list of numbers",
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


def _unknown_key(key: str, model: type[BaseModel] | None) -> str:
    names = list(model.model_fields) if model else []
    near = difflib.get_close_matches(key, names, 1)
    if near:
        return f"unknown key {quoted(key)}; did you mean {quoted(near[0])}?"
    return f"unknown key {quoted(key)}; the keys allowed here are {', '.join(names)}"


def _sentence(error: Any, model: type[BaseModel]) -> Problem:
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    location = error["loc"]
    key: Key = tuple(part for part in location if not str(part).startswith("~"))
    if kind == "extra_forbidden":
        # The user's own word comes last; it may well look like a tag.
        name = str(location[-1])
        key = (*(part for part in location[:-1] if not str(part).startswith("~")), name)
        message = _unknown_key(name, _model_at(model, location[:-1]))
    elif kind == "missing":
        message = "the key is missing; add it"
        if key == ("bodies",):
            message = "the key is missing; say with it where parameter sets come from"
    elif kind == "body_source":
        return _source_problem(value, key)
    elif kind == "value_error":
        message = str(context["error"])
    elif kind == "literal_error":
        choices = [c.strip("'") for c in context["expected"].replace(" or ", ", ").split(", ")]
        message = (
            not_one_of(value, choices)
            if isinstance(value, str)
            else f"{describe(value)} is not one of {', '.join(choices)}; choose one of them"
        )
    elif kind in _LIMITS:
        name, words = _LIMITS[kind]
        message = f"{value!r} is out of range; it must be {words} {context[name]:.15g}"
    elif kind in _WANTED:
        message = _wanted(value, _WANTED[kind])
    elif kind == "string_too_short":
        message = "the text is empty; write at least one character"
    elif kind == "finite_number":
        message = f"{value!r} is not a finite number; write a finite one"
    else:
        # Reached by nothing known; still names the offending value and never pydantic's words.
        message = f"{describe(value)} cannot stand here; see the schema for what can"
    return Problem(key, message)


def _source_problem(value: Any, key: Key) -> Problem:
    from rattlesweep.sweep.config_models import SOURCES

    if not isinstance(value, dict):
        return Problem(key, _wanted(value, "a mapping"))
    if "source" not in value:
        return Problem(
            (*key, "source"), f"the key is missing; it must be one of {', '.join(SOURCES)}"
        )
    source = value["source"]
    if isinstance(source, str):
        return Problem((*key, "source"), not_one_of(source, SOURCES))
    return Problem(
        (*key, "source"),
        f"{describe(source)} is not one of {', '.join(SOURCES)}; choose one of them",
    )


def _model_at(model: type[BaseModel], location: Iterable[Any]) -> type[BaseModel] | None:
    """The model that an error's location leads to. Tags ("~sd") choose among several."""
    here: list[Any] = [model]
    for part in location:
        if str(part).startswith("~"):
            here = [one for one, tags in _alternatives(here) if part in tags] or here
        else:
            models = [m for m, _ in _alternatives(here)]
            here = [m.model_fields[part].annotation for m in models if part in m.model_fields]
    models = [m for m, _ in _alternatives(here)]
    return models[0] if models else None


def _alternatives(
    types: Iterable[Any], tags: tuple[str, ...] = ()
) -> list[tuple[type[BaseModel], tuple[str, ...]]]:
    """The models inside unions and annotations, each with the tags that choose it."""
    found: list[tuple[type[BaseModel], tuple[str, ...]]] = []
    for one in types:
        if isinstance(one, type) and issubclass(one, BaseModel):
            found.append((one, tags))
        else:
            metadata = getattr(one, "__metadata__", ())
            own = tuple(str(m.tag) for m in metadata if hasattr(m, "tag"))
            found += _alternatives(get_args(one)[:1] if metadata else get_args(one), tags + own)
    return found


def problems_of(error: ValidationError, model: type[BaseModel]) -> list[Problem]:
    """Every error of a validation as one plain sentence and the key it is about."""
    found = error.errors(include_url=False)
    return list(dict.fromkeys(_sentence(one, model) for one in found))
