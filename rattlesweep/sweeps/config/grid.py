"""Bodies on a grid: a base body and the parameters that vary over it."""

import math
import sys
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

from rattlesweep.sweeps.config.bodies import MAX_BODIES, Preset, Skewed
from rattlesweep.sweeps.config.fields import (
    DESCRIPTIONS,
    LIMITS,
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
from rattlesweep.sweeps.config.messages import problems_of
from rattlesweep.sweeps.config.places import Places

MAX_AXIS = 10**6
_TOO_CLOSE = "{n:g} values from {low!r} to {high!r} would not all differ; give fewer of them"


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
    if isinstance(base, ExplicitBase) or ("preset" not in keys and LIMITS.keys() & keys):
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


def _checked_step(ends: list[float]) -> list[float]:
    low, high, n = ends
    # Neighbours closer than this may round to one number.
    if n > 1 and not abs(high / (n - 1) - low / (n - 1)) > 4 * math.ulp(max(abs(low), abs(high))):
        raise ValueError(_TOO_CLOSE.format(n=n, low=low, high=high))
    return ends


def _checked_ratio(ends: list[float]) -> list[float]:
    low, high, n = ends
    if low == 0 or not 0 < high / low < math.inf:
        raise ValueError(
            f"no constant ratio leads from {low:g} to {high:g}; "
            "both ends must have the same sign and neither be 0"
        )
    if n > 1 and not abs(math.log(high / low)) / (n - 1) > 4 * sys.float_info.epsilon:
        raise ValueError(_TOO_CLOSE.format(n=n, low=low, high=high))
    return ends


_ENDS: Any = Field(
    description="[low, high, n]: n values between and including low and high.",
    json_schema_extra={"minItems": 3, "maxItems": 3},
)


class Linspace(Base):
    """Evenly spaced values."""

    linspace: Annotated[
        list[float], AfterValidator(_checked_ends), AfterValidator(_checked_step)
    ] = _ENDS

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
        problem = problems_of(error, kind, given, set(), Places())[0][0]
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


Values = list[float] | Linspace | Logspace


def axis_values(axis: Values) -> list[float]:
    """The values along an axis, however it is written."""
    return axis if isinstance(axis, list) else axis.values()


def axis_ends(axis: Values) -> tuple[float, float, int]:
    """Smallest and largest value of an axis, and how many there are; the others are not made."""
    if isinstance(axis, list):
        return min(axis), max(axis), len(axis)
    low, high, n = axis.linspace if isinstance(axis, Linspace) else axis.logspace
    return min(low, high), max(low, high), int(n)


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
            if not axis:
                raise ValueError("the list is empty; give at least one number")
            no_repeats(axis)
        for value in axis_ends(axis)[:2]:
            if problem := limit_problem(info.field_name, value, "the value"):
                raise ValueError(problem)
        return axis

    @model_validator(mode="after")
    def _plausible(self) -> "Axes":
        ends = self.ends()
        if not ends:
            raise ValueError("no parameter varies; give at least one axis")
        angles = [name for name in ends if "xi" in name]
        if len(angles) > 1:
            raise ValueError(f"both {' and '.join(angles)} are given; keep one of them")
        bodies = math.prod(size for _, _, size in ends.values())
        if bodies > MAX_BODIES:
            raise ValueError(f"the grid has {bodies} bodies; at most {MAX_BODIES} are possible")
        return self

    def given(self) -> dict[str, Values]:
        """The axes that are given."""
        axes = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: axis for name, axis in axes.items() if axis is not None}

    def values(self) -> dict[str, list[float]]:
        """The values of each axis that is given."""
        return {name: axis_values(axis) for name, axis in self.given().items()}

    def ends(self) -> dict[str, tuple[float, float, int]]:
        """Smallest and largest value of each axis that is given, and how many there are."""
        return {name: axis_ends(axis) for name, axis in self.given().items()}


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
        ends = axes.ends()
        shell_dumbbell = isinstance(base, ShellDumbbellBase)
        for name in ("alpha", "beta") if shell_dumbbell else ("f_sd",):
            if name in ends:
                raise ValueError(
                    f"{name} cannot vary over this base; f_sd is for a shell-dumbbell base, alpha "
                    "and beta are for any other"
                )
        for small, large in (("phi", "theta"), ("beta", "alpha")):
            most = ends[small][1] if small in ends else getattr(base, small, -math.inf)
            least = ends[large][0] if large in ends else getattr(base, large, math.inf)
            if most >= least:
                raise ValueError(
                    f"{small} >= {large} is possible, as {small} goes up to {most:g} and "
                    f"{large} down to {least:g}; their values must not meet"
                )
        return axes
