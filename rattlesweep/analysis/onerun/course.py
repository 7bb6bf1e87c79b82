"""One run as a table of channels, computed chunk by chunk: in memory or in a file."""
# ruff: noqa: D102 - the names are enough

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.csv as pcsv
import pyarrow.parquet as pq

from rattlesweep.analysis.derived import COMMON_FRICTION
from rattlesweep.analysis.onerun.channels import (
    VARIABLES,
    View,
    channels_in_si,
    choose_channels,
)
from rattlesweep.analysis.onerun.section import RISES, CrossingSearch, Section
from rattlesweep.arrays import Flags, Floats, take
from rattlesweep.design.batches import make_batch, reduced_batch, with_energies
from rattlesweep.design.launch import Launch, plan_of
from rattlesweep.design.models import model_of
from rattlesweep.design.prepare import prepare_launches
from rattlesweep.kernel.batch import longest_frame_steps
from rattlesweep.kernel.follow import Follower
from rattlesweep.kernel.method.tableau import DOP853, METHODS, TOL
from rattlesweep.kernel.recorder import NORMAL_MIN, RATIO_MAX, Samples
from rattlesweep.kernel.state.fields import SLIP_SPEED, SLIP_WORK
from rattlesweep.motion.model import reduced_model
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.rows import arrow
from rattlesweep.rows.arrow import build_table
from rattlesweep.system.console import counted
from rattlesweep.system.files import streamed_file
from rattlesweep.words.defaults import LEAST_ROWS, ROWS_A_PERIOD
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import ACTING, TIME, ActionConstant

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from rattlesweep.config.schema import Config
    from rattlesweep.kernel.outcome import Batch
    from rattlesweep.physics.mesh.pose import MeshPose
    from rattlesweep.physics.si import Units
    from rattlesweep.rows.prepared import PreparedRuns

# Columns of rows by name: numbers, and flags of a section.
Columns: TypeAlias = "dict[str, NDArray[Any]]"
_CHUNK = 8192  # rows in memory at once
_MOST_ROWS = 10**8
# The first time of a warning is searched in so many parts of a step, so many times.
_PARTS = 33
REFINEMENTS = 3
BESIDE_TOL = 1e-10  # of the reduced model, which differs from the full one by far more
# Letters of the parameters in a title.
LETTERS = {"alpha": "α", "beta": "β", "gamma": "γ", "theta": "θ", "phi": "φ"}
LIFTS = (
    "contact would be lost at t = {:.4g}, where the normal force becomes negative; the "
    "model keeps the body on the plane all the same"
)
SLIPS = (
    "rolling without slip needs a coefficient of friction of {:.2g}, and more than "
    "{:g} from t = {:.4g} on; with less the body slips, as it does with mu"
)


