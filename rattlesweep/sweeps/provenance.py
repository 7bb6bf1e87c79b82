"""Where numbers come from: this program, this machine, this moment, and what determines them."""

from __future__ import annotations

import os
import platform
import sys
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("numpy", "numba", "llvmlite", "scipy", "pandas", "pyarrow")


def package_version() -> str:
    """Version of rattlesweep."""
    try:
        return version("rattlesweep")
    except PackageNotFoundError:
        return "unknown"


def now(timespec: str = "seconds") -> str:
    """The time, in UTC."""
    return datetime.now(UTC).isoformat(timespec=timespec)


def command_line() -> list[str]:
    """The words of the command that this process is."""
    words = [Path(sys.argv[0]).name, *sys.argv[1:]]
    # A path need not be UTF-8, and JSON must.
    return [word.encode(errors="backslashreplace").decode() for word in words]


def machine() -> dict[str, Any]:
    """Return system, processor and the number of processors that this process may use."""
    from llvmlite import binding

    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "cpu": binding.get_host_cpu_name(),
        "processors": allowed,
    }


def peak_memory() -> int | None:
    """Most memory this process has held, in bytes; None where the system does not say."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    return {
        "rattlesweep": package_version(),
        "python": platform.python_version(),
        **{name: version(name) for name in PACKAGES},
    }
