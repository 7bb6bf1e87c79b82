"""The patch of contact under a body: its arguments, and what they mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.analysis.contact import ContactPatch, patch_under
from rattlesweep.api.arguments import kind_of, measured_from, one_number
from rattlesweep.physics import si
from rattlesweep.physics.body import Rattleback
from rattlesweep.physics.friction.materials import MATERIALS, Material
from rattlesweep.words.defaults import PATCH_FRICTION, PATCH_SPIN
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.units import require_unit

if TYPE_CHECKING:
    # A name, or E and nu.
    OneMaterial = str | Material | Mapping[str, float | str]

MATERIAL_NAMES = {name.casefold(): name for name in MATERIALS}


def contact_patch(
    body: Rattleback | str | Mapping[str, Any],
    materials: Sequence[OneMaterial],
    *,
    mu: float = PATCH_FRICTION,
    n_i: float | str = PATCH_SPIN,
    facet: float | str | None = None,
) -> ContactPatch:
    """Return Hertz's patch of contact under a body at rest, and the lever of pivoting.

    While a body spins, its patch of contact rubs on the plane, with a torque of the
    weight times the lever ``mu <r>``, where ``<r>`` is the mean radius of the pressure.
    The attribute ``pivot`` has this lever in units of ``a``.

    The theory is that of smooth elastic solids.  It leaves out roughness, wear,
    yielding, the slow flow of plastics and the grain of wood.

    Stability: stable.

    Parameters
    ----------
    body : Rattleback, str or mapping
        A body with a size and a mass, or the keys of one, as for ``fit``.
    materials : two of str, Material or mapping
        Those of the body and of the plane.  Each is one of ``PLA``, ``ABS``, ``resin``,
        ``acrylic``, ``wood``, ``glass``, ``steel``, ``aluminium``, ``brass`` and
        ``stone``, or a mapping such as ``{"E": "3.5 GPa", "nu": 0.36}``, with a plain
        ``E`` in Pa.
    mu : float
        Coefficient of friction.
    n_i : str
        Vertical spin whose end is told.
    facet : str, optional
        Width of the flat facets of a printed bottom, with which a remark compares the
        patch.

    Raises
    ------
    ConfigError
        If the body has no size or mass, or an argument is wrong.

    Examples
    --------
    >>> stone = rs.Rattleback.half_ellipsoid(
    ...     length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg")
    >>> patch = rs.contact_patch(stone, ("PLA", "glass"))
    >>> round(1e6 * patch.long_half_axis), round(1e6 * patch.short_half_axis)
    (462, 76)
    >>> round(1e6 * patch.mean_radius), round(patch.pivot, 4), round(patch.t_spin, 1)
    (180, 0.0072, 9.1)
    """
    stone = _sized(body)
    pair = _pair(materials)
    friction = one_number("mu", mu)
    spin = one_number("n_i", n_i, stone.units)
    if friction is None or spin is None:
        raise ConfigError("mu and n_i: None is given; each must be a number")
    require_unit("facet", facet, "length", of_size=True)
    try:
        width = None
        if facet is not None:
            width = si.size(facet, "length", "facet")
    except ValueError as error:
        raise ConfigError(str(error)) from None
    return patch_under(stone, pair, friction, spin, width)


def _sized(body: Rattleback | str | Mapping[str, Any]) -> Rattleback:
    """Return a body that has a size and a mass, or refuse it."""
    stone = measured_from(body).body
    if stone.units is None or not np.isfinite(stone.units.mass):
        raise ConfigError(
            "body: a patch of contact needs a size and a mass, and this body has none; "
            "give KL, from_si or half_ellipsoid (--mass, --half-ellipsoid)"
        )
    return stone


def _pair(materials: object) -> tuple[Material, Material]:
    """Return the materials of body and plane, or refuse them."""
    if not isinstance(materials, Sequence) or isinstance(materials, str):
        pair: list[object] = []
    else:
        pair = list(materials)
    if len(pair) != 2:
        raise ConfigError(
            f"materials: {kind_of(materials)} is given; two are needed, that of the "
            "body and that of the plane, such as PLA and glass"
        )
    try:
        return _material(pair[0]), _material(pair[1])
    except ValueError as error:
        raise ConfigError(f"materials: {error}") from None


def _material(value: object) -> Material:
    """Return a material by its name or its constants, or raise a ValueError."""
    from rattlesweep.words.errors import not_one_of

    if isinstance(value, Material):
        value = {"E": value.E, "nu": value.nu}
    if not isinstance(value, Mapping):
        name = MATERIAL_NAMES.get(str(value).casefold())
        if name is None:
            raise ValueError(f"{not_one_of(value, MATERIALS)}, or give E and nu")
        return MATERIALS[name]
    for key in value:
        if key not in ("E", "nu"):
            raise ValueError(not_one_of(key, ("E", "nu")))
    for key in ("E", "nu"):
        if key not in value:
            raise ValueError(f"{key} is missing; give E and nu")
    stiffness = si.size(value["E"], "modulus", "E")
    ratio = si.plain("nu", value["nu"], "")
    if not isinstance(ratio, Real) or not -1 < float(ratio) <= 0.5:
        raise ValueError(f"nu is {ratio}; a number above -1 and up to 0.5 is needed")
    return Material(stiffness, float(ratio))
