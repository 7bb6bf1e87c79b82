"""What acts on a body beside gravity and the force that keeps it rolling.

A law is a set of actions.  An action is a record; its formulas are in
:mod:`rattlesweep.physics`, its constants in :mod:`rattlesweep.words.quantities`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from rattlesweep.arrays import Floats
from rattlesweep.physics import shaking, stone
from rattlesweep.physics.friction import pivoting, slip
from rattlesweep.physics.friction.creep import no_rate
from rattlesweep.physics.surface import Formula

Vector3 = tuple[float, float, float]


class Whereabouts(NamedTuple):
    """Where a body is and how it moves: what actions may depend on, in its own axes."""

    u: Vector3  # the upward vertical
    omega: Vector3  # angular velocity
    r: Vector3  # the contact point, from the centre of mass
    w: Vector3  # r x omega - dr/dt
    velocity: Vector3  # of the centre of mass
    creep: float  # mu times the speed of sliding, 0 where the body rolls
    # Rates of the velocity of a contact point that slips, along h_1 and h_2
    slip_rates: tuple[float, float]


# Compared by identity: formulas and mappings have no other equality.
@dataclass(frozen=True, eq=False)
class Action:
    """What acts on a body: torques, forces, their constants, components and work.

    Each formula takes a :class:`Whereabouts` and the numbers ``own`` of the action,
    its constants and then its components of the state.  Vectors are in the axes of the
    body.  What an action lacks is None, and costs nothing.

    The next actions were the measure of this record:

    - *A drag* is a ``force``.
    """

    name: str  # one word
    # Names of its constants.  The action is left out where the first one is zero.
    constants: tuple[str, ...]
    # Those among them that users do not give, and their values.
    fixed: Mapping[str, float] = field(default_factory=dict)

    # What acts, and where
    torque: Formula | None = None  # torque(place, own)
    # grip(place, own): a torque in proportion to the normal force, per unit of it
    grip: Formula | None = None
    force: Formula | None = None  # force(place, own): at the centre of mass
    weight: Formula | None = None  # weight(place, own): what it adds to the weight 1
    # Whether it may lift the body off the plane, where a run then ends.
    lifts: bool = False
    # Whether it holds the spin at zero, and opposes it elsewhere, with a torque along
    # the vertical of at most `constants[0]` times the normal force while the body
    # rolls.  Then `grip` is the torque while it slides.  Its constants are the last.
    pivots: bool = False
    # Whether the foot drifts while the body rolls and another action pivots; its
    # constant is the coefficient of friction in the patch (`motion.drifting`).
    drifts: bool = False

    # Further components of the state, from the launch on
    components: tuple[str, ...] = ()
    rates: Formula | None = None  # rates(place, own): a number for each
    # start(place, constants by name): values at launch, an array for each; else zeros.
    # `place` has the slopes and angular velocities, shape (rows, 5).
    start: Callable[[Floats, Mapping[str, Floats]], tuple[Floats, ...]] | None = None
    # error(e, components): squares of their errors e, as twice an energy in M g a
    error: Formula | None = None
    # energy(place, own): of its components, beyond that of a body that rolls
    energy: Formula | None = None
    # tangent(place, own): square of the tangential force, if it is not that of rolling
    tangent: Formula | None = None

    # Whether the contact point slips at the velocity that are the first two components,
    # along h_1 and h_2 of `physics.friction.sliding`, under a friction of its constant
    # times it (`motion.slipping`).
    slips: bool = False

    # The work of all actions is a component of the state.  The name of a further one
    # with that of this action alone:
    own_work: str | None = None
    # slid_power(placed, normal): its power while the body slides, if that is cheaper
    # from the sum of all actions
    slid_power: Formula | None = None

    @property
    def strength(self) -> str:
        """The constant without which it does not act."""
        return self.constants[0]


VISCOUS = Action("viscous", ("sigma",), torque=stone.viscous_torque)
"""It accompanies all others, so that they share fast equations."""

ROLLING = Action(
    "rolling",
    ("rolling", "smoothing"),
    fixed={"smoothing": stone.SMOOTHING},
    grip=stone.rolling_torque,
)
PIVOTING = Action(
    "pivoting",
    ("pivot", "sense"),
    # The sense of the spin, which lanes keep.
    fixed={"sense": 1.0},
    grip=pivoting.patch_torque,
    pivots=True,
    own_work="pivot work",
    slid_power=pivoting.sliding_power,
)
CREEP = Action(
    "creep",
    ("creep",),
    drifts=True,
    own_work="creep work",
    components=("doubtful work",),
    rates=no_rate,
)
SLIP = Action(
    "slip",
    ("viscous",),
    components=("slip_1", "slip_2", "slip work"),
    rates=slip.rates,
    error=slip.squared_slip_error,
    energy=slip.energy,
    tangent=slip.squared_force,
    slips=True,
)
SHAKEN = Action(
    "shaken",
    ("base_acceleration", "base_frequency", "base_phase"),
    weight=shaking.more_weight,
    lifts=True,
    components=("turns of the base",),
    rates=shaking.turns_rate,
    start=shaking.first_turns,
    own_work="base work",
)
# It takes the place of `SHAKEN`, whose constants it shares.  A horizontal force changes
# the normal force by at most half its size, as the mobility of the centre of mass has
# eigenvalues from 0 to 1.
SWAYED = Action(
    "swayed",
    ("base_acceleration", "base_frequency", "base_phase", "base_azimuth"),
    force=shaking.force_of_plane,
    lifts=True,
    components=("turns of the base", "base_x", "base_y", "base_z"),
    rates=shaking.swayed_rates,
    start=shaking.first_direction,
    own_work="base work",
)
ACTIONS: dict[str, Action] = {
    action.name: action
    for action in (VISCOUS, ROLLING, CREEP, SLIP, SHAKEN, SWAYED, PIVOTING)
}
"""The actions by name, in the order of their constants."""


def numbered(actions: Iterable[Action]) -> tuple[Action, ...]:
    """Return actions in the order of their constants, with what accompanies them."""
    chosen = set(actions)
    if chosen:
        chosen.add(VISCOUS)
    if not any(action.pivots for action in chosen):
        # A foot that does not turn does not drift.
        chosen = {action for action in chosen if not action.drifts}
    known = [action for action in ACTIONS.values() if action in chosen]
    further = sorted(chosen - set(known), key=lambda action: action.name)
    # The constants of an action that pivots are the last.
    return tuple(sorted([*known, *further], key=lambda action: action.pivots))
