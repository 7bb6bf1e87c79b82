"""Runs as time series and as animated pages, also those that a sweep has stored."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.api import arguments as arguments
from rattlesweep.api.arguments import check_count, numbers, one_number
from rattlesweep.api.single import NumberOrText, prepare_launch
from rattlesweep.physics.body import Rattleback
from rattlesweep.system.console import counted
from rattlesweep.words.errors import ConfigError, check_names

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from rattlesweep.analysis.onerun.course import Course, PreparedRun
    from rattlesweep.analysis.onerun.replay import StoredRun
    from rattlesweep.physics.si import Units

ROWS = ("points", "dt", "steps", "times", "from_time")
SHOWN = ("points", "from_time", "path")


class Trajectory:
    """A run as a time series.

    The DataFrame `table` has a column per channel, NaN where there is no finite value,
    and `units` is a dict.  If the size of the body is known, columns in SI units
    follow, such as ``t_s``. `zeros` are the times of all zeros of the spin after
    the launch; the first is the ``t_r`` of a sweep, except for a tap, whose zeros count
    only after the spin has exceeded a quarter of ``n_0``. `reversals` has the first
    zero of each reversal, which takes the spin from beyond a quarter of its initial
    value (of ``n_0`` for a tap) to beyond a quarter on the other side.  `t_end` is the
    time reached, `n_steps` counts accepted steps, and `status` is ``ok`` or a word for
    what went wrong.  `warning` says where contact would be lost, or rolling needs a
    coefficient of friction above 0.3, and how large.  `slides` has begin and end of
    each slide.

    If a section is asked for, the DataFrame `section` has the columns at each crossing,
    with `t` first and with `rising`, whether the channel rises there; the run is then
    integrated again for `table`, when that is first used.

    Stability: stable.
    """

    def __init__(
        self,
        run: PreparedRun,
        channels: Sequence[str] | None,
        section: str | None = None,
        **rows: Any,
    ) -> None:
        import pandas as pd

        from rattlesweep.analysis.onerun.course import Course
        from rattlesweep.analysis.onerun.section import Section

        names = None
        if channels is not None:
            names = arguments.names_of("channels", channels)
        check_names("arguments", rows, ROWS)
        chosen_rows = rows_of(run.units, **rows)
        self.section: pd.DataFrame | None = None
        if section is None:
            course = Course(run, names, **chosen_rows)
            self.table = pd.DataFrame(course.columns())
        else:
            plane = Section.parse(section, run.model, run.units)
            start = chosen_rows["from_time"]
            course = Course(run, names, section=plane, from_time=start)
            self.section = pd.DataFrame(course.columns())
            self._course_of_table = partial(Course, run, names, **chosen_rows)
        follower = course.follower
        self._course = course
        self.units = {channel.name: channel.unit for channel in course.channels}
        self.reversals = np.array(course.reversals)
        self.zeros = np.array(follower.zeros)
        self.t_end = follower.t
        self.n_steps = follower.n_steps
        self.status = follower.status.label
        self.warning = course.warning
        self.slides = np.array(course.slides).reshape(-1, 2)

    @cached_property
    def table(self) -> pd.DataFrame:
        """The rows beside a section, for which the run is integrated again."""
        import pandas as pd

        return pd.DataFrame(self._course_of_table().columns())

    def __getitem__(self, columns: str | list[str]) -> Any:
        """Return a column of `table` as a Series, or several as a DataFrame."""
        return self.table[columns]

    def __repr__(self) -> str:
        events = counted(len(self.reversals), "reversal")
        if self.section is not None:
            events += f" and {counted(len(self.section), 'crossing')}"
        names = ", ".join(self.units)
        return f"<Trajectory of {names}: {events} by t = {self.t_end:g}>"

    def _repr_html_(self) -> str:
        shown = self.section
        if shown is None:
            shown = self.table
        return f"<div>{html.escape(repr(self))}{shown.to_html(max_rows=6)}</div>"

    def show(self, *, title: str | None = None, **shown: Any) -> Page:
        """Make a page of this run with the arguments of ``show``."""
        check_names("arguments", shown, SHOWN)
        return page_of(self._course.run, title, **shown)[0]

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw the columns against the time, and write the figure to a `path`."""
        from rattlesweep.analysis.onerun.figure import draw

        if "t" not in self.table or len(self._course.channels) < 2:
            raise ConfigError("channels: a plot needs t and at least one other")
        columns = {str(name): self.table[name].to_numpy() for name in self.table}
        return draw(columns, self._course, path)

    def plot_section(
        self,
        x: str | None = None,
        y: str | None = None,
        path: str | Path | None = None,
        *,
        ax: Axes | None = None,
    ) -> Figure:
        """Draw two channels at the crossings of the section against each other.

        By default they are the first that are neither `t` nor the channel of the
        section.  `path` is an .svg, .png or .pdf file to write.  The figure is that of
        `ax`, if axes are given, and otherwise has the size of ``matplotlib.rcParams``.
        Raises a ConfigError if the run has no section, or not these channels.
        """
        from rattlesweep.analysis.onerun.figure import draw_section

        if self.section is None:
            raise ConfigError("section: none is asked for; give section to trajectory")
        return draw_section(self._course, x, y, path, ax)


