"""One run as a table of chosen channels, whole or in chunks."""
# ruff: noqa: D102 - names and types say it

from __future__ import annotations

import html
import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from rattlesweep.analysis.onerun.channels import View, choose, contact_force, in_si, spin
from rattlesweep.analysis.onerun.rows import Rows
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import PLATEAU_SHARE
from rattlesweep.integrate.follow import Follower, Samples
from rattlesweep.integrate.model import REDUCED
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import DOP853, METHODS
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.sweeps.launches import Launch, model_of, reduced_batch, single_run, with_energies
from rattlesweep.text import counted

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from rattlesweep.integrate.batch import Batch
    from rattlesweep.physics.si import Units
    from rattlesweep.sweeps.config.schema import Config
    from rattlesweep.sweeps.launches import Launches

# A run that is ready to be integrated, as :func:`single_run` makes it of a launch and
# :meth:`rattlesweep.analysis.onerun.replay.Replay.prepare` of a stored run.
PreparedRun: TypeAlias = "tuple[Config, Launches, Batch | None]"
# Rows that are in memory at once.
CHUNK = 8192
# Tolerance of the reduced model beside: its errors are far below its distance from the full one.
BESIDE_TOL = 1e-10


@dataclass
class Observer:
    """Turns and contact forces of a run, from its launch and its accepted steps as they come."""

    plateau: float  # modulus of the launch's spin; of a launch without spin, n_0
    zeros: list[float] = field(default_factory=list)  # of the spin so far, kept by the follower
    reversals: list[float] = field(default_factory=list)  # the first zero of each turn
    normal_min: float = math.inf  # least normal force in M g
    friction_max: float = 0.0  # largest ratio of the tangential force to it
    lifts: float = math.nan  # when the first is first negative; NaN if never
    slips: float = math.nan  # when the second is first above 1; NaN if never
    # The last time beyond the share PLATEAU_SHARE of the plateau, and the sign of the spin then.
    _last: tuple[float, float] = (0.0, 0.0)

    def spin(self, t: Floats, n: Floats) -> None:
        far = np.abs(n) > PLATEAU_SHARE * self.plateau
        t = np.concatenate([[self._last[0]], t[far]])
        side = np.concatenate([[self._last[1]], np.sign(n[far])])
        for k in np.flatnonzero(side[1:] * side[:-1] < 0):
            first = bisect_right(self.zeros, t[k])
            self.reversals += self.zeros[first : first + 1]
        self._last = float(t[-1]), float(side[-1])

    def forces(self, t: Floats, normal: Floats, tangential: Floats) -> None:
        ratio = np.divide(tangential, normal, out=np.zeros(len(t)), where=normal > 0)
        if not self.lifts <= t[0] and (normal < 0).any():
            self.lifts = float(t[np.argmax(normal < 0)])
        if not self.slips <= t[0] and (ratio > 1).any():
            self.slips = float(t[np.argmax(ratio > 1)])
        self.normal_min = min(self.normal_min, float(normal.min()))
        self.friction_max = max(self.friction_max, float(ratio.max()))

    @property
    def warning(self) -> str:
        """One sentence on what the model does that no real body would; empty if nothing."""
        if math.isfinite(self.lifts):
            return (
                f"contact would be lost at t = {self.lifts:.4g}, where the normal force becomes "
                f"negative (least: {self.normal_min:.2g} M g); the model keeps the body on the "
                "plane all the same"
            )
        if math.isfinite(self.slips):
            return (
                "rolling without slip needs a coefficient of friction above 1 from "
                f"t = {self.slips:.4g} (largest: {self.friction_max:.3g})"
            )
        return ""


class _ClosedForm:
    """Garcia and Hubbard's solution in a follower's place: there is nothing to integrate."""

    status, n_steps, ended, energy_0 = Status.OK, 0, True, math.nan

    def __init__(self, launches: Launches) -> None:
        self.t = float(launches.t_end[0])
        t_rgh = float(launches.gh.t_rgh[0])
        self.zeros = [t_rgh] if t_rgh <= self.t else []

    def at(self, times: Floats) -> Samples:
        nothing = np.zeros((len(times), 0))
        return Samples(times, nothing, nothing)


