"""Types of arrays over runs, and rows of dataclasses that hold such arrays."""

from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from rattlesweep.words.errors import ConfigError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Places = NDArray[np.intp]
Flags = NDArray[np.bool_]
EXACT_WHOLE = 2**53  # whole numbers up to this are exact as floats

_T = TypeVar("_T")


def with_plain_numbers(record: object) -> None:
    """Turn NumPy's numbers in a frozen dataclass into Python's, as it is made.

    They have the same values, and their `repr` is a number alone.
    """
    for each in fields(cast(Any, record)):
        value = getattr(record, each.name)
        if isinstance(value, np.generic):
            object.__setattr__(record, each.name, value.item())


def take(values: _T, rows: NDArray[Any]) -> _T:
    """Return some rows of an array, or of each array in a dict or dataclass.

    An array without rows holds what was not recorded, and stays so.
    """
    taken: object = values
    if isinstance(values, np.ndarray):
        if len(values):
            taken = values[rows]
    elif isinstance(values, dict):
        taken = {name: take(value, rows) for name, value in values.items()}
    elif is_dataclass(values) and not isinstance(values, type):
        columns = {
            field.name: take(getattr(values, field.name), rows)
            for field in fields(values)
        }
        taken = replace(values, **columns)
    return cast("_T", taken)


def unmasked(name: str, values: _T) -> _T:
    """Return a masked array without its mask, or refuse it; others stay as they are.

    NumPy's functions drop a mask, and with it what the caller meant to leave out.  The
    message begins with the `name` of the argument.
    """
    if not isinstance(values, np.ma.MaskedArray):
        return values
    masked = np.ma.getmaskarray(values)
    if masked.any():
        place = np.argwhere(masked)[0].tolist()
        index = f"{place}" if place else ""
        raise ConfigError(
            f"{name}{index} is masked; give a number there, or leave the entry out, as "
            "with .compressed()"
        )
    return cast("_T", values.data)


def refuse_foreign_units(name: str, value: object) -> None:
    """Refuse arrays of other libraries whose unit NumPy would drop without a word."""
    unit = getattr(value, "unit", getattr(value, "units", None))
    if isinstance(value, np.ndarray) and unit is not None:
        raise ConfigError(
            f"{name}: an array in {unit} ({type(value).__name__}) is not understood; "
            "give texts such as '60 rpm', or quantities of Pint"
        )


def put(values: _T, into: _T, rows: NDArray[Any]) -> None:
    """Write the arrays of a dataclass into some rows of another one of its type."""
    for field in fields(values):  # type: ignore[arg-type]
        target = getattr(into, field.name)
        if isinstance(target, np.ndarray) and len(target):
            target[rows] = getattr(values, field.name)


def spread(values: _T, rows: Flags) -> _T:
    """Return a dataclass whose arrays have a place for each of `rows`.

    Those that are true get the entries of `values` in order, the others NaN or 0.
    """
    count = int(rows.sum())
    wide: dict[str, NDArray[Any]] = {}
    for field in fields(values):  # type: ignore[arg-type]
        array = getattr(values, field.name)
        # What was not recorded has no rows.
        if not isinstance(array, np.ndarray) or len(array) != count:
            continue
        fill = np.nan if array.dtype.kind == "f" else 0
        wide[field.name] = np.full((len(rows), *array.shape[1:]), fill, array.dtype)
        wide[field.name][rows] = array
    return cast("_T", replace(cast("Any", values), **wide))
