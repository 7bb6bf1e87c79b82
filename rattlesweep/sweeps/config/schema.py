"""Schema of a config as frozen pydantic models, in units M = a = g = 1; rules between
keys.
"""

# mypy: disable-error-code="valid-type"
# Types that functions return are types to pydantic, but not to mypy.

import json
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import chain
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

import numpy as np
import pydantic
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    PlainSerializer,
    Tag,
)

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.tableau import DT, MAX_STEPS, METHODS, TOL
from rattlesweep.physics.body import MAX_INERTIA
from rattlesweep.physics.si import LIMITS
from rattlesweep.sweeps.config import Places
from rattlesweep.units import KINDS, Quantity, quantities, split

# sqrt(g/a); at this spin a tilt of 1e-6 rad takes a contact force of the weight
MAX_SPEED = 1e3
MAX_SIGMA = 1e6  # M a^2 sqrt(g/a)
MAX_TIME = 1e30  # sqrt(a/g) or t_rGH, beyond any run; sums of such numbers stay finite
MIN_OSCILLATION = 1e-140  # sqrt(g/a); the square of a smaller one underflows
MAX_AXIS, MAX_CASES = 10**6, 100_000
TABLE = "table"  # stands for values that the rows of a table give

# Symbols of Kondo and Nakanishi (2017) with the ends of their open intervals;
# `physics.body` checks the relations between them.
BODY_KEYS: dict[str, tuple[float, float, str]] = {
    "alpha": (
        1,
        MAX_INERTIA,
        "I_xx / (M a^2) + 1, inertia about the x axis; above beta.",
    ),
    "beta": (1, MAX_INERTIA, "I_yy / (M a^2) + 1, inertia about the y axis."),
    "gamma": (0, MAX_INERTIA, "I_zz / (M a^2), inertia about the spin axis."),
    "theta": (0, 1, "Larger principal curvature at the bottom, times a."),
    "phi": (0, 1, "Smaller principal curvature at the bottom, times a."),
    "xi": (
        -math.pi / 2,
        0,
        "Skew angle from the axes of inertia to those of curvature, in rad.",
    ),
    "xi_deg": (-90, 0, "Skew angle xi in degrees."),
    "minus_xi_deg": (0, 90, "Skew angle xi times -1, in degrees."),
    "c": (0, 1e9, "Vertical semi-axis of the ellipsoid, divided by a; above theta."),
    "f_sd": (0, 0.5, "I_yy / I_zz of a shell-dumbbell body."),
}


def key(default: Any, description: str, **limits: Any) -> Any:
    """Return a pydantic field; a callable default is a factory."""
    kind = "default_factory" if callable(default) else "default"
    return Field(**{kind: default}, description=description, **limits)


class Base(pydantic.BaseModel):
    """Frozen, strict and closed model."""

    model_config = {
        "extra": "forbid",
        "frozen": True,
        "strict": True,
        "allow_inf_nan": False,
        # Models take 0.3 s to build, and a command needs one of them.
        "defer_build": True,
    }

    @pydantic.model_validator(mode="before")
    @classmethod
    def _tidy(cls, data: Any) -> Any:
        """Drop nulls, and read numbers such as 1e-9, which are text in YAML 1.1
        (PyYAML).
        """

        def number(value: Any) -> Any:
            if isinstance(value, list):
                return [number(item) for item in value]
            if isinstance(value, str):
                for kind in (int, float):
                    with suppress(ValueError):
                        return kind(value)
            return value

        if not isinstance(data, dict):
            return data
        # The error about an unknown key has its value as input, which here becomes the
        # known keys.
        known, texts = [*cls.model_fields], ("name", "path", "output")
        given = {k: x if k in known else known for k, x in data.items()}
        given = {k: x for k, x in given.items() if x is not None}
        return {k: x if k in texts else number(x) for k, x in given.items()}


Positive = Annotated[float, Field(gt=0)]
Time = Annotated[float, Field(gt=0, le=MAX_TIME)]
Speed = Annotated[float, Field(ge=-MAX_SPEED, le=MAX_SPEED)]
THREE = Field(min_length=3, max_length=3)
UNIQUE = Field(json_schema_extra={"uniqueItems": True})
COUNT = {"ge": 1, "le": 2**62}
PATH = {"min_length": 1, "pattern": r"^[^\x00]*$"}
TAGS = TEXT, OTHER = (
    "<text>",
    "<other>",
)  # which pydantic puts into the locations of errors


