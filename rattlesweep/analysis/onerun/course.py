"""One run as a table of channels, computed chunk by chunk: in memory, as Parquet or
CSV.
"""
# ruff: noqa: D102 - the names are enough

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv as pcsv
import pyarrow.parquet as pq

from rattlesweep.analysis.derived import COMMON_FRICTION
from rattlesweep.analysis.onerun.channels import View, choose, in_si
from rattlesweep.arrays import Floats, take
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import PLATEAU_SHARE
from rattlesweep.integrate.follow import Follower, Samples
from rattlesweep.integrate.model import REDUCED
from rattlesweep.integrate.tableau import DOP853, METHODS
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.sweeps import columns
from rattlesweep.sweeps.columns import DAMPING, build_table
from rattlesweep.sweeps.files import streamed_file
from rattlesweep.sweeps.launches import (
    Launch,
    model_of,
    reduced_batch,
    single_run,
    with_energies,
)

if TYPE_CHECKING:
    from rattlesweep.integrate.batch import Batch
    from rattlesweep.physics.si import Units
    from rattlesweep.sweeps.config.schema import Config
    from rattlesweep.sweeps.launches import Launches

CHUNK = 8192  # rows in memory at once
PER_PERIOD, LEAST_ROWS = 20, 2001  # default rows in a period of the pitch, and in all
MOST_ROWS = 10**8
BESIDE_TOL = 1e-10  # of the reduced model, which differs from the full one by far more
LIFTS = (
    "contact would be lost at t = {:.4g}, where the normal force becomes negative; the "
    "model keeps the body on the plane all the same"
)
SLIPS = (
    "rolling without slip needs a coefficient of friction of {:.2g}, and more than "
    "{:g} from t = {:.4g} on; with less the body slips, which is not modelled"
)


