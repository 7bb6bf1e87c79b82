"""Configs; here: keys, their places in a file, and the words of messages about them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from rattlesweep.words.errors import one_line

Key = tuple[str | int, ...]  # such as ("bodies", "ranges", "theta", 1)


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
