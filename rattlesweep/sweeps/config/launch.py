"""A launch from a full state."""

import math
from collections.abc import Sequence

from pydantic import Field, field_validator, model_validator

from rattlesweep.sweeps.config.fields import AngularVelocity, Base, UnitVector

U_SLACK = 1e-3
"""How far the length of a unit vector may be from 1, as digits are typed."""


class State(Base):
    """A full state that all bodies are launched from, in components along the body's axes."""

    omega: AngularVelocity
    """Angular velocity [x, y, z] in sqrt(g/a)."""
    u: UnitVector = Field(default=[0.0, 0.0, -1.0])
    """Vertical unit vector [x, y, z], upwards; [0, 0, -1] is upright."""

    @field_validator("u")
    @classmethod
    def _stands(cls, u: list[float]) -> list[float]:
        return unit(u)

    @model_validator(mode="after")
    def _moves(self) -> "State":
        if not any(self.omega) and not any(self.u[:2]):
            raise ValueError("the body stands upright and at rest; give it an angular velocity")
        return self


def unit(u: Sequence[float]) -> list[float]:
    """A vertical vector of length 1 exactly; one that is none, or no launch's, is refused."""
    length = math.hypot(*u)
    if not abs(length - 1) <= U_SLACK:
        raise ValueError(
            f"its length is {length:.6g}; give a unit vector, such as [0, 0, -1] for upright"
        )
    if not u[2] < 0:
        raise ValueError(
            f"u_z is {u[2]:g}; it must be negative, as the body's z axis points down, and "
            "[0, 0, -1] is upright"
        )
    # One that is so to rounding keeps its bits.
    return list(u) if abs(length - 1) < 1e-15 else [component / length for component in u]
