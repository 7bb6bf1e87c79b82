"""Schema of a config as frozen pydantic models.  Units are M = a = g = 1: times in sqrt(a/g)."""

# mypy: disable-error-code="valid-type"
# Types that functions make are types to pydantic alone.

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import product
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PrivateAttr,
    WrapValidator,
    model_validator,
)

from rattlesweep.errors import ConfigError
from rattlesweep.integrate.defaults import DT, MAX_STEPS, TOL
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.physics.body import MAX_INERTIA
from rattlesweep.sweeps.config.messages import Key, Places, dotted, not_one_of, quoted
from rattlesweep.units import KINDS, Quantity, split

Clash = Iterator[tuple[str, str]]
"""Keys, empty for the section, and what is wrong with them."""
MAX_SPEED = 1e3
"""Largest spin or oscillation in sqrt(g/a): 5000 turns a second of a body of 1 cm.  At this
spin a tilt of 1e-6 rad takes a contact force as large as the weight."""
MAX_SIGMA = 1e6
"""Largest torque of friction over the angular velocity, in M a^2 sqrt(g/a)."""
MAX_TIME = 1e30
"""Largest horizon in sqrt(a/g) or t_rGH, beyond any run; sums of such numbers stay finite."""
MIN_OSCILLATION = 1e-140
"""Smallest oscillation in sqrt(g/a); the square of a smaller one underflows."""
MAX_AXIS, MAX_CASES = 10**6, 100_000
U_SLACK = 1e-3
"""Largest distance of a typed unit vector's length from 1."""
TABLE = "table"
"""Word for values that stand in the rows of a table."""
ELLIPSOIDS = ("KL",)
"""Presets that are ellipsoids."""
NO_NUL = r"^[^\x00]*$"


class Parameter(NamedTuple):
    """Open interval of a body parameter, and its meaning."""

    low: float
    high: float
    meaning: str


PARAMETERS = {
    "alpha": Parameter(1, MAX_INERTIA, "I_xx / (M a^2) + 1, inertia about the x axis; > beta."),
    "beta": Parameter(1, MAX_INERTIA, "I_yy / (M a^2) + 1, inertia about the y axis; > 1."),
    "gamma": Parameter(0, MAX_INERTIA, "I_zz / (M a^2), inertia about the spin axis; > 0."),
    "theta": Parameter(0, 1, "Larger curvature at the bottom times a; phi < theta < 1."),
    "phi": Parameter(0, 1, "Smaller curvature at the bottom times a; 0 < phi < theta."),
    "xi": Parameter(-math.pi / 2, 0, "Skew from inertia to curvature axes in radians; negative."),
    "xi_deg": Parameter(-90, 0, "Skew from inertia to curvature axes in degrees; negative."),
    "minus_xi_deg": Parameter(0, 90, "Skew angle times -1, in degrees; between 0 and 90."),
    "c": Parameter(0, 1e9, "Vertical semi-axis of the ellipsoid over a; above theta."),
    "f_sd": Parameter(0, 0.5, "I_yy / I_zz of a shell-dumbbell body; below 0.5."),
}
"""Parameters of bodies, in the symbols of Kondo and Nakanishi (2017).

`rattlesweep.physics.body` checks how they go together.
"""


class Clashes(ValueError):
    """Values that exclude each other: pairs of a key, empty for the section, and a sentence."""

    def __init__(self, found: list[tuple[str, str]]) -> None:
        super().__init__(found[0][1])
        self.found = found


