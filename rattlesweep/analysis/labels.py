"""Texts of a figure in its author's words: another language, other symbols."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from rattlesweep.analysis import style
from rattlesweep.analysis.style import REGIME_STYLE, TYPE_STYLE
from rattlesweep.config.read import read_file
from rattlesweep.rows.columns import COLUMNS, define
from rattlesweep.words.errors import ConfigError, describe, hint, one_line
from rattlesweep.words.quantities import MEASURES, QUANTITIES

LONGEST = 60  # letters of a text that a message may list; captions are longer

ROLES = ("xlabel", "ylabel", "bar", "caption")
"""Names of texts that a figure has once: of the axes, the bar of colours, below."""

SYMBOLS = {
    name: define(name).symbol for name in (*QUANTITIES, *MEASURES, *COLUMNS, "ratio")
}
"""Symbols of the columns by name, as they stand in labels, headings and legends."""

WORDS = {
    name: look.label for name, look in (*TYPE_STYLE.items(), *REGIME_STYLE.items())
}
"""Legend entries of types and regimes by name."""

FURTHER_ENTRIES = (style.OF_THEORY, style.STABLE, style.BONDI)
"""Further entries, of some figures of a sweep: a file of texts may serve them all."""


class Labels:
    """Replacements of texts, and which of them a figure has used.

    A key is one of `ROLES`, the name of a column, a type or a regime, or a text as the
    figure has it.
    """

    def __init__(self, texts: Mapping[str, str], source: str = "labels") -> None:
        self._source = source
        self._of_role = {key: texts[key] for key in texts if key in ROLES}
        self._of_text = {key: texts[key] for key in texts if key not in ROLES}
        self._of_symbol: dict[str, str] = {}
        for key, text in self._of_text.items():
            if key in WORDS:
                self._of_symbol[WORDS[key]] = text
            elif key in SYMBOLS:
                self._of_symbol[SYMBOLS[key]] = text
        self._pattern = _any_of(self._of_symbol)
        self._seen: set[str] = set()  # texts of the figure
        self._made: set[str] = set()  # texts that took their place

    def __call__(self, text: str) -> str:
        """Return a text in the author's words."""
        if text in self._made:
            return text
        self._seen.add(text)
        new = self._of_text.get(text)
        if new is None:
            new = text
            if self._pattern is not None:
                new = self._pattern.sub(lambda part: self._of_symbol[part[0]], text)
        self._made.add(new)
        return new

    def role(self, name: str, text: str) -> str:
        """Return the text of a role in the author's words."""
        own = self._of_role.get(name)
        if own is None:
            return self(text)
        self._made.add(own)
        return own

    def rename(self, handles: Iterable[Artist]) -> None:
        """Give entries of a legend the author's words."""
        for handle in handles:
            handle.set_label(self(str(handle.get_label())))

    def apply(self, drawn: Figure | Axes) -> None:
        """Replace the texts of what is drawn; a ConfigError names an unknown key."""
        every = [drawn] if isinstance(drawn, Axes) else drawn.axes
        for axes in every:
            is_bar = hasattr(axes, "_colorbar")
            for which in ("xlabel", "ylabel"):
                text = getattr(axes, f"get_{which}")()
                if text:
                    role = "bar" if is_bar else which
                    getattr(axes, f"set_{which}")(self.role(role, text))
        for text in drawn.findobj(Text):
            shown = text.get_text()
            if shown:
                text.set_text(self(shown))
        self._check()

    def _check(self) -> None:
        """Refuse a key that is neither a name nor a text of the figure."""
        for key in self._of_text:
            if any(
                key in known for known in (self._seen, SYMBOLS, WORDS, FURTHER_ENTRIES)
            ):
                continue
            texts = sorted(
                text
                for text in self._seen
                if len(text) < LONGEST and re.search("[A-Za-z]{2}", text)
            )
            advice = hint(
                key,
                [*ROLES, *texts, *SYMBOLS, *WORDS, *FURTHER_ENTRIES],
                f"give one of {', '.join(ROLES)}, the name of a column or a type, or a "
                f"text of the figure: {'; '.join(map(repr, texts))}",
            )
            raise ConfigError(
                f"{self._source}: {describe(key)} is no text of this figure; {advice}"
            )


def _any_of(symbols: Iterable[str]) -> re.Pattern[str] | None:
    """Return a pattern of any of some texts, the longest first; None if there is none.

    A symbol that is a word, such as a column of the user's, is not found within others.
    """
    parts = []
    for symbol in sorted(symbols, key=len, reverse=True):
        part = re.escape(symbol)
        if re.fullmatch(r"\w+", symbol):
            part = rf"\b{part}\b"
        parts.append(part)
    if not parts:
        return None
    return re.compile("|".join(parts))


def read_labels(given: Mapping[str, str] | str | Path | None) -> Labels | None:
    """Return the texts of a mapping or of a YAML file, or raise a ConfigError."""
    if given is None:
        return None
    source = "labels"
    data: Mapping[str, object]
    if isinstance(given, Mapping):
        data = given
    else:
        source = one_line(str(given), 200)
        data, _, problems = read_file(given)
        if problems:
            line, _, message = problems[0]
            raise ConfigError(f"{source}:{line}: {message}")
    for key, text in data.items():
        if not isinstance(key, str) or not isinstance(text, str):
            raise ConfigError(
                f"{source}: {describe(key)} has {describe(text)}, and a text is "
                "needed; write it in quotes"
            )
    return Labels({key: str(text) for key, text in data.items()}, source)
