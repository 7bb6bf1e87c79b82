"""Schema of a config as frozen pydantic models, in units M = a = g = 1; rules between
keys.
"""

import json
import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import chain
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
import pydantic
from pydantic import AfterValidator, BeforeValidator, Field

from rattlesweep.arrays import Floats
from rattlesweep.defaults import MESH_UNIT
from rattlesweep.design.columns import RECORDABLE, REFINABLE
from rattlesweep.design.config import KeyPlaces
from rattlesweep.design.config.values import (
    UNIQUE,
    Count,
    One,
    OneOf,
    OrText,
    Range,
    Several,
    Three,
    TwoOf,
    Vertical,
    Whole,
    distinct,
    number_or,
    one_of,
    pair_of_lengths,
    quantity_or,
    size_of,
)
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.tableau import DOP853, DT, MAX_STEPS, METHODS, TOL
from rattlesweep.names import AccuracyName, ModelName, PresetName
from rattlesweep.physics.si import LIMITS
from rattlesweep.quantities import (
    CONSTANT_OF_SURFACE,
    COUPLE_CONSTANTS,
    LOSSES,
    MAX_TIME,
    QUANTITIES,
    SURFACE_CONSTANTS,
    Loss,
    law_of,
)
from rattlesweep.units import Quantity, Setting, without_unit

MAX_CASES = 100_000
FROM_TABLE = "table"  # stands for values that the rows of a table give
PATH = {"min_length": 1, "pattern": r"^[^\x00]*$"}


def key(default: object, description: str, **limits: Any) -> Any:
    """Return a pydantic field; a callable default is a factory."""
    if callable(default):
        return Field(default_factory=default, description=description, **limits)
    return Field(default=default, description=description, **limits)


def parameter(name: str, default: object = None) -> Any:
    """Return the field of a body parameter, which the registry describes."""
    quantity = QUANTITIES[name]
    description = f"{quantity.meaning[0].upper()}{quantity.meaning[1:]}"
    if quantity.unit not in ("1", "deg"):
        description += f", in {quantity.unit}"
    return Field(default, description=f"{description}.")


def _within(name: str) -> object:
    """Return the limits of a quantity as a constraint of a type."""
    quantity = QUANTITIES[name]
    if quantity.is_open:
        return Field(gt=quantity.low, lt=quantity.high)
    return Field(ge=quantity.low, le=quantity.high)


class Base(pydantic.BaseModel):
    """Frozen, strict and closed model."""

    model_config = {
        "extra": "forbid",
        "frozen": True,
        "strict": True,
        "allow_inf_nan": False,
        # Models take 0.3 s to build, and a command needs one of them.
        "defer_build": True,
    }
    # Keys whose texts stay texts, even if they look like numbers.
    texts: ClassVar[tuple[str, ...]] = ()

    @pydantic.model_validator(mode="before")
    @classmethod
    def _tidy(cls, data: object) -> object:
        """Drop nulls, and read numbers such as 1e-9, which are texts in YAML 1.1.

        An unknown key stays even without a value: ``n_i: 0,3`` in braces has a key 3.
        """
        if not isinstance(data, dict):
            return data
        tidied = {}
        for name, value in data.items():
            if value is None and name in cls.model_fields:
                continue
            tidied[name] = value
            if name not in cls.texts:
                tidied[name] = _with_numbers(value)
        return tidied

    @property
    def given(self) -> dict[str, object]:
        """Return the keys that have a value."""
        return self.model_dump(exclude_none=True)


def _with_numbers(value: object) -> object:
    """Return a value with the texts that are numbers as numbers."""
    if isinstance(value, list):
        return [_with_numbers(item) for item in value]
    if isinstance(value, str):
        for kind in (int, float):
            with suppress(ValueError):
                return kind(value)
    return value


Positive = Annotated[float, Field(gt=0)]
Time = Annotated[float, Field(gt=0, le=MAX_TIME)]
Alpha = Annotated[float, _within("alpha")]
Beta = Annotated[float, _within("beta")]
Gamma = Annotated[float, _within("gamma")]
Theta = Annotated[float, _within("theta")]
Phi = Annotated[float, _within("phi")]
Xi = Annotated[float, _within("xi")]
XiDegrees = Annotated[float, _within("xi_deg")]
MinusXiDegrees = Annotated[float, _within("minus_xi_deg")]
ShellShare = Annotated[float, _within("f_sd")]

