"""One run as a table of chosen channels, whole or in chunks."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from rattlesweep.errors import ConfigError
from rattlesweep.integrate.follow.trajectory import Follower, Samples
from rattlesweep.integrate.model import MODELS, REDUCED
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import DOP853, METHODS
from rattlesweep.study.onerun.channels import Channel, View, choose, force_of, spin_of
from rattlesweep.sweeps.blocks.single import Launch, single_run
from rattlesweep.sweeps.cases.launches import reduced_batch, with_energies

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    from rattlesweep.integrate.batch import Batch
    from rattlesweep.physics.body import Rattleback
    from rattlesweep.sweeps.cases.launches import Launches
    from rattlesweep.sweeps.config.load import Config

    Floats = NDArray[np.float64]

# Rows that are in memory at once.
CHUNK = 8192
# Rows of a table that is asked for without a word on its times: so many at least, and so many in
# a period of the pitch.
POINTS, PER_PERIOD = 2001, 20
# The spin has reversed once it has gone from beyond this share of the launch's spin to beyond it on
# the other side.  Where the spin has plateaus, any share from 0.05 to 0.5 counts the same (GH at
# n_i = 0.1 and -0.1, with theta = 0.64, 0.75 and 0.9); a spin that wanders has no sure count.
TURN = 0.25
# Of the reduced model beside: its errors are then far below its own distance from the full one.
BESIDE_TOL = 1e-10


class Times(Protocol):
    """Increasing times that need not all be there at once."""

    def __len__(self) -> int:
        """How many there are."""

    def __getitem__(self, part: slice, /) -> Floats:
        """Some of them."""


@dataclass(frozen=True)
class EvenTimes:
    """``step * k / parts`` for ``k`` from 0 to ``count - 1``."""

    count: int
    step: float
    parts: int = 1

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, part: slice) -> Floats:
        k = np.arange(*part.indices(self.count), dtype=float)
        # One division, of exact whole numbers: the last of N points is the horizon itself.
        return self.step * (k / self.parts)


def even_points(t_end: float, points: int) -> EvenTimes:
    """So many times, even from 0 to ``t_end``."""
    return EvenTimes(points, t_end, points - 1)


def make_times(
    t_end: float,
    points: int | None,
    dt: float | None,
    steps: bool,
    times: Any,
    default: int = POINTS,
) -> Times | None:
    """Times of the rows, ``default`` of them; None for those of the accepted steps.

    Raises
    ------
    ConfigError
        If more than one way is given, or it makes no increasing times from 0 to ``t_end``.
    """
    ways = {"points": points, "dt": dt, "steps": steps or None, "times": times}
    given = [name for name, value in ways.items() if value is not None]
    if len(given) > 1:
        raise ConfigError(f"{' and '.join(given)} are both given; keep one of them")
    if steps:
        return None
    if times is not None:
        array = np.array(times, dtype=float, ndmin=1)
        if array.ndim != 1 or not array.size or not np.all(np.isfinite(array)):
            raise ConfigError("times: a list of finite numbers is needed")
        if array[0] < 0 or array[-1] > t_end or np.any(np.diff(array) <= 0):
            raise ConfigError(f"times: they must increase, from 0 at least to t_end = {t_end:g}")
        return array
    if dt is not None:
        if not (math.isfinite(dt) and dt > 0):
            raise ConfigError(f"dt {dt:g}: the distance of two rows must be positive")
        # A last row at the horizon, also where rounding has dt * k just above it.
        count = math.floor(t_end / dt * (1 + 1e-15)) + 1
        while dt * (count - 1) > t_end:
            count -= 1
        return EvenTimes(count, dt)
    points = default if points is None else points
    if points < 2:
        raise ConfigError(f"points {points}: at least 2 are wanted, the launch and the end")
    return even_points(t_end, points)


@dataclass
class Seen:
    """What a run does at its launch and its accepted steps, whatever rows are asked for.

    Attributes
    ----------
    plateau : float
        Modulus of the launch's spin.
    reversals : list of float
        Of each reversal (:data:`TURN`) its first zero.
    normal_min, friction_max : float
        Least normal force in ``M g``, and the largest ratio of the tangential to the normal force.
    lifts, slips : float
        When the first is first negative and the second first above 1; NaN if never.
    """

    plateau: float
    reversals: list[float] = field(default_factory=list)
    normal_min: float = math.inf
    friction_max: float = 0.0
    lifts: float = math.nan
    slips: float = math.nan
    # The last time beyond TURN of the plateau, and the sign of the spin then.
    _last: tuple[float, float] = (0.0, 0.0)

    def spin(self, t: Floats, n: Floats, zeros: Sequence[float]) -> None:
        """Look at spins; ``zeros`` are all those of the spin up to the last of them."""
        far = np.abs(n) > TURN * self.plateau
        t = np.concatenate([[self._last[0]], t[far]])
        side = np.concatenate([[self._last[1]], np.sign(n[far])])
        for k in np.flatnonzero(side[1:] * side[:-1] < 0):
            first = bisect_right(zeros, t[k])
            self.reversals += zeros[first : first + 1]
        self._last = float(t[-1]), float(side[-1])

    def forces(self, t: Floats, normal: Floats, tangential: Floats) -> None:
        """Look at contact forces."""
        down = normal > 0
        ratio = np.divide(tangential, normal, out=np.zeros(len(t)), where=down)
        if not self.lifts <= t[0] and (normal < 0).any():
            self.lifts = float(t[np.argmax(normal < 0)])
        if not self.slips <= t[0] and (ratio > 1).any():
            self.slips = float(t[np.argmax(ratio > 1)])
        self.normal_min = min(self.normal_min, float(normal.min()))
        self.friction_max = max(self.friction_max, float(ratio.max()))

    @property
    def warning(self) -> str:
        """What the model does that no real body would, in one sentence; empty if nothing."""
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


class Course:
    """A trajectory under way: iterate to get it chunk by chunk, stop whenever you like.

    Parameters
    ----------
    body : Rattleback
    n_i, omega_xy0, t_end, psi, model
        As for :func:`rattlesweep.sweeps.blocks.single.Launch`.
    channels : sequence of str
        Names of :data:`rattlesweep.study.onerun.channels.CHANNELS`; these become the columns.
    points, dt, steps, times
        One way to choose the rows: so many, evenly from 0 to ``t_end``; every ``dt``; one per
        accepted step; or any increasing times.  By default 2001 points, or 20 a period of the
        pitch if that is more.
    integrator : mapping, optional
        Keys of the config's ``integrator``.
    e_p0, e_r0 : float, optional
        Energies with which the reduced model begins, in ``M g a``; by default the launch's.
    watch : callable, optional
        Called with the share that is done, every few thousand steps.

    Attributes
    ----------
    channels : tuple of Channel
    launches : Launches
        The launch and what theory says of it.
    integrator : dict
        Method with its ``tol`` or ``dt``.
    times : Times or None
        Of the rows; None for the accepted steps.
    zeros, reversals : list of float
        All zeros of the spin so far, in ``sqrt(a/g)``, and of each reversal (:data:`TURN`) the
        first.
    seen : Seen
        What else the run has done so far.
    status : Status
    t, t_end : float
        Time reached, and the horizon.

    Raises
    ------
    ConfigError
        If an argument is wrong.
    """

    def __init__(
        self,
        body: Rattleback,
        *,
        n_i: float,
        omega_xy0: float,
        t_end: float | None = None,
        psi: str | float = "relevant",
        model: str = "full",
        channels: Sequence[str] = ("t", "n"),
        points: int | None = None,
        dt: float | None = None,
        steps: bool = False,
        times: Any = None,
        integrator: dict[str, Any] | None = None,
        e_p0: float | None = None,
        e_r0: float | None = None,
        watch: Callable[[float], None] | None = None,
    ) -> None:
        run = single_run(Launch(body, n_i, omega_xy0, t_end, psi, model, integrator or {}))
        self._prepare(run, channels, points, dt, steps, times, e_p0, e_r0, watch)

    @classmethod
    def of_run(
        cls,
        run: tuple[Config, Launches, Batch | None],
        *,
        channels: Sequence[str] = ("t", "n"),
        points: int | None = None,
        dt: float | None = None,
        steps: bool = False,
        watch: Callable[[float], None] | None = None,
    ) -> Course:
        """The trajectory of a run of a sweep: its config, its launch and its batch, one run each.

        The other arguments are those of the class.
        """
        course = cls.__new__(cls)
        course._prepare(run, channels, points, dt, steps, None, None, None, watch)
        return course

    def _prepare(
        self,
        run: tuple[Config, Launches, Batch | None],
        channels: Sequence[str],
        points: int | None,
        dt: float | None,
        steps: bool,
        times: Any,
        e_p0: float | None,
        e_r0: float | None,
        watch: Callable[[float], None] | None,
    ) -> None:
        self._watch = watch
        config, launches, batch = run
        model: str = config.model
        self.channels: tuple[Channel, ...] = choose(channels, model)
        self.model, self.launches = model, launches
        chosen = config.integrator
        adaptive = METHODS[chosen.method].adaptive
        self.integrator: dict[str, Any] = {"method": chosen.method} | (
            {"tol": chosen.tol} if adaptive else {"dt": chosen.dt}
        )
        self.t_end = float(launches.t_end[0])
        if not (math.isfinite(self.t_end) and self.t_end > 0):
            raise ConfigError("t_end: Garcia and Hubbard's time of reversal is no finite time; "
                              "give t_end")  # fmt: skip
        if steps and batch is None:
            raise ConfigError("steps: the model gh takes none; give points or dt")
        default = max(POINTS, self.rows_of_periods(PER_PERIOD))
        self.times = make_times(self.t_end, points, dt, steps, times, default)
        self.seen = Seen(abs(float(launches.n_i[0])))
        needs = {channel.needs for channel in self.channels}
        if model == "full" and (e_p0 is not None or e_r0 is not None) and "reduced" not in needs:
            raise ConfigError("e_p0 and e_r0 are of the reduced model; no channel asks for it")
        self.energy_0, self._constants = math.nan, np.zeros(0)
        self._follower = self._beside = None
        if batch is not None:
            if model == "reduced":
                batch = with_energies(batch, e_p0, e_r0)
            self._constants = batch.constants[0]
            self._follower = Follower(
                batch,
                METHODS[chosen.method],
                MODELS[model],
                tol=chosen.tol or 1e-9,
                dt=chosen.dt or 0.002,
                max_steps=chosen.max_steps,
                attitude="attitude" in needs,
                look=self._look,
                watch=self._report,
            )
            self.energy_0 = self._follower.energy_0
        if "reduced" in needs:
            beside = with_energies(reduced_batch(launches), e_p0, e_r0)
            self._beside = Follower(beside, DOP853, REDUCED, tol=BESIDE_TOL)

    @property
    def t(self) -> float:
        """Time reached."""
        return self.t_end if self._follower is None else self._follower.t

    @property
    def status(self) -> Status:
        """What has become of the run so far."""
        return Status.OK if self._follower is None else self._follower.status

    @property
    def n_steps(self) -> int:
        """Accepted steps so far."""
        return 0 if self._follower is None else self._follower.n_steps

    @property
    def zeros(self) -> list[float]:
        """Times of the zeros of the spin so far."""
        if self._follower is not None:
            return self._follower.zeros
        t_rgh = float(self.launches.gh.t_rgh[0])
        return [t_rgh] if t_rgh <= self.t_end else []

    @property
    def reversals(self) -> list[float]:
        """Times of the first zeros of the reversals so far."""
        # Garcia and Hubbard's spin has one zero and goes through it for good.
        return self.zeros if self._follower is None else self.seen.reversals

    def rows_of_periods(self, each: int) -> int:
        """Rows from 0 to the horizon that give each period of the pitch so many, at least 2."""
        if self.model != "full":
            return 2
        periods = self.t_end * float(self.launches.modes.omega_p[0]) / (2 * math.pi)
        return max(2, math.ceil(periods * each) + 1)

    def __iter__(self) -> Iterator[dict[str, Floats]]:
        """Columns by name, at most :data:`CHUNK` rows at a time."""
        for samples in self._samples():
            beside = None if self._beside is None else self._beside.at(samples.t)
            view = View(self.launches, self.model, self._constants, self.energy_0, samples, beside)
            yield {channel.name: channel.of(view) for channel in self.channels}

    def _samples(self) -> Iterator[Samples]:
        follower = self._follower
        if self.times is None:
            assert follower is not None
            yield follower.launch()
            while (found := follower.steps()).t.size or not follower.ended:
                yield found
            return
        for begin in range(0, len(self.times), CHUNK):
            part = self.times[begin : begin + CHUNK]
            if follower is None:
                yield Samples(part, np.zeros((len(part), 0)), np.zeros((len(part), 0)))
                continue
            found = follower.at(part)
            if found.t.size:
                yield found
            if found.t.size < part.size:
                return
        # What lies behind the last row belongs to the run: its reversals and its status.
        while follower is not None and not follower.ended:
            follower.steps()

    def _look(self, t: Floats, y: Floats) -> None:
        """See the accepted steps as they come."""
        if not len(t):
            return
        zeros = [] if self._follower is None else self._follower.zeros
        if self.model == "reduced":
            self.seen.spin(t, y[:, 0], zeros)
            return
        columns = np.ascontiguousarray(y.T)
        # A run that goes wrong overflows.
        with np.errstate(all="ignore"):
            self.seen.spin(t, spin_of(*columns), zeros)
            self.seen.forces(t, *force_of(*columns, *self._constants))

    def _report(self, t: float) -> None:
        if self._watch is not None:
            self._watch(min(1.0, t / self.t_end))


@dataclass(frozen=True)
class Trajectory:
    """A run as a table.

    Attributes
    ----------
    table : pandas.DataFrame
        One column per channel; NaN where a channel has no finite value.
    reversals : ndarray
        Times of the reversals up to ``t_end``, in ``sqrt(a/g)``: the spin has gone from beyond a
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
    """

    table: pd.DataFrame
    reversals: Floats
    zeros: Floats
    t_end: float
    status: str
    n_steps: int
    units: dict[str, str]
    warning: str = ""


def collect(course: Course) -> Trajectory:
    """The whole trajectory in memory."""
    import pandas as pd

    chunks = list(course)
    table = pd.DataFrame(
        {c.name: np.concatenate([chunk[c.name] for chunk in chunks]) for c in course.channels}
    )
    return Trajectory(
        table=table,
        reversals=np.array(course.reversals),
        zeros=np.array(course.zeros),
        t_end=course.t,
        status=course.status.label,
        n_steps=course.n_steps,
        units={c.name: c.unit for c in course.channels},
        warning=course.seen.warning,
    )
