"""Equations of some sets of actions that are cheaper than sums.

A set without an entry here uses the equations of :mod:`sums`, at 1.3 to 1.4 times the
price.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from rattlesweep.motion.action import PIVOTING, ROLLING, SHAKEN, SWAYED, VISCOUS, Action
from rattlesweep.motion.chart import ANYWHERE, SLOPES, Chart
from rattlesweep.physics import shaking, stone, vectors
from rattlesweep.physics.friction import pivoting
from rattlesweep.physics.surface import Formula


@dataclass(frozen=True)
class Fast:
    """The equations of one set of actions in one chart.

    ``loss`` are the constants of the actions.
    """

    # rhs(contact, y, inertia, shape, loss): the derivative of the state
    rhs: Formula
    # parts(contact, y, inertia, shape, loss): as in `pivoting.pivoting_parts`, of a set
    # with an action that pivots
    parts: Formula | None = None
    # volume(y, inertia, shape, loss): rate of phase volume
    volume: Formula | None = None


FAST_EQUATIONS: dict[tuple[Chart, frozenset[Action]], Fast] = {
    (SLOPES, frozenset()): Fast(
        stone.frictionless_rhs, volume=vectors.frictionless_volume
    ),
    (SLOPES, frozenset([VISCOUS])): Fast(
        stone.viscous_rhs, volume=vectors.viscous_volume
    ),
    (SLOPES, frozenset([VISCOUS, SHAKEN])): Fast(
        # The weight of the body does not change the rate of phase volume.
        shaking.shaken_rhs,
        volume=vectors.viscous_volume,
    ),
    (SLOPES, frozenset([VISCOUS, SWAYED])): Fast(
        # Nor does a force, or the turning of its direction.
        shaking.swayed_rhs,
        volume=vectors.viscous_volume,
    ),
    (SLOPES, frozenset([VISCOUS, ROLLING])): Fast(
        stone.rolling_rhs, volume=vectors.rolling_volume
    ),
    (SLOPES, frozenset([VISCOUS, PIVOTING])): Fast(
        pivoting.pivoting_rhs, pivoting.pivoting_parts
    ),
    (SLOPES, frozenset([VISCOUS, ROLLING, PIVOTING])): Fast(
        pivoting.rolling_rhs, pivoting.rolling_parts
    ),
    (ANYWHERE, frozenset([VISCOUS, ROLLING])): Fast(
        vectors.rolling_rhs, volume=vectors.rolling_volume
    ),
    (ANYWHERE, frozenset([VISCOUS, ROLLING, PIVOTING])): Fast(
        pivoting.rhs_anywhere, pivoting.parts_anywhere
    ),
}


def fast_for(chart: Chart, actions: Collection[Action]) -> Fast | None:
    """Return the equations of a set of actions, None if they are their sum."""
    return FAST_EQUATIONS.get((chart, frozenset(actions)))
