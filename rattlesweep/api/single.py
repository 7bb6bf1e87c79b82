"""Single runs: outcomes, time series, animated pages, fits, replays of stored runs."""

from __future__ import annotations

import html
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from os import PathLike
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from rattlesweep.api import arrays as arguments
from rattlesweep.api.arrays import BodiesLike, check_count, numbers, one_number
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, ConfigWarning, check_names
from rattlesweep.physics.body import Rattleback
from rattlesweep.quantities import INITIAL_RATES, LOSSES
from rattlesweep.text import Bar, counted

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    OneFilm: TypeAlias = (
        str | PathLike[str] | pd.DataFrame | Mapping[str, Sequence[float]]
    )

    from rattlesweep.analysis.fit.joint import JointFit
    from rattlesweep.analysis.fit.measured import MeasuredBody, Prior
    from rattlesweep.analysis.fit.result import Fit
    from rattlesweep.analysis.onerun.course import Course, PreparedRun
    from rattlesweep.analysis.onerun.replay import StoredRun
    from rattlesweep.design.single import Launch
    from rattlesweep.physics.si import Units


# A number, or text with an SI unit such as "60 rpm".
Number: TypeAlias = "float | str"
_STATE = ("omega_x", "omega_y", "omega_z", "u_x", "u_y", "u_z")
INTEGRATOR = ("method", "tol", "dt_step", "accuracy")
ROWS = ("points", "dt", "steps", "times", "from_time")
SHOWN = ("points", "from_time", "path")
LAUNCH_ARGUMENTS = (
    *INITIAL_RATES,
    "omega",
    "u",
    "t_end",
    "psi",
    "model",
    *LOSSES,
    *INTEGRATOR,
)


class Run(SimpleNamespace):
    """Outcome of one run: an attribute for each column of ``runs``, and `units`."""

    def __getitem__(self, name: str) -> Any:
        check_names("columns", [name], vars(self))
        return getattr(self, name)

    def __repr__(self) -> str:
        shown = ["t_r=None"]
        if self.t_r is not None:
            shown = [f"t_r={self.t_r:.10g}"]
        if getattr(self, "t_r_s", None) is not None:
            shown.append(f"{self.t_r_s:.5g} s")
        shown.append(f"t_end={self.t_end:.10g}")
        shown += [f"type={self.type}", f"status={self.status}"]
        return f"<Run {', '.join(shown)}>"

    def to_dict(self) -> dict[str, Any]:
        """Return all columns of the run by name."""
        return {name: value for name, value in vars(self).items() if name != "units"}


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
    """A self-contained HTML page, which notebooks show, and the file that has it."""

    content: bytes = field(repr=False)
    path: Path | None = None

    def save(self, path: str | Path) -> Page:
        """Write the page to an .html file, and return it with its path."""
        from rattlesweep.files import as_path, replace_file

        path = as_path(path, "path")
        if path.suffix.lower() not in (".html", ".htm"):
            raise ConfigError(f"path {path}: the name must end in .html or .htm")
        replace_file(path, self.content)
        return Page(self.content, path)

    def _repr_html_(self) -> str:
        # Scripts in this frame have no access to the notebook.
        look = 'sandbox="allow-scripts" style="width: 100%; height: 720px; border: 0"'
        return f'<iframe {look} srcdoc="{html.escape(self.content.decode())}"></iframe>'