class Base(BaseModel):
    """Frozen, strict and closed model.

    The text below a field is its description, in the JSON Schema too. A text that is exactly a
    number is taken for it, since YAML 1.1 parsers such as PyYAML read ``1e-9`` as text.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )

    @model_validator(mode="before")
    @classmethod
    def _take_numbers(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        fields = ((name, field.annotation) for name, field in cls.model_fields.items())
        texts = [name for name, kind in fields if str in (kind, *get_args(kind))]
        return {k: v if k in texts else as_number(v) for k, v in data.items()}

    @model_validator(mode="after")
    def _check_clashes(self) -> Self:
        if found := list(self._clashes()):
            raise Clashes(found)
        return self

    def _clashes(self) -> Clash:
        """Yield a key and a sentence for each value that does not go with the others."""
        yield from ()

    def _one_of(self, *names: str, needed: bool = True, both: bool = False) -> Clash:
        """Yield a clash unless one key is given; `both` may be, or none if not `needed`."""
        given = [name for name in names if getattr(self, name) is not None]
        if len(given) > 1 and not both:
            yield "", f"both {' and '.join(given)} are given; keep one of them"
        if needed and not given:
            more = ", or both" if both else ""
            yield "", f"neither {' nor '.join(names)} is given; give one of them{more}"


def as_number(value: Any) -> Any:
    """Return the number that a text is, also inside lists; return all else unchanged."""
    if isinstance(value, list):
        return [as_number(item) for item in value]
    for kind in (int, float) if isinstance(value, str) else ():
        with suppress(ValueError):
            return kind(value)
    return value


def number(name: str) -> Any:
    """Return the type of a body parameter."""
    return Annotated[float, Field(gt=PARAMETERS[name].low, lt=PARAMETERS[name].high)]


def parameter(name: str) -> Any:
    """Return the type of a body parameter that may be left out."""
    return Annotated[number(name) | None, Field(description=PARAMETERS[name].meaning)]


def or_word(item: Any, *words: str) -> Any:
    """Return the type of an item that may be one of some words instead."""

    def check(value: Any, handler: Callable[[Any], Any]) -> Any:
        if not isinstance(value, str):
            return handler(value)
        if value not in words:
            raise ValueError(not_one_of(value, words))
        return value

    given = Literal[words] | item
    return Annotated[item, WrapValidator(check, given), PlainSerializer(lambda value: value)]


def measured(item: Any, kind: str) -> Any:
    """Return the type of a number in units of the body, or of a text with a unit of a kind."""
    text = Annotated[str, Field(examples=[KINDS[kind][1]])]

    def check(value: Any, handler: Callable[[Any], Any]) -> Any:
        if not isinstance(value, str):
            return handler(value)
        try:
            return Quantity(value, kind)
        except ValueError as error:
            raise ValueError(f"{quoted(value)} {error}") from None

    return Annotated[item, WrapValidator(check, item | text), PlainSerializer(_plain)]


def _plain(value: float) -> float | str:
    return value.text if isinstance(value, Quantity) else value


PAIR: Any = Field(min_length=2, max_length=2)
TRIPLE: Any = Field(min_length=3, max_length=3)


class Spaced(Base):
    """Values between two ends, which are values themselves."""

    def values(self) -> list[float]:
        """Return n values from low to high, in even steps or with a constant ratio."""
        low, high, n = next(iter(self.__dict__.values()))
        log = isinstance(self, Logspace)
        if n != int(n) or not 1 <= n <= MAX_AXIS:
            raise ValueError(f"n is {n:g}; it must be a whole number from 1 to {MAX_AXIS}")
        if (n == 1) != (low == high) or (log and (low == 0 or not 0 < high / low < math.inf)):
            words = f"{n:.0f} values cannot be spaced from {low!r} to {high!r}"
            raise ValueError(f"{words}; give other ends, or equal ends with n = 1")
        shares = [i / (n - 1) for i in range(1, int(n) - 1)]
        if log:
            inner = [low * math.pow(high / low, share) for share in shares]
        else:
            inner = [low + (high - low) * share for share in shares]
        return [low, *inner, high][: int(n)]


class Linspace(Spaced):
    """Evenly spaced values."""

    linspace: Annotated[list[float], TRIPLE] = Field(description="[low, high, n], ends included.")


class Logspace(Spaced):
    """Values with a constant ratio."""

    logspace: Annotated[list[float], TRIPLE] = Field(description="[low, high, n], ends included.")


def _as_list(value: Any) -> Any:
    if not isinstance(value, dict) or not value.keys() & {"linspace", "logspace"}:
        return value if isinstance(value, list) else [value]
    kind, name = (Logspace, "logspace") if "logspace" in value else (Linspace, "linspace")
    ends, unit = value[name], ""
    if isinstance(ends, list) and len(ends) == 3 and all(isinstance(x, str) for x in ends[:2]):
        (low, unit), (high, other) = map(split, ends[:2])
        if low is None or high is None or unit != other:
            raise ValueError("the ends are not two numbers with one unit; write them alike")
        value = {**value, name: [low, high, ends[2]]}
    values = kind.model_validate(value).values()
    return [f"{value!r} {unit}" for value in values] if unit else values


def no_repeats(values: list[Any]) -> list[Any]:
    """Return the values; raise if one stands twice."""
    for value, count in Counter(values).items():
        if count > 1:
            raise ValueError(f"{value} is repeated; give each value once")
    return values


def several(item: Any) -> Any:
    """Return the type of a list of distinct numbers, given as one, some, or spaced ones."""
    many = Annotated[list[item], Field(min_length=1, json_schema_extra={"uniqueItems": True})]
    return Annotated[
        list[item],
        Field(min_length=1),
        BeforeValidator(_as_list, item | many | Linspace | Logspace),
        AfterValidator(no_repeats),
    ]


def _check_order(ends: list[float]) -> list[float]:
    low, high = ends
    if low > high:
        raise ValueError(f"the range [{low:g}, {high:g}] is reversed; write [{high:g}, {low:g}]")
    return ends


def interval(item: Any) -> Any:
    """Return the type of a range [low, high] that may be given as one number."""
    pair = Annotated[list[item], PAIR]
    both = BeforeValidator(lambda x: x if isinstance(x, list) else [x, x], item | pair)
    return Annotated[list[item], PAIR, both, AfterValidator(_check_order)]


def losses(most: float, kind: str) -> Any:
    """Return the type of one or several numbers up to a limit, or of the word table."""
    item = measured(Annotated[float, Field(ge=0, le=most)], kind)

    def check(value: Any, handler: Callable[[Any], list[float]]) -> Any:
        if value == TABLE:
            return value
        values = handler(value)
        return values[0] if len(values) == 1 else values

    many = several(item)
    given = many | Literal["table"]
    dump = PlainSerializer(lambda x: [*map(_plain, x)] if isinstance(x, list) else _plain(x))
    return Annotated[many, WrapValidator(check, given), dump]


Speed = Annotated[float, Field(ge=-MAX_SPEED, le=MAX_SPEED)]
Unsigned = Annotated[Speed, AfterValidator(lambda spin: spin + 0.0)]  # a zero has no sign
Oscillation = Annotated[float, Field(ge=MIN_OSCILLATION, le=MAX_SPEED)]
Positive = Annotated[float, Field(gt=0)]
Time = Annotated[float, Field(gt=0, le=MAX_TIME)]
Preset = Literal["GH", "KL"]


def ranged(name: str, item: Any = None) -> Any:
    """Return the type of a range of a body parameter."""
    return Annotated[interval(item or number(name)), Field(description=PARAMETERS[name].meaning)]


class SdRanges(Base):
    """Ranges that shell-dumbbell bodies are drawn from; the paper's Table I unless given."""

    gamma: ranged("gamma") = [5.0, 15.0]
    f_sd: ranged("f_sd") = [0.05, 0.15]
    theta: ranged("theta") = [0.6, 0.95]
    phi: ranged("phi") = [0.01, 0.1]
    # Drawn from (low, high]: zero may bound the skew angle, but is never drawn.
    minus_xi_deg: ranged("minus_xi_deg", Annotated[float, Field(ge=0, lt=90)]) = [0.0, 6.0]

    def _clashes(self) -> Clash:
        (_, _, theta, phi, skew) = self.ends()
        if phi[1] >= theta[0]:
            span = f"phi goes up to {phi[1]:g} and theta down to {theta[0]:g}"
            yield "phi", f"phi >= theta is possible, as {span}; the ranges must not meet"
        if skew[1] == 0:
            yield "minus_xi_deg", "only xi = 0 is left, which never reverses; raise the end"

    def ends(self) -> list[list[float]]:
        """Return the ranges in the order of the fields, in which bodies are drawn."""
        return [getattr(self, name) for name in type(self).model_fields]


