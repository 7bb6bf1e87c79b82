"""Provenance: the program, the machine and the command behind the numbers."""

import platform
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path

from rattlesweep.system.processors import processors

PACKAGES = ("numpy", "numba", "llvmlite", "scipy", "pandas", "pyarrow")


def versions() -> dict[str, str]:
    """Return the versions of all that the numbers depend on.

    Stability: stable.
    """
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    # Looking them up takes longer than the rest of a manifest.
    program = {
        "rattlesweep": version("rattlesweep"),
        "python": platform.python_version(),
    }
    return program | {name: version(name) for name in PACKAGES}


def machine() -> dict[str, str | int]:
    """Return system and processor, and how many of them this process may use.

    Stability: stable.
    """
    from llvmlite import binding

    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "cpu": binding.get_host_cpu_name(),
        "processors": processors(),
    }


def now() -> str:
    """Return the time, in UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def command_line() -> list[str]:
    """Return the program and arguments of this process."""
    arguments = [Path(sys.argv[0]).name, *sys.argv[1:]]
    # Arguments need not be UTF-8, but JSON must be.
    return [text.encode(errors="backslashreplace").decode() for text in arguments]
