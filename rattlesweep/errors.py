"""The two ways a sweep can fail that are the user's to mend, and what only looks like one."""

from collections.abc import Iterable

MAX_LINE = 1000


def printable(text: str) -> str:
    """`text` as any terminal can show it: escapes and the like spelled out, line ends kept."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def one_line(text: str, limit: int = 60) -> str:
    """`text` fit for one line of any terminal: nothing unprintable, and cut if it is long."""
    if len(text) > limit:
        text = text[: limit - 3] + "..."
    return printable(text).replace("\n", "\\n")


class ConfigError(ValueError):
    """A command or a config is wrong (exit code 2).

    Parameters
    ----------
    messages
        One message, or one for each thing that is wrong. Each becomes a single line.
    """

    def __init__(self, messages: str | Iterable[str]) -> None:
        lines = [messages] if isinstance(messages, str) else messages
        self.messages = [one_line(line, MAX_LINE) for line in lines]
        super().__init__(self.messages)

    def __str__(self) -> str:
        return "\n".join(self.messages)


class ConfigWarning(UserWarning):
    """What a config asks for makes little physical sense."""


class OutputError(RuntimeError):
    """Results cannot be read or written where they should be (exit code 1)."""


class DamagedError(OutputError):
    """A file is not what was written: cut short, changed, or none of this program."""
