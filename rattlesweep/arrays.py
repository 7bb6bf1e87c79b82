"""Arrays over runs: their types, and dataclasses of them, of which rows are taken and put back."""

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
    """Return some rows of a dataclass of arrays over runs; what was not recorded stays so."""
    found: Any = values
    if isinstance(values, np.ndarray):
        found = values[rows] if len(values) else values
    elif isinstance(values, dict):
        found = {name: take(part, rows) for name, part in values.items()}
    elif is_dataclass(values):
        parts = {part.name: take(getattr(values, part.name), rows) for part in fields(values)}
        found = cast("Any", type(values))(**parts)
    return cast("T", found)


def put(values: T, into: T, rows: NDArray[Any]) -> None:
    """Write rows of one dataclass of arrays into those places of another of its kind."""
    for part in fields(values):  # type: ignore[arg-type]
        here = getattr(into, part.name)
        if isinstance(here, np.ndarray) and len(here):
            here[rows] = getattr(values, part.name)
