"""Errors and warnings that users can act on, and text made safe for a terminal."""

from collections.abc import Iterable


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
    """A command, a config or an argument is wrong (exit code 2), with all messages."""

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
    """Results cannot be read or written (exit code 1)."""


class GoneError(OutputError):
    """A file is gone, as one that was merged with others while they were read."""


class DamagedError(OutputError):
    """A file is cut short, changed, or not written by this program."""
