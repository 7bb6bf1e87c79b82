"""A case as a model of MuJoCo (MJCF)."""

import math
import re
from collections.abc import Sequence

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from scipy.spatial.transform import Rotation

from rattlesweep.analysis.engines.case import EngineCase
from rattlesweep.analysis.onerun.course import PreparedRun
from rattlesweep.system.shipped import linked
from rattlesweep.words.errors import ConfigError, printable

# Friction of a plane that always holds: this, or so many times what rolling needs.
HOLDING_FRICTION = 1.0
AMPLE = 2.0
# So many times with pivoting friction, of which MuJoCo's cone takes away the more, the
# more of the sliding friction is used (docs/engines.md).
AMPLE_IN_PIVOTING = 10.0
# Time constant of the contact in sqrt(a/g), and the steps in it: the fewest that
# MuJoCo allows, with which its error is smallest (docs/engines.md).
CONTACT_TIME = 0.005
STEPS_IN_CONTACT_TIME = 2
# Of a portable model: the largest friction, since some readers clip it, and half the
# width of its plane in heights of the centre of mass, since some have no endless one.
PORTABLE_FRICTION = 2.0
PORTABLE_PLANE = 1000.0


def check_model(
    run: PreparedRun, title: str = "MuJoCo", pivots: bool = True, instead: str = ""
) -> None:
    """Raise a ConfigError if an engine has no such body or no such friction.

    `instead` ends the sentence: what else there is.
    """
    if run.config.bodies.bottom == "paraboloid":
        raise ConfigError(
            f"body: {title} has no paraboloid; give the vertical semi-axis c of an "
            f"ellipsoid{instead}"
        )
    known = ("mu", "pivot") if pivots else ("mu",)
    losses = [
        name
        for name, values in run.launches.losses.items()
        if name not in known and values[0] > 0
    ]
    if losses:
        raise ConfigError(
            f"{', '.join(losses)}: {title} has no such friction; leave it out{instead}"
        )


def to_mjcf(
    case: EngineCase, one_percent: float | None = None, portable: bool = False
) -> str:
    """Return the model of the case of a run that passed :func:`check_model`.

    `one_percent` is the time constant of the contact, in ``sqrt(a/g)``, that is known
    to give the first reversal to 1 %.  A `portable` model keeps to what most readers
    of MJCF know: a free joint with a name, Euler's integrator, a plane that ends, and
    a friction of 2 at most.

    Raises
    ------
    ConfigError
        If a portable model needs more friction.
    """
    unit_of_time = math.sqrt(case.body.height / case.plane.gravity)
    time_constant = CONTACT_TIME * unit_of_time
    friction, lever = friction_and_lever(case)
    plane_size: float = 0  # without an end
    if portable:
        friction = _portable_friction(case, friction)
        plane_size = PORTABLE_PLANE * case.body.height
    quaternion = [number + 0.0 for number in case.launch.quaternion]
    to_world = Rotation.from_quat(np.roll(quaternion, -1))  # SciPy's has w last
    # An elliptic cone: what rolling uses of the friction is lost to pivoting.
    used = min(1.0, case.expected.contact.friction / friction)
    half = case.body.surface.angle / 2
    environment = Environment(
        loader=PackageLoader("rattlesweep", "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["numbers"] = _numbers
    environment.filters["printable"] = printable
    environment.filters["comment"] = _comment
    text = environment.get_template("case.xml.j2").render(
        case=case,
        expected=case.expected,
        surface=case.body.surface,
        share=CONTACT_TIME,
        one_percent=one_percent,
        unit_of_time=unit_of_time,
        friction=friction,
        lever=lever,
        torque_left=math.sqrt(1 - used**2),
        weight=case.body.mass * case.plane.gravity,
        time_constant=time_constant,
        timestep=time_constant / STEPS_IN_CONTACT_TIME,
        portable=portable,
        plane_size=plane_size,
        quaternion=quaternion,
        omega_of_world=to_world.apply(case.launch.omega),
        turned=(math.cos(half), 0.0, 0.0, math.sin(half)),
    )
    return linked(text)


def friction_and_lever(case: EngineCase) -> tuple[float, float]:
    """Return the coefficient of friction of a case, and the lever of pivoting in m.

    A plane that always holds has an ample friction.
    """
    lever = 0.0
    if "pivot" in case.plane.losses:
        lever = case.plane.losses["pivot"].value
    if case.plane.friction is not None:
        return float(case.plane.friction), lever
    return float(_ample_friction(case.expected.contact.friction, lever)), lever


def _portable_friction(case: EngineCase, friction: float) -> float:
    """Return a friction of 2 at most; raise a ConfigError if the run needs more."""
    needed = case.expected.contact.friction
    if case.plane.friction is not None:
        needed = case.plane.friction
    if needed > PORTABLE_FRICTION:
        raise ConfigError(
            f"portable: the run needs a friction of {needed:.3g}, and a portable model "
            f"has {PORTABLE_FRICTION:g} at most; leave portable out"
        )
    return min(friction, PORTABLE_FRICTION)


def _ample_friction(needed: float, lever: float) -> float:
    """Return a coefficient of sliding friction with which a body rolls always."""
    if lever > 0:
        return math.ceil(AMPLE_IN_PIVOTING * needed)
    if needed < HOLDING_FRICTION:
        return HOLDING_FRICTION
    return math.ceil(AMPLE * needed)


def _comment(text: str) -> str:
    """Return text that may stand in a comment of XML, whose end is two hyphens."""
    lines = (printable(line) for line in text.split("\n"))
    return re.sub("-(?=-)", "- ", "\n".join(lines))


def _numbers(values: Sequence[float]) -> str:
    """Return numbers with all their digits, as MJCF lists them."""
    return " ".join(repr(float(value)) for value in values)