def or_text(item: Any, text: Any) -> Any:
    """Return the type of an `item` that may also be given as a `text` type."""
    kinds = Annotated[item, Tag(OTHER)] | Annotated[text, Tag(TEXT)]
    kind_of = Discriminator(lambda value: TEXT if isinstance(value, str) else OTHER)
    as_given = PlainSerializer(lambda value: getattr(value, "text", value))
    return Annotated[kinds, kind_of, as_given]


def measured(kind: str, item: Any, *words: str) -> Any:
    """Return the type of a number in units of the body, a text with a unit, or one of
    `words`.
    """
    read = AfterValidator(lambda text: text if text in words else Quantity(text, kind))
    return or_text(item, Annotated[str, Field(examples=[KINDS[kind][1]]), read])


def _distinct(values: list[Any]) -> list[Any]:
    if len({*values}) < len(values):
        raise ValueError("a value is repeated; give each once")
    return values


def _as_list(value: Any) -> Any:
    """Return a list as it is, and one value or ``{linspace: [low, high, n]}`` as a
    list.
    """
    if not isinstance(value, dict):
        return value if isinstance(value, list) else [value]
    laws: dict[str, Any] = {"linspace": np.linspace, "logspace": np.geomspace}
    values = np.array([np.nan])
    with suppress(TypeError, ValueError, KeyError), np.errstate(all="ignore"):
        [(law, (*ends, n))] = value.items()
        (low, unit), (high, other) = (split(str(end)) for end in ends)
        # One value if the ends are equal, else two or more.
        if (
            unit == other
            and 1 <= n <= MAX_AXIS
            and n == int(n)
            and (n == 1) == (low == high)
        ):
            values = laws[law](low, high, int(n))
    if not np.isfinite(values).all():
        raise ValueError(
            "write {linspace: [low, high, n]} or {logspace: [low, high, n]}, with ends "
            "in one unit, of one sign for logspace, and a whole number n up to "
            f"{MAX_AXIS}"
        )
    return [f"{x!r} {unit}" if unit else x for x in values.tolist()]


def several(item: Any) -> Any:
    """Return the type of a list of distinct items, given as one, as a list, or by
    linspace.
    """
    many = Annotated[list[item], Field(min_length=1), UNIQUE]
    spaced = dict[Literal["linspace", "logspace"], Annotated[list[float | str], THREE]]
    as_list = BeforeValidator(_as_list, item | many | spaced)
    return Annotated[many, as_list, AfterValidator(_distinct)]


def interval(item: Any) -> Any:
    """Return the type of a range [low, high]; one number stands for a range of zero
    width.
    """

    def rising(ends: list[float]) -> list[float]:
        if ends[0] > ends[1]:
            raise ValueError("the range is reversed; write [low, high]")
        return ends

    pair = Annotated[list[item], Field(min_length=2, max_length=2)]
    as_pair = BeforeValidator(
        lambda x: x if isinstance(x, list) else [x, x], item | pair
    )
    return Annotated[pair, as_pair, AfterValidator(rising)]


def parameter(name: str, shape: Callable[[Any], Any] = lambda item: item) -> Any:
    """Return the type of an optional body parameter: one value, or a shape such as
    `several`.
    """
    low, high, meaning = BODY_KEYS[name]
    item = Annotated[float, Field(gt=low, lt=high)]
    return Annotated[shape(item) | None, Field(description=meaning)]


PRESET_MEANING = (
    "GH: the body of Garcia and Hubbard (1988); KL: that of Kane and Levinson (1982)."
)
Preset = Literal["GH", "KL"]
Surface = Literal["paraboloid", "ellipsoid"]
Draw = Literal["random", "sobol", "saltelli"]
Skew = Annotated[float, Field(ge=0, lt=90)]


class Surfaced(Base):
    """Bodies whose surface is a paraboloid or an ellipsoid."""

    source: str
    surface: Surface | None = key(None, "Shape of the bottom; ellipsoid if c is given.")
    c: parameter("c") = None

    @property
    def has_semi_axis(self) -> bool:
        """Whether there is a semi-axis c: the key, an axis of a grid, or that of the
        preset KL.
        """
        axes, base = getattr(self, "axes", None), getattr(self, "base", None)
        preset = base.preset if base else getattr(self, "name", None)
        return (
            self.c is not None or getattr(axes, "c", None) is not None or preset == "KL"
        )

    @property
    def ellipsoidal(self) -> bool:
        """Whether the bodies are ellipsoids; unless `surface` is given, those with a
        semi-axis.
        """
        return (
            self.has_semi_axis if self.surface is None else self.surface == "ellipsoid"
        )


