"""Arguments of the Python interface: bodies and numbers, one or many, with or without
units.
"""
# ruff: noqa: D103 - names and types say it

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import astuple
from numbers import Integral
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.physics.body import PARAMETERS, PRESETS, Rattleback
from rattlesweep.physics.si import GRAVITY, Units
from rattlesweep.units import quantity, require_unit

if TYPE_CHECKING:
    import pandas as pd

    from rattlesweep.sweeps.bodies.table import Frame


Bodies: TypeAlias = "Rattleback | str | Iterable[Any] | Mapping[str, Any] | Frame"
"""A body or the name of a preset, a sequence or an array of these, or a table of
bodies.
"""

# The arguments that may be given in SI units, and their kinds.
KINDS = {
    "n": "spin",
    "n_i": "spin",
    "omega_xy0": "spin",
    "omega": "spin",
    "t_end": "time",
    "from_time": "time",
    "dt": "time",
    "times": "time",
    "sigma": "torque per spin",
    "rolling": "length",
    "e_p0": "energy",
    "e_r0": "energy",
}
SIZE = ("mass_kg", "height_m", "gravity_m_s2")  # columns that hold the size of bodies
OF_BODIES = (*PARAMETERS, "c", *SIZE)


def one_body(body: Any, name: str = "body") -> Rattleback:
    from rattlesweep.sweeps.bodies.making import body_from

    if isinstance(body, Rattleback):
        return body
    if isinstance(body, str) and body in PRESETS:
        return body_from({"preset": body})
    raise ConfigError(
        f"{name}: {kind_of(body)} is not a body; give a Rattleback, or GH or KL"
    )


def body_columns(bodies: Bodies) -> dict[str, Floats]:
    """Return the columns of bodies as arrays of one shape, with `SIZE` if all sizes are
    known.
    """
    if isinstance(bodies, Mapping) or is_table(bodies):
        return _table_columns(bodies)
    several = isinstance(bodies, Iterable) and not isinstance(bodies, str)
    given: Any = np.array(list(bodies) if several else bodies, object)  # type: ignore[arg-type]
    labels = [f"bodies[{k}]" for k in range(given.size)] if several else ["bodies"]
    flat = list(map(one_body, given.flat, labels))
    names = (
        (*PARAMETERS, "c") if any(body.c is not None for body in flat) else PARAMETERS
    )
    columns = {name: [getattr(body, name) for body in flat] for name in names}
    sizes = [astuple(body.units) for body in flat if body.units is not None]
    if flat and len(sizes) == len(flat):
        columns |= dict(zip(SIZE, map(list, zip(*sizes, strict=True)), strict=True))
    # The c of a paraboloid, None, becomes NaN.
    return {
        name: np.array(values, float).reshape(given.shape)
        for name, values in columns.items()
    }


def _table_columns(bodies: Mapping[str, Any] | Frame) -> dict[str, Floats]:
    from rattlesweep.sweeps.bodies.table import frame_bodies

    if isinstance(bodies, Mapping):
        import pandas as pd

        try:
            bodies = pd.DataFrame(bodies)
        except ValueError as error:
            raise ConfigError(f"bodies: cannot be read as a table: {error}") from None
    table = frame_bodies(bodies)
    return table.columns | {
        name: table.carried[name] for name in SIZE if name in table.carried
    }


def column_units(columns: Mapping[str, Any]) -> Units | None:
    if "height_m" not in columns:
        return None
    size = (
        columns.get("mass_kg", np.nan),
        columns["height_m"],
        columns.get(SIZE[2], GRAVITY),
    )
    return Units(*(np.asarray(part, float) for part in np.broadcast_arrays(*size)))


def numbers(name: str, value: Any, units: Units | None = None) -> Floats:
    """Return an argument as an array in the units of the bodies, or refuse it."""
    from rattlesweep.sweeps.bodies.table import check_value

    array = _floats(name, value, units)
    broken = check_value("psi_deg" if name == "psi" else name, array.ravel())
    if (bad := ~np.isfinite(array)).any():
        broken = int(np.argmax(bad)), "it must be finite"
    if broken is not None:
        place = np.unravel_index(broken[0], array.shape)
        where = f"[{', '.join(map(str, place))}]" if place else ""
        raise ConfigError(f"{name}{where} {array[place]:g}: {broken[1]}")
    return array


def _floats(name: str, value: Any, units: Units | None) -> Floats:
    if isinstance(value, np.ndarray) and value.dtype.kind in "iuf":
        return value.astype(float)
    given = np.array(
        value, dtype=object
    )  # other types would turn numbers beside texts into texts
    flat = given.ravel().tolist()
    found = []
    for one in flat:
        try:
            if isinstance(one, bool):
                raise TypeError
            found.append(
                quantity(one, KINDS[name]) if isinstance(one, str) else float(one)
            )
        except (KeyError, TypeError, OverflowError):
            raise ConfigError(
                f"{name}: {kind_of(value)} is not a number or an array"
            ) from None
        except ValueError as error:
            raise ConfigError(f"{name}: {kind_of(one)} {error}") from None
    array = np.array(found, float).reshape(given.shape)
    is_text = np.array([isinstance(one, str) for one in flat]).reshape(given.shape)
    if not is_text.any():
        return array
    if units is None:
        raise ConfigError(
            f"{name}: {one_line(str(value))} has a unit, but the body has no size; "
            "give a number, or a body with a size (KL, from_si, half_ellipsoid, "
            "--mass and --height)"
        )
    return np.asarray(np.where(is_text, units.natural(array, KINDS[name]), array))


