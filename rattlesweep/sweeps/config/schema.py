"""Schema of a config as frozen pydantic models.  Units are M = a = g = 1: times in sqrt(a/g)."""

# mypy: disable-error-code="valid-type"
# Types that functions make are types to pydantic alone.

import json
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

import numpy as np
import pydantic
from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, WrapValidator
from pydantic_core import PydanticCustomError

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.tableau import DT, MAX_STEPS, METHODS, TOL
from rattlesweep.physics.body import MAX_INERTIA
from rattlesweep.sweeps.config import Key, Places, not_one_of
from rattlesweep.units import KINDS, Quantity, split

MAX_SPEED = 1e3  # sqrt(g/a); at this spin a tilt of 1e-6 rad takes a contact force of the weight
MAX_SIGMA = 1e6  # M a^2 sqrt(g/a)
MAX_TIME = 1e30  # sqrt(a/g) or t_rGH, beyond any run; sums of such numbers stay finite
MIN_OSCILLATION = 1e-140  # sqrt(g/a); the square of a smaller one underflows
MAX_COUNT = 2**62
MAX_AXIS, MAX_CASES = 10**6, 100_000
TABLE = "table"  # word for values that stand in the rows of a table

# In the symbols of Kondo and Nakanishi (2017), each with the ends of its open interval;
# `physics.body` checks how they go together.
PARAMETERS: dict[str, tuple[float, float, str]] = {
    "alpha": (1, MAX_INERTIA, "I_xx / (M a^2) + 1, inertia about the x axis; > beta."),
    "beta": (1, MAX_INERTIA, "I_yy / (M a^2) + 1, inertia about the y axis; > 1."),
    "gamma": (0, MAX_INERTIA, "I_zz / (M a^2), inertia about the spin axis; > 0."),
    "theta": (0, 1, "Larger curvature at the bottom times a; phi < theta < 1."),
    "phi": (0, 1, "Smaller curvature at the bottom times a; 0 < phi < theta."),
    "xi": (-math.pi / 2, 0, "Skew from inertia to curvature axes in radians; negative."),
    "xi_deg": (-90, 0, "Skew from inertia to curvature axes in degrees; negative."),
    "minus_xi_deg": (0, 90, "Skew angle times -1, in degrees; between 0 and 90."),
    "c": (0, 1e9, "Vertical semi-axis of the ellipsoid over a; above theta."),
    "f_sd": (0, 0.5, "I_yy / I_zz of a shell-dumbbell body; below 0.5."),
}


def key(default: Any, words: str, **limits: Any) -> Any:
    """Return a field with its description; the default may be a function that makes it."""
    how = {"default_factory" if callable(default) else "default": default}
    return Field(**how, description=words, **limits)


class Base(pydantic.BaseModel):
    """Frozen, strict and closed model."""

    model_config = {"extra": "forbid", "frozen": True, "strict": True, "allow_inf_nan": False}

    @pydantic.model_validator(mode="before")
    @classmethod
    def _tidy(cls, data: Any) -> Any:
        """Leave out null, and take numbers for the texts that YAML 1.1, as of PyYAML, has: 1e-9."""

        def number(value: Any) -> Any:
            if isinstance(value, list):
                return [number(item) for item in value]
            for kind in (int, float) if isinstance(value, str) else ():
                with suppress(ValueError):
                    return kind(value)
            return value

        if not isinstance(data, dict):
            return data
        texts = ("name", "path", "output")
        known = {k: x for k, x in data.items() if x is not None or k not in cls.model_fields}
        return {name: x if name in texts else number(x) for name, x in known.items()}


Positive = Annotated[float, Field(gt=0)]
Time = Annotated[float, Field(gt=0, le=MAX_TIME)]
Speed = Annotated[float, Field(ge=-MAX_SPEED, le=MAX_SPEED)]
THREE = Field(min_length=3, max_length=3)
UNIQUE = Field(json_schema_extra={"uniqueItems": True})
PATH = {"min_length": 1, "pattern": r"^[^\x00]*$"}


