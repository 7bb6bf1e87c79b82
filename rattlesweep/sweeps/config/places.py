"""Where the keys of a config stand, and the lines that say what is wrong with them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from rattlesweep.errors import one_line

Key = tuple[str | int, ...]
"""Where a value stands in nested data: ``("bodies", "ranges", "theta", 1)``."""

Origin = tuple[int, int] | str
"""Line and column in the file, or the ``--set KEY=VALUE`` that gave the value."""

MAX_TOLD = 20
"""Problems told in full; of the rest only the number."""


class Problem(NamedTuple):
    """One thing wrong with the value at `key`, which stands at `position` where that is known."""

    key: Key
    message: str
    position: tuple[int, int] | None = None


def dotted(key: Key) -> str:
    """A key as people write it: ``bodies.ranges.theta[1]``."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{one_line(part)}" for part in key)
    text = "".join(parts).removeprefix(".")
    return text if len(text) <= 200 else f"{text[:120]}...{text[-77:]}"


def value_at(data: Any, key: Key) -> Any:
    """What stands at a key of nested data; None if nothing does."""
    try:
        for part in key:
            data = data[part]
    except (TypeError, KeyError, IndexError):
        return None
    return data


@dataclass(frozen=True)
class Places:
    """Where a config's keys stand; all are equal, as places change no config.

    Attributes
    ----------
    file
        Name of the file as the user gave it; None for Python data.
    origins
        Place of each key that was given.
    """

    file: str | None = field(default=None, compare=False)
    origins: Mapping[Key, Origin] = field(default_factory=dict, compare=False)

    def origin(self, problem: Problem) -> Origin | None:
        """Place of a problem: its own, that of its key, or of the nearest key around it."""
        if problem.position is not None and self.file is not None:
            return problem.position
        key = problem.key
        while key not in self.origins and key:
            key = key[:-1]
        return self.origins.get(key)

    def rank(self, problem: Problem) -> tuple[int, int, int]:
        """What problems are sorted by: their place in the file, then that among the settings."""
        origin = self.origin(problem)
        if isinstance(origin, tuple):
            return 0, *origin
        return (0 if origin is None else 1), 0, 0

    def line(self, problem: Problem) -> str:
        """One line: place, key, sentence."""
        origin = self.origin(problem)
        place = f"{self.file}:{origin[0]}:{origin[1]}" if isinstance(origin, tuple) else origin
        return ": ".join(part for part in (place, dotted(problem.key), problem.message) if part)

    def lines(self, problems: Iterable[Problem], more: int = 0) -> list[str]:
        """A line per problem, in the order of their places; `more` are known only by number."""
        lines = list(dict.fromkeys(self.line(one) for one in sorted(problems, key=self.rank)))
        more += max(0, len(lines) - MAX_TOLD)
        if more:
            rest = f"and {more} more; fix these first"
            lines = [*lines[:MAX_TOLD], f"{self.file}: {rest}" if self.file else rest]
        return lines
