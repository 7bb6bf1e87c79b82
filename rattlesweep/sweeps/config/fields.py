"""The kinds of values that configs are made of: numbers with limits, lists, closed intervals."""

import math
import sys
from collections.abc import Callable
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema
from pydantic_core import PydanticCustomError

from rattlesweep.sweeps.config.messages import out_of_range
from rattlesweep.sweeps.config.yamlfile import is_number


class Base(BaseModel):
    """Frozen, strict and closed: what a config does not know, it does not swallow."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, validate_default=False
    )


MAX_SPEED = 1e6
"""Of spins and oscillations, in sqrt(g/a): 5e6 turns a second of a body of 1 cm."""

LIMITS = {
    "alpha": (1, 1e6),
    "beta": (1, 1e6),
    "gamma": (0, 1e6),
    "theta": (0, 1),
    "phi": (0, 1),
    "xi": (-math.pi / 2, 0),
    "xi_deg": (-90, 0),
    "minus_xi_deg": (0, 90),
    "f_sd": (0, 0.5),
}
"""The open interval each body parameter lives in; how they go together is for `physics.body`."""

DESCRIPTIONS = {
    "alpha": "I_xx / (M a^2) + 1, moment of inertia about the x axis; no unit, above beta.",
    "beta": "I_yy / (M a^2) + 1, moment of inertia about the y axis; no unit, above 1.",
    "gamma": "I_zz / (M a^2), moment of inertia about the spin axis; no unit, above 0.",
    "theta": "The larger principal curvature at the bottom, times a; no unit, phi < theta < 1.",
    "phi": "The smaller principal curvature at the bottom, times a; no unit, 0 < phi < theta.",
    "xi": "Skew angle from inertia to curvature axes in radians; negative, above -pi/2.",
    "xi_deg": "Skew angle from inertia to curvature axes in degrees; negative, above -90.",
    "minus_xi_deg": "Skew angle times -1, in degrees; between 0 and 90.",
    "f_sd": "I_yy / I_zz of a shell-dumbbell body; no unit, between 0 and 0.5.",
}
"""What each body parameter means. Symbols are those of Kondo and Nakanishi (2017)."""


def check_limits(name: str, value: float, what: str) -> None:
    """Raise ValueError if `value`, which is `what`, is no value of the body parameter `name`."""
    low, high = LIMITS[name]
    if value <= low:
        raise ValueError(out_of_range(f"{what} {value:g}", "above", low))
    if value >= high:
        raise ValueError(out_of_range(f"{what} {value:g}", "below", high))


def _limited(name: str) -> Any:
    low, high = LIMITS[name]
    return Field(gt=low, lt=high)


Alpha = Annotated[float, _limited("alpha")]
Beta = Annotated[float, _limited("beta")]
Gamma = Annotated[float, _limited("gamma")]
Theta = Annotated[float, _limited("theta")]
Phi = Annotated[float, _limited("phi")]
Xi = Annotated[float, _limited("xi")]
XiDeg = Annotated[float, _limited("xi_deg")]
FSd = Annotated[float, _limited("f_sd")]


MAX_AXIS = 10**6
_TOO_CLOSE = "{n:g} values from {low!r} to {high!r} would not all differ; give fewer of them"


def _checked_ends(ends: list[float]) -> list[float]:
    if len(ends) != 3:
        raise ValueError(f"three numbers are wanted, [low, high, n], and not {len(ends)}")
    low, high, n = ends
    if n != int(n) or not 1 <= n <= MAX_AXIS:
        raise ValueError(f"n is {n:g}; it must be a whole number from 1 to {MAX_AXIS}")
    if (n == 1) != (low == high):
        raise ValueError(
            f"{n:g} values from {low:g} to {high:g} cannot be spaced; "
            "give equal ends with n = 1 and different ones with more"
        )
    return ends


def _checked_step(ends: list[float]) -> list[float]:
    low, high, n = ends
    # Neighbours closer than this may round to one number.
    if n > 1 and not abs(high / (n - 1) - low / (n - 1)) > 4 * math.ulp(max(abs(low), abs(high))):
        raise ValueError(_TOO_CLOSE.format(n=n, low=low, high=high))
    return ends


def _checked_ratio(ends: list[float]) -> list[float]:
    low, high, n = ends
    if low == 0 or not 0 < high / low < math.inf:
        raise ValueError(
            f"no constant ratio leads from {low:g} to {high:g}; "
            "both ends must have the same sign and neither be 0"
        )
    if n > 1 and not abs(math.log(high / low)) / (n - 1) > 4 * sys.float_info.epsilon:
        raise ValueError(_TOO_CLOSE.format(n=n, low=low, high=high))
    return ends


_ENDS: Any = Field(
    description="[low, high, n]: n values between and including low and high.",
    json_schema_extra={"minItems": 3, "maxItems": 3},
)
Ends = Annotated[list[float], AfterValidator(_checked_ends)]


class Linspace(Base):
    """Evenly spaced values."""

    linspace: Annotated[Ends, AfterValidator(_checked_step)] = _ENDS

    def values(self) -> list[float]:
        """The values along the axis."""
        low, high, n = self.linspace
        inner = [low + (high - low) * (i / (n - 1)) for i in range(1, int(n) - 1)]
        return [low, *inner, high] if n > 1 else [low]


class Logspace(Base):
    """Values with a constant ratio; the ends are values, not exponents."""

    logspace: Annotated[Ends, AfterValidator(_checked_ratio)] = _ENDS

    def values(self) -> list[float]:
        """The values along the axis."""
        low, high, n = self.logspace
        inner = [low * (high / low) ** (i / (n - 1)) for i in range(1, int(n) - 1)]
        return [low, *inner, high] if n > 1 else [low]


def _as_list(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return [value]
    if isinstance(value, dict) and "logspace" in value:
        return Logspace.model_validate(value).values()
    if isinstance(value, dict) and "linspace" in value:
        return Linspace.model_validate(value).values()
    if not isinstance(value, list):
        raise PydanticCustomError("number_or_list", "a number or a list of numbers is needed")
    return value


def _listed(values: list[float]) -> list[float]:
    if not values:
        raise ValueError("the list is empty; give at least one number")
    no_repeats(values)
    return values


def no_repeats(values: list[Any]) -> None:
    """Raise ValueError if a value stands twice in `values`."""
    seen = set()
    for value in values:
        if value in seen:
            raise ValueError(f"{value} is repeated; give each value once")
        seen.add(value)


def _each(good: Callable[[float], bool], sentence: str) -> AfterValidator:
    """Refuses lists with a value that is not `good`, in a sentence about that value."""

    def check(values: list[float]) -> list[float]:
        for value in values:
            if not good(value):
                raise ValueError(sentence.format(value))
        return values

    return AfterValidator(check)


_POSITIVE = _each(lambda value: value > 0, "{:g} is not above 0; every value must be positive")
_NONZERO = _each(
    lambda value: value != 0,
    "the spin {:g} has no direction; every n_i must be positive or negative",
)
_SLOW = _each(
    lambda value: abs(value) <= MAX_SPEED,
    f"{{:g}} is faster than any body turns; at most {MAX_SPEED:g}",
)


def number_list_schema(**item: Any) -> dict[str, Any]:
    """JSON schema of a number, a list of distinct ones, or numbers spaced like a grid's axis."""
    number = {"type": "number", **item}
    ends = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
    spaced = [
        {"type": "object", "properties": {name: ends}, "required": [name],
         "additionalProperties": False}
        for name in ("linspace", "logspace")
    ]  # fmt: skip
    numbers = {"type": "array", "items": number, "minItems": 1, "uniqueItems": True}
    return {"anyOf": [number, numbers, *spaced]}


