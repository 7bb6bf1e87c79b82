"""Checks of refused commands."""

from typing import Any


def assert_refused(result: Any, code: int, *words: str) -> None:
    """Check that the only output is one line on standard error with all of these words."""
    assert (result.exit_code, result.stdout) == (code, "")
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert [part for part in words if part not in result.stderr] == []
