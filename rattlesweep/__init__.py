"""Parameter sweeps of rattlebacks: reversal times, types of motion, Parquet tables.

>>> import rattlesweep as rs
>>> gh = rs.Rattleback.gh()
>>> round(rs.modes(gh).K_p, 3)
0.553
"""

# ruff: noqa: F403, F405
from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rattlesweep.api import *

__version__ = "1.0.0"

__all__ = [
    "Branch",
    "ConfigError",
    "ContactPatch",
    "GrowthRates",
    "Modes",
    "Orbit",
    "OutputError",
    "Page",
    "Rattleback",
    "Run",
    "Sweep",
    "Trajectory",
    "Verdict",
    "__version__",
    "bondi_threshold",
    "branch",
    "contact_patch",
    "draw_bodies",
    "export",
    "find_orbits",
    "fit",
    "growth_rates",
    "is_chaotic",
    "load",
    "machine",
    "modes",
    "orbit",
    "replay",
    "reversal_time_gh",
    "show",
    "simulate",
    "sweep",
    "trajectory",
    "verdict",
    "versions",
    "wilson",
]


def __getattr__(name: str) -> object:
    # Imported at first use, as Numba takes half a second, which --help need not wait.
    if name in __all__:
        from rattlesweep import api

        return getattr(api, name)
    raise AttributeError(f"module 'rattlesweep' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