class SdRanges(Base):
    """Ranges from which shell-dumbbell bodies are drawn; default: the paper's Table
    I.
    """

    gamma: parameter("gamma", interval) = [5.0, 15.0]
    f_sd: parameter("f_sd", interval) = [0.05, 0.15]
    theta: parameter("theta", interval) = [0.6, 0.95]
    phi: parameter("phi", interval) = [0.01, 0.1]
    # The lower end may be zero, as draws exclude it.
    minus_xi_deg: interval(Skew) = key([0.0, 6.0], BODY_KEYS["minus_xi_deg"][2])


class Target(Base):
    """Bodies are redrawn until their torque coefficient lies close to one of these
    values.
    """

    K_r: several(Positive) | None = key(
        None, "Targets of the rolling coefficient; a case each."
    )
    K_p: several(Positive) | None = key(
        None, "Targets of the pitching coefficient; a case each."
    )
    rel_tol: float = key(
        1e-3, "Largest relative distance from the target.", gt=0, le=0.5
    )
    max_draws: int = key(10**6, "Draws after which a sample is given up.", **COUNT)

    @property
    def name(self) -> Literal["K_r", "K_p"]:
        """The coefficient that has targets."""
        return "K_p" if self.K_r is None else "K_r"

    @property
    def values(self) -> list[float]:
        """The targets."""
        return self.K_r or self.K_p or []


class SdSource(Surfaced):
    """Shell-dumbbell bodies, drawn at random from ranges."""

    source: Literal["sd"] = key(..., "Draw shell-dumbbell bodies at random.")
    samples: int = key(1000, "Bodies per case.", **COUNT)
    ranges: SdRanges = key(SdRanges, "Ranges of the uniform draws.")
    draw: Draw = key(
        "random", "sobol: more even; saltelli: for `rattlesweep sensitivity`."
    )
    target: Target | None = key(None, "Keep only bodies with this torque coefficient.")
    c: parameter("c", interval) = None

    @property
    def drawn(self) -> tuple[str, ...]:
        """Names of the parameters that are drawn from a range, in their order."""
        return (
            *SdRanges.model_fields,
            *(["c"] if self.c and self.c[0] < self.c[1] else []),
        )

    @property
    def group(self) -> int:
        """Samples that saltelli draws together: two points, and one for each
        parameter.
        """
        return 2 + len(self.drawn)


class Overrides(Base):
    """Parameters that replace those of a preset."""

    alpha: parameter("alpha") = None
    beta: parameter("beta") = None
    gamma: parameter("gamma") = None
    theta: parameter("theta") = None
    phi: parameter("phi") = None
    xi: parameter("xi") = None
    xi_deg: parameter("xi_deg") = None

    def given(self) -> dict[str, float]:
        """Return the parameters that are given, with xi in radians."""
        values = self.model_dump(exclude_none=True, exclude={"preset", "xi_deg"})
        return (
            values
            if self.xi_deg is None
            else values | {"xi": math.radians(self.xi_deg)}
        )


class PresetSource(Surfaced):
    """One body of the literature, perhaps with other values of some parameters."""

    source: Literal["preset"] = key(..., "Use one named body.")
    name: Preset = key(..., PRESET_MEANING)
    overrides: Overrides = key(Overrides, "Parameters that replace the preset's.")


class TableSource(Surfaced):
    """Bodies from the rows of a table, in its order."""

    source: Literal["table"] = key(..., "Read bodies from a table.")
    path: str = key(
        ..., "CSV or Parquet file, or a directory of Parquet files.", **PATH
    )


class GridBase(Overrides):
    """The body whose parameters are varied: a preset, six parameters, or a
    shell-dumbbell body.
    """

    preset: Preset | None = key(None, PRESET_MEANING)
    f_sd: parameter("f_sd") = None


ANGLES = ("xi", "xi_deg", "minus_xi_deg")
AXES = ("alpha", "beta", "gamma", "f_sd", "theta", "phi", *ANGLES, "c")
VARYING: dict[str, Any] = {name: (parameter(name, several), None) for name in AXES}
ORDER = (
    "Parameters that vary. Every combination is a body; the first axis varies slowest."
)
Axes = pydantic.create_model("Axes", __base__=Base, __doc__=ORDER, **VARYING)


class Refine(Base):
    """A coarse grid is run first, then, level by level, the points between runs that
    differ.
    """

    levels: int = key(4, "Halvings from the coarse grid to the full one.", ge=1, le=16)
    by: Literal[
        "type",
        "t_r",
        "n_end",
        "t_end",
        "n_steps",
        "energy_drift",
        "n_departure",
        "amp_growth",
        "lyapunov",
        "contact_ratio_max",
        "n_turns",
    ] = key("type", "Column that is compared: cells in which it differs are halved.")
    tol: float = key(
        0.05, "For numbers: relative distance from the neighbours' line.", gt=0, lt=1
    )