def or_text(item: Any, text: Any, read: Callable[[str], Any]) -> Any:
    """Return the type of an item that may be given as a text, which a function reads."""
    choose = WrapValidator(lambda x, of: read(x) if isinstance(x, str) else of(x), item | text)
    return Annotated[item, choose, PlainSerializer(lambda value: getattr(value, "text", value))]


def or_word(item: Any, *words: str) -> Any:
    """Return the type of an item, or of one of some words."""

    def read(text: str) -> str:
        if text not in words:
            raise PydanticCustomError("word", not_one_of(text, words))
        return text

    return or_text(item, Literal[words], read)


def measured(kind: str, item: Any, *words: str) -> Any:
    """Return the type of a number in units of the body, a text with a unit, or one of `words`."""
    texts = Annotated[str, Field(examples=[KINDS[kind][1]])]
    return or_text(item, texts, lambda text: text if text in words else Quantity(text, kind))


def _distinct(values: list[Any]) -> list[Any]:
    if len({*values}) < len(values):
        raise ValueError("a value is repeated; give each once")
    return values


def _as_list(value: Any) -> Any:
    """Return one value, several, or evenly spaced ones as a list."""
    if not isinstance(value, dict):
        return value if isinstance(value, list) else [value]
    laws: dict[str, Any] = {"linspace": np.linspace, "logspace": np.geomspace}
    values = np.array([np.nan])
    with suppress(TypeError, ValueError, KeyError), np.errstate(all="ignore"):
        [(law, (*ends, n))] = value.items()
        (low, unit), (high, other) = (split(str(end)) for end in ends)
        if unit == other and 1 <= n <= MAX_AXIS and n == int(n) and (n == 1) == (low == high):
            values = laws[law](low, high, int(n))
    if not np.isfinite(values).all():
        words = "write {linspace: [low, high, n]} or {logspace: [low, high, n]}, ends in one unit"
        raise ValueError(f"{words} and not 0 for logspace, n a whole number up to {MAX_AXIS}")
    return [f"{x!r} {unit}" if unit else x for x in values.tolist()]


def several(item: Any) -> Any:
    """Return the type of a list of distinct numbers, given as one, some, or spaced ones."""
    many = Annotated[list[item], Field(min_length=1), UNIQUE]
    given = item | many | dict[Literal["linspace", "logspace"], Annotated[list[float | str], THREE]]
    return Annotated[many, BeforeValidator(_as_list, given), AfterValidator(_distinct)]


def interval(item: Any) -> Any:
    """Return the type of a range [low, high] that may be given as one number."""

    def rising(ends: list[float]) -> list[float]:
        if ends[0] > ends[1]:
            raise ValueError("the range is reversed; write [low, high]")
        return ends

    pair = Annotated[list[item], Field(min_length=2, max_length=2)]
    both = BeforeValidator(lambda x: x if isinstance(x, list) else [x, x], item | pair)
    return Annotated[pair, both, AfterValidator(rising)]


def parameter(name: str, kind: Callable[[Any], Any] = lambda item: item) -> Any:
    """Return the type of a body parameter, or of a kind of lists of its values."""
    low, high, meaning = PARAMETERS[name]
    item = Annotated[float, Field(gt=low, lt=high)]
    return Annotated[kind(item) | None, Field(description=meaning)]


PRESETS = "GH: the body of Garcia and Hubbard (1988); KL: that of Kane and Levinson (1982)."
Preset = Literal["GH", "KL"]
Surface = Literal["paraboloid", "ellipsoid"]
Draw = Literal["random", "sobol", "saltelli"]
Skew = Annotated[float, Field(ge=0, lt=90)]