class Target(Base):
    """Bodies are redrawn until their torque coefficient lies close to one of these values."""

    K_r: several(Positive) | None = None
    """Targets of the rolling coefficient K_r; one case for each."""
    K_p: several(Positive) | None = None
    """Targets of the pitching coefficient K_p; one case for each."""
    rel_tol: float = Field(default=1e-3, gt=0, le=0.5)
    """Largest relative distance from the target."""
    max_draws: int = Field(default=1_000_000, ge=1, le=2**62)
    """Draws after which a sample is given up."""

    def _clashes(self) -> Clash:
        yield from self._one_of("K_r", "K_p")

    @property
    def name(self) -> Literal["K_r", "K_p"]:
        """The coefficient that has targets."""
        return "K_p" if self.K_r is None else "K_r"

    @property
    def values(self) -> list[float]:
        """The targets."""
        return self.K_r or self.K_p or []


class Surfaced(Base):
    """Bodies with a surface."""

    surface: Literal["paraboloid", "ellipsoid"] | None = None
    """Shape of the bottom; unless given an ellipsoid where c is, or where the preset is one."""

    @property
    def ellipsoidal(self) -> bool:
        """Whether the bodies are ellipsoids."""
        return self.has_c if self.surface is None else self.surface == "ellipsoid"

    @property
    def has_c(self) -> bool:
        """Whether a vertical semi-axis is given, or the preset has one."""
        return getattr(self, "c", None) is not None or getattr(self, "name", None) in ELLIPSOIDS

    def _clashes(self) -> Clash:
        if self.surface == "paraboloid" and getattr(self, "c", None) is not None:
            yield "c", "c is given, and a paraboloid has none; take surface: ellipsoid"
        # A table may have a column c.
        if self.surface == "ellipsoid" and not (self.has_c or isinstance(self, TableSource)):
            yield "surface", "an ellipsoid needs c, its vertical semi-axis over a; give c: 2"


