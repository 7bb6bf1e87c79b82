"""The formulas of a composed model: equations, energy, force, error, torque."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from rattlesweep.motion.action import Action, Whereabouts
from rattlesweep.motion.chart import ANYWHERE, SLOPES, Chart
from rattlesweep.motion.drifting import N_BODY, drifting_parts, force_without_drift
from rattlesweep.motion.fast import Fast, fast_for
from rattlesweep.motion.slipping import slipping_parts
from rattlesweep.motion.sums import (
    ActionSum,
    Numbering,
    contact_force,
    own_rates,
    summed_parts,
    with_own_energy,
)
from rattlesweep.physics import stone, vectors
from rattlesweep.physics.friction.sliding import cross
from rattlesweep.physics.full import scalar
from rattlesweep.physics.surface import Formula, Surface


def equations_of(
    chart: Chart, actions: tuple[Action, ...], layout: Numbering, fast: Fast | None
) -> tuple[Formula, Formula | None]:
    """Return the derivative of the state, and its parts, with ``contact`` first.

    They are formulas ``(contact, y, inertia, shape, loss)``.
    """
    drift = drift_of(actions)
    if drift is not None:
        return _drifting(chart, actions, drift, layout)
    if fast is not None:
        return fast.rhs, fast.parts
    return generic_equations(chart, actions, layout)


def drift_of(actions: Iterable[Action]) -> Action | None:
    """Return the action under which the foot drifts, None if there is none."""
    for action in actions:
        if action.drifts:
            return action
    return None


def _without_drift(
    chart: Chart, actions: tuple[Action, ...], drift: Action, layout: Numbering
) -> tuple[Formula, int]:
    """Return the parts of the equations without a drift.

    The second value is the place of its coefficient among the constants of actions.
    """
    others = tuple(action for action in actions if action is not drift)
    names = [name for name in layout.constants if name not in drift.constants]
    without = replace(layout, constants=tuple(names))
    _, parts = equations_of(chart, others, without, fast_for(chart, others))
    assert parts is not None
    return parts, layout.constants[N_BODY:].index(drift.strength)


def _drifting(
    chart: Chart, actions: tuple[Action, ...], drift: Action, layout: Numbering
) -> tuple[Formula, Formula]:
    """Return what :func:`equations_of` does, of a body whose foot drifts."""
    others = [action for action in actions if action is not drift]
    parts, place_of_mu = _without_drift(chart, actions, drift, layout)
    acting = ActionSum.of(others, layout)
    drifting = drifting_parts(chart, parts, place_of_mu, acting)

    @scalar
    def rhs(contact, y, inertia, shape, loss):
        place, turned, _, _, power, taken, crept, doubtful, _, _ = drifting(
            contact, y, inertia, shape, loss
        )
        works = power + taken + crept, taken, crept, doubtful
        return place + turned + works

    @scalar
    def parts_on(contact, y, inertia, shape, loss):
        place, turned, torque, held, power, taken, _, _, normal, _ = drifting(
            contact, y, inertia, shape, loss
        )
        return place, turned, torque, held, power, taken, normal

    further = own_rates(acting, layout)
    if further is None:
        return rhs, parts_on
    (_,) = [each for each in others if each.own_work and not each.pivots]
    locate = chart.locate

    @scalar
    def rhs_with_own(contact, y, inertia, shape, loss):
        place, turned, _, _, power, taken, crept, doubtful, normal, more = drifting(
            contact, y, inertia, shape, loss
        )
        _, u, omega, r, w, _ = locate(contact, y, shape)
        constants = inertia + shape[:4] + loss
        velocity = cross(r, omega)
        x, y_, z = cross(r, more)
        rolling = Whereabouts(u, omega, r, w, velocity, 0.0, (0.0, 0.0))
        drifted = velocity[0] + x, velocity[1] + y_, velocity[2] + z
        at = Whereabouts(u, omega, r, w, drifted, 0.0, (0.0, 0.0))
        own = further(at, normal, y, constants)
        whole = power + taken + crept
        # The power so far is that of a body that rolls without the drift.
        rolled = further(rolling, normal, y, constants)
        crept = crept - (own[0] - rolled[0])
        works = whole, taken, crept, own[0]
        return place + turned + works + (doubtful,) + own[1:]

    return rhs_with_own, parts_on


def generic_equations(
    chart: Chart, actions: tuple[Action, ...], layout: Numbering
) -> tuple[Formula, Formula]:
    """Return what :func:`equations_of` does, from the sum of any actions."""
    holds = any(action.pivots for action in actions)
    acting = ActionSum.of([each for each in actions if not each.pivots], layout)
    slips = [action for action in actions if action.slips]
    if slips:
        parts = slipping_parts(chart, acting, slips[0], layout)
    else:
        parts = summed_parts(chart, acting, holds=holds)
    further = own_rates(ActionSum.of(actions, layout), layout)
    works_of = _both_works if holds else _one_work

    @scalar
    def parts_on(contact, y, inertia, shape, loss):
        place, turned, torque, normal, power, taken, _ = parts(
            contact, y, inertia, shape, loss
        )
        return place, turned, torque, normal, power, taken

    if further is None:

        @scalar
        def rhs(contact, y, inertia, shape, loss):
            place, turned, _, _, power, taken, _ = parts(
                contact, y, inertia, shape, loss
            )
            return place + turned + works_of(power, taken)

        return rhs, parts_on

    @scalar
    def rhs_with_own(contact, y, inertia, shape, loss):
        rates, turned, _, normal, power, taken, place = parts(
            contact, y, inertia, shape, loss
        )
        constants = inertia + shape[:4] + loss
        own = further(place, normal, y, constants)
        return rates + turned + works_of(power, taken) + own

    return rhs_with_own, parts_on


@scalar
def _one_work(power, taken):
    return (power,)


@scalar
def _both_works(power, taken):
    return power + taken, taken


def on_surface(rhs: Formula, contact: Formula) -> Formula:
    """Return equations of a surface as `Model.rhs`."""

    @scalar
    def on_surface(y, constants):
        return rhs(contact, y, constants[:3], constants[3:7], constants[7:])

    return on_surface  # type: ignore[no-any-return]


def error_of(chart: Chart, actions: tuple[Action, ...], layout: Numbering) -> Formula:
    """Return the squares that a step control compares."""
    error = chart.error_of_actions if actions else chart.error
    for action in actions:
        if action.error is not None:
            error = _with_own_error(error, action, layout)
    return error


def _with_own_error(before: Formula, action: Action, layout: Numbering) -> Formula:
    begin = layout.components.index(action.components[0])
    end = begin + len(action.components)
    own = action.error
    assert own is not None

    @scalar
    def error(e, y, constants):
        step, size = before(e, y, constants)
        return step + own(e[begin:end], y[begin:end]), size

    return error  # type: ignore[no-any-return]


def energy_less_work(
    chart: Chart,
    surface: Surface,
    contact: Formula,
    actions: tuple[Action, ...],
    layout: Numbering,
) -> Formula:
    """Return the energy less the work of the actions."""
    energy_of = surface.energy if chart is SLOPES else vectors.energy
    if not actions:
        return energy_of
    if any(action.energy is not None for action in actions):
        energy_of = with_own_energy(
            energy_of, chart, contact, ActionSum.of(actions, layout)
        )
    work = len(chart.place)

    @scalar
    def energy(y, constants):
        return energy_of(y, constants) - y[work]

    return energy  # type: ignore[no-any-return]


def contact_force_of(
    chart: Chart,
    surface: Surface,
    contact: Formula,
    actions: tuple[Action, ...],
    layout: Numbering,
) -> Formula:
    """Return the contact force, as `Model.force`."""
    drift = drift_of(actions)
    if drift is not None:
        parts, place_of_mu = _without_drift(chart, actions, drift, layout)
        others = ActionSum.of([each for each in actions if each is not drift], layout)
        return force_without_drift(chart, parts, contact, place_of_mu, others)
    if any(each.force or each.weight or each.tangent for each in actions):
        return contact_force(chart, contact, ActionSum.of(actions, layout))
    if chart is ANYWHERE:
        force_anywhere: Formula = vectors.contact_force
        return force_anywhere
    if surface.force is not None and not actions:
        return surface.force

    @scalar
    def force(y, dy, constants):
        return stone.surface_force(contact, y, dy, constants)

    return force  # type: ignore[no-any-return]


def rise_of(chart: Chart, contact: Formula) -> Formula:
    """Return the height of a surface's contact, as `Model.rise`."""
    if chart is ANYWHERE:
        rise_anywhere: Formula = vectors.rise
        return rise_anywhere

    @scalar
    def rise(y, constants):
        (_, _, height), _, _ = contact(y, (0.0, 0.0, 0.0), constants[3:7])
        return height

    return rise  # type: ignore[no-any-return]


