"""Checks of refused commands."""

from typing import Any


def assert_refused(result: Any, code: int, *words: str) -> None:
    """Check that the only output is one line on standard error with all of these
    words.
    """
    refused(result, code, *words)
    assert result.stderr.count("\n") == 1


def refused(result: Any, code: int, *words: str) -> None:
    """Check that the only output is short sentences on standard error, with all of
    these words.
    """
    assert (result.exit_code, result.stdout) == (code, ""), result.output
    assert [part for part in words if part not in result.stderr] == []
    for line in result.stderr.splitlines():
        assert line.startswith("error: ")
        assert line.isprintable()
        assert len(line) < 600
