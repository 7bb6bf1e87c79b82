"""Types of arrays over runs, and rows of dataclasses that hold such arrays."""

from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Places = NDArray[np.intp]
Flags = NDArray[np.bool_]

T = TypeVar("T")


def take(values: T, rows: NDArray[Any]) -> T:
    """Return some rows of an array, or of each array in a dict or dataclass; empty ones
    stay so.
    """
    found: Any = values
    if isinstance(values, np.ndarray):
        found = values[rows] if len(values) else values
    elif isinstance(values, dict):
        found = {name: take(part, rows) for name, part in values.items()}
    elif is_dataclass(values):
        parts = {
            part.name: take(getattr(values, part.name), rows) for part in fields(values)
        }
        found = cast("Any", type(values))(**parts)
    return cast("T", found)


def put(values: T, into: T, rows: NDArray[Any]) -> None:
    """Write the arrays of a dataclass into some rows of another dataclass of its
    type.
    """
    for part in fields(values):  # type: ignore[arg-type]
        target = getattr(into, part.name)
        if isinstance(target, np.ndarray) and len(target):
            target[rows] = getattr(values, part.name)