class GridSource(Surfaced):
    """All combinations of the values of some parameters, with the others fixed."""

    source: Literal["grid"] = key(..., "Vary parameters over a grid.")
    base: GridBase = key(..., "The body whose parameters are varied.")
    axes: Axes = key(..., "Parameters that vary, with their values.")
    refine: Refine | None = key(None, "Skip points between runs that agree.")
    c: parameter("c", several) = None

    @property
    def varying(self) -> dict[str, list[float]]:
        """Values of each axis in order; a key c with several values is the last
        axis.
        """
        axes = vars(self.axes) | ({"c": self.c} if self.c and len(self.c) > 1 else {})
        return {name: values for name, values in axes.items() if values is not None}


Length, Mass, Angle = (
    measured(kind, Annotated[float, Field(ge=LIMITS[kind][0], le=LIMITS[kind][1])])
    for kind in ("length", "mass", "angle")
)
Lengths, Masses, Angles = map(interval, (Length, Mass, Angle))
Coordinate: Any = measured("length", float)
from_text = BeforeValidator(
    lambda x: quantities(x, "length", 2) if isinstance(x, str) else x
)
Place = Annotated[list[Coordinate], Field(min_length=2, max_length=2), from_text]


class ShapeSource(Base):
    """Bodies of a simple shape and a size; keys that are ranges are drawn for each
    sample.
    """

    source: Literal["shape"] = key(..., "Make bodies of a shape and a size.")
    shape: Literal["half_ellipsoid"] = key(
        "half_ellipsoid", "Of uniform density, flat side up."
    )
    length: Lengths = key(..., "Axis of the flat side, in m or with a unit.")
    width: Lengths = key(..., "Its other axis, in m or with a unit.")
    height: Lengths = key(
        ..., "From the lowest point to the flat side, in m or with a unit."
    )
    mass: Masses = key(..., "Without the weights, in kg or with a unit.")
    skew: Angles = key(
        [0.0, 0.0],
        "Turn of the axes of inertia, clockwise from above, in rad or "
        "with a unit; needed without weights.",
    )
    weights: Masses | None = key(
        None, "Mass of each of two equal weights on the flat side."
    )
    at: Place | None = key(
        None, "Place [x, y] of one weight, to the right and away from you."
    )
    wall: Length | None = key(
        None, "Thickness of an open shell; without it the body is solid."
    )
    samples: int | None = key(
        None, "Bodies per case (1000) if a key is a range.", **COUNT
    )

    ellipsoidal: ClassVar[bool] = True  # as is its bottom

    @property
    def sizes(self) -> dict[str, list[float]]:
        """The range of each key in SI units."""
        names = ("length", "width", "height", "mass", "skew", "weights")
        return {
            name: ends for name in names if (ends := getattr(self, name)) is not None
        }

    @property
    def fixed(self) -> dict[str, float]:
        """The keys without a range, as arguments of `physics.si.half_ellipsoid`."""
        place: dict[str, float] = dict(zip("xy", self.at or (), strict=False))
        return place if self.wall is None else place | {"wall": self.wall}

    @property
    def drawn(self) -> list[str]:
        """Names of the keys that are drawn from a range."""
        return [name for name, (low, high) in self.sizes.items() if low < high]


SOURCES = {
    "sd": SdSource,
    "preset": PresetSource,
    "table": TableSource,
    "grid": GridSource,
    "shape": ShapeSource,
}
AnySource = SdSource | PresetSource | TableSource | GridSource | ShapeSource

InitialSpin = Annotated[
    Speed, AfterValidator(lambda spin: spin + 0.0)
]  # turns -0.0 into 0.0
Oscillation = Annotated[float, Field(ge=MIN_OSCILLATION, le=MAX_SPEED)]
Direction = or_text(
    Annotated[float, Field(ge=-360, le=360)], Literal["relevant", "pitch", "roll"]
)
Spins, Oscillations = (
    several(measured("spin", item)) for item in (InitialSpin, Oscillation)
)


class Spin(Base):
    """Initial spin and oscillation of upright bodies: every n_i with every
    omega_xy0.
    """

    n_i: Spins = key(
        ..., "Initial spins in sqrt(g/a) or with a unit; negative: steady; 0: a tap."
    )
    omega_xy0: Oscillations = key(
        ..., "Initial oscillations in sqrt(g/a) or with a unit."
    )
    psi: Direction = key(
        "relevant", "Mode (relevant: pitch for n_i >= 0, else roll) or degrees."
    )