class Course:
    """A trajectory under way: iterate to get its columns chunk by chunk.

    `watch` is called with the share that is done, every few thousand steps.  `zeros` and
    `reversals` are the times of all zeros of the spin so far, and of the first zero of each turn.
    """

    def __init__(
        self,
        run: Launch | PreparedRun,
        *,
        channels: Sequence[str] = ("t", "n"),
        rows: Rows = Rows(),  # noqa: B008 - frozen
        watch: Callable[[float], None] | None = None,
    ) -> None:
        self.units: Units | None = None
        energies: tuple[float | None, float | None] = None, None
        if isinstance(run, Launch):
            energies, self.units = (run.e_p0, run.e_r0), run.body.units
        config, launches, batch = single_run(run) if isinstance(run, Launch) else run
        # The launch and what theory says of it, as arrays over this one run.
        self.launches, self.model = launches, str(config.model)
        chosen = choose(channels, self.model)
        self.si = in_si(chosen, self.units)
        self.channels = *chosen, *self.si.values()
        self.body = {name: float(getattr(launches.bodies, name)[0]) for name in PARAMETERS}
        if launches.bodies.c is not None and np.isfinite(launches.bodies.c[0]):
            self.body["c"] = float(launches.bodies.c[0])
        self.launch = {
            name: float(getattr(launches, name)[0]) for name in ("n_i", "omega_xy0", "psi")
        }
        self.t_end = t_end = float(launches.t_end[0])
        if not (math.isfinite(t_end) and t_end > 0):
            raise ConfigError("t_end: Garcia and Hubbard's time of reversal is no finite time; "
                              "give t_end")  # fmt: skip
        if rows.steps and batch is None:
            raise ConfigError("steps: the model gh takes none; give points or dt")
        # Periods of the pitch up to the horizon; 0 for a model without them.
        pitch = float(launches.modes.omega_p[0]) / (2 * math.pi)
        self.periods = t_end * pitch if self.model == "full" else 0.0
        # Times of the rows; None for the accepted steps.
        self.times = rows.up_to(t_end, self.periods)
        self._start = rows.from_time or 0.0
        needs = {channel.needs for channel in self.channels}
        if "reduced" in needs and launches.bodies.omega is not None:
            raise ConfigError("channels: the reduced model begins with a spin and an oscillation, "
                              "and has no run beside one launched from a full state")  # fmt: skip
        if self.model == "full" and energies != (None, None) and "reduced" not in needs:
            raise ConfigError("e_p0 and e_r0 are of the reduced model; no channel asks for it")
        own = config.integrator
        tableau = METHODS[own.method]
        setting: dict[str, Any] = {"tol": own.tol} if tableau.adaptive else {"dt": own.dt}
        self.integrator: dict[str, Any] = {"method": own.method} | setting
        self.observer = Observer(float(launches.spin_scale[0]))
        self.constants = np.zeros(0) if batch is None else batch.constants[0]
        self._follower: Follower | _ClosedForm
        if batch is None:
            self._follower = _ClosedForm(launches)
            # Its spin has one zero and goes through it for good.
            self.observer.reversals += self._follower.zeros
        else:
            self._follower = Follower(
                batch,
                tableau,
                model_of(config),
                **setting,
                max_steps=own.max_steps,
                attitude="attitude" in needs,
                look=self._look,
                watch=None if watch is None else lambda t: watch(min(1.0, t / t_end)),
            )
        self.zeros = self.observer.zeros = self._follower.zeros
        self.reversals = self.observer.reversals
        self._view = partial(View, self.model, launches, self.constants, self._follower.energy_0)
        self._beside = None
        if "reduced" in needs:
            beside = with_energies(reduced_batch(launches), *energies)
            self._beside = Follower(beside, DOP853, REDUCED, tol=BESIDE_TOL)

    @property
    def t(self) -> float:
        return self._follower.t

    @property
    def status(self) -> Status:
        return self._follower.status

    @property
    def n_steps(self) -> int:
        return self._follower.n_steps

    def __iter__(self) -> Iterator[dict[str, Floats]]:
        """Yield columns by name, at most :data:`CHUNK` rows at a time."""
        for samples in self._samples():
            beside = None if self._beside is None else self._beside.at(samples.t)
            view = self._view(samples, beside)
            yield {channel.name: channel.of(view) for channel in self.channels}

    def columns(self) -> dict[str, Floats]:
        chunks = list(self)
        return {
            c.name: np.concatenate([np.zeros(0), *(chunk[c.name] for chunk in chunks)])
            for c in self.channels
        }

    def _samples(self) -> Iterator[Samples]:
        follower = self._follower
        if self.times is None:
            assert isinstance(follower, Follower)
            found = follower.launch()
            while found.t.size or not follower.ended:
                early = int(np.searchsorted(found.t, self._start))
                if early < len(found.t):  # what was not asked for has no rows
                    yield Samples(found.t[early:], found.y[early:], found.extra[early:])
                found = follower.steps()
            return
        for begin in range(0, len(self.times), CHUNK):
            part = self.times[begin : begin + CHUNK]
            found = follower.at(part)
            if found.t.size:
                yield found
            if found.t.size < part.size:
                return
        # What lies behind the last row belongs to the run: its reversals and its status.
        while isinstance(follower, Follower) and not follower.ended:
            follower.steps()

    def _look(self, t: Floats, y: Floats) -> None:
        """Observe the accepted steps as they come, and at first the launch."""
        if not len(t):
            return
        columns = np.ascontiguousarray(y.T)
        with np.errstate(all="ignore"):  # a run that goes wrong overflows
            if self.model == "reduced":
                self.observer.spin(t, columns[0])
            else:
                self.observer.spin(t, spin(columns))
                self.observer.forces(t, *contact_force(columns, self.constants))


