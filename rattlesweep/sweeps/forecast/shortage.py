"""What this machine is too small for."""

from __future__ import annotations

import os
import shutil
from pathlib import Path


def shortages(memory: float, size: float, directory: Path) -> list[str]:
    """Sentences on what is wanted and not there.

    Parameters
    ----------
    memory, size
        Bytes of memory, and on disk.
    directory
        Where the sweep would be written; need not exist.
    """
    lines = []
    free = free_memory()
    if free is not None and memory > free:
        lines.append(
            f"it needs {memory / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are free; a "
            "smaller block_size needs less"
        )
    place = directory.resolve()
    while not place.exists() and place != place.parent:
        place = place.parent
    space = shutil.disk_usage(place).free
    if size > space:
        lines.append(
            f"it needs {size / 1e9:.1f} GB on disk, and {place} has {space / 1e9:.1f} GB free; "
            "choose another --output"
        )
    return lines


def free_memory() -> int | None:
    """Bytes of memory that can be had; None where the system does not say."""
    try:
        with open("/proc/meminfo") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return 1024 * int(line.split()[1])
    except (OSError, ValueError, IndexError):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None
