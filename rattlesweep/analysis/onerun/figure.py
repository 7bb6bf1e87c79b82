"""Figures of one run: the spin with the theory, and other channels below."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rattlesweep.analysis import room, style
from rattlesweep.analysis.onerun.channels import CHANNELS
from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.analysis.style import BLUE, GREY, INK, VERMILION, curve
from rattlesweep.arrays import Floats
from rattlesweep.system.console import counted
from rattlesweep.system.files import as_path
from rattlesweep.words.errors import ConfigError

# Rows in a period of the pitch, and the fewest and the most in all.
_PER_PERIOD = 24
_LEAST = 2001
_MOST = 400_001
PALE = "#e4e2dc"  # of the times at which the body slides
_MARKS = 12  # reversals to mark; if there are more, only the first is marked
_MODELS = {"full": "full dynamics", "reduced": "reduced model"}
_BESIDE = {
    "n_gh": ("Garcia and Hubbard", INK, "--"),
    "n_reduced": ("reduced model", VERMILION, "-."),
}
SENSES = {True: ("rising", BLUE), False: ("falling", VERMILION)}
POINT_SIZES = (0.7, 3.0)  # points; the more there are, the smaller
DPI_OF_POINTS = 300.0
# The least range of an axis of a conserved channel, in parts of its value and of its
# error.
_LEAST_RANGE = 1e-6
_ERRORS_SHOWN = 10.0
_SHOWN = {"full": ("n", "omega_x", "omega_y"), "reduced": ("n", "E_p", "E_r")}


def course_of_figure(
    run: PreparedRun, shown: Sequence[str] | None, start: float | None
) -> Course:
    """Return a run with the channels to be drawn, and the theory beside its spin."""
    if shown is None:
        shown = _SHOWN[run.model]
    names = ["t", *shown]
    if "n" in names:
        if run.launches.n_i[0] != 0:  # without spin, the formula stays at zero
            names.append("n_gh")
        if run.model == "full" and run.energies != (None, None):
            names.append("n_reduced")
    rows = run.even_rows(_PER_PERIOD, _LEAST, _MOST, start)
    if rows < _MOST:
        return Course(run, names, points=rows, from_time=start)
    # Rows at equal distances of almost a period would show a beat that is not there.
    # Each of these is anywhere in its own part of the time.
    begin = start or 0.0
    anywhere = np.random.default_rng(0).random(rows - 2)
    places = np.concatenate(([0.0], np.arange(rows - 2) + anywhere, [rows - 2]))
    times = begin + (run.t_end - begin) * (places / (rows - 2))
    times[-1] = run.t_end
    return Course(run, names, times=times, from_time=start)


def draw_section(
    course: Course,
    x: str | None = None,
    y: str | None = None,
    path: str | Path | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Return a figure of two channels at the crossings of the section of a course.

    By default they are the first that are neither `t` nor the channel of the section.
    The figure is that of `ax`, if these axes of the caller's are given.
    """
    section = course.section
    assert section is not None
    crossed = section.channel.name
    names = [channel.name for channel in course.channels if channel.name in CHANNELS]
    free = (name for name in names if name not in ("t", crossed, x, y))
    x = x or next(free, "")
    y = y or next(free, "")
    if not {x, y} <= {*names}:
        raise ConfigError(
            f"a figure of this section needs two of its channels, {', '.join(names)}, "
            f"by default not t and {crossed}; choose two, or add a channel"
        )
    columns = course.columns()
    with style.styled():
        figure = room.usual_figure(*mpl.rcParams["figure.figsize"])
        axes = ax or figure.subplots()
        abscissa = course.si.get(x, CHANNELS[x])
        ordinate = course.si.get(y, CHANNELS[y])
        axes.set_xlabel(style.label(x, abscissa.unit))
        axes.set_ylabel(style.label(y, ordinate.unit))
        style.light_grid(axes)
        handles = []
        for is_rising, (word, colour) in SENSES.items():
            points = columns["rising"] == is_rising
            count = np.count_nonzero(points)
            if not count:
                continue
            axes.plot(
                columns[abscissa.name][points],
                columns[ordinate.name][points],
                "o",
                color=colour,
                markersize=np.clip(120 / np.sqrt(count), *POINT_SIZES),
                markeredgewidth=0,
                rasterized=True,
            )
            handles.append(style.entry(f"{count:,} {word}", color=colour, marker="o"))
        heading = f"{style.symbol(crossed)} = {section.level}"
        if ax is None:
            style.add_legend(figure, handles, [heading])
            style.add_caption(figure, [f"{course.run.title}."], grow=False)
            room.separate_ticks(figure)
            shown(figure)
        else:
            ax.legend(handles=handles, title=heading)
        whole = axes.get_figure(root=True)
        assert whole is not None
        if path is not None:
            style.save_figure(whole, [as_path(path, "path")], DPI_OF_POINTS)
        return whole


def shown(figure: Figure, path: str | Path | None = None) -> Figure:
    """Make notebooks show a figure, write it to `path` if given, and return it."""
    room.fit_to_size(figure)
    if path is not None:
        style.save_figure(figure, [as_path(path, "path")])
    # Figures made without pyplot need `_repr_png_` to show in a notebook.
    setattr(figure, "_repr_png_", lambda: style.encode_figure(figure, "png", 110.0))  # noqa: B010
    return figure


