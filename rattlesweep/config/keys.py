"""Keys of a config: how they are declared, and the numbers that many of them take."""

from contextlib import suppress
from typing import Annotated, Any, ClassVar

import pydantic
from pydantic import Field

from rattlesweep.words.quantities import (
    MAX_TIME,
    QUANTITIES,
)

MAX_CASES = 100_000
FROM_TABLE = "table"  # stands for values that the rows of a table give
OF_SLIDES = "mu"  # stands for a creep with the friction of slides
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
Gamma = Annotated[float, _within("gamma")]
Theta = Annotated[float, _within("theta")]
Phi = Annotated[float, _within("phi")]
ShellShare = Annotated[float, _within("f_sd")]