class Surfaced(Base):
    """Bodies with a surface."""

    source: str
    surface: Surface | None = key(None, "Shape of the bottom; an ellipsoid where c is given.")
    c: parameter("c") = None

    @property
    def curved(self) -> bool:
        """Whether c is given, varies, or is the preset's own."""
        axes, base = getattr(self, "axes", self), getattr(self, "base", None)
        return bool(self.c or axes.c) or "KL" in (getattr(self, "name", ""), base and base.preset)

    @property
    def ellipsoidal(self) -> bool:
        """Whether the bodies are ellipsoids, as those with c and of the preset KL are."""
        return self.curved if self.surface is None else self.surface == "ellipsoid"


class SdRanges(Base):
    """Ranges that shell-dumbbell bodies are drawn from; the paper's Table I unless given."""

    gamma: parameter("gamma", interval) = [5.0, 15.0]
    f_sd: parameter("f_sd", interval) = [0.05, 0.15]
    theta: parameter("theta", interval) = [0.6, 0.95]
    phi: parameter("phi", interval) = [0.01, 0.1]
    # Zero may bound the skew angle, but is never drawn.
    minus_xi_deg: interval(Skew) = key([0.0, 6.0], PARAMETERS["minus_xi_deg"][2])


class Target(Base):
    """Bodies are redrawn until their torque coefficient lies close to one of these values."""

    K_r: several(Positive) | None = key(None, "Targets of the rolling coefficient; a case each.")
    K_p: several(Positive) | None = key(None, "Targets of the pitching coefficient; a case each.")
    rel_tol: float = key(1e-3, "Largest relative distance from the target.", gt=0, le=0.5)
    max_draws: int = key(10**6, "Draws after which a sample is given up.", ge=1, le=MAX_COUNT)

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
    samples: int = key(1000, "Bodies per case.", ge=1, le=MAX_COUNT)
    ranges: SdRanges = key(SdRanges, "Where the parameters are drawn from, uniformly.")
    draw: Draw = key("random", "sobol: more even; saltelli: for `rattlesweep sensitivity`.")
    target: Target | None = key(None, "Keep only bodies with this torque coefficient.")
    c: parameter("c", interval) = None

    @property
    def drawn(self) -> tuple[str, ...]:
        """Names of the parameters that are drawn from a range, in their order."""
        return (*SdRanges.model_fields, *(["c"] if self.c and self.c[0] < self.c[1] else []))

    @property
    def group(self) -> int:
        """Samples that saltelli draws together: two points, and one for each parameter."""
        return 2 + len(self.drawn)


class Overrides(Base):
    """Parameters of a body; those that replace a preset's."""

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
        return values if self.xi_deg is None else values | {"xi": math.radians(self.xi_deg)}


class PresetSource(Surfaced):
    """One body of the literature, perhaps with parameters replaced."""

    source: Literal["preset"] = key(..., "Use one named body.")
    name: Preset = key(..., PRESETS)
    overrides: Overrides = key(Overrides, "Parameters that replace the preset's.")


class TableSource(Surfaced):
    """Bodies from the rows of a table, in its order."""

    source: Literal["table"] = key(..., "Read bodies from a table.")
    path: str = key(..., "CSV or Parquet file, or a directory of Parquet files.", **PATH)


class GridBase(Overrides):
    """The body whose parameters are varied: a preset, six parameters, or a shell-dumbbell body."""

    preset: Preset | None = key(None, PRESETS)
    f_sd: parameter("f_sd") = None


AXES = ("alpha", "beta", "gamma", "f_sd", "theta", "phi", "xi", "xi_deg", "minus_xi_deg", "c")
VARYING: dict[str, Any] = {name: (parameter(name, several), None) for name in AXES}
ORDER = "Parameters that vary: every combination is a body, and the first one varies slowest."
Axes = pydantic.create_model("Axes", __base__=Base, __doc__=ORDER, **VARYING)


