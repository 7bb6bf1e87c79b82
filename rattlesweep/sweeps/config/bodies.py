"""Where parameter sets come from: drawn at random, a preset, or a table."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from rattlesweep.sweeps.config.fields import (
    DESCRIPTIONS,
    Alpha,
    Base,
    Beta,
    FSd,
    Gamma,
    Phi,
    PositiveNumbers,
    Theta,
    Xi,
    XiDeg,
    interval,
)

Preset = Literal["GH"]
MAX_BODIES = 10**12


class SdRanges(Base):
    """Ranges that shell-dumbbell bodies are drawn from; the paper's Table I unless given."""

    gamma: Annotated[list[Gamma], *interval("gamma")] = Field(default=[5.0, 15.0])
    f_sd: Annotated[list[FSd], *interval("f_sd")] = Field(default=[0.05, 0.15])
    theta: Annotated[list[Theta], *interval("theta")] = Field(default=[0.6, 0.95])
    phi: Annotated[list[Phi], *interval("phi")] = Field(default=[0.01, 0.1], validate_default=True)
    # Drawn from (low, high]: zero may bound the skew angle, but is never drawn.
    minus_xi_deg: Annotated[
        list[Annotated[float, Field(ge=0, lt=90)]], *interval("minus_xi_deg")
    ] = Field(default=[0.0, 6.0])

    @field_validator("minus_xi_deg")
    @classmethod
    def _skewed(cls, minus_xi_deg: list[float]) -> list[float]:
        if minus_xi_deg[1] == 0:
            raise ValueError("the range leaves only xi = 0, which never reverses; raise its end")
        return minus_xi_deg

    @field_validator("phi")
    @classmethod
    def _below_theta(cls, phi: list[float], info: ValidationInfo) -> list[float]:
        theta = info.data.get("theta")
        if theta and phi[1] >= theta[0]:
            raise ValueError(
                f"phi >= theta is possible, as phi goes up to {phi[1]:g} and theta down to "
                f"{theta[0]:g}; the ranges must not meet"
            )
        return phi

    def ends(self) -> list[list[float]]:
        """The ranges in the order of the fields, in which bodies are drawn."""
        return [getattr(self, name) for name in type(self).model_fields]


class Target(Base):
    """Bodies are redrawn until their torque coefficient lies close to one of these values."""

    K_r: PositiveNumbers | None = Field(
        default=None,
        description="Targets of the rolling coefficient K_r, no unit; one case for each.",
    )
    K_p: PositiveNumbers | None = Field(
        default=None,
        description="Targets of the pitching coefficient K_p, no unit; one case for each.",
    )
    rel_tol: float = Field(
        default=1e-3,
        gt=0,
        le=0.5,
        description="Largest relative distance from the target, no unit.",
    )
    max_draws: int = Field(
        default=1_000_000, ge=1, le=2**62, description="Draws after which a sample is given up."
    )

    @model_validator(mode="after")
    def _one_of_two(self) -> "Target":
        if self.K_r is not None and self.K_p is not None:
            raise ValueError("both K_r and K_p are given; keep one of them")
        if self.K_r is None and self.K_p is None:
            raise ValueError("neither K_r nor K_p is given; give one of them")
        return self

    @property
    def name(self) -> Literal["K_r", "K_p"]:
        """The coefficient that is aimed at."""
        return "K_p" if self.K_r is None else "K_r"

    @property
    def values(self) -> list[float]:
        """The values aimed at."""
        return self.K_r or self.K_p or []


class SdSource(Base):
    """Shell-dumbbell bodies, drawn at random from ranges."""

    source: Literal["sd"] = Field(description="Draw shell-dumbbell bodies at random.")
    samples: int = Field(default=1000, ge=1, le=MAX_BODIES, description="Bodies per case.")
    ranges: SdRanges = Field(
        default_factory=lambda: SdRanges(),
        description="Where the parameters are drawn from, uniformly.",
    )
    target: Target | None = Field(
        default=None, description="Keep only bodies with this torque coefficient; null: keep all."
    )


class Skewed(Base):
    """A body whose skew angle may be given in radians or in degrees."""

    xi: Xi | None = Field(default=None, description=DESCRIPTIONS["xi"])
    xi_deg: XiDeg | None = Field(default=None, description=DESCRIPTIONS["xi_deg"])

    needs_skew: ClassVar[bool] = True

    @model_validator(mode="after")
    def _one_angle(self) -> "Skewed":
        if self.xi is not None and self.xi_deg is not None:
            raise ValueError("both xi and xi_deg are given; keep one of them")
        if self.needs_skew and self.xi is None and self.xi_deg is None:
            raise ValueError("neither xi nor xi_deg is given; give one of them")
        return self

    @property
    def xi_radians(self) -> float | None:
        """The skew angle in radians, from whichever of the two is given."""
        return self.xi if self.xi_deg is None else math.radians(self.xi_deg)


class Overrides(Skewed):
    """Parameters that replace those of a preset."""

    alpha: Alpha | None = Field(default=None, description=DESCRIPTIONS["alpha"])
    beta: Beta | None = Field(default=None, description=DESCRIPTIONS["beta"])
    gamma: Gamma | None = Field(default=None, description=DESCRIPTIONS["gamma"])
    theta: Theta | None = Field(default=None, description=DESCRIPTIONS["theta"])
    phi: Phi | None = Field(default=None, description=DESCRIPTIONS["phi"])

    needs_skew: ClassVar[bool] = False

    def given(self) -> dict[str, float]:
        """The parameters that are set, with xi in radians."""
        values = self.model_dump(exclude={"xi_deg"}) | {"xi": self.xi_radians}
        return {name: value for name, value in values.items() if value is not None}


class PresetSource(Base):
    """One body of the literature, perhaps with parameters replaced."""

    source: Literal["preset"] = Field(description="Use one named body.")
    name: Preset = Field(description="GH: the body of Garcia and Hubbard (1988).")
    overrides: Overrides = Field(
        default_factory=lambda: Overrides(), description="Parameters that replace the preset's."
    )


class TableSource(Base):
    """Bodies from the rows of a table, in its order."""

    source: Literal["table"] = Field(description="Read bodies from a table.")
    path: str = Field(
        min_length=1,
        pattern=r"^[^\x00]*$",
        description=(
            "CSV or Parquet file with columns alpha beta gamma theta phi xi (radians), and "
            "optionally n_i omega_xy0 t_end, which replace spin and horizon row by row."
        ),
    )
