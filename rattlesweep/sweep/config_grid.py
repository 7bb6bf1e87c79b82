"""Bodies on a grid: a base body and the parameters that vary over it."""

import math
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from rattlesweep.sweep.config_bodies import MAX_BODIES, Preset, Skewed
from rattlesweep.sweep.config_errors import problems_of
from rattlesweep.sweep.config_fields import (
    DESCRIPTIONS,
    Alpha,
    Base,
    Beta,
    FSd,
    Gamma,
    Phi,
    Theta,
    limit_problem,
    no_repeats,
)

MAX_AXIS = 10**6


class PresetBase(Base):
    """Start from a body of the literature."""

    preset: Preset = Field(description="GH: the body of Garcia and Hubbard (1988).")


class ExplicitBase(Skewed):
    """Start from a body given by its six parameters."""

    alpha: Alpha
    beta: Beta
    gamma: Gamma
    theta: Theta
    phi: Phi


class ShellDumbbellBase(Skewed):
    """Start from a shell-dumbbell body."""

    gamma: Gamma
    f_sd: FSd
    theta: Theta
    phi: Phi


def _base_kind(base: Any) -> str:
    keys = base.keys() if isinstance(base, dict) else ()
    if isinstance(base, ShellDumbbellBase) or ("f_sd" in keys and "alpha" not in keys):
        return "~shell-dumbbell"
    if isinstance(base, ExplicitBase) or (keys and "preset" not in keys):
        return "~explicit"
    return "~preset"


GridBase = Annotated[
    Annotated[PresetBase, Tag("~preset")]
    | Annotated[ExplicitBase, Tag("~explicit")]
    | Annotated[ShellDumbbellBase, Tag("~shell-dumbbell")],
    Discriminator(_base_kind),
]


def _checked_ends(ends: list[float]) -> list[float]:
    if len(ends) != 3:
        raise ValueError(f"three numbers are wanted, [low, high, n], and not {len(ends)}")
    low, high, n = ends
    if n != int(n) or not 1 <= n <= MAX_AXIS:
        raise ValueError(f"n is {n:g}; it must be a whole number from 1 to {MAX_AXIS}")
    if (n == 1) != (low == high):
        raise ValueError(
            f"{n:g} values from {low:g} to {high:g} cannot be spaced; "
            "give equal ends with n = 1 and different ones with more"
        )
    return ends


def _checked_ratio(ends: list[float]) -> list[float]:
    low, high, _ = ends
    if low == 0 or not 0 < high / low < math.inf:
        raise ValueError(
            f"no constant ratio leads from {low:g} to {high:g}; "
            "both ends must have the same sign and neither be 0"
        )
    return ends


_ENDS: Any = Field(
    description="[low, high, n]: n values between and including low and high.",
    json_schema_extra={"minItems": 3, "maxItems": 3},
)


class Linspace(Base):
    """Evenly spaced values."""

    linspace: Annotated[list[float], AfterValidator(_checked_ends)] = _ENDS

    def values(self) -> list[float]:
        """The values along the axis."""
        low, high, n = self.linspace
        inner = [low + (high - low) * (i / (n - 1)) for i in range(1, int(n) - 1)]
        return [low, *inner, high] if n > 1 else [low]


class Logspace(Base):
    """Values with a constant ratio; the ends are values, not exponents."""

    logspace: Annotated[
        list[float], AfterValidator(_checked_ends), AfterValidator(_checked_ratio)
    ] = _ENDS

    def values(self) -> list[float]:
        """The values along the axis."""
        low, high, n = self.logspace
        inner = [low * (high / low) ** (i / (n - 1)) for i in range(1, int(n) - 1)]
        return [low, *inner, high] if n > 1 else [low]


def spaced(given: dict[str, Any]) -> list[float]:
    """The values of ``{linspace: [low, high, n]}`` or ``{logspace: ...}``.

    Raises
    ------
    ValueError
        It is neither, or its numbers make no axis.
    """
    kind: type[Linspace] | type[Logspace] = Logspace if "logspace" in given else Linspace
    try:
        return kind.model_validate(given).values()
    except ValidationError as error:
        problem = problems_of(error, kind)[0]
        where = ".".join(str(part) for part in problem.key)
        raise ValueError(f"{where}: {problem.message}") from None


def _axis_kind(axis: Any) -> str:
    if isinstance(axis, Logspace) or (isinstance(axis, dict) and "logspace" in axis):
        return "~logspace"
    return "~linspace" if isinstance(axis, dict | Linspace) else "~list"


Axis = (
    Annotated[
        Annotated[list[float], Tag("~list")]
        | Annotated[Linspace, Tag("~linspace")]
        | Annotated[Logspace, Tag("~logspace")],
        Discriminator(_axis_kind),
    ]
    | None
)


def axis_values(axis: list[float] | Linspace | Logspace) -> list[float]:
    """The values along an axis, however it is written."""
    return axis if isinstance(axis, list) else axis.values()


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
        values = axis_values(axis)
        if not values:
            raise ValueError("the list is empty; give at least one number")
        no_repeats(values)
        for value in (min(values), max(values)):
            if problem := limit_problem(info.field_name, value, "the value"):
                raise ValueError(problem)
        return axis

    @model_validator(mode="after")
    def _plausible(self) -> "Axes":
        values = self.values()
        if not values:
            raise ValueError("no parameter varies; give at least one axis")
        angles = [name for name in values if "xi" in name]
        if len(angles) > 1:
            raise ValueError(f"both {' and '.join(angles)} are given; keep one of them")
        bodies = math.prod(len(axis) for axis in values.values())
        if bodies > MAX_BODIES:
            raise ValueError(f"the grid has {bodies} bodies; at most {MAX_BODIES} are possible")
        return self

    def values(self) -> dict[str, list[float]]:
        """The values of each axis that is given."""
        axes = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: axis_values(axis) for name, axis in axes.items() if axis is not None}


class GridSource(Base):
    """Every combination of some parameters' values, the others fixed."""

    source: Literal["grid"] = Field(description="Vary parameters over a grid.")
    base: GridBase = Field(description="The body whose parameters are varied.")
    axes: Axes = Field(description="Which parameters vary, over which values.")

    @field_validator("base")
    @classmethod
    def _is_a_body(cls, base: GridBase) -> GridBase:
        if not isinstance(base, PresetBase) and base.phi >= base.theta:
            raise ValueError(f"phi {base.phi:g} is not below theta {base.theta:g}; swap them")
        if isinstance(base, ExplicitBase) and base.beta >= base.alpha:
            raise ValueError(f"beta {base.beta:g} is not below alpha {base.alpha:g}; swap them")
        return base

    @field_validator("axes")
    @classmethod
    def _fit_base(cls, axes: Axes, info: ValidationInfo) -> Axes:
        base = info.data.get("base")
        if base is None:
            return axes
        values = axes.values()
        shell_dumbbell = isinstance(base, ShellDumbbellBase)
        for name in ("alpha", "beta") if shell_dumbbell else ("f_sd",):
            if name in values:
                raise ValueError(
                    f"{name} cannot vary over this base; f_sd is for a shell-dumbbell base, alpha "
                    "and beta are for any other"
                )
        for small, large in (("phi", "theta"), ("beta", "alpha")):
            lows = values.get(small) or [getattr(base, small, -math.inf)]
            highs = values.get(large) or [getattr(base, large, math.inf)]
            if max(lows) >= min(highs):
                raise ValueError(
                    f"{small} >= {large} is possible, as {small} goes up to {max(lows):g} and "
                    f"{large} down to {min(highs):g}; their values must not meet"
                )
        return axes
