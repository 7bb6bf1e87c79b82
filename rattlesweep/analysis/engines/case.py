"""One run as a document: what another program needs to repeat it, and what to expect.

The document is in SI units and in axes that physics engines use, with z up.  Its times
come from two methods at their tightest tolerance.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict
from scipy.spatial.transform import Rotation

from rattlesweep.analysis.onerun.course import Course, PreparedRun
from rattlesweep.arrays import Floats
from rattlesweep.design.batches import make_batch
from rattlesweep.design.bodies.making import missing_height
from rattlesweep.physics.si import Units
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import LOSSES

if TYPE_CHECKING:
    from rattlesweep.kernel.follow import Follower

    Columns = dict[str, Floats]

# The first gives the poses; the second checks its zeros.
BOTH_METHODS = ("dop853", "verner98")
TIGHTEST_TOL = 1e-13
# Zeros count as known while both methods agree to this, relative to the time.
AGREED = 1e-6
LISTED_ZEROS = 20
# Errors of zeros: so many differences of both methods, and at least this of the time.
ZERO_ERROR = 3.0
LEAST_ZERO_ERROR = 1e-12
POSES = 10
ASSUMED_MASS = 1.0  # of a body without a size, in kg; it changes no time
ARMED = 0.25  # share of n_0 that the spin of a tap exceeds before its zeros count
CASE_CHANNELS = (
    *("t", "n", "energy", "q0", "q1", "q2", "q3"),
    *("omega_x", "omega_y", "omega_z", "contact_x", "contact_y", "contact_z"),
)
# From the body's axes here, z down at rest, to those of a case: half a turn about x.
FLIP = np.array([1.0, -1.0, -1.0])

CONVENTIONS = {
    "units": "kg, m, s, rad, N, J",
    "world": "The plane is z = 0 and does not move; gravity points along -z.",
    "body": (
        "The origin is the centre of mass; x, y and z are principal axes of inertia, "
        "and z points up at rest."
    ),
    "surface": (
        "Its axes are turned about the body's z axis by `angle`, counterclockwise seen "
        "from above: the smaller radius of curvature lies along the turned x axis, the "
        "larger along the turned y axis, and the third semi-axis is vertical."
    ),
    "quaternion": (
        "Unit quaternion from body to world axes, scalar first; q and -q are the same."
    ),
    "velocity": "Velocity of the centre of mass along the world's axes.",
    "omega": "Angular velocity along the body's axes.",
    "spin": (
        "Vertical component of the angular velocity; positive is counterclockwise seen "
        "from above."
    ),
    "rolling": (
        "The contact point of the body has no velocity at launch: the velocity of the "
        "centre of mass follows from omega. It stays so unless the friction has a "
        "coefficient and is not enough."
    ),
    "first_reversal": (
        "First zero of the spin after its size has exceeded `counts_above`, which is 0 "
        "for a body that is launched with a spin. Pivoting friction may hold the spin "
        "at zero; the zero is then the time at which it leaves to the other side."
    ),
    "direction": (
        "In the steady direction the slower oscillation grows and the spin lasts "
        "longer; in the unsteady direction the faster oscillation grows."
    ),
    "error": (
        "Bound of the numerical error of a time: three times the difference of the two "
        "methods, and at least 1e-12 of the time."
    ),
}

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]


class DocumentPart(BaseModel):
    """A part of the document."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, use_attribute_docstrings=True
    )


class LowerSurface(DocumentPart):
    """The lower surface of the body."""

    shape: Literal["ellipsoid", "paraboloid"]
    radii: tuple[float, float]
    """Radii of curvature at the lowest point, m."""
    angle: float
    """Angle by which its axes are turned, rad."""
    semi_axes: Vector | None
    """Semi-axes of an ellipsoid, m."""
    centre: Vector | None
    """Centre of an ellipsoid in body axes, m."""
    rim: float | None
    """Height over the lowest point where the surface ends, m."""


