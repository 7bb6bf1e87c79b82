"""One run as a table of chosen channels, chunk by chunk: in memory, as Parquet or as CSV."""
# ruff: noqa: D102 - names and types say it

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv as pcsv
import pyarrow.parquet as pq

from rattlesweep.analysis.onerun.channels import View, choose, contact_force, in_si, spin
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import PLATEAU_SHARE
from rattlesweep.integrate.follow import Follower, Samples
from rattlesweep.integrate.model import REDUCED
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import DOP853, METHODS
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.sweeps import columns
from rattlesweep.sweeps.columns import build_table
from rattlesweep.sweeps.files import streamed_file
from rattlesweep.sweeps.launches import Launch, model_of, reduced_batch, single_run, with_energies
from rattlesweep.sweeps.provenance import package_version

if TYPE_CHECKING:
    from typing import Self

    from rattlesweep.integrate.batch import Batch
    from rattlesweep.physics.si import Units
    from rattlesweep.sweeps.config.schema import Config
    from rattlesweep.sweeps.launches import Launches

CHUNK = 8192
"""Rows that are in memory at once."""
PER_PERIOD, LEAST_ROWS, MOST_ROWS = 20, 2001, 10**8
"""Rows in a period of the pitch, and all of them, where nothing else is asked for."""
BESIDE_TOL = 1e-10
"""Tolerance of the reduced model beside, whose distance from the full one is far larger."""


@dataclass(frozen=True)
class PreparedRun:
    """One run that is ready to be integrated; all arrays have one entry."""

    config: Config
    launches: Launches
    batch: Batch | None  # None in the model gh
    units: Units | None = None  # of a body whose size is known
    energies: tuple[float | None, float | None] = (None, None)  # with which the reduced one begins

    def __post_init__(self) -> None:
        if not (math.isfinite(self.t_end) and self.t_end > 0):
            raise ConfigError(f"t_end: {self.t_end:g} is no finite, positive time; give t_end")

    @classmethod
    def of(cls, launch: Launch) -> Self:
        return cls(*single_run(launch), launch.body.units, (launch.e_p0, launch.e_r0))

    @property
    def model(self) -> str:
        return str(self.config.model)

    @property
    def t_end(self) -> float:
        return float(self.launches.t_end[0])

    @cached_property
    def body(self) -> dict[str, float]:
        bodies = self.launches.bodies
        body = {name: float(getattr(bodies, name)[0]) for name in PARAMETERS}
        ellipsoid = bodies.c is not None and np.isfinite(bodies.c[0])
        return body | {"c": float(bodies.c[0])} if ellipsoid else body  # type: ignore[index]

    @cached_property
    def launch(self) -> dict[str, float]:
        return {x: float(getattr(self.launches, x)[0]) for x in ("n_i", "omega_xy0", "psi")}

    @property
    def integrator(self) -> dict[str, Any]:
        own = self.config.integrator
        step = {"tol": own.tol} if METHODS[own.method].adaptive else {"dt": own.dt}
        return {"method": own.method, **step}

    @property
    def title(self) -> str:
        """The run in one line."""
        names = {"alpha": "α", "beta": "β", "gamma": "γ", "theta": "θ", "phi": "φ", "c": "c"}
        body = ", ".join(f"{names[x]} {v:.4g}" for x, v in self.body.items() if x in names)
        launch = f"n_i {self.launch['n_i']:.4g}, ω_xy0 {self.launch['omega_xy0']:.4g}"
        line = f"{body}, ξ {math.degrees(self.body['xi']):.4g}°; {launch}; units M = a = g = 1"
        return line.replace("-", "−")

    def even_rows(self, per_period: int, least: int, most: int, start: float | None = None) -> int:
        """Return how many rows are so many in each period of the pitch, from a time on."""
        shown = self.t_end - (start or 0.0)
        pitch = float(self.launches.modes.omega_p[0]) if self.model == "full" else 0.0
        return min(max(least, math.ceil(shown * pitch / (2 * math.pi) * per_period) + 1), most)

    def row_times(
        self, points: int | None, dt: float | None, steps: bool, times: Any, start: float | None
    ) -> Floats | None:
        """Return the times of the rows, of which none is before `start`; None for the steps."""
        ways = {"points": points, "dt": dt, "steps": steps or None, "times": times}
        given = [name for name, value in ways.items() if value is not None]
        first, t_end = start or 0.0, self.t_end
        if len(given) > 1:
            raise ConfigError(f"{' and '.join(given)} are both given; keep one of them")
        if not 0 <= first < t_end:
            raise ConfigError(f"from_time {first:g}: rows begin from 0 to t_end = {t_end:g}")
        if steps and self.batch is None:
            raise ConfigError("steps: the model gh takes none; give points or dt")
        if steps:
            return None
        if times is not None:
            wanted: Floats = np.array(times, float, ndmin=1)
            rising = wanted.ndim == 1 and wanted.size > 0 and (np.diff(wanted) > 0).all()
            if not (rising and wanted[0] >= 0 and wanted[-1] <= t_end):
                raise ConfigError(f"times: a list that increases from 0 at least to t_end = "
                                  f"{t_end:g} is needed")  # fmt: skip
            return wanted[wanted >= first]
        if dt is not None and dt <= 0:
            raise ConfigError(f"dt {dt:g}: the distance of two rows must be positive")
        if dt is None:
            count = points or self.even_rows(PER_PERIOD, LEAST_ROWS, MOST_ROWS + 1, start)
        else:
            count = int(min((t_end - first) / dt, MOST_ROWS)) + 2
        if count > MOST_ROWS:
            raise ConfigError(f"more than {MOST_ROWS:,} rows; ask for fewer")
        rows = first + (dt or 1.0) * np.arange(count, dtype=np.float64)
        return np.linspace(first, t_end, count) if dt is None else rows[rows <= t_end]


