"""Mean reversal times, or their ratios to theory, against one axis."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba

from rattlesweep.analysis import style
from rattlesweep.analysis.plots.picture import (
    ENOUGH,
    Arrangement,
    Handle,
    Panel,
    Picture,
    scale,
    texts,
    within,
)
from rattlesweep.analysis.style import SERIES, THEORY, label
from rattlesweep.arrays import Floats

MOST_MARKERS = 40  # more markers would hide the curve
# Theory at a single abscissa, where a line has no length.
SINGLE: dict[str, Any] = {"linestyle": "", "marker": "_", "markersize": 12}


class CurveLook(NamedTuple):
    """A curve: its place on the second axis, its colour and marker."""

    place: int
    colour: str
    marker: str


class CurveValues(NamedTuple):
    """The values of a curve; `theory` is the mean of t_rGH."""

    mean: Floats
    spread: Floats
    theory: Floats


class Times(Picture):
    """The mean of ``t_r``, or of ``t_r/t_rGH``, over type R, and theory dashed."""

    panel = (2.6, 2.8)

    def arrange(self) -> Arrangement:
        """Make the longest of the other axes the curves of a panel."""
        prefer = "n_i" if self.is_relative else ""
        first, *rest = self.ordered(ENOUGH, prefer)
        rest.sort(key=lambda name: -self.layout.lengths[name])
        return Arrangement([first, *rest[:1]], [], [*self.wished, *rest[1:]])

    @property
    def is_relative(self) -> bool:
        """Whether the times are divided by those of theory."""
        return self.name == "ratio"

    def told(self) -> tuple[str, str]:
        """Return the words and the column for the times, or their ratios."""
        if self.is_relative:
            return "Mean of t_r/t_rGH", "ratio_mean"
        return "Mean time until the first reversal", f"{self.layout.name('t_r')}_mean"

    def draw(self, panels: list[Panel], log: bool | None) -> list[Handle]:
        """Draw a curve with a band for each value of the second axis."""
        x, *curve_axes = self.inside
        looks = self._looks()
        # The axis of ratios is linear and begins at 0.
        log_y = log is not False
        if self.is_relative:
            log_y = bool(log)
        curves = self._curves()
        # The curves of the two directions of spin are not joined.
        stretches = [places for places, _ in x.stretches]
        for axes, place, _ in panels:
            scale(axes, "x", x, log)
            for look in looks:
                here = CurveValues(
                    *(within(values, (look.place, *place)) for values in curves)
                )
                for stretch in stretches:
                    piece = CurveValues(*(values[stretch] for values in here))
                    self._draw_piece(axes, x.values[stretch], piece, look, log_y)
        for axes, *_ in panels:
            style.light_grid(axes)
            if len(x.values) == 1:
                axes.set_xticks(x.values)
            if self.is_relative:
                axes.axhline(1, **THEORY, zorder=1.5)
            if log_y:
                axes.set_yscale("log")
                style.plain_ticks(axes, "y", *axes.get_ylim())
            elif self.is_relative:
                highest = np.nanmax(curves.mean + curves.spread, initial=1.0)
                axes.set_ylim(0, 1.08 * float(highest))
        self._label(len(looks))
        handles: list[Handle] = []
        shown = curves.mean
        if not self.is_relative:
            # Where nothing reverses, the theory still has a curve.
            shown = np.fmax(curves.mean, curves.theory)
        if curve_axes:
            for look in looks:
                if not np.isfinite(shown[:, look.place]).any():
                    continue
                name = texts(curve_axes, [look.place])
                handles.append(
                    style.entry(
                        name, color=look.colour, marker=look.marker, ms=4, ls="-"
                    )
                )
        if not self.is_relative and not np.isfinite(curves.theory).any():
            return handles
        theory: dict[str, Any] = dict(THEORY)
        if len(x.values) == 1 and not self.is_relative:
            theory = SINGLE | {"color": style.INK}
        return [*handles, style.entry(style.OF_THEORY, **theory)]

    @property
    def _count(self) -> int:
        """The number of curves."""
        if len(self.inside) < 2:
            return 1
        return len(self.inside[1].values)

    def _looks(self) -> list[CurveLook]:
        """Return the curves, no more than there are markers.

        A value of a sweep has its colour in all figures.
        """
        places = np.linspace(0, self._count - 1, min(self._count, len(SERIES)))
        if len(self.inside) < 2:
            colour, marker = SERIES[0]
            return [CurveLook(0, colour, marker)]
        axis = self.inside[1]
        count = len(axis.values if axis.every is None else axis.every)
        looks = []
        for rank, place in enumerate(places.astype(int).tolist()):
            of_sweep = int(axis.places[place])
            _, marker = SERIES[of_sweep if count <= len(SERIES) else rank]
            looks.append(CurveLook(place, style.colour_of(of_sweep, count), marker))
        return looks

    def _curves(self) -> CurveValues:
        """Return the values on the grid of the axes, of which the second is curves."""
        cells = self.counted[0]
        moments = cells.ratio if self.is_relative else cells.t_r
        curves = CurveValues(
            mean=self.grid(moments.means()),
            spread=self.grid(np.nan_to_num(moments.deviations())),
            theory=self.grid(cells.t_rgh.means()),
        )
        if len(self.inside) < 2:
            return CurveValues(*(np.expand_dims(values, 1) for values in curves))
        return curves

    def _draw_piece(
        self, axes: Axes, x: Floats, curve: CurveValues, look: CurveLook, log_y: bool
    ) -> None:
        """Draw a curve in one direction of spin, with its band and its theory."""
        few = len(self.axes[0].values) <= MOST_MARKERS
        # Markers with bars stand beside each other, as they would hide one another.
        beside = self._beside(axes, x, look) if few else x
        axes.plot(
            beside,
            curve.mean,
            color=look.colour,
            linewidth=1.1,
            markersize=4,
            marker=look.marker if few else None,
        )
        below = curve.spread
        if log_y:
            # A logarithmic axis has no zero: the band ends at a tenth of the mean.
            below = np.minimum(below, 0.9 * curve.mean)
        if few:
            axes.errorbar(
                beside,
                curve.mean,
                np.stack([below, curve.spread]),
                fmt="none",
                ecolor=look.colour,
                elinewidth=0.8,
                capsize=1.5,
            )
        else:
            axes.fill_between(
                x,
                curve.mean - below,
                curve.mean + curve.spread,
                facecolor=to_rgba(look.colour, 0.1),
                edgecolor=to_rgba(look.colour, 0.6),
                linewidth=0.4,
            )
        if not self.is_relative:
            # A single abscissa has no line: a short dash is seen there.
            dashes = SINGLE if len(self.axes[0].values) == 1 else THEORY
            axes.plot(x, curve.theory, **dashes | {"color": look.colour, "zorder": 1.5})

    def _beside(self, axes: Axes, x: Floats, look: CurveLook) -> Floats:
        """Return the abscissas of a curve's markers, next to those of other curves."""
        looks = self._looks()
        if len(looks) == 1 or len(self.axes[0].values) == 1:
            return x
        values = self.axes[0].values
        rank = [other.place for other in looks].index(look.place)
        part = 0.15 * (rank - (len(looks) - 1) / 2) / len(looks)
        if axes.get_xscale() == "log":
            moved: Floats = x * np.exp(part * np.diff(np.log(values)).min())
        else:
            moved = x + part * np.diff(values).min()
        return moved

    def _label(self, drawn: int) -> None:
        """Set the label and the sentences of the caption."""
        if self.is_relative:
            self.ylabel = label("ratio")
            quantity = "t_r/t_rGH"
            theory = "Theory: Garcia and Hubbard's t_rGH"
        else:
            self.ylabel = label(self.layout.name("t_r"))
            quantity = "the time t_r of the first reversal"
            theory = "Theory: Garcia and Hubbard's t_rGH, mean over all runs"
        if self.layout.stored.config.dissipation:
            theory += ", without friction"
        self.notes += [
            f"Mean of {quantity} over the runs that reverse (type R), with its "
            "standard deviation.",
            f"{theory}.",
        ]
        if drawn > 1 and 1 < len(self.axes[0].values) <= MOST_MARKERS:
            self.notes.append("Markers at one abscissa stand beside each other.")
        if drawn < self._count:
            self.notes.append(f"{drawn} of {self._count} values are shown.")