class Body(DocumentPart):
    """The rigid body."""

    mass: float
    """kg"""
    height: float
    """Height of the centre of mass at rest, m."""
    inertia: Vector
    """Principal moments about the centre of mass, kg m2."""
    surface: LowerSurface
    parameters: dict[str, float]
    """The same body in rattlesweep, in units of mass, height and gravity."""


class LossConstant(DocumentPart):
    """A constant of dissipation other than sliding friction."""

    value: float
    unit: str
    meaning: str


class Plane(DocumentPart):
    """What the plane does to the body."""

    gravity: float
    """m/s2"""
    friction: float | None
    """Coefficient of sliding friction; null for a plane that always holds."""
    losses: dict[str, LossConstant]


class Start(DocumentPart):
    """The state at time zero."""

    position: Vector
    """Centre of mass, m."""
    quaternion: Quaternion
    velocity: Vector
    """m/s"""
    omega: Vector
    """rad/s"""


class Zero(DocumentPart):
    """A zero of the spin."""

    time: float
    """s"""
    error: float
    """s"""


class Method(DocumentPart):
    """A method of integration and what it found."""

    method: str
    tol: float
    steps: int
    first_reversal: float | None
    """s"""


class ContactExtremes(DocumentPart):
    """Extremes of the contact force up to the first reversal."""

    friction: float
    """Largest ratio of tangential to normal force."""
    least_normal: float
    """Least normal force, N."""


class Pose(DocumentPart):
    """The body at some time."""

    time: float
    """s"""
    quaternion: Quaternion
    omega: Vector
    """rad/s"""
    spin: float
    """rad/s"""
    energy: float
    """J, zero at rest upright"""


class Expected(DocumentPart):
    """What a program should find."""

    spun: Literal["counterclockwise", "clockwise", "without spin"]
    direction: Literal["steady", "unsteady"] | None
    counts_above: float
    """rad/s"""
    first_reversal: Zero | None
    until: float
    """Time to which zeros were searched, s."""
    zeros: list[Zero]
    """The first zeros of the spin, as far as both methods agree."""
    slides: list[tuple[float, float]]
    """Begin and end of each slide up to the first reversal, s."""
    contact: ContactExtremes
    energy: float
    """At launch, J; zero at rest upright."""
    poses: list[Pose]
    """Ten times, evenly spaced up to the first reversal."""


class EngineCase(DocumentPart):
    """A run of a rattleback that another program can repeat."""

    format: Literal["rattlesweep engine case 1"] = "rattlesweep engine case 1"
    name: str
    about: str
    conventions: dict[str, str]
    body: Body
    plane: Plane
    launch: Start
    expected: Expected
    methods: list[Method]
    made_by: str

    def to_json(self) -> str:
        """Return the document as text."""
        return (
            json.dumps(self.model_dump(mode="json"), indent=1, allow_nan=False) + "\n"
        )