@dataclass
class Observer:
    """Turns and contact forces of a run, from its launch and its accepted steps as they come."""

    plateau: float  # modulus of the launch's spin; of a launch without spin, n_0
    zeros: list[float] = field(default_factory=list)  # of the spin so far, kept by the follower
    reversals: list[float] = field(default_factory=list)  # the first zero of each turn
    lifts: float = math.nan  # when the normal force is first negative; NaN if never
    slips: float = math.nan  # when rolling first needs a friction above 1; NaN if never
    # The last time beyond the share PLATEAU_SHARE of the plateau, and the sign of the spin then.
    last: tuple[float, float] = (0.0, 0.0)

    def spin(self, t: Floats, n: Floats) -> None:
        far = np.abs(n) > PLATEAU_SHARE * self.plateau
        t = np.append(self.last[0], t[far])
        side = np.append(self.last[1], np.sign(n[far]))
        for k in np.flatnonzero(side[1:] * side[:-1] < 0):
            first = bisect_right(self.zeros, t[k])
            self.reversals += self.zeros[first : first + 1]
        self.last = float(t[-1]), float(side[-1])

    def forces(self, t: Floats, normal: Floats, tangential: Floats) -> None:
        slipping = (normal > 0) & (tangential > normal)
        if math.isnan(self.lifts) and (normal < 0).any():
            self.lifts = float(t[np.argmax(normal < 0)])
        if math.isnan(self.slips) and slipping.any():
            self.slips = float(t[np.argmax(slipping)])

    @property
    def warning(self) -> str:
        """One sentence on what the model does that no real body would; empty if nothing."""
        if math.isfinite(self.lifts):
            return (
                f"contact would be lost at t = {self.lifts:.4g}, where the normal force becomes "
                "negative; the model keeps the body on the plane all the same"
            )
        if math.isfinite(self.slips):
            needed = "rolling without slip needs a coefficient of friction above 1"
            return f"{needed} from t = {self.slips:.4g} on"
        return ""


