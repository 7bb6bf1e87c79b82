"""What a sweep is: configs, read and checked; and words of messages about them."""

import difflib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rattlesweep.errors import one_line

Key = tuple[str | int, ...]  # such as ("bodies", "ranges", "theta", 1)


def describe(value: Any) -> str:
    """Return words for a value of a YAML file."""
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "a mapping"
    return "nothing" if value is None else one_line(json.dumps(value, ensure_ascii=False))


def hint(text: Any, names: Iterable[str], otherwise: str) -> str:
    """Return the question which of `names` a text misspells, or what to say if it is none."""
    known = {name.casefold(): name for name in names}
    near = difflib.get_close_matches(str(text)[:40].casefold(), known, 1)
    return f"did you mean {describe(known[near[0]])}?" if near else otherwise


def not_one_of(value: Any, names: Iterable[str]) -> str:
    """Return the sentence for a value that is none of `names`."""
    told = hint(value, names := list(names), "choose one of them")
    return f"{describe(value)} is not one of {', '.join(names)}; {told}"


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
        name = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in key)
        name = one_line(name.removeprefix("."), 200)
        return ": ".join(part for part in (place, name, message) if part)