def require_units(
    values: Mapping[str, Any],
    units: Units | None,
    spelled: Callable[[str], str] = str,
) -> None:
    """Refuse numbers without a unit, which a command or a file gives for a sized body.

    A person who writes ``n_i: 60`` may mean rpm.  The numbers of Python calls are in
    units of the body, as their documentation says.
    """
    if units is None:
        return
    for name, value in values.items():
        # A full state has no form with units.
        if name in KINDS and name != "omega":
            require_unit(spelled(name), value, KINDS[name])


def number(name: str, value: Any, units: Units | None = None) -> float | None:
    if value is None:
        return None
    array = numbers(name, value, units)
    if array.shape:
        raise ConfigError(
            f"{name}: one number is needed, not an array of shape {array.shape}"
        )
    return float(array)


def check_count(name: str, value: Any, least: int = 1) -> None:
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if value is not None and not (whole and least <= int(value) < 2**63):
        raise ConfigError(
            f"{name}: {kind_of(value)} is not a whole number from {least} on"
        )


def check_names(what: str, given: Iterable[str], known: Collection[str]) -> None:
    from rattlesweep.sweeps.config import not_one_of

    for name in given:
        if name not in known:
            raise ConfigError(f"{what}: {not_one_of(name, known)}")


def names_of(what: str, value: str | Iterable[str]) -> list[str]:
    """Return one name or several as a list."""
    names = (
        [value]
        if isinstance(value, str) or not isinstance(value, Iterable)
        else list(value)
    )
    if not all(isinstance(name, str) for name in names):
        raise ConfigError(f"{what}: {kind_of(value)} is not a name or a list of names")
    return names


def full_states(omega: Any, u: Any, units: Units | None = None) -> dict[str, Floats]:
    if units is not None:
        units = Units(*(np.asarray(part)[..., None] for part in vars(units).values()))
    state: dict[str, Floats] = {}
    for name, value in {
        "omega": omega,
        "u": (0.0, 0.0, -1.0) if u is None else u,
    }.items():
        vectors = numbers(name, value, units)
        if vectors.shape[-1:] != (3,):
            raise ConfigError(
                f"{name}: a vector has three components, not shape {vectors.shape}"
            )
        for k, x in enumerate("xyz"):
            state[f"{name}_{x}"] = numbers(f"{name}_{x}", vectors[..., k])
    return state


def broadcast(
    arrays: Mapping[str, Floats],
) -> tuple[dict[str, Floats], tuple[int, ...]]:
    """Broadcast arrays by NumPy's rules, and return them and their shape."""
    try:
        whole = np.broadcast_arrays(*arrays.values())
    except ValueError:
        told = {
            "bodies" if name == "alpha" else name: x.shape for name, x in arrays.items()
        }
        told = {
            name: shape
            for name, shape in told.items()
            if shape and name not in OF_BODIES
        }
        shapes = ", ".join(f"{name} {shape}" for name, shape in told.items())
        advice = "for all combinations, write one as a column, as in [[1], [2]]"
        raise ConfigError(f"the shapes do not broadcast: {shapes}; {advice}") from None
    return dict(zip(arrays, whole, strict=True)), whole[0].shape


def is_table(value: Any) -> TypeGuard[Frame]:
    """Return whether a value is a table of pandas, Polars or Arrow."""
    # All of them hand over their columns by Arrow's protocol, which single columns have
    # too.
    return hasattr(value, "__arrow_c_stream__") and hasattr(value, "columns")


def column_names(table: Frame) -> list[str]:
    """Return the names of the columns of a table."""
    return list(map(str, getattr(table, "column_names", table.columns)))


def is_frame(value: Any) -> TypeGuard[pd.DataFrame]:
    """Return whether a value is a DataFrame, without importing pandas, which is
    slow.
    """
    pandas = sys.modules.get("pandas")
    return pandas is not None and isinstance(value, pandas.DataFrame)


def units_of(schema: Any, key: bytes = b"unit") -> dict[str, str]:
    return {
        f.name: f.metadata[key].decode() for f in schema if key in (f.metadata or {})
    }


def to_frame(table: Any) -> pd.DataFrame:
    """Return an Arrow table as a DataFrame, with its units and descriptions in
    ``attrs``.
    """
    frame: pd.DataFrame = table.to_pandas()
    frame.attrs["units"] = units_of(table.schema)
    frame.attrs["descriptions"] = units_of(table.schema, b"description")
    return frame


def kind_of(value: Any) -> str:
    return f"{one_line(repr(value), 40)} ({type(value).__name__})"
