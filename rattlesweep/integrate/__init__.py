"""Integration of the equations: methods, compiled kernels, batches of runs."""

import os

MOST_THREADS = 4096


class SettingError(ValueError):
    """An environment variable of Numba has an impossible value (exit code 2)."""


def processors() -> int:
    """Return the number of processors that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_settings() -> None:
    """Raise SettingError if NUMBA_NUM_THREADS would make importing Numba fail."""
    text = os.environ.get("NUMBA_NUM_THREADS", "1")
    if not (text.strip().isdecimal() and 1 <= int(text) <= MOST_THREADS):
        raise SettingError(
            f"NUMBA_NUM_THREADS={ascii(text)[1:-1]}: "
            f"it must be a whole number from 1 to {MOST_THREADS}"
        )
