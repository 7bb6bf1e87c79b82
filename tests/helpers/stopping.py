"""Engines that break off, and a sweep that is begun again until it is through."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

from rattlesweep.sweeps.old.session import Session

from rattlesweep.sweeps.old import local


class Stop(Exception):
    """The engine has had enough."""


def after(blocks: int | Callable[[], int], dice: random.Random | None = None) -> Any:
    """An engine that breaks off after so many blocks; with dice, in any order."""

    def some(session: Session) -> None:
        if dice is not None:
            dice.shuffle(session.pending)
        del session.pending[blocks if isinstance(blocks, int) else blocks() :]
        local.work_off(session)
        raise Stop

    return some


def again_and_again(
    sweep: Callable[..., Any], most: int, dice: random.Random, harm: Callable[[int], None]
) -> int:
    """Call ``sweep(engine=...)`` until it is through, with harm after each stop; how many stops."""
    for trial in range(200):
        try:
            sweep(engine=after(lambda: dice.randint(1, most), dice))
        except Stop:
            harm(trial)
        else:
            return trial
    raise AssertionError("it does not end")
