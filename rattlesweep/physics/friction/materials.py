"""Elastic constants of the materials that rattlebacks and tables are made of.

They are typical values at room temperature; a print, a resin or a piece of wood may
differ from them by half.  This module imports nothing heavy, so that ``--help`` is
fast.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Material:
    """An isotropic elastic solid: Young's modulus `E` in Pa and Poisson's ratio `nu`.

    `source` says where both come from.
    """

    E: float
    nu: float
    source: str = ""


MATERIALS = {
    "PLA": Material(3.5e9, 0.36, "Farah et al., Adv. Drug Deliv. Rev. 107, 367 (2016)"),
    "ABS": Material(2.0e9, 0.40, "1.1 to 2.9 GPa: Ashby, Materials Selection"),
    "resin": Material(2.8e9, 0.35, "cured resin for printers, data sheets; nu assumed"),
    "acrylic": Material(3.0e9, 0.39, "2.2 to 3.8 GPa: Ashby, Materials Selection"),
    "wood": Material(1.0e9, 0.30, "across the grain, 0.4 to 2 GPa: Wood Handbook, 5"),
    "glass": Material(70e9, 0.22, "soda-lime glass: EN 572-1 (E), ASTM E1300 (nu)"),
    "steel": Material(210e9, 0.30, "EN 1993-1-1, section 3.2.6"),
    "aluminium": Material(70e9, 0.30, "EN 1999-1-1, section 3.2.5"),
    "brass": Material(97e9, 0.34, "Callister, Materials Science and Eng., Tab. 6.1"),
    "stone": Material(59e9, 0.26, "granite: Wyllie, Foundations on Rock, Tab. 3.1"),
}  # fmt: skip
"""The materials by name."""


def contact_modulus(body: Material, plane: Material) -> float:
    """Return Hertz's modulus ``E*`` of two materials in Pa.

    ``1/E* = (1 - nu_1^2)/E_1 + (1 - nu_2^2)/E_2``.
    """
    compliances = ((1 - each.nu**2) / each.E for each in (body, plane))
    return 1 / sum(compliances)
