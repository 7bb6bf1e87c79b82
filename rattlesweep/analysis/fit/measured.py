"""What was measured of a stone with an error, such as ``60 +- 1 g``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from rattlesweep.design.bodies.making import SIZE_KINDS, body_from
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.physics.si import number
from rattlesweep.words.errors import ConfigError, one_line
from rattlesweep.words.quantities import ANGLES, QUANTITIES
from rattlesweep.words.units import InSI, natural, separate_error

# Keys of bodies with a size that may have an error.
_SIZES = (
    "length",
    "width",
    "height",
    "mass",
    "density",
    "skew",
    "weights",
    "wall",
    "axes_angle",
)
# The same of bodies without a size.
NUMBERS = (*PARAMETERS, "c", "f_sd", *ANGLES)


class Prior(NamedTuple):
    """A measured value of a parameter, and its standard error."""

    value: float
    error: float


@dataclass(frozen=True)
class MeasuredBody:
    """A body, the keys and values that it is made from, and the priors of these.

    Priors and numbers of `keys` are in SI units and radians.  A body that is given
    ready-made has no keys.
    """

    body: Rattleback
    keys: Mapping[str, object] = field(default_factory=dict)
    priors: Mapping[str, Prior] = field(default_factory=dict)

    def remade(self, values: Mapping[str, float]) -> Rattleback:
        """Return the body with other values of some keys, or raise a ValueError."""
        in_si = {name: InSI(value) for name, value in values.items()}
        return body_from({**self.keys, **in_si})

    def size(self, name: str) -> float:
        """Return the value of a key in SI units, or raise a ConfigError."""
        value = self.keys.get(name)
        if isinstance(value, int | float | str):
            kind = SIZE_KINDS.get(name, "")
            return number(value, kind, name)
        raise ConfigError(
            f"free: {name} is not among the keys of the body; give its value there"
        )


def separate(
    values: Mapping[str, object],
) -> tuple[dict[str, Any], dict[str, float | str]]:
    """Return values without their errors, and the errors by name.

    Of a text that has an error, a value or an error without a unit becomes a number.
    Other values stay as they are.
    """
    plain: dict[str, Any] = dict(values)
    errors: dict[str, float | str] = {}
    for name, text in values.items():
        if not isinstance(text, str):
            continue
        try:
            measured = separate_error(text)
        except ValueError as reason:
            raise ConfigError(f"{name}: {one_line(repr(text))} {reason}") from None
        if measured is not None:
            value, error = measured
            plain[name] = _number_or_text(value)
            errors[name] = _number_or_text(error)
    return plain, errors


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def measured_body(values: Mapping[str, object]) -> MeasuredBody:
    """Return the body of a mapping as for `body_from`, in which numbers have errors."""
    keys, errors = separate(values)
    body = body_from(keys)
    known = NUMBERS
    if keys.keys() & {"shape", "mesh", "mass"}:
        known = _SIZES
    priors = {}
    for name, error in errors.items():
        if name not in known:
            raise ConfigError(f"{name}: only {', '.join(known)} may have an error")
        kind = SIZE_KINDS.get(name, "")
        try:
            prior = Prior(number(keys[name], kind, name), number(error, kind, name))
        except ValueError as reason:
            raise ConfigError(str(reason)) from None
        if name in ANGLES:
            # As the key ``xi``, which is in radians.
            degree = math.radians(1)
            prior = Prior(ANGLES[name] * degree * prior.value, degree * prior.error)
            del keys[name]
            name = "xi"
            keys[name] = prior.value
        priors[name] = prior
    return MeasuredBody(body, keys, priors)


def of_body(name: str, value: Any) -> Any:
    """Return a parameter in units of the body as a number that knows its unit.

    What is no number, or no quantity, stays as it is.
    """
    if name not in QUANTITIES or not isinstance(value, float):
        return value
    return natural(value, QUANTITIES[name].kind)
