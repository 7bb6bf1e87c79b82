"""Arguments of the Python interface: bodies and numbers, one or many, with units or without."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from numbers import Integral
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.physics.body import PARAMETERS, PRESETS, Rattleback
from rattlesweep.physics.si import GRAVITY, Units
from rattlesweep.units import quantity

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from rattlesweep.sweeps.bodies.protocol import Scale
    from rattlesweep.sweeps.bodies.table import TableBodies

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
UNITS = {
    "spin": "sqrt(g/a)", "time": "sqrt(a/g)", "length": "a", "energy": "M g a",
    "torque per spin": "M a^2 sqrt(g/a)",
}  # fmt: skip
"""Units of the quantities that may be given in SI units, by their kind."""
ENDINGS = {
    "spin": "rad_s", "time": "s", "length": "m", "energy": "J", "torque per spin": "N_m_s",
}  # fmt: skip
KINDS = {
    "n": "spin", "n_i": "spin", "omega_xy0": "spin", "omega": "spin", "t_end": "time",
    "from_time": "time", "dt": "time", "times": "time", "sigma": "torque per spin",
    "rolling": "length", "e_p0": "energy", "e_r0": "energy",
}  # fmt: skip
"""Arguments that may be given in SI units, and their kinds."""
SIZE = ("mass_kg", "height_m", "gravity_m_s2")
"""Columns that tell the size of bodies."""
RPM = 30 / np.pi


# -- bodies ------------------------------------------------------------------------------------


def one_body(body: Any, name: str = "body") -> Rattleback:
    """Return a body, perhaps given by the name of a preset, or raise a ConfigError."""
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
    a table.  If the size of all of them is known, it is in the columns `SIZE`.
    """
    if isinstance(bodies, Rattleback | str):
        bodies = np.array(one_body(bodies, "bodies"), dtype=object)
    if isinstance(bodies, Mapping) or is_frame(bodies):
        import pandas as pd

        from rattlesweep.sweeps.bodies.table import frame_bodies

        try:
            found = frame_bodies(pd.DataFrame(bodies))
        except ConfigError:
            raise
        except ValueError as error:
            reason = one_line(str(error))
            raise ConfigError(f"bodies: cannot be read as a table ({reason})") from None
        return found.columns | {name: found.carried[name] for name in SIZE if name in found.carried}
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
    columns = {name: [getattr(body, name) for body in flat] for name in names}
    sizes = [body.units for body in flat if body.units is not None]
    if flat and len(sizes) == len(flat):
        for name, part in zip(SIZE, ("mass", "length", "gravity"), strict=True):
            columns[name] = [getattr(units, part) for units in sizes]
    return {  # None becomes NaN
        name: np.array(values, float).reshape(shape) for name, values in columns.items()
    }


def table_bodies(columns: Mapping[str, Floats]) -> TableBodies:
    """Return the bodies of columns, with seconds in their runs if their size is known."""
    from rattlesweep.sweeps.bodies.table import KEPT, TableBodies
    from rattlesweep.sweeps.columns import F64, MEASURED, required

    size = {name: columns[name] for name in SIZE if name in columns}
    rest = {name: values for name, values in columns.items() if name not in size}
    if (scale := column_scale(columns)) is None:
        return TableBodies(rest)
    fields = [required(name, F64, KEPT[name], "of the body") for name in size]
    return TableBodies(rest, scale, size, (*fields, *MEASURED))


# -- units -------------------------------------------------------------------------------------


def scale_of(units: Units | None) -> Scale | None:
    """Return the units of a body as a scale, None if its size is not known."""
    from rattlesweep.sweeps.bodies.protocol import Scale

    if units is None:
        return None
    return Scale(*map(np.asarray, (units.mass, units.length, units.gravity)))


def column_scale(columns: Mapping[str, Any]) -> Scale | None:
    """Return the units of bodies that the columns `SIZE` tell, None if they do not."""
    from rattlesweep.sweeps.bodies.protocol import Scale

    if "height_m" not in columns:
        return None
    length = np.asarray(columns["height_m"], float)
    mass, gravity = (
        np.broadcast_to(np.asarray(columns.get(name, default), float), length.shape)
        for name, default in (("mass_kg", np.nan), ("gravity_m_s2", GRAVITY))
    )
    return Scale(mass, length, gravity)


def to_si(runs: Any) -> Any:
    """Return runs in SI units, if the size of their bodies is known.

    Parameters
    ----------
    runs : Run or pandas.DataFrame
        A result of :func:`simulate`, or runs of a sweep of bodies with ``height_m`` and
        ``mass_kg``.

    Returns
    -------
    dict or pandas.DataFrame
        The columns that have units, by names that end in theirs: ``t_r_s``, ``n_i_rpm``,
        ``omega_p_rad_s``, ``energy_0_J``, ``sigma_N_m_s``, ``c_m``.

    Raises
    ------
    ConfigError
        If the size is not known.

    Examples
    --------
    >>> import rattlesweep as rs
    >>> run = rs.simulate("KL", n_i="-60 rpm", omega_xy0="5 rpm", t_end="20 s")
    >>> round(rs.to_si(run)["n_i_rpm"], 9), run.t_r is None, round(rs.to_si(run)["t_end_s"], 9)
    (-60.0, True, 20.0)
    """
    import pandas as pd

    many = is_frame(runs)
    frame: Any = runs if many else pd.DataFrame([runs.to_dict()])
    units = runs.attrs.get("units", {}) if many else runs.units
    scale = column_scale(frame)
    if scale is None:
        raise ConfigError("runs: their bodies have no size; make them by Rattleback.from_si, kl or "
                          "half_ellipsoid, or give the columns mass_kg and height_m")  # fmt: skip
    found: dict[str, Any] = {}
    for name, values in frame.items():
        kind = next((kind for kind, unit in UNITS.items() if unit == units.get(name)), None)
        if kind is None:
            continue
        rpm = name.startswith("n_") or name == "omega_xy0"
        size = (RPM if rpm else 1.0) / scale.natural(1.0, kind)
        if values.dtype == object:  # lists, or nothing but None
            pairs = zip(values, size, strict=True)
            values = [None if value is None else np.multiply(value, one) for value, one in pairs]
        else:
            values = values * size
        found[f"{name}_{'rpm' if rpm else ENDINGS[kind]}"] = values
    if many:
        return pd.DataFrame(found, index=frame.index)
    return {name: np.asarray(values[0]).tolist() for name, values in found.items()}


