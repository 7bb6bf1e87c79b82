"""Schema of a config as frozen pydantic models, in units M = a = g = 1; rules between
keys.
"""

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from typing import Annotated, Any, Literal, Self

import numpy as np
import pydantic
from pydantic import AfterValidator, BeforeValidator, Field

from rattlesweep.arrays import Floats
from rattlesweep.config import KeyPlaces
from rattlesweep.config.body_sources import AnySource, GridSource, Refine
from rattlesweep.config.keys import (
    FROM_TABLE,
    OF_SLIDES,
    PATH,
    Base,
    Time,
    _within,
    key,
)
from rattlesweep.config.values import (
    UNIQUE,
    Count,
    OneOf,
    Several,
    Three,
    Vertical,
    Whole,
    distinct,
    number_or,
    one_of,
    quantity_or,
)
from rattlesweep.kernel.method.tableau import DOP853, DT, MAX_STEPS, METHODS, TOL
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.names import (
    RECORDABLE,
    AccuracyName,
    ModelName,
)
from rattlesweep.words.quantities import (
    BASE_DIRECTIONS,
    CONSTANT_OF_SURFACE,
    COUPLE_CONSTANTS,
    DRIVES,
    HORIZONTAL,
    LOSSES,
    QUANTITIES,
    ActionConstant,
    law_of,
)
from rattlesweep.words.units import Quantity, Setting

InitialSpin = Annotated[
    float,
    quantity_or(
        # The sum turns -0.0 into 0.0.
        Annotated[float, _within("n_i"), AfterValidator(lambda spin: spin + 0.0)],
        "spin",
        "in sqrt(g/a)",
    ),
]
Oscillation = Annotated[
    float,
    quantity_or(Annotated[float, _within("omega_xy0")], "spin", "in sqrt(g/a)"),
]
DIRECTIONS = ("relevant", "pitch", "roll")
_Degrees = Annotated[float, Field(ge=-360, le=360)]
Direction = Annotated[float | str, one_of(_Degrees, DIRECTIONS)]
DriveAngle = Annotated[float | str, number_or(_Degrees, FROM_TABLE)]


class Spin(Base):
    """Initial spin and oscillation of upright bodies: every n_i with every
    omega_xy0.
    """

    n_i: Several[InitialSpin] = key(
        ...,
        "Initial spins in sqrt(g/a) or with a unit; negative: steady direction if "
        "xi < 0; 0: a tap, which starts an oscillation without spin.",
    )
    omega_xy0: Several[Oscillation] = key(
        ..., "Pushes: initial oscillations in sqrt(g/a) or with a unit."
    )
    psi: Direction = key(
        "relevant",
        "Direction of the push: along a mode, where relevant is pitch for n_i >= 0 and "
        "roll for n_i < 0; or an angle in degrees.",
    )


class FullState(Base):
    """Full initial state of all bodies, in components along the body's axes."""

    omega: Three[Annotated[float, _within("n_i")]] = key(
        ..., "Angular velocity [x, y, z] in sqrt(g/a)."
    )
    u: Vertical = key(
        [0, 0, -1], "Vertical unit vector [x, y, z]; [0, 0, -1] is upright."
    )


class Horizon(Base):
    """Time at which a run without a reversal ends. Of several, the smallest counts."""

    t_rgh: Time | None = key(None, "In units of t_rGH in the spin's own direction.")
    t: Annotated[float, quantity_or(Time, "time", "in sqrt(a/g)")] | None = key(
        None, "In sqrt(a/g) or with a unit."
    )
    t_decay: Time | None = key(
        None, "In units of gamma/sigma; needs dissipation.sigma."
    )

    def earliest(
        self,
        t: Floats | float | None,
        t_rgh: Floats,
        gamma: Floats,
        sigma: Floats | None,
    ) -> Floats:
        """Return the horizons of runs; `t` is the key, in units of the bodies."""
        end = np.full(len(t_rgh), np.inf)
        if self.t_rgh is not None:
            # fmin ignores NaN, the t_rGH of launches that have none.
            end = np.fmin(end, self.t_rgh * t_rgh)
        if t is not None:
            end = np.minimum(end, t)
        if self.t_decay is not None and sigma is not None:
            with np.errstate(divide="ignore"):
                end = np.minimum(end, self.t_decay * gamma / sigma)
        return end


