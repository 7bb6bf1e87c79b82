"""A command that is refused."""

from typing import Any


def assert_refused(result: Any, code: int, *words: str) -> None:
    """Check that one line on standard error alone says why, with all of these words."""
    assert (result.exit_code, result.stdout) == (code, "")
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert [part for part in words if part not in result.stderr] == []
