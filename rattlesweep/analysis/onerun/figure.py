"""Draw one run: its spin with the theory, its oscillations as curves or as their envelopes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rattlesweep.analysis import style
from rattlesweep.analysis.onerun.channels import CHANNELS, si_size
from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.analysis.onerun.rows import Rows
from rattlesweep.analysis.style import GREY, INK, VERMILION, curve
from rattlesweep.arrays import Floats
from rattlesweep.sweeps.launches import Launch

WIDTH, DPI = 7.2, 160
# Every period of the pitch is seen, as far as the points are not too many.
ROWS = Rows(per_period=24, most=400_001)
# Of more turns than this only the first is marked.
MARKS = 12
CURVES = {"full": "full dynamics", "reduced": "reduced model", "gh": "Garcia and Hubbard"}
SHOWN = {"full": ("n", "omega_x", "omega_y"), "reduced": ("n", "E_p", "E_r"), "gh": ("n",)}


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
        style.save(draw(columns, course), [path], DPI)


def describe(course: Course) -> str:
    """Return which run it is, in one line."""
    values = dict(course.body)
    skew = math.degrees(values.pop("xi"))
    body = ", ".join(f"{style.symbol(name)} = {value:.4g}" for name, value in values.items())
    n_i, omega_xy0 = course.launch["n_i"], course.launch["omega_xy0"]
    launch = f"$n_i$ = {n_i:.4g}, $|\\omega_{{xy0}}|$ = {omega_xy0:.4g}"
    return f"{body}, $\\xi$ = {skew:.3g}°;  {launch}".replace("= -", "= −")


def draw(columns: dict[str, Floats], course: Course) -> Figure:
    """Draw the columns of a course of :func:`course_of`, at its end, in SI units if it has some."""
    sizes = {name: si_size(name, CHANNELS[name].unit, course.units)
             for name in columns if name in CHANNELS}  # fmt: skip
    columns = {name: columns[name] * size for name, (size, _) in sizes.items()}
    t = columns["t"]
    # Curves of theory lie over the spin, and energies over each other.
    over = {"t", "n_gh", "n_reduced"} if "n" in columns else {"t"}
    both = {"E_p", "E_r"} <= columns.keys()
    panels = [name for name in columns if name not in over and not (both and name == "E_r")]
    figure = style.new_figure(WIDTH, 1.1 + 1.85 * len(panels))
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axis, name in zip(axes, panels, strict=True):
        axis.set_ylabel(style.label(name, sizes[name][1]))
        if name == "n":
            curve(axis, t, columns["n"], label=CURVES[course.model])
            beside = {"n_gh": ("gh", INK, "--"), "n_reduced": ("reduced", VERMILION, "-.")}
            for other, (model, colour, dash) in beside.items():
                if other in columns:
                    curve(axis, t, columns[other], colour, label=CURVES[model], linestyle=dash)
            spins = [columns[k] for k in ("n", *beside) if k in columns]
            most = float(max(np.max(np.abs(spin)) for spin in spins))
            axis.set_ylim(-1.15 * most, 1.75 * most)  # room for the legend above the curves
        elif name == "E_p" and both:
            curve(axis, t, columns["E_p"], label="$E_p$")
            curve(axis, t, columns["E_r"], VERMILION, label="$E_r$")
            axis.set_ylim(top=1.3 * float(max(columns["E_p"].max(), columns["E_r"].max())))
            axis.set_ylabel(style.label("energy", sizes[name][1]))
        else:
            curve(axis, t, columns[name])
    _mark_turns(axes, course, sizes["t"][0])
    axes[-1].set_xlim(t[0], t[-1])
    axes[-1].set_xlabel(style.label("t", sizes["t"][1]))
    figure.align_ylabels(axes)
    figure.suptitle(describe(course), fontsize=9)
    return figure


def _mark_turns(axes: Any, course: Course, size: float) -> None:
    """Mark zero and the turns, and explain each kind of curve in the first panel that has it."""
    since = 0.0 if course.times is None else float(course.times[:1][0])
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
