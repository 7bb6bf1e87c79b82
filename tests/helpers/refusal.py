"""A command that is refused."""

from typing import Any


def assert_refused(result: Any, code: int, *words: str) -> None:
    """Nothing is printed, and one line on standard error says why, with all of these words."""
    assert (result.exit_code, result.stdout) == (code, "")
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    for part in words:
        assert part in result.stderr
