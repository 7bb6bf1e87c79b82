"""Where parameter sets come from: drawn at random, a preset, a table, or a grid."""

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator

from rattlesweep.sweeps.config import fields
from rattlesweep.sweeps.config.fields import (
    ORDERED,
    PARAMETERS,
    Base,
    Linspace,
    Logspace,
    PositiveNumbers,
    Spaced,
    check_one,
    interval,
    no_repeats,
    parameter,
    within,
)
from rattlesweep.sweeps.config.messages import out_of_range

Preset = Literal["GH", "KL"]
ELLIPSOIDS = ("KL",)
"""Presets that are ellipsoids."""
MAX_BODIES = 10**12
MAX_SOBOL = 2**30


class SdRanges(Base):
    """Ranges that shell-dumbbell bodies are drawn from; the paper's Table I unless given."""

    gamma: Annotated[list[Annotated[float, within("gamma")]], ORDERED] = interval("gamma", 5, 15)
    f_sd: Annotated[list[Annotated[float, within("f_sd")]], ORDERED] = interval("f_sd", 0.05, 0.15)
    theta: Annotated[list[Annotated[float, within("theta")]], ORDERED] = interval(
        "theta", 0.6, 0.95
    )
    phi: Annotated[list[Annotated[float, within("phi")]], ORDERED] = interval("phi", 0.01, 0.1)
    # Drawn from (low, high]: zero may bound the skew angle, but is never drawn.
    minus_xi_deg: Annotated[list[Annotated[float, Field(ge=0, lt=90)]], ORDERED] = interval(
        "minus_xi_deg", 0, 6
    )

    rules = (
        ("minus_xi_deg", lambda r: r.minus_xi_deg[1] == 0,
         "the range leaves only xi = 0, which never reverses; raise its end"),
        ("phi", lambda r: r.theta and r.phi[1] >= r.theta[0],
         "phi >= theta is possible, as phi goes up to {phi[1]:g} and theta down to {theta[0]:g}; "
         "the ranges must not meet"),
    )  # fmt: skip

    def ends(self) -> list[list[float]]:
        """The ranges in the order of the fields, in which bodies are drawn."""
        return [getattr(self, name) for name in type(self).model_fields]


class Target(Base):
    """Bodies are redrawn until their torque coefficient lies close to one of these values."""

    K_r: PositiveNumbers | None = None
    """Targets of the rolling coefficient K_r, no unit; one case for each."""
    K_p: PositiveNumbers | None = None
    """Targets of the pitching coefficient K_p, no unit; one case for each."""
    rel_tol: float = Field(default=1e-3, gt=0, le=0.5)
    """Largest relative distance from the target, no unit."""
    max_draws: int = Field(default=1_000_000, ge=1, le=2**62)
    """Draws after which a sample is given up."""

    @model_validator(mode="after")
    def _one_of_two(self) -> "Target":
        check_one(self, "K_r", "K_p")
        return self

    @property
    def name(self) -> Literal["K_r", "K_p"]:
        """The coefficient that is aimed at."""
        return "K_p" if self.K_r is None else "K_r"

    @property
    def values(self) -> list[float]:
        """The values aimed at."""
        return self.K_r or self.K_p or []


class Surfaced(Base):
    """Bodies with a surface."""

    surface: Literal["paraboloid", "ellipsoid"] | None = None
    """What the bottom is: a paraboloid or an ellipsoid, of the same curvatures at its lowest point.
    Unless given an ellipsoid where c is, or where the preset is one."""

    @property
    def ellipsoidal(self) -> bool:
        """Whether the bodies are ellipsoids."""
        return self.has_c if self.surface is None else self.surface == "ellipsoid"

    @property
    def has_c(self) -> bool:
        """Whether a vertical semi-axis is given, or the preset has one."""
        return getattr(self, "c", None) is not None

    @model_validator(mode="after")
    def _fits_surface(self) -> "Surfaced":
        if self.surface == "paraboloid" and getattr(self, "c", None) is not None:
            raise ValueError("c is given, and a paraboloid has none; take surface: ellipsoid")
        # A table has it row by row.
        if self.surface == "ellipsoid" and not (self.has_c or self.source == "table"):  # type: ignore[attr-defined]
            raise ValueError("an ellipsoid needs c, its vertical semi-axis over a; give c: 2")
        return self