def draw(
    columns: Mapping[str, Floats], course: Course, path: str | Path | None = None
) -> Figure:
    """Return a figure of the columns of a finished course, in SI units if it can."""
    data: dict[str, Floats] = {}
    units: dict[str, str] = {}
    for name in columns:
        if name in CHANNELS:
            # The same quantity is also a column in SI units, if the size is known.
            channel = course.si.get(name, CHANNELS[name])
            data[name] = columns[channel.name]
            units[name] = channel.unit
    t = data["t"]
    if not len(t):
        raise ConfigError(
            f"the run ends at t = {course.follower.t:g}, before its first row"
        )
    second = 1.0
    if "t" in course.si:
        second = course.si["t"].size
    beside = []
    if "n" in data:
        beside = [name for name in _BESIDE if name in data]
    panels = [name for name in data if name != "t" and name not in beside]
    reversals = [time * second for time in course.reversals if time * second >= t[0]]
    marked = reversals[:1] if len(reversals) > _MARKS else reversals
    slides = [
        (begin * second, (end - begin) * second)
        for begin, end in course.slides
        if end * second >= t[0]
    ]
    run = course.run
    with style.styled():
        figure = room.usual_figure(7.2, 1.1 + 1.85 * len(panels))
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        bands = False
        for axis, name in zip(axes, panels, strict=True):
            axis.set_ylabel(style.label(name, units[name]))
            bands |= curve(axis, t, data[name], label=_MODELS[run.model])
            style.light_grid(axis)
            if CHANNELS[name].conserved:
                is_kept = run.model in CHANNELS[name].conserved and not run.losses
                _widen(axis, data[name], is_kept)
            if not np.isfinite(data[name]).any():
                axis.text(
                    0.5,
                    0.6,
                    "no finite value",
                    horizontalalignment="center",
                    transform=axis.transAxes,
                )
                axis.set_yticks([])
            if name == "n":
                for theory in beside:
                    label, colour, dash = _BESIDE[theory]
                    curve(axis, t, data[theory], colour, label=label, linestyle=dash)
                low, high = axis.get_ylim()
                # Room for the legend, which has two entries in a row.
                rows = (1 + len(beside) + bool(reversals) + bool(slides) + 1) // 2
                axis.set_ylim(low, high + (0.05 + 0.15 * rows) * (high - low))
            if slides:
                across = axis.get_xaxis_transform()
                axis.broken_barh(slides, (0, 1), transform=across, color=PALE, zorder=0)
            for time in marked:
                axis.axvline(time, color=GREY, linewidth=0.9, linestyle=":", zorder=1)
            low, high = axis.get_ylim()
            if low <= 0 <= high:
                axis.axhline(0, color=GREY, linewidth=0.7, zorder=1)
        if reversals:
            label = counted(len(reversals), "reversal")
            if len(reversals) > 1:
                label += ", the first"
            label += f" at {reversals[0]:.6g}"
            if "t" in course.si:
                label += " s"
            axes[0].plot([], [], color=GREY, linestyle=":", label=label)
        if slides:
            axes[0].fill([], [], color=PALE, label=counted(len(slides), "slide"))
        axes[-1].set(xlim=(t[0], t[-1]), xlabel=style.label("t", units["t"]))
        figure.align_ylabels(axes)
        title = run.title.replace("; ", "\n")
        if room.chosen_size() is None:
            axes[0].legend(
                loc="upper right", ncols=2, fontsize=8, frameon=True, edgecolor="none"
            )
            figure.suptitle(title, fontsize=9)
        else:
            style.add_legend(figure, axes[0].get_legend_handles_labels()[0], [title])
        if bands:
            style.add_caption(figure, [style.BAND])
        return shown(figure, path)


def _widen(axis: Axes, values: Floats, is_kept: bool) -> None:
    """Give an axis of a channel that hardly varies a range that does not magnify it.

    What varies of a value that `is_kept` is the error of the method.
    """
    finite = values[np.isfinite(values)]
    size = np.abs(finite).max(initial=0.0)
    if size == 0:
        return
    part = np.ptp(finite) / size
    least = _LEAST_RANGE
    if is_kept:
        least = max(least, _ERRORS_SHOWN * part)
    if part >= least:
        return
    middle = (finite.min() + finite.max()) / 2
    half = size * least / 2
    end = _part_in_words(least / 2)
    axis.set_ylim(middle - 1.2 * half, middle + 1.2 * half)
    axis.set_yticks(
        [middle - half, middle, middle + half],
        [f"−{end}", f"{middle:.6g}".replace("-", "−"), f"+{end}"],
    )
    axis.set_ylabel(f"{axis.get_ylabel()}\nvaries by {_part_in_words(part)}")


def _part_in_words(part: float) -> str:
    """Return a part of a value, such as ``5e−7 of it``."""
    digit, power = f"{part:.0e}".split("e")
    return f"{digit}e{int(power)} of it".replace("-", "−")
