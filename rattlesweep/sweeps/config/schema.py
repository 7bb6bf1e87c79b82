"""What a sweep is, as frozen models. Units are M = a = g = 1: times in sqrt(a/g)."""

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from types import SimpleNamespace
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.config.bodies import GridSource, PresetSource, SdSource, TableSource
from rattlesweep.sweeps.config.fields import (
    MAX_SPEED,
    MAX_TIME,
    TABLE,
    AngularVelocity,
    Base,
    OscillationNumbers,
    SpinNumbers,
    UnitVector,
    check_one,
    losses,
    no_repeats,
    word_or_number,
)
from rattlesweep.sweeps.config.integrator import Integrator
from rattlesweep.sweeps.config.places import Places, Problem, dotted

MAX_CASES = 100_000

Bodies = Annotated[
    SdSource | PresetSource | TableSource | GridSource, Field(discriminator="source")
]
Psi = Annotated[
    Annotated[Literal["relevant", "pitch", "roll"], Tag("word")]
    | Annotated[Annotated[float, Field(ge=-360, le=360)], Tag("number")],
    Discriminator(word_or_number),
]
Record = Literal["energy", "contact", "windows", "lyapunov", "error", "reversals"]


class Spin(Base):
    """How bodies are launched. Every n_i is combined with every omega_xy0."""

    n_i: SpinNumbers
    """Initial spins in sqrt(g/a); positive is the unsteady direction, negative the steady, 0 a tap,
    which needs horizon.t. A number, a list, {linspace: [low, high, n]} or {logspace: [low, high,
    n]}."""
    omega_xy0: OscillationNumbers
    """Initial sizes of the oscillation's angular velocity in sqrt(g/a)."""
    psi: Psi = "relevant"
    """Direction of the oscillation: the relevant mode (pitch for n_i >= 0, roll for n_i < 0), the
    pitch mode, the roll mode, or an angle from the x axis in degrees."""


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


class Horizon(Base):
    """When a run ends that has not reversed. Where several are given, the smallest counts."""

    t_rgh: float | None = Field(default=None, gt=0, le=MAX_TIME)
    """In units of t_rGH, the reversal time of Garcia and Hubbard in the spin's direction."""
    t: float | None = Field(default=None, gt=0, le=MAX_TIME)
    """A time in sqrt(a/g)."""
    t_decay: float | None = Field(default=None, gt=0, le=MAX_TIME)
    """In units of gamma/sigma, in which dissipation.sigma takes an upright spin down to 1/e; for
    runs with sigma 0 the others count."""

    @model_validator(mode="after")
    def _one_at_least(self) -> "Horizon":
        check_one(self, "t_rgh", "t", needed=self.t_decay is None, both=True)
        return self


class Dissipation(Base):
    """What takes energy from the body: nothing by default. Of several values each is combined with
    every launch; `table` stands for the column of that name in a table of bodies, which counts
    wherever there is one.
    """

    sigma: losses(MAX_SPEED) = 0.0  # type: ignore[valid-type]
    """Torque -sigma omega about the centre of mass, in M a^2 sqrt(g/a)."""
    rolling: losses(1) = 0.0  # type: ignore[valid-type]
    """Lever of the rolling resistance, in a: a moment of so much times the normal force against the
    angular velocity in the plane."""

    def values(self, name: str) -> list[float | None]:
        """Values of one of the two, in their order; None stands for those of a table."""
        value: Any = getattr(self, name)
        return [None] if value == TABLE else value if isinstance(value, list) else [value]

    @property
    def cases(self) -> list[tuple[float | None, float | None]]:
        """Both, in every combination."""
        return list(product(self.values("sigma"), self.values("rolling")))

    @property
    def kind(self) -> Literal["", "viscous", "rolling"]:
        """What some run has: nothing, sigma alone, or a rolling resistance too."""
        if any(self.values("rolling")) or self.rolling == TABLE:
            return "rolling"
        return "viscous" if any(self.values("sigma")) or self.sigma == TABLE else ""

    def __bool__(self) -> bool:
        """Whether there is any."""
        return bool(self.kind)


