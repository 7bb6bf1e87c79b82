"""Sources of bodies, as the key `bodies` of a config has them."""

import math
from collections.abc import Iterable
from typing import Annotated, Any, ClassVar, Literal, Self

import pydantic
from pydantic import BeforeValidator, Field

from rattlesweep.config.keys import (
    PATH,
    Base,
    Gamma,
    Phi,
    Positive,
    ShellShare,
    Theta,
    _within,
    key,
    parameter,
)
from rattlesweep.config.values import (
    Count,
    One,
    OneOf,
    OrText,
    Range,
    Several,
    Three,
    TwoOf,
    Whole,
    pair_of_lengths,
    quantity_or,
    size_of,
)
from rattlesweep.physics.si import LIMITS
from rattlesweep.words.defaults import MESH_UNIT
from rattlesweep.words.names import REFINABLE, PresetName
from rattlesweep.words.quantities import (
    ANGLES,
    CONSTANT_OF_SURFACE,
    SURFACE_CONSTANTS,
)
from rattlesweep.words.units import without_unit

PRESET_MEANING = (
    "GH: the body of Garcia and Hubbard (1988); KL: that of Kane and Levinson (1982)."
)
SIZED_PRESETS = ("KL",)
# Presets that are no paraboloids, with the constant of their surface.
PRESET_CONSTANTS = {"KL": "c"}
_OF_BODY = ("alpha", "beta", "gamma", "theta", "phi", "xi", "xi_deg")
Draw = Literal["random", "sobol", "saltelli"]


_IMPLIED_SURFACES = [
    f"{surface} if {constant} is given"
    for surface, constant in CONSTANT_OF_SURFACE.items()
    if constant is not None
]
SURFACE_MEANING = "; ".join(["Shape of the bottom", *_IMPLIED_SURFACES])


def with_quantities(base: type[Base], form: Any, names: Iterable[str]) -> Any:
    """Return `base` with a key for each of some quantities, as the registry has them.

    A number may stand there, or what `form`, such as ``Range``, makes of its type.
    """
    keys: dict[str, Any] = {}
    for name in names:
        number = Annotated[float, _within(name)]
        keys[name] = (form[number] | None, parameter(name))
    return pydantic.create_model(base.__name__, __base__=base, **keys)


class Surfaced(Base):
    """Bodies with one of several surfaces."""

    source: str
    surface: Annotated[str, OneOf(tuple(CONSTANT_OF_SURFACE))] | None = key(
        None, f"{SURFACE_MEANING}."
    )

    # Whether their size is known.  Of a table, only its rows tell.
    has_size: ClassVar[bool] = False

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


class SdSource(with_quantities(Surfaced, Range, SURFACE_CONSTANTS)):  # type: ignore[misc]
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


class Overrides(with_quantities(Base, One, _OF_BODY)):  # type: ignore[misc]
    """Parameters that replace those of a preset."""

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters that are given, with xi in radians."""
        values: dict[str, float] = self.model_dump(
            exclude_none=True, exclude={"preset", "xi_deg"}
        )
        if self.xi_deg is not None:
            values["xi"] = math.radians(self.xi_deg)
        return values


class PresetSource(with_quantities(Surfaced, One, SURFACE_CONSTANTS)):  # type: ignore[misc]
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


class TableSource(with_quantities(Surfaced, One, SURFACE_CONSTANTS)):  # type: ignore[misc]
    """Bodies from the rows of a table, in its order."""

    texts = ("path",)

    source: Literal["table"] = key(..., "The rows of a table.")
    path: str = key(
        ..., "CSV or Parquet file, or a directory of Parquet files.", **PATH
    )

    @classmethod
    def in_memory(cls, surface: str | None) -> Self:
        """Return the source of a table without a path, whose rows are at hand."""
        return cls.model_construct(source="table", path="", surface=surface)


class GridBase(Overrides):
    """The body whose parameters are varied: a preset, six parameters, or a
    shell-dumbbell body.
    """

    preset: PresetName | None = key(None, "A named body.")
    f_sd: ShellShare | None = parameter("f_sd")


_VARIED = (
    *("alpha", "beta", "gamma", "f_sd", "theta", "phi"),
    *("xi", *ANGLES, *SURFACE_CONSTANTS),
)


class Axes(with_quantities(Base, Several, _VARIED)):  # type: ignore[misc]
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


class GridSource(with_quantities(Surfaced, Several, SURFACE_CONSTANTS)):  # type: ignore[misc]
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
        names = ("length", "width", "height", "mass", "skew", "weights")
        ranges = {name: getattr(self, name) for name in names}
        return {name: ends for name, ends in ranges.items() if ends is not None}

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
