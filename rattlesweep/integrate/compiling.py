"""Who hears that a kernel is being compiled, the one long wait of a first use."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

# Given a kernel's name; what it makes lasts as long as the compilation.
Listener = Callable[[str], AbstractContextManager[object]]
_listeners: list[Listener] = []


@contextmanager
def listening(listener: Listener | None) -> Iterator[None]:
    """Have a listener hear of the compilations inside ``with``, in all threads; None: nobody."""
    _listeners.append(listener or nullcontext)
    try:
        yield
    finally:
        _listeners.pop()


def compiling(kernel: str) -> AbstractContextManager[object]:
    """To be entered around a compilation; the innermost listener hears of it."""
    return _listeners[-1](kernel) if _listeners else nullcontext()
