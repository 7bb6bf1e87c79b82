"""Bondi's threshold over a map, from theory and not from the runs: known between the cells too."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.physics.theory import bondi_threshold
from rattlesweep.analysis.plots.layout import Layout
from rattlesweep.sweeps.bodies.sources import make_source
from rattlesweep.sweeps.config.read import parse_config, resolved


def threshold(layout: Layout, values: Mapping[str, Floats]) -> Floats:
    """Bondi's ``n_c1`` of a grid of bodies with other `values` along its axes, each of several.

    The first of `layout.bodies` varies slowest; where there is no threshold, it is infinite.
    """
    data = resolved(layout.config)
    if "c" in layout.bodies:  # be it among the axes or beside them
        data["bodies"].pop("c", None)
    data["bodies"]["axes"] = {name: values[name].tolist() for name in layout.bodies}
    source = make_source(parse_config(data))
    body = source.bodies(np.nan, np.arange(source.samples))
    n_c1 = bondi_threshold(body.alpha, body.beta, body.gamma, body.theta, body.phi)
    return np.nan_to_num(n_c1, nan=-np.inf)