NO_UNIT_VECTOR = "u must be a vector of length 1 with u_z below 0, as [0, 0, -1]"
AT_REST = "the body stands upright and at rest; give it an angular velocity"


def normalised(u: Any) -> Floats:
    """Return vectors scaled to length 1; NaN for a length other than 1 and for u_z >=
    0.
    """
    u = np.asarray(u, float)
    length = np.linalg.norm(u, axis=-1, keepdims=True)
    off = np.abs(length - 1)
    # A vector that is normalised to rounding keeps its bits.
    return np.where(
        (off <= 1e-3) & (u[..., 2:] < 0), u / np.where(off < 1e-15, 1, length), np.nan
    )


def _unit(u: list[float]) -> list[float]:
    found: list[float] = normalised(u).tolist()
    if math.isnan(found[0]):
        raise ValueError(NO_UNIT_VECTOR)
    return found


Vertical = Annotated[list[float], THREE, AfterValidator(_unit)]


class State(Base):
    """Full initial state of all bodies, in components along the body's axes."""

    omega: Annotated[list[Speed], THREE] = key(
        ..., "Angular velocity [x, y, z] in sqrt(g/a)."
    )
    u: Vertical = key(
        [0, 0, -1], "Vertical unit vector [x, y, z]; [0, 0, -1] is upright."
    )


class Horizon(Base):
    """Time at which a run without a reversal ends. Of several, the smallest counts."""

    t_rgh: Time | None = key(None, "In units of t_rGH in the spin's own direction.")
    t: measured("time", Time) | None = key(None, "In sqrt(a/g) or with a unit.")
    t_decay: Time | None = key(
        None, "In units of gamma/sigma; needs dissipation.sigma."
    )


Torque = measured("torque per spin", Annotated[float, Field(ge=0, le=MAX_SIGMA)], TABLE)
Lever = measured("length", Annotated[float, Field(ge=0, le=1)], TABLE)


class Dissipation(Base):
    """Loss of energy. Each value of a list is a case; `table` stands for a table's
    column.
    """

    sigma: several(Torque) = key(
        [0.0], "Torque / -omega, in M a^2 sqrt(g/a) or with a unit."
    )
    rolling: several(Lever) = key([0.0], "Moment / normal force, in a or with a unit.")

    @property
    def kind(self) -> Literal["", "viscous", "rolling"]:
        """Dissipation of some run: none, by sigma alone, or with rolling resistance."""
        return (
            "rolling" if self.rolling != [0] else "viscous" if self.sigma != [0] else ""
        )

    def __bool__(self) -> bool:
        return bool(self.kind)


class Classify(Base):
    """Thresholds between the types of runs that do not reverse; `early` saves steps of
    type SS.
    """

    ss_growth: float = key(
        1e-3, "SS if amplitudes grow by less than this fraction.", gt=0
    )
    sw_departure: float = key(
        0.05, "Else SW if n/n_i falls below 1 by this fraction.", gt=0, lt=1
    )
    early: bool = key(False, "End runs of model full once they are certain to be SS.")
    dead_energy: float = key(
        0.01, "D if not R and below this fraction of energy.", ge=1e-6, lt=1
    )

    @property
    def thresholds(self) -> dict[str, float]:
        """The thresholds, without `early`, which stored runs cannot change."""
        return self.model_dump(exclude={"early"})

    @property
    def as_text(self) -> str:
        """The thresholds as JSON, as stored in each file of rows."""
        return json.dumps(self.thresholds, sort_keys=True)


class Stop(Base):
    """Half-widths of 95 % intervals at which a case has enough samples; both, if both
    are given.
    """

    fraction: float | None = key(None, "For the fraction of every type.", gt=0, lt=0.5)
    t_r: float | None = key(None, "For the mean t_r, relative to it.", gt=0, lt=1)


# Method and tol of each word; docs/accuracy.md has their errors.
ACCURACIES = {
    "draft": ("dop853", 1e-6),
    "standard": ("dop853", TOL),
    "reference": ("verner98", 1e-12),
}


class AccuracyGoal(Base):
    """Largest error of the results; each run is integrated at the tol that this
    takes.
    """

    t_r: float = key(..., "Relative error of reversal times.", ge=1e-12, le=1e-3)


Accuracy = or_text(AccuracyGoal, Literal[tuple(ACCURACIES)])