def volume_of(chart: Chart, volume_at: Formula) -> Formula:
    """Return the rate of phase volume, as `Model.volume`."""
    if chart is ANYWHERE:

        @scalar
        def volume(y, constants):
            return volume_at(y, constants[:3], constants[3:7], constants[7:])

        return volume  # type: ignore[no-any-return]

    @scalar
    def volume_of_slope(y, constants):
        p, q, a, b, c = y[:5]
        # A paraboloid is an ellipsoid with k = 0.
        shape = (constants[3:] + (0.0,))[:4]  # noqa: RUF005
        there = -p, -q, -1.0, a, b, c
        return volume_at(there, constants[:3], shape, constants[7:])

    return volume_of_slope  # type: ignore[no-any-return]


def pivot_of(parts: Formula, contact: Formula, *, drifts: bool) -> Formula:
    """Return the torque of an action that pivots, as `Model.pivot`."""
    if drifts:

        @scalar
        def pivot_of_drift(y, constants):
            _, _, torque, held, _, _, normal = parts(
                contact, y, constants[:3], constants[3:7], constants[7:]
            )
            return torque, held, normal

        return pivot_of_drift  # type: ignore[no-any-return]

    @scalar
    def pivot(y, constants):
        _, _, torque, normal, _, _ = parts(
            contact, y, constants[:3], constants[3:7], constants[7:]
        )
        return torque, normal, normal

    return pivot  # type: ignore[no-any-return]


def at_contact(formula_on: Formula, contact: Formula) -> Formula:
    """Return a formula ``(contact, y, constants)`` for the contact of a surface."""

    @scalar
    def formula(y, constants):
        return formula_on(contact, y, constants)

    return formula  # type: ignore[no-any-return]
