"""Arguments of the Python interface: bodies and numbers, with or without units."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from numbers import Integral
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard

import numpy as np

from rattlesweep.arrays import EXACT_WHOLE, Floats, refuse_foreign_units, unmasked
from rattlesweep.physics.body import PARAMETERS, PRESETS, Rattleback
from rattlesweep.physics.si import GRAVITY, Units, check_spins
from rattlesweep.words.errors import ConfigError, check_names, one_line
from rattlesweep.words.quantities import (
    ACTING,
    BASE_DIRECTIONS,
    HORIZONTAL,
    QUANTITIES,
)
from rattlesweep.words.units import (
    in_si,
    is_measured,
    natural_number,
    quantity,
    require_unit,
)

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from rattlesweep.analysis.fit.measured import MeasuredBody
    from rattlesweep.design.bodies.table import Frame


BodiesLike: TypeAlias = (
    "Rattleback | str | Iterable[object] | Mapping[str, Any] | Frame"
)
"""A body or the name of a preset, a sequence or array of these, or a table."""

# The arguments that may be given in SI units, and their kinds.
_KINDS = {
    name: QUANTITIES[name].kind
    for name in ("n", "n_i", "omega_xy0", "t_end", "dt", *ACTING, "base_amplitude")
    if QUANTITIES[name].kind
}
_KINDS |= {"omega": "spin", "from_time": "time", "times": "time"}
_KINDS |= {"e_p0": "energy", "e_r0": "energy"}
_KINDS |= {"period": "time", "energy": "energy"}
# Columns that hold the size of bodies, and the height of their rims.
SIZE_COLUMNS = ("mass_kg", "height_m", "gravity_m_s2", "rim")
OF_BODIES = (*PARAMETERS, "c", *SIZE_COLUMNS)


def one_body(body: object, name: str = "body") -> Rattleback:
    """Return a body or the preset of a name, or refuse it."""
    from rattlesweep.design.bodies.making import body_from

    if isinstance(body, Rattleback):
        return body
    if isinstance(body, str) and body in PRESETS:
        return body_from({"preset": body})
    raise ConfigError(
        f"{name}: {kind_of(body)} is not a body; give a Rattleback, or GH or KL"
    )


def measured_from(body: object) -> MeasuredBody:
    """Return a body, or the keys of a stone, with the errors of what was measured."""
    from rattlesweep.analysis.fit.measured import MeasuredBody, measured_body

    if isinstance(body, Mapping):
        return measured_body(body)
    if isinstance(body, MeasuredBody):
        return body
    return MeasuredBody(one_body(body))


def body_columns(bodies: BodiesLike) -> dict[str, Floats]:
    """Return the columns of bodies as arrays of one shape.

    They hold the size of the bodies if it is known for all of them.
    """
    if isinstance(bodies, Mapping) or is_table(bodies):
        return _table_columns(bodies)
    if isinstance(bodies, Iterable) and not isinstance(bodies, str):
        array = np.array(list(bodies), object)
        flat = [one_body(body, f"bodies[{k}]") for k, body in enumerate(array.flat)]
    else:
        array = np.array(bodies, object)
        flat = [one_body(bodies, "bodies")]
    columns = {name: [getattr(body, name) for body in flat] for name in PARAMETERS}
    if any(body.c is not None for body in flat):
        # The c of a paraboloid, None, becomes NaN.
        columns["c"] = [body.c for body in flat]
    if any(body.rim is not None for body in flat):
        # A body without a rim gets NaN.
        columns["rim"] = [body.rim for body in flat]
    units = [body.units for body in flat if body.units is not None]
    if flat and len(units) == len(flat):
        columns["mass_kg"] = [unit.mass for unit in units]
        columns["height_m"] = [unit.length for unit in units]
        columns["gravity_m_s2"] = [unit.gravity for unit in units]
    return {
        name: np.array(values, float).reshape(array.shape)
        for name, values in columns.items()
    }


def _table_columns(bodies: Mapping[str, Any] | Frame) -> dict[str, Floats]:
    from rattlesweep.design.bodies.table import frame_bodies

    if isinstance(bodies, Mapping):
        import pandas as pd

        refuse_units_of_columns("bodies", bodies)
        try:
            bodies = pd.DataFrame(bodies)
        except ValueError as error:
            raise ConfigError(f"bodies: cannot be read as a table: {error}") from None
    table = frame_bodies(bodies)
    sizes = {
        name: table.carried[name] for name in SIZE_COLUMNS if name in table.carried
    }
    return table.columns | sizes


def refuse_units_of_columns(where: str, columns: Mapping[str, Any]) -> None:
    """Refuse columns that are quantities, of which a table would keep the numbers."""
    for name, values in columns.items():
        refuse_foreign_units(f"{where}: {name}", values)
        if is_measured(values):
            raise ConfigError(
                f"{where}: the column {name} is in {values.units}; give numbers, in a "
                "column whose name has the unit, such as n_i_rpm or t_s"
            )


def column_units(columns: Mapping[str, Floats]) -> Units | None:
    """Return the units of bodies whose columns hold their size, None for others."""
    if "height_m" not in columns:
        return None
    mass, height, gravity = np.broadcast_arrays(
        columns.get("mass_kg", np.nan),
        columns["height_m"],
        columns.get("gravity_m_s2", GRAVITY),
    )
    return Units(
        np.asarray(mass, float), np.asarray(height, float), np.asarray(gravity, float)
    )


def numbers(name: str, value: object, units: Units | None = None) -> Floats:
    """Return an argument as an array in the units of the bodies, or refuse it."""
    from rattlesweep.design.bodies.table import check_value

    array = _floats(name, value, units)
    broken = check_value("psi_deg" if name == "psi" else name, array.ravel())
    if units is not None and _KINDS.get(name) == "spin":
        check_spins(name, array, units)
    infinite = ~np.isfinite(array)
    if infinite.any():
        broken = int(np.argmax(infinite)), "it must be finite"
    if broken is not None:
        first, rule = broken
        place = np.unravel_index(first, array.shape)
        index = f"[{', '.join(map(str, place))}]" if place else ""
        raise ConfigError(f"{name}{index} {array[place]:g}: {rule}")
    return array


def _floats(name: str, value: object, units: Units | None) -> Floats:
    """Return numbers, texts with units and quantities of Pint as an array in the units
    of the bodies.
    """
    kind = _KINDS.get(name, "")
    # A full state has no form with units in configs.
    needs_unit = units is not None and kind and name != "omega"
    if is_measured(value):
        in_si_units = _in_si(name, value)
        is_in_si = np.ones(np.shape(in_si_units), bool)
        array = np.asarray(unmasked(name, in_si_units), float)
    else:
        refuse_foreign_units(name, value)
        value = unmasked(name, value)
        if needs_unit:
            require_unit(name, value, kind)
        if isinstance(value, np.ndarray) and value.dtype.kind in "iuf":
            return value.astype(float)
        # Any other type of array would turn the numbers beside a text into texts.
        mixed = np.array(value, dtype=object)
        flat = mixed.ravel().tolist()
        array = np.array([_number(name, value, entry) for entry in flat], float)
        array = array.reshape(mixed.shape)
        have_units = [_is_in_si(each, kind) for each in flat]
        is_in_si = np.array(have_units, bool).reshape(mixed.shape)
    if name == "psi":
        return np.where(is_in_si, np.degrees(array), array)
    if not kind or not is_in_si.any():
        return array
    if units is None:
        raise ConfigError(
            f"{name}: {one_line(str(value))} has a unit, but the body has no size; "
            "give a number, or a body with a size (KL, from_si, half_ellipsoid, "
            "--mass and --height)"
        )
    natural = units.natural(array, kind)
    return np.where(is_in_si, natural, array)


def columns_of_base(base: object, units: Units | None = None) -> dict[str, Floats]:
    """Return the columns of a plane that shakes, in the units of the bodies.

    It is a pair of frequency and acceleration, or a mapping with the keys of a config.
    """
    from rattlesweep.config.clashes import clashes_of_plane
    from rattlesweep.config.schema import Shaking

    if not isinstance(base, Mapping):
        if not isinstance(base, tuple | list) or len(base) != 2:
            raise ConfigError(
                f"base: {kind_of(base)} is given; give (frequency, acceleration), or a "
                "mapping with the keys of a config"
            )
        base = dict(zip(("frequency", "acceleration"), base, strict=True))
    given = {name: value for name, value in base.items() if value is not None}
    check_names("keys of base", given, Shaking.model_fields)
    direction = given.pop("direction", "vertical")
    if direction not in BASE_DIRECTIONS:
        raise ConfigError(
            f"base: direction is {kind_of(direction)}; give vertical or horizontal"
        )
    is_horizontal = direction == HORIZONTAL
    problems = [text for _, text in clashes_of_plane(given, is_horizontal)]
    if "frequency" not in given:
        problems.append("frequency is missing; add it")
    if problems:
        raise ConfigError(f"base: {problem}" for problem in problems)
    frequency = numbers("base_frequency", given["frequency"], units)
    if "amplitude" in given:
        stroke = numbers("base_amplitude", given["amplitude"], units)
        acceleration = stroke * frequency**2
    else:
        acceleration = numbers("base_acceleration", given["acceleration"], units)
    phase = np.radians(numbers("psi", given.get("phase_deg", 0.0)))
    columns = {
        "base_frequency": frequency,
        "base_acceleration": acceleration,
        "base_phase": phase,
    }
    if is_horizontal:
        azimuth = numbers("psi", given.get("azimuth_deg", 0.0))
        columns["base_azimuth"] = np.radians(azimuth)
    return columns


def _is_in_si(entry: object, kind: str) -> bool:
    """Return whether an entry of an argument is read as one in SI units."""
    if isinstance(entry, str):
        return natural_number(entry, kind) is None
    return is_measured(entry)


def _in_si(name: str, value: Any) -> Any:
    """Return the numbers of a quantity of Pint in SI units, or refuse it."""
    try:
        return in_si(value, "angle" if name == "psi" else _KINDS.get(name, ""))
    except ValueError as error:
        raise ConfigError(f"{name}: {one_line(str(value))} {error}") from None


def _number(name: str, value: object, entry: Any) -> float:
    """Return an entry of an argument as a number, in SI units if it is a text."""
    try:
        if isinstance(entry, bool):
            raise TypeError
        if is_measured(entry):
            entry = _in_si(name, entry)
        if isinstance(entry, np.ma.MaskedArray):
            entry = unmasked(name, entry)
        if isinstance(entry, str):
            natural = natural_number(entry, _KINDS[name])
            if natural is not None:
                return natural
            return quantity(entry, _KINDS[name])
        return float(entry)
    except (KeyError, TypeError, OverflowError):
        message = f"{name}: {kind_of(value)} is not a number or an array"
        raise ConfigError(message) from None
    except ConfigError:
        raise
    except ValueError as error:
        raise ConfigError(f"{name}: {kind_of(entry)} {error}") from None


def require_units(
    values: Mapping[str, Any],
    units: Units | None,
    spelled: Callable[[str], str] = str,
) -> None:
    """Refuse numbers without a unit, which a command or a file gives for a sized body.

    The same rule holds for :func:`numbers`; here messages spell the names.
    """
    if units is None:
        return
    for name, value in values.items():
        # A full state has no form with units.
        if name in _KINDS and name != "omega":
            require_unit(spelled(name), value, _KINDS[name])


def one_number(name: str, value: object, units: Units | None = None) -> float | None:
    """Return an argument as one number in the units of the body, or refuse it."""
    if value is None:
        return None
    return only_number(name, numbers(name, value, units))


def only_number(name: str, array: Floats) -> float:
    """Return the number of an array of no dimension, or refuse several."""
    if array.shape:
        raise ConfigError(
            f"{name}: one number is needed, not an array of shape {array.shape}"
        )
    return float(array)


def check_count(name: str, value: object, least: int = 1) -> None:
    """Refuse an argument that is neither None nor a whole number from `least` on."""
    if value is None:
        return
    needed = f"a whole number of at least {least} is needed"
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise ConfigError(f"{name}: {kind_of(value)} is given; {needed}")
    if not least <= int(value) < 2**63:
        raise ConfigError(f"{name}: {one_line(str(value), 30)} is given; {needed}")


def names_of(what: str, value: object) -> list[str]:
    """Return one name or several as a list, or refuse what is not a name."""
    names = [value]
    if isinstance(value, Iterable) and not isinstance(value, str):
        names = list(value)
    texts = [name for name in names if isinstance(name, str)]
    if len(texts) < len(names):
        raise ConfigError(f"{what}: {kind_of(value)} is not a name or a list of names")
    return texts


def full_states(omega: object, u: object, units: Units | None) -> dict[str, Floats]:
    """Return the columns of full states; without `u` the bodies are upright."""
    if u is None:
        u = (0.0, 0.0, -1.0)
    if units is not None:
        # Each size belongs to the three components of a vector.
        units = Units(*(np.asarray(size)[..., None] for size in vars(units).values()))
    state: dict[str, Floats] = {}
    for name, value in (("omega", omega), ("u", u)):
        vectors = numbers(name, value, units)
        if vectors.shape[-1:] != (3,):
            raise ConfigError(
                f"{name}: a vector has three components, not shape {vectors.shape}"
            )
        for k, axis in enumerate("xyz"):
            column = f"{name}_{axis}"
            state[column] = numbers(column, vectors[..., k])
    return state


def broadcast(
    arrays: Mapping[str, Floats],
) -> tuple[dict[str, Floats], tuple[int, ...]]:
    """Broadcast arrays by NumPy's rules, and return them and their shape."""
    try:
        columns = np.broadcast_arrays(*arrays.values())
    except ValueError:
        shapes = {
            name: array.shape
            for name, array in arrays.items()
            if array.shape and name not in OF_BODIES
        }
        if arrays.get("alpha", np.zeros(())).shape:
            shapes = {"bodies": arrays["alpha"].shape, **shapes}
        listed = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise ConfigError(
            f"the shapes do not broadcast: {listed}; for all combinations, write one "
            "as a column, as in [[1], [2]]"
        ) from None
    return dict(zip(arrays, columns, strict=True)), columns[0].shape


