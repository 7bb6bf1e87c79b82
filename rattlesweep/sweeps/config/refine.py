"""Which runs of a grid may be left out."""

from pydantic import Field, field_validator

from rattlesweep.sweeps.config.fields import Base
from rattlesweep.sweeps.config.messages import not_one_of

REFINED_BY = ("type", "t_r", "n_end", "t_end", "n_steps", "energy_drift", "n_departure",
              "amp_growth", "lyapunov", "contact_ratio_max", "n_reversals")  # fmt: skip


class Refine(Base):
    """A coarse grid first, then, level by level, only what lies between runs that differ."""

    levels: int = Field(default=4, ge=1, le=16)
    """Halvings from the coarse grid, every 2^levels-th value, to the finest, which the axes and the
    spins are; fewer along axes of few values."""
    by: str = "type"
    """What must not differ within a cell: type, or besides it a column with numbers, such as t_r,
    which must not bend there."""
    tol: float = Field(default=0.05, gt=0, lt=1)
    """How far a number may lie off the line through its neighbours, relative; not for type."""

    @field_validator("by")
    @classmethod
    def _is_a_column(cls, by: str) -> str:
        if by not in REFINED_BY:
            raise ValueError(not_one_of(by, REFINED_BY))
        return by