class SdSource(Surfaced):
    """Shell-dumbbell bodies, drawn at random from ranges."""

    source: Literal["sd"]
    """Draw shell-dumbbell bodies at random."""
    samples: int = Field(default=1000, ge=1, le=2**62)
    """Bodies per case."""
    ranges: SdRanges = Field(default_factory=lambda: SdRanges())
    """Where the parameters are drawn from, uniformly."""
    draw: Literal["random", "sobol", "saltelli"] = "random"
    """random: independent bodies; sobol: a scrambled Sobol' sequence, which fills the ranges more
    evenly; saltelli: groups that differ in one parameter each, for `rattlesweep sensitivity`."""
    target: Target | None = None
    """Keep only bodies with this torque coefficient; null: keep all."""
    c: Annotated[interval(number("c")) | None, Field(description=PARAMETERS["c"].meaning)] = None

    def _clashes(self) -> Clash:
        yield from super()._clashes()
        if self.draw != "random" and self.target:
            yield "target", "only random draws can meet a target; take draw: random"

    @property
    def drawn(self) -> tuple[str, ...]:
        """Names of the parameters that are drawn from a range, in their order."""
        varies = self.c is not None and self.c[0] < self.c[1]
        return (*SdRanges.model_fields, *(["c"] if varies else []))

    @property
    def group(self) -> int:
        """Samples that saltelli draws together: two points, and one for each parameter."""
        return 2 + len(self.drawn)


class Overrides(Base):
    """Parameters of a body; those that replace a preset's."""

    alpha: parameter("alpha") = None
    beta: parameter("beta") = None
    gamma: parameter("gamma") = None
    theta: parameter("theta") = None
    phi: parameter("phi") = None
    xi: parameter("xi") = None
    xi_deg: parameter("xi_deg") = None

    def _clashes(self) -> Clash:
        yield from self._one_of("xi", "xi_deg", needed=False)

    def given(self) -> dict[str, float]:
        """Return the parameters that are given, with xi in radians."""
        values = self.model_dump(exclude_none=True, exclude={"preset"})
        if "xi_deg" in values:
            values["xi"] = math.radians(values.pop("xi_deg"))
        return values


class PresetSource(Surfaced):
    """One body of the literature, perhaps with parameters replaced."""

    source: Literal["preset"]
    """Use one named body."""
    name: Preset
    """GH: the body of Garcia and Hubbard (1988); KL: that of Kane and Levinson (1982)."""
    overrides: Overrides = Field(default_factory=lambda: Overrides())
    """Parameters that replace the preset's."""
    c: parameter("c") = None


class TableSource(Surfaced):
    """Bodies from the rows of a table, in its order."""

    source: Literal["table"]
    """Read bodies from a table."""
    path: str = Field(min_length=1, pattern=NO_NUL)
    """CSV or Parquet file, or a directory of Parquet files, with a body in each row."""
    c: parameter("c") = None


class GridBase(Overrides):
    """The body whose parameters are varied: a preset, six parameters, or a shell-dumbbell body."""

    preset: Preset | None = None
    """GH: the body of Garcia and Hubbard (1988); KL: that of Kane and Levinson (1982)."""
    f_sd: parameter("f_sd") = None

    def _clashes(self) -> Clash:
        yield from super()._clashes()
        inertia = {"f_sd"} if self.f_sd is not None else {"alpha", "beta"}
        wanted = set() if self.preset else inertia | {"gamma", "theta", "phi", "xi"}
        if more := sorted(self.given().keys() - wanted):
            yield more[0], "goes with neither preset nor f_sd; leave it out"
        if missing := [name for name in PARAMETERS if name in wanted - self.given().keys()]:
            yield "", f"{', '.join(missing)} missing; give preset, or alpha beta gamma theta phi xi"


def axis(name: str) -> Any:
    """Return the type of an axis of a body parameter."""
    words = Field(description=PARAMETERS[name].meaning)
    return Annotated[several(number(name)) | None, words]


class Axes(Base):
    """Parameters that vary: every combination is a body, and the first one varies slowest."""

    alpha: axis("alpha") = None
    beta: axis("beta") = None
    gamma: axis("gamma") = None
    f_sd: axis("f_sd") = None
    theta: axis("theta") = None
    phi: axis("phi") = None
    xi: axis("xi") = None
    xi_deg: axis("xi_deg") = None
    minus_xi_deg: axis("minus_xi_deg") = None
    c: axis("c") = None

    def _clashes(self) -> Clash:
        if not self.given():
            yield "", "no parameter varies; give at least one axis"
        yield from self._one_of("xi", "xi_deg", "minus_xi_deg", needed=False)

    def given(self) -> dict[str, list[float]]:
        """Return the axes that are given."""
        return {name: values for name, values in self if values is not None}


class Refine(Base):
    """A coarse grid first, then, level by level, only what lies between runs that differ."""

    levels: int = Field(default=4, ge=1, le=16)
    """Halvings from the coarse grid to the values of the axes and the spins."""
    by: Literal["type", "t_r", "n_end", "t_end", "n_steps", "energy_drift", "n_departure",
                "amp_growth", "lyapunov", "contact_ratio_max", "n_turns"] = "type"  # fmt: skip
    """What must not differ within a cell: type, and perhaps a column of numbers."""
    tol: float = Field(default=0.05, gt=0, lt=1)
    """How far a number may lie off the line through its neighbours, relative."""