class Integrator(Base):
    """Integration method, with adaptive steps (tol) or a fixed step (dt)."""

    method: Literal["dop853", "dopri5", "verner98", "rk4"] = key(
        "dop853", "Name of the method."
    )
    accuracy: Accuracy | None = key(
        None, "A word for method and tol, or {t_r: ...} for tol."
    )
    tol: float | None = key(
        None, "Adaptive: error per step (default 1e-09).", ge=1e-15, le=0.01
    )
    dt: float | None = key(None, "Fixed: step in sqrt(a/g) (default 0.002).", gt=0)
    max_steps: int = key(MAX_STEPS, "Steps after which a run is given up.", **COUNT)

    @property
    def goal(self) -> float | None:
        """Largest relative error of t_r, if the config sets one."""
        return self.accuracy.t_r if isinstance(self.accuracy, AccuracyGoal) else None

    @pydantic.model_validator(mode="before")
    @classmethod
    def _spell_out(cls, data: Any) -> Any:
        """Fill in method, tol and dt, so that configs with one meaning are equal."""
        if not isinstance(data, dict):
            return data
        data = {name: value for name, value in data.items() if value is not None}
        word, method = data.get("accuracy"), data.get("method", "dop853")
        if (
            isinstance(word, str)
            and word in ACCURACIES
            and not {"method", "tol", "dt"} & {*data}
        ):
            del data["accuracy"]
            data["method"], data["tol"] = ACCURACIES[word]
        elif word is None and isinstance(method, str) and method in METHODS:
            data = ({"tol": TOL} if METHODS[method].adaptive else {"dt": DT}) | data
        return data


Record = Literal[
    "energy", "contact", "windows", "lyapunov", "volume", "error", "reversals"
]
Model = Literal["full", "reduced", "gh"]
Records = Annotated[list[Record], AfterValidator(_distinct), UNIQUE]


class Config(Base):
    """A sweep: its bodies, launches, integration, and output."""

    name: str = key(
        "sweep", "Also names the directory in out/; default: name of the file."
    )
    seed: int = key(
        0, "Random draws depend only on seed, case and sample.", ge=0, lt=2**63
    )
    bodies: AnySource = key(..., "Source of the bodies.", discriminator="source")
    stop: Stop | None = key(
        None, "When a case has enough samples; null: at `bodies.samples`."
    )
    launch: State | None = key(None, "Full initial state, in place of `spin`.")
    spin: Spin | None = key(None, "Launches, unless `launch` or a table gives them.")
    model: Model = key(
        "full", "full: five variables; reduced: three; gh: a closed formula."
    )
    horizon: Horizon = key(
        lambda: Horizon(t_rgh=5.0), "When runs that do not reverse end."
    )
    dissipation: Dissipation = key(Dissipation, "Loss of energy, for model full.")
    integrator: Integrator = key(Integrator, "Integration method.")
    classify: Classify = key(Classify, "Thresholds between types of runs.")
    record: Records = key(
        list, "Extra columns; with reversals, runs continue to the horizon."
    )
    output: str | None = key(None, "Directory; null: out/<name>.", **PATH)

    _places: Places = pydantic.PrivateAttr(default_factory=Places)

    @pydantic.field_validator("name")
    @classmethod
    def _plain_word(cls, name: str) -> str:
        if (
            name.strip() in ("", ".", "..")
            or not name.isprintable()
            or {"/", "\\"} & {*name}
        ):
            raise ValueError(
                "is not a plain word; leave out slashes and control characters"
            )
        return name

    @pydantic.model_validator(mode="after")
    def _order_record(self) -> Self:
        """Sort the words of `record`, and add those that are implied."""
        found = {*self.record, *(["error"] if self.integrator.goal else [])}
        self.__dict__["record"] = [name for name in get_args(Record) if name in found]
        return self

    @property
    def deciding_key(self) -> Literal["stop", "bodies.refine"] | None:
        """The key by which a sweep leaves runs out; None if it runs all."""
        if self.stop is not None:
            return "stop"
        return "bodies.refine" if getattr(self.bodies, "refine", None) else None

    @property
    def deciding_column(self) -> str | None:
        """The column, besides `type`, by which a sweep leaves runs out."""
        if self.stop is not None:
            return None if self.stop.t_r is None else "t_r"
        refine = getattr(self.bodies, "refine", None)
        return None if refine is None or refine.by == "type" else refine.by

    @property
    def parts(self) -> list[str]:
        """Optional groups of columns in `runs`."""
        others = {
            "tol": self.integrator.goal,
            "turns": {"error", "reversals"} <= {*self.record},
            "surface": self.bodies.ellipsoidal,
            "dissipation": self.dissipation,
        }
        return [*self.record, *(name for name, there in others.items() if there)]

    @property
    def settings(self) -> dict[str, list[float | None]]:
        """Values by the column that they set, as `Quantity` if with units; None for a
        table's.
        """
        spin, losses = self.spin, self.dissipation
        given = {} if spin is None else {"n_i": spin.n_i, "omega_xy0": spin.omega_xy0}
        given |= {
            "sigma": losses.sigma,
            "rolling": losses.rolling,
            "t_end": [self.horizon.t],
        }
        return {
            k: [None if x == TABLE else x for x in values]
            for k, values in given.items()
        }

    @property
    def in_si(self) -> bool:
        """Whether some of these have units, so that they depend on the size of the
        bodies.
        """
        return any(
            isinstance(value, Quantity) for value in chain(*self.settings.values())
        )

    @property
    def directory(self) -> str:
        """The output directory."""
        return self.output or f"out/{self.name}"

    def located(self, message: str) -> str:
        """Return a message with file and line in front if it begins with a dotted
        key.
        """
        name, _, sentence = message.partition(": ")
        if not re.fullmatch(
            rf"({'|'.join(Config.model_fields)})(\.\w+|\[\d+\])*", name
        ):
            return message
        parts = re.findall(r"\w+", name)
        return self._places.line(
            tuple(int(x) if x.isdigit() else x for x in parts), sentence
        )

    @contextmanager
    def locating(self) -> Iterator[None]:
        """Put file and line in front of the messages of a ConfigError."""
        try:
            yield
        except ConfigError as error:
            raise ConfigError(map(self.located, error.messages)) from None


