"""Executors that integrate blocks of a given size, and may give up."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any
from unittest.mock import patch

import numpy as np

from rattlesweep.store import merging
from rattlesweep.work.job import Job, Keys
from rattlesweep.work.run import local


class Stop(Exception):
    """The executor gives up."""


def cut(rows: int, most: int = 10**9, dice: random.Random | None = None) -> Any:
    """Return an executor for blocks of `rows` runs, each of which has a file, which
    gives up after `most` blocks.
    """

    def executor(work: Job, blocks: Iterator[Keys]) -> None:
        case, sample = (np.concatenate(keys) for keys in zip(*blocks, strict=True))
        order = np.lexsort((sample, case))
        pieces = []
        for first in range(0, len(case), rows):
            chosen = order[first : first + rows]
            pieces.append((case[chosen], sample[chosen]))
        if dice is not None:
            dice.shuffle(pieces)
        with patch.object(merging, "FILE_BYTES", 1):
            local(work, iter(pieces[:most]))
        if len(pieces) > most:
            raise Stop

    return executor