def constant_of(name: str, *words: str) -> object:
    """Return the type of a value of a constant of the registry, or of a word."""
    quantity = QUANTITIES[name]
    number = Annotated[float, _within(name)]
    words = (FROM_TABLE, *words)
    if quantity.kind:
        item = quantity_or(number, quantity.kind, f"in {quantity.unit}", *words)
    else:
        item = number_or(number, *words)
    return Annotated[float | str, item]


def loss_key(loss: ActionConstant) -> Any:
    """Return the type and the field of the key of a constant of dissipation."""
    words = [OF_SLIDES] if loss.name == "creep" else []
    values: Any = Several[constant_of(loss.name, *words)]  # type: ignore[misc]
    meaning = f"{loss.key}."
    if loss.kind:
        meaning = f"{loss.key}, in {loss.unit} or with a unit."
    if loss.default is None:
        return values | None, key(None, meaning)
    return values, key([loss.default], meaning)


# A key for each constant of the registry.
LossKeys: Any = pydantic.create_model(
    "LossKeys",
    __base__=Base,
    **{name: loss_key(loss) for name, loss in LOSSES.items()},
)


class Dissipation(LossKeys):  # type: ignore[misc]
    """Loss of energy. Each value of a list is a case; `table` stands for a table's
    column.
    """

    @property
    def present(self) -> list[str]:
        """The constants that are not zero in some run."""
        # A key is absent, or has a list with a value for each case.
        absent: tuple[object, ...] = (None, [0])
        return [name for name in LOSSES if getattr(self, name) not in absent]

    @property
    def creeps_with_mu(self) -> bool:
        """Whether the patch creeps with the friction of slides."""
        creep: list[float | str] = self.creep
        return creep == [OF_SLIDES]

    @property
    def values(self) -> dict[str, list[float | str]]:
        """The values of each constant that cases have."""
        return {
            name: getattr(self, name)
            for name, loss in LOSSES.items()
            if not loss.optional
            or (name in self.present and getattr(self, name) != [OF_SLIDES])
        }

    @property
    def has_couples(self) -> bool:
        """Whether couples of friction act in some run."""
        return bool(COUPLE_CONSTANTS.intersection(self.present))

    @property
    def law(self) -> str:
        """The actions of the constants, as models are named by them."""
        return law_of(self.present)

    @property
    def pivots(self) -> bool:
        """Whether friction resists the spin and can hold it at zero."""
        return "pivot" in self.present

    @property
    def creeps(self) -> bool:
        """Whether the patch of contact gives way as it pivots."""
        return "creep" in self.present

    @property
    def slips(self) -> bool:
        """Whether the foot slips under viscous friction."""
        return "viscous" in self.present

    @property
    def slides(self) -> bool:
        """Whether the foot slides where the plane does not hold it."""
        return "mu" in self.present

    def __bool__(self) -> bool:
        return bool(self.present)


def _in_radians(degrees: list[float | str]) -> list[float | str]:
    return [x if isinstance(x, str) else math.radians(x) for x in degrees]


class Shaking(Base):
    """A plane that shakes. Each value of a list is a case; `table` stands for a table's
    column.
    """

    frequency: Several[constant_of("base_frequency")] = key(  # type: ignore[valid-type]
        ...,
        "Angular frequency in sqrt(g/a) or rad/s, or cycles a second, such as 25 Hz.",
    )
    acceleration: Several[constant_of("base_acceleration")] | None = key(  # type: ignore[valid-type]
        None, "Amplitude of the plane's acceleration in g."
    )
    amplitude: Several[constant_of("base_amplitude")] | None = key(  # type: ignore[valid-type]
        None, "Amplitude of the plane's path, in a or with a unit, in its place."
    )
    phase_deg: Several[DriveAngle] = key(
        [0.0], "Phase at launch, in degrees; 0: the acceleration is largest."
    )
    direction: Annotated[str, OneOf(BASE_DIRECTIONS)] = key(
        "vertical", "Direction in which it shakes."
    )
    azimuth_deg: Several[DriveAngle] | None = key(
        None,
        "Of a horizontal one, 0 if it is left out: the angle from the body's x axis "
        "at launch, counterclockwise from above.",
    )

    @property
    def present(self) -> list[str]:
        """The constants in runs, none if the plane is at rest in all."""
        absent: tuple[object, ...] = (None, [0])
        if self.acceleration in absent and self.amplitude in absent:
            return []
        return [name for name in DRIVES if self.is_horizontal or name != "base_azimuth"]

    @property
    def is_horizontal(self) -> bool:
        """Whether the plane shakes along itself."""
        return self.direction == HORIZONTAL

    @property
    def values(self) -> dict[str, list[float | str]]:
        """The values that cases have, of the amplitude in place of the acceleration."""
        if not self.present:
            return {}
        values: dict[str, list[float | str]] = {"base_frequency": self.frequency}
        if self.acceleration is not None:
            values["base_acceleration"] = self.acceleration
        elif self.amplitude is not None:
            values["base_amplitude"] = self.amplitude
        values["base_phase"] = _in_radians(self.phase_deg)
        if self.is_horizontal:
            values["base_azimuth"] = _in_radians(self.azimuth_deg or [0.0])
        return values

    def with_columns(self, columns: Mapping[str, list[float | str]]) -> "Shaking":
        """Return the plane with the columns of a table, which have the names of runs.

        Angles in columns are in radians.  Only planes that shake along themselves have
        an azimuth.
        """
        keys = {name.removeprefix("base_"): values for name, values in columns.items()}
        if "phase" in keys:
            keys["phase_deg"] = keys.pop("phase")
        if "azimuth" in keys:
            keys["azimuth_deg"] = keys.pop("azimuth")
            keys["direction"] = HORIZONTAL  # type: ignore[assignment]
        if "acceleration" in keys:
            keys["amplitude"] = None  # type: ignore[assignment]
        return self.model_copy(update=keys)


