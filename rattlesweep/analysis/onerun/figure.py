"""Draw one run: its spin with the theory, its oscillations as curves or as their envelopes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rattlesweep.analysis import style
from rattlesweep.analysis.onerun.channels import CHANNELS
from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.analysis.style import GREY, INK, VERMILION, curve
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError

# Every period of the pitch is seen, as far as the points are not too many.
PER_PERIOD, LEAST, MOST = 24, 2001, 400_001
# Of more turns than this only the first is marked.
MARKS = 12
CURVES = {"full": "full dynamics", "reduced": "reduced model", "gh": "Garcia and Hubbard"}
SHOWN = {"full": ("n", "omega_x", "omega_y"), "reduced": ("n", "E_p", "E_r"), "gh": ("n",)}


def course_of(
    run: PreparedRun,
    shown: Sequence[str] | None = None,
    from_time: float | None = None,
    watch: Callable[[float], None] | None = None,
) -> Course:
    """Return the run at the times and with the channels that its figure needs.

    `shown` are the channels to be drawn, by default what suits the model. Energies of the reduced
    model ask for it beside the full one.
    """
    names = ["t", *(SHOWN[run.model] if shown is None else shown)]
    if "n" in names:
        names += ["n_gh"] * (run.model != "gh")
        if run.model == "full" and run.energies != (None, None):
            names.append("n_reduced")
    points = run.even_rows(PER_PERIOD, LEAST, MOST, from_time)
    return Course(run, names, points=points, from_time=from_time, watch=watch)


def shown(figure: Figure, path: str | Path | None = None, dpi: float = 150.0) -> Figure:
    """Return a figure as notebooks can show it, written to a file if there is a path."""
    if path is not None:
        style.save(figure, [Path(path)], dpi)
    # Figures made without pyplot need `_repr_png_` to show in a notebook.
    setattr(figure, "_repr_png_", lambda: style.encode(figure, "png", 110.0))  # noqa: B010
    return figure


def draw(columns: Mapping[str, Floats], course: Course, path: str | Path | None = None) -> Figure:
    """Draw the columns of a course at its end, in SI units if it has some; write it to a file."""
    with style.styled():
        return shown(_panels(columns, course), path, 160.0)


def _panels(columns: Mapping[str, Floats], course: Course) -> Figure:
    """Draw a panel for each column, curves of theory over the spin and energies over each other."""
    data = {name: columns[course.si[name].name if name in course.si else name]
            for name in columns if name in CHANNELS}  # fmt: skip
    units = {name: course.si.get(name, CHANNELS[name]).unit for name in data}
    t = data["t"]
    if not len(t):
        raise ConfigError(f"the run ends at t = {course.t:g}, before its first row")
    over = {"t", "n_gh", "n_reduced"} if "n" in data else {"t"}
    both = {"E_p", "E_r"} <= data.keys()
    panels = [name for name in data if name not in over and not (both and name == "E_r")]
    figure = style.new_figure(7.2, 1.1 + 1.85 * len(panels))
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axis, name in zip(axes, panels, strict=True):
        axis.set_ylabel(style.label(name, units[name]))
        if name == "n":
            curve(axis, t, data["n"], label=CURVES[course.run.model])
            beside = {"n_gh": ("gh", INK, "--"), "n_reduced": ("reduced", VERMILION, "-.")}
            for other, (model, colour, dash) in beside.items():
                if other in data:
                    curve(axis, t, data[other], colour, label=CURVES[model], linestyle=dash)
            most = max(float(np.max(np.abs(data[k]))) for k in ("n", *beside) if k in data)
            axis.set_ylim(-1.15 * most, 1.75 * most)  # room for the legend above the curves
        elif name == "E_p" and both:
            curve(axis, t, data["E_p"], label="$E_p$")
            curve(axis, t, data["E_r"], VERMILION, label="$E_r$")
            axis.set_ylim(top=1.3 * float(max(data["E_p"].max(), data["E_r"].max())))
            axis.set_ylabel(style.label("energy", units[name]))
        else:
            curve(axis, t, data[name])
    size = course.si["t"].size if "t" in course.si else 1.0
    _mark_turns(axes, course, float(t[0]) / size, size)
    axes[-1].set_xlim(t[0], t[-1])
    axes[-1].set_xlabel(style.label("t", units["t"]))
    figure.align_ylabels(axes)
    figure.suptitle(course.run.title, fontsize=9)
    return figure


def _mark_turns(axes: Any, course: Course, since: float, size: float) -> None:
    """Mark zero and the turns, and explain each kind of curve in the first panel that has it."""
    times, words = [time for time in course.reversals if time >= since], ("turn", "turns")
    if not times:
        times = [time for time in course.zeros if time >= since]
        words = ("zero of the spin", "zeros of the spin")
    text = f"{words[0]} at " if len(times) == 1 else f"{len(times)} {words[1]}, the first at "
    for axis in axes:
        style.light_grid(axis)
        low, high = axis.get_ylim()
        if low <= 0 <= high:
            axis.axhline(0, color=GREY, linewidth=0.7, zorder=1)
        for k, time in enumerate(times if len(times) <= MARKS else times[:1]):
            label = f"{text}{time * size:.6g}" if k == 0 and axis is axes[0] else None
            axis.axvline(time * size, color=GREY, linewidth=0.9, linestyle=":", zorder=1,
                         label=label)  # fmt: skip
        if axis.get_legend_handles_labels()[1]:
            axis.legend(loc="upper right", ncols=2, fontsize=8, frameon=True, framealpha=0.9,
                        edgecolor="none")  # fmt: skip
