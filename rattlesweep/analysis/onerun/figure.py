"""The figure of one run: its spin with the theory, its oscillations with their envelopes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rattlesweep.arrays import Floats, Places
from rattlesweep.analysis import style
from rattlesweep.analysis.onerun.channels import CHANNELS
from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.analysis.onerun.rows import Rows
from rattlesweep.analysis.style import BLUE, GREY, INK, RATE, TIME, UNITS, VERMILION
from rattlesweep.sweeps.single import Launch

WIDTH, DPI = 7.2, 160
# Every period of the pitch is to be seen, as far as the points are not too many.
ROWS = Rows(per_period=24, most=400_001)
# Stretches of which no more than the least and the largest value are drawn.
BINS = 1600
# Of more reversals than this only the first is marked.
MARKS = 12
CURVES = {"full": "full dynamics", "reduced": "reduced model", "gh": "Garcia and Hubbard"}
SHOWN = {"full": ("n", "omega_x", "omega_y"), "reduced": ("n", "E_p", "E_r"), "gh": ("n",)}


def course_of(
    run: Launch | PreparedRun,
    shown: Sequence[str] | None = None,
    watch: Callable[[float], None] | None = None,
    from_time: float | None = None,
) -> Course:
    """The run at the times and with the channels that its figure needs, from a time on.

    ``shown`` are the channels to be drawn, by default what suits the model.  Energies of the
    reduced model ask for it beside the full one.
    """
    launch = run if isinstance(run, Launch) else None
    model: str = run.model if isinstance(run, Launch) else run[0].model
    names = ["t", *(SHOWN[model] if shown is None else shown)]
    if "n" in names:
        names += ["n_gh"] * (model != "gh")
        if model == "full" and launch and (launch.e_p0, launch.e_r0) != (None, None):
            names.append("n_reduced")
    return Course(
        run,
        channels=list(dict.fromkeys(names)),
        rows=replace(ROWS, from_time=from_time),
        watch=watch,
    )


def save(course: Course, path: Path) -> None:
    """Integrate, draw and write a figure, in the format of the file's ending."""
    columns = course.columns()
    with style.styled():
        style.save(draw(columns, course, describe(course)), [path], DPI)


def describe(course: Course) -> str:
    """Which run: one line."""
    values = dict(course.body)
    skew = math.degrees(values.pop("xi"))
    body = ", ".join(f"{style.symbol(name)} = {value:.4g}" for name, value in values.items())
    n_i, omega_xy0 = course.launch["n_i"], course.launch["omega_xy0"]
    launch = f"$n_i$ = {n_i:g}, $|\\omega_{{xy0}}|$ = {omega_xy0:g}"
    return f"{body}, $\\xi$ = {skew:.3g}°;  {launch}"


