"""The quantities that a user can name: symbol, unit, kind, limits and meaning of each.

Keys of the config, columns of tables, arguments, options, axes of figures and the pages
of the documentation read them here.  A column that only `runs` or `summary` has is
defined in :mod:`rattlesweep.rows.columns`.  This module imports nothing, so that
``--help`` is fast.
"""

import math
import re
from collections.abc import Collection
from dataclasses import dataclass

# Units of the body: mass M, height a of the centre of mass, and gravity g are 1.
TIME = "sqrt(a/g)"
RATE = "sqrt(g/a)"
LENGTH = "a"
SPEED = "sqrt(g a)"
ENERGY = "M g a"
FORCE = "M g"
DAMPING = "M a^2 sqrt(g/a)"
RESISTANCE = "M sqrt(g/a)"

MAX_INERTIA = 1e6  # M a^2
# At this spin, in sqrt(g/a), a tilt of 1e-6 rad takes a contact force of the weight.
MAX_SPEED = 1e3
MAX_SIGMA = 1e6  # M a^2 sqrt(g/a)
MAX_MU = 1e6
MAX_VISCOUS = 1e9  # M sqrt(g/a)
MAX_ACCELERATION = 1e3  # of the plane, in g
MAX_TIME = 1e30  # sqrt(a/g) or t_rGH, beyond any run; sums of such numbers stay finite
MIN_OSCILLATION = 1e-140  # sqrt(g/a); the square of a smaller one underflows

_LETTER_AND_INDEX = re.compile(
    r"(alpha|beta|gamma|theta|xi|sigma|omega|[A-Za-z])(?:_(\w{1,3}))?"
)


@dataclass(frozen=True)
class Measure:
    """The column that holds a quantity in SI units, in rpm or in degrees."""

    name: str
    unit: str
    size: float = 1.0  # of its unit, in SI units