class GridSource(Surfaced):
    """Every combination of some parameters' values, the others fixed."""

    source: Literal["grid"]
    """Vary parameters over a grid."""
    base: GridBase
    """The body whose parameters are varied."""
    axes: Axes
    """Which parameters vary, over which values."""
    refine: Refine | None = None
    """Leave out runs between others of one type; null: every combination is run."""
    c: axis("c") = None

    def _clashes(self) -> Clash:
        yield from super()._clashes()
        for name in {"alpha", "beta", "f_sd"} & self.axes.given().keys():
            if (self.base.f_sd is None) == (name == "f_sd"):
                yield "axes", f"{name} cannot vary over this base; f_sd stands for alpha and beta"
        if self.c and self.axes.c is not None:
            yield "c", "c is an axis of axes too; keep one of them"
        if self.c and len(self.c) > 1 and self.refine:
            yield "c", "refine takes the axes of axes alone; write axes: {c: ...}"

    @property
    def has_c(self) -> bool:
        """Whether a vertical semi-axis is given, or the preset has one."""
        return bool(self.c or self.axes.c) or self.base.preset in ELLIPSOIDS

    @property
    def varying(self) -> dict[str, list[float]]:
        """The values of each axis in their order, `c` behind the others where it is one."""
        own = {} if self.c is None or len(self.c) == 1 else {"c": self.c}
        return self.axes.given() | own


def size(kind: str, most: float = math.inf) -> Any:
    """Return the type of a size, or of a range of sizes, in SI units or as texts with a unit."""
    least = -most if kind == "angle" else 0
    return interval(measured(Annotated[float, Field(gt=least, lt=most)], kind))


class ShapeSource(Base):
    """Bodies of a simple shape, which have a size; drawn from the keys that are ranges."""

    source: Literal["shape"]
    """Make bodies of a shape, with a size."""
    shape: Literal["half_ellipsoid"] = "half_ellipsoid"
    """half_ellipsoid: solid and of uniform density, its flat side up."""
    length: size("length")
    """Longer side of the flat face, in m or with a unit."""
    width: size("length")
    """Shorter side of the flat face, in m or with a unit."""
    height: size("length")
    """From the lowest point to the flat face, in m or with a unit."""
    mass: size("mass")
    """Mass, in kg or with a unit."""
    skew: size("angle", math.pi / 2)
    """Size of the angle between the axes of inertia and surface, in radians or with a unit."""
    samples: int | None = Field(default=None, ge=1, le=2**62)
    """Bodies per case where a key is a range (1000 unless given)."""

    ellipsoidal: ClassVar[bool] = True  # its bottom is one

    def _clashes(self) -> Clash:
        if self.samples is not None and not self.drawn:
            yield "samples", "no key is a range, so all bodies are alike; leave it out"

    @property
    def sizes(self) -> dict[str, list[float]]:
        """The range of each key in SI units."""
        return {name: getattr(self, name) for name in ("length", "width", "height", "mass", "skew")}

    @property
    def drawn(self) -> list[str]:
        """Names of the keys that are drawn from a range."""
        return [name for name, (low, high) in self.sizes.items() if low < high]


SOURCES = {"sd": SdSource, "preset": PresetSource, "table": TableSource, "grid": GridSource,
           "shape": ShapeSource}  # fmt: skip
Bodies = Annotated[
    SdSource | PresetSource | TableSource | GridSource | ShapeSource, Field(discriminator="source")
]


class Spin(Base):
    """How bodies are launched. Every n_i is combined with every omega_xy0."""

    n_i: several(measured(Unsigned, "spin"))
    """Initial spins in sqrt(g/a), or with a unit; positive is the unsteady direction, negative the
    steady, and 0 a tap, which needs horizon.t."""
    omega_xy0: several(measured(Oscillation, "spin"))
    """Initial sizes of the oscillation's angular velocity in sqrt(g/a), or with a unit."""
    psi: or_word(Annotated[float, Field(ge=-360, le=360)], "relevant", "pitch", "roll") = "relevant"
    """Direction of the oscillation: the pitch or the roll mode, the relevant one (pitch for
    n_i >= 0, roll for n_i < 0), or an angle from the x axis in degrees."""


def unit(u: Sequence[float]) -> list[float]:
    """Return u normalised; raise if it is not a unit vector or does not point upwards."""
    length = math.hypot(*u)
    if not abs(length - 1) <= U_SLACK:
        raise ValueError(f"its length is {length:.6g}; give a unit vector, as [0, 0, -1]")
    if not u[2] < 0:
        raise ValueError(f"u_z is {u[2]:g}; it must be negative, and [0, 0, -1] is upright")
    # A vector that is normalised to rounding keeps its bits.
    return list(u) if abs(length - 1) < 1e-15 else [component / length for component in u]