class Refine(Base):
    """A coarse grid first, then, level by level, only what lies between runs that differ."""

    levels: int = key(4, "Halvings from the coarse grid to the given values.", ge=1, le=16)
    by: Literal[
        "type", "t_r", "n_end", "t_end", "n_steps", "energy_drift", "n_departure", "amp_growth",
        "lyapunov", "contact_ratio_max", "n_turns",
    ] = key("type", "What must not differ within a cell; perhaps a column of numbers.")  # fmt: skip
    tol: float = key(0.05, "How far a number may lie off its neighbours' line.", gt=0, lt=1)


class GridSource(Surfaced):
    """Every combination of some parameters' values, the others fixed."""

    source: Literal["grid"] = key(..., "Vary parameters over a grid.")
    base: GridBase = key(..., "The body whose parameters are varied.")
    axes: Axes = key(..., "Which parameters vary, over which values.")
    refine: Refine | None = key(None, "Leave out runs between others of one type.")
    c: parameter("c", several) = None

    @property
    def varying(self) -> dict[str, list[float]]:
        """The values of each axis in their order, `c` behind the others where it is one."""
        axes = vars(self.axes) | ({"c": self.c} if self.c and len(self.c) > 1 else {})
        return {name: values for name, values in axes.items() if values is not None}


Length, Mass = (interval(measured(kind, Positive)) for kind in ("length", "mass"))
Angle = interval(measured("angle", Annotated[float, Field(gt=-math.pi / 2, lt=math.pi / 2)]))


class ShapeSource(Base):
    """Bodies of a simple shape, which have a size; drawn from the keys that are ranges."""

    source: Literal["shape"] = key(..., "Make bodies of a shape, with a size.")
    shape: Literal["half_ellipsoid"] = key("half_ellipsoid", "Solid and uniform, flat side up.")
    length: Length = key(..., "Longer side of the flat face, in m or with a unit.")
    width: Length = key(..., "Shorter side of the flat face, in m or with a unit.")
    height: Length = key(..., "From the lowest point to the flat face, in m or with a unit.")
    mass: Mass = key(..., "In kg or with a unit.")
    skew: Angle = key(..., "Angle between the axes of inertia and surface, in rad or with a unit.")
    samples: int | None = key(None, "Bodies per case (1000) if a key is a range.", ge=1, le=2**62)

    ellipsoidal: ClassVar[bool] = True  # its bottom is one

    @property
    def sizes(self) -> dict[str, list[float]]:
        """The range of each key in SI units."""
        return {name: getattr(self, name) for name in ("length", "width", "height", "mass", "skew")}

    @property
    def drawn(self) -> list[str]:
        """Names of the keys that are drawn from a range."""
        return [name for name, (low, high) in self.sizes.items() if low < high]


SOURCES = {"sd": SdSource, "preset": PresetSource, "table": TableSource, "grid": GridSource,
           "shape": ShapeSource}  # fmt: skip
Bodies = SdSource | PresetSource | TableSource | GridSource | ShapeSource

Unsigned = Annotated[Speed, AfterValidator(lambda spin: spin + 0.0)]  # a zero has no sign
Oscillation = Annotated[float, Field(ge=MIN_OSCILLATION, le=MAX_SPEED)]
Direction = or_word(Annotated[float, Field(ge=-360, le=360)], "relevant", "pitch", "roll")
Spins, Pushes = (several(measured("spin", item)) for item in (Unsigned, Oscillation))


class Spin(Base):
    """How bodies are launched. Every n_i is combined with every omega_xy0."""

    n_i: Spins = key(..., "Initial spins in sqrt(g/a) or with a unit; negative: steady; 0: a tap.")
    omega_xy0: Pushes = key(..., "Initial oscillations in sqrt(g/a), or with a unit.")
    psi: Direction = key("relevant", "Mode (relevant: pitch for n_i >= 0, else roll) or degrees.")


NO_UNIT_VECTOR = "u must be a vector of length 1 with u_z below 0, as [0, 0, -1]"