@dataclass(frozen=True)
class PreparedRun:
    """A run that is ready to be integrated; all arrays have one entry."""

    config: Config
    launches: PreparedRuns
    batch: Batch | None
    units: Units | None = None  # if the size of the body is known
    pose: MeshPose | None = None  # of its mesh
    # E_p and E_r of the reduced model, if they are given.
    energies: tuple[float | None, float | None] = (None, None)

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
        plan = plan_of(launch)
        first = np.zeros(1, np.int64)
        launches = prepare_launches(plan, first, first)
        energies = launch.e_p0, launch.e_r0
        batch = make_batch(launches, launch.model)
        if batch is not None and launch.model == "reduced":
            batch = with_energies(batch, *energies)
        body = launch.body
        return cls(plan.config, launches, batch, body.units, body.pose, energies)

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
        for name, values in bodies.further.items():
            if np.isfinite(values[0]):
                body[name] = float(values[0])
        return body

    @cached_property
    def launch(self) -> dict[str, float]:
        return {
            x: float(getattr(self.launches, x)[0]) for x in ("n_i", "omega_xy0", "psi")
        }

    @property
    def integrator(self) -> dict[str, Any]:
        integrator = self.config.integrator
        if METHODS[integrator.method].adaptive:
            return {"method": integrator.method, "tol": integrator.tol}
        return {"method": integrator.method, "dt": integrator.dt}

    @property
    def title(self) -> str:
        """The run in one line."""
        texts = [
            f"{LETTERS.get(name, name)} {value:.4g}"
            for name, value in self.body.items()
            if name != "xi"
        ]
        size = 1.0
        unit = "√(g/a)"
        if self.units is not None:
            size = 30 / math.pi / self.units.time
            unit = "rpm"
        title = (
            f"{', '.join(texts)}, ξ {math.degrees(self.body['xi']):.4g}°; "
            f"n_i {size * self.launch['n_i']:.4g} {unit}"
        )
        # Given energies of both modes replace the oscillation of the reduced model.
        if self.model == "full" or None in self.energies:
            title += f", ω_xy0 {size * self.launch['omega_xy0']:.4g} {unit}"
        for name, energy in zip(("E_p0", "E_r0"), self.energies, strict=True):
            if energy is not None:
                title += f", {name} {energy:.4g}"
        if self.losses:
            title += f", {self.losses}"
        return title.replace("-", "−")

    @property
    def losses(self) -> str:
        """What acts on the body by its constants, as text."""
        return self.acting(ACTING)

    def acting(self, constants: Mapping[str, ActionConstant]) -> str:
        """Return which of some constants act on the body, as text."""
        words = []
        for name, values in self.launches.losses.items():
            constant = constants.get(name)
            if constant is not None and values[0] != constant.default:
                value = self.with_unit(values[0], constant.unit)
                words.append(f"{constant.letter} {value}")
        return ", ".join(words)

    def with_unit(self, value: float, unit: str) -> str:
        """Return a value with its unit, in SI if the size of the body is known."""
        if unit == "1":
            return f"{value:.6g}"
        # An angle has one unit for all bodies.
        if self.units is None or unit not in self.units.sizes:
            return f"{value:.6g} {unit.replace('sqrt', '√')}"
        size, si_unit = self.units.sizes[unit]
        return f"{size * value:.6g} {si_unit}"

    def even_rows(
        self, per_period: int, least: int, most: int, start: float | None = None
    ) -> int:
        """Return the number of rows with `per_period` in each period of the pitch."""
        count = least
        if self.model == "full":
            shown = self.t_end - (start or 0.0)
            pitch = float(self.launches.modes.omega_p[0])
            periods = shown * pitch / (2 * math.pi)
            count = max(least, math.ceil(periods * per_period) + 1)
        return min(count, most)

    def row_times(
        self,
        points: int | None,
        dt: float | None,
        steps: bool,
        times: ArrayLike | None,
        start: float | None,
        section: Section | None = None,
    ) -> Floats | None:
        """Return the times of the rows from `start` on, None if these are not known."""
        first = start or 0.0
        t_end = self.t_end
        ways = points, dt, steps or None, times, section
        if sum(way is not None for way in ways) > 1:
            raise ConfigError(
                "points, dt, steps, times, section: more than one is given; keep one"
            )
        if not 0 <= first < t_end:
            raise ConfigError(
                f"from_time {first:g}: must be from 0 to t_end = {t_end:g}"
            )
        if steps or section is not None:
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
        if dt is not None:
            count = int(min((t_end - first) / dt, _MOST_ROWS)) + 2
        elif points:
            count = points
        else:
            count = self.even_rows(ROWS_A_PERIOD, LEAST_ROWS, _MOST_ROWS + 1, start)
        if count > _MOST_ROWS:
            raise ConfigError(f"more than {_MOST_ROWS:,} rows; ask for fewer")
        if dt is None:
            return np.linspace(first, t_end, count)
        rows = first + dt * np.arange(count, dtype=np.float64)
        return rows[rows <= t_end]


def _check_needs(run: PreparedRun, needs: set[str]) -> None:
    """Raise a ConfigError if a run lacks what channels need, or none needs its own."""
    if "reduced" in needs and run.launches.bodies.omega is not None:
        raise ConfigError(
            "channels: the reduced model begins with a spin and an oscillation, "
            "not with a full state"
        )
    has_energies = run.energies != (None, None)
    if run.model == "full" and has_energies and "reduced" not in needs:
        raise ConfigError(
            "e_p0 and e_r0 belong to the reduced model; no channel needs it"
        )


