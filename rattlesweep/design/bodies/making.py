"""One body from a mapping of keys and values, as in a fit's file or in options."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from inspect import signature
from typing import TypeVar

from rattlesweep.physics.body import PARAMETERS, PRESETS, Rattleback
from rattlesweep.physics.si import Units
from rattlesweep.system.console import joined
from rattlesweep.system.files import as_path
from rattlesweep.words.errors import ConfigError, not_one_of
from rattlesweep.words.quantities import ANGLES
from rattlesweep.words.units import require_unit

_T = TypeVar("_T")
# Kinds of the keys of bodies with a size.
SIZE_KINDS = {
    "mass": "mass",
    "density": "density",
    "weights": "mass",
    "length": "length",
    "width": "length",
    "height": "length",
    "wall": "length",
    "at": "length",
    "radii": "length",
    "c": "length",
    "skew": "angle",
    "axes_angle": "angle",
    "inertia": "moment of inertia",
    "gravity": "acceleration",
}
# The other keys of a mesh.
OF_MESHES = ("unit", "points", "up")
# Keys that choose how a body is made.
WAYS = ("preset", "shape", "mesh", "mass", "f_sd")


def body_from(
    values: Mapping[str, object],
    spelled: Callable[[str], str] = str,
) -> Rattleback:
    """Return the body of a mapping; raise a ConfigError if no body is described.

    Parameters
    ----------
    values : mapping
        ``preset`` and parameters that replace its own; ``shape: half_ellipsoid`` and
        the arguments of :meth:`Rattleback.half_ellipsoid`; ``mesh``, a file, and the
        arguments of :meth:`Rattleback.from_mesh`; ``mass`` and the arguments of
        :meth:`Rattleback.from_si`; ``f_sd`` and those of
        :meth:`Rattleback.shell_dumbbell`; or those of :class:`Rattleback`.  The skew
        angle may be given as ``xi``, ``xi_deg`` or ``minus_xi_deg``.
    spelled : callable
        Returns how messages spell a key, such as an option of a command.
    """
    skew = next((name for name in ANGLES if name in values), "xi")
    values = _with_skew_in_radians(dict(values), spelled)
    way, make = _maker(values)
    # The keys that may be given, and whether they must: the arguments of the function,
    # but for those of a Rattleback that follow from how it is made.
    required = {
        key: parameter.default is parameter.empty
        for key, parameter in signature(make).parameters.items()
        if key not in ("rim", "units", "pose")
    }
    if way == "preset":
        # `Rattleback.replace` takes any names, so its signature tells none.
        required = dict.fromkeys((*PARAMETERS, "c"), False)
    if way == "f_sd":
        # `shell_dumbbell` takes no c; the body gets it afterwards.
        required["c"] = False
    for key in values:
        if key in required:
            continue
        if key in (*SIZE_KINDS, *WAYS, *PARAMETERS, "z_up", *OF_MESHES):
            chosen = "a body by its parameters" if way not in WAYS else spelled(way)
            given = spelled(skew if key == "xi" else key)
            raise ConfigError(
                f"{given} does not go with {chosen}; leave one of them out"
            )
        known = [spelled(each) for each in dict.fromkeys((*required, *WAYS))]
        raise ConfigError(not_one_of(spelled(key), known))
    for key, is_required in required.items():
        if is_required and key not in values:
            sentence = f"{spelled(key)} is missing; add it"
            if make is Rattleback:
                sentence += f", or give {joined([*map(spelled, WAYS)], 'or')}"
            raise ConfigError(sentence)
    if way in ("shape", "mesh", "mass"):
        for key, value in values.items():
            if key == "points":
                require_units_of_points(spelled(key), value)
            if key in SIZE_KINDS:
                require_unit(spelled(key), value, SIZE_KINDS[key], of_size=True)
    semi_axis = None
    if way == "f_sd":
        semi_axis = values.pop("c", None)
    try:
        body = make(**values)
        if semi_axis is not None:
            body = body.replace(c=semi_axis)
    except (TypeError, ValueError) as error:
        raise ConfigError(str(error)) from None
    return body


def _maker(values: dict[str, object]) -> tuple[str, Callable[..., Rattleback]]:
    """Return which of `WAYS` the keys choose, and the function that makes the body.

    Keys that are no arguments of this function are removed from `values`.  Without any
    of `WAYS`, the keys are those of a :class:`Rattleback`.
    """
    if "preset" in values:
        return "preset", preset_of(values.pop("preset"), "preset").replace
    if "shape" in values:
        shape = values.pop("shape")
        if shape != "half_ellipsoid":
            raise ConfigError(f"shape: {not_one_of(shape, ['half_ellipsoid'])}")
        return "shape", Rattleback.half_ellipsoid
    if "mesh" in values:
        path = as_path(values.pop("mesh"), "mesh")
        return "mesh", partial(Rattleback.from_mesh, path)
    if "mass" in values:
        return "mass", Rattleback.from_si
    if "f_sd" in values:
        return "f_sd", Rattleback.shell_dumbbell
    return "parameters", Rattleback


def missing_height(units: Units | None, height: _T | None) -> _T | None:
    """Return the height that a body without a size needs, which others must not have.

    None if the body has a size.
    """
    if units is not None and height is not None:
        raise ConfigError("length: the body has a size already; leave length out")
    if units is None and height is None:
        raise ConfigError(
            "length: the body has no size; give the height of its centre of mass, such "
            "as 1 cm"
        )
    return height


def require_units_of_points(name: str, points: object) -> None:
    """Raise a ConfigError if the mass of a point has no unit.

    Its place has the unit of the mesh.
    """
    for point in points if isinstance(points, list | tuple) else ():
        if isinstance(point, list | tuple) and point:
            require_unit(name, point[0], "mass", of_size=True)


def preset_of(name: object, where: str) -> Rattleback:
    """Return the body of a name; messages of errors begin with `where`."""
    if isinstance(name, str) and name in PRESETS:
        return PRESETS[name]()
    raise ConfigError(f"{where}: {not_one_of(name, PRESETS)}")


def _with_skew_in_radians(
    values: dict[str, object], spelled: Callable[[str], str]
) -> dict[str, object]:
    """Return values with the skew angle as ``xi``, in radians; `values` may change."""
    names = [name for name in ("xi", *ANGLES) if name in values]
    if len(names) > 1:
        listed = " and ".join(map(spelled, names))
        raise ConfigError(f"{listed} exclude each other; keep one")
    for name, sign in ANGLES.items():
        if name in values:
            degrees = values.pop(name)
            if isinstance(degrees, bool) or not isinstance(degrees, int | float):
                raise ConfigError(
                    f"{spelled(name)}: {degrees!r} is not a number; give degrees"
                )
            values["xi"] = sign * math.radians(degrees)
    return values
