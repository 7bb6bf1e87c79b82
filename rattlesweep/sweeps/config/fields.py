"""The kinds of values that configs are made of: numbers with limits, lists, spaced values."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    PlainSerializer,
    Tag,
    ValidationInfo,
    field_validator,
)

from rattlesweep.sweeps.config.messages import wrong_kind
from rattlesweep.sweeps.config.yamlfile import is_number


class Base(BaseModel):
    """Frozen, strict and closed: what a config does not know, it does not swallow.

    The text below a field is its description, in the JSON Schema too.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )

    rules: ClassVar[tuple[tuple[str, Callable[[Any], Any], str], ...]] = ()
    """What goes with no value of the keys before it: a key, whether it breaks the rule, and the
    sentence.  Both are given all keys by their names; those that are wrong themselves are False."""

    @field_validator("*")
    @classmethod
    def _goes_with_others(cls, value: Any, info: ValidationInfo) -> Any:
        known = dict.fromkeys(cls.model_fields, False) | info.data | {info.field_name: value}
        for key, breaks, sentence in cls.rules:
            if key == info.field_name and breaks(SimpleNamespace(**known)):
                raise ValueError(sentence.format(**known))
        return value


class Parameter(NamedTuple):
    """The open interval that a body parameter lives in, and what it means."""

    low: float
    high: float
    meaning: str


PARAMETERS = {
    "alpha": Parameter(
        1, 1e6, "I_xx / (M a^2) + 1, moment of inertia about the x axis; no unit, above beta."),
    "beta": Parameter(
        1, 1e6, "I_yy / (M a^2) + 1, moment of inertia about the y axis; no unit, above 1."),
    "gamma": Parameter(
        0, 1e6, "I_zz / (M a^2), moment of inertia about the spin axis; no unit, above 0."),
    "theta": Parameter(
        0, 1, "The larger principal curvature at the bottom, times a; no unit, phi < theta < 1."),
    "phi": Parameter(
        0, 1, "The smaller principal curvature at the bottom, times a; no unit, 0 < phi < theta."),
    "xi": Parameter(-math.pi / 2, 0,
        "Skew angle from inertia to curvature axes in radians; negative, above -pi/2."),
    "xi_deg": Parameter(
        -90, 0, "Skew angle from inertia to curvature axes in degrees; negative, above -90."),
    "minus_xi_deg": Parameter(0, 90, "Skew angle times -1, in degrees; between 0 and 90."),
    "c": Parameter(0, 1e9,
        "Vertical semi-axis of the ellipsoid below, over the height a of the centre of mass; no "
        "unit, above theta."),
    "f_sd": Parameter(0, 0.5, "I_yy / I_zz of a shell-dumbbell body; no unit, between 0 and 0.5."),
}  # fmt: skip
"""Parameters of bodies, in the symbols of Kondo and Nakanishi (2017).

How they go together is for `physics.body`.
"""


def within(name: str) -> Any:
    """Annotation of a number: the limits of a body parameter."""
    return Field(gt=PARAMETERS[name].low, lt=PARAMETERS[name].high)


def parameter(name: str, default: Any = ...) -> Any:
    """A field that holds a body parameter."""
    low, high, meaning = PARAMETERS[name]
    return Field(default=default, gt=low, lt=high, description=meaning)


MAX_SPEED = 1e6
"""Of spins and oscillations, in sqrt(g/a): 5e6 turns a second of a body of 1 cm."""

MAX_TIME = 1e30
"""Of horizons, in sqrt(a/g) or t_rGH: far beyond any run, and sums of so many still are numbers."""

MAX_AXIS = 10**6


_ENDS: Any = Field(
    min_length=3,
    max_length=3,
    description="[low, high, n]: n values between and including low and high.",
)


class Spaced(Base):
    """Values between two ends that follow a law."""

    @property
    def ends(self) -> tuple[float, float, int]:
        """The first value, the last one, and how many there are."""
        low, high, n = next(iter(self.__dict__.values()))
        return low, high, int(n)

    def values(self) -> list[float]:
        """All values, in their order."""
        low, high, n = self.ends
        shares = [i / (n - 1) for i in range(1, n - 1)]
        if isinstance(self, Logspace):
            inner = [low * math.pow(high / low, share) for share in shares]
        else:
            inner = [low + (high - low) * share for share in shares]
        return [low, *inner, high][:n]

    @field_validator("*")
    @classmethod
    def _can_be_spaced(cls, ends: list[float]) -> list[float]:
        low, high, n = ends
        if n != int(n) or not 1 <= n <= MAX_AXIS:
            raise ValueError(f"n is {n:g}; it must be a whole number from 1 to {MAX_AXIS}")
        if cls is Logspace and (low == 0 or not 0 < high / low < math.inf):
            raise ValueError(
                f"no constant ratio leads from {low:g} to {high:g}; "
                "both ends must have the same sign and neither be 0"
            )
        # Neighbours closer than this may round to one number.
        close = abs(high - low) <= 4 * (n - 1) * math.ulp(max(abs(low), abs(high)))
        if low != high if n == 1 else close:
            raise ValueError(
                f"{n:.0f} values from {low!r} to {high!r} cannot be spaced so that all differ; "
                "give fewer, or equal ends with n = 1"
            )
        return ends