class Losses(Base):
    """Dissipation of one run."""

    sigma: float | str = 0.0
    rolling: float | str = 0.0


class Stone(Base):
    """What is known of a stone, and the names of the unknowns; see `docs/fit.md`."""

    body: dict[str, Any]
    free: list[str]
    launch: dict[str, Any] = {}
    dissipation: Losses = Field(default_factory=Losses)


def clashes(config: Config) -> Iterator[tuple[str, str]]:
    """Yield a dotted key and a message for each broken rule between keys."""
    bodies, spin, launch, losses = (
        config.bodies,
        config.spin,
        config.launch,
        config.dissipation,
    )
    horizon, integrator, record = config.horizon, config.integrator, {*config.record}
    early, full, table = (
        config.classify.early,
        config.model == "full",
        bodies.source == TABLE,
    )
    lossy_or_ellipsoidal = losses or bodies.ellipsoidal
    yield from _body_clashes(bodies)
    axes = getattr(bodies, "axes", None)
    for name, section in {
        "stop": config.stop,
        "horizon": horizon,
        "bodies.axes": axes,
    }.items():
        if section and not _given(section):
            yield (
                name,
                f"no key is given; add one of {', '.join(type(section).model_fields)}",
            )
    if config.stop and not getattr(bodies, "drawn", ()):
        yield "stop", f"source {bodies.source} draws no samples; take source: sd"
    if config.stop and getattr(bodies, "draw", "") == "saltelli":
        yield "stop", "draw: saltelli has groups of dependent samples; take draw: sobol"
    if spin and launch:
        yield "spin", "spin and launch are both given; keep one of them"
    if not (spin or launch or table):
        yield (
            "spin",
            "the key is missing; give n_i and omega_xy0, or a launch with omega and u",
        )
    if launch and not any((*launch.omega, *launch.u[:2])):
        yield "launch", AT_REST
    lists = [
        losses.sigma,
        losses.rolling,
        *([spin.n_i, spin.omega_xy0] if spin else []),
    ]
    lists += (
        [bodies.target.values] if isinstance(bodies, SdSource) and bodies.target else []
    )
    if (cases := math.prod(map(len, lists))) > MAX_CASES:
        yield "spin", f"the lists make {cases} cases; at most {MAX_CASES} are possible"
    if horizon.t_decay and not (table or any(losses.sigma)):
        yield "dissipation", "horizon.t_decay is in units of gamma/sigma; give sigma"
    if TABLE in (*losses.sigma, *losses.rolling) and not table:
        yield "dissipation", "the word table needs source: table; give a number"
    if losses and not full:
        yield (
            "dissipation",
            f"the model {config.model} conserves energy; take model: full",
        )
    accuracy: Any = integrator.accuracy
    method = integrator.method
    control = ("accuracy" if accuracy else "tol") if METHODS[method].adaptive else "dt"
    for name in ("accuracy", "tol", "dt"):
        if name != control and getattr(integrator, name) is not None:
            yield (
                f"integrator.{name}",
                f"{method} takes {control} alone; leave {name} out",
            )
    if isinstance(accuracy, str) and control == "accuracy" and integrator.tol is None:
        yield "integrator.accuracy", f"{accuracy} sets method and tol; leave them out"
    if integrator.goal and (config.model == "gh" or "reversals" in record):
        yield (
            "integrator",
            "accuracy {t_r: ...} excludes model gh and record reversals; keep one",
        )
    if early and (lossy_or_ellipsoidal or not full):
        yield (
            "classify",
            "early needs model full and paraboloids without dissipation; leave it out",
        )
    if lossy_or_ellipsoidal and "lyapunov" in record:
        yield "record", "lyapunov needs paraboloids without dissipation; leave it out"
    if early and {"lyapunov", "volume", "reversals"} & record:
        yield (
            "record",
            "lyapunov, volume and reversals need whole runs; leave classify.early out",
        )


