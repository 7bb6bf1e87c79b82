"""The interface of sources of bodies."""

from typing import Protocol

import pyarrow as pa

from rattlesweep.arrays import Floats, Integers
from rattlesweep.rows.prepared import Bodies


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
