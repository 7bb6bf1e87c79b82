"""The two ways a sweep can fail that are the user's to mend, and what only looks like one."""

from collections.abc import Iterable


def printable(text: str) -> str:
    """Return text as any terminal can show it: escapes and the like spelled out."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def one_line(text: str, limit: int = 60) -> str:
    """Return text as one printable line, cut if it is long."""
    text = text if len(text) <= limit else text[: limit - 3] + "..."
    return printable(text).replace("\n", "\\n")


class ConfigError(ValueError):
    """A command or a config is wrong (exit code 2): one line for each thing that is."""

    def __init__(self, messages: str | Iterable[str]) -> None:
        lines = [messages] if isinstance(messages, str) else messages
        self.messages = [one_line(line, 1000) for line in lines]
        super().__init__(self.messages)

    def __str__(self) -> str:
        return "\n".join(self.messages)


class ConfigWarning(UserWarning):
    """What a config asks for makes little physical sense."""


class OutputError(RuntimeError):
    """Results cannot be read or written where they should be (exit code 1)."""


class DamagedError(OutputError):
    """A file is not what was written: cut short, changed, or none of this program."""
