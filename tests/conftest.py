"""Settings and fixtures of the whole test run."""

from __future__ import annotations

import gc
import signal
import tempfile
from collections.abc import Iterator
from contextlib import closing, nullcontext
from typing import Any

import pytest
import quick_kernels
from compiler import Compiler

# The longest files start first, so that both workers finish at about the same time.
LONGEST = (
    "test_run",
    "test_dask",
    "test_paper_run",
    "test_show",
    "test_harm",
    "test_transcripts",
    "test_stop_resume",
    "test_decide",
    "test_tutorial",
    "test_sensitivity",
    "test_plot",
    "test_invariance",
    "test_report",
    "test_merge",
    "test_compare",
)

# Imported modules are never garbage, and collecting them again and again took 8 % of
# the time.
gc.disable()

# Shells make background jobs ignore Ctrl-C, and their children inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Move the tests in `LONGEST` to the front."""
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path.stem, len(LONGEST)))


def pytest_collection_finish() -> None:
    """Collect garbage from here on, but only among the objects that tests create."""
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let quick tests use no kernel that few of them need."""
    quick_kernels.is_quick = item.get_closest_marker("slow") is None


def pytest_unconfigure() -> None:
    gc.unfreeze()  # otherwise some libraries report leaks


@pytest.fixture(scope="session", autouse=True)
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep temporary files in pytest's own directory, compile kernels in one process,
    and hide messages about compilation.
    """
    with pytest.MonkeyPatch.context() as patch, closing(Compiler()) as compiler:
        patch.setattr(tempfile, "tempdir", str(tmp_path_factory.mktemp("tempfile")))
        patch.setattr("rattlesweep.compiling.loading._start_child", compiler.start)
        patch.setattr("rattlesweep.compiling.loading.PROCESSES", 1)
        patch.setattr("rattlesweep.compiling.loading._load", quick_kernels.load)
        patch.setattr(
            "rattlesweep.cli.options.listening", lambda listener: nullcontext()
        )
        yield


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """Chromium for the tests of one file, as its event loop would disturb others."""
    from browser import launched

    with launched() as it:
        yield it


@pytest.fixture(autouse=True)
def signal_handlers() -> Iterator[None]:
    """Restore the signal handlers, which commands replace when they run in this
    process.
    """
    before = {
        number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)
    }
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