@dataclass(frozen=True)
class PreparedRun:
    """A run that is ready to be integrated; all arrays have one entry."""

    config: Config
    launches: Launches
    batch: Batch | None
    units: Units | None = None  # if the size of the body is known
    energies: tuple[float | None, float | None] = (
        None,
        None,
    )  # E_p, E_r of the reduced model

    def __post_init__(self) -> None:
        if self.batch is None:
            raise ConfigError(
                "model: gh has no trajectory; the others have the channel n_gh"
            )
        if not (math.isfinite(self.t_end) and self.t_end > 0):
            raise ConfigError(
                f"t_end: {self.t_end:g} is no finite, positive time; give t_end"
            )

    @classmethod
    def of(cls, launch: Launch) -> PreparedRun:
        return cls(*single_run(launch), launch.body.units, (launch.e_p0, launch.e_r0))

    @property
    def model(self) -> str:
        return str(self.config.model)

    @property
    def t_end(self) -> float:
        return float(self.launches.horizon[0])

    @cached_property
    def body(self) -> dict[str, float]:
        bodies = self.launches.bodies
        body = {name: float(getattr(bodies, name)[0]) for name in PARAMETERS}
        ellipsoid = bodies.c is not None and np.isfinite(bodies.c[0])
        return body | {"c": float(bodies.c[0])} if ellipsoid else body  # type: ignore[index]

    @cached_property
    def launch(self) -> dict[str, float]:
        return {
            x: float(getattr(self.launches, x)[0]) for x in ("n_i", "omega_xy0", "psi")
        }

    @property
    def integrator(self) -> dict[str, Any]:
        own = self.config.integrator
        step = {"tol": own.tol} if METHODS[own.method].adaptive else {"dt": own.dt}
        return {"method": own.method, **step}

    @property
    def title(self) -> str:
        """The run in one line."""
        names = {
            "alpha": "α",
            "beta": "β",
            "gamma": "γ",
            "theta": "θ",
            "phi": "φ",
            "c": "c",
        }
        body = ", ".join(
            f"{names[x]} {v:.4g}" for x, v in self.body.items() if x in names
        )
        rate, unit = (
            (30 / math.pi / self.units.time, "rpm") if self.units else (1.0, "√(g/a)")
        )
        n_i, omega_xy0 = (
            f"{rate * self.launch[name]:.4g} {unit}" for name in ("n_i", "omega_xy0")
        )
        line = f"{body}, ξ {math.degrees(self.body['xi']):.4g}°; n_i {n_i}"
        # Given energies of both modes replace the oscillation of the reduced model.
        if self.model == "full" or None in self.energies:
            line += f", ω_xy0 {omega_xy0}"
        energies = zip(("E_p0", "E_r0"), self.energies, strict=True)
        line += "".join(
            f", {name} {value:.4g}" for name, value in energies if value is not None
        )
        return ", ".join(filter(None, (line, self.losses))).replace("-", "−")

    @property
    def losses(self) -> str:
        """The losses that are not zero, in words."""
        own = (
            ("σ", DAMPING, self.launches.sigma),
            ("rolling", "a", self.launches.rolling),
        )
        return ", ".join(
            f"{name} {self.with_unit(of[0], unit)}"
            for name, unit, of in own
            if of is not None and of[0] > 0
        )

    def with_unit(self, value: float, unit: str) -> str:
        """Return a value with its unit, converted to SI if the size of the body is
        known.
        """
        size, name = (
            self.units.sizes[unit] if self.units else (1.0, unit.replace("sqrt", "√"))
        )
        return f"{size * value:.6g} {name}"

    def even_rows(
        self, per_period: int, least: int, most: int, start: float | None = None
    ) -> int:
        """Return the number of rows that gives `per_period` in each period of the
        pitch.
        """
        shown = self.t_end - (start or 0.0)
        pitch = float(self.launches.modes.omega_p[0]) if self.model == "full" else 0.0
        return min(
            max(least, math.ceil(shown * pitch / (2 * math.pi) * per_period) + 1), most
        )

    def row_times(
        self,
        points: int | None,
        dt: float | None,
        steps: bool,
        times: Any,
        start: float | None,
    ) -> Floats | None:
        """Return the times of the rows from `start` on; None for those of the steps."""
        first, t_end = start or 0.0, self.t_end
        if sum(way is not None for way in (points, dt, steps or None, times)) > 1:
            raise ConfigError(
                "points, dt, steps, times: more than one is given; keep one"
            )
        if not 0 <= first < t_end:
            raise ConfigError(
                f"from_time {first:g}: must be from 0 to t_end = {t_end:g}"
            )
        if steps:
            return None
        if times is not None:
            wanted: Floats = np.array(times, float, ndmin=1)
            rising = (
                wanted.ndim == 1 and wanted.size > 0 and (np.diff(wanted) > 0).all()
            )
            if not (rising and wanted[0] >= 0 and wanted[-1] <= t_end):
                raise ConfigError(
                    "times: must be a list of increasing numbers from 0 to t_end = "
                    f"{t_end:g}"
                )
            return wanted[wanted >= first]
        if dt is None:
            count = points or self.even_rows(
                PER_PERIOD, LEAST_ROWS, MOST_ROWS + 1, start
            )
        else:
            count = int(min((t_end - first) / dt, MOST_ROWS)) + 2
        if count > MOST_ROWS:
            raise ConfigError(f"more than {MOST_ROWS:,} rows; ask for fewer")
        rows = first + (dt or 1.0) * np.arange(count, dtype=np.float64)
        return np.linspace(first, t_end, count) if dt is None else rows[rows <= t_end]


