"""Engines that integrate blocks of a given size, and may give up."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import numpy as np

from rattlesweep.sweeps.job import Job, Keys
from rattlesweep.sweeps.run import local


class Stop(Exception):
    """The engine gives up."""


def cut(rows: int, most: int = 10**9, dice: random.Random | None = None) -> Any:
    """Return an engine for blocks of `rows` runs, which gives up after `most`
    blocks.
    """

    def engine(work: Job, blocks: Iterator[Keys]) -> None:
        case, sample = (np.concatenate(part) for part in zip(*blocks, strict=True))
        parts = [
            (case[k : k + rows], sample[k : k + rows])
            for k in range(0, len(case), rows)
        ]
        if dice is not None:
            dice.shuffle(parts)
        local(work, iter(parts[:most]))
        if len(parts) > most:
            raise Stop

    return engine