UNSHAKEN = Shaking.model_construct(frequency=[0.0])
"""A plane that does not shake."""


class Acting:
    """What acts on bodies in a sweep: dissipation, and a plane that shakes."""

    def __init__(self, losses: Dissipation, plane: Shaking) -> None:
        self.present = losses.present + plane.present
        self.values = losses.values | plane.values
        self.is_shaken = bool(plane.present)

    @property
    def law(self) -> str:
        """The actions of the constants, as models are named by them."""
        return law_of(self.present)

    @property
    def does_work(self) -> bool:
        """Whether actions do work that the state counts."""
        return bool(self.law)

    def __bool__(self) -> bool:
        return bool(self.present)


class Classify(Base):
    """Thresholds between the types of runs that do not reverse."""

    ss_growth: float = key(
        1e-3, "Type SS if amplitudes grow by less than this fraction.", gt=0
    )
    sw_departure: float = key(
        0.05, "Otherwise SW if the spin loses this fraction of n_i.", gt=0, lt=1
    )
    early: bool = key(False, "End runs of model full once they are sure to be SS.")
    dead_energy: float = key(
        0.01,
        "D (dead) if not R and less than this fraction of the energy is left.",
        ge=1e-6,
        lt=1,
    )

    @property
    def thresholds(self) -> dict[str, float]:
        """The thresholds, without `early`, which stored runs cannot change."""
        return self.model_dump(exclude={"early"})

    @property
    def as_text(self) -> str:
        """The thresholds as JSON, as stored in each file of rows."""
        return json.dumps(self.thresholds, sort_keys=True)


class Stop(Base):
    """Half-widths of 95 % intervals at which a case has enough samples. If several are
    given, all must be met.
    """

    fraction: float | None = key(None, "For the fraction of each type.", gt=0, lt=0.5)
    t_r: float | None = key(
        None,
        "For the mean t_r, relative to it; a case whose spread of times is so wide "
        "that they may have no mean goes on.",
        gt=0,
        lt=1,
    )
    t_r_median: float | None = key(
        None, "For the median t_r, relative to it.", gt=0, lt=1
    )

    @property
    def watches_times(self) -> bool:
        """Whether reversal times decide when a case has enough samples."""
        return self.t_r is not None or self.t_r_median is not None


# Method and tol of each word; docs/accuracy.md has their errors.
ACCURACIES: dict[AccuracyName, tuple[str, float]] = {
    "draft": (DOP853.name, 1e-6),
    "standard": (DOP853.name, TOL),
    "reference": ("verner98", 1e-12),
}


class AccuracyGoal(Base):
    """Largest error of the results. Each run is repeated with smaller tol until its
    estimated error is below it.
    """

    t_r: float = key(..., "Relative error of reversal times.", ge=1e-12, le=1e-3)


