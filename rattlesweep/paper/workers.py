"""Long compiled calls side by side, with Ctrl-C heard while they last."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

T = TypeVar("T")
# Seconds between two looks at Ctrl-C.
POLL = 0.05


def side_by_side(
    tasks: Sequence[Callable[[], T]], threads: int, report: Callable[[float], None]
) -> list[T]:
    """Results of tasks, in their order.

    Parameters
    ----------
    tasks : sequence of callable
        Each lets other threads run while it lasts.
    threads : int
    report : callable
        Called in this thread with the share that is done.  What it or a task raises is raised
        here, and no further task is begun.
    """
    left = iter(range(len(tasks)))
    results: dict[int, T] = {}
    errors: list[BaseException] = []
    stop = threading.Event()
    lock = threading.Lock()

    def work() -> None:
        while not stop.is_set():
            with lock:
                place = next(left, None)
            if place is None:
                return
            try:
                results[place] = tasks[place]()
            except BaseException as error:
                errors.append(error)
                stop.set()
                return

    # Daemons: one that is inside a long call does not keep the process from ending.
    team = [threading.Thread(target=work, daemon=True) for _ in range(min(threads, len(tasks)))]
    for thread in team:
        thread.start()
    try:
        while any(thread.is_alive() for thread in team):
            for thread in team:
                thread.join(POLL / len(team))
            report(len(results) / len(tasks))
    finally:
        stop.set()
    if errors:
        raise errors[0]
    return [results[place] for place in range(len(tasks))]
