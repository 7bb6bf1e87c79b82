"""The figure of one run: its spin with the theory, its oscillations with their envelopes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.study.trajectory import Course, even_points
from rattlesweep.sweep.files import replace_file

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from rattlesweep.physics.body import Rattleback

    Floats = NDArray[np.float64]

ENDINGS = (".svg", ".png", ".pdf")
WIDTH, DPI = 7.2, 160
# Okabe and Ito's colours, told apart by the colour-blind; theory is told apart by its dashes too.
BLUE, ORANGE, BLACK, GREY = "#0072B2", "#D55E00", "#222222", "#666666"
# Points of a period of the faster mode, and how many there are at most.
PER_PERIOD, LEAST, MOST = 24, 2001, 400_001
# More than so many points become the least and the largest of each of so many bins.
LINE, BINS = 8000, 1600
# Of more reversals than this only the first is marked.
MARKS = 12


def channels_of(model: str, *, beside: bool = False) -> list[str]:
    """What the figure of a model needs; ``beside`` for the reduced model beside the full one."""
    own = {"full": ["omega_x", "omega_y"], "reduced": ["E_p", "E_r"], "gh": []}[model]
    return ["t", "n", *(["n_gh"] if model != "gh" else []), *own, *(["n_reduced"] * beside)]


def points_for(course: Course) -> int:
    """Points that show every period of the pitch, as far as they are not too many."""
    if course.model != "full":
        return LEAST
    periods = course.t_end * float(course.launches.modes.omega_p[0]) / (2 * math.pi)
    return int(min(MOST, max(LEAST, math.ceil(periods * PER_PERIOD) + 1)))


def course_for(
    body: Rattleback, launch: dict[str, Any], watch: Callable[[float], None] | None = None
) -> Course:
    """The run at the times that its figure needs.

    Parameters
    ----------
    body : Rattleback
    launch : dict
        What :class:`Course` takes beyond the body, the channels and the times.  Energies of the
        reduced model ask for it beside the full one.
    watch : callable, optional
        As for :class:`Course`.
    """
    model = launch["model"]
    given = launch.get("e_p0") is not None or launch.get("e_r0") is not None
    names = channels_of(model, beside=model == "full" and given)
    # The horizon is known once the launch is.
    return at_its_times(Course(body, channels=names, watch=watch, **launch))


def at_its_times(course: Course) -> Course:
    """Give a course the times that its figure needs."""
    course.times = even_points(course.t_end, points_for(course))
    return course


def save(course: Course, path: Path, caption: str = "") -> None:
    """Integrate, draw and write a figure, in the format of the file's ending.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    chunks = list(course)
    columns = {c.name: np.concatenate([x[c.name] for x in chunks]) for c in course.channels}
    figure = draw(columns, course, caption or describe(course))
    replace_file(path, encode(figure, path.suffix.lower()[1:]))


def describe(course: Course) -> str:
    """Which run: one line."""
    runs = course.launches
    b = runs.bodies
    body = ", ".join(
        f"{sign} = {float(getattr(b, name)[0]):.4g}"
        for name, sign in (("alpha", "$\\alpha$"), ("beta", "$\\beta$"), ("gamma", "$\\gamma$"),
                           ("theta", "$\\theta$"), ("phi", "$\\phi$"))
    )  # fmt: skip
    launch = f"$n_i$ = {runs.n_i[0]:g}, $|\\omega_{{xy0}}|$ = {runs.omega_xy0[0]:g}"
    return f"{body}, $\\xi$ = {math.degrees(b.xi[0]):.3g}°;  {launch}"


