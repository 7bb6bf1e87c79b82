"""Arguments of the Python interface: bodies and numbers, one or many."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from numbers import Integral
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.physics.body import PARAMETERS, PRESETS, Rattleback

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

Bodies: TypeAlias = (
    "Rattleback | str | Iterable[Rattleback | str] | Mapping[str, Any] | pd.DataFrame"
)
"""One body or the name of a preset; a sequence or an array of these; or a table of bodies."""

WANTED = {
    "n_i": "the initial spin must be finite",
    "omega_xy0": "the oscillation must be finite and positive",
    "t_end": "the horizon must be finite and positive",
    "psi": "an angle from -360 to 360 degrees is needed",
    "sigma": "the dissipation must be finite and not negative",
    "rolling": "the dissipation must be finite and not negative",
}


def one_body(body: Any, name: str = "body") -> Rattleback:
    """Return a body, perhaps given by the name of a preset.

    Raises
    ------
    ConfigError
        If it is neither; the sentence begins with `name`.
    """
    if isinstance(body, Rattleback):
        return body
    if isinstance(body, str) and body in PRESETS:
        return PRESETS[body]()
    raise ConfigError(
        f"{name}: {kind_of(body)} is no body; give a Rattleback or a name, {' or '.join(PRESETS)}"
    )


def body_columns(bodies: Bodies) -> dict[str, Floats]:
    """Return the parameters of bodies, arrays of one shape, and what else a table of them says.

    The shape is ``()`` for one body, that of an array of bodies, and ``(rows,)`` for a sequence or
    a table.

    Raises
    ------
    ConfigError
        If it is no body, or one that cannot exist.
    """
    if isinstance(bodies, Rattleback | str):
        bodies = np.array(one_body(bodies, "bodies"), dtype=object)
    if isinstance(bodies, Mapping) or is_frame(bodies):
        import pandas as pd

        from rattlesweep.sweeps.bodies.table import frame_bodies

        try:
            frame = pd.DataFrame(bodies)
        except ValueError as error:
            reason = one_line(str(error))
            raise ConfigError(f"bodies: cannot be read as a table ({reason})") from None
        columns: dict[str, Floats] = frame_bodies(frame).columns
        return columns
    if not isinstance(bodies, Iterable):
        raise ConfigError(
            f"bodies: {kind_of(bodies)} is no body; give a Rattleback, a sequence of them, or a "
            f"DataFrame with the columns {' '.join(PARAMETERS)}"
        )
    array = bodies if isinstance(bodies, np.ndarray) else None
    many = list(bodies) if array is None else list(array.ravel())
    flat = [one_body(body, f"bodies[{place}]") for place, body in enumerate(many)]
    shape = (len(flat),) if array is None else array.shape
    names = (*PARAMETERS, "c") if any(body.c is not None for body in flat) else PARAMETERS
    # None becomes NaN.
    return {
        name: np.array([getattr(body, name) for body in flat], float).reshape(shape)
        for name in names
    }


def numbers(name: str, value: Any) -> Floats:
    """Return an argument as an array.

    Raises
    ------
    ConfigError
        If it is no number or array of numbers, or one of them is none that `name` can be.
    """
    from rattlesweep.sweeps.bodies.table import check_value

    wanted = WANTED.get(name, "it must be finite")
    array: Floats | None = None
    with suppress(TypeError, ValueError):
        given = np.asarray(value)
        if given.dtype.kind in "iufO":
            array = given.astype(float)
    if array is None:
        raise ConfigError(f"{name}: {kind_of(value)} is no number or array of numbers; {wanted}")
    bad = ~np.isfinite(array)
    if name == "psi":
        bad |= np.abs(array) > 360
    broken = None if bad.any() or name == "psi" else check_value(name, array.ravel())
    if bad.any() or broken is not None:
        at, rule = (int(np.argmax(bad)), wanted) if broken is None else broken
        place = np.unravel_index(at, array.shape)
        where = f"[{', '.join(map(str, place))}]" if place else ""
        # The rule of a table says no more than what is wanted, unless it is a limit.
        raise ConfigError(
            f"{name}{where} {array[place]:g}: {rule if 'allowed' in rule else wanted}"
        )
    return array


def number(name: str, value: Any) -> float | None:
    """Return an argument that is one number, or None; refuse anything else."""
    if value is None:
        return None
    array = numbers(name, value)
    if array.shape:
        raise ConfigError(f"{name}: one number is needed, and not an array of shape {array.shape}")
    return float(array)


def check_count(name: str, value: Any, least: int = 1) -> None:
    """Raise a ConfigError if an argument is neither None nor a whole number from `least` on."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if value is not None and not (whole and value >= least):
        raise ConfigError(f"{name}: {kind_of(value)} is no count; give a whole number from {least} "
                          "on")  # fmt: skip


def full_states(omega: Any, u: Any) -> dict[str, Floats]:
    """Return the components of full states by the names of their columns."""
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
    """Bring columns of bodies and arrays to one shape by NumPy's rules; return them and it."""
    try:
        whole = np.broadcast_arrays(*arrays.values())
    except ValueError:
        of_bodies = {"bodies": arrays[PARAMETERS[0]]}
        rest = {name: a for name, a in arrays.items() if name not in (*PARAMETERS, "f_sd", "c")}
        shapes = ", ".join(f"{name} {array.shape}" for name, array in (of_bodies | rest).items())
        raise ConfigError(f"the shapes do not go together: {shapes}") from None
    return dict(zip(arrays, whole, strict=True)), whole[0].shape


def is_frame(value: Any) -> TypeGuard[pd.DataFrame]:
    """Tell whether something is a DataFrame, without importing pandas, which takes long."""
    pandas = sys.modules.get("pandas")
    return pandas is not None and isinstance(value, pandas.DataFrame)


def to_frame(table: pa.Table) -> pd.DataFrame:
    """Return a table as pandas has it, with units and descriptions of its columns in ``attrs``."""
    frame: pd.DataFrame = table.to_pandas()
    for key, name in (("units", b"unit"), ("descriptions", b"description")):
        frame.attrs[key] = {
            column.name: column.metadata[name].decode()
            for column in table.schema
            if column.metadata and name in column.metadata
        }
    return frame


def kind_of(value: Any) -> str:
    """Return a value and its type for a sentence."""
    return f"{one_line(repr(value), 40)} ({type(value).__name__})"
