"""States and constants of a model in slopes, in the variables of any position."""

from __future__ import annotations

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.motion.chart import ANYWHERE, SLOPES
from rattlesweep.motion.model import Model
from rattlesweep.physics import full


def from_slopes(model: Model, y: Floats, constants: Floats) -> tuple[Floats, Floats]:
    """Return states and constants of runs, a row each, for `Model.anywhere`.

    What the runs lack there does not act on them.
    """
    there = model.anywhere
    assert there is not None
    u, omega = full.to_vectors(y[:, : full.N_STATE].T)
    place = len(ANYWHERE.place)
    states = np.zeros((len(y), there.n_state))
    states[:, :place] = np.hstack([u.T, omega.T])
    for name in there.components[place:]:
        if name in model.components:
            states[:, there.column(name)] = y[:, model.column(name)]
    named = model.named(constants.T)
    columns = []
    for name in there.of_runs:
        values = named.get(name, np.full(len(y), there.fixed.get(name, 0.0)))
        columns.append(values)
    return states, np.stack(columns, axis=1)


def to_slopes(model: Model, y: Floats) -> Floats:
    """Return states of a model in slopes from those of `Model.anywhere`."""
    there = model.anywhere
    assert there is not None
    slopes = y[:, :2] / y[:, 2:3]
    others = model.components[len(SLOPES.place) - 3 :]
    return np.hstack([slopes, y[:, [there.column(name) for name in others]]])