@dataclass(frozen=True)
class Trajectory:
    """A run as a table.

    Attributes
    ----------
    table : pandas.DataFrame
        One column per channel; NaN where a channel has no finite value. Of a body whose size is
        known, the same in SI units follow, such as ``t_s`` and ``n_rpm``.
    reversals : ndarray
        Times of the turns up to ``t_end``, in ``sqrt(a/g)``: the spin has gone from beyond a
        quarter of the launch's spin to beyond a quarter on the other side, and the time is that of
        its first zero on the way.
    zeros : ndarray
        Times of all zeros of the spin; the first is the ``t_r`` of a sweep.
    t_end : float
        Time reached.
    status : str
        ``ok``, or a word for what went wrong, as in the tables of runs.
    n_steps : int
        Accepted steps.
    units : dict
        Unit of each column.
    warning : str
        Where contact would be lost, or rolling needs a coefficient of friction above 1; else empty.
    si : dict
        Columns in SI units by those they belong to, such as ``t_s`` by ``t``.
    """

    table: pd.DataFrame
    reversals: Floats
    zeros: Floats
    t_end: float
    status: str
    n_steps: int
    units: dict[str, str]
    warning: str = ""
    si: dict[str, str] = field(default_factory=dict)
    page: Callable[..., Any] | None = field(default=None, repr=False, compare=False)

    def show(self, **settings: Any) -> Any:
        """Return the page on which the body rolls; settings as for :func:`rattlesweep.show`."""
        assert self.page is not None
        return self.page(**settings)

    def __getitem__(self, columns: str | list[str]) -> Any:
        """Return a column as a Series, or several as a DataFrame."""
        return self.table[columns]

    def __repr__(self) -> str:
        turns = counted(len(self.reversals), "reversal")
        names = ", ".join(map(str, self.table))
        return (
            f"<Trajectory of {names}: {counted(len(self.table), 'row')}, {turns} by "
            f"t = {self.t_end:g}, {self.status}>"
        )

    def _repr_html_(self) -> str:
        return f"<div>{html.escape(repr(self))}{self.table.to_html(max_rows=6)}</div>"

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw each column against the time, and write the figure to a file if `path` is given.

        Raises
        ------
        ConfigError
            If the table has no column ``t``, or no other one.
        """
        from rattlesweep.analysis import style

        names = [str(name) for name in self.table if name not in ("t", *self.si.values())]
        if "t" not in self.table or not names:
            raise ConfigError("channels: t and at least one other are needed for a plot")
        shown = {name: self.si.get(name, name) for name in ("t", *names)}
        with style.styled():
            figure = style.new_figure(7.2, 1.2 + 1.6 * len(names))
            panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
            for panel, name in zip(panels, names, strict=True):
                t, values = (self.table[shown[k]].to_numpy() for k in ("t", name))
                style.curve(panel, t, values)
                panel.set_ylabel(style.label(name, self.units[shown[name]]))
                style.light_grid(panel)
            panels[-1].set_xlabel(style.label("t", self.units[shown["t"]]))
            if path is not None:
                style.save(figure, [Path(path)], 150.0)
        # Figures made without pyplot need `_repr_png_` to show in a notebook.
        setattr(figure, "_repr_png_", lambda: style.encode(figure, "png", 110.0))  # noqa: B010
        return figure


def collect(course: Course, page: Callable[..., Any] | None = None) -> Trajectory:
    """Integrate the whole trajectory into memory; `page` is what its `show` calls."""
    import pandas as pd  # half a second, which commands need not wait for

    table = pd.DataFrame(course.columns())
    units = {c.name: c.unit for c in course.channels}
    zeros, reversals = np.array(course.zeros), np.array(course.reversals)
    si = {name: channel.name for name, channel in course.si.items()}
    return Trajectory(table, reversals, zeros, course.t, course.status.label, course.n_steps,
                      units, course.observer.warning, si, page)  # fmt: skip