class Course:
    """A trajectory that is integrated while its chunks of columns are iterated over.

    Unless `watched`, nobody sees its contact: there are no :attr:`slides`, and no
    :attr:`warning`.
    """

    def __init__(
        self,
        run: PreparedRun,
        channels: Sequence[str] | None = None,
        *,
        points: int | None = None,
        dt: float | None = None,
        steps: bool = False,
        times: ArrayLike | None = None,
        from_time: float | None = None,
        section: Section | None = None,
        watched: bool = True,
    ) -> None:
        if section is not None:
            channels = ["t", *(channels or VARIABLES[run.model])]
        elif channels is None:
            channels = ["t", "n"]
        chosen = choose_channels(channels, run.model)
        needs = {channel.needs for channel in chosen}
        if section is not None:
            section.refuse_constant(run.model, has_losses=bool(run.losses))
            needs.add(section.channel.needs)
        _check_needs(run, needs)
        self.run = run
        self.si = channels_in_si(chosen, run.units)
        self.channels = (*chosen, *self.si.values())
        self.section = section
        self.times = run.row_times(points, dt, steps, times, from_time, section)
        self._start = from_time or 0.0
        self.n_crossings = 0  # of the section so far
        self._whole: Columns | None = None
        # The largest ratio of the contact's forces and the least normal force, between
        # steps too, and the first times at which the body would slip or lift off.
        self.friction = 0.0
        self.least_normal = math.inf
        self._slips_from: float | None = None
        self._lifts_from: float | None = None
        self._ended_slides: list[tuple[float, float]] = []
        self._slides_from: float | None = None  # begin of a slide that goes on
        self.slide_work = 0.0  # of sliding friction so far, negative
        self.follower = self._follow("attitude" in needs, watched)
        self._beside = None
        if "reduced" in needs:
            beside = with_energies(reduced_batch(run.launches), *run.energies)
            model = reduced_model(run.launches.losses)
            self._beside = Follower(beside, DOP853, model, tol=BESIDE_TOL)

    def _follow(self, has_attitude: bool, watched: bool) -> Follower:
        """Return the integration of the run, which has not begun."""
        run = self.run
        assert run.batch is not None
        setting = run.integrator
        tableau = METHODS[setting.pop("method")]
        longest_step: Floats | float = np.inf
        if "spectrum" in run.config.record:
            # A replay takes the steps of the stored run.
            tol = run.config.integrator.tol or TOL
            longest_step = longest_frame_steps(run.batch, tableau, tol)
        return Follower(
            run.batch,
            tableau,
            model_of(run.config),
            **setting,
            max_steps=run.config.integrator.max_steps,
            longest_step=longest_step,
            attitude=has_attitude,
            look=self._look if watched else None,
        )

    def __iter__(self) -> Iterator[Columns]:
        """Yield columns by name, some thousand rows at a time."""
        if self._whole is not None:
            yield self._whole
            return
        if self.section is None:
            for samples in self._samples():
                yield self._columns_of(samples)
            return
        # Rare crossings are gathered, since a chunk becomes a row group of a file.
        gathered: list[Columns] = []
        for chunk in self._crossings(self.section):
            gathered.append(chunk)
            if sum(len(each["rising"]) for each in gathered) >= _CHUNK:
                yield _joined(gathered)
                gathered = []
        if gathered:
            yield _joined(gathered)

    def columns(self) -> Columns:
        """Integrate to the end, and return whole columns; those of a section stay."""
        empty: Columns = {channel.name: np.zeros(0) for channel in self.channels}
        if self.section is None:
            return _joined([empty, *self])
        self._whole = _joined([empty | {"rising": np.zeros(0, dtype=bool)}, *self])
        return self._whole

    def _columns_of(self, samples: Samples) -> Columns:
        beside = None
        if self._beside is not None:
            beside = self._beside.at(samples.t)
        view = self._view(samples, beside)
        return {
            channel.name: channel.size * channel.of(view) for channel in self.channels
        }

    def _view(self, samples: Samples, beside: Samples | None = None) -> View:
        return View(self.run.launches, self.follower, samples, beside)

    def _crossings(self, section: Section) -> Iterator[Columns]:
        """Yield columns at the crossings of a section, and whether it rises there."""

        def channel_of(samples: Samples) -> Floats:
            view = self._view(samples)
            does_work = self.run.config.acting.does_work
            if section.channel.name == "energy" and not does_work:
                # Between slides nothing takes energy, and the error of the method would
                # cross the value.
                return self.follower.energy_0 + view.work
            return section.channel.of(view)

        for samples, rises in CrossingSearch(section, self.follower, channel_of):
            is_late = samples.t >= self._start
            self.n_crossings += int(is_late.sum())
            if is_late.any():
                columns = self._columns_of(take(samples, is_late))
                yield columns | {"rising": rises[is_late]}

    def _samples(self) -> Iterator[Samples]:
        follower = self.follower
        if self.times is None:
            samples = follower.launch()
            while samples.t.size or not follower.ended:
                late = take(samples, samples.t >= self._start)
                if late.t.size:
                    yield late
                samples = follower.steps()
            return
        for begin in range(0, len(self.times), _CHUNK):
            times = self.times[begin : begin + _CHUNK]
            samples = follower.at(times)
            if samples.t.size:
                yield samples
            if samples.t.size < times.size:
                return
        # The rest of the run matters, too: its reversals and its status.
        while not follower.ended:
            follower.steps()

    def _look(self, samples: Samples, seen: Floats, extremes: Floats) -> None:
        """Collect slides and warnings from launch and accepted steps."""
        t = samples.t
        self._note_slides(t, samples.slip[:, SLIP_SPEED] > 0)
        if not len(t):
            return
        self.slide_work = float(samples.slip[-1, SLIP_WORK])
        self.friction = float(extremes[-1, RATIO_MAX])
        self.least_normal = float(extremes[-1, NORMAL_MIN])
        slips = extremes[:, RATIO_MAX] > COMMON_FRICTION
        lifts = extremes[:, NORMAL_MIN] < 0
        if self._slips_from is None and slips.any():
            step = int(np.argmax(slips))
            self._slips_from = self._first(samples, step, seen, _excess)
        if self._lifts_from is None and lifts.any():
            step = int(np.argmax(lifts))
            self._lifts_from = self._first(samples, step, seen, _lift)

    def _first(
        self,
        samples: Samples,
        step: int,
        seen: Floats,
        function: Callable[[Floats], Floats],
    ) -> float:
        """Return the first time in a step at which a function of forces is positive.

        It is so at the end of the step, or for a time between its ends.
        """
        end = float(samples.t[step])
        if end == 0.0:
            return end
        follower = self.follower
        low = 0.0
        high = float(follower.lengths()[step])
        if function(seen[:, step : step + 1])[0] <= 0:
            offsets = np.linspace(low, high, _PARTS)
            values = function(self._forces(step, offsets))
            high = float(offsets[np.argmax(values)])
        for _ in range(REFINEMENTS):
            offsets = np.linspace(low, high, _PARTS)
            is_positive = function(self._forces(step, offsets)) > 0
            first = max(1, int(np.argmax(is_positive)))
            if not is_positive.any():
                first = _PARTS - 1
            low, high = float(offsets[first - 1]), float(offsets[first])
        return end - float(follower.lengths()[step]) + high

    def _forces(self, step: int, offsets: Floats) -> Floats:
        """Return what the follower observes in a step of its last call."""
        which = np.full(len(offsets), step)
        return self.follower.observe(self.follower.within(which, offsets))

    def _note_slides(self, t: Floats, is_sliding: Flags) -> None:
        """Add the slides that begin or end at accepted steps."""
        began = self._slides_from is not None
        before = np.append(began, is_sliding[:-1])
        for k in np.flatnonzero(is_sliding != before):
            if self._slides_from is None:
                self._slides_from = float(t[k])
            else:
                self._ended_slides.append((self._slides_from, float(t[k])))
                self._slides_from = None

    @property
    def reversals(self) -> list[float]:
        """Time of the first zero of the spin in each reversal so far."""
        return self.follower.reversals

    @property
    def slides(self) -> list[tuple[float, float]]:
        """Begin and end of each slide so far; the last may still go on."""
        if self._slides_from is None:
            return self._ended_slides
        return [*self._ended_slides, (self._slides_from, self.follower.t)]

    @property
    def slides_in_words(self) -> str:
        """How many slides there were, how long, and what they took; empty for none."""
        if not self.slides:
            return ""
        lasted = sum(end - begin for begin, end in self.slides)
        share = -self.slide_work / self.follower.energy_0
        count = counted(len(self.slides), "slide")
        time = self.run.with_unit(lasted, TIME)
        return f"{count} of {time} in all, {share:.2%} of the energy"

    @property
    def warning(self) -> str:
        """Where a real body would lift off or slip, and the run does not."""
        if self.run.config.dissipation.slides:
            return ""
        if self._lifts_from is not None:
            return LIFTS.format(self._lifts_from)
        # A foot that slips under viscous friction does so at any force.
        if self._slips_from is not None and not self.run.config.dissipation.slips:
            return SLIPS.format(self.friction, COMMON_FRICTION, self._slips_from)
        return ""


