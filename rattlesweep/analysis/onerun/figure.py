"""Draw one run: its spin with the theory, its oscillations with their envelopes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rattlesweep.analysis import style
from rattlesweep.analysis.onerun.channels import CHANNELS
from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.analysis.onerun.rows import Rows
from rattlesweep.analysis.style import BLUE, GREY, INK, VERMILION
from rattlesweep.arrays import Floats, Places
from rattlesweep.sweeps.single import Launch

WIDTH, DPI = 7.2, 160
# Every period of the pitch is seen, as far as the points are not too many.
ROWS = Rows(per_period=24, most=400_001)
# Stretches of which only the least and the largest value are drawn.
BINS = 1600
# With more periods of the slower mode than this, an oscillation is drawn as its envelope.
MOST_PERIODS = 150
# Of more turns than this only the first is marked.
MARKS = 12
CURVES = {"full": "full dynamics", "reduced": "reduced model", "gh": "Garcia and Hubbard"}
SHOWN = {"full": ("n", "omega_x", "omega_y"), "reduced": ("n", "E_p", "E_r"), "gh": ("n",)}
SYMBOLS = {"n": "spin $n$", "omega_x": r"$\omega_x$", "omega_y": r"$\omega_y$"}


def course_of(
    run: Launch | PreparedRun,
    shown: Sequence[str] | None = None,
    watch: Callable[[float], None] | None = None,
    from_time: float | None = None,
) -> Course:
    """Return the run at the times and with the channels that its figure needs.

    `shown` are the channels to be drawn, by default what suits the model. Energies of the reduced
    model ask for it beside the full one.
    """
    launch = run if isinstance(run, Launch) else None
    model: str = run.model if isinstance(run, Launch) else run[0].model
    names = ["t", *(SHOWN[model] if shown is None else shown)]
    if "n" in names:
        names += ["n_gh"] * (model != "gh")
        if model == "full" and launch and (launch.e_p0, launch.e_r0) != (None, None):
            names.append("n_reduced")
    rows = replace(ROWS, from_time=from_time)
    return Course(run, channels=list(dict.fromkeys(names)), rows=rows, watch=watch)


def save(course: Course, path: Path) -> None:
    """Integrate, draw and write a figure, in the format of the file's ending."""
    columns = course.columns()
    with style.styled():
        style.save(draw(columns, course, describe(course)), [path], DPI)


def describe(course: Course) -> str:
    """Return which run it is, in one line."""
    values = dict(course.body)
    skew = math.degrees(values.pop("xi"))
    body = ", ".join(f"{style.symbol(name)} = {value:.4g}" for name, value in values.items())
    n_i, omega_xy0 = course.launch["n_i"], course.launch["omega_xy0"]
    launch = f"$n_i$ = {n_i:g}, $|\\omega_{{xy0}}|$ = {omega_xy0:g}"
    return f"{body}, $\\xi$ = {skew:.3g}°;  {launch}"


def envelope(values: Floats, width: int) -> Floats:
    """Return the largest modulus within ``width`` points, smoothed over as many."""
    from scipy.ndimage import maximum_filter1d, uniform_filter1d

    # Odd, so that both filters have the point in their middle and the mean of largest values is
    # never below the point itself.
    width = max(3, min(width, len(values) // 2)) | 1
    largest = maximum_filter1d(np.abs(values), width, mode="nearest")
    smooth: Floats = uniform_filter1d(largest, width, mode="nearest")
    return smooth


def thin(values: Floats, bins: int) -> Places:
    """Return the places of the ends, and of the least and largest value of each of some stretches.

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


def draw(columns: dict[str, Floats], course: Course, caption: str = "") -> Figure:
    """Draw the columns of a course of :func:`course_of`, at its end, under a line of words."""
    t = columns["t"]
    # Curves of theory lie over the spin, and energies over each other.
    over = {"t", "n_gh", "n_reduced"} if "n" in columns else {"t"}
    both = {"E_p", "E_r"} <= columns.keys()
    panels = [name for name in columns if name not in over and not (both and name == "E_r")]
    figure = style.new_figure(WIDTH, 1.1 + 1.85 * len(panels))
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    period = 2 * math.pi / float(course.launches.modes.omega_r[0])

    def line(axis: Any, name: str, colour: str = BLUE, **look: Any) -> None:
        places = thin(columns[name], BINS)
        look = {"color": colour, "linewidth": 1.0} | look
        axis.plot(t[places], columns[name][places], **look)

    for axis, name in zip(axes, panels, strict=True):
        axis.set_ylabel(style.label(SYMBOLS.get(name, name), CHANNELS[name].unit))
        if name == "n":
            line(axis, "n", label=CURVES[course.model])
            beside = {"n_gh": ("gh", INK, "--"), "n_reduced": ("reduced", VERMILION, "-.")}
            for other, (model, colour, dash) in beside.items():
                if other in columns:
                    line(axis, other, colour, label=CURVES[model], linestyle=dash)
            spins = [columns[k] for k in ("n", *beside) if k in columns]
            most = float(max(np.max(np.abs(spin)) for spin in spins))
            axis.set_ylim(-1.15 * most, 1.75 * most)  # room for the legend above the curves
        elif name == "E_p" and both:
            line(axis, "E_p", label="$E_p$")
            line(axis, "E_r", VERMILION, label="$E_r$", linestyle="--")
            axis.set_ylim(top=1.3 * float(max(columns["E_p"].max(), columns["E_r"].max())))
            axis.set_ylabel(style.label("energy", "M g a"))
        elif name in ("omega_x", "omega_y"):
            height = envelope(columns[name], round(period / ((t[-1] - t[0]) / (len(t) - 1))))
            if t[-1] - t[0] > MOST_PERIODS * period:
                # A line would be a slab of ink.
                axis.fill_between(t, -height, height, color=BLUE, alpha=0.25, linewidth=0)
            else:
                line(axis, name)
            for sign, label in ((1, "envelope"), (-1, None)):
                axis.plot(t, sign * height, color=VERMILION, linewidth=1.1, label=label)
            most = float(height.max()) or 1.0
            axis.set_ylim(-1.1 * most, 1.45 * most)
        else:
            line(axis, name)

    # Mark zero and the turns; explain each kind of curve in the first panel that has it.
    since = 0.0 if course.times is None else float(course.times[:1][0])
    times, words = [time for time in course.reversals if time >= since], ("turn", "turns")
    if not times:
        times = [time for time in course.zeros if time >= since]
        words = ("zero of the spin", "zeros of the spin")
    text = f"{words[0]} at " if len(times) == 1 else f"{len(times)} {words[1]}, the first at "
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
    axes[-1].set_xlim(t[0], t[-1])
    axes[-1].set_xlabel(style.label("time", "sqrt(a/g)"))
    figure.align_ylabels(axes)
    if caption:
        figure.suptitle(caption, fontsize=9)
    return figure
