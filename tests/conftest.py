"""What holds for the whole of a test run."""

from __future__ import annotations

import gc
import signal
import tempfile
from collections.abc import Iterator
from contextlib import nullcontext

import pytest

# The files that take longest begin first, so that no worker is left alone with one at the end.
LONGEST = ("test_run", "test_dask", "test_paper_run", "test_show", "test_harm", "test_transcripts",
           "test_stop_resume", "test_decide", "test_tutorial", "test_sensitivity", "test_plot",
           "test_invariance", "test_report", "test_merge", "test_compare")  # fmt: skip

# What is imported stays: to look for garbage in it again and again is a twelfth of the time.
gc.disable()

# A shell that starts the tests in the background has them, and all they start, ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of `LONGEST` before the others."""
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path.stem, len(LONGEST)))


def pytest_collection_finish() -> None:
    """Look for garbage in what the tests make, from here on."""
    gc.collect()
    gc.freeze()
    gc.enable()


def pytest_unconfigure() -> None:
    gc.unfreeze()  # libraries would call it leaked


@pytest.fixture(scope="session", autouse=True)
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Make temporary directories in pytest's own, and let no command tell of compilation."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(tmp_path_factory.mktemp("tempfile")))
        patch.setattr("rattlesweep.cli.options.listening", lambda listener: nullcontext())
        yield


@pytest.fixture(autouse=True)
def signal_handlers() -> Iterator[None]:
    """Give back the handlers of signals: a command that ends in this process leaves its own."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
