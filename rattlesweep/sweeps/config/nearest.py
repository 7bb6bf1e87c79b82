"""Finds the word that was meant by one that is misspelt."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

# Longer words are no misspelling of anything here, and comparing them takes long.
MAX_WORD = 40
ALIKE = 0.6


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
