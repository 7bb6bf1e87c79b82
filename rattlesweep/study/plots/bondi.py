"""Bondi's threshold over a map, from theory and not from the runs: exact between the cells too."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.physics.theory import bondi_threshold
from rattlesweep.study.plots.layout import Axis, Layout
from rattlesweep.sweeps.cases.sources import make_source
from rattlesweep.sweeps.config.load import parse_config, resolved

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

FINE = 2001
FINE_PLANE = 500


def threshold_line(
    layout: Layout, along: Axis, fixed: Mapping[str, float]
) -> tuple[Floats, Floats]:
    """Bondi's ``n_c1`` along an axis of a grid of bodies.

    Parameters
    ----------
    layout
    along : Axis
        An axis of the grid.
    fixed
        Values of its other axes.

    Returns
    -------
    values, n_c1 : ndarray
        Along the axis, much finer than the grid; NaN where there is no threshold.
    """
    n_c1 = _thresholds(layout, [along], FINE, fixed)
    return np.linspace(along.values[0], along.values[-1], FINE), n_c1


def threshold_plane(
    layout: Layout, x: Axis, y: Axis, fixed: Mapping[str, float]
) -> tuple[Floats, Floats, Floats]:
    """Fine values of two axes of a grid and Bondi's ``n_c1`` over them, shape (y, x)."""
    # The source numbers bodies with its own first axis slowest.
    order = [axis for axis in layout.grid if axis.name in (x.name, y.name)]
    plane = _thresholds(layout, order, FINE_PLANE, fixed).reshape(FINE_PLANE, FINE_PLANE)
    a, b = (np.linspace(axis.values[0], axis.values[-1], FINE_PLANE) for axis in (x, y))
    return a, b, plane.T if order[0].name == x.name else plane


def _thresholds(layout: Layout, axes: list[Axis], count: int, fixed: Mapping[str, float]) -> Floats:
    data = resolved(layout.config)
    finer = {
        axis.name: {"linspace": [float(axis.values[0]), float(axis.values[-1]), float(count)]}
        for axis in axes
    }
    data["bodies"]["axes"] = {name: [value] for name, value in fixed.items()} | finer
    source = make_source(parse_config(data))
    body = source.bodies(0, np.arange(source.samples))
    return bondi_threshold(body.alpha, body.beta, body.gamma, body.theta, body.phi)