class Integrator(Base):
    """Integration method, with adaptive steps (tol) or a fixed step (dt)."""

    method: Annotated[str, OneOf(tuple(METHODS))] = key(
        DOP853.name, "Name of the method."
    )
    accuracy: Annotated[AccuracyGoal | str, one_of(AccuracyGoal, ACCURACIES)] | None = (
        key(
            None,
            "A word that stands for method and tol; or {t_r: ...}, which finds a tol "
            "for each run.",
        )
    )
    tol: float | None = key(
        None,
        "For methods with adaptive steps: error per step (default 1e-09).",
        ge=1e-15,
        le=0.01,
    )
    dt: float | None = key(
        None, "For methods with a fixed step: step in sqrt(a/g) (default 0.002).", gt=0
    )
    max_steps: Count = key(MAX_STEPS, "Steps after which a run is given up.")

    @property
    def goal(self) -> float | None:
        """Largest relative error of t_r, if the config sets one."""
        if isinstance(self.accuracy, AccuracyGoal):
            return self.accuracy.t_r
        return None

    @pydantic.model_validator(mode="before")
    @classmethod
    def _spell_out(cls, data: object) -> object:
        """Fill in method, tol and dt, so that configs with one meaning are equal."""
        if not isinstance(data, dict):
            return data
        data = {name: value for name, value in data.items() if value is not None}
        accuracy = data.get("accuracy")
        if isinstance(accuracy, str) and accuracy in ACCURACIES:
            if not {"method", "tol", "dt"} & data.keys():
                del data["accuracy"]
                data["method"], data["tol"] = ACCURACIES[accuracy]
            return data
        method = data.get("method", DOP853.name)
        if accuracy is None and isinstance(method, str) and method in METHODS:
            if METHODS[method].adaptive:
                return {"tol": TOL} | data
            return {"dt": DT} | data
        return data


def _word_as_list(value: object) -> object:
    """Return one word as a list."""
    if isinstance(value, str):
        return [value]
    return value


def _setting(value: float | str | None) -> Setting:
    """Return a value of a config as a setting."""
    if isinstance(value, Quantity):
        return Setting(si=value)
    if isinstance(value, str):  # `FROM_TABLE`
        return Setting()
    return Setting(value)