@dataclass(frozen=True)
class Page:
    """A self-contained HTML page, which notebooks show, and the file that has it.

    Stability: stable.
    """

    content: bytes = field(repr=False)
    path: Path | None = None

    def save(self, path: str | Path) -> Page:
        """Write the page to an .html file, and return it with its path."""
        from rattlesweep.system.files import replace_file

        path = page_path(path)
        replace_file(path, self.content)
        return Page(self.content, path)

    def _repr_html_(self) -> str:
        # Scripts in this frame have no access to the notebook.
        return (
            '<iframe sandbox="allow-scripts" style="width: 100%; height: 720px; '
            f'border: 0" srcdoc="{html.escape(self.content.decode())}"></iframe>'
        )


def page_path(path: str | Path) -> Path:
    """Return the path of a page, which is refused before the page takes its time."""
    from rattlesweep.system.files import as_path

    path = as_path(path, "path")
    if path.suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"path {path}: the name must end in .html or .htm")
    return path


def trajectory(
    body: Rattleback | str,
    *,
    channels: Sequence[str] | None = None,
    section: str | None = None,
    points: int | None = None,
    dt: NumberOrText | None = None,
    steps: bool = False,
    times: ArrayLike | None = None,
    from_time: NumberOrText | None = None,
    **launch: Any,
) -> Trajectory:
    """Integrate one launch to ``t_end``, past its reversals, as a time series.

    The accepted steps, and so the first zero, are those of ``simulate``, whichever rows
    are requested.

    Stability: stable.

    Parameters
    ----------
    body, **launch
        As for ``simulate``, for one body; also ``e_p0`` and ``e_r0``, the initial
        energies of pitch and roll in the reduced model, in ``M g a``, by default those
        of the launch.
    channels : sequence of str, optional
        Columns of the table, by default ``t`` and ``n``, and of a section, by default
        ``t``, ``n``, ``omega`` and ``u`` (in the reduced model ``t``, ``n`` and both
        energies); ``rattlesweep trajectory --channels list`` prints all of them.
    section : str, optional
        A channel and a value that it crosses: ``"omega_y=0.1"`` in both directions,
        ``"omega_y=0.1+"`` rising, ``"omega_y=0.1-"`` falling, and ``"omega_y"`` at
        zero.  The value is in the units of the body, or as in ``"n=60 rpm"``.  Each
        crossing, but not the launch, is a row of ``.section``, where the state has the
        accuracy of the method.
    points, dt, steps, times
        One of them chooses the rows: a number of rows, evenly spaced (by default 2001,
        or 20 per pitch period if that is more), one every ``dt``, one per accepted
        step, or increasing times. Times are in ``sqrt(a/g)``.
    from_time : number or str, optional
        Time of the first row; earlier crossings are left out.

    Raises
    ------
    ConfigError
        If a name, a number or a section is wrong.

    Examples
    --------
    >>> path = rs.trajectory("GH", n_i=0.1, omega_xy0=0.01, t_end=150, points=4)
    >>> path["n"].shape, path.reversals.round(2)
    ((4,), array([112.09]))
    >>> launch = {"n_i": 0.1, "omega_xy0": 0.01, "t_end": 15}
    >>> rs.trajectory("GH", section="omega_y=0+", **launch).section[["t", "n"]].round(4)
             t       n
    0   1.7880  0.0999
    1   6.5441  0.0998
    2  10.6784  0.0995
    """
    return Trajectory(
        prepare_launch(body, **launch),
        channels,
        section,
        points=points,
        dt=dt,
        steps=steps,
        times=times,
        from_time=from_time,
    )