def normalised(u: Any) -> Floats:
    """Return vectors with length 1, NaN those that are longer or shorter or point downwards."""
    u = np.asarray(u, float)
    length = np.linalg.norm(u, axis=-1, keepdims=True)
    off = np.abs(length - 1)
    # A vector that is normalised to rounding keeps its bits.
    return np.where((off <= 1e-3) & (u[..., 2:] < 0), u / np.where(off < 1e-15, 1, length), np.nan)


def _unit(u: list[float]) -> list[float]:
    found: list[float] = normalised(u).tolist()
    if math.isnan(found[0]):
        raise ValueError(NO_UNIT_VECTOR)
    return found


Upwards = Annotated[list[float], THREE, AfterValidator(_unit)]


class State(Base):
    """A full state that all bodies are launched from, in components along the body's axes."""

    omega: Annotated[list[Speed], THREE] = key(..., "Angular velocity [x, y, z] in sqrt(g/a).")
    u: Upwards = key([0, 0, -1], "Vertical unit vector [x, y, z]; [0, 0, -1] is upright.")


class Horizon(Base):
    """When a run ends that has not reversed. Where several are given, the smallest counts."""

    t_rgh: Time | None = key(None, "In units of t_rGH in the spin's own direction.")
    t: measured("time", Time) | None = key(None, "A time in sqrt(a/g), or with a unit.")
    t_decay: Time | None = key(None, "In units of gamma/sigma, of dissipation.sigma.")


Torque = measured("torque per spin", Annotated[float, Field(ge=0, le=MAX_SIGMA)], TABLE)
Lever = measured("length", Annotated[float, Field(ge=0, le=1)], TABLE)


class Dissipation(Base):
    """What takes energy from the body; lists are cases, `table` stands for a table's column."""

    sigma: several(Torque) = key([0.0], "Torque over -omega, in M a^2 sqrt(g/a) or with a unit.")
    rolling: several(Lever) = key([0.0], "Moment over the normal force, in a or with a unit.")

    def values(self, name: str) -> list[float | None]:
        """Return the values of one of the two in their order; None stands for a table's."""
        return [None if value == TABLE else value for value in getattr(self, name)]

    @property
    def kind(self) -> Literal["", "viscous", "rolling"]:
        """What some run has: nothing, sigma alone, or a rolling resistance too."""
        return "rolling" if self.rolling != [0] else "viscous" if self.sigma != [0] else ""

    def __bool__(self) -> bool:
        return bool(self.kind)


class Classify(Base):
    """Thresholds between the types of runs that do not reverse; whether certain ones end early."""

    ss_growth: float = key(1e-3, "SS if amplitudes grow by less than this fraction.", gt=0)
    sw_departure: float = key(0.05, "Else SW if n/n_i falls below 1 by this fraction.", gt=0, lt=1)
    early: bool = key(False, "Whether runs of the model full end once they are certain to be SS.")
    dead_energy: float = key(0.01, "D, unless R, below this fraction of energy.", ge=1e-6, lt=1)

    @property
    def thresholds(self) -> dict[str, float]:
        """The thresholds between types of stored runs."""
        return self.model_dump(exclude={"early"})

    @property
    def as_text(self) -> str:
        """The thresholds as JSON, as each file of rows tells by which ones it was typed."""
        return json.dumps(self.thresholds, sort_keys=True)


class Stop(Base):
    """When there are enough samples, by 95 % intervals; where both are given, both are met."""

    fraction: float | None = key(None, "Half the width for every type's fraction.", gt=0, lt=0.5)
    t_r: float | None = key(None, "Half the width for the mean t_r, relative to it.", gt=0, lt=1)


# Words for a method and its tol; docs/accuracy.md has their errors.
ACCURACIES = {"draft": ("dop853", 1e-6), "standard": ("dop853", TOL),
              "reference": ("verner98", 1e-12)}  # fmt: skip


