"""Bodies and numbers, one or many, as the Python interface takes them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from numbers import Integral
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.physics.body import PARAMETERS, Rattleback

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

Bodies: TypeAlias = "Rattleback | Iterable[Rattleback] | Mapping[str, Any] | pd.DataFrame"
"""One body; a sequence or an array of bodies; or a table with the columns of a table of bodies."""

WANTED = {
    "n_i": "the initial spin must be finite",
    "omega_xy0": "the oscillation must be finite and positive",
    "t_end": "the horizon must be finite and positive",
    "psi": "an angle from -360 to 360 degrees is needed",
}


def body_columns(bodies: Bodies) -> dict[str, Floats]:
    """Parameters of bodies, arrays of one shape, and what else a table of them says.

    The shape is ``()`` of one body, that of an array of bodies, and ``(rows,)`` of a sequence or a
    table.  Refuses what is no body, or cannot exist.
    """
    if isinstance(bodies, Rattleback):
        bodies = np.array(bodies, dtype=object)
    if isinstance(bodies, Mapping) or is_frame(bodies):
        import pandas as pd

        from rattlesweep.sweeps.bodies.table import frame_bodies

        try:
            frame = pd.DataFrame(bodies)
        except ValueError as error:
            raise ConfigError(
                f"bodies: cannot be read as a table ({one_line(str(error))})"
            ) from None
        return frame_bodies(frame).columns
    many: Any = bodies
    if isinstance(many, str) or not isinstance(many, Iterable):
        raise ConfigError(
            f"bodies: {_kind(bodies)} is none; give a Rattleback, a sequence of them, or a "
            f"DataFrame with the columns {' '.join(PARAMETERS)}"
        )
    array = many if isinstance(many, np.ndarray) else None
    flat: list[Any] = list(many if array is None else array.ravel())
    for place, body in enumerate(flat):
        if not isinstance(body, Rattleback):
            raise ConfigError(f"bodies[{place}]: {_kind(body)} is no Rattleback")
    shape = (len(flat),) if array is None else array.shape
    names = (*PARAMETERS, "c") if any(body.c is not None for body in flat) else PARAMETERS
    # None is NaN then.
    return {
        name: np.array([getattr(body, name) for body in flat], float).reshape(shape)
        for name in names
    }


def numbers(name: str, value: Any) -> Floats:
    """An argument as an array; refuses anything but numbers that are what its name wants."""
    from rattlesweep.sweeps.bodies.table import check_value

    wanted = WANTED.get(name, "it must be finite")
    array: Floats | None = None
    with suppress(TypeError, ValueError):
        given = np.asarray(value)
        if given.dtype.kind in "iufO":
            array = given.astype(float)
    if array is None:
        raise ConfigError(f"{name}: {_kind(value)} is no number or array of numbers; {wanted}")
    found = None
    bad = ~np.isfinite(array)
    if name == "psi":
        bad |= np.abs(array) > 360
    if bad.any():
        found = int(np.argmax(bad)), wanted
    elif name != "psi" and (broken := check_value(name, array.ravel())) is not None:
        # Of a rule that is not the limit of what can be computed, the words for Python.
        found = broken[0], broken[1] if "allowed" in broken[1] else wanted
    if found is not None:
        place = np.unravel_index(found[0], array.shape)
        where = f"[{', '.join(map(str, place))}]" if place else ""
        raise ConfigError(f"{name}{where} {array[place]:g}: {found[1]}")
    return array


def full_states(omega: Any, u: Any) -> dict[str, Floats]:
    """Components of full states by the names of their columns."""
    state: dict[str, Floats] = {}
    for name, value in (("omega", omega), ("u", (0.0, 0.0, -1.0) if u is None else u)):
        vectors = numbers(name, value)
        if vectors.shape[-1:] != (3,):
            raise ConfigError(
                f"{name}: a vector has three components, x, y, z; its shape is {vectors.shape}"
            )
        for k, x in enumerate("xyz"):
            state[f"{name}_{x}"] = numbers(f"{name}_{x}", vectors[..., k])
    return state


def broadcast(arrays: Mapping[str, Floats]) -> tuple[dict[str, Floats], tuple[int, ...]]:
    """Columns of bodies and arrays brought to one shape by NumPy's rules, and that shape."""
    try:
        whole = np.broadcast_arrays(*arrays.values())
    except ValueError:
        of_bodies = {"bodies": arrays[PARAMETERS[0]]}
        rest = {name: a for name, a in arrays.items() if name not in (*PARAMETERS, "f_sd", "c")}
        shapes = ", ".join(f"{name} {array.shape}" for name, array in (of_bodies | rest).items())
        raise ConfigError(f"the shapes do not go together: {shapes}") from None
    return dict(zip(arrays, whole, strict=True)), whole[0].shape


def is_frame(value: Any) -> TypeGuard[pd.DataFrame]:
    """Whether something is a DataFrame; whoever has one has loaded pandas, half a second."""
    pandas = sys.modules.get("pandas")
    return pandas is not None and isinstance(value, pandas.DataFrame)


def to_frame(table: pa.Table) -> pd.DataFrame:
    """A table as pandas has it, with units and descriptions of its columns in ``attrs``."""
    frame: pd.DataFrame = table.to_pandas()
    for key, name in (("units", b"unit"), ("descriptions", b"description")):
        frame.attrs[key] = {
            column.name: column.metadata[name].decode()
            for column in table.schema
            if column.metadata and name in column.metadata
        }
    return frame


def check_threads(threads: int | None) -> None:
    """Refuse what is no number of threads."""
    given: Any = threads
    if given is not None and (
        isinstance(given, bool) or not isinstance(given, Integral) or given < 1
    ):
        raise ConfigError(f"threads: {_kind(threads)} is none; give a whole number from 1 on")


def _kind(value: Any) -> str:
    """What a value is, for a sentence."""
    return f"{one_line(repr(value), 40)} ({type(value).__name__})"