def is_table(value: object) -> TypeGuard[Frame]:
    """Return whether a value is a table of pandas, Polars or Arrow."""
    # All hand over their columns by Arrow's protocol, which single columns have, too.
    return hasattr(value, "__arrow_c_stream__") and hasattr(value, "columns")


def column_names(table: Frame) -> list[str]:
    """Return the names of the columns of a table."""
    return list(map(str, getattr(table, "column_names", table.columns)))


def is_frame(value: object) -> TypeGuard[pd.DataFrame]:
    """Return whether a value is a DataFrame, without the slow import of pandas."""
    pandas = sys.modules.get("pandas")
    return pandas is not None and isinstance(value, pandas.DataFrame)


def units_of(schema: pa.Schema, key: bytes = b"unit") -> dict[str, str]:
    """Return the units, or other metadata, of the columns that have them."""
    return {
        field.name: field.metadata[key].decode()
        for field in schema
        if key in (field.metadata or {})
    }


def to_frame(table: pa.Table) -> pd.DataFrame:
    """Return a table as a DataFrame, with units and descriptions in ``attrs``."""
    frame: pd.DataFrame = table.to_pandas()
    for name in _beyond_floats(table):
        import pandas as pd
        import pyarrow as pa

        exact = {pa.int64(): pd.Int64Dtype(), pa.uint64(): pd.UInt64Dtype()}
        frame[name] = table.column(name).to_pandas(types_mapper=exact.get)
    frame.attrs["units"] = units_of(table.schema)
    frame.attrs["descriptions"] = units_of(table.schema, b"description")
    return frame


def _beyond_floats(table: pa.Table) -> list[str]:
    """Return the columns of whole numbers and empty cells that floats would round.

    They are floats in a DataFrame, as these have NaN for an empty cell.
    """
    import pyarrow.compute as pc
    from pyarrow import types

    names = []
    for name, column in zip(table.column_names, table.columns, strict=True):
        if types.is_integer(column.type) and column.null_count:
            ends = pc.min_max(column).as_py()
            if max(-(ends["min"] or 0), ends["max"] or 0) > EXACT_WHOLE:
                names.append(name)
    return names


def kind_of(value: object) -> str:
    """Return a value with its type, as messages name what they refuse."""
    return f"{one_line(repr(value), 40)} ({type(value).__name__})"