class ClosedForm:
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

    One of `points`, `dt`, `steps` and `times` chooses the rows, none of which is before
    `from_time`.  `watch` is called with the share that is done, every few thousand steps.  `zeros`
    and `reversals` are the times of all zeros of the spin so far, and of the first of each turn.
    """

    def __init__(
        self,
        run: PreparedRun,
        channels: Sequence[str] = ("t", "n"),
        *,
        points: int | None = None,
        dt: float | None = None,
        steps: bool = False,
        times: Any = None,
        from_time: float | None = None,
        watch: Callable[[float], None] | None = None,
    ) -> None:
        chosen = choose(channels, run.model)
        launches = run.launches
        needs = {channel.needs for channel in chosen}
        if "reduced" in needs and launches.bodies.omega is not None:
            raise ConfigError("channels: the reduced model begins with a spin and an oscillation, "
                              "and has no run beside one launched from a full state")  # fmt: skip
        if run.model == "full" and run.energies != (None, None) and "reduced" not in needs:
            raise ConfigError("e_p0 and e_r0 are of the reduced model; no channel asks for it")
        self.run, self.si = run, in_si(chosen, run.units)
        self.channels = (*chosen, *self.si.values())
        self.times = run.row_times(points, dt, steps, times, from_time)
        self._start = from_time or 0.0
        self._constants = np.zeros(0) if run.batch is None else run.batch.constants[0]
        self.observer = Observer(float(launches.spin_scale[0]))
        self._follower: Follower | ClosedForm
        if run.batch is None:
            self._follower = ClosedForm(launches)
            self.observer.reversals += self._follower.zeros  # its spin goes through zero for good
        else:
            setting = run.integrator
            self._follower = Follower(
                run.batch,
                METHODS[setting.pop("method")],
                model_of(run.config),
                **setting,
                max_steps=run.config.integrator.max_steps,
                attitude="attitude" in needs,
                look=self._look,
                watch=None if watch is None else lambda t: watch(min(1.0, t / run.t_end)),
            )
        self.zeros = self.observer.zeros = self._follower.zeros
        self.reversals = self.observer.reversals
        self._beside = None
        if "reduced" in needs:
            beside = with_energies(reduced_batch(launches), *run.energies)
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
        run, energy_0 = self.run, self._follower.energy_0
        for samples in self._samples():
            beside = None if self._beside is None else self._beside.at(samples.t)
            view = View(run.model, run.launches, self._constants, energy_0, samples, beside)
            yield {channel.name: channel.size * channel.of(view) for channel in self.channels}

    def columns(self) -> dict[str, Floats]:
        """Integrate to the end, and return the columns whole."""
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
                if early < len(found.t):
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
        state = np.ascontiguousarray(y.T)
        with np.errstate(all="ignore"):  # a run that goes wrong overflows
            if self.run.model == "reduced":
                self.observer.spin(t, state[0])
            else:
                self.observer.spin(t, spin(state))
                self.observer.forces(t, *contact_force(state, self._constants))


def save(course: Course, path: Path) -> None:
    """Integrate and write a file, whole or not at all."""
    with streamed_file(path) as file:
        (write_csv if path.suffix.lower() == ".csv" else write_parquet)(course, file)


def write_parquet(course: Course, file: BinaryIO) -> None:
    """Integrate and write row groups; at the end, where pyarrow can, the reversals and zeros."""
    schema = _schema(course)
    with pq.ParquetWriter(file, schema, compression="zstd", version="2.6") as writer:
        for chunk in course:
            writer.write_table(build_table(chunk, schema))
        if hasattr(writer, "add_key_value_metadata"):  # younger than pyarrow 16
            writer.add_key_value_metadata(
                {"rattlesweep.reversals": json.dumps(course.reversals),
                 "rattlesweep.zeros": json.dumps(course.zeros),
                 "rattlesweep.status": course.status.label}
            )  # fmt: skip


def write_csv(course: Course, file: BinaryIO) -> None:
    """Integrate and write lines: names first, digits that give the same number back."""
    schema = _schema(course)
    file.write((",".join(schema.names) + "\n").encode())
    for chunk in course:
        sink = pa.BufferOutputStream()
        # In one piece: pyarrow (26) writes what was in memory for an empty chunk before others.
        table = build_table(chunk, schema).combine_chunks()
        pcsv.write_csv(table, sink, pcsv.WriteOptions(include_header=False))
        file.write(sink.getvalue().to_pybytes())


def _schema(course: Course) -> pa.Schema:
    """Return the columns with unit and description; the metadata say which run it is."""
    run = course.run
    about = run.body | run.launch | {
        "model": run.model, "t_end": run.t_end, "rattlesweep": package_version(),
        "integrator": run.integrator,
    }  # fmt: skip
    fields = [columns.field(c.name, columns.F64, c.unit, c.description) for c in course.channels]
    return pa.schema(fields, metadata={"rattlesweep.run": json.dumps(about)})