def simulate(
    body: BodiesLike,
    *,
    n_i: ArrayLike | None = None,
    omega_xy0: ArrayLike | None = None,
    omega: ArrayLike | None = None,
    u: ArrayLike | None = None,
    t_end: ArrayLike | None = None,
    psi: str | ArrayLike | None = None,
    model: str = "full",
    record: str | Sequence[str] = (),
    threads: int | None = None,
    progress: bool | None = None,
    **settings: Any,
) -> Any:
    """Integrate bodies from their launches to their first reversals or to ``t_end``.

    Arrays are broadcast by NumPy's rules.  If the size of the bodies is known, spins,
    times and losses may be texts with a unit: ``"60 rpm"``, ``"20 s"``, ``"1e-5 N m
    s"``.

    Returns a ``Run``, or a DataFrame if any argument is an array: one row per run, in C
    order of ``attrs["shape"]``, with the columns of a sweep's ``runs`` except ``case``
    and ``sample``, ``t_r_s`` and ``n_i_rpm`` if sizes are known, and the index of a
    DataFrame of bodies.

    Parameters
    ----------
    body : Rattleback, str, sequence or array of these, or DataFrame
        A text is the name of a preset, ``"GH"`` or ``"KL"``.  A table, such as the runs
        of a sweep, has the columns ``alpha beta gamma theta phi xi`` and may have ``n_i
        omega_xy0 psi t_end``, which count unless `n_i` and `omega_xy0` are given; then
        only the ``t_end`` of a table without launches counts.  Angles are in radians,
        ``psi``, too, unlike the argument.
    n_i, omega_xy0 : array_like
        Initial spin and oscillation, in ``sqrt(g/a)``; ``n_i=0`` is a tap, by default
        on the pitch.
    omega, u : array_like, shape (..., 3)
        A full state instead, along the body's axes: angular velocity, in ``sqrt(g/a)``,
        and vertical unit vector, by default ``(0, 0, -1)`` (upright).
    t_end : array_like, optional
        Horizon, in ``sqrt(a/g)``, by default 5 t_rGH of the spin's own direction.
    psi : array_like, optional
        Direction of the oscillation: ``relevant`` (default), ``pitch``, ``roll``, or
        degrees.  The column ``psi`` of the result is in radians.
    model : str
        ``full``, ``reduced`` or ``gh``.
    record : str or sequence of str
        Extra columns, such as ``["error", "energy"]``.
    threads : int, optional
        Threads of the kernel, by default all.
    progress : bool, optional
        Whether to show a bar, by default in a terminal and in a notebook.
    **settings
        Dissipation, by the names of the config: arrays of ``sigma``, the coefficient of
        a torque ``-sigma omega``, in ``M a^2 sqrt(g/a)``, and of ``rolling``, the lever
        of a rolling resistance, and of ``pivot``, the lever of the torque against
        pivoting, both in ``a``, and ``mu``, the coefficient of sliding friction,
        without which the foot never slides.  Integrator: ``method`` with
        ``tol`` or ``dt_step``, or an ``accuracy``: ``"draft"``, ``{"t_r": 1e-6}``.

    Examples
    --------
    >>> rs.simulate("GH", n_i=0.1, omega_xy0=0.01)
    <Run t_r=112.093878, t_end=112.093878, type=R, status=ok>
    """
    from rattlesweep.design.bodies.table import (
        TableBodies,
        launched_from,
        unknown_columns,
    )
    from rattlesweep.design.plausible import near_tap
    from rattlesweep.design.single import directions, is_full_state, plan_of_rows
    from rattlesweep.integrate.compile import listening
    from rattlesweep.work.run import integrate_plan

    check_names(
        "arguments", settings, (*LAUNCH_ARGUMENTS, "record", "threads", "progress")
    )
    integrator = {name: settings[name] for name in INTEGRATOR if name in settings}
    losses = {name: settings[name] for name in LOSSES if name in settings}
    check_count("threads", threads)
    if arguments.is_table(body):
        unused = unknown_columns(arguments.column_names(body))
        if unused:
            text = f"bodies: columns not used: {', '.join(unused)}"
            warnings.warn(text, ConfigWarning, stacklevel=2)
    columns = arguments.body_columns(body)
    units = arguments.column_units(columns)

    # The launches as arrays in units of the bodies, and broadcast with these.
    spin = {"n_i": n_i, "omega_xy0": omega_xy0}
    arrays = {
        name: numbers(name, value, units)
        for name, value in (spin | {"t_end": t_end} | losses).items()
        if value is not None
    }
    full = is_full_state(omega, u, spin | {"psi": psi})
    if full:
        arrays |= arguments.full_states(omega, u, units)
    if psi is not None and not isinstance(psi, str):
        arrays["psi"] = np.radians(numbers("psi", psi))
    columns, shape = arguments.broadcast(_launched(columns, arrays, psi))
    columns = {name: column.ravel() for name, column in columns.items()}
    if full:
        columns |= launched_from(columns, "launch")
    elif isinstance(psi, str):
        columns["psi"] = directions(columns, psi)
    units = arguments.column_units(columns)
    sizes = {
        name: columns.pop(name) for name in arguments.SIZE_COLUMNS if name in columns
    }
    if units is None:
        sizes = {name: sizes[name] for name in sizes if name == "rim"}
    question = None
    if "u_x" not in columns:
        question = near_tap(columns["n_i"])
    if question is not None:
        warnings.warn(f"n_i: {question}", ConfigWarning, stacklevel=2)
    rows = TableBodies(columns, units, sizes)
    names = arguments.names_of("record", record)
    plan = plan_of_rows(rows, model, integrator, names, {})
    if not shape:
        threads = 1
    with Bar.of_call(progress) as bar, listening(bar.compiling):
        report = bar.counting(f"{plan.runs:,} runs")
        table = integrate_plan(plan, threads, report)
    table = table.cast(plan.schema).drop_columns(["case", "sample"])
    if not shape:
        return Run(**table.to_pylist()[0], units=arguments.units_of(table.schema))
    frame = arguments.to_frame(table)
    frame.attrs["shape"] = shape
    if arguments.is_frame(body) and shape == (len(body),):
        frame.index = body.index
    return frame


