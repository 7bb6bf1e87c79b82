"""Integration of the equations: methods, compiled kernels, batches of runs."""

import os

MOST_THREADS = 4096


class SettingError(ValueError):
    """A setting of Numba in the environment asks for what cannot be (exit code 2)."""


def check_settings() -> None:
    """Raise SettingError for a number of threads at which importing Numba fails."""
    text = os.environ.get("NUMBA_NUM_THREADS", "1")
    if not (text.strip().isdecimal() and 1 <= int(text) <= MOST_THREADS):
        raise SettingError(
            f"NUMBA_NUM_THREADS={ascii(text)[1:-1]}: "
            f"it must be a whole number from 1 to {MOST_THREADS}"
        )