PRESET_MEANING = (
    "GH: the body of Garcia and Hubbard (1988); KL: that of Kane and Levinson (1982)."
)
SIZED_PRESETS = ("KL",)
# Presets that are no paraboloids, with the constant of their surface.
PRESET_CONSTANTS = {"KL": "c"}
Draw = Literal["random", "sobol", "saltelli"]


_IMPLIED_SURFACES = [
    f"{surface} if {constant} is given"
    for surface, constant in CONSTANT_OF_SURFACE.items()
    if constant is not None
]
SURFACE_MEANING = "; ".join(["Shape of the bottom", *_IMPLIED_SURFACES])


def with_constants(base: type[Base], form: Any) -> Any:
    """Return `base` with one more key for each surface that has a further constant.

    A number may stand there, or what `form`, such as ``Range``, makes of its type.
    """
    keys: dict[str, Any] = {}
    for name in SURFACE_CONSTANTS:
        number = Annotated[float, _within(name)]
        keys[name] = (form[number] | None, parameter(name))
    return pydantic.create_model(base.__name__, __base__=base, **keys)


class Surfaced(Base):
    """Bodies with one of several surfaces."""

    source: str
    surface: Annotated[str, OneOf(tuple(CONSTANT_OF_SURFACE))] | None = key(
        None, f"{SURFACE_MEANING}."
    )

    # Their size is known; None if only the rows of a table tell.
    has_size: ClassVar[bool | None] = False

    def constant(self, name: str) -> Any:
        """Return the value of the key for a further constant of a surface, or None."""
        return getattr(self, name)

    @property
    def constants(self) -> set[str]:
        """The further constants that the config gives, by a key or a preset."""
        return {name for name in SURFACE_CONSTANTS if self.constant(name) is not None}

    @property
    def bottom(self) -> str:
        """The surface: that of the key, or else that of a constant that is given."""
        if self.surface is not None:
            return self.surface
        for name, constant in CONSTANT_OF_SURFACE.items():
            if constant in self.constants:
                return name
        return next(iter(CONSTANT_OF_SURFACE))


def of_preset(name: str | None) -> set[str]:
    """Return the further constants that a preset has."""
    return {PRESET_CONSTANTS[name]} if name in PRESET_CONSTANTS else set()


class SdRanges(Base):
    """Ranges from which shell-dumbbell bodies are drawn; default: the paper's Table
    I.
    """

    gamma: Range[Gamma] = parameter("gamma", [5.0, 15.0])
    f_sd: Range[ShellShare] = parameter("f_sd", [0.05, 0.15])
    theta: Range[Theta] = parameter("theta", [0.6, 0.95])
    phi: Range[Phi] = parameter("phi", [0.01, 0.1])
    # The lower end may be zero, as draws exclude it.
    minus_xi_deg: Range[Annotated[float, Field(ge=0, lt=90)]] = parameter(
        "minus_xi_deg", [0.0, 6.0]
    )


class Target(Base):
    """Bodies are redrawn until their torque coefficient lies close to one of these
    values.
    """

    K_r: Several[Positive] | None = key(
        None, "Targets of the rolling coefficient; a case each."
    )
    K_p: Several[Positive] | None = key(
        None, "Targets of the pitching coefficient; a case each."
    )
    rel_tol: float = key(
        1e-3, "Largest relative distance from the target.", gt=0, le=0.5
    )
    max_draws: Count = key(10**6, "Draws after which a sample is given up.")

    @property
    def name(self) -> Literal["K_r", "K_p"]:
        """The coefficient that has targets."""
        return "K_p" if self.K_r is None else "K_r"

    @property
    def values(self) -> list[float]:
        """The targets."""
        return self.K_r or self.K_p or []