class State(Base):
    """A full state that all bodies are launched from, in components along the body's axes."""

    omega: Annotated[list[Speed], TRIPLE]
    """Angular velocity [x, y, z] in sqrt(g/a)."""
    u: Annotated[
        list[Annotated[float, Field(ge=-2, le=2)]], TRIPLE, AfterValidator(unit)
    ] = [0, 0, -1]  # fmt: skip
    """Vertical unit vector [x, y, z], upwards; [0, 0, -1] is upright."""

    def _clashes(self) -> Clash:
        if not any(self.omega) and not any(self.u[:2]):
            yield "", "the body stands upright and at rest; give it an angular velocity"


class Horizon(Base):
    """When a run ends that has not reversed. Where several are given, the smallest counts."""

    t_rgh: Time | None = None
    """In units of t_rGH, the reversal time of Garcia and Hubbard in the spin's direction."""
    t: measured(Time, "time") | None = None
    """A time in sqrt(a/g), or with a unit."""
    t_decay: Time | None = None
    """In units of gamma/sigma, in which dissipation.sigma takes an upright spin down to 1/e."""

    def _clashes(self) -> Clash:
        yield from self._one_of("t_rgh", "t", needed=self.t_decay is None, both=True)


class Dissipation(Base):
    """What takes energy from the body; each value is combined with every launch.

    The word `table` stands for the column of that name in a table of bodies.
    """

    sigma: losses(MAX_SIGMA, "torque per spin") = 0.0
    """Torque -sigma omega about the centre of mass, in M a^2 sqrt(g/a), or with a unit."""
    rolling: losses(1, "length") = 0.0
    """Lever of the rolling resistance, in a: its moment over the normal force; or with a unit."""

    def values(self, name: str) -> list[float | None]:
        """Return the values of one of the two in their order; None stands for a table's."""
        value: Any = getattr(self, name)
        return [None] if value == TABLE else value if isinstance(value, list) else [value]

    @property
    def cases(self) -> list[tuple[float | None, float | None]]:
        """Both, in every combination."""
        return list(product(self.values("sigma"), self.values("rolling")))

    @property
    def kind(self) -> Literal["", "viscous", "rolling"]:
        """What some run has: nothing, sigma alone, or a rolling resistance too."""
        if any(self.values("rolling")) or self.rolling == TABLE:
            return "rolling"
        return "viscous" if any(self.values("sigma")) or self.sigma == TABLE else ""

    def __bool__(self) -> bool:
        """Return whether there is any."""
        return bool(self.kind)


class Classify(Base):
    """Thresholds between the types of runs that do not reverse; whether certain ones end early."""

    ss_growth: float = Field(default=1e-3, gt=0)
    """SS if the amplitude of the relevant oscillation never exceeds an earlier one by more than
    this fraction."""
    sw_departure: float = Field(default=0.05, gt=0, lt=1)
    """SW, unless SS, if n/n_i falls below 1 by more than this fraction at some time."""
    early: bool = False
    """Whether a run of the model full ends as soon as it is certain to be SS."""
    dead_energy: float = Field(default=0.01, ge=1e-6, lt=1)
    """With dissipation: D, unless R, if less than this fraction of the launch's energy is left. A
    zero of the spin after that is no reversal, so stored runs keep their dead_energy."""

    @property
    def thresholds(self) -> dict[str, float]:
        """The thresholds between types of stored runs."""
        return self.model_dump(exclude={"early"})

    @property
    def as_text(self) -> str:
        """The thresholds as JSON, as each file of rows tells by which ones it was typed."""
        return json.dumps(self.thresholds, sort_keys=True)


class Stop(Base):
    """When there are enough samples; a case has them when all that is given is met."""

    fraction: float | None = Field(default=None, gt=0, lt=0.5)
    """Half the width of the 95 % interval of every type's share."""
    t_r: float | None = Field(default=None, gt=0, lt=1)
    """Half the width of the 95 % interval of the mean t_r of type R, relative to it."""

    def _clashes(self) -> Clash:
        yield from self._one_of("fraction", "t_r", both=True)


ACCURACIES = {
    "draft": ("dop853", 1e-6),
    "standard": ("dop853", TOL),
    "reference": ("verner98", 1e-12),
}
"""Words for the accuracy of runs, with a method and its tol.

The description of the key `accuracy` has the errors by ``configs/tradeoff.yaml``.
"""


class AccuracyGoal(Base):
    """The error that the results may have."""

    t_r: float = Field(ge=1e-12, le=1e-3)
    """Relative error of the times of reversal; each run is integrated as tightly as that takes."""


