"""Words of messages about configs and options: places of keys, values, and near misses."""

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


def describe(value: Any) -> str:
    """Return words for a value of a YAML file."""
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "a mapping"
    return "nothing" if value is None else one_line(json.dumps(value, ensure_ascii=False))


def not_one_of(value: Any, names: Iterable[str]) -> str:
    """Return the sentence for a value that is none of `names`."""
    names = list(names)
    near = nearest(value, names) if isinstance(value, str) else None
    hint = f"did you mean {describe(near)}?" if near else "choose one of them"
    return f"{describe(value)} is not one of {', '.join(names)}; {hint}"


def nearest(text: str, names: Iterable[str]) -> str | None:
    """Return the one of `names` that `text` most likely misspells; None if there is none."""

    def folded(word: str) -> str:
        return re.sub(r"[\W_]+", "", word[:40]).casefold()

    known = {folded(name): name for name in names}
    near = difflib.get_close_matches(folded(text), known, 1)
    return known[near[0]] if near else None


@dataclass(frozen=True)
class Places:
    """Where keys stand: the line in `file`, or a ``--set`` text; all of them are equal."""

    file: str | None = field(default=None, compare=False)
    origins: Mapping[Key, int | str] = field(default_factory=dict, compare=False)

    def origin(self, key: Key) -> int | str | None:
        """Return the place of a key, or of the nearest key around it."""
        while key and key not in self.origins:
            key = key[:-1]
        return self.origins.get(key)

    def line(self, key: Key, message: str, origin: int | str | None = None) -> str:
        """Return ``file:line: key: message``."""
        origin = origin or self.origin(key)
        place = f"{self.file}:{origin}" if isinstance(origin, int) else origin
        parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in key)
        name = one_line("".join(parts).removeprefix("."), 200)
        return ": ".join(part for part in (place, name, message) if part)