def _body_clashes(bodies: AnySource) -> Iterator[tuple[str, str]]:
    if isinstance(bodies, ShapeSource):
        if bodies.samples is not None and not bodies.drawn:
            yield (
                "bodies.samples",
                "no key is a range, so all bodies are equal; leave it out",
            )
        if (bodies.weights is None) != (bodies.at is None):
            yield "bodies.weights", "weights and at belong together; give both"
        elif bodies.at is not None:
            sides = (bodies.sizes[name][0] for name in ("length", "width"))
            if (
                sum(
                    (2 * x / side) ** 2
                    for x, side in zip(bodies.at, sides, strict=True)
                )
                > 1
            ):
                yield (
                    "bodies.at",
                    "the weight lies beyond the edge of the flat side; move it",
                )
        return
    if bodies.surface == "paraboloid" and bodies.c is not None:
        yield "bodies.c", "a paraboloid has no c; take surface: ellipsoid"
    # A table may have a column c.
    if (
        bodies.surface == "ellipsoid"
        and not bodies.has_semi_axis
        and bodies.source != TABLE
    ):
        yield (
            "bodies.surface",
            "an ellipsoid needs its vertical semi-axis; give c, such as c: 2",
        )
    for name in ("overrides", "base", "axes"):
        if len(_given(getattr(bodies, name, None)) & {*ANGLES}) > 1:
            yield (
                f"bodies.{name}",
                "xi, xi_deg and minus_xi_deg exclude each other; keep one",
            )
    if isinstance(bodies, SdSource):
        ranges, target = bodies.ranges, bodies.target
        if ranges.phi[1] >= ranges.theta[0]:
            yield (
                "bodies.ranges.phi",
                "phi >= theta is possible; separate the two ranges",
            )
        if ranges.minus_xi_deg[1] == 0:
            yield (
                "bodies.ranges.minus_xi_deg",
                "only xi = 0 is possible, which never reverses",
            )
        if bodies.c and bodies.c[0] <= ranges.theta[1]:
            yield (
                "bodies.c",
                "c <= theta is possible, and such a body lies on its side; raise c",
            )
        if target and len(given := _given(target) & {"K_r", "K_p"}) != 1:
            several = "K_r and K_p exclude each other; keep one"
            yield (
                "bodies.target",
                several if given else "neither K_r nor K_p is given; add one",
            )
        if target and bodies.draw != "random":
            yield (
                "bodies.target",
                "only random draws can meet a target; take draw: random",
            )
    if isinstance(bodies, GridSource):
        base, axes = bodies.base, _given(bodies.axes)
        needed = {"gamma", "theta", "phi", "xi"}
        needed |= {"alpha", "beta"} if base.f_sd is None else {"f_sd"}
        if base.given().keys() != (set() if base.preset else needed):
            yield (
                "bodies.base",
                "give a preset alone, or gamma theta phi xi with alpha beta or with "
                "f_sd",
            )
        for name in sorted(
            axes & ({"f_sd"} if base.f_sd is None else {"alpha", "beta"})
        ):
            yield (
                "bodies.axes",
                f"{name} cannot vary: f_sd stands in place of alpha and beta",
            )
        if bodies.c and ("c" in axes or (len(bodies.c) > 1 and bodies.refine)):
            yield (
                "bodies.c",
                "c clashes with axes.c or refine; write axes: {c: ...} alone",
            )


def _given(section: Base | None) -> set[str]:
    return set() if section is None else {*section.model_dump(exclude_none=True)}