def case_schema() -> dict[str, Any]:
    """Return the JSON Schema of the document."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **EngineCase.model_json_schema(mode="serialization"),
    }


def make_case(
    run: PreparedRun, name: str, about: str = "", height: float | None = None
) -> EngineCase:
    """Integrate a run by two methods, and return its document.

    `height` is that of the centre of mass of a body without a size, in m; a
    ConfigError is raised if such a body has none.
    """
    if run.model != "full":
        raise ConfigError(f"model: {run.model} has no moving body; leave it out")
    units = _units(run, height)
    if run.units is None:
        about = (
            f"{about} The size and the mass of {ASSUMED_MASS:g} kg are chosen.".strip()
        )
    first, second = (_followed(run, method) for method in BOTH_METHODS)
    reversal, other = (_first_reversal(run, follower) for follower in (first, second))
    end = run.t_end
    if reversal is not None:
        end = reversal
    course = Course(
        _by(run, BOTH_METHODS[0], end),
        CASE_CHANNELS,
        times=np.linspace(0.0, end, 1 + POSES),
    )
    columns = course.columns()
    poses = [_pose(columns, row, units) for row in range(1 + POSES)]
    time = units.time
    zeros = [
        _zero(*both, units)
        for both in zip(first.zeros, second.zeros, strict=False)
        if abs(both[0] - both[1]) <= AGREED * both[0]
    ]
    n_i = run.launch["n_i"]
    force, _ = units.sizes["M g"]
    return EngineCase(
        name=name,
        about=about,
        conventions=CONVENTIONS,
        body=_body(run, units),
        plane=_plane(run, units),
        launch=_start(columns, units),
        expected=Expected(
            spun=_turning(n_i),
            direction=_direction(n_i, run.body["xi"]),
            counts_above=_counts_above(run) / time,
            first_reversal=_reversal(reversal, other, units),
            until=run.t_end * time,
            zeros=zeros[:LISTED_ZEROS],
            slides=[(begin * time, stop * time) for begin, stop in course.slides],
            contact=ContactExtremes(
                friction=course.friction, least_normal=force * course.least_normal
            ),
            energy=poses[0].energy,
            poses=poses[1:],
        ),
        methods=[
            Method(
                method=method,
                tol=TIGHTEST_TOL,
                steps=follower.n_steps,
                first_reversal=None if found is None else found * time,
            )
            for method, follower, found in zip(
                BOTH_METHODS, (first, second), (reversal, other), strict=True
            )
        ],
        made_by=f"rattlesweep {version('rattlesweep')}",
    )


def _units(run: PreparedRun, height: float | None) -> Units:
    """Return the units of a body; one without a size has those of its height."""
    needed = missing_height(run.units, height)
    if needed is not None:
        return Units(ASSUMED_MASS, needed)
    assert run.units is not None
    return run.units


def _by(run: PreparedRun, method: str, t_end: float) -> PreparedRun:
    """Return a run up to a time by a method at its tightest tolerance."""
    steps = {"method": method, "tol": TIGHTEST_TOL, "dt": None, "accuracy": None}
    integrator = run.config.integrator.model_copy(update=steps)
    launches = replace(run.launches, horizon=np.array([t_end]))
    return replace(
        run,
        config=run.config.model_copy(update={"integrator": integrator}),
        launches=launches,
        batch=make_batch(launches, run.model),
    )


def _followed(run: PreparedRun, method: str) -> Follower:
    """Integrate a run to its horizon; raise a ConfigError if it fails."""
    course = Course(_by(run, method, run.t_end), points=2)
    course.columns()
    follower = course.follower
    if follower.status.label != "ok":
        raise ConfigError(
            f"the run ends at t = {follower.t:g}: {follower.status.meaning}; shorten "
            "t_end, or take another launch"
        )
    return follower


def _counts_above(run: PreparedRun) -> float:
    """Return the spin after which zeros count, in ``sqrt(g/a)``."""
    if run.launch["n_i"] != 0:
        return 0.0
    return ARMED * float(run.launches.n_0[0])


def _first_reversal(run: PreparedRun, follower: Follower) -> float | None:
    """Return the first zero that counts, None if there is none."""
    counted = follower.zeros if run.launch["n_i"] != 0 else follower.reversals
    return counted[0] if counted else None


def _reversal(first: float | None, second: float | None, units: Units) -> Zero | None:
    """Return the first reversal; raise a ConfigError if the methods disagree on it."""
    if first is None and second is None:
        return None
    if first is None or second is None or abs(first - second) > AGREED * first:
        raise ConfigError(
            "the methods find different first reversals, since the run amplifies "
            "errors; it is no reference, so take another launch or a shorter t_end"
        )
    return _zero(first, second, units)


def _zero(first: float, second: float, units: Units) -> Zero:
    error = max(ZERO_ERROR * abs(first - second), LEAST_ZERO_ERROR * first)
    return Zero(time=first * units.time, error=error * units.time)


def _turning(n_i: float) -> Literal["counterclockwise", "clockwise", "without spin"]:
    if n_i == 0:
        return "without spin"
    return "counterclockwise" if n_i > 0 else "clockwise"


def _direction(n_i: float, xi: float) -> Literal["steady", "unsteady"] | None:
    if n_i == 0:
        return None
    return "unsteady" if n_i * xi < 0 else "steady"


def rim_of(run: PreparedRun) -> float | None:
    """Return the height of a body's rim in units of ``a``, None without a rim."""
    rims = run.launches.bodies.rim
    if not np.isfinite(rims).any():
        return None
    return float(rims[0])


