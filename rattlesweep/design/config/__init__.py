"""Configs; here: keys, their places in a file, and the words of messages about them."""

import difflib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from rattlesweep.errors import one_line

Key = tuple[str | int, ...]  # such as ("bodies", "ranges", "theta", 1)


def describe(value: object) -> str:
    """Return a value of a config in the words of a message."""
    if value is None:
        return "nothing"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, dict):
        return "a mapping"
    return one_line(json.dumps(value, ensure_ascii=False))


def hint(text: object, names: Iterable[str], otherwise: str) -> str:
    """Return ``did you mean NAME?`` if a name is close to a text, else `otherwise`."""
    known = {name.casefold(): name for name in names}
    word = str(text)[:40].casefold()
    near = difflib.get_close_matches(word, known, len(known) or 1)
    if not near:
        return otherwise
    # Letters in another order, as in tetha, are the most frequent slip.
    anagrams = [name for name in near if sorted(name) == sorted(word)]
    return f"did you mean {describe(known[(anagrams or near)[0]])}?"


def not_one_of(value: object, names: Iterable[str]) -> str:
    """Return the message about a value that is not one of `names`."""
    names = list(names)
    advice = hint(value, names, "choose one of them")
    return f"{describe(value)} is not one of {', '.join(names)}; {advice}"


def spell(key: Key) -> str:
    """Return a key as in messages, such as ``bodies.ranges.theta[1]``."""
    parts = [f"[{part}]" if isinstance(part, int) else f".{part}" for part in key]
    return one_line("".join(parts).removeprefix("."), 200)


@dataclass(frozen=True)
class KeyPlaces:
    """Places of keys, each a line of `file` or a ``--set`` text; all compare equal."""

    file: str | None = field(default=None, compare=False)
    origins: Mapping[Key, int | str] = field(default_factory=dict, compare=False)

    def origin(self, key: Key) -> int | str | None:
        """Return the place of a key, or of the innermost section that has one."""
        while key and key not in self.origins:
            key = key[:-1]
        return self.origins.get(key)

    def line(self, key: Key, message: str, origin: int | str | None = None) -> str:
        """Return ``file:line: key: message``."""
        place = origin or self.origin(key)
        if isinstance(place, int):
            place = f"{self.file}:{place}"
        return ": ".join(text for text in (place, spell(key), message) if text)