# -- numbers -----------------------------------------------------------------------------------


def numbers(name: str, value: Any, scale: Scale | None = None) -> Floats:
    """Return an argument as an array in the units of the bodies.

    Raises
    ------
    ConfigError
        If it is no number, text with a unit, or array of these, or is not what `name` can be.
    """
    from rattlesweep.sweeps.bodies.table import check_value

    wanted = WANTED.get(name, "it must be finite")
    array = _floats(name, value, scale)
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
        told = rule if "allowed" in rule else wanted
        raise ConfigError(f"{name}{where} {array[place]:g}: {told}")
    return array


def _floats(name: str, value: Any, scale: Scale | None) -> Floats | None:
    """Return numbers and texts with units in the units of the bodies, None if there are others."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "iuf":
        return value.astype(float)
    try:
        given = np.array(value, dtype=object)  # not as texts, which numbers beside them may be
        flat = given.ravel().tolist()
        texts = {one for one in flat if isinstance(one, str)} if name in KINDS else set()
        if any(isinstance(one, bool) or (isinstance(one, str) and not texts) for one in flat):
            return None
        found: dict[Any, float] = {text: _in_si(name, text, scale) for text in texts}
        array = np.array([found.get(one, one) for one in flat], float).reshape(given.shape)
    except ConfigError:
        raise
    except (TypeError, ValueError):
        return None
    if scale is None or not texts:
        return array
    is_text = np.array([isinstance(one, str) for one in flat]).reshape(given.shape)
    return np.asarray(np.where(is_text, scale.natural(array, KINDS[name]), array))


def _in_si(name: str, text: str, scale: Scale | None) -> float:
    try:
        found = quantity(text, KINDS[name])
    except ValueError as error:
        raise ConfigError(f"{name}: {one_line(repr(text))} {error}") from None
    if scale is None:
        raise ConfigError(
            f"{name}: {text!r} has a unit, but the body has no size; give it one (KL, from_si, "
            f"half_ellipsoid, --mass and --height), or a number in {UNITS[KINDS[name]]}"
        )
    return found


def number(name: str, value: Any, scale: Scale | None = None) -> float | None:
    """Return an argument that is one number, or None; refuse anything else."""
    if value is None:
        return None
    array = numbers(name, value, scale)
    if array.shape:
        raise ConfigError(f"{name}: one number is needed, and not an array of shape {array.shape}")
    return float(array)


def check_count(name: str, value: Any, least: int = 1) -> None:
    """Raise a ConfigError if an argument is neither None nor a whole number from `least` on."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if value is not None and not (whole and value >= least):
        raise ConfigError(f"{name}: {kind_of(value)} is no count; give a whole number from {least} "
                          "on")  # fmt: skip


def full_states(omega: Any, u: Any, scale: Scale | None = None) -> dict[str, Floats]:
    """Return the components of full states by the names of their columns."""
    state: dict[str, Floats] = {}
    if scale is not None:
        parts = scale.mass, scale.length, scale.gravity
        scale = type(scale)(*(np.asarray(part)[..., None] for part in parts))
    for name, value in (("omega", omega), ("u", (0.0, 0.0, -1.0) if u is None else u)):
        vectors = numbers(name, value, scale)
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
        hidden = (*PARAMETERS, *SIZE, "f_sd", "c")
        rest = {name: array for name, array in arrays.items() if name not in hidden}
        shapes = ", ".join(f"{name} {array.shape}" for name, array in (of_bodies | rest).items())
        raise ConfigError(f"the shapes do not go together: {shapes}") from None
    return dict(zip(arrays, whole, strict=True)), whole[0].shape


# -- tables ------------------------------------------------------------------------------------


def is_frame(value: Any) -> TypeGuard[pd.DataFrame]:
    """Tell whether something is a DataFrame, without importing pandas, which takes long."""
    pandas = sys.modules.get("pandas")
    return pandas is not None and isinstance(value, pandas.DataFrame)


def units_of(schema: pa.Schema, key: bytes = b"unit") -> dict[str, str]:
    """Return the units of the columns of a table, or their descriptions."""
    return {f.name: f.metadata[key].decode() for f in schema if key in (f.metadata or {})}


def to_frame(table: pa.Table) -> pd.DataFrame:
    """Return a table as pandas has it, with units and descriptions of its columns in ``attrs``."""
    frame: pd.DataFrame = table.to_pandas()
    frame.attrs["units"] = units_of(table.schema)
    frame.attrs["descriptions"] = units_of(table.schema, b"description")
    return frame


def kind_of(value: Any) -> str:
    """Return a value and its type for a sentence."""
    return f"{one_line(repr(value), 40)} ({type(value).__name__})"