Numbers = Annotated[list[float], BeforeValidator(_as_list), AfterValidator(_listed)]
PositiveNumbers = Annotated[
    Numbers, _POSITIVE, WithJsonSchema(number_list_schema(exclusiveMinimum=0))
]
SpinNumbers = Annotated[
    Numbers,
    _NONZERO,
    _SLOW,
    WithJsonSchema(
        number_list_schema(minimum=-MAX_SPEED, maximum=MAX_SPEED, **{"not": {"const": 0}})
    ),
]
OscillationNumbers = Annotated[
    Numbers,
    _POSITIVE,
    _SLOW,
    WithJsonSchema(number_list_schema(exclusiveMinimum=0, maximum=MAX_SPEED)),
]


def _ordered(ends: list[float]) -> list[float]:
    if len(ends) != 2:
        raise ValueError(f"a range has two numbers, [low, high], and not {len(ends)}; write both")
    if ends[0] > ends[1]:
        raise ValueError(
            f"the range [{ends[0]:g}, {ends[1]:g}] is reversed; write [{ends[1]:g}, {ends[0]:g}]"
        )
    return ends


def _within(name: str) -> Callable[[list[float]], list[float]]:
    def check(ends: list[float]) -> list[float]:
        # The skew angle is drawn from (low, high]: zero may bound it, but is never drawn.
        if name == "minus_xi_deg" and ends == [0, 0]:
            raise ValueError("the range leaves only xi = 0, which never reverses; raise its end")
        low_is_open = name == "minus_xi_deg" and ends[0] == 0
        for value, what in zip(ends, ("the lower end", "the upper end"), strict=True):
            if value == 0 and low_is_open:
                continue
            check_limits(name, value, what)
        return ends

    return check


def interval(name: str) -> Any:
    """Annotations of a field that holds the range ``[low, high]`` of a body parameter."""
    return (
        AfterValidator(_ordered),
        AfterValidator(_within(name)),
        WithJsonSchema(
            {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
        ),
        Field(description=f"Range [low, high]. {DESCRIPTIONS[name]}"),
    )


def tag_number(value: Any) -> str:
    """Union branch of something that is a word or a number; quoted numbers count as numbers."""
    return "word" if isinstance(value, str) and not is_number(value) else "number"