class Config(Base):
    """A sweep: its bodies, launches, integration, and output."""

    texts = ("name", "output")

    name: str = key(
        "sweep",
        "Name of the sweep and of its directory in out/; default: name of the file.",
    )
    seed: Whole = key(
        0,
        "Start of the random numbers; a draw depends on seed, case and sample alone.",
        ge=0,
        lt=2**63,
    )
    bodies: AnySource = key(..., "Source of the bodies.", discriminator="source")
    stop: Stop | None = key(
        None,
        "When a case has enough samples, before all of `bodies.samples` are run.",
    )
    launch: FullState | None = key(None, "Full initial state, in place of `spin`.")
    spin: Spin | None = key(
        None, "Launches; not needed if `launch` or a table has them."
    )
    model: ModelName = key(
        "full",
        "full: the equations of motion; reduced: the paper's three variables; gh: "
        "Garcia and Hubbard's formula alone.",
    )
    horizon: Horizon = key(
        lambda: Horizon(t_rgh=5.0), "When runs that do not reverse end."
    )
    dissipation: Dissipation = key(Dissipation, "Loss of energy, not for model gh.")
    base: Shaking | None = key(None, "A plane that shakes, for model full.")
    integrator: Integrator = key(Integrator, "Integration method.")
    classify: Classify = key(Classify, "Thresholds between types of runs.")
    record: Annotated[
        list[Annotated[str, OneOf(RECORDABLE)]],
        AfterValidator(distinct),
        UNIQUE,
        BeforeValidator(_word_as_list),
    ] = key(
        list,
        "Extra columns; with reversals, spectrum or late, runs go on to the horizon "
        "after they reverse.",
    )
    output: str | None = key(None, "Directory; null: out/<name>.", **PATH)

    _places: KeyPlaces = pydantic.PrivateAttr(default_factory=KeyPlaces)

    @pydantic.field_validator("name")
    @classmethod
    def _plain_word(cls, name: str) -> str:
        # It names the default directory of output.
        is_folder = name.strip() in ("", ".", "..")
        has_slash = "/" in name or "\\" in name
        if is_folder or has_slash or not name.isprintable():
            raise ValueError(
                "is not a plain word; leave out slashes and control characters"
            )
        return name

    @pydantic.model_validator(mode="after")
    def _order_record(self) -> Self:
        """Sort the words of `record`, and add those that are implied."""
        recorded = {*self.record}
        if self.integrator.goal:
            recorded.add("error")
        # A config is frozen; this is still a part of making it.
        self.__dict__["record"] = [name for name in RECORDABLE if name in recorded]
        return self

    @property
    def refine(self) -> Refine | None:
        """How a grid is refined, if it is."""
        if isinstance(self.bodies, GridSource):
            return self.bodies.refine
        return None

    @property
    def deciding_key(self) -> Literal["stop", "bodies.refine"] | None:
        """The key by which a sweep skips runs; None if it runs all."""
        if self.stop is not None:
            return "stop"
        if self.refine is not None:
            return "bodies.refine"
        return None

    @property
    def deciding_column(self) -> str | None:
        """The column, besides `type`, by which a sweep skips runs."""
        if self.stop is not None:
            return "t_r" if self.stop.watches_times else None
        if self.refine is None or self.refine.by == "type":
            return None
        return self.refine.by

    @property
    def goes_on(self) -> bool:
        """Whether runs go on to the horizon after a reversal."""
        return not {"reversals", "spectrum", "late"}.isdisjoint(self.record)

    @property
    def parts(self) -> list[str]:
        """Optional groups of columns in `runs`."""
        recorded = {*self.record}
        surface = self.bodies.bottom
        parts = [*self.record]
        if self.integrator.goal is not None:
            parts.append("tol")
        if {"error", "reversals"} <= recorded:
            parts.append("turns")
        if {"casimir", "reversals"} <= recorded:
            parts.append("casimir_turns")
        if {"lyapunov", "spectrum"} & recorded:
            parts.append("chaos")
        if CONSTANT_OF_SURFACE[surface] is not None:
            parts.append(surface)
        if self.dissipation:
            parts.append("dissipation")
        parts += [name for name in self.dissipation.present if LOSSES[name].optional]
        if self.acting.is_shaken:
            parts.append("base")
        if "base_azimuth" in self.acting.present:
            parts.append("base_azimuth")
        return parts

    @property
    def acting(self) -> Acting:
        """What acts on bodies beside gravity and the plane."""
        return Acting(self.dissipation, self.base or UNSHAKEN)

    def with_columns(self, columns: Mapping[str, list[float | str]]) -> "Config":
        """Return the config with the constants in columns of a table."""
        losses = {name: columns[name] for name in LOSSES if name in columns}
        drives = {name: columns[name] for name in DRIVES if name in columns}
        sections: dict[str, object] = {
            "dissipation": self.dissipation.model_copy(update=losses)
        }
        if drives:
            sections["base"] = (self.base or UNSHAKEN).with_columns(drives)
        return self.model_copy(update=sections)

    @property
    def settings(self) -> dict[str, list[Setting]]:
        """Values by the column that they set, empty where a table has them."""
        settings: dict[str, Sequence[float | str | None]] = {
            **self.acting.values,
            "t_end": [self.horizon.t],
        }
        if self.spin is not None:
            settings["n_i"] = self.spin.n_i
            settings["omega_xy0"] = self.spin.omega_xy0
        return {name: list(map(_setting, x)) for name, x in settings.items()}

    @property
    def in_si(self) -> bool:
        """Whether some values have units, so that they depend on the bodies' sizes."""
        return any(value.si is not None for value in chain(*self.settings.values()))

    @property
    def directory(self) -> str:
        """The output directory."""
        return self.output or f"out/{self.name}"

    def located(self, message: str) -> str:
        """Return a message with file and line in front if it begins with a dotted
        key.
        """
        name, _, sentence = message.partition(": ")
        sections = "|".join(Config.model_fields)
        if not re.fullmatch(rf"({sections})(\.\w+|\[\d+\])*", name):
            return message
        names = re.findall(r"\w+", name)
        place = tuple(int(word) if word.isdigit() else word for word in names)
        return self._places.line(place, sentence)

    @contextmanager
    def locating(self) -> Iterator[None]:
        """Put file and line in front of the messages of a ConfigError."""
        try:
            yield
        except ConfigError as error:
            raise ConfigError(map(self.located, error.messages)) from None


# The same constants, one number each.
Losses = pydantic.create_model(
    "Losses",
    __base__=Base,
    __doc__="Dissipation of one run.",
    **{name: (float | str | None, loss.default) for name, loss in LOSSES.items()},  # type: ignore[call-overload]
)


class Stone(Base):
    """What is known of a stone, and the names of the unknowns; see `docs/fit.md`."""

    body: dict[str, object]
    free: list[str] = Field(default_factory=list)
    launch: dict[str, object] = Field(default_factory=dict)
    dissipation: Losses = Field(default_factory=Losses)  # type: ignore[valid-type]
    base: dict[str, object] | None = None
    error: float | str | None = None