def show(
    body: Rattleback | str,
    *,
    from_time: NumberOrText | None = None,
    points: int | None = None,
    title: str | None = None,
    path: str | Path | None = None,
    **launch: Any,
) -> Page:
    """Make a page on which a body rolls on the plane, with its trace and its spin.

    The arguments are those of ``trajectory``, with 20 rows per pitch period by default.
    `title` is the title of the page, and `path` an .html file to write it to.

    Stability: stable.
    """
    if title is None and isinstance(body, str):
        title = f"Rattleback {body}"
    run = prepare_launch(body, **launch)
    return page_of(run, title, points=points, from_time=from_time, path=path)[0]


def replay(
    directory: str | Path,
    case: int,
    sample: int,
    *,
    t_end: NumberOrText | None = None,
    channels: Sequence[str] | None = None,
    section: str | None = None,
    **rows: Any,
) -> Trajectory:
    """Integrate a stored run again as a trajectory, if it comes out as stored.

    `case` and `sample` are columns of the ``runs`` in an output directory, complete or
    running. The other arguments are those of ``trajectory``; `t_end` is by default the
    sweep's.  Raises an OutputError if the run is not stored yet, is damaged, or differs
    in any bit.

    Stability: stable.
    """
    _, run = prepare_stored(directory, t_end, case=case, sample=sample)
    return Trajectory(run, channels, section, **rows)


def page_of(
    run: PreparedRun,
    title: str | None,
    *,
    points: int | None = None,
    from_time: NumberOrText | None = None,
    path: str | Path | None = None,
) -> tuple[Page, Course]:
    """Return the page of a run and its course; write the page if there is a path."""
    from rattlesweep.analysis.onerun.show import course_of_page, make_page, make_scene

    check_count("points", points, 2)
    if path is not None:
        path = page_path(path)
    course = course_of_page(run, points, one_number("from_time", from_time, run.units))
    page = Page(make_page(make_scene(course), str(title or "Rattleback"), run.title))
    return page if path is None else page.save(path), course


def prepare_stored(
    directory: str | Path,
    t_end: object = None,
    *,
    case: int | None = None,
    sample: int | None = None,
    where: str | None = None,
) -> tuple[StoredRun, PreparedRun]:
    """Return a stored run, proved to come out as stored, and the same to ``t_end``."""
    from rattlesweep.analysis.onerun.replay import find_run
    from rattlesweep.system.files import as_path

    check_count("case", case, 0)
    check_count("sample", sample, 0)
    run = find_run(as_path(directory, "directory"), case, sample, where)
    prepared = run.prepare(one_number("t_end", t_end, run.units))
    run.prove()
    return run, prepared


def rows_of(
    units: Units | None,
    points: int | None = None,
    dt: object = None,
    steps: bool = False,
    times: object = None,
    from_time: object = None,
) -> dict[str, Any]:
    """Return the arguments of a course that choose its rows, in units of its body."""
    check_count("points", points, 2)
    return {
        "points": points,
        "dt": one_number("dt", dt, units),
        "steps": steps,
        "times": None if times is None else numbers("times", times, units),
        "from_time": one_number("from_time", from_time, units),
    }
