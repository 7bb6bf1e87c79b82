"""Sentences about values of a config that its schema refuses."""

from collections.abc import Iterator
from typing import get_args

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from rattlesweep.config import Key
from rattlesweep.config.body_sources import SOURCES
from rattlesweep.config.schema import Config
from rattlesweep.words.errors import describe, hint, not_one_of
from rattlesweep.words.units import with_point

_Model = type[BaseModel]
# What is needed, by pydantic's types of errors.
_NEEDED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "int_parsing_size": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "string_type": "a text",
    "string_too_short": "a text that is not empty",
    "string_pattern_mismatch": "a text without null characters",
    "list_type": "a list",
    "dict_type": "a section of keys with values",
}
# The word for a limit, and its name in the context of an error.
_LIMITS = {
    "greater_than": ("above", "gt"),
    "greater_than_equal": ("of at least", "ge"),
    "less_than": ("below", "lt"),
    "less_than_equal": ("of at most", "le"),
}


def key_and_sentence(
    error: ErrorDetails, model: _Model, data: object
) -> tuple[Key, str]:
    """Return the key and the sentence of one of pydantic's errors about data."""
    key = _key_of(error["loc"], data)
    kind = error["type"]
    value = error["input"]
    context = error.get("ctx", {})
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return (*key, "source"), not_one_of(value.get("source"), SOURCES)
    if kind == "missing":
        return key, "the key is missing; add it"
    if kind == "extra_forbidden":
        return key, _unknown(key, model, data)
    if kind == "literal_error":
        return key, not_one_of(value, _words_of(context["expected"]))
    if kind == "value_error":
        sentence = str(context["error"])
        if isinstance(value, str):
            return key, f"{describe(value)} {sentence}"
        return key, sentence
    return key, f"{describe(value)} is given; {_needed(error, key, model, data)}"


def _key_of(location: tuple[int | str, ...], data: object) -> Key:
    """Return the key at a location, which for bodies also names the source."""
    place = list(location)
    if place[:1] == ["bodies"]:
        del place[1:2]
    key: Key = ()
    value = data
    for part in place:
        if isinstance(part, str):
            key = (*key, part)
            value = value.get(part) if isinstance(value, dict) else None
        elif isinstance(value, list):  # and not one value that stands for a list
            key = (*key, part)
            value = value[part]
    return key


def _words_of(expected: str) -> list[str]:
    """Return the words of a text such as ``'full', 'reduced' or 'gh'``."""
    return expected.replace(" or ", ", ").replace("'", "").split(", ")


def _needed(error: ErrorDetails, key: Key, model: _Model, data: object) -> str:
    """Return the clause about what is needed in place of a value."""
    kind = error["type"]
    value = error["input"]
    context = error.get("ctx", {})
    if isinstance(value, str) and (pointed := with_point(value)):
        return f"write {pointed} with a decimal point"
    if kind in _LIMITS:
        word, name = _LIMITS[kind]
        return f"a value {word} {context[name]:g} is needed"
    if kind in ("too_short", "too_long"):
        count = context.get("min_length", context.get("max_length"))
        return f"it has {context['actual_length']} values, and {count} are needed"
    if kind in _NEEDED:
        return f"{_NEEDED[kind]} is needed"
    # What remains is a value in place of a section.
    section = _model_at(key, model, data)
    example = "{key: value}"
    if section is not None:
        first = next(iter(section.model_fields))
        shown = "..." if isinstance(value, list | dict) else f"{value}"
        example = f"{{{first}: {shown[:20]}}}"
    return f"a section is needed, such as {key[-1] if key else 'a config'}: {example}"


def _unknown(key: Key, model: _Model, data: object) -> str:
    """Return the sentence about a key that is not known in its section."""
    name = str(key[-1])
    sentence = f"unknown key {describe(name)}"
    section = _model_at(key[:-1], model, data)
    known = list(section.model_fields) if section is not None else []
    if name.isdigit():
        return f"{sentence}; if this is a decimal comma, write a decimal point"
    sources = [
        source for source, bodies in SOURCES.items() if name in bodies.model_fields
    ]
    if key[:-1] == ("bodies",) and sources:
        return f"{sentence} of this source; it goes with source {' or '.join(sources)}"
    near = hint(name, known, "")
    if near:
        return f"{sentence}; {near}"
    elsewhere = dict.fromkeys(
        ".".join(path)
        for path, other in _sections((), Config)
        if name in other.model_fields and model is Config
    )
    if elsewhere:
        places = " or ".join(f"{path}.{name}".lstrip(".") for path in elsewhere)
        return f"{sentence}; did you mean {places}?"
    return f"{sentence}; allowed are {', '.join(known)}"


def _model_at(key: Key, model: _Model, data: object) -> _Model | None:
    """Return the model of the section at a key; None if there is no section."""
    section: _Model | None = model
    for name in key:
        if section is None or isinstance(name, int):
            return None
        if name == "bodies" and section is Config:
            assert isinstance(data, dict)  # it has the key
            bodies = data["bodies"]
            if not isinstance(bodies, dict):
                return None
            section = SOURCES.get(str(bodies.get("source")))
            continue
        field = section.model_fields.get(name)
        models = list(_models_in(field.annotation)) if field else []
        section = models[0] if models else None
    return section


def _models_in(annotation: object) -> Iterator[_Model]:
    """Yield the models in the annotation of a field."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


def _sections(
    path: tuple[str, ...], model: _Model
) -> Iterator[tuple[tuple[str, ...], _Model]]:
    """Yield the dotted path and the model of each section of a model."""
    yield path, model
    for name, field in model.model_fields.items():
        for section in _models_in(field.annotation):
            yield from _sections((*path, name), section)