def trajectory(
    body: Rattleback | str,
    *,
    channels: Sequence[str] | None = None,
    section: str | None = None,
    points: int | None = None,
    dt: Number | None = None,
    steps: bool = False,
    times: ArrayLike | None = None,
    from_time: Number | None = None,
    **launch: Any,
) -> Trajectory:
    """Integrate one launch to ``t_end``, past its reversals, as a time series.

    The accepted steps, and so the first zero, are those of ``simulate``, whichever rows
    are requested.

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
    from_time: Number | None = None,
    points: int | None = None,
    title: str | None = None,
    path: str | Path | None = None,
    **launch: Any,
) -> Page:
    """Make a page on which a body rolls on the plane, with its trace and its spin.

    The arguments are those of ``trajectory``, with 20 rows per pitch period by default.
    `title` is the title of the page, and `path` an .html file to write it to.
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
    t_end: Number | None = None,
    channels: Sequence[str] | None = None,
    section: str | None = None,
    **rows: Any,
) -> Trajectory:
    """Integrate a stored run again as a trajectory, if it comes out as stored.

    `case` and `sample` are columns of the ``runs`` in an output directory, complete or
    running. The other arguments are those of ``trajectory``; `t_end` is by default the
    sweep's.  Raises an OutputError if the run is not stored yet, is damaged, or differs
    in any bit.
    """
    _, run = prepare_stored(directory, t_end, case=case, sample=sample)
    return Trajectory(run, channels, section, **rows)


def fit(
    body: Rattleback | str | Mapping[str, Any],
    data: OneFilm | Sequence[OneFilm],
    *,
    free: Iterable[str],
    launch: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None = None,
    error: Number | None = None,
    robust: bool = False,
    progress: bool | None = None,
    **losses: Number,
) -> Fit | JointFit:
    """Fit parameters of one run to a measured angle or spin, or to reversal times.

    A quantity that was measured otherwise may be a text with its standard error, such
    as ``"60 +- 1 g"`` (or ``±``).  It is then fitted, too, and its difference from the
    measured value, over the error, is one more residual.

    The 95 % intervals come from the Jacobian at the best fit.  They assume independent
    noise, of the size that `error` or a column says, or else of equal size, estimated
    from the residuals.

    A list of films is fitted together: each has its own launch, and what else is free
    is the same for all.  The noise is that of each film.

    Parameters
    ----------
    body : Rattleback, str or mapping
        What is known of the body; with a size if the data are in seconds.  A mapping
        has the keys of a stone file, such as ``{"shape": "half_ellipsoid", "length":
        "12 +- 0.02 cm", ...}``, and numbers in SI units.
    data : path, DataFrame or mapping of columns, or a list of these
        ``t_s`` (or ``t_ms``) and ``angle_deg``, ``spin_rpm``, ``n_rpm`` or
        ``gyro_rad_s`` (about the stone's own upward axis), an export of Tracker or
        phyphox with these quantities, two marks ``x1_px, y1_px, x2_px, y2_px``; or
        ``reversal_s`` alone. ``t`` and ``n`` are in the units of the body.  The angle
        is that of the long axis, counterclockwise seen from above, and may jump by half
        turns; the spin is its central difference, and n is ``u . omega``.  The launch
        is the first row, or time 0.  A column such as ``angle_error_deg`` has the
        standard errors.
    free : sequence of str
        Parameters to fit, of ``n_i, omega_xy0, psi_deg, sigma, rolling, pivot, mu,
        skew`` (which is ``-xi``), ``xi, theta, phi, alpha, beta, gamma, c``, and of a
        mapping ``length, width, height, mass, weights, wall, axes_angle, f_sd``.  The
        search begins at their given values.
    launch : mapping
        ``n_i, omega_xy0, psi`` or ``omega, u``; free parameters may be left out. For
        several films also a list.
    error : number or str, optional
        Standard error of all values, in the unit of the column or with a unit.
    robust : bool
        Whether to leave out rows that are far off all others; a remark names them.
    progress : bool, optional
        Whether to show a bar, by default in a terminal and in a notebook.
    **losses
        Dissipation, as for ``simulate``: ``sigma``, ``rolling``, ``pivot`` and
        ``mu``.

    Raises
    ------
    ConfigError
        If an argument or the data are wrong, or the data are too few.
    """
    options: dict[str, Any] = {"free": free, "error": error, "robust": robust, **losses}
    with Bar.of_call(progress) as bar:
        if isinstance(data, list | tuple):
            return fit_films(bar, body, data, launch=launch, **options)
        one: Any = data
        return fit_with_progress(bar, body, one, launch=launch, **options)


