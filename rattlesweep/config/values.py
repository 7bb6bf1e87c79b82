"""Types of values of a config: numbers with units, words, lists and ranges."""

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    WithJsonSchema,
)
from pydantic_core import CoreSchema, core_schema

from rattlesweep.arrays import Floats
from rattlesweep.physics.si import outside
from rattlesweep.words.errors import not_one_of
from rattlesweep.words.units import (
    KINDS,
    Natural,
    Quantity,
    natural_number,
    quantities,
    split,
    without_unit,
)

_T = TypeVar("_T")
MAX_AXIS = 10**6
_ROUNDING = 2e-15  # relative error of a computed power
NO_UNIT_VECTOR = "u must be a vector of length 1 with u_z below 0, as [0, 0, -1]"
NO_VALUE_SCHEMA: dict[str, object] = {"not": {}}  # the JSON Schema of no value
AT_REST = "the body stands upright and at rest; give it an angular velocity"


def _whole(value: object) -> object:
    """Return floats without a fraction, such as 1e5, as integers."""
    if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
        return int(value)
    return value


Whole = Annotated[int, BeforeValidator(_whole)]
Count = Annotated[int, Field(ge=1, le=2**62), BeforeValidator(_whole)]


@dataclass(frozen=True)
class OneOf:
    """A text that is one of some names."""

    names: Iterable[str]

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.literal_schema(list(self.names))


@dataclass(frozen=True, eq=False)
class OrText:
    """A value of the type `item`, or a text that a function reads or refuses."""

    item: object
    read: Callable[[str], object]
    text: dict[str, object]  # the JSON Schema of the text

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        def validate(
            value: object, item_of: core_schema.ValidatorFunctionWrapHandler
        ) -> object:
            if not isinstance(value, str):
                return item_of(value)
            found = self.read(value)
            if isinstance(found, Natural):
                # It has the limits of a plain number.
                return Natural(item_of(float(found)), found.text)
            return found

        return core_schema.no_info_wrap_validator_function(
            validate,
            handler.generate_schema(self.item),
            serialization=core_schema.plain_serializer_function_ser_schema(as_written),
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, object]:
        other = handler(schema)
        if other == NO_VALUE_SCHEMA:
            return self.text
        return {"anyOf": [other, self.text]}


def as_written(value: object) -> object:
    """Return a value as in a config; quantities with units are their texts."""
    return getattr(value, "text", value)


def quantity_or(
    item: object, kind: str, unit: str, *words: str, is_limited: bool = False
) -> OrText:
    """Return a number in a `unit`, a text with a unit of a kind, or one of `words`.

    A text that `is_limited` has the limits of a size of this kind.
    """
    example = KINDS[kind][1]

    def read(text: str) -> object:
        if text in words:
            return text
        natural = natural_number(text, kind) if unit else None
        if natural is not None:
            return natural
        if split(text)[0] is None:
            raise ValueError(
                f"is not a number; give a number {unit}, or one with a unit, such as "
                f"{example}"
            )
        size = Quantity(text, kind)
        problem = None
        if is_limited:
            problem = outside(size, kind, text)
        if problem is not None:
            raise ValueError(f"is out of range; {problem}")
        return size

    return OrText(item, read, {"type": "string", "examples": [example]})


def size_of(kind: str, is_limited: bool = True, may_be_zero: bool = False) -> OrText:
    """Return a size of a body, a text with a unit; numbers are refused."""

    def refuse(number: float) -> float:
        if may_be_zero and number == 0:
            return number
        raise ValueError(f"{number:g} {without_unit(number, kind, of_size=True)}")

    of_text = quantity_or(float, kind, "", is_limited=is_limited)
    schema = {"type": "number", "const": 0} if may_be_zero else NO_VALUE_SCHEMA
    number = Annotated[float, AfterValidator(refuse), WithJsonSchema(schema)]
    return OrText(number, of_text.read, of_text.text)


def number_or(item: object, *words: str) -> OrText:
    """Return a number, or one of `words`."""

    def read(text: str) -> str:
        if text in words:
            return text
        raise ValueError("is not a number; give one, without a unit")

    return OrText(item, read, {"type": "string", "enum": [*words]})


def one_of(item: object, words: Collection[str]) -> OrText:
    """Return a value of the type `item`, or one of `words`."""

    def read(text: str) -> str:
        if text not in words:
            # The message begins with the value.
            message = not_one_of(text, words)
            raise ValueError(message[message.index(" is not one of ") + 1 :])
        return text

    return OrText(item, read, {"type": "string", "enum": list(words)})


def distinct(values: list[_T]) -> list[_T]:
    """Return a list in which no value is repeated."""
    if len({*values}) < len(values):
        raise ValueError("a value is repeated; give each once")
    return values


def _as_list(value: object) -> object:
    """Return one value, or ``{linspace: [low, high, n]}``, as a list."""
    if isinstance(value, dict):
        return _spaced(value)
    if isinstance(value, list):
        return value
    return [value]


