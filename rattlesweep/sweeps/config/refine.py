"""Which runs of a grid may be left out."""

from typing import Literal

from pydantic import Field

from rattlesweep.sweeps.config.fields import Base


class Refine(Base):
    """A coarse grid first, then, level by level, only what lies between runs that differ."""

    levels: int = Field(default=4, ge=1, le=16)
    """Halvings from the coarse grid, every 2^levels-th value, to the finest, which the axes and the
    spins are; fewer along axes of few values."""
    by: Literal["type", "t_r", "n_end", "t_end", "n_steps", "energy_drift", "n_departure",
                "amp_growth", "lyapunov", "contact_ratio_max", "n_reversals"] = "type"  # fmt: skip
    """What must not differ within a cell: type, or besides it a column with numbers, such as t_r,
    which must not bend there."""
    tol: float = Field(default=0.05, gt=0, lt=1)
    """How far a number may lie off the line through its neighbours, relative; not for type."""
