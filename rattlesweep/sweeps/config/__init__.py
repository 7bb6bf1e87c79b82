"""Configs; here: keys, their places in a file, and the words of messages about them."""

import difflib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rattlesweep.errors import one_line

Key = tuple[str | int, ...]  # such as ("bodies", "ranges", "theta", 1)


def describe(value: Any) -> str:
    """Return a value of a config in the words of a message."""
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "a mapping"
    return (
        "nothing" if value is None else one_line(json.dumps(value, ensure_ascii=False))
    )


def hint(text: Any, names: Iterable[str], otherwise: str) -> str:
    """Return ``did you mean NAME?`` if a text is close to one of `names`, else
    `otherwise`.
    """
    known = {name.casefold(): name for name in names}
    near = difflib.get_close_matches(str(text)[:40].casefold(), known, 1)
    return f"did you mean {describe(known[near[0]])}?" if near else otherwise


def not_one_of(value: Any, names: Iterable[str]) -> str:
    """Return the message about a value that is not one of `names`."""
    names = list(names)
    advice = hint(value, names, "choose one of them")
    return f"{describe(value)} is not one of {', '.join(names)}; {advice}"


@dataclass(frozen=True)
class Places:
    """Places of keys: a line of `file`, or a ``--set`` text.  All instances compare
    equal.
    """

    file: str | None = field(default=None, compare=False)
    origins: Mapping[Key, int | str] = field(default_factory=dict, compare=False)

    def origin(self, key: Key) -> int | str | None:
        """Return the place of a key, or of the innermost section around it that has
        one.
        """
        while key and key not in self.origins:
            key = key[:-1]
        return self.origins.get(key)

    def line(self, key: Key, message: str, origin: int | str | None = None) -> str:
        """Return ``file:line: key: message``."""
        origin = origin or self.origin(key)
        place = f"{self.file}:{origin}" if isinstance(origin, int) else origin
        name = "".join(
            f"[{part}]" if isinstance(part, int) else f".{part}" for part in key
        )
        name = one_line(name.removeprefix("."), 200)
        return ": ".join(part for part in (place, name, message) if part)
