"""A kernel that is compiled within a second, and its cache; imports little."""

from __future__ import annotations

from typing import Any

from rattlesweep.compiling import loading
from rattlesweep.compiling.loading import Kernel, is_stored, load_kernels


def plus_ten(x: int) -> int:
    return abs(x) + 10


def small(name: str) -> Kernel:
    """Return the kernel, under any name."""
    return Kernel(plus_ten, (-3,), {})


def no_number(x: int) -> int:
    return x + "ten"  # type: ignore[operator]


def broken(name: str) -> Kernel:
    """Return a kernel that Numba cannot compile."""
    return Kernel(no_number, (-3,), {})


def load_small() -> Any:
    """Return the compiled function."""
    return load_kernels((small, "small"))[0]


def again() -> tuple[int, bool]:
    """Return its value as in a new process, and whether it was stored before."""
    loading._loaded.clear()
    forget_folders()
    stored = is_stored(small, "small")
    return load_small()(-3), stored


def forget_folders() -> None:
    loading.cache_folder.cache_clear()
    loading._stored_folder.cache_clear()
