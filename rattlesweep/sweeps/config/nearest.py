"""Finds the right key or word for one that is misspelt or stands in the wrong section."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from functools import cache
from typing import Any, get_args

from pydantic import BaseModel

# Longer words are no misspelling of anything here, and comparing them takes long.
MAX_WORD = 40
# A word like one of another section must be more like it than one of its own.
ALIKE, ALIKE_ELSEWHERE = 0.6, 0.8


def nearest(text: str, names: Iterable[str], alike: float = ALIKE) -> str | None:
    """The one of `names` that was most likely meant, if any was."""
    folded = {_folded(name): name for name in names}
    word = _folded(text[:MAX_WORD])
    if word in folded:
        return folded[word]
    if near := difflib.get_close_matches(word, folded, 1, alike):
        return folded[near[0]]
    # Shortened or drawn out: "tolerance" for "tol", "omega" for "omega_xy0".
    drawn = [
        name
        for fold, name in folded.items()
        if min(len(fold), len(word)) >= 3 and (fold.startswith(word) or word.startswith(fold))
    ]
    return drawn[0] if len(drawn) == 1 and alike == ALIKE else None


def _folded(text: str) -> str:
    return re.sub(r"[\W_]+", "", text).casefold()


def unknown_key(key: str, model: type[BaseModel] | None, root: type[BaseModel], source: Any) -> str:
    """What an unknown key may have been meant to be.

    Parameters
    ----------
    key
        The key.
    model
        What stands where the key was found.
    root
        What the whole config is.
    source
        The config's source of bodies, as far as it is known: its keys are the ones to look among.
    """
    from rattlesweep.sweeps.config.messages import quoted

    names = list(model.model_fields) if model else []
    said = f"unknown key {quoted(key)}"
    homes = _homes(root, source if isinstance(source, str) else None)
    if _folded(key[:MAX_WORD]) not in map(_folded, names) and key in homes:
        return f"{said} here; it belongs {_section(homes[key])}"
    if near := nearest(key, names):
        return f"{said}; did you mean {quoted(near)}?"
    if far := nearest(key, homes, ALIKE_ELSEWHERE):
        return f"{said}; did you mean {quoted(far)}, {_section(homes[far])}?"
    return f"{said}; the keys allowed here are {', '.join(names)}"


def _section(homes: tuple[str, ...]) -> str:
    return " or ".join(f"under {home}" if home else "at the top level" for home in homes)


@cache
def _homes(root: type[BaseModel], source: str | None) -> dict[str, tuple[str, ...]]:
    """Sections in which each key is at home, by key; left out where they are too many to tell."""
    found: dict[str, list[str]] = {}
    _collect(root, "", source, found)
    return {key: tuple(homes) for key, homes in found.items() if len(homes) <= 3}


def _collect(
    model: type[BaseModel], path: str, source: str | None, found: dict[str, list[str]]
) -> None:
    for name, field in model.model_fields.items():
        homes = found.setdefault(name, [])
        if path not in homes:
            homes.append(path)
        inside = alternatives([field.annotation])
        chosen = [one for one in inside if f"~{source}" in one[1]] or inside
        for inner, _ in chosen:
            _collect(inner, f"{path}.{name}".removeprefix("."), source, found)


def alternatives(
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
            found += alternatives(get_args(one)[:1] if metadata else get_args(one), tags + own)
    return found
