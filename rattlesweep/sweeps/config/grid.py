"""Bodies on a grid: a base body and the parameters that vary over it."""

import math
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator

from rattlesweep.sweeps.config.bodies import MAX_BODIES, Preset, Skewed
from rattlesweep.sweeps.config.fields import (
    DESCRIPTIONS,
    LIMITS,
    Alpha,
    Base,
    Beta,
    FSd,
    Gamma,
    Linspace,
    Logspace,
    Phi,
    Spaced,
    Theta,
    no_repeats,
)
from rattlesweep.sweeps.config.messages import out_of_range


class PresetBase(Base):
    """Start from a body of the literature."""

    preset: Preset = Field(description="GH: the body of Garcia and Hubbard (1988).")


class ExplicitBase(Skewed):
    """Start from a body given by its six parameters."""

    alpha: Alpha = Field(description=DESCRIPTIONS["alpha"])
    beta: Beta = Field(description=DESCRIPTIONS["beta"])
    gamma: Gamma = Field(description=DESCRIPTIONS["gamma"])
    theta: Theta = Field(description=DESCRIPTIONS["theta"])
    phi: Phi = Field(description=DESCRIPTIONS["phi"])


class ShellDumbbellBase(Skewed):
    """Start from a shell-dumbbell body."""

    gamma: Gamma = Field(description=DESCRIPTIONS["gamma"])
    f_sd: FSd = Field(description=DESCRIPTIONS["f_sd"])
    theta: Theta = Field(description=DESCRIPTIONS["theta"])
    phi: Phi = Field(description=DESCRIPTIONS["phi"])


def _base_kind(base: Any) -> str:
    if not isinstance(base, dict):
        return type(base).__name__ if isinstance(base, Base) else "PresetBase"
    if "f_sd" in base and "alpha" not in base:
        return "ShellDumbbellBase"
    explicit = "preset" not in base and LIMITS.keys() & base.keys()
    return "ExplicitBase" if explicit else "PresetBase"


GridBase = Annotated[
    Annotated[PresetBase, Tag("PresetBase")]
    | Annotated[ExplicitBase, Tag("ExplicitBase")]
    | Annotated[ShellDumbbellBase, Tag("ShellDumbbellBase")],
    Discriminator(_base_kind),
]


def _axis_kind(axis: Any) -> str:
    if isinstance(axis, dict):
        return "Logspace" if "logspace" in axis else "Linspace"
    return type(axis).__name__ if isinstance(axis, Linspace | Logspace) else "list"


Axis = (
    Annotated[
        Annotated[list[float], Tag("list")]
        | Annotated[Linspace, Tag("Linspace")]
        | Annotated[Logspace, Tag("Logspace")],
        Discriminator(_axis_kind),
    ]
    | None
)
Values = list[float] | Spaced


class Axes(Base):
    """Parameters that vary: every combination is a body, and the first one varies slowest."""

    alpha: Axis = Field(default=None, description=DESCRIPTIONS["alpha"])
    beta: Axis = Field(default=None, description=DESCRIPTIONS["beta"])
    gamma: Axis = Field(default=None, description=DESCRIPTIONS["gamma"])
    f_sd: Axis = Field(default=None, description=DESCRIPTIONS["f_sd"])
    theta: Axis = Field(default=None, description=DESCRIPTIONS["theta"])
    phi: Axis = Field(default=None, description=DESCRIPTIONS["phi"])
    xi: Axis = Field(default=None, description=DESCRIPTIONS["xi"])
    xi_deg: Axis = Field(default=None, description=DESCRIPTIONS["xi_deg"])
    minus_xi_deg: Axis = Field(default=None, description=DESCRIPTIONS["minus_xi_deg"])

    @field_validator("*")
    @classmethod
    def _in_limits(cls, axis: Axis, info: ValidationInfo) -> Axis:
        if axis is None or info.field_name is None:
            return axis
        if isinstance(axis, list):
            no_repeats(axis)
        low, high = LIMITS[info.field_name]
        for value in (min(axis), max(axis)) if isinstance(axis, list) else axis.ends[:2]:
            if not low < value < high:
                bound = ("above", low) if value <= low else ("below", high)
                raise ValueError(out_of_range(f"the value {value:g}", *bound))
        return axis

    @model_validator(mode="after")
    def _plausible(self) -> "Axes":
        given = self.given()
        if not given:
            raise ValueError("no parameter varies; give at least one axis")
        angles = [name for name in given if "xi" in name]
        if len(angles) > 1:
            raise ValueError(f"both {' and '.join(angles)} are given; keep one of them")
        bodies = math.prod(
            len(axis) if isinstance(axis, list) else axis.ends[2] for axis in given.values()
        )
        if bodies > MAX_BODIES:
            raise ValueError(f"the grid has {bodies} bodies; at most {MAX_BODIES} are possible")
        return self

    def given(self) -> dict[str, Values]:
        """The axes that are given."""
        axes = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: axis for name, axis in axes.items() if axis is not None}

    def values(self) -> dict[str, list[float]]:
        """The values of each axis that is given."""
        given = self.given().items()
        return {name: axis if isinstance(axis, list) else axis.values() for name, axis in given}


class GridSource(Base):
    """Every combination of some parameters' values, the others fixed."""

    source: Literal["grid"] = Field(description="Vary parameters over a grid.")
    base: GridBase = Field(description="The body whose parameters are varied.")
    axes: Axes = Field(description="Which parameters vary, over which values.")

    @field_validator("axes")
    @classmethod
    def _fit_base(cls, axes: Axes, info: ValidationInfo) -> Axes:
        base = info.data.get("base")
        if base is None:
            return axes
        shell_dumbbell = isinstance(base, ShellDumbbellBase)
        for name in ("alpha", "beta") if shell_dumbbell else ("f_sd",):
            if name in axes.given():
                raise ValueError(
                    f"{name} cannot vary over this base; f_sd is for a shell-dumbbell base, alpha "
                    "and beta are for any other"
                )
        return axes
