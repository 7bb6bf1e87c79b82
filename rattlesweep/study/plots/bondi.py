"""Bondi's threshold over a map, from theory and not from the runs: exact between the cells too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics.theory import bondi_threshold
from rattlesweep.study.plots.layout import Axis, Layout
from rattlesweep.sweeps.cases.sources import make_source
from rattlesweep.sweeps.config.load import parse_config, resolved

# Points along one axis, and along each of two.
FINE = {1: 2001, 2: 500}


def threshold(
    layout: Layout, axes: Sequence[Axis], fixed: Mapping[str, float]
) -> tuple[list[Floats], Floats]:
    """Bondi's ``n_c1`` over one or two axes of a grid of bodies, at `fixed` values of the others.

    Gives values along each of the axes, much finer than the grid, and ``n_c1`` over the axes in
    their order, NaN where there is no threshold.
    """
    count, names = FINE[len(axes)], [axis.name for axis in axes]
    values = {axis.name: np.linspace(axis.values[0], axis.values[-1], count) for axis in axes}
    # The source numbers bodies with its own first axis slowest.
    order = [name for name in layout.bodies if name in values]
    data = resolved(layout.config)
    if "c" in layout.bodies:  # be it among the axes or beside them
        data["bodies"].pop("c", None)
    data["bodies"]["axes"] = {name: [value] for name, value in fixed.items()} | {
        name: {"linspace": [values[name][0], values[name][-1], float(count)]} for name in order
    }
    source = make_source(parse_config(data))
    body = source.bodies(0, np.arange(source.samples))
    n_c1 = bondi_threshold(body.alpha, body.beta, body.gamma, body.theta, body.phi)
    n_c1 = n_c1.reshape([count] * len(axes))
    return list(values.values()), n_c1 if order == names else n_c1.T
