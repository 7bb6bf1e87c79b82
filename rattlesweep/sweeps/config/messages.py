"""The words of messages: what stands there, and what would be right."""

import difflib
import json
import re
from collections.abc import Iterable
from typing import Any

from rattlesweep.errors import one_line
from rattlesweep.sweeps.config.yamlfile import is_number

# Longer words are no misspelling of anything here, and comparing them takes long.
MAX_WORD = 40
ALIKE = 0.6


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


def not_one_of(value: Any, names: Iterable[str]) -> str:
    """Sentence for a word, or something else, that is none of `names`."""
    names = list(names)
    near = nearest(value, names) if isinstance(value, str) else None
    hint = f"did you mean {quoted(near)}?" if near else "choose one of them"
    what = quoted(value) if isinstance(value, str) else describe(value)
    return f"{what} is not one of {', '.join(names)}; {hint}"


def wrong_kind(value: Any, wanted: str) -> str:
    """Sentence for a value of the wrong kind; text that looks like a number is a common one."""
    if isinstance(value, str) and "number" in wanted:
        if is_number(value):
            return f"{quoted(value)} is text; remove the quotes"
        if is_number(value.replace("_", "")):
            return f"{quoted(value)} is text in YAML 1.2; write {value.replace('_', '')}"
    if isinstance(value, int | float) and not isinstance(value, bool) and wanted == "text":
        return f"{value!r} is a number; put it in quotes to make it text"
    return f"{describe(value)} is given here; write {wanted}"


def out_of_range(what: str, bound: str, limit: float) -> str:
    """Sentence for a number beyond a limit, such as "above" 0 or "at most" 1."""
    return f"{what} is out of range; it must be {bound} {limit:.15g}"


def nearest(text: str, names: Iterable[str], alike: float = ALIKE) -> str | None:
    """The one of `names` that was most likely meant, if any was."""
    folded = {fold(name): name for name in names}
    word = fold(text)
    if word in folded:
        return folded[word]
    if near := difflib.get_close_matches(word, folded, 1, alike):
        return folded[near[0]]
    # Shortened or drawn out: "tolerance" for "tol", "omega" for "omega_xy0".
    drawn = [
        name
        for short, name in folded.items()
        if min(len(short), len(word)) >= 3 and (short.startswith(word) or word.startswith(short))
    ]
    return drawn[0] if len(drawn) == 1 and alike == ALIKE else None


def fold(text: str) -> str:
    """A word without what is often misspelt in it: capitals, dashes, underscores."""
    return re.sub(r"[\W_]+", "", text[:MAX_WORD]).casefold()
