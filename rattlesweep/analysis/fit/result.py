"""The result of a fit, and its figure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.analysis.fit.film import Film
from rattlesweep.analysis.fit.problem import PARAMETERS
from rattlesweep.arrays import Floats
from rattlesweep.physics.body import Rattleback

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MANY_ROWS = 30  # more are drawn as points, fewer as circles


@dataclass(frozen=True)
class Fit:
    """The result of a fit: best parameters in the units of the body, angles in radians.

    Only `psi_deg` is in degrees; `in_si` has degrees, rpm and SI units.  `intervals`
    are 95 % intervals; `launch` holds launch and dissipation as arguments of
    ``rs.trajectory``; `noise` is the standard deviation of a measured value, in
    `noise_unit`; `remarks` name what the data cannot determine or the model not
    describe.
    """

    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    body: Rattleback
    launch: dict[str, Any]
    noise: float
    noise_unit: str
    rows: int
    remarks: list[str]
    _film: Film = field(repr=False)
    _expected: Floats = field(repr=False)

    @property
    def in_si(self) -> dict[str, tuple[float, float, float, str]]:
        """Value, interval and unit of each parameter with an SI unit, and of angles."""
        sizes = {"rad": (180 / math.pi, "deg")}
        units = self.body.units
        if units is not None:
            sizes |= units.sizes
            sizes["sqrt(g/a)"] = (30 / math.pi / units.time, "rpm")
        in_si = {}
        for name, value in self.values.items():
            if PARAMETERS[name].unit in sizes:
                size, unit = sizes[PARAMETERS[name].unit]
                low, high = self.intervals[name]
                in_si[name] = (size * value, size * low, size * high, unit)
        return in_si

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw data, fit and residuals, and write the figure to `path` if given."""
        from rattlesweep.analysis import style
        from rattlesweep.analysis.onerun.figure import shown

        film = self._film
        value_unit = film.value_column.unit
        value = film.value / value_unit.size
        expected = self._expected / value_unit.size
        line: dict[str, Any] = {"color": style.VERMILION, "linewidth": 1.2}
        if film.kind == "reversal":
            # Single times, which no line joins.
            t = np.arange(1.0, len(value) + 1)
            t_label = "number of the reversal"
            line |= {"linestyle": "none", "marker": "x"}
        else:
            t = film.t / film.t_column.unit.size
            t_label = style.label("time", film.t_column.unit.name)
        marker = "." if len(t) > MANY_ROWS else "o"
        dots: dict[str, Any] = {
            "color": style.BLUE,
            "linestyle": "none",
            "marker": marker,
            "markersize": 2.5,
        }
        with style.styled():
            figure = style.new_figure(7.2, 4.6)
            top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
            top.plot(t, value, label="measured", **dots)
            top.plot(t, expected, label="fit", **line)
            bottom.plot(t, value - expected, **dots)
            bottom.axhline(0, color=style.VERMILION, linewidth=1.0)
            top.set_ylabel(style.label(film.kind, value_unit.name))
            bottom.set_ylabel(style.label("residual", value_unit.name))
            bottom.set_xlabel(t_label)
            top.legend(loc="best")
            if film.kind == "reversal":
                bottom.set_xticks(t)
            for axes in (top, bottom):
                style.light_grid(axes)
            figure.align_ylabels([top, bottom])
            return shown(figure, path)
