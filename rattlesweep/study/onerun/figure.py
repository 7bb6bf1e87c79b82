"""The figure of one run: its spin with the theory, its oscillations with their envelopes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.study.onerun.channels import CHANNELS
from rattlesweep.study.onerun.course import Course, even_points
from rattlesweep.study.style import RATE, TIME, encode, new_figure, styled
from rattlesweep.sweeps.store.atomic import replace_file

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from rattlesweep.physics.body import Rattleback

    Floats = NDArray[np.float64]

WIDTH, DPI = 7.2, 160
# Okabe and Ito's colours, told apart by the colour-blind; theory is told apart by its dashes too.
BLUE, ORANGE, BLACK, GREY = "#0072B2", "#D55E00", "#222222", "#666666"
UNITS = {"1": "", "sqrt(a/g)": TIME, "sqrt(g/a)": RATE, "rad": "rad"}
# Points of a period of the faster mode, and how many there are at most.
PER_PERIOD, LEAST, MOST = 24, 2001, 400_001
# More than so many points become the least and the largest of each of so many bins.
LINE, BINS = 8000, 1600
# Of more reversals than this only the first is marked.
MARKS = 12


def channels_of(
    model: str, *, beside: bool = False, shown: Sequence[str] | None = None
) -> list[str]:
    """What a figure needs.

    Parameters
    ----------
    model : str
    beside : bool
        Whether the reduced model is drawn beside the full one.
    shown : sequence of str, optional
        Channels that are to be drawn; by default what suits the model.
    """
    default = {"full": ["n", "omega_x", "omega_y"], "reduced": ["n", "E_p", "E_r"], "gh": ["n"]}
    names = ["t", *(default[model] if shown is None else shown)]
    if "n" in names:
        names += ["n_gh"] * (model != "gh") + ["n_reduced"] * beside
    return list(dict.fromkeys(names))


def points_for(course: Course) -> int:
    """Points that show every period of the pitch, as far as they are not too many."""
    return min(MOST, max(LEAST, course.rows_of_periods(PER_PERIOD)))


def course_for(
    body: Rattleback,
    launch: dict[str, Any],
    watch: Callable[[float], None] | None = None,
    shown: Sequence[str] | None = None,
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
    shown : sequence of str, optional
        As for :func:`channels_of`.
    """
    model = launch["model"]
    given = launch.get("e_p0") is not None or launch.get("e_r0") is not None
    names = channels_of(model, beside=model == "full" and given, shown=shown)
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
    with styled():
        figure = draw(columns, course, caption or describe(course))
        replace_file(path, encode(figure, path.suffix.lower()[1:], DPI))


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
    t = columns["t"]
    panels = _panels(columns)
    figure = new_figure(WIDTH, 1.1 + 1.85 * len(panels))
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    slower = float(course.launches.modes.omega_r[0])
    width = round(2 * math.pi / slower / (t[-1] / (len(t) - 1)))
    for axis, panel in zip(axes, panels, strict=True):
        if panel == ("n",):
            _draw_spin(axis, columns, course)
        elif panel == ("E_p", "E_r"):
            for mode, colour, dash in (("E_p", BLUE, "-"), ("E_r", ORANGE, "--")):
                axis.plot(t, columns[mode], color=colour, linestyle=dash, linewidth=1.3,
                          label=f"${mode}$")  # fmt: skip
            axis.set_ylim(top=1.3 * float(max(columns["E_p"].max(), columns["E_r"].max())))
            axis.set_ylabel("energy  [$M g a$]")
        elif panel[0] in ("omega_x", "omega_y"):
            (name,) = panel
            _line(axis, t, columns[name], BLUE, "")
            height = envelope(columns[name], width)
            for sign, label in ((1, "envelope"), (-1, None)):
                axis.plot(t, sign * height, color=ORANGE, linewidth=1.1, label=label)
            axis.set_ylabel(f"$\\omega_{name[-1]}$  [{RATE}]")
            most = float(height.max()) or 1.0
            axis.set_ylim(-1.1 * most, 1.45 * most)
        else:
            (name,) = panel
            _line(axis, t, columns[name], BLUE, "")
            unit = UNITS.get(CHANNELS[name].unit, f"${CHANNELS[name].unit}$")
            axis.set_ylabel(name + (f"  [{unit}]" if unit else ""))
    marks = course.reversals or course.zeros
    said: set[str] = set()
    for axis in axes:
        axis.grid(visible=True, color="#e4e4e4", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        low, high = axis.get_ylim()
        if low <= 0 <= high:
            axis.axhline(0, color=GREY, linewidth=0.7, zorder=1)
        for k, time in enumerate(marks if len(marks) <= MARKS else marks[:1]):
            label = _marks(course) if k == 0 and axis is axes[0] else None
            axis.axvline(time, color=GREY, linewidth=0.9, linestyle=":", zorder=1, label=label)
        words = axis.get_legend_handles_labels()[1]
        if not said.issuperset(words):
            said |= set(words)
            axis.legend(loc="upper right", ncols=2, fontsize=8, frameon=True, framealpha=0.9,
                        edgecolor="none")  # fmt: skip
    axes[-1].set_xlim(0, t[-1])
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
    axis.set_ylabel(f"spin $n$  [{RATE}]")
    spins = ("n", "n_gh", "n_reduced")
    most = max(float(np.max(np.abs(columns[name]))) for name in spins if name in columns)
    # Room for the legend above the curves.
    axis.set_ylim(-1.15 * most, 1.75 * most)


def _marks(course: Course) -> str:
    times, word = course.reversals, "reversal"
    if not times:
        times, word = course.zeros, "zero crossing"
    if len(times) == 1:
        return f"{word} at {times[0]:.6g}"
    return f"{len(times)} {word}s, the first at {times[0]:.6g}"


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
