"""What holds for the whole of a test run."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator

import pytest


@pytest.fixture(scope="session", autouse=True)
def temporary_directories(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Make temporary directories in pytest's own, which no cleaner removes during a run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(tmp_path_factory.mktemp("tempfile")))
        yield