def fit_films(
    bar: Bar, body: object, data: Sequence[OneFilm], *, launch: Any, **options: Any
) -> JointFit:
    """Fit several films together as :func:`fit` does, and show the progress."""
    from rattlesweep.analysis.fit.joint import fit_together

    launches = launch
    if not isinstance(launch, list | tuple):
        launches = [launch] * len(data)
    if len(launches) != len(data) or len(data) < 2:
        raise ConfigError(
            f"launch: {counted(len(data), 'film')} with {len(launches)} of launches; "
            "give two films or more, and one launch for all or one for each"
        )
    fits = [
        fit_with_progress(bar, body, one, launch=own, **options)
        for one, own in zip(data, launches, strict=True)
    ]
    return fit_together(fits)


def fit_with_progress(
    bar: Bar,
    body: object,
    data: OneFilm,
    *,
    free: Iterable[str],
    launch: Any,
    error: Number | None = None,
    robust: bool = False,
    **losses: Any,
) -> Fit:
    """Fit as :func:`fit` does, and show the progress on a bar."""
    from rattlesweep.analysis.fit.film import read_film
    from rattlesweep.analysis.fit.search import fit_run
    from rattlesweep.integrate.compile import listening

    if isinstance(data, Mapping):
        arguments.refuse_units_of_columns("data", data)
    run, stone, priors, names = _to_fit(body, free, launch, losses)
    film = read_film(data, run.body.units, error, run.n_i)
    with listening(bar.compiling):
        return fit_run(run, film, names, bar.counting("fit"), stone, priors, robust)


def plan_of_fit(
    body: object,
    *,
    free: Iterable[str],
    launch: Any,
    seconds: str,
    fps: float,
    error: Number | None = None,
    **losses: Any,
) -> Fit:
    """Return the fit that a film of the given values would have, at its best."""
    from rattlesweep.analysis.fit.film import read_film
    from rattlesweep.analysis.fit.search import planned_fit
    from rattlesweep.analysis.fit.synthetic import synthetic_film

    run, stone, priors, names = _to_fit(body, free, launch, losses)
    table = synthetic_film(run, seconds, fps)
    film = read_film(table, run.body.units, error or "0.5 deg", run.n_i)
    return planned_fit(run, film, names, stone, priors)


def film_of(
    body: object,
    *,
    launch: Any,
    seconds: str,
    fps: float,
    noise: str,
    seed: int,
    **losses: Any,
) -> pd.DataFrame:
    """Return a synthetic film of a stone."""
    from rattlesweep.analysis.fit.synthetic import synthetic_film

    run, _, _, _ = _to_fit(body, ["n_i"], launch, losses)
    return synthetic_film(run, seconds, fps, noise, seed)


def _to_fit(
    body: object, free: Iterable[str], launch: Any, losses: Mapping[str, Any]
) -> tuple[Launch, MeasuredBody, dict[str, Prior], list[str]]:
    """Return the run of a fit, its body, priors and free parameters."""
    from rattlesweep.analysis.fit.measured import (
        MeasuredBody,
        measured_body,
        separate,
    )
    from rattlesweep.analysis.fit.search import check_free

    launch = launch or {}
    if not isinstance(launch, Mapping):
        raise ConfigError(f"launch: {arguments.kind_of(launch)} is not a mapping")
    check_names("launch", launch, (*INITIAL_RATES, "psi", "omega", "u"))
    check_names("arguments", losses, LOSSES)
    if isinstance(body, Mapping):
        body = measured_body(body)
    if not isinstance(body, MeasuredBody):
        body = MeasuredBody(arguments.one_body(body))
    values, errors = separate({**launch, **losses})
    run = launch_of(body.body, **values)
    priors = {**body.priors, **_priors(run, errors)}
    wanted = arguments.names_of("free", free)
    # What was measured with an error is free as well.
    wanted = [*wanted, *(name for name in priors if name not in wanted)]
    return run, body, priors, check_free(run, wanted, body)


