"""Errors and warnings that users can act on, the words of their messages, and text
made safe for a terminal.
"""

import difflib
import json
from collections.abc import Collection, Iterable


def printable(text: object) -> str:
    """Return text as one line that is safe for any terminal.

    Whatever is stored, such as a name or a file's name, passes through here before it
    is printed. Escape sequences could change what a terminal shows, and a new line
    could forge a line of ours.
    """
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(text))


def as_lines(lines: Iterable[object]) -> str:
    """Return lines for a terminal, each of them :func:`printable`."""
    return "\n".join(map(printable, lines))


def one_line(text: str, limit: int = 60) -> str:
    """Return text as one printable line, shortened to a limit."""
    if len(text) > limit:
        text = text[: limit - 3] + "..."
    return printable(text)


class ConfigError(ValueError):
    """A command, a config or an argument is wrong (exit code 2), with all messages.

    Stability: stable.
    """

    def __init__(self, messages: str | Iterable[str]) -> None:
        if isinstance(messages, str):
            messages = [messages]
        self.messages = [one_line(message, 1000) for message in messages]
        super().__init__(self.messages)

    def __str__(self) -> str:
        return "\n".join(self.messages)


class ConfigWarning(UserWarning):
    """A config is valid, but makes little physical sense."""


class OutputError(RuntimeError):
    """Results cannot be read or written (exit code 1).

    Stability: stable.
    """


class GoneError(OutputError):
    """A file is gone, as one that was merged with others while they were read."""


class TwiceError(OutputError):
    """A run is stored twice, in two files."""


class DamagedError(OutputError):
    """A file is cut short, changed, or not written by this program."""


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


def check_names(what: str, names: Iterable[str], known: Collection[str]) -> None:
    """Refuse names that are not known."""
    for name in names:
        if name not in known:
            raise ConfigError(f"{what}: {not_one_of(name, known)}")