def _spaced(
    value: dict[str, tuple[float | str, float | str, int]],
) -> list[float | str]:
    """Return the values between the ends of a linspace or a logspace."""
    wanted = (
        "write {linspace: [low, high, n]} or {logspace: [low, high, n]}, with ends in "
        f"one unit, of one sign for logspace, and a whole number n up to {MAX_AXIS}"
    )
    laws = {"linspace": _evenly, "logspace": _by_factors}
    try:
        [(law, (low, high, count))] = value.items()
        first, unit = split(str(low))
        last, other_unit = split(str(high))
        whole = 1 <= count <= MAX_AXIS and count == int(count)
        # One value if the ends are equal, else two or more.
        if unit != other_unit or not whole or (count == 1) != (first == last):
            raise ValueError(wanted)
        if first is None or last is None:
            raise ValueError(wanted)
        values = laws[law](first, last, int(count))
    except (TypeError, ValueError, KeyError, OverflowError):
        raise ValueError(wanted) from None
    if not np.isfinite(values).all():
        raise ValueError(wanted)
    if unit:
        return [f"{number!r} {unit}" for number in values]
    return [*values]


def _evenly(low: float, high: float, count: int) -> list[float]:
    """Return evenly spaced numbers, each the nearest to its exact value.

    The ends are the decimals as they are written, so that -0.1 to -0.5 has -0.3, and
    -0.9 to 0.9 has 0: floating-point sums miss these by a rounding error.
    """
    first = Fraction(repr(low))
    last = Fraction(repr(high))
    gaps = max(count - 1, 1)
    step = (last - first) / gaps
    # Over a common denominator, each value is a quotient of whole numbers, which Python
    # rounds correctly.
    below = first.denominator * step.denominator
    start = first.numerator * step.denominator
    more = step.numerator * first.denominator
    return [(start + k * more) / below for k in range(count)]


def _by_factors(low: float, high: float, count: int) -> list[float]:
    """Return numbers spaced by a factor; those that are decimals but for rounding
    errors are these decimals.
    """
    with np.errstate(all="ignore"):
        values = np.geomspace(low, high, count).tolist()
    spaced = []
    for value in values:
        decimal = float(f"{value:.12g}")
        if abs(decimal - value) <= _ROUNDING * abs(value):
            value = decimal
        spaced.append(value)
    return spaced


class _OneOrSeveral:
    """A list that may be given as one item, as a list, or by linspace or logspace."""

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_before_validator_function(_as_list, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, object]:
        several = handler(schema)
        ends = {"type": "array", "minItems": 3, "maxItems": 3}
        ends["items"] = {"anyOf": [{"type": "number"}, {"type": "string"}]}
        spaced = {
            "type": "object",
            "propertyNames": {"enum": ["linspace", "logspace"]},
            "additionalProperties": ends,
        }
        return {"anyOf": [several["items"], several, spaced]}


class _OneOrPair:
    """A range that may be given as one number, for a range of zero width."""

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        def as_pair(value: object) -> object:
            if isinstance(value, list):
                return value
            return [value, value]

        return core_schema.no_info_before_validator_function(as_pair, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, object]:
        pair = handler(schema)
        return {"anyOf": [pair["items"], pair]}


def _rising(ends: list[float]) -> list[float]:
    if ends[0] > ends[1]:
        raise ValueError("the range is reversed; write [low, high]")
    return ends


UNIQUE = Field(json_schema_extra={"uniqueItems": True})
Several = Annotated[
    list[_T], Field(min_length=1), UNIQUE, _OneOrSeveral(), AfterValidator(distinct)
]
"""A list of distinct items, given as one, as a list, or by linspace."""
One = Annotated[_T, Field()]
"""One item."""
TwoOf = Annotated[list[_T], Field(min_length=2, max_length=2)]
Three = Annotated[list[_T], Field(min_length=3, max_length=3)]
Range = Annotated[
    list[_T],
    Field(min_length=2, max_length=2),
    _OneOrPair(),
    AfterValidator(_rising),
]
"""A range [low, high], or one number."""


def pair_of_lengths(value: object) -> object:
    """Return a text such as ``45, -9 mm`` as two texts with units."""
    if not isinstance(value, str):
        return value
    quantities(value, "length", 2)
    first, second = map(str.strip, value.split(","))
    if not split(first)[1]:
        first += f" {split(second)[1]}"
    return [first, second]


def normalised(u: ArrayLike) -> Floats:
    """Return vectors scaled to length 1; NaN for another length and for u_z >= 0."""
    u = np.asarray(u, float)
    length = np.linalg.norm(u, axis=-1, keepdims=True)
    off = np.abs(length - 1)
    # A vector that is normalised to rounding keeps its bits.
    scaled = u / np.where(off < 1e-15, 1, length)
    return np.where((off <= 1e-3) & (u[..., 2:] < 0), scaled, np.nan)


def _unit_vector(u: list[float]) -> list[float]:
    scaled: list[float] = normalised(u).tolist()
    if np.isnan(scaled[0]):
        raise ValueError(NO_UNIT_VECTOR)
    return scaled


Vertical = Annotated[Three[float], AfterValidator(_unit_vector)]
