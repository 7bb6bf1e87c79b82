"""Processors and threads that this process may use."""

import math
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from threading import Thread

from rattlesweep.words.errors import OutputError

MOST_THREADS = 4096


class SettingError(ValueError):
    """An environment variable of Numba has an impossible value (exit code 2)."""


def processors() -> int:
    """Return the number of processors that this process may use.

    A container may be allowed the time of fewer than it may run on.
    """
    allowed = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        allowed = len(os.sched_getaffinity(0))
    quota = math.ceil(processor_time())
    return max(1, min(allowed, quota)) if quota else allowed


def processor_time(proc: Path = Path("/proc/self")) -> float:
    """Return how many processors' time the control groups of Linux allow; 0: any."""
    quotas = []
    with suppress(OSError, ValueError):
        for folder in _control_groups(proc):
            quota = _quota(folder)
            if quota > 0:
                quotas.append(quota)
    return min(quotas, default=0.0)


def _control_groups(proc: Path) -> Iterator[Path]:
    """Yield the folders of this process' groups of processor time, and of theirs."""
    groups: dict[str, str] = {}  # by version
    for line in (proc / "cgroup").read_text().splitlines():
        _, controllers, group = line.split(":", 2)
        if not controllers:
            groups["cgroup2"] = group
        elif "cpu" in controllers.split(","):
            groups["cgroup"] = group
    for line in (proc / "mountinfo").read_text().splitlines():
        mount, _, system = line.partition(" - ")
        kind, _, options = system.split(" ", 2)
        _, _, _, root, place, *_ = mount.split(" ")
        is_of_time = kind == "cgroup2" or "cpu" in options.split(",")
        if kind not in groups or not is_of_time:
            continue
        # A container may see its own group as the root, under its name outside.
        inside = groups[kind].removeprefix(root.rstrip("/"))
        folder = Path(place) / inside.strip("/")
        while True:
            yield folder
            if folder == Path(place) or Path(place) not in folder.parents:
                break
            folder = folder.parent


def _quota(folder: Path) -> float:
    """Return how many processors' time a group may use; 0: any."""
    with suppress(OSError, ValueError):
        limit, period = (folder / "cpu.max").read_text().split()
        return 0.0 if limit == "max" else int(limit) / int(period)
    with suppress(OSError, ValueError):
        limit = (folder / "cpu.cfs_quota_us").read_text()
        return int(limit) / int((folder / "cpu.cfs_period_us").read_text())
    return 0.0


def check_settings() -> None:
    """Raise SettingError if NUMBA_NUM_THREADS would make importing Numba fail."""
    text = os.environ.get("NUMBA_NUM_THREADS", "1")
    if not (text.strip().isdecimal() and 1 <= int(text) <= MOST_THREADS):
        raise SettingError(
            f"NUMBA_NUM_THREADS={ascii(text)[1:-1]}: "
            f"it must be a whole number from 1 to {MOST_THREADS}"
        )


def start_thread(thread: Thread) -> None:
    """Start a thread; an OutputError says that the system has no more of them."""
    try:
        thread.start()
    except RuntimeError as error:
        raise OutputError(
            f"{error}; the system's limit of threads or memory is reached"
        ) from None