class AccuracyGoal(Base):
    """The error that the results may have; runs are integrated as tightly as that takes."""

    t_r: float = key(..., "Relative error of the times of reversal.", ge=1e-12, le=1e-3)


Accuracy = or_word(AccuracyGoal, *ACCURACIES)


class Integrator(Base):
    """How states move: with error control (tol) or in steps of one size (dt)."""

    method: Literal["dop853", "dopri5", "verner98", "rk4"] = key("dop853", "Name of the method.")
    accuracy: Accuracy | None = key(None, "A word for method and tol, or {t_r: ...} for tol.")
    tol: float | None = key(None, "Adaptive: error per step (default 1e-09).", ge=1e-15, le=0.01)
    dt: float | None = key(None, "Others: step in sqrt(a/g) (default 0.002).", gt=0)
    max_steps: int = key(MAX_STEPS, "Steps after which a run is given up.", ge=1, le=MAX_COUNT)

    @property
    def goal(self) -> float | None:
        """Relative error that t_r may have, if the config asks for one."""
        return self.accuracy.t_r if isinstance(self.accuracy, AccuracyGoal) else None

    @pydantic.model_validator(mode="before")
    @classmethod
    def _spell_out(cls, data: Any) -> Any:
        """Write method, tol and dt out, so that configs of one meaning are equal."""
        if not isinstance(data, dict):
            return data
        data = {name: value for name, value in data.items() if value is not None}
        word, method = data.get("accuracy"), data.get("method", "dop853")
        if isinstance(word, str) and word in ACCURACIES and not {"method", "tol", "dt"} & {*data}:
            del data["accuracy"]
            data["method"], data["tol"] = ACCURACIES[word]
        elif word is None and isinstance(method, str) and method in METHODS:
            data = ({"tol": TOL} if METHODS[method].adaptive else {"dt": DT}) | data
        return data


Record = Literal["energy", "contact", "windows", "lyapunov", "volume", "error", "reversals"]
Model = Literal["full", "reduced", "gh"]
Records = Annotated[list[Record], AfterValidator(_distinct), UNIQUE]