class Classify(Base):
    """Thresholds between the types of runs that do not reverse; whether certain ones end early."""

    ss_growth: float = Field(default=1e-3, gt=0)
    """SS if the amplitude of the relevant oscillation in a window of time never exceeds its
    smallest value in earlier windows by more than this fraction."""
    sw_departure: float = Field(default=0.05, gt=0, lt=1)
    """SW, unless SS, if n/n_i falls below 1 by more than this fraction at some time."""
    early: bool = False
    """Whether a run ends as soon as linear stability and its energy make it certain that it is SS,
    by any ss_growth; for the model full."""
    dead_energy: float = Field(default=0.01, gt=0, lt=1)
    """With dissipation: D, unless R, if less than this fraction of the launch's energy is left."""

    @property
    def thresholds(self) -> dict[str, float]:
        """What decides between types of runs that are stored."""
        return self.model_dump(exclude={"early"})


class Stop(Base):
    """When there are enough samples; a case has them when all that is given is met."""

    fraction: float | None = Field(default=None, gt=0, lt=0.5)
    """Half the width of the 95 % interval of every type's share."""
    t_r: float | None = Field(default=None, gt=0, lt=1)
    """Half the width of the 95 % interval of the mean t_r of type R, relative to it."""

    @model_validator(mode="after")
    def _one_at_least(self) -> "Stop":
        check_one(self, "fraction", "t_r", both=True)
        return self


def _is_plain(config: Any) -> bool:
    """Whether, as far as is known, bodies are paraboloids and lose nothing."""
    return not config.dissipation and not (config.bodies and config.bodies.ellipsoidal)


def _has_goal(config: Any) -> bool:
    """Whether, as far as is known, an error of t_r is asked for."""
    return getattr(getattr(config, "integrator", None), "goal", None) is not None