class Linspace(Spaced):
    """Evenly spaced values."""

    linspace: list[float] = _ENDS


class Logspace(Spaced):
    """Values with a constant ratio; the ends are values, not exponents."""

    logspace: list[float] = _ENDS


def no_repeats(values: list[Any]) -> list[Any]:
    """The values, if none stands twice."""
    seen = set()
    for value in values:
        if value in seen:
            raise ValueError(f"{value} is repeated; give each value once")
        seen.add(value)
    return values


def _as_list(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return [value]
    if isinstance(value, dict) and value.keys() & {"linspace", "logspace"}:
        return (Logspace if "logspace" in value else Linspace).model_validate(value).values()
    if not isinstance(value, list):
        raise ValueError(wrong_kind(value, "a number or a list of numbers"))
    return value


def several(item: Any) -> Any:
    """Annotations of a list of distinct numbers that may be one number, or spaced ones."""
    many = Annotated[list[item], Field(min_length=1, json_schema_extra={"uniqueItems": True})]
    return (
        Field(min_length=1),
        BeforeValidator(_as_list, json_schema_input_type=item | many | Linspace | Logspace),
        AfterValidator(no_repeats),
    )


TABLE = "table"
"""The word for values that stand in the rows of a table."""


def word_or_number(value: Any) -> str:
    """Tag of a word or of a number; quoted numbers count as numbers."""
    return "word" if isinstance(value, str) and not is_number(value) else "number"


def losses(most: float) -> Any:
    """Type of a number from 0 to a limit, which may be several, or stand in a table."""
    number = Annotated[float, Field(ge=0, le=most)]
    return Annotated[
        Annotated[list[number], *several(number), Tag("number")]
        | Annotated[Literal["table"], Tag("word")],
        Discriminator(word_or_number),
        # One number is itself.
        AfterValidator(lambda x: x[0] if isinstance(x, list) and len(x) == 1 else x),
        PlainSerializer(lambda value: value),
    ]


Positive = Annotated[float, Field(gt=0)]
PositiveNumbers = Annotated[list[Positive], *several(Positive)]
C = Annotated[float, within("c")]
CNumbers = Annotated[list[C], *several(C)]
Oscillation = Annotated[float, Field(gt=0, le=MAX_SPEED)]
OscillationNumbers = Annotated[list[Oscillation], *several(Oscillation)]
Speed = Annotated[float, Field(ge=-MAX_SPEED, le=MAX_SPEED)]
# A zero has no sign.
Spin = Annotated[Speed, AfterValidator(lambda spin: spin + 0.0)]
SpinNumbers = Annotated[list[Spin], *several(Spin)]
AngularVelocity = Annotated[list[Speed], Field(min_length=3, max_length=3)]
UnitVector = Annotated[
    list[Annotated[float, Field(ge=-2, le=2)]], Field(min_length=3, max_length=3)
]


def ordered(ends: list[float]) -> list[float]:
    """The ends of a range, if they are in order."""
    low, high = ends
    if low > high:
        raise ValueError(f"the range [{low:g}, {high:g}] is reversed; write [{high:g}, {low:g}]")
    return ends


ORDERED = AfterValidator(ordered)


def interval(name: str, *default: float) -> Any:
    """A field that holds the range ``[low, high]`` of a body parameter."""
    words = f"Range [low, high]. {PARAMETERS[name].meaning}"
    return Field([*default], min_length=2, max_length=2, description=words, validate_default=True)


def _as_range(value: Any) -> Any:
    one = isinstance(value, int | float) and not isinstance(value, bool)
    return [value, value] if one else value


def number_or_interval() -> Any:
    """Annotations of a field that holds a range, or one value for both of its ends."""
    ends = Annotated[list[float], Field(min_length=2, max_length=2)]
    return (
        Field(min_length=2, max_length=2),
        BeforeValidator(_as_range, json_schema_input_type=float | ends),
        ORDERED,
    )


def check_one(model: BaseModel, *names: str, needed: bool = True, both: bool = False) -> None:
    """Of some keys of a model one must be given, or at most one, or `both` may be."""
    given = [name for name in names if getattr(model, name) is not None]
    if len(given) > 1 and not both:
        raise ValueError(f"both {' and '.join(given)} are given; keep one of them")
    if needed and not given:
        more = ", or both" if both else ""
        raise ValueError(f"neither {' nor '.join(names)} is given; give one of them{more}")