class Config(Base):
    """A sweep: which bodies, launched how, integrated with what, and written where."""

    name: str = key("sweep", "Also of its directory in out/; unless given, that of the file.")
    seed: int = key(0, "All draws depend on this, the case and the sample.", ge=0, lt=2**63)
    bodies: Bodies = key(..., "Where parameter sets come from.", discriminator="source")
    stop: Stop | None = key(None, "When a case has enough samples; null: at `bodies.samples`.")
    launch: State | None = key(None, "The full state that bodies are launched from.")
    spin: Spin | None = key(None, "How bodies are launched, unless launch or a table says it.")
    model: Model = key("full", "Five variables; reduced: three; gh: Garcia and Hubbard's formula.")
    horizon: Horizon = key(lambda: Horizon(t_rgh=5.0), "When runs end that do not reverse.")
    dissipation: Dissipation = key(Dissipation, "What takes energy from bodies of model full.")
    integrator: Integrator = key(Integrator, "How states move.")
    classify: Classify = key(Classify, "Thresholds between types of runs.")
    record: Records = key(list, "Extra columns; with reversals, runs go on to the horizon.")
    output: str | None = key(None, "Directory; null: out/<name>.", **PATH)

    _places: Places = pydantic.PrivateAttr(default_factory=Places)

    @pydantic.field_validator("name")
    @classmethod
    def _plain_word(cls, name: str) -> str:
        if name.strip() in ("", ".", "..") or not name.isprintable() or {"/", "\\"} & {*name}:
            raise ValueError("is empty, or has a slash or a control character; write a plain word")
        return name

    @pydantic.model_validator(mode="after")
    def _order_record(self) -> Self:
        """Put the words of `record` in order, with those that are implied."""
        found = {*self.record, *(["error"] if self.integrator.goal else [])}
        self.__dict__["record"] = [name for name in get_args(Record) if name in found]
        return self

    @property
    def parts(self) -> list[str]:
        """Parts of the columns of `runs` that not every sweep has."""
        own = {"tol": self.integrator.goal, "turns": {"error", "reversals"} <= {*self.record},
               "surface": self.bodies.ellipsoidal, "dissipation": self.dissipation}  # fmt: skip
        return [*self.record, *(name for name, there in own.items() if there)]

    @property
    def in_si(self) -> dict[str, list[Quantity]]:
        """Values with units, by the names of what they stand for in a run."""
        given = {"n_i": self.spin.n_i, "omega_xy0": self.spin.omega_xy0} if self.spin else {}
        given |= {name: self.dissipation.values(name) for name in Dissipation.model_fields}
        given["t_end"] = [self.horizon.t]
        found = ((k, [x for x in v if isinstance(x, Quantity)]) for k, v in given.items())
        return {name: values for name, values in found if values}

    @property
    def directory(self) -> str:
        """Where results go."""
        return self.output or f"out/{self.name}"

    def line(self, key: Key, message: str) -> str:
        """Return ``file:line: key: message``, without the file for Python data."""
        return self._places.line(key, message)

    @contextmanager
    def locating(self) -> Iterator[None]:
        """Put file and line before messages of a ConfigError that begin with a dotted key."""

        def located(message: str) -> str:
            name, _, sentence = message.partition(": ")
            parts = tuple(int(x) if x.isdigit() else x for x in re.findall(r"\w+", name))
            known = rf"({'|'.join(Config.model_fields)})(\.\w+|\[\d+\])*"
            return self.line(parts, sentence) if re.fullmatch(known, name) else message

        try:
            yield
        except ConfigError as error:
            raise ConfigError(map(located, error.messages)) from None


def clashes(config: Config) -> Iterator[tuple[str, str]]:
    """Yield a dotted key and a sentence for each rule between values that is broken."""
    bodies, spin, launch, lost = config.bodies, config.spin, config.launch, config.dissipation
    horizon, integrator, record = config.horizon, config.integrator, {*config.record}
    early, full, table = config.classify.early, config.model == "full", bodies.source == TABLE
    special = lost or bodies.ellipsoidal
    yield from _body_clashes(bodies)
    sections = {
        "stop": config.stop,
        "horizon": horizon,
        "bodies.axes": getattr(bodies, "axes", None),
    }
    for name, section in sections.items():
        if section and not _count(section, *(names := type(section).model_fields)):
            yield name, f"none of {', '.join(names)} is given; add one"
    if config.stop and not getattr(bodies, "drawn", ()):
        yield "stop", f"bodies of source {bodies.source} are all there are; take source: sd"
    if config.stop and getattr(bodies, "draw", "") == "saltelli":
        yield "stop", "samples of draw: saltelli are not independent; take draw: sobol"
    if spin and launch:
        yield "spin", "spin and launch are both given; keep one of them"
    if not (spin or launch or table):
        yield "spin", "the key is missing; give n_i and omega_xy0, or a launch with omega and u"
    if launch and not any((*launch.omega, *launch.u[:2])):
        yield "launch", "the body stands upright and at rest; give it an angular velocity"
    lists = [lost.sigma, lost.rolling, *([spin.n_i, spin.omega_xy0] if spin else [])]
    lists += [bodies.target.values] if isinstance(bodies, SdSource) and bodies.target else []
    if (cases := math.prod(map(len, lists))) > MAX_CASES:
        yield "spin", f"the lists make {cases} cases; at most {MAX_CASES} are possible"
    if horizon.t_decay and not (table or any(lost.sigma)):
        yield "dissipation", "horizon.t_decay is in units of gamma/sigma; give sigma"
    if TABLE in (*lost.sigma, *lost.rolling) and not table:
        yield "dissipation", "the word table needs a table of bodies; give a number"
    if lost and not full:
        yield "dissipation", f"the model {config.model} conserves energy; take model: full"
    word: Any = integrator.accuracy
    method = integrator.method
    takes = ("accuracy" if word else "tol") if METHODS[method].adaptive else "dt"
    for name in ("accuracy", "tol", "dt"):
        if name != takes and getattr(integrator, name) is not None:
            yield f"integrator.{name}", f"{method} takes {takes} alone; leave this out"
    if isinstance(word, str) and takes == "accuracy" and integrator.tol is None:
        yield "integrator.accuracy", "a word is a method and its tol; leave out method and tol"
    if integrator.goal and (config.model == "gh" or "reversals" in record):
        yield "integrator", "accuracy is for integrated first reversals; leave it or those out"
    if early and (special or not full):
        yield "classify", "early is for full paraboloids without dissipation; leave it out"
    if special and "lyapunov" in record:
        yield "record", "lyapunov is for paraboloids without dissipation; leave it out"
    if early and {"lyapunov", "volume", "reversals"} & record:
        yield "record", "lyapunov, volume and reversals need whole runs; leave classify.early out"