class Config(Base):
    """A sweep: which bodies, launched how, integrated with what, and written where."""

    name: str = "sweep"
    """Name of the sweep; also of its directory in out/."""
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """All draws depend on this, the case and the sample."""
    bodies: Bodies
    """Where parameter sets come from."""
    stop: Stop | None = None
    """Cases are given more samples, in whole blocks, until each has enough or all of
    `bodies.samples`; null: all at once."""
    launch: State | None = None
    """The full state that bodies are launched from, instead of a spin."""
    spin: Spin | None = Field(default=None, validate_default=True)
    """How bodies are launched; null where launch is given, or a table says it row by row."""
    model: Literal["full", "reduced", "gh"] = "full"
    """full: all six variables; reduced: the three of the simplified dynamics; gh: the closed form
    of Garcia and Hubbard, without integration."""
    horizon: Horizon = Field(default_factory=lambda: Horizon(t_rgh=5.0))
    """When runs end that do not reverse."""
    dissipation: Dissipation = Field(default_factory=lambda: Dissipation(), validate_default=True)
    """What takes energy from the bodies of the full model."""
    integrator: Integrator = Field(default_factory=lambda: Integrator())
    """How states move."""
    classify: Classify = Field(default_factory=lambda: Classify())
    """Thresholds between types of runs."""
    record: list[Record] = Field(
        default_factory=list, validate_default=True, json_schema_extra={"uniqueItems": True}
    )
    """Extra columns; each costs time. With reversals runs go on behind their first one, to the
    horizon."""
    block_size: int = Field(default=4_000, ge=1, le=200_000)
    """Runs per block, that is, per output file."""
    output: str | None = Field(default=None, min_length=1, pattern=r"^[^\x00]*$")
    """Directory; null: out/<name>."""

    _places: Places = PrivateAttr(default_factory=Places)

    rules = (
        ("name", lambda c: not c.name.strip() or c.name in (".", ".."),
         "the name is empty or dots only; write a word"),
        ("name", lambda c: not c.name.isprintable() or "/" in c.name or "\\" in c.name,
         "the name has a slash or a control character; write a plain word"),
        ("stop", lambda c: c.stop and c.bodies and c.bodies.source != "sd",
         "bodies of source {bodies.source} are no samples of which there could be more; leave it "
         "out, or take source: sd"),
        ("stop", lambda c: c.stop and getattr(c.bodies, "draw", None) == "saltelli",
         "samples of draw: saltelli come seven at a time, and say less than as many others of when "
         "there are enough; leave it out, or take draw: sobol"),
        ("spin", lambda c: c.spin and c.launch,
         "spin and launch are both given; keep one of them"),
        ("spin", lambda c: c.spin is None and c.launch is None and c.bodies
         and c.bodies.source != "table",
         "missing; bodies of source {bodies.source} need a spin with n_i and omega_xy0, or a "
         "launch with omega and u"),
        *(("dissipation", lambda c, name=name: getattr(c.dissipation, name) == TABLE and c.bodies
           and c.bodies.source != "table",
           f"{name} is that of a table, and the bodies are of source {{bodies.source}}; give a "
           "number, or several")
          for name in Dissipation.model_fields),
        ("dissipation", lambda c: c.horizon and c.horizon.t_decay is not None
         and not any(c.dissipation.values("sigma"))
         and not (c.bodies and c.bodies.source == "table"),
         "horizon.t_decay is in units of gamma/sigma, and sigma is 0; give sigma, or another "
         "horizon"),
        ("dissipation", lambda c: c.dissipation and c.model and c.model != "full",
         "the model {model} conserves energy; take model: full, or leave it out"),
        ("integrator", lambda c: c.integrator.goal is not None and c.model == "gh",
         "the model gh is a closed form whose t_r has no error to limit; leave accuracy out"),
        ("classify", lambda c: c.classify.early and c.model and c.model != "full",
         "early is for the model full, and the model {model} has no stable spin by which a run "
         "could be certain to be SS; leave early out"),
        ("classify", lambda c: c.classify.early and not _is_plain(c),
         "early is for paraboloids without dissipation; leave it out"),
        *(("record", lambda c, goal=goal: "reversals" in c.record
           and (_has_goal(c) if goal else "error" in c.record),
           f"{goal or 'error'} compares runs at their first reversal, behind which reversals "
           "follows them; keep one of the two")
          for goal in ("integrator.accuracy of t_r", "")),
        *(("record", lambda c, word=word: word in c.record and c.classify and c.classify.early,
           f"{word} {what} of a run up to its horizon, and classify.early ends runs before; leave "
           "one of them out")
          for word, what in (("lyapunov", "is the exponent"), ("reversals", "are those"))),
        ("record", lambda c: "lyapunov" in c.record and not _is_plain(c),
         "lyapunov is for paraboloids without dissipation; leave it out"),
    )  # fmt: skip

    @field_validator("spin", "dissipation")
    @classmethod
    def _few_enough(cls, value: Any, info: ValidationInfo) -> Any:
        known = {**info.data, str(info.field_name): value}
        target, spin = getattr(known.get("bodies"), "target", None), known.get("spin")
        lost: Dissipation = known.get("dissipation") or Dissipation()
        names = {"targets": target.values if target else [0]}
        names |= {} if spin is None else {"n_i": spin.n_i, "omega_xy0": spin.omega_xy0}
        names |= {name: lost.values(name) for name in ("sigma", "rolling")} if lost else {}
        if (cases := math.prod(map(len, names.values()))) > MAX_CASES:
            most = f"at most {MAX_CASES} are possible"
            raise ValueError(f"{cases} cases ({' x '.join(names)}); {most}")
        return value

    @field_validator("record")
    @classmethod
    def _in_order(cls, record: list[str], info: ValidationInfo) -> list[str]:
        found = no_repeats(record) + ["error"] * _has_goal(SimpleNamespace(**info.data))
        return [name for name in get_args(Record) if name in found]

    @property
    def parts(self) -> list[str]:
        """Parts of the columns of `runs` that not every sweep has."""
        own = {
            "tol": self.integrator.goal is not None,
            "surface": self.bodies.ellipsoidal,
            "dissipation": bool(self.dissipation),
        }
        return [*self.record, *(name for name, there in own.items() if there)]

    @property
    def places(self) -> Places:
        """Where the keys stand in the file that was read."""
        return self._places

    def placed(self, places: Places) -> "Config":
        """Remember where the keys stand; returns the config itself."""
        self._places = places
        return self

    @contextmanager
    def locating(self) -> Iterator[None]:
        """Give the messages of a ConfigError from inside the places of the keys they begin with."""
        try:
            yield
        except ConfigError as error:
            raise ConfigError(map(self._located, error.messages)) from None

    def _located(self, line: str) -> str:
        name, _, message = line.partition(": ")
        parts = re.findall(r"\w+", name)
        key = tuple(int(part) if part.isdigit() else part for part in parts)
        if not key or dotted(key) != name or key[0] not in type(self).model_fields:
            return line
        return self._places.line(Problem(key, message))

    @property
    def directory(self) -> str:
        """Where results go: `output`, or the default made from the name."""
        return self.output or f"out/{self.name}"