def envelope(values: Floats, width: int) -> Floats:
    """Largest modulus within ``width`` points, one period of the slower mode, smoothed as wide."""
    from scipy.ndimage import maximum_filter1d, uniform_filter1d

    # Odd, so that both filters have the point in their middle and the mean of largest values is
    # never below the point itself.
    width = max(3, min(width, len(values) // 2)) | 1
    largest = maximum_filter1d(np.abs(values), width, mode="nearest")
    smooth: Floats = uniform_filter1d(largest, width, mode="nearest")
    return smooth


def draw(columns: dict[str, Floats], course: Course, caption: str = "") -> Figure:
    """Draw the columns of a course of :func:`course_of`, at its end, under a line of words."""
    t = columns["t"]
    panels = _panels(columns)
    figure = style.new_figure(WIDTH, 1.1 + 1.85 * len(panels))
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    slower = float(course.launches.modes.omega_r[0])
    width = round(2 * math.pi / slower / ((t[-1] - t[0]) / (len(t) - 1)))
    for axis, panel in zip(axes, panels, strict=True):
        if panel == ("n",):
            _draw_spin(axis, columns, CURVES[course.model])
        elif panel == ("E_p", "E_r"):
            for mode, colour, dash in (("E_p", BLUE, "-"), ("E_r", VERMILION, "--")):
                axis.plot(t, columns[mode], color=colour, linestyle=dash, linewidth=1.3,
                          label=f"${mode}$")  # fmt: skip
            axis.set_ylim(top=1.3 * float(max(columns["E_p"].max(), columns["E_r"].max())))
            axis.set_ylabel("energy  [$M g a$]")
        elif panel[0] in ("omega_x", "omega_y"):
            _draw_oscillation(axis, t, columns[panel[0]], width)
            axis.set_ylabel(f"$\\omega_{panel[0][-1]}$  [{RATE}]")
        else:
            (name,) = panel
            _line(axis, t, columns[name], BLUE)
            unit = UNITS.get(CHANNELS[name].unit, f"${CHANNELS[name].unit}$")
            axis.set_ylabel(name + (f"  [{unit}]" if unit else ""))
    _finish(axes, course)
    axes[-1].set_xlim(t[0], t[-1])
    axes[-1].set_xlabel(f"time  [{TIME}]")
    figure.align_ylabels(axes)
    if caption:
        figure.suptitle(caption, fontsize=9)
    return figure


def _panels(columns: dict[str, Floats]) -> list[tuple[str, ...]]:
    """Channels of each panel: a curve of theory lies over the spin, energies over each other."""
    over = {"t", "n_gh", "n_reduced"} if "n" in columns else {"t"}
    both = {"E_p", "E_r"} <= columns.keys()
    names = [name for name in columns if name not in over and not (both and name == "E_r")]
    return [("E_p", "E_r") if both and name == "E_p" else (name,) for name in names]


def _draw_spin(axis: Any, columns: dict[str, Floats], label: str) -> None:
    t = columns["t"]
    _line(axis, t, columns["n"], BLUE, label)
    most = float(np.max(np.abs(columns["n"])))
    for name, model, colour, dash in (
        ("n_gh", "gh", INK, "--"), ("n_reduced", "reduced", VERMILION, "-.")
    ):  # fmt: skip
        if name in columns:
            axis.plot(t, columns[name], color=colour, linestyle=dash, linewidth=1.1,
                      label=CURVES[model])  # fmt: skip
            most = max(most, float(np.max(np.abs(columns[name]))))
    axis.set_ylabel(f"spin $n$  [{RATE}]")
    # Room for the legend above the curves.
    axis.set_ylim(-1.15 * most, 1.75 * most)


def _draw_oscillation(axis: Any, t: Floats, values: Floats, width: int) -> None:
    _line(axis, t, values, BLUE)
    height = envelope(values, width)
    for sign, label in ((1, "envelope"), (-1, None)):
        axis.plot(t, sign * height, color=VERMILION, linewidth=1.1, label=label)
    most = float(height.max()) or 1.0
    axis.set_ylim(-1.1 * most, 1.45 * most)


def _finish(axes: Any, course: Course) -> None:
    """Mark zero and the reversals; explain each kind of curve in the first panel that has it."""
    since = 0.0 if course.times is None else float(course.times[:1][0])
    times, word = [time for time in course.reversals if time >= since], "reversal"
    if not times:
        times, word = [time for time in course.zeros if time >= since], "zero crossing"
    one = len(times) == 1
    text = f"{word} at " if one else f"{len(times)} {word}s, the first at "
    explained: set[str] = set()
    for axis in axes:
        style.light_grid(axis)
        low, high = axis.get_ylim()
        if low <= 0 <= high:
            axis.axhline(0, color=GREY, linewidth=0.7, zorder=1)
        for k, time in enumerate(times if len(times) <= MARKS else times[:1]):
            label = f"{text}{time:.6g}" if k == 0 and axis is axes[0] else None
            axis.axvline(time, color=GREY, linewidth=0.9, linestyle=":", zorder=1, label=label)
        labels = axis.get_legend_handles_labels()[1]
        if not explained.issuperset(labels):
            explained |= set(labels)
            axis.legend(loc="upper right", ncols=2, fontsize=8, frameon=True, framealpha=0.9,
                        edgecolor="none")  # fmt: skip


def _line(axis: Any, t: Floats, values: Floats, colour: str, label: str | None = None) -> None:
    """Draw a curve, as far as it can be seen."""
    places = thin(values, BINS)
    axis.plot(t[places], values[places], color=colour, linewidth=1.0, label=label)


def thin(values: Floats, bins: int) -> Places:
    """Places of the ends, and of the least and the largest value of each of so many stretches.

    A curve through them covers on paper what the whole one does, if a stretch is no wider than a
    line.
    """
    count = len(values)
    if count <= 2 * bins:
        return np.arange(count)
    stretches = np.split(values, np.linspace(0, count, bins + 1).astype(np.int64)[1:-1])
    first = np.cumsum([0, *map(len, stretches[:-1])])
    extremes = [(part.argmin(), part.argmax()) for part in stretches]
    return np.union1d(first[:, None] + extremes, [0, count - 1])
