"""Types of arrays over runs, and rows of dataclasses that hold such arrays."""

from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Places = NDArray[np.intp]
Flags = NDArray[np.bool_]

T = TypeVar("T")


def take(values: T, rows: NDArray[Any]) -> T:
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
    return cast("T", taken)


def put(values: T, into: T, rows: NDArray[Any]) -> None:
    """Write the arrays of a dataclass into some rows of another one of its type."""
    for field in fields(values):  # type: ignore[arg-type]
        target = getattr(into, field.name)
        if isinstance(target, np.ndarray) and len(target):
            target[rows] = getattr(values, field.name)


def scatter(values: T, rows: Flags) -> T:
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
    return cast("T", replace(cast("Any", values), **wide))