class SdSource(Surfaced):
    """Shell-dumbbell bodies, drawn at random from ranges."""

    source: Literal["sd"]
    """Draw shell-dumbbell bodies at random."""
    samples: int = Field(default=1000, ge=1, le=MAX_BODIES)
    """Bodies per case."""
    ranges: SdRanges = Field(default_factory=lambda: SdRanges())
    """Where the parameters are drawn from, uniformly."""
    draw: Literal["random", "sobol", "saltelli"] = "random"
    """random: each body by itself; sobol: by a scrambled Sobol' sequence, whose points fill the
    ranges more evenly, so that shares and means come closer with as many samples; saltelli: seven
    at a time, eight if c has a range, that differ in one parameter each, for `rattlesweep
    sensitivity`."""
    target: Target | None = None
    """Keep only bodies with this torque coefficient; null: keep all."""
    c: Annotated[list[fields.C], *fields.number_or_interval()] | None = Field(
        default=None, description=f"A number, or a range [low, high]. {PARAMETERS['c'].meaning}"
    )

    @property
    def drawn(self) -> tuple[str, ...]:
        """What is drawn from a range, in its order."""
        varies = self.c is not None and self.c[0] < self.c[1]
        return (*SdRanges.model_fields, *(["c"] if varies else []))

    @property
    def group(self) -> int:
        """Samples that saltelli draws together: at two points, and with one parameter moved."""
        return 2 + len(self.drawn)

    rules = (
        ("draw", lambda s: s.draw != "random" and s.samples > MAX_SOBOL,
         f"the sequence has {MAX_SOBOL} points; take fewer samples, or random"),
        ("target", lambda s: s.target and s.draw and s.draw != "random",
         "bodies that are redrawn until they meet a target do not fill the ranges evenly; leave "
         "out the target, or take draw: random"),
    )  # fmt: skip


class Skewed(Base):
    """A body whose skew angle may be given in radians or in degrees."""

    xi: float | None = parameter("xi", None)
    xi_deg: float | None = parameter("xi_deg", None)

    needs_skew: ClassVar[bool] = True

    @model_validator(mode="after")
    def _one_angle(self) -> "Skewed":
        check_one(self, "xi", "xi_deg", needed=self.needs_skew)
        return self

    def given(self) -> dict[str, float]:
        """The parameters that are set, with xi in radians."""
        values = self.model_dump(exclude={"xi_deg"})
        if self.xi_deg is not None:
            values["xi"] = math.radians(self.xi_deg)
        return {name: value for name, value in values.items() if value is not None}


class Overrides(Skewed):
    """Parameters that replace those of a preset."""

    alpha: float | None = parameter("alpha", None)
    beta: float | None = parameter("beta", None)
    gamma: float | None = parameter("gamma", None)
    theta: float | None = parameter("theta", None)
    phi: float | None = parameter("phi", None)

    needs_skew: ClassVar[bool] = False


class PresetSource(Surfaced):
    """One body of the literature, perhaps with parameters replaced."""

    source: Literal["preset"]
    """Use one named body."""
    name: Preset
    """GH: the body of Garcia and Hubbard (1988); KL: that of Kane and Levinson (1982)."""
    overrides: Overrides = Field(default_factory=lambda: Overrides())
    """Parameters that replace the preset's."""
    c: float | None = parameter("c", None)

    @property
    def has_c(self) -> bool:
        """Whether a vertical semi-axis is given, or the preset has one."""
        return self.c is not None or self.name in ELLIPSOIDS


class TableSource(Surfaced):
    """Bodies from the rows of a table, in its order."""

    source: Literal["table"]
    """Read bodies from a table."""
    path: str = Field(min_length=1, pattern=r"^[^\x00]*$")
    """CSV or Parquet file with columns alpha beta gamma theta phi xi (radians), and optionally
    n_i omega_xy0 t_end, which replace spin and horizon row by row, or a full state instead of
    n_i omega_xy0: omega_x omega_y omega_z u_x u_y u_z; sigma and rolling replace those of
    dissipation."""
    c: fields.C | None = Field(
        default=None, description=f"Of rows without a c. {PARAMETERS['c'].meaning}"
    )


class PresetBase(Base):
    """Start from a body of the literature."""

    preset: Preset
    """GH: the body of Garcia and Hubbard (1988); KL: that of Kane and Levinson (1982)."""


class ExplicitBase(Skewed):
    """Start from a body given by its six parameters."""

    alpha: float = parameter("alpha")
    beta: float = parameter("beta")
    gamma: float = parameter("gamma")
    theta: float = parameter("theta")
    phi: float = parameter("phi")