def envelope(values: Floats, width: int) -> Floats:
    """Largest modulus within ``width`` points, one period of the slower mode, smoothed as wide."""
    from scipy.ndimage import maximum_filter1d, uniform_filter1d

    # Odd, so that both filters have the point in their middle and the mean of largest values is
    # never below the point itself.
    width = max(3, min(width, len(values) // 2)) | 1
    largest = maximum_filter1d(np.abs(values), width, mode="nearest")
    smooth: Floats = uniform_filter1d(largest, width, mode="nearest")
    return smooth


def draw(columns: dict[str, Floats], course: Course, caption: str = "") -> Any:
    """Draw the figure.

    Parameters
    ----------
    columns : dict
        The channels of :func:`channels_of`, at even times.
    course : Course
        The run they come from, at its end.
    caption : str
        A line above: which run.
    """
    # Without pyplot: no window, no state that outlives the figure.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    t = columns["t"]
    below: list[str] = [name for name in ("omega_x", "omega_y") if name in columns]
    energies = "E_p" in columns
    count = 1 + len(below) + energies
    figure = Figure(figsize=(WIDTH, 1.1 + 1.85 * count), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    _draw_spin(axes[0], columns, course)
    slower = float(course.launches.modes.omega_r[0])
    width = round(2 * math.pi / slower / (t[-1] / (len(t) - 1)))
    for axis, name in zip(axes[1:], below, strict=False):
        _line(axis, t, columns[name], BLUE, "")
        height = envelope(columns[name], width)
        for sign, label in ((1, "envelope"), (-1, None)):
            axis.plot(t, sign * height, color=ORANGE, linewidth=1.1, label=label)
        axis.set_ylabel(f"$\\omega_{name[-1]}$  [$\\sqrt{{g/a}}$]")
        most = float(height.max()) or 1.0
        axis.set_ylim(-1.1 * most, 1.45 * most)
    if energies:
        for mode, colour, dash in (("E_p", BLUE, "-"), ("E_r", ORANGE, "--")):
            axes[1].plot(t, columns[mode], color=colour, linestyle=dash, linewidth=1.3,
                         label=f"${mode}$")  # fmt: skip
        axes[1].set_ylim(top=1.3 * float(max(columns["E_p"].max(), columns["E_r"].max())))
        axes[1].set_ylabel("energy  [$M g a$]")
    for axis in axes:
        axis.grid(visible=True, color="#e4e4e4", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        axis.axhline(0, color=GREY, linewidth=0.7, zorder=1)
        marks = course.reversals if len(course.reversals) <= MARKS else course.reversals[:1]
        for k, time in enumerate(marks):
            label = _reversals(course.reversals) if k == 0 and axis is axes[0] else None
            axis.axvline(time, color=GREY, linewidth=0.9, linestyle=":", zorder=1, label=label)
        if axis is axes[0] or axis is axes[min(1, count - 1)]:
            axis.legend(loc="upper right", ncols=2, fontsize=8, framealpha=0.9, edgecolor="none")
    axes[-1].set_xlim(0, t[-1])
    axes[-1].set_xlabel("time  [$\\sqrt{a/g}$]")
    figure.align_ylabels(axes)
    if caption:
        figure.suptitle(caption, fontsize=9)
    return figure


def _draw_spin(axis: Any, columns: dict[str, Floats], course: Course) -> None:
    t, n = columns["t"], columns["n"]
    own = {"full": "full dynamics", "reduced": "reduced model", "gh": "Garcia and Hubbard"}
    _line(axis, t, n, BLUE, own[course.model])
    if "n_gh" in columns:
        axis.plot(t, columns["n_gh"], color=BLACK, linestyle="--", linewidth=1.1,
                  label="Garcia and Hubbard")  # fmt: skip
    if "n_reduced" in columns:
        axis.plot(t, columns["n_reduced"], color=ORANGE, linestyle="-.", linewidth=1.1,
                  label="reduced model")  # fmt: skip
    axis.set_ylabel("spin $n$  [$\\sqrt{g/a}$]")
    most = max(float(np.max(np.abs(columns[name]))) for name in columns if name[0] == "n")
    # Room for the legend above the curves.
    axis.set_ylim(-1.15 * most, 1.75 * most)


def _reversals(times: list[float]) -> str:
    if len(times) == 1:
        return f"reversal at {times[0]:.6g}"
    return f"{len(times)} reversals, the first at {times[0]:.6g}"


def _line(axis: Any, t: Floats, values: Floats, colour: str, label: str) -> None:
    """Draw a curve, or the band it fills where it swings faster than can be seen."""
    if len(t) <= LINE:
        axis.plot(t, values, color=colour, linewidth=1.0, label=label or None)
        return
    edges = np.linspace(0, len(t), BINS + 1).astype(int)[:-1]
    low, high = np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)
    # Neighbours share a border, so that a slow curve does not fall apart into dots.
    low[:-1] = np.minimum(low[:-1], high[1:])
    high[:-1] = np.maximum(high[:-1], low[1:])
    axis.fill_between(t[edges], low, high, color=colour, linewidth=0.6)
    axis.plot([], [], color=colour, linewidth=1.0, label=label or None)


def encode(figure: Any, kind: str) -> bytes:
    """Bytes of a figure as ``svg``, ``png`` or ``pdf``; equal figures give equal bytes."""
    import matplotlib

    from rattlesweep.study import plot_style

    with matplotlib.rc_context({"svg.hashsalt": "rattlesweep", "svg.fonttype": "path"}):
        return plot_style.encode(figure, kind, DPI)
