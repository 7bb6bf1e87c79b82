"""Fractions of the types against one axis."""

import math
from functools import cached_property
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from rattlesweep.analysis import style
from rattlesweep.analysis.layout import LAUNCH_COLUMNS, Axis
from rattlesweep.analysis.plots.picture import (
    ENOUGH,
    WIDE,
    Arrangement,
    Handle,
    Panel,
    Picture,
    scale,
    within,
)
from rattlesweep.analysis.shares import Points, fractions_of, read_points
from rattlesweep.analysis.style import TYPE_STYLE, label
from rattlesweep.arrays import Floats
from rattlesweep.statistics.intervals import share, wilson

_FEW = 6  # with fewer values than this, each value of an abscissa has a tick


class BinnedFractions(Picture):
    """Fractions of the types over bins of any column, in panels by the launches."""

    panel = (2.6, 2.0)

    def arrange(self) -> Arrangement:
        """Make panels of the launches, but for those of very many values."""
        assert self.x is not None
        self.unit, _ = self.layout.column(self.x, "x")
        self.shows = f"that has values of {self.x}"
        lengths = self.layout.lengths
        few = [name for name in self.layout.several if lengths[name] <= _FEW]
        launch = [name for name in few if name in LAUNCH_COLUMNS]
        launch = [name for name in launch if name not in self.wished]
        if self.wished:
            return Arrangement([], launch, self.wished)
        rows = [name for name in launch if name == "omega_xy0"]
        return Arrangement([], rows, [name for name in launch if name not in rows])

    @cached_property
    def points(self) -> Points:
        """The points of the column and of the axes of the panels."""
        return read_points(self.layout, self._by)

    @property
    def _by(self) -> list[str]:
        """The column, and the keys of the axes of the panels."""
        keys = {axis.name: key for key, axis in self.layout.axes.items()}
        return [str(self.x), *(keys[axis.name] for axis in self.axes)]

    def __len__(self) -> int:
        return len(np.unique(self.points.run))

    @cached_property
    def bins(self) -> int:
        """The number of bins: more where a panel has many runs."""
        panels = math.prod(len(axis.values) for axis in self.axes)
        most = 12 if len(self.columns) == 0 else 8
        return int(np.clip(math.isqrt(len(self) // panels) // 2, 3, most))

    def table(self) -> pd.DataFrame:
        """Return the fractions of each bin of each panel, with their intervals."""
        return fractions_of(self.layout, self.points, self._by, self.bins)

    def draw(self, panels: list[Panel], log: bool | None) -> list[Handle]:
        """Stack the types on each other in each bin, with their intervals."""
        table = self.table()
        column = self.layout.name(str(self.x))
        low = float(table[f"{column}_low"].min())
        high = float(table[f"{column}_high"].max())
        log_x = bool(low > 0 and high > WIDE * low) if log is None else log
        entries: dict[str, Handle] = {}
        panel_axes = [*self.rows, *self.columns]
        for axes, place, is_lowest in panels:
            here = table
            for axis, k in zip(panel_axes, place, strict=True):
                here = here[here[axis.name] == axis.values[k]]
            self._stack(axes, here, column, entries)
            style.scale_axis(axes, "x", (low, high), log_x, column)
            if is_lowest:
                axes.set_xlabel(label(str(self.x), self.unit))
            axes.set(ylim=(0, 1), yticks=self.ticks)
            if low < high:
                axes.set_xlim(low, high)
        self.ylabel = "fraction of runs"
        self.notes.append(
            f"Fractions of {len(self):,} runs over bins with equal numbers of them, "
            "with 95 % intervals (Wilson)."
        )
        if self.layout.refined:
            self.notes.append("A run counts for the points nearest to it.")
        return list(entries.values())

    def _stack(
        self, axes: Axes, here: pd.DataFrame, column: str, entries: dict[str, Handle]
    ) -> None:
        """Draw the types of one panel, and note their legend entries."""
        low = here[f"{column}_low"].to_numpy()
        high = here[f"{column}_high"].to_numpy()
        centre = here[column].to_numpy()
        if (low == high).all():
            # A bin around each value.
            edges = Axis(column, centre, np.arange(len(centre))).edges
            low = edges[:-1]
            high = edges[1:]
        below = np.zeros(len(here))
        for name, mark in TYPE_STYLE.items():
            if f"fraction_{name}" not in here:
                continue
            fraction = here[f"fraction_{name}"].to_numpy()
            bars = axes.bar(
                low,
                fraction,
                high - low,
                below,
                align="edge",
                facecolor=mark.colour,
                hatch=mark.hatch,
                linewidth=0,
            )
            if fraction.any():
                entries[mark.label] = bars[0]
                bars[0].set_label(mark.label)
            below = below + fraction
            effective = here["runs_effective"].to_numpy()
            # Rounding must not leave a border inside that is at the top.
            border = np.where(below > 1 - 1e-9, 1.0, below)
            _draw_intervals(axes, centre, border * effective, effective)


class Fractions(Picture):
    """Fractions of the types against the first axis, in panels by the others."""

    panel = (1.7, 1.6)

    def arrange(self) -> Arrangement:
        """Make the oscillation, or else one of several further axes, the rows."""
        first, *rest = self.ordered(ENOUGH)
        if self.wished:
            return Arrangement([first], rest, self.wished)
        rest.sort(key=lambda name: (name != "omega_xy0", name not in LAUNCH_COLUMNS))
        rows = 0
        if len(rest) > 1 or rest == ["omega_xy0"]:
            rows = 1
        return Arrangement([first], rest[:rows], rest[rows:])

    def told(self) -> tuple[str, str]:
        """Return the words and the column for what reverses."""
        return "Fraction that reverses", "fraction_R"

    def draw(self, panels: list[Panel], log: bool | None) -> list[Handle]:
        """Stack the types on each other, with the intervals of their borders."""
        x = self.axes[0]
        cells = self.counted[0]
        bondi = self.grid(share(cells["bondi"], cells["steady"]))
        entries: dict[str, Handle] = {}
        stable: list[Handle] = []
        names = [name for name in TYPE_STYLE if name in cells.types]
        has_bondi = bool(np.isfinite(bondi).any())
        if has_bondi and "SS" in names:
            # Where theory is right, its share ends at the border of steady spinning.
            names.remove("SS")
            names.insert(0, "SS")
        for axes, place, _ in panels:
            self._stack(axes, place, names, entries)
            if has_bondi:
                [triangles] = axes.plot(
                    x.values,
                    within(bondi, place),
                    "k^",
                    label=style.STABLE,
                    clip_on=False,
                    markersize=4,
                    markeredgecolor="white",
                    markeredgewidth=0.5,
                    zorder=5,
                )
                stable = [triangles]
            scale(axes, "x", x, log)
            if len(x.values) < _FEW:
                _tick_each(axes, x)
            ends = x.stretches[0][1][0], x.stretches[-1][1][-1]
            axes.set(xlim=ends, ylim=(0, 1), yticks=self.ticks)
        self.ylabel = "fraction of bodies"
        self.notes.append(
            "Fractions of the runs with status ok, with 95 % intervals (Wilson)."
        )
        if has_bondi:
            self.notes.append(
                "The height of a triangle is the fraction of the bodies whose steady "
                "spin theory finds stable: |n_c1| < |n_i|."
            )
        kinds = [TYPE_STYLE[name].label for name in names]
        return [*(entries[kind] for kind in kinds if kind in entries), *stable]

    def _stack(
        self,
        axes: Axes,
        place: tuple[int, ...],
        names: list[str],
        entries: dict[str, Handle],
    ) -> None:
        """Draw the types of one panel from below, and note their legend entries."""
        x = self.axes[0]
        cells = self.counted[0]
        ok = within(self.grid(cells["ok"]), place)
        count = np.zeros(len(x.values))
        for name in names:
            mark = TYPE_STYLE[name]
            its = within(self.grid(cells.types[name]), place)
            if not its.any():
                continue
            below = share(count, ok)
            count = count + its
            above = share(count, ok)
            for places, edges in x.stretches:
                entries[mark.label] = axes.stairs(
                    above[places],
                    edges,
                    baseline=below[places],
                    fill=True,
                    label=mark.label,
                    facecolor=mark.colour,
                    hatch=mark.hatch,
                    linewidth=0,
                )
            _draw_intervals(axes, x.values, count, ok)


def _draw_intervals(axes: Axes, x: Floats, count: Floats, ok: NDArray[Any]) -> None:
    """Draw Wilson's interval of an upper border, a fraction of the runs itself."""
    border = share(count, ok)
    low, high = wilson(count, ok)
    inside = (count > 0) & (count < ok)
    lengths = np.stack([border - low, high - border])[:, inside]
    axes.errorbar(
        x[inside],
        border[inside],
        lengths,
        fmt="none",
        ecolor=style.BLACK,
        elinewidth=0.9,
        capsize=1.6,
        zorder=4,
    )


def _tick_each(axes: Axes, x: Axis) -> None:
    """Write the values at the abscissa, the ends first where there is little room."""
    words = [style.number_text(value) for value in x.values]
    grid: Any = axes.get_gridspec()
    # In points; a letter is about 0.62 of the size of the font wide.
    width = 72 * (grid.figure.get_figwidth() - 1.2) / grid.ncols
    letter = 0.62 * float(mpl.rcParams["font.size"])
    low, high = x.edges[[0, -1]]
    places = (x.values - low) / (high - low)
    if axes.get_xscale() == "log":
        places = np.log(x.values / low) / np.log(high / low)
    shown: list[int] = []
    ends = (0, len(words) - 1)
    for k in sorted(range(len(words)), key=lambda k: k not in ends):
        half = letter * (len(words[k]) + 1) / 2
        if all(
            abs(places[k] - places[other]) * width
            > half + letter * (len(words[other]) + 1) / 2
            for other in shown
        ):
            shown.append(k)
    axes.set_xticks(
        x.values, [word if k in shown else "" for k, word in enumerate(words)]
    )
