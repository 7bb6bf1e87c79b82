"""Says in plain sentences what pydantic found wrong: what stands there, and what would be right."""

import json
from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel, ValidationError

from rattlesweep.errors import one_line
from rattlesweep.sweeps.config.nearest import alternatives, nearest, unknown_key
from rattlesweep.sweeps.config.places import MAX_TOLD, Places
from rattlesweep.sweeps.config.yamlfile import Key, Problem, is_number


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
    near = nearest(text, names)
    hint = f"did you mean {quoted(near)}?" if near else "choose one of them"
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
    return f"{describe(value)} is given here; write {wanted}"


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


def _key(error: Any) -> Key:
    """The key an error is about: its location without the tags that choose among models."""
    location = error["loc"]
    if error["type"] == "extra_forbidden":
        # The user's own word comes last; it may well look like a tag.
        return *_untagged(location[:-1]), str(location[-1])
    return _untagged(location)


def _untagged(location: Iterable[Any]) -> Key:
    return tuple(part for part in location if not str(part).startswith("~"))


def _sentence(error: Any, model: type[BaseModel], source: Any) -> Problem:
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    key = _key(error)
    if kind == "extra_forbidden":
        message = unknown_key(str(key[-1]), _model_at(model, error["loc"][:-1]), model, source)
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
    from rattlesweep.sweeps.config.schema import SOURCES

    if not isinstance(value, dict):
        return Problem(key, _wanted(value, "a mapping"))
    if "source" not in value:
        if near := nearest("source", map(str, value)):
            return Problem((*key, near), f'unknown key {quoted(near)}; did you mean "source"?')
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
            here = [one for one, tags in alternatives(here) if part in tags] or here
        else:
            models = [m for m, _ in alternatives(here)]
            here = [m.model_fields[part].annotation for m in models if part in m.model_fields]
    models = [m for m, _ in alternatives(here)]
    return models[0] if models else None


def problems_of(
    error: ValidationError, model: type[BaseModel], data: Any, known: set[Key], places: Places
) -> tuple[list[Problem], int]:
    """Errors of a validation as one plain sentence each and the key it is about.

    Parameters
    ----------
    error, model, data
        What was wrong with which data of a config of which model.
    known
        Keys of which, and of what is below them, enough is said already.
    places
        Where the keys stand: the first `MAX_TOLD` are put in words.

    Returns
    -------
    tuple
        The problems, and how many more there are.
    """
    bodies = data.get("bodies") if isinstance(data, dict) else None
    source = bodies.get("source") if isinstance(bodies, dict) else None
    every = [(_key(one), one) for one in error.errors(include_url=False)]
    unknown: dict[Key, list[str]] = {}
    for key, one in every:
        if one["type"] == "extra_forbidden":
            unknown.setdefault(key[:-1], []).append(str(key[-1]))
    found = [
        (key, one)
        for key, one in every
        if not any(key[:depth] in known for depth in range(len(key) + 1))
        # What is missing stands there under a misspelt name, which is told.
        and not (one["type"] == "missing" and nearest(str(key[-1]), unknown.get(key[:-1], ())))
    ]
    found.sort(key=lambda item: places.rank(item[0]))
    told = [_sentence(one, model, source) for _, one in found[:MAX_TOLD]]
    return list(dict.fromkeys(told)), max(0, len(found) - MAX_TOLD)
