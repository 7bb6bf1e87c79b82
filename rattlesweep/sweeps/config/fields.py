"""The kinds of values that configs are made of: numbers with limits, lists, closed intervals."""

import math
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import PydanticCustomError

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


def _whole_n(ends: list[float]) -> list[float]:
    if len(ends) != 3:
        raise ValueError(f"three numbers are wanted, [low, high, n], and not {len(ends)}")
    if ends[2] != int(ends[2]) or not 1 <= ends[2] <= MAX_AXIS:
        raise ValueError(f"n is {ends[2]:g}; it must be a whole number from 1 to {MAX_AXIS}")
    return ends


def _of_one_sign(ends: list[float]) -> list[float]:
    low, high, _ = ends
    if low == 0 or not 0 < high / low < math.inf:
        raise ValueError(
            f"no constant ratio leads from {low:g} to {high:g}; "
            "both ends must have the same sign and neither be 0"
        )
    return ends


_ENDS: Any = Field(
    description="[low, high, n]: n values between and including low and high.",
    json_schema_extra={"minItems": 3, "maxItems": 3},
)
Ends = Annotated[list[float], AfterValidator(_whole_n)]


class Spaced(Base):
    """Values between two ends that follow a law."""

    @property
    def ends(self) -> tuple[float, float, int]:
        """The first value, the last one, and how many there are."""
        low, high, n = next(iter(self.__dict__.values()))
        return low, high, int(n)

    def between(self, low: float, high: float, share: float) -> float:
        """The value at a share of the way."""
        raise NotImplementedError

    def values(self) -> list[float]:
        """All values, in their order."""
        low, high, n = self.ends
        inner = [self.between(low, high, i / (n - 1)) for i in range(1, n - 1)]
        return [low, *inner, high] if n > 1 else [low]

    @model_validator(mode="after")
    def _differ(self) -> "Spaced":
        low, high, n = self.ends
        if (n == 1) != (low == high):
            raise ValueError(
                f"{n} values from {low:g} to {high:g} cannot be spaced; "
                "give equal ends with n = 1 and different ones with more"
            )
        if n > 1:
            # Values are closest at an end; neighbours closer than this may round to one number.
            second, last = (self.between(low, high, i / (n - 1)) for i in (1, n - 2))
            for one, other in ((low, second), (last, high)):
                if not abs(one - other) > 4 * math.ulp(max(abs(one), abs(other))):
                    raise ValueError(
                        f"{n} values from {low!r} to {high!r} would not all differ; give fewer"
                    )
        return self


class Linspace(Spaced):
    """Evenly spaced values."""

    linspace: Ends = _ENDS

    def between(self, low: float, high: float, share: float) -> float:
        """The value at a share of the way."""
        return low + (high - low) * share


class Logspace(Spaced):
    """Values with a constant ratio; the ends are values, not exponents."""

    logspace: Annotated[Ends, AfterValidator(_of_one_sign)] = _ENDS

    def between(self, low: float, high: float, share: float) -> float:
        """The value at a share of the way."""
        return low * math.pow(high / low, share)


def no_repeats(values: list[Any]) -> list[Any]:
    """The values, if there are any and none stands twice."""
    if not values:
        raise ValueError("the list is empty; give at least one number")
    seen = set()
    for value in values:
        if value in seen:
            raise ValueError(f"{value} is repeated; give each value once")
        seen.add(value)
    return values


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


def _numbers(**item: Any) -> Any:
    """Annotations of a list of distinct numbers that may be one number, or spaced ones."""
    number = {"type": "number", **item}
    ends = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
    spaced = [
        {"type": "object", "properties": {name: ends}, "required": [name],
         "additionalProperties": False}
        for name in ("linspace", "logspace")
    ]  # fmt: skip
    numbers = {"type": "array", "items": number, "minItems": 1, "uniqueItems": True}
    return (
        BeforeValidator(_as_list),
        AfterValidator(no_repeats),
        WithJsonSchema({"anyOf": [number, numbers, *spaced]}),
    )


def _directed(spin: float) -> float:
    if spin == 0:
        raise ValueError("the spin 0 has no direction; every n_i must be positive or negative")
    return spin


Positive = Annotated[float, Field(gt=0)]
PositiveNumbers = Annotated[list[Positive], *_numbers(exclusiveMinimum=0)]
OscillationNumbers = Annotated[
    list[Annotated[Positive, Field(le=MAX_SPEED)]],
    *_numbers(exclusiveMinimum=0, maximum=MAX_SPEED),
]
SpinNumbers = Annotated[
    list[Annotated[float, Field(ge=-MAX_SPEED, le=MAX_SPEED), AfterValidator(_directed)]],
    *_numbers(minimum=-MAX_SPEED, maximum=MAX_SPEED, **{"not": {"const": 0}}),
]


def _ordered(ends: list[float]) -> list[float]:
    if len(ends) != 2:
        raise ValueError(f"a range has two numbers, [low, high], and not {len(ends)}; write both")
    if ends[0] > ends[1]:
        raise ValueError(
            f"the range [{ends[0]:g}, {ends[1]:g}] is reversed; write [{ends[1]:g}, {ends[0]:g}]"
        )
    return ends


def interval(name: str) -> Any:
    """Annotations of a field that holds the range ``[low, high]`` of a body parameter."""
    return (
        AfterValidator(_ordered),
        WithJsonSchema(
            {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
        ),
        Field(description=f"Range [low, high]. {DESCRIPTIONS[name]}"),
    )


def tag_number(value: Any) -> str:
    """Union branch of something that is a word or a number; quoted numbers count as numbers."""
    return "word" if isinstance(value, str) and not is_number(value) else "number"
