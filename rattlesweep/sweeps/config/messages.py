"""Words of messages about configs and options: names of keys, values, and near misses."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rattlesweep.errors import one_line

Key = tuple[str | int, ...]
"""Place of a value in nested data, such as ``("bodies", "ranges", "theta", 1)``."""


def dotted(key: Key) -> str:
    """Return a key as people write it: ``bodies.ranges.theta[1]``."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{one_line(part)}" for part in key)
    text = "".join(parts).removeprefix(".")
    return text if len(text) <= 200 else f"{text[:120]}...{text[-77:]}"


def quoted(text: str) -> str:
    """Return `text` in double quotes, on one line."""
    return f'"{one_line(text)}"'


def describe(value: Any) -> str:
    """Return words for a value of a YAML file."""
    if value is None:
        return "nothing (null)"
    if isinstance(value, bool):
        return f"{json.dumps(value)} (a truth value)"
    if isinstance(value, int | float):
        return str(value) if isinstance(value, float) else one_line(f"{value:d}", 24)
    if isinstance(value, str):
        return f"{quoted(value)} (text)"
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "a mapping"
    return f"a value of type {one_line(type(value).__name__)}"


def not_one_of(value: Any, names: Iterable[str]) -> str:
    """Return the sentence for a value that is none of `names`."""
    names = list(names)
    near = nearest(value, names) if isinstance(value, str) else None
    hint = f"did you mean {quoted(near)}?" if near else "choose one of them"
    what = quoted(value) if isinstance(value, str) else describe(value)
    return f"{what} is not one of {', '.join(names)}; {hint}"


def nearest(text: str, names: Iterable[str]) -> str | None:
    """Return the one of `names` that `text` most likely misspells; None if there is none."""
    folded = {_fold(name): name for name in names}
    word = _fold(text)
    if near := difflib.get_close_matches(word, folded, 1):
        return folded[near[0]]
    # Shortened or drawn out: "tolerance" for "tol", "omega" for "omega_xy0".
    drawn = [
        name
        for short, name in folded.items()
        if min(len(short), len(word)) >= 3 and (short.startswith(word) or word.startswith(short))
    ]
    return drawn[0] if len(drawn) == 1 else None


def _fold(text: str) -> str:
    """Return the beginning of a word without capitals, dashes and underscores."""
    return re.sub(r"[\W_]+", "", text[:40]).casefold()


@dataclass(frozen=True)
class Places:
    """Where the keys of a config stand: the line in `file`, or the ``--set`` text.

    All are equal, so that the equality of configs does not depend on them.
    """

    file: str | None = field(default=None, compare=False)
    origins: Mapping[Key, int | str] = field(default_factory=dict, compare=False)

    def origin(self, key: Key) -> int | str | None:
        """Return the place of a key, or of the nearest key around it."""
        while key not in self.origins and key:
            key = key[:-1]
        return self.origins.get(key)

    def line(self, key: Key, message: str, origin: int | str | None = None) -> str:
        """Return ``file:line: key: message``."""
        origin = origin or self.origin(key)
        place = f"{self.file}:{origin}" if isinstance(origin, int) else origin
        return ": ".join(part for part in (place, dotted(key), message) if part)