def _body_clashes(bodies: Bodies) -> Iterator[tuple[str, str]]:
    if isinstance(bodies, ShapeSource):
        if bodies.samples is not None and not bodies.drawn:
            yield "bodies.samples", "no key is a range, so all bodies are alike; leave it out"
        return
    if bodies.surface == "paraboloid" and bodies.c is not None:
        yield "bodies.c", "c is given, and a paraboloid has none; take surface: ellipsoid"
    # A table may have a column c.
    if bodies.surface == "ellipsoid" and not bodies.curved and bodies.source != TABLE:
        yield "bodies.surface", "an ellipsoid needs c, its vertical semi-axis over a; give c: 2"
    for name in ("overrides", "base", "axes"):
        if _count(getattr(bodies, name, None), "xi", "xi_deg", "minus_xi_deg") > 1:
            yield f"bodies.{name}", "xi, xi_deg and minus_xi_deg exclude each other; keep one"
    if isinstance(bodies, SdSource):
        ranges, target = bodies.ranges, bodies.target
        if ranges.phi[1] >= ranges.theta[0]:
            yield "bodies.ranges.phi", "phi >= theta is possible; the ranges must not meet"
        if ranges.minus_xi_deg[1] == 0:
            yield "bodies.ranges.minus_xi_deg", "only xi = 0 is left, which never reverses"
        if bodies.c and bodies.c[0] <= ranges.theta[1]:
            yield "bodies.c", "c <= theta is possible, of bodies that lie on their sides; raise c"
        if target and _count(target, "K_r", "K_p") != 1:
            yield "bodies.target", "K_r and K_p exclude each other; give one of them"
        if target and bodies.draw != "random":
            yield "bodies.target", "only random draws can meet a target; take draw: random"
    if isinstance(bodies, GridSource):
        base = bodies.base
        axes = {name for name, values in vars(bodies.axes).items() if values is not None}
        wanted = {"gamma", "theta", "phi", "xi"}
        wanted |= {"alpha", "beta"} if base.f_sd is None else {"f_sd"}
        if base.given().keys() != (set() if base.preset else wanted):
            told = "give a preset alone, or gamma theta phi xi with alpha beta or with f_sd"
            yield "bodies.base", told
        for name in sorted(axes & ({"f_sd"} if base.f_sd is None else {"alpha", "beta"})):
            yield "bodies.axes", f"{name} cannot vary over this base; f_sd is for alpha and beta"
        if bodies.c and ("c" in axes or (len(bodies.c) > 1 and bodies.refine)):
            yield "bodies.c", "c is given beside axes.c or refine; write axes: {c: ...} alone"


def _count(section: Base | None, *names: str) -> int:
    return sum(getattr(section, name, None) is not None for name in names)