@dataclass(frozen=True)
class Definition:
    """What a quantity is called, what it means, and which values it may have."""

    name: str
    unit: str  # in units of the body; "1" for a pure number
    meaning: str
    kind: str = ""  # a key of `units.KINDS`; empty for a pure number
    low: float = -math.inf
    high: float = math.inf
    # Whether the limits themselves are excluded.
    is_open: bool = False
    measure: Measure | None = None
    # For figures, where it is not the name as a letter with an index.
    formula: str = ""

    @property
    def symbol(self) -> str:
        """Formula for figures; ``omega_p`` is a letter with an index."""
        return self.formula or symbol_of(self.name)

    @property
    def limits(self) -> str:
        """The allowed values as a text such as ``from 0 to 1 a``."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        if self.is_open:
            return f"above {self.low:g} and below {self.high:g}{unit}"
        return f"from {self.low:g} to {self.high:g}{unit}"


@dataclass(frozen=True)
class ActionConstant(Definition):
    """A constant of what acts on a body: of dissipation, or of a plane that shakes.

    A record is a key of the config, an argument, an option, a column and an axis.
    """

    # What the key of the config sets, without the unit.
    key: str = ""
    # In the titles of single runs.
    letter: str = ""
    # The value without the key; None if the key then has no meaning.
    default: float | None = 0.0
    # Whether only sweeps with some of it have its column.
    optional: bool = True
    # The action of `rattlesweep.motion.action` that it is a constant of; none for
    # sliding, which is another motion.
    action: str = ""
    # Whether a spin decays under it.
    takes_spin: bool = True
    # Whether a small oscillation about a spin has a rate of growth that theory knows.
    is_linear: bool = False
    # Whether theory has its average over swings, for the reduced model and the growth
    # rates of modes.  A run of the reduced model is refused with what has none.
    is_averaged: bool = False
    # Where the search of a fit begins, and its limits; most 0: it is not fitted.  A
    # torque per spin begins at multiples of gamma over the time of the data.  What acts
    # more and more toward zero, and not at zero, has a lower limit.
    first_values: tuple[float, ...] = ()
    least_fitted: float = 0.0
    most_fitted: float = 0.0


@dataclass(frozen=True)
class SurfaceConstant(Definition):
    """The further constant of a surface.

    A record is a key of `bodies`, a range or an axis there, and a column.
    """

    noun: str = ""
    example: str = ""


def symbol_of(name: str) -> str:
    """Return a name as a formula if it is a letter with an index, else the name."""
    match = _LETTER_AND_INDEX.fullmatch(name)
    if match is None:
        return name
    letter, index = match.groups()
    if len(letter) > 1:
        letter = f"\\{letter}"
    return f"${letter}_{{{index}}}$" if index else f"${letter}$"


# Limits of a body are those of the config; `physics.body` checks the relations between
# its parameters, and tables take mirrored bodies (xi > 0), too.
_BODY = (
    Definition(
        name="alpha",
        unit="1",
        meaning="I_xx / (M a^2) + 1",
        low=1.0,
        high=MAX_INERTIA,
        is_open=True,
    ),
    Definition(
        name="beta",
        unit="1",
        meaning="I_yy / (M a^2) + 1",
        low=1.0,
        high=MAX_INERTIA,
        is_open=True,
    ),
    Definition(
        name="gamma",
        unit="1",
        meaning="I_zz / (M a^2)",
        low=0.0,
        high=MAX_INERTIA,
        is_open=True,
    ),
    Definition(
        name="theta",
        unit="1",
        meaning="larger principal curvature at the bottom, times a",
        low=0.0,
        high=1.0,
        is_open=True,
    ),
    Definition(
        name="phi",
        unit="1",
        meaning="smaller principal curvature at the bottom, times a",
        low=0.0,
        high=1.0,
        is_open=True,
        formula=r"$\varphi$",
    ),
    Definition(
        name="xi",
        unit="rad",
        meaning="skew angle from the axes of inertia to those of curvature",
        kind="angle",
        low=-math.pi / 2,
        high=0.0,
        is_open=True,
        measure=Measure("xi_deg", "deg", math.pi / 180),
    ),
    Definition(
        name="xi_deg",
        unit="deg",
        meaning="skew angle xi in degrees",
        low=-90.0,
        high=0.0,
        is_open=True,
        formula=r"$\xi$",
    ),
    Definition(
        name="minus_xi_deg",
        unit="deg",
        meaning="skew angle xi times -1, in degrees",
        low=0.0,
        high=90.0,
        is_open=True,
        formula=r"$-\xi$",
    ),
    Definition(
        name="f_sd",
        unit="1",
        meaning="I_yy / I_zz",
        low=0.0,
        high=0.5,
        is_open=True,
    ),
)

_SURFACE = (
    SurfaceConstant(
        name="c",
        unit=LENGTH,
        meaning="vertical semi-axis of the ellipsoid below",
        kind="length",
        low=0.0,
        high=1e9,
        is_open=True,
        measure=Measure("c_m", "m"),
        noun="vertical semi-axis",
        example="2",
    ),
)

_SIZE = (
    Definition(
        name="rim",
        unit=LENGTH,
        meaning="height of the body's rim above its lowest point",
        kind="length",
        low=0.0,
        high=1e9,
        is_open=True,
    ),
    Definition("mass_kg", "kg", "mass M", "mass", 1e-9, 1e9),
    Definition(
        "height_m",
        "m",
        "height a of the centre of mass above the contact",
        "length",
        1e-9,
        1e6,
    ),
    Definition("gravity_m_s2", "m/s^2", "gravity g", "acceleration", 1e-6, 1e6),
    Definition("r1_m", "m", "a radius of curvature at the bottom", "length", 1e-9, 1e6),
    Definition("r2_m", "m", "the other radius of curvature", "length", 1e-9, 1e6),
)

_LAUNCH = (
    Definition(
        name="n_i",
        unit=RATE,
        meaning="initial spin",
        kind="spin",
        low=-MAX_SPEED,
        high=MAX_SPEED,
        measure=Measure("n_i_rpm", "rpm", math.pi / 30),
    ),
    Definition(
        name="omega_xy0",
        unit=RATE,
        meaning="initial rate of the oscillation",
        kind="spin",
        low=MIN_OSCILLATION,
        high=MAX_SPEED,
        measure=Measure("omega_xy0_rpm", "rpm", math.pi / 30),
    ),
    Definition(
        name="psi",
        unit="rad",
        meaning="direction of the oscillation from the x axis; the key and the "
        "argument psi are in degrees",
        kind="angle",
        low=-2 * math.pi,
        high=2 * math.pi,
        measure=Measure("psi_deg", "deg", math.pi / 180),
    ),
    Definition(
        name="psi_deg",
        unit="deg",
        meaning="direction of the oscillation from the x axis, in degrees",
        low=-360.0,
        high=360.0,
        formula=r"$\psi$",
    ),
    *(
        Definition(
            name=f"omega_{axis}",
            unit=RATE,
            meaning=f"initial angular velocity, component along the body's {axis}",
            kind="spin",
            low=-MAX_SPEED,
            high=MAX_SPEED,
        )
        for axis in "xyz"
    ),
    *(
        Definition(
            name=f"u_{axis}",
            unit="1",
            meaning=f"initial vertical vector, component along the body's {axis}",
        )
        for axis in "xyz"
    ),
    Definition(
        name="e_p0",
        unit=ENERGY,
        meaning="initial energy of the pitch in the reduced model",
        kind="energy",
        low=0.0,
        high=MAX_SPEED**2,
        formula="$E_{p0}$",
    ),
    Definition(
        name="e_r0",
        unit=ENERGY,
        meaning="initial energy of the roll in the reduced model",
        kind="energy",
        low=0.0,
        high=MAX_SPEED**2,
        formula="$E_{r0}$",
    ),
)

_DISSIPATION = (
    ActionConstant(
        name="sigma",
        unit=DAMPING,
        meaning="torque -sigma omega",
        kind="torque per spin",
        low=0.0,
        high=MAX_SIGMA,
        measure=Measure("sigma_N_m_s", "N m s"),
        key="Torque / -omega",
        action="viscous",
        letter="σ",
        optional=False,
        is_linear=True,
        is_averaged=True,
        first_values=(0.03, 0.1, 0.3),
        most_fitted=10.0,
    ),
    ActionConstant(
        name="rolling",
        unit=LENGTH,
        meaning="lever of the rolling resistance",
        kind="length",
        low=0.0,
        high=1.0,
        measure=Measure("rolling_m", "m"),
        formula="$l$",
        key="Moment / normal force",
        action="rolling",
        letter="rolling",
        optional=False,
        is_averaged=True,
        first_values=(1e-4, 1e-3),
        most_fitted=1.0,
    ),
    ActionConstant(
        name="pivot",
        unit=LENGTH,
        meaning="lever of the torque against pivoting",
        kind="length",
        low=0.0,
        high=1.0,
        measure=Measure("pivot_m", "m"),
        formula=r"$l_\mathrm{pivot}$",
        key="Torque against pivoting / normal force",
        action="pivoting",
        letter="pivot",
        is_averaged=True,
        first_values=(1e-4, 1e-3),
        most_fitted=1.0,
    ),
    ActionConstant(
        name="creep",
        unit="1",
        meaning="coefficient of friction in the patch that pivots; 0: no creep",
        low=0.0,
        high=MAX_MU,
        formula=r"$\mu_\mathrm{creep}$",
        key="Friction / normal force in the patch, which drifts as it pivots; the "
        "word mu: that of slides",
        action="creep",
        letter="creep",
        is_averaged=True,
        first_values=(0.2, 0.4),
        least_fitted=0.01,
        most_fitted=10.0,
    ),
    ActionConstant(
        name="viscous",
        unit=RESISTANCE,
        meaning="friction of the foot over its speed of slip; 0: no slip",
        kind="force per speed",
        low=0.0,
        high=MAX_VISCOUS,
        measure=Measure("viscous_N_s_m", "N s/m"),
        formula=r"$k$",
        key="Friction / speed at which the foot slips; 0: it does not slip",
        action="slip",
        letter="k",
        is_averaged=True,
        first_values=(30.0, 300.0),
        least_fitted=0.1,
        most_fitted=1e6,
    ),
    ActionConstant(
        name="mu",
        unit="1",
        meaning="coefficient of sliding friction",
        low=0.0,
        high=MAX_MU,
        is_open=True,
        formula=r"$\mu$",
        key="Friction / normal force at which the foot slides; none: never",
        letter="μ",
        default=None,
        takes_spin=False,
        is_linear=True,
        first_values=(0.2, 0.4),
        least_fitted=1e-3,
        most_fitted=10.0,
    ),
)

_DRIVES = (
    ActionConstant(
        name="base_frequency",
        unit=RATE,
        meaning="angular frequency of the plane that shakes",
        kind="frequency",
        low=0.0,
        high=MAX_SPEED,
        measure=Measure("base_frequency_Hz", "Hz", 2 * math.pi),
        formula=r"$\Omega$",
        letter="Ω",
        action="shaken",
        takes_spin=False,
        is_linear=True,
    ),
    ActionConstant(
        name="base_acceleration",
        unit="1",
        meaning="amplitude of the plane's acceleration in g",
        low=0.0,
        high=MAX_ACCELERATION,
        formula=r"$\varepsilon$",
        letter="ε",
        action="shaken",
        takes_spin=False,
        first_values=(0.02, 0.1),
        most_fitted=MAX_ACCELERATION,
    ),
    ActionConstant(
        name="base_phase",
        unit="rad",
        meaning="phase at launch of the plane's acceleration, which is largest at 0",
        kind="angle",
        low=-2 * math.pi,
        high=2 * math.pi,
        letter="phase",
        action="shaken",
        takes_spin=False,
        is_linear=True,
        # One in each quarter turn.
        first_values=(-2.4, -0.8, 0.8, 2.4),
        most_fitted=2 * math.pi,
    ),
    ActionConstant(
        name="base_azimuth",
        unit="rad",
        meaning="direction in which the plane shakes along itself, counterclockwise "
        "from above, from the horizontal part of the body's x axis at launch",
        kind="angle",
        low=-2 * math.pi,
        high=2 * math.pi,
        letter="azimuth",
        default=None,
        action="swayed",
        takes_spin=False,
        is_linear=True,
    ),
)

_STROKE = (
    Definition(
        name="base_amplitude",
        unit=LENGTH,
        meaning="amplitude of the plane's path",
        kind="length",
        low=0.0,
        high=1e6,
    ),
)

_TIMES = (
    Definition(
        name="t",
        unit=TIME,
        meaning="time",
        kind="time",
        measure=Measure("t_s", "s"),
        formula="time",
    ),
    # As a key or argument, and in a table of bodies: the horizon.
    Definition(
        name="t_end",
        unit=TIME,
        meaning="time reached",
        kind="time",
        low=1e-300,
        high=MAX_TIME,
        measure=Measure("t_end_s", "s"),
    ),
    Definition(
        name="dt",
        unit=TIME,
        meaning="spacing of the rows, or step of a fixed-step method",
        kind="time",
        low=1e-300,
        high=MAX_TIME,
    ),
    Definition(
        name="t_r",
        unit=TIME,
        meaning="first zero of the spin by t_end",
        kind="time",
        measure=Measure("t_r_s", "s"),
    ),
)

_THEORY = (
    Definition("omega_p", RATE, "pitch frequency without spin", "spin"),
    Definition("omega_r", RATE, "roll frequency without spin", "spin"),
    Definition("K_p", "1", "asymmetric torque coefficient of pitch"),
    Definition("K_r", "1", "asymmetric torque coefficient of roll"),
    Definition("n_c1", RATE, "Bondi's threshold spin of the steady direction", "spin"),
    Definition("n_0", RATE, "spin if all energy were spin", "spin"),
    Definition(
        name="t_rgh",
        unit=TIME,
        meaning="reversal time of Garcia and Hubbard's theory",
        kind="time",
        formula="$t_{rGH}$",
    ),
    Definition("ratio", "1", "t_r / t_rgh", formula=r"$t_r/t_{rGH}$"),
    Definition("n", RATE, "spin u . omega", "spin", formula="spin $n$"),
)

INITIAL_RATES = ("n_i", "omega_xy0")
"""The spin and the oscillation with which a run is launched."""

ANGLES = {"xi_deg": 1, "minus_xi_deg": -1}
"""Names of the skew angle in degrees, and their signs."""

QUANTITIES: dict[str, Definition] = {
    quantity.name: quantity
    for group in (
        *(_BODY, _SURFACE, _SIZE, _LAUNCH, _DISSIPATION),
        *(_DRIVES, _STROKE, _TIMES, _THEORY),
    )
    for quantity in group
}
"""The quantities by name."""

MEASURES: dict[str, tuple[Definition, Measure]] = {
    quantity.measure.name: (quantity, quantity.measure)
    for quantity in QUANTITIES.values()
    if quantity.measure is not None
}
"""Quantities in SI units, rpm or degrees by the names of their columns."""

LOSSES: dict[str, ActionConstant] = {loss.name: loss for loss in _DISSIPATION}
"""The constants of dissipation by name."""

DRIVES: dict[str, ActionConstant] = {drive.name: drive for drive in _DRIVES}
"""The constants of a plane that shakes by name."""

HORIZONTAL = "horizontal"
BASE_DIRECTIONS = ("vertical", HORIZONTAL)
"""The directions in which a plane shakes; only a horizontal one has an azimuth."""

ACTING: dict[str, ActionConstant] = LOSSES | DRIVES
"""The constants of all that acts on a body beside gravity and the plane, by name."""

COUPLE_CONSTANTS = frozenset(name for name, loss in LOSSES.items() if loss.takes_spin)
"""The constants under which a spin decays."""

SURFACE_CONSTANTS: dict[str, SurfaceConstant] = {each.name: each for each in _SURFACE}
"""The further constants of surfaces by name."""

CONSTANT_OF_SURFACE: dict[str, str | None] = {"paraboloid": None, "ellipsoid": "c"}
"""The surfaces, each with its further constant; bodies without one are the first."""


def law_of(names: Collection[str]) -> str:
    """Return the actions whose constants are among names, as models are named by them.

    The viscous torque accompanies all others, and is named where it is alone.
    """
    actions = [each.action for name, each in ACTING.items() if name in names]
    words = dict.fromkeys(filter(None, actions))
    if len(words) > 1:
        words.pop("viscous", None)
    if "swayed" in words:
        # A plane that shakes along itself has the constants of one that shakes upwards.
        words.pop("shaken", None)
    return "_".join(words)