class Course:
    """A trajectory that is integrated while iterating over the chunks of its
    columns.
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
    ) -> None:
        chosen = choose(channels, run.model)
        needs = {channel.needs for channel in chosen}
        if "reduced" in needs and run.launches.bodies.omega is not None:
            raise ConfigError(
                "channels: the reduced model begins with a spin and an oscillation, "
                "not with a full state"
            )
        if (
            run.model == "full"
            and run.energies != (None, None)
            and "reduced" not in needs
        ):
            raise ConfigError(
                "e_p0 and e_r0 belong to the reduced model; no channel needs it"
            )
        self.run, self.si = run, in_si(chosen, run.units)
        self.channels = (*chosen, *self.si.values())
        self.times = run.row_times(points, dt, steps, times, from_time)
        self._start = from_time or 0.0
        self.reversals: list[float] = []
        # The largest ratio of the contact's forces, and the first times at which the
        # body would slip or lift off.
        self.friction = 0.0
        self._slips_from: float | None = None
        self._lifts_from: float | None = None
        # Time and sign of the last spin beyond PLATEAU_SHARE of the launch's.
        self._last = 0.0, 0.0
        assert run.batch is not None
        self._constants, setting = run.batch.constants[0], run.integrator
        self.follower = Follower(
            run.batch,
            METHODS[setting.pop("method")],
            model_of(run.config),
            **setting,
            max_steps=run.config.integrator.max_steps,
            attitude="attitude" in needs,
            look=self._look,
        )
        self._beside = None
        if "reduced" in needs:
            beside = with_energies(reduced_batch(run.launches), *run.energies)
            self._beside = Follower(beside, DOP853, REDUCED, tol=BESIDE_TOL)

    def __iter__(self) -> Iterator[dict[str, Floats]]:
        """Yield columns by name, at most :data:`CHUNK` rows at a time."""
        for samples in self._samples():
            beside = None if self._beside is None else self._beside.at(samples.t)
            view = View(
                self.run.launches, self._constants, self.follower, samples, beside
            )
            yield {
                channel.name: channel.size * channel.of(view)
                for channel in self.channels
            }

    def columns(self) -> dict[str, Floats]:
        """Integrate to the end, and return the whole columns."""
        none = {channel.name: np.zeros(0) for channel in self.channels}
        chunks = [none, *self]
        return {
            name: np.concatenate([chunk[name] for chunk in chunks]) for name in none
        }

    def _samples(self) -> Iterator[Samples]:
        follower = self.follower
        if self.times is None:
            found = follower.launch()
            while found.t.size or not follower.ended:
                late = take(found, found.t >= self._start)
                if late.t.size:
                    yield late
                found = follower.steps()
            return
        for begin in range(0, len(self.times), CHUNK):
            part = self.times[begin : begin + CHUNK]
            found = follower.at(part)
            if found.t.size:
                yield found
            if found.t.size < part.size:
                return
        # The rest of the run matters, too: its reversals and its status.
        while not follower.ended:
            follower.steps()

    def _look(self, t: Floats, seen: Floats) -> None:
        """Collect reversals and warnings from the accepted steps, and first from the
        launch.
        """
        n, _, normal, tangential = seen
        with np.errstate(all="ignore"):  # a failing run may overflow
            far = np.abs(n) > PLATEAU_SHARE * self.run.launches.spin_scale[0]
            ratio = np.where(normal > 0, tangential / normal, 0.0)
            ratio = np.where(np.isfinite(ratio), ratio, 0.0)
        times = np.append(self._last[0], t[far])
        side = np.append(self._last[1], np.sign(n[far]))
        for k in np.flatnonzero(side[1:] * side[:-1] < 0):
            first = bisect_right(self.follower.zeros, times[k])
            self.reversals += self.follower.zeros[first : first + 1]
        self._last = float(times[-1]), float(side[-1])
        slips = ratio > COMMON_FRICTION
        lifts = normal < 0
        self.friction = max(self.friction, float(np.max(ratio, initial=0.0)))
        if self._slips_from is None and slips.any():
            self._slips_from = float(t[np.argmax(slips)])
        if self._lifts_from is None and lifts.any():
            self._lifts_from = float(t[np.argmax(lifts)])

    @property
    def warning(self) -> str:
        """Where a real body would lift off or slip; empty if it would not."""
        if self._lifts_from is not None:
            return LIFTS.format(self._lifts_from)
        if self._slips_from is not None:
            return SLIPS.format(self.friction, COMMON_FRICTION, self._slips_from)
        return ""


def save(course: Course, path: Path) -> None:
    """Integrate a run and write its file atomically."""
    with streamed_file(path) as file:
        (write_csv if path.suffix.lower() == ".csv" else write_parquet)(course, file)


def write_parquet(course: Course, file: BinaryIO) -> None:
    """Integrate a run and write its chunks as row groups."""
    schema = _schema(course)
    with pq.ParquetWriter(file, schema, compression="zstd", version="2.6") as writer:
        for chunk in course:
            writer.write_table(build_table(chunk, schema))


def write_csv(course: Course, file: BinaryIO) -> None:
    """Integrate a run and write its chunks as lines, after the names."""
    schema = _schema(course)
    file.write((",".join(schema.names) + "\n").encode())
    for chunk in course:
        sink = pa.BufferOutputStream()
        # pyarrow 26 writes stray memory for an empty chunk that comes before others.
        table = build_table(chunk, schema).combine_chunks()
        pcsv.write_csv(table, sink, pcsv.WriteOptions(include_header=False))
        file.write(sink.getvalue().to_pybytes())


def _schema(course: Course) -> pa.Schema:
    """Return the schema of a run, whose metadata describe body, launch and
    integrator.
    """
    run = course.run
    about = {
        **run.body,
        **run.launch,
        "model": run.model,
        "t_end": run.t_end,
        "rattlesweep": version("rattlesweep"),
        "integrator": run.integrator,
    }
    fields = [
        columns.field(c.name, columns.F64, c.unit, c.description)
        for c in course.channels
    ]
    return pa.schema(fields, metadata={"rattlesweep.run": json.dumps(about)})