class Integrator(Base):
    """How states move: with error control (tol) or in steps of one size (dt)."""

    method: Literal["dop853", "dopri5", "verner98", "rk4"] = "dop853"
    """Name of the method."""
    accuracy: or_word(AccuracyGoal, *ACCURACIES) | None = None
    """A method with its tol, by the median error of t_r: draft: dop853 at tol 1e-06, 1e-07;
    standard: dop853 at tol 1e-09, 9e-11; reference: verner98 at tol 1e-12, 2e-14. Or the error that
    t_r may have, {t_r: 1.0e-6}, which implies record: [error]."""
    tol: float | None = Field(default=None, ge=1e-15, le=1e-2)
    """Error per step relative to the oscillation; for adaptive methods only (default 1e-09)."""
    dt: float | None = Field(default=None, gt=0)
    """Size of a step in sqrt(a/g); for methods of fixed step only (default 0.002)."""
    max_steps: int = Field(default=MAX_STEPS, ge=1, le=2**62)
    """Steps after which a run is given up."""

    @property
    def goal(self) -> float | None:
        """Relative error that t_r may have, if the config asks for one."""
        return self.accuracy.t_r if isinstance(self.accuracy, AccuracyGoal) else None

    @model_validator(mode="before")
    @classmethod
    def _spell_out(cls, data: Any) -> Any:
        """Write method, tol and dt out, so that configs of one meaning are equal."""
        if not isinstance(data, dict):
            return data
        unset = [key for key in ("accuracy", "tol", "dt") if key in data and data[key] is None]
        data = {key: value for key, value in data.items() if key not in unset}
        word, method = data.get("accuracy"), data.get("method", "dop853")
        given = data.keys() & {"method", "tol", "dt"}
        if isinstance(word, str) and word in ACCURACIES and not given:
            del data["accuracy"]
            data["method"], data["tol"] = ACCURACIES[word]
        elif word is None and isinstance(method, str) and method in METHODS:
            adaptive = METHODS[method].adaptive
            data = {("tol" if adaptive else "dt"): (TOL if adaptive else DT)} | data
        return data

    def _clashes(self) -> Clash:
        adaptive = METHODS[self.method].adaptive
        if isinstance(self.accuracy, str):
            word = self.accuracy
            yield "accuracy", f"{word} is a method and its tol; leave out method, tol and dt"
        elif self.accuracy and not adaptive:
            yield "accuracy", f"{self.method} has steps of one size; choose another method"
        elif self.accuracy:
            for key, value in (("tol", self.tol), ("dt", self.dt)):
                if value is not None:
                    yield key, "accuracy stands in its place; keep one of the two"
        elif adaptive and self.dt is not None:
            yield "dt", f"{self.method} chooses its own steps and takes no dt; leave it out"
        elif not adaptive and self.tol is not None:
            yield "tol", f"{self.method} has steps of one size and takes no tol; leave it out"


Record = Literal["energy", "contact", "windows", "lyapunov", "volume", "error", "reversals"]


def _check_name(name: str) -> str:
    if name.strip() in ("", ".", "..") or not name.isprintable() or {"/", "\\"} & {*name}:
        raise ValueError("it is empty, or has a slash or a control character; write a plain word")
    return name