def _priors(run: Launch, errors: Mapping[str, Number]) -> dict[str, Prior]:
    """Return the priors of a launch and its dissipation, in units of the body."""
    from rattlesweep.analysis.fit.measured import Prior

    priors = {}
    for name, error in errors.items():
        width = one_number(name, error, run.body.units)
        value = run.losses.get(name, getattr(run, name, None))
        assert isinstance(value, float)
        assert width is not None
        # The direction is in degrees.
        priors["psi_deg" if name == "psi" else name] = Prior(value, width)
    return priors


def page_of(
    run: PreparedRun,
    title: str | None,
    *,
    points: int | None = None,
    from_time: Number | None = None,
    path: str | Path | None = None,
) -> tuple[Page, Course]:
    """Return the page of a run and its course; write the page if there is a path."""
    from rattlesweep.analysis.onerun.show import course_of_page, make_page, make_scene

    check_count("points", points, 2)
    course = course_of_page(run, points, one_number("from_time", from_time, run.units))
    page = Page(make_page(make_scene(course), str(title or "Rattleback"), run.title))
    if path is not None:
        page = page.save(path)
    return page, course


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
    from rattlesweep.files import as_path

    check_count("case", case, 0)
    check_count("sample", sample, 0)
    run = find_run(as_path(directory, "directory"), case, sample, where)
    prepared = run.prepare(one_number("t_end", t_end, run.units))
    run.prove()
    return run, prepared


def prepare_launch(body: object, **launch: Any) -> PreparedRun:
    """Return one launch, ready to be integrated."""
    from rattlesweep.analysis.onerun.course import PreparedRun

    return PreparedRun.of(launch_of(body, **launch))


def launch_of(
    body: object,
    *,
    psi: object = None,
    omega: object = None,
    u: Any = None,
    model: str = "full",
    **values: Any,
) -> Launch:
    """Return one launch with its numbers in the units of its body."""
    from rattlesweep.design.single import Launch

    stone = arguments.one_body(body)
    check_names("arguments", values, (*LAUNCH_ARGUMENTS, "e_p0", "e_r0"))
    present = {name: value for name, value in values.items() if value is not None}
    integrator = {name: present.pop(name) for name in INTEGRATOR if name in present}
    single: dict[str, Any] = {
        name: one_number(name, value, stone.units) for name, value in present.items()
    }
    losses = {name: single.pop(name) for name in LOSSES if name in single}
    components: list[float] | None = None
    if omega is not None:
        state = arguments.full_states(omega, u, stone.units)
        components = [float(state[f"omega_{axis}"]) for axis in "xyz"]
    return Launch(
        stone,
        psi=psi if isinstance(psi, str) else one_number("psi", psi),
        omega=components,
        u=u,
        model=model,
        integrator=integrator,
        losses=losses,
        **single,
    )


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


def _launched(
    columns: dict[str, Floats], arrays: dict[str, Floats], psi: object
) -> dict[str, Floats]:
    """Return the columns of bodies with the launches, or else those of their table."""
    if any(name in arrays for name in (*INITIAL_RATES, *_STATE)):
        replaced = {*INITIAL_RATES, "psi", *_STATE}
        if columns.keys() & replaced:
            # The horizons of a table belong to its own launches, if it has some.
            replaced.add("t_end")
        columns = {
            name: column for name, column in columns.items() if name not in replaced
        }
    elif psi is not None:
        if "u_x" in columns:
            raise ConfigError(
                "psi does not go with the full states of the table; leave it out"
            )
        columns.pop("psi", None)
    launched = columns | arrays
    missing = [name for name in INITIAL_RATES if name not in launched]
    if missing and "u_x" not in launched:
        names = " and ".join(missing)
        raise ConfigError(f"{names} missing; give both, or a table with them")
    return launched