def _excess(seen: Floats) -> Floats:
    """Return the ratio of observed forces above a common coefficient of friction."""
    _, _, normal, tangential, _ = seen
    with np.errstate(all="ignore"):  # a failing run may overflow
        excess: Floats = np.nan_to_num(tangential / np.abs(normal) - COMMON_FRICTION)
    return excess


def _lift(seen: Floats) -> Floats:
    """Return the force by which the plane would have to hold the body down."""
    return np.nan_to_num(-seen[2])


def _joined(chunks: Sequence[Columns]) -> Columns:
    """Return the columns of several chunks in one."""
    return {
        name: np.concatenate([chunk[name] for chunk in chunks]) for name in chunks[0]
    }


def save_course(course: Course, path: Path) -> None:
    """Integrate a run and write its file atomically."""
    with streamed_file(path) as file:
        if path.suffix.lower() == ".csv":
            write_csv(course, file)
        else:
            _write_parquet(course, file)


def _write_parquet(course: Course, file: BinaryIO) -> None:
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
    """Return the schema of a run, whose metadata describe how it was made."""
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
        arrow.field(c.name, arrow.F64, c.unit, c.description) for c in course.channels
    ]
    if course.section is not None:
        meaning = RISES.format(course.section.channel.name)
        fields.append(arrow.field("rising", arrow.FLAG, "1", meaning))
        about["section"] = course.section.text
    return pa.schema(fields, metadata={"rattlesweep.run": json.dumps(about)})