class SdSource(with_constants(Surfaced, Range)):  # type: ignore[misc]
    """Shell-dumbbell bodies, drawn at random from ranges."""

    source: Literal["sd"] = key(..., "Shell-dumbbell bodies drawn at random.")
    samples: Count = key(1000, "Bodies per case.")
    ranges: SdRanges = key(SdRanges, "Ranges of the uniform draws.")
    draw: Draw = key(
        "random",
        "sobol: more even than random; saltelli: for `rattlesweep sensitivity`.",
    )
    target: Target | None = key(None, "Keep only bodies with this torque coefficient.")

    @property
    def drawn(self) -> tuple[str, ...]:
        """Names of the parameters that are drawn from a range, in their order."""
        names = tuple(SdRanges.model_fields)
        for name in self.constants:
            low, high = self.constant(name)
            if low < high:
                names = (*names, name)
        return names

    @property
    def group(self) -> int:
        """Samples that saltelli draws together: two points, and one for each
        parameter.
        """
        return 2 + len(self.drawn)


class Overrides(Base):
    """Parameters that replace those of a preset."""

    alpha: Alpha | None = parameter("alpha")
    beta: Beta | None = parameter("beta")
    gamma: Gamma | None = parameter("gamma")
    theta: Theta | None = parameter("theta")
    phi: Phi | None = parameter("phi")
    xi: Xi | None = parameter("xi")
    xi_deg: XiDegrees | None = parameter("xi_deg")

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters that are given, with xi in radians."""
        values = self.model_dump(exclude_none=True, exclude={"preset", "xi_deg"})
        if self.xi_deg is not None:
            values["xi"] = math.radians(self.xi_deg)
        return values


class PresetSource(with_constants(Surfaced, One)):  # type: ignore[misc]
    """One body of the literature, perhaps with other values of some parameters."""

    texts = ("name",)

    source: Literal["preset"] = key(..., "A named body.")
    name: PresetName = key(..., PRESET_MEANING)
    overrides: Overrides = key(Overrides, "Parameters that replace the preset's.")

    @property
    def has_size(self) -> bool:
        """Whether the size of the preset is known."""
        return self.name in SIZED_PRESETS

    @property
    def constants(self) -> set[str]:
        """The further constants that the config gives, by a key or the preset."""
        constants: set[str] = super().constants
        return constants | of_preset(self.name)


class TableSource(with_constants(Surfaced, One)):  # type: ignore[misc]
    """Bodies from the rows of a table, in its order."""

    texts = ("path",)
    has_size = None

    source: Literal["table"] = key(..., "The rows of a table.")
    path: str = key(
        ..., "CSV or Parquet file, or a directory of Parquet files.", **PATH
    )

    @classmethod
    def in_memory(cls, surface: str | None) -> Self:
        """Return the source of a table without a path, whose rows are at hand."""
        rows: Self = cls.model_construct(source="table", path="", surface=surface)
        return rows


class GridBase(Overrides):
    """The body whose parameters are varied: a preset, six parameters, or a
    shell-dumbbell body.
    """

    preset: PresetName | None = key(None, "A named body.")
    f_sd: ShellShare | None = parameter("f_sd")


class ParameterAxes(Base):
    """Parameters that vary, without the constants of surfaces."""

    alpha: Several[Alpha] | None = parameter("alpha")
    beta: Several[Beta] | None = parameter("beta")
    gamma: Several[Gamma] | None = parameter("gamma")
    f_sd: Several[ShellShare] | None = parameter("f_sd")
    theta: Several[Theta] | None = parameter("theta")
    phi: Several[Phi] | None = parameter("phi")
    xi: Several[Xi] | None = parameter("xi")
    xi_deg: Several[XiDegrees] | None = parameter("xi_deg")
    minus_xi_deg: Several[MinusXiDegrees] | None = parameter("minus_xi_deg")


class Axes(with_constants(ParameterAxes, Several)):  # type: ignore[misc]
    """Parameters that vary. Every combination is a body; the first axis varies
    slowest.
    """


class Refine(Base):
    """A coarse grid is run first. Then its cells are halved, level by level, where the
    runs at the corners of a cell differ.
    """

    levels: Whole = key(
        4, "Halvings from the coarse grid to the full one.", ge=1, le=16
    )
    by: Annotated[str, OneOf(REFINABLE)] = key(
        "type", "Column that is compared: a cell in which it differs is halved."
    )
    tol: float = key(
        0.05,
        "For numbers: largest difference from linear interpolation, as a fraction.",
        gt=0,
        lt=1,
    )


class GridSource(with_constants(Surfaced, Several)):  # type: ignore[misc]
    """All combinations of the values of some parameters, with the others fixed."""

    source: Literal["grid"] = key(..., "A grid of parameters.")
    base: GridBase = key(..., "The body whose parameters are varied.")
    axes: Axes = key(..., "Parameters that vary, with their values.")
    refine: Refine | None = key(None, "Skip the points between runs that agree.")

    @property
    def has_size(self) -> bool:
        """Whether the size of the base is known."""
        return self.base.preset in SIZED_PRESETS

    @property
    def constants(self) -> set[str]:
        """The further constants that the config gives: a key, an axis, the preset."""
        constants: set[str] = super().constants
        axes: set[str] = self.axes.given.keys() & SURFACE_CONSTANTS.keys()
        return constants | axes | of_preset(self.base.preset)

    @property
    def varying(self) -> dict[str, list[float]]:
        """Values of each axis in order; a key such as c with several values is the
        last axis.
        """
        axes = {name: values for name, values in vars(self.axes).items() if values}
        for name in SURFACE_CONSTANTS:
            values = self.constant(name) or []
            if len(values) > 1:
                axes[name] = values
        return axes


def _angle() -> OrText:
    """Return a number in radians or a text with a unit, within limits."""
    low, high, unit = LIMITS["angle"]
    number = Annotated[float, Field(ge=low, le=high)]
    return quantity_or(number, "angle", f"in {unit}", is_limited=True)


Length = Annotated[float, size_of("length")]
Mass = Annotated[float, size_of("mass")]
Angle = Annotated[float, _angle()]
Coordinate = Annotated[float, size_of("length", is_limited=False, may_be_zero=True)]
Place = Annotated[TwoOf[Coordinate], BeforeValidator(pair_of_lengths)]


class ShapeSource(Base):
    """Bodies of a shape; keys that are ranges are drawn for each sample. Sizes need
    a unit; a skew without one is in rad.
    """

    source: Literal["shape"] = key(..., "Bodies of a shape and a size.")
    shape: Literal["half_ellipsoid"] = key(
        "half_ellipsoid", "Of uniform density, flat side up."
    )
    length: Range[Length] = key(..., "Long axis of the flat side.")
    width: Range[Length] = key(..., "Short axis of the flat side.")
    height: Range[Length] = key(..., "From the lowest point to the flat side.")
    mass: Range[Mass] = key(..., "Without the weights.")
    skew: Range[Angle] = key(
        [0.0, 0.0],
        "Angle of the axes of inertia from the long and short axis, clockwise from "
        "above; needed without weights.",
    )
    weights: Range[Mass] | None = key(
        None, "Mass of each of two equal weights on the flat side."
    )
    at: Place | None = key(
        None, "Place [x, y] of one weight, to the right and away from you."
    )
    wall: Length | None = key(None, "Thickness of an open shell; none: solid.")
    samples: Count | None = key(None, "Bodies per case (1000) if a key is a range.")

    bottom: ClassVar[str] = "ellipsoid"
    has_size: ClassVar[bool] = True

    @property
    def sizes(self) -> dict[str, list[float]]:
        """The range of each key in SI units."""
        ranges = {
            "length": self.length,
            "width": self.width,
            "height": self.height,
            "mass": self.mass,
            "skew": self.skew,
        }
        if self.weights is not None:
            ranges["weights"] = self.weights
        return ranges

    @property
    def fixed(self) -> dict[str, float]:
        """The keys without a range, as arguments of `physics.si.half_ellipsoid`."""
        fixed = {}
        if self.at is not None:
            fixed["x"], fixed["y"] = self.at
        if self.wall is not None:
            fixed["wall"] = self.wall
        return fixed

    @property
    def drawn(self) -> list[str]:
        """Names of the keys that are drawn from a range."""
        return [name for name, (low, high) in self.sizes.items() if low < high]


def _point_masses(value: object) -> object:
    """Refuse point masses without a unit; the places have the unit of the mesh."""
    if isinstance(value, list):
        for point in value:
            if not (isinstance(point, list) and len(point) == 2):
                raise ValueError(
                    "is no point [mass, [x, y, z]], as [7.5 g, [45, -9, 0]]"
                )
            if isinstance(point[0], int | float):
                wrong = without_unit(point[0], "mass", of_size=True)
                raise ValueError(f"{point[0]:g} {wrong}")
    return value


Density = Annotated[float, size_of("density", is_limited=False)]
NumberOrTexts = float | str | list[float | str]
MeshPoint = list[NumberOrTexts]  # mass and place, which `physics.mesh.reading` checks


class MeshSource(Base):
    """Bodies of closed meshes, a case each."""

    texts = ("path", "unit")

    source: Literal["mesh"] = key(..., "Closed meshes, as for a 3D printer.")
    path: Several[Annotated[str, Field(**PATH)]] = key(
        ..., "STL, OBJ, PLY or 3MF files; a case each."
    )
    unit: str = key(MESH_UNIT, "Unit of the files.")
    mass: Mass | None = key(None, "Weighed mass, without the points.")
    density: Density | None = key(None, "Density, instead of the mass.")
    points: Annotated[list[MeshPoint], BeforeValidator(_point_masses)] = key(
        list, "Point masses [mass, [x, y, z]], at places in the unit of the mesh."
    )
    up: Three[float] | None = key(
        None, "Direction that is up, roughly; none: that of the flat side, or z."
    )

    bottom: ClassVar[str] = "ellipsoid"
    has_size: ClassVar[bool] = True


SOURCES: dict[str, type[Base]] = {
    "sd": SdSource,
    "preset": PresetSource,
    "table": TableSource,
    "grid": GridSource,
    "shape": ShapeSource,
    "mesh": MeshSource,
}
AnySource = (
    SdSource | PresetSource | TableSource | GridSource | ShapeSource | MeshSource
)

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
Direction = Annotated[
    float | str, one_of(Annotated[float, Field(ge=-360, le=360)], DIRECTIONS)
]


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


def loss_key(loss: Loss) -> Any:
    """Return the type and the field of the key of a constant of dissipation."""
    number = Annotated[float, _within(loss.name)]
    if loss.kind:
        unit = f"in {loss.unit}"
        item = quantity_or(number, loss.kind, unit, FROM_TABLE)
        meaning = f"{loss.key}, {unit} or with a unit."
    else:
        item = number_or(number, FROM_TABLE)
        meaning = f"{loss.key}."
    values = Several[Annotated[float | str, item]]
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
    def values(self) -> dict[str, list[float | str]]:
        """The values of each constant that cases and columns have."""
        return {
            name: getattr(self, name)
            for name, loss in LOSSES.items()
            if name in self.present or not loss.optional
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
    def slides(self) -> bool:
        """Whether the foot slides where the plane does not hold it."""
        return "mu" in self.present

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
    dissipation: Dissipation = key(Dissipation, "Loss of energy, for model full.")
    integrator: Integrator = key(Integrator, "Integration method.")
    classify: Classify = key(Classify, "Thresholds between types of runs.")
    record: Annotated[
        list[Annotated[str, OneOf(RECORDABLE)]],
        AfterValidator(distinct),
        UNIQUE,
        BeforeValidator(_word_as_list),
    ] = key(
        list,
        "Extra columns; with reversals or spectrum, runs go on to the horizon after "
        "they reverse.",
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
        return not {"reversals", "spectrum"}.isdisjoint(self.record)

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
        if {"lyapunov", "spectrum"} & recorded:
            parts.append("chaos")
        if CONSTANT_OF_SURFACE[surface] is not None:
            parts.append(surface)
        if self.dissipation:
            parts.append("dissipation")
        parts += [name for name in self.dissipation.present if LOSSES[name].optional]
        return parts

    @property
    def settings(self) -> dict[str, list[Setting]]:
        """Values by the column that they set, empty where a table has them."""
        settings: dict[str, Sequence[float | str | None]] = {
            **self.dissipation.values,
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
    free: list[str] = []
    launch: dict[str, object] = {}
    dissipation: Losses = Field(default_factory=Losses)  # type: ignore[valid-type]
    error: float | str | None = None
