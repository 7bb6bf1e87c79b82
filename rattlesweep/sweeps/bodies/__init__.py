"""Bodies of runs, and the interface of sources of bodies."""

from dataclasses import dataclass, field
from typing import Any, Protocol

import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import Floats, Integers
from rattlesweep.physics.si import Units


@dataclass(frozen=True)
class Bodies:
    """Bodies of some runs, with the launches, horizons and dissipation that a table
    gives.

    Where these are None, and where `t_end` is NaN, the config applies.  `f_sd` is NaN
    unless the body is a shell-dumbbell, `c` is NaN for a paraboloid.  `carried` has
    further columns of runs.
    """

    alpha: Floats
    beta: Floats
    gamma: Floats
    theta: Floats
    phi: Floats
    xi: Floats
    f_sd: Floats
    c: Floats | None = None
    n_i: Floats | None = None
    omega_xy0: Floats | None = None
    psi: Floats | None = None
    t_end: Floats | None = None
    omega: Floats | None = None
    u: Floats | None = None
    sigma: Floats | None = None
    rolling: Floats | None = None
    units: Units | None = None
    carried: dict[str, NDArray[Any]] = field(default_factory=dict)


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
