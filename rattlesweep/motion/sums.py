"""What several actions do together, and the equations of a body that rolls under them.

These equations serve any set of actions, on any surface and in any chart.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any

from rattlesweep.motion.action import Action, Whereabouts
from rattlesweep.physics.friction import pivoting
from rattlesweep.physics.friction.sliding import cross
from rattlesweep.physics.full import NO_FORCE, scalar
from rattlesweep.physics.stone import dot, force_at, solve_again, triple
from rattlesweep.physics.surface import Formula

if TYPE_CHECKING:
    from rattlesweep.motion.chart import Chart


@scalar
def no_number(place, y, constants):
    """Return 0, the sum of no numbers."""
    return 0.0


@scalar
def no_vector(place, y, constants):
    """Return the zero vector, the sum of no vectors."""
    return NO_FORCE


def _of_own(formula: Formula, action: Action, layout: Numbering) -> Formula:
    """Return a formula of an action as one of place, state and constants."""
    first = layout.constants.index(action.strength)
    last = first + len(action.constants)
    if not action.components:

        @scalar
        def of_constants(place, y, constants):
            return formula(place, constants[first:last])

        return of_constants  # type: ignore[no-any-return]
    begin = layout.components.index(action.components[0])
    end = begin + len(action.components)

    @scalar
    def of_own(place, y, constants):
        return formula(place, constants[first:last] + y[begin:end])

    return of_own  # type: ignore[no-any-return]


def _two_vectors(one: Formula, other: Formula) -> Formula:
    @scalar
    def both(place, y, constants):
        a, b, c = one(place, y, constants)
        x, y_, z = other(place, y, constants)
        return a + x, b + y_, c + z

    return both  # type: ignore[no-any-return]


def _two_values(one: Formula, other: Formula) -> Formula:
    """Return the sum of two numbers, or one tuple after the other."""

    @scalar
    def both(place, y, constants):
        return one(place, y, constants) + other(place, y, constants)

    return both  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Numbering:
    """Where the numbers of actions are: names of components and constants."""

    components: tuple[str, ...]
    constants: tuple[str, ...]


@dataclass(frozen=True)
class ActionSum:
    """What some actions do: formulas of place, state and constants."""

    actions: tuple[Action, ...]
    torque: Formula
    grip: Formula  # per unit of the normal force
    force: Formula  # at the centre of mass
    weight: Formula  # beyond 1
    tangent: Formula | None  # square of the tangential force, None if it rolls
    energy: Formula  # of their components
    rates: Formula | None  # of the components of actions, None without any

    @classmethod
    def of(cls, actions: Sequence[Action], layout: Numbering) -> ActionSum:
        """Return the sum of actions whose numbers lie as in a layout."""

        def total(name: str, none: Any, two: Callable[..., Formula]) -> Any:
            formulas = [
                _of_own(getattr(action, name), action, layout)
                for action in actions
                if getattr(action, name) is not None
            ]
            if not formulas:
                return none
            return reduce(two, formulas)

        return cls(
            tuple(actions),
            torque=total("torque", no_vector, _two_vectors),
            grip=total("grip", no_vector, _two_vectors),
            force=total("force", no_vector, _two_vectors),
            weight=total("weight", no_number, _two_values),
            tangent=total("tangent", None, _two_values),
            energy=total("energy", no_number, _two_values),
            rates=total("rates", None, _two_values),
        )


def power_formula(acting: ActionSum) -> Formula:
    """Return the power of what a sum or an action does.

    What it adds to the ``weight`` acts at the centre of mass, as a ``force`` does.
    Where neither is, not even a product with zero may change the code around it.
    """

    @scalar
    def turning(torque, grip, force, weight, normal, omega, velocity, u):
        return dot(torque, omega) + normal * dot(grip, omega)

    if not any(action.force or action.weight for action in acting.actions):
        return turning  # type: ignore[no-any-return]

    @scalar
    def power(torque, grip, force, weight, normal, omega, velocity, u):
        turned = turning(torque, grip, force, weight, normal, omega, velocity, u)
        return turned + (dot(force, velocity) - weight * dot(u, velocity))

    return power  # type: ignore[no-any-return]


def summed_parts(chart: Chart, acting: ActionSum, *, holds: bool) -> Formula:
    """Return the equations of a body that rolls under a sum of actions.

    They are a formula ``(contact, y, inertia, shape, loss)``.  Its values are the rates
    of the position, ``domega/dt``, the torque of an action that pivots, the normal
    force, the power of all other actions, that of the torque, and the place.  If an
    action pivots (``holds``), the last two constants are its lever and the sense of the
    spin.
    """
    locate = chart.locate
    accelerate = chart.accelerate
    torque_of = acting.torque
    grip_of = acting.grip
    force_of = acting.force
    weight_of = acting.weight
    power_of = power_formula(acting)

    @scalar
    def parts(contact, y, inertia, shape, loss):
        constants = inertia + shape[:4] + loss
        located = locate(contact, y, shape)
        rates, u, omega, r, w, _ = located
        place = Whereabouts(u, omega, r, w, cross(r, omega), 0.0, (0.0, 0.0))
        force = force_of(place, y, constants)
        more = weight_of(place, y, constants)
        torque = torque_of(place, y, constants)
        grip = grip_of(place, y, constants)
        # The plane's reaction to a force gives it a torque about the contact point.
        reaction = cross(force, r)
        whole = (
            torque[0] + reaction[0],
            torque[1] + reaction[1],
            torque[2] + reaction[2],
        )
        turned, solved = accelerate(y, located, inertia, whole, 1.0 + more)
        normal, _ = force_at(u, omega, turned, r, w, 1.0 + more, force)
        # The torque in proportion to the normal force changes that itself.
        held = h0, h1, h2 = solve_again(r, grip, solved)
        kept = 1.0 - triple(u, r, held)
        normal = normal / kept
        # There is no such torque where the plane would have to pull.
        normal = 0.5 * (normal + abs(normal))
        turned = (
            turned[0] + normal * h0,
            turned[1] + normal * h1,
            turned[2] + normal * h2,
        )
        pivot = 0.0
        taken = 0.0
        if holds:
            j = j0, j1, j2 = solve_again(r, u, solved)
            lift = triple(u, r, j) / kept
            j = j0 + lift * h0, j1 + lift * h1, j2 + lift * h2
            lever, sense = loss[-2:]
            turned, pivot, normal = pivoting.with_torque(
                u, omega, turned, normal, j, lift, lever, sense
            )
            taken = pivot * dot(u, omega)
        power = power_of(torque, grip, force, more, normal, omega, place.velocity, u)
        return rates, turned, pivot, normal, power, taken, place

    return parts  # type: ignore[no-any-return]


def own_rates(acting: ActionSum, layout: Numbering) -> Formula | None:
    """Return the rates of own works and of components of actions, None without any.

    They are a formula of place, normal force, state and constants.  Actions with a
    `slid_power` count their work elsewhere.
    """
    rates = [
        _own_power(ActionSum.of([action], layout))
        for action in acting.actions
        if action.own_work is not None and action.slid_power is None
    ]
    if acting.rates is not None:
        rates.append(_of_components(acting.rates))
    if not rates:
        return None
    return reduce(_one_after_other, rates)


def _one_after_other(one: Formula, other: Formula) -> Formula:
    @scalar
    def both(place, normal, y, constants):
        return one(place, normal, y, constants) + other(place, normal, y, constants)

    return both  # type: ignore[no-any-return]


def _of_components(rates: Formula) -> Formula:
    @scalar
    def of_components(place, normal, y, constants):
        return rates(place, y, constants)

    return of_components  # type: ignore[no-any-return]


def _own_power(own: ActionSum) -> Formula:
    torque_of = own.torque
    grip_of = own.grip
    force_of = own.force
    weight_of = own.weight
    power_of = power_formula(own)

    @scalar
    def power(place, normal, y, constants):
        power = power_of(
            torque_of(place, y, constants),
            grip_of(place, y, constants),
            force_of(place, y, constants),
            weight_of(place, y, constants),
            normal,
            place.omega,
            place.velocity,
            place.u,
        )
        return (power,)

    return power  # type: ignore[no-any-return]


def with_own_energy(
    before: Formula, chart: Chart, contact: Formula, acting: ActionSum
) -> Formula:
    """Return an energy with that of the components of actions."""
    locate = chart.locate
    own_energy = acting.energy

    @scalar
    def energy(y, constants):
        _, u, omega, r, w, _ = locate(contact, y, constants[3:7])
        place = Whereabouts(u, omega, r, w, cross(r, omega), 0.0, (0.0, 0.0))
        return before(y, constants) + own_energy(place, y, constants)

    return energy  # type: ignore[no-any-return]


def contact_force(chart: Chart, contact: Formula, acting: ActionSum) -> Formula:
    """Return the contact force where further ones act at the centre of mass.

    It is a formula as `model.Model.force`.
    """
    locate = chart.locate
    end = len(chart.place)
    begin = end - 3
    force_of = acting.force
    weight_of = acting.weight

    @scalar
    def force(y, dy, constants):
        _, u, omega, r, w, _ = locate(contact, y, constants[3:7])
        place = Whereabouts(u, omega, r, w, cross(r, omega), 0.0, (0.0, 0.0))
        turned = dy[begin:end]
        weight = 1.0 + weight_of(place, y, constants)
        return force_at(u, omega, turned, r, w, weight, force_of(place, y, constants))

    tangent_of = acting.tangent
    if tangent_of is None:
        return force  # type: ignore[no-any-return]

    @scalar
    def slipped_force(y, dy, constants):
        # The velocity of slip stays in the plane: the normal force is that of rolling.
        normal, _ = force(y, dy, constants)
        _, u, omega, r, w, _ = locate(contact, y, constants[3:7])
        place = Whereabouts(u, omega, r, w, cross(r, omega), 0.0, (0.0, 0.0))
        return normal, tangent_of(place, y, constants)

    return slipped_force  # type: ignore[no-any-return]