class Config(Base):
    """A sweep: which bodies, launched how, integrated with what, and written where."""

    name: Annotated[str, AfterValidator(_check_name)] = "sweep"
    """Name of the sweep; also of its directory in out/. Unless given, the name of the file."""
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """All draws depend on this, the case and the sample."""
    bodies: Bodies
    """Where parameter sets come from."""
    stop: Stop | None = None
    """When a case has enough samples; null: it gets all of `bodies.samples`."""
    launch: State | None = None
    """The full state that bodies are launched from, instead of a spin."""
    spin: Spin | None = None
    """How bodies are launched; null where launch is given, or a table says it row by row."""
    model: Literal["full", "reduced", "gh"] = "full"
    """full: five variables; reduced: the simplified dynamics, three variables; gh: the closed form
    of Garcia and Hubbard, without integration."""
    horizon: Horizon = Field(default_factory=lambda: Horizon(t_rgh=5.0))
    """When runs end that do not reverse."""
    dissipation: Dissipation = Field(default_factory=lambda: Dissipation())
    """What takes energy from the bodies of the full model."""
    integrator: Integrator = Field(default_factory=lambda: Integrator())
    """How states move."""
    classify: Classify = Field(default_factory=lambda: Classify())
    """Thresholds between types of runs."""
    record: Annotated[list[Record], AfterValidator(no_repeats)] = Field(
        default_factory=list, json_schema_extra={"uniqueItems": True}
    )
    """Extra columns; each costs time. With reversals, runs go on to the horizon."""
    output: str | None = Field(default=None, min_length=1, pattern=NO_NUL)
    """Directory; null: out/<name>."""

    _places: Places = PrivateAttr(default_factory=Places)

    @model_validator(mode="after")
    def _order_record(self) -> Self:
        """Put the words of `record` in order, with those that are implied."""
        found = {*self.record, *(["error"] if self.integrator.goal else [])}
        self.__dict__["record"] = [name for name in get_args(Record) if name in found]
        return self

    @property
    def parts(self) -> list[str]:
        """Parts of the columns of `runs` that not every sweep has."""
        own = {
            "tol": self.integrator.goal is not None,
            "surface": self.bodies.ellipsoidal,
            "dissipation": bool(self.dissipation),
        }
        return [*self.record, *(name for name, there in own.items() if there)]

    @property
    def in_si(self) -> dict[str, list[Quantity]]:
        """Values with units, by the names of what they stand for in a run."""
        given = {
            **({"n_i": self.spin.n_i, "omega_xy0": self.spin.omega_xy0} if self.spin else {}),
            **{name: self.dissipation.values(name) for name in Dissipation.model_fields},
            "t_end": [self.horizon.t],
        }
        found = {k: [x for x in v if isinstance(x, Quantity)] for k, v in given.items()}
        return {name: values for name, values in found.items() if values}

    @property
    def directory(self) -> str:
        """Where results go: `output`, or the default made from the name."""
        return self.output or f"out/{self.name}"

    def line(self, key: Key, message: str) -> str:
        """Return ``file:line: key: message``, without the file for Python data."""
        return self._places.line(key, message)

    @contextmanager
    def locating(self) -> Iterator[None]:
        """Put file and line before messages of a ConfigError that begin with a dotted key."""
        try:
            yield
        except ConfigError as error:
            raise ConfigError(map(self._located, error.messages)) from None

    def _located(self, line: str) -> str:
        name, _, message = line.partition(": ")
        key = tuple(int(part) if part.isdigit() else part for part in re.findall(r"\w+", name))
        if not key or dotted(key) != name or key[0] not in type(self).model_fields:
            return line
        return self.line(key, message)


def clashes(sections: Mapping[str, Any]) -> Clash:
    """Yield what does not go together between sections; one with mistakes of its own is missing."""
    stop, bodies, spin, launch, model, horizon, lost, integrator, classify, record = (
        # False is no section, and is not None, which stands for one that is not given.
        sections.get(name, False)
        for name in ("stop", "bodies", "spin", "launch", "model", "horizon", "dissipation",
                     "integrator", "classify", "record")
    )  # fmt: skip
    table, random = bodies and bodies.source == "table", bool(getattr(bodies, "drawn", ()))
    goal, early = integrator and integrator.goal, classify and classify.early
    if stop and bodies and not random:
        yield "stop", f"bodies of source {bodies.source} are all there are; take source: sd"
    elif stop and getattr(bodies, "draw", "") == "saltelli":
        yield "stop", "samples of draw: saltelli are not independent; take draw: sobol"
    if spin and launch:
        yield "spin", "spin and launch are both given; keep one of them"
    elif spin is None and launch is None and bodies and not table:
        yield "spin", "the key is missing; give n_i and omega_xy0, or a launch with omega and u"
    lists: dict[str, Sequence[Any]] = {}
    target = bodies.target if isinstance(bodies, SdSource) else None
    lists["targets"] = target.values if target else [0]
    lists |= {"n_i": spin.n_i, "omega_xy0": spin.omega_xy0} if spin else {}
    lists |= {name: lost.values(name) for name in Dissipation.model_fields} if lost else {}
    if (cases := math.prod(map(len, lists.values()))) > MAX_CASES:
        yield "spin", f"{cases} cases ({' x '.join(lists)}); at most {MAX_CASES} are possible"
    if bodies and not table and lost is not False:
        for name in Dissipation.model_fields:
            if getattr(lost, name) == TABLE:
                yield "dissipation", f"{name} is that of a table, and there is none; give a number"
        if horizon and horizon.t_decay and not any(lost.values("sigma")):
            yield "dissipation", "horizon.t_decay is in units of gamma/sigma; give sigma"
    if lost and model and model != "full":
        yield "dissipation", f"the model {model} conserves energy; take model: full"
    if goal and model == "gh":
        yield "integrator", "the model gh is a closed form without error; leave accuracy out"
    if early and model and model != "full":
        yield "classify", f"early is for the model full and not for {model}; leave it out"
    special = lost or (bodies and bodies.ellipsoidal)
    if early and special:
        yield "classify", "early is for paraboloids without dissipation; leave it out"
    if record and "lyapunov" in record and special:
        yield "record", "lyapunov is for paraboloids without dissipation; leave it out"
    if record and "reversals" in record and (goal or "error" in record):
        what = "integrator.accuracy of t_r" if goal else "error"
        yield "record", f"{what} is for the first reversal alone; leave it or reversals out"
    for word in {"lyapunov", "volume", "reversals"}.intersection(record or () if early else ()):
        yield "record", f"classify.early ends runs before their horizon; leave it or {word} out"