def _body(run: PreparedRun, units: Units) -> Body:
    """Return the body in SI units."""
    body = run.body
    size = units.length
    moments = body["alpha"] - 1, body["beta"] - 1, body["gamma"]
    unit_of_inertia, _ = units.sizes["M a^2"]
    c = body.get("c")
    rim = rim_of(run)
    semi_axes = None
    centre = None
    if c is not None:
        across = math.sqrt(c / body["theta"])
        along = math.sqrt(c / body["phi"])
        semi_axes = size * across, size * along, size * c
        centre = 0.0, 0.0, size * (c - 1)
    surface = LowerSurface(
        shape="paraboloid" if c is None else "ellipsoid",
        radii=(size / body["theta"], size / body["phi"]),
        # Angles are clockwise where z points down.
        angle=-body["xi"],
        semi_axes=semi_axes,
        centre=centre,
        rim=None if rim is None else size * rim,
    )
    ixx, iyy, izz = (unit_of_inertia * moment for moment in moments)
    return Body(
        mass=units.mass,
        height=size,
        inertia=(ixx, iyy, izz),
        surface=surface,
        parameters=body,
    )


def _plane(run: PreparedRun, units: Units) -> Plane:
    """Return gravity and friction in SI units."""
    losses = {name: float(values[0]) for name, values in run.launches.losses.items()}
    friction = losses.pop("mu", None)
    if friction is not None and not math.isfinite(friction):
        friction = None
    in_si = {}
    for name, value in losses.items():
        if value > 0:
            # A coefficient of friction has no unit.
            size, unit = units.sizes.get(LOSSES[name].unit, (1.0, "1"))
            meaning = LOSSES[name].meaning
            in_si[name] = LossConstant(value=size * value, unit=unit, meaning=meaning)
    return Plane(gravity=units.gravity, friction=friction, losses=in_si)


def _vector(columns: Columns, name: str, row: int) -> Floats:
    """Return a vector along the axes of a case."""
    return FLIP * [float(columns[f"{name}_{axis}"][row]) for axis in "xyz"]


def _three(vector: Floats) -> Vector:
    x, y, z = vector.tolist()
    return x, y, z


def _quaternion(columns: Columns, row: int) -> Quaternion:
    w, x, y, z = (float(columns[f"q{k}"][row]) for k in range(4))
    # The product with half a turn about x.
    return x, -w, -z, y


def _start(columns: Columns, units: Units) -> Start:
    """Return the state at launch, in which the contact point does not move."""
    quaternion = _quaternion(columns, 0)
    w, x, y, z = quaternion
    to_world = Rotation.from_quat([x, y, z, w])
    contact = units.length * _vector(columns, "contact", 0)
    omega = _vector(columns, "omega", 0) / units.time
    height = -to_world.apply(contact)[2]
    return Start(
        position=(0.0, 0.0, float(height)),
        quaternion=quaternion,
        velocity=_three(to_world.apply(np.cross(contact, omega))),
        omega=_three(omega),
    )


def _pose(columns: Columns, row: int, units: Units) -> Pose:
    size, _ = units.sizes["M g a"]
    omega = _vector(columns, "omega", row) / units.time
    return Pose(
        time=float(columns["t"][row]) * units.time,
        quaternion=_quaternion(columns, row),
        omega=_three(omega),
        spin=float(columns["n"][row]) / units.time,
        energy=size * float(columns["energy"][row]),
    )
