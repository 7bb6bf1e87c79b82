"""Bodies of runs, and the interface of sources of bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import Floats, Integers
from rattlesweep.physics.si import Units
from rattlesweep.quantities import LOSSES, SURFACE_CONSTANTS


@dataclass(frozen=True)
class Bodies:
    """Bodies of some runs, with the launches, horizons and dissipation that a table
    gives.

    Where these are None or missing, and where `t_end` is NaN, the config applies.
    `f_sd` is NaN unless the body is a shell-dumbbell.
    """

    alpha: Floats
    beta: Floats
    gamma: Floats
    theta: Floats
    phi: Floats
    xi: Floats
    f_sd: Floats
    # Further constants of the surface by name, NaN for a paraboloid.
    further: dict[str, Floats] = field(default_factory=dict)
    n_i: Floats | None = None
    omega_xy0: Floats | None = None
    psi: Floats | None = None
    t_end: Floats | None = None
    omega: Floats | None = None
    u: Floats | None = None
    # Constants of dissipation by name.
    losses: dict[str, Floats] = field(default_factory=dict)
    units: Units | None = None
    # Further columns of runs.
    carried: dict[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def rim(self) -> Floats:
        """Heights of rims in a, NaN without one; no entries if no body has a rim."""
        return self.carried.get("rim", np.zeros(0))

    @classmethod
    def of(cls, columns: Mapping[str, Floats], **others: Any) -> Bodies:
        """Return the bodies of columns, and what else is known of them."""
        known: dict[str, Any] = {
            name: columns[name] for name in columns if name in _COLUMNS
        }
        further = {name: columns[name] for name in SURFACE_CONSTANTS if name in columns}
        losses = {name: columns[name] for name in LOSSES if name in columns}
        return cls(**known, further=further, losses=losses, **others)


_COLUMNS = {each.name for each in fields(Bodies)}


class Source(Protocol):
    """A source of bodies; a pickled copy returns the same bodies in another process."""

    @property
    def samples(self) -> int:
        """Samples of each case."""

    @property
    def fields(self) -> tuple[pa.Field, ...]:
        """Columns that the bodies add to the runs."""

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of samples in any order; `target` is NaN where a run has
        none.
        """
