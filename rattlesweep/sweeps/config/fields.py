"""The kinds of values that configs are made of: numbers with limits, lists, closed intervals."""

import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema
from pydantic_core import PydanticCustomError

from rattlesweep.sweeps.config.yamlfile import is_number


class Base(BaseModel):
    """Frozen, strict and closed: what a config does not know, it does not swallow."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, validate_default=False
    )


class Limits(NamedTuple):
    """The open interval a body parameter lives in, and the same in words."""

    low: float
    high: float
    words: str


MAX_SPEED = 1e6
"""Of spins and oscillations, in sqrt(g/a): 5e6 turns a second of a body of 1 cm."""

LIMITS = {
    "alpha": Limits(1, 1e6, "1 < beta < alpha < 1e6"),
    "beta": Limits(1, 1e6, "1 < beta < alpha < 1e6"),
    "gamma": Limits(0, 1e6, "0 < gamma < 1e6"),
    "theta": Limits(0, 1, "0 < phi < theta < 1"),
    "phi": Limits(0, 1, "0 < phi < theta < 1"),
    "xi": Limits(-math.pi / 2, 0, "-pi/2 < xi < 0"),
    "xi_deg": Limits(-90, 0, "-90 < xi_deg < 0"),
    "minus_xi_deg": Limits(0, 90, "0 < minus_xi_deg < 90"),
    "f_sd": Limits(0, 0.5, "0 < f_sd < 0.5"),
}

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


def limit_problem(name: str, value: float, what: str = "") -> str | None:
    """Why `value` is no value of the body parameter `name`; None if it is one."""
    limits = LIMITS[name]
    subject = f"{what} {value:g}".strip()
    if value >= limits.high:
        return f"{subject} is not below {limits.high:.6g}; {name} must satisfy {limits.words}"
    if value <= limits.low:
        return f"{subject} is not above {limits.low:.6g}; {name} must satisfy {limits.words}"
    return None


def _limited(name: str) -> Callable[[float], float]:
    def check(value: float) -> float:
        if problem := limit_problem(name, value):
            raise ValueError(problem)
        return value

    return check


def _limit_schema(name: str) -> dict[str, Any]:
    limits = LIMITS[name]
    return {
        "type": "number",
        "exclusiveMinimum": limits.low,
        "exclusiveMaximum": limits.high,
    }


def _parameter(name: str) -> Any:
    return (
        AfterValidator(_limited(name)),
        WithJsonSchema(_limit_schema(name)),
        Field(description=DESCRIPTIONS[name]),
    )


Alpha = Annotated[float, *_parameter("alpha")]
Beta = Annotated[float, *_parameter("beta")]
Gamma = Annotated[float, *_parameter("gamma")]
Theta = Annotated[float, *_parameter("theta")]
Phi = Annotated[float, *_parameter("phi")]
Xi = Annotated[float, *_parameter("xi")]
XiDeg = Annotated[float, *_parameter("xi_deg")]
FSd = Annotated[float, *_parameter("f_sd")]


def _as_list(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return [value]
    if isinstance(value, dict) and ("linspace" in value or "logspace" in value):
        from rattlesweep.sweeps.config.grid import spaced  # it imports this module

        return spaced(value)
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


def _positive(values: list[float]) -> list[float]:
    for value in values:
        if value <= 0:
            raise ValueError(f"{value:g} is not above 0; every value must be positive")
    return values


def _slow(values: list[float]) -> list[float]:
    for value in values:
        if not abs(value) <= MAX_SPEED:
            raise ValueError(f"{value:g} is faster than any body turns; at most {MAX_SPEED:g}")
    return values


def _nonzero(values: list[float]) -> list[float]:
    if 0 in values:
        raise ValueError("the spin 0 has no direction; every n_i must be positive or negative")
    return values


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
    Numbers, AfterValidator(_positive), WithJsonSchema(number_list_schema(exclusiveMinimum=0))
]
SpinNumbers = Annotated[
    Numbers,
    AfterValidator(_nonzero),
    AfterValidator(_slow),
    WithJsonSchema(
        number_list_schema(minimum=-MAX_SPEED, maximum=MAX_SPEED, **{"not": {"const": 0}})
    ),
]
OscillationNumbers = Annotated[
    Numbers,
    AfterValidator(_positive),
    AfterValidator(_slow),
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
            if problem := limit_problem(name, value, what):
                raise ValueError(problem)
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
    return "~word" if isinstance(value, str) and not is_number(value) else "~number"