class ShellDumbbellBase(Skewed):
    """Start from a shell-dumbbell body."""

    gamma: float = parameter("gamma")
    f_sd: float = parameter("f_sd")
    theta: float = parameter("theta")
    phi: float = parameter("phi")


def _base_kind(base: Any) -> str:
    if not isinstance(base, dict):
        return type(base).__name__ if isinstance(base, Base) else "PresetBase"
    if "f_sd" in base and "alpha" not in base:
        return "ShellDumbbellBase"
    explicit = "preset" not in base and PARAMETERS.keys() & base.keys()
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


def varied(name: str) -> Any:
    """A field that may hold an axis of a body parameter."""
    return Field(default=None, description=PARAMETERS[name].meaning)


class Axes(Base):
    """Parameters that vary: every combination is a body, and the first one varies slowest."""

    alpha: Axis = varied("alpha")
    beta: Axis = varied("beta")
    gamma: Axis = varied("gamma")
    f_sd: Axis = varied("f_sd")
    theta: Axis = varied("theta")
    phi: Axis = varied("phi")
    xi: Axis = varied("xi")
    xi_deg: Axis = varied("xi_deg")
    minus_xi_deg: Axis = varied("minus_xi_deg")
    c: Axis = varied("c")

    @field_validator("*")
    @classmethod
    def _in_limits(cls, axis: Axis, info: ValidationInfo) -> Axis:
        if axis is None or info.field_name is None:
            return axis
        ends = axis.ends[:2] if isinstance(axis, Spaced) else no_repeats(axis)
        low, high, _ = PARAMETERS[info.field_name]
        for value in (min(ends), max(ends)):
            if not low < value < high:
                bound = ("above", low) if value <= low else ("below", high)
                raise ValueError(out_of_range(f"the value {value:g}", *bound))
        return axis

    @model_validator(mode="after")
    def _plausible(self) -> "Axes":
        given = self.given()
        if not given:
            raise ValueError("no parameter varies; give at least one axis")
        check_one(self, "xi", "xi_deg", "minus_xi_deg", needed=False)
        bodies = math.prod(
            axis.ends[2] if isinstance(axis, Spaced) else len(axis) for axis in given.values()
        )
        if bodies > MAX_BODIES:
            raise ValueError(f"the grid has {bodies} bodies; at most {MAX_BODIES} are possible")
        return self

    def given(self) -> dict[str, list[float] | Spaced]:
        """The axes that are given."""
        axes = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: axis for name, axis in axes.items() if axis is not None}

    def values(self) -> dict[str, list[float]]:
        """The values of each axis that is given."""
        given = self.given().items()
        return {name: axis.values() if isinstance(axis, Spaced) else axis for name, axis in given}


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


class GridSource(Surfaced):
    """Every combination of some parameters' values, the others fixed."""

    source: Literal["grid"]
    """Vary parameters over a grid."""
    base: GridBase
    """The body whose parameters are varied."""
    axes: Axes
    """Which parameters vary, over which values."""
    refine: Refine | None = None
    """Leave out runs between others of one type; null: every combination is run."""
    c: fields.CNumbers | None = Field(
        default=None,
        description=f"A number, or an axis, which varies fastest. {PARAMETERS['c'].meaning}",
    )

    @property
    def has_c(self) -> bool:
        """Whether a vertical semi-axis is given, or the preset has one."""
        preset = getattr(self.base, "preset", None)
        return self.c is not None or self.axes.c is not None or preset in ELLIPSOIDS

    @property
    def varying(self) -> dict[str, list[float]]:
        """The values of each axis in their order, `c` behind the others where it is one."""
        own = {} if self.c is None or len(self.c) == 1 else {"c": self.c}
        return self.axes.values() | own

    rules = (
        *(("axes", lambda s, name=name: s.base and getattr(s.axes, name) is not None
           and isinstance(s.base, ShellDumbbellBase) == (name != "f_sd"),
           f"{name} cannot vary over this base; f_sd is for a shell-dumbbell base, alpha and beta "
           "are for any other")
          for name in ("alpha", "beta", "f_sd")),
        ("c", lambda s: s.c is not None and s.axes and s.axes.c is not None,
         "c is an axis of axes too; keep one of them"),
        ("c", lambda s: s.c is not None and len(s.c) > 1 and s.refine,
         "refine takes the axes of axes alone; write axes: {{c: ...}}"),
    )  # fmt: skip
