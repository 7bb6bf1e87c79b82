"""Runs followed abreast: integrated in lanes side by side, and sampled together.

The states have the bits of :class:`~rattlesweep.kernel.follow.Follower`, which follows
one run.  A fit tries many parameters at once, and most of its time is saved here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rattlesweep.arrays import Floats, Integers, take
from rattlesweep.kernel import batch as batches
from rattlesweep.kernel import recipes
from rattlesweep.kernel.follow import added_up, moved_on
from rattlesweep.kernel.method.tableau import DT, Tableau
from rattlesweep.kernel.outcome import Batch
from rattlesweep.kernel.recorder import (
    SENSE,
    STEPS_PER_CALL,
    T_LOW,
    Recorder,
    Samples,
    Stretch,
    T,
)
from rattlesweep.kernel.state.fields import LANES
from rattlesweep.kernel.state.status import Status
from rattlesweep.motion.chart import ANYWHERE
from rattlesweep.motion.model import Model


@dataclass(frozen=True)
class RunAbreast:
    """A run that was followed to its end, and its states at some times."""

    recorder: Recorder
    run: int  # its number there
    stretch: Stretch
    samples: Samples

    @property
    def model(self) -> Model:
        """The model whose variables the states have."""
        return self.recorder.models[0]

    @property
    def constants(self) -> Mapping[str, Floats]:
        """The constants of the model by name."""
        return self.model.named(self.recorder.batch.constants[self.run])

    @property
    def energy_0(self) -> float:
        """The energy at launch."""
        return self.stretch.energy_0

    def observe(self, samples: Samples) -> Floats:
        """Return what samples show, as `Follower.observe` does."""
        return self.recorder.observe(self.run, samples)


def follow_abreast(
    batch: Batch,
    tableau: Tableau,
    model: Model,
    times: Sequence[Floats],
    *,
    tol: float,
    max_steps: int,
    attitude: bool,
) -> list[RunAbreast | None]:
    """Return runs with their states at increasing times, those up to their ends.

    It is None for a run that has to be followed alone: one that slides, is long, fails
    or leaves the chart of its variables.
    """
    settings = batches.BatchSettings(tol, DT, max_steps, frozenset({"reversals"}))
    followed: list[RunAbreast | None] = [None] * len(batch)
    for rows, own in batches.by_own_model(batch, model):
        slides = recipes.problem_of(own).modes.schedules
        if slides or own.chart is ANYWHERE:
            continue
        part = batches.with_model(take(batch, rows), model, own)
        for first in range(0, len(rows), LANES):
            some = np.arange(first, min(first + LANES, len(rows)))
            recorder = Recorder(
                take(part, some), tableau, own, settings, attitude=attitude
            )
            stretches = recorder.record(1 + STEPS_PER_CALL, begins=True)
            whole = [
                run
                for run, stretch in enumerate(stretches)
                if stretch.ended and stretch.status == Status.OK
            ]
            if not whole:
                continue
            wanted = [times[rows[some[run]]] for run in whole]
            ended = [stretches[run] for run in whole]
            samples = _sampled(recorder, whole, ended, wanted)
            for run, stretch, at_times in zip(whole, ended, samples, strict=True):
                one = RunAbreast(recorder, run, stretch, at_times)
                followed[rows[some[run]]] = one
    return followed


def _sampled(
    recorder: Recorder,
    numbers: list[int],
    stretches: list[Stretch],
    times: list[Floats],
) -> list[Samples]:
    """Return the states at the times of each run, by the numbers of the runs."""
    tables = [stretch.steps for stretch in stretches]
    table = np.concatenate(tables)
    begins = np.cumsum([0, *map(len, tables)])[:-1]
    wanted = []
    places = []
    for begin, steps, some in zip(begins, tables, times, strict=True):
        ends = steps[:, T]
        within = some[: np.searchsorted(some, ends[-1], side="right")]
        before = np.maximum(np.searchsorted(ends, within, side="left") - 1, 0)
        wanted.append(within)
        places.append(begin + before)
    t = np.concatenate(wanted)
    which = np.concatenate(places)
    run = np.repeat(numbers, [len(each) for each in wanted])
    offset = (t - table[which, T]) + table[which, T_LOW]
    y, slip = recorder.between(0, table, which, offset, run)
    extra = np.zeros((len(t), 0))
    if len(recorder.models) > 1:
        begin_of_step = _carried(recorder, numbers, tables, table)
        moved = recorder.moves(table, which, offset, run)
        extra = moved_on(begin_of_step[which], moved)
    sense = table[which, SENSE]
    cuts = np.cumsum([len(each) for each in wanted])[:-1]
    columns = [np.split(values, cuts) for values in (t, y, slip, sense, extra)]
    return [Samples(*of_run) for of_run in zip(*columns, strict=True)]


def _carried(
    recorder: Recorder, numbers: list[int], tables: list[Floats], table: Floats
) -> Floats:
    """Return heading and place in all rows of `table`, the tables below each other."""
    rows = np.cumsum([len(steps) for steps in tables])
    # No step begins in the last row of a table.
    is_begin = np.ones(len(table), bool)
    is_begin[rows - 1] = False
    which: Integers = np.flatnonzero(is_begin)
    length = np.diff(table[:, T])[which] - np.diff(table[:, T_LOW])[which]
    run = np.repeat(numbers, [len(steps) - 1 for steps in tables])
    moved = recorder.moves(table, which, length, run)
    cuts = np.cumsum([len(steps) - 1 for steps in tables])[:-1]
    base = np.zeros(recorder.models[1].n_extra)
    return np.concatenate([added_up(base, part) for part in np.split(moved, cuts)])
