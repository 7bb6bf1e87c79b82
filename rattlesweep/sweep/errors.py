"""The two ways a sweep can fail that are the user's to mend."""

from collections.abc import Iterable


class ConfigError(ValueError):
    """A command or a config is wrong (exit code 2).

    Parameters
    ----------
    messages
        One message, or one for each thing that is wrong. Each is a single line.
    """

    def __init__(self, messages: str | Iterable[str]) -> None:
        self.messages = [messages] if isinstance(messages, str) else list(messages)
        super().__init__(self.messages)

    def __str__(self) -> str:
        return "\n".join(self.messages)


class OutputError(RuntimeError):
    """Results cannot be read or written where they should be (exit code 1)."""
