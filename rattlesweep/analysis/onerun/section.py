"""Sections of one run: the states at which a channel crosses a value.

Each accepted step is cut into pieces that are short compared with a swing.  A piece
whose ends lie on two sides of the value has a crossing.  A piece whose ends lie on one
side has a pair of them if the channel turns back beyond the value, so its extreme is
searched wherever one may lie.  Every state is one step of the method from the accepted
step before it, and all pieces of many steps are searched together.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.analysis.onerun.channels import Channel, choose_channels
from rattlesweep.arrays import Flags, Floats, take
from rattlesweep.kernel.event.zeros import PIECE_ANGLE
from rattlesweep.kernel.state.fields import SLIP_SPEED
from rattlesweep.words.errors import ConfigError, one_line
from rattlesweep.words.units import NATURAL, natural_number, quantity, require_unit

if TYPE_CHECKING:
    from rattlesweep.kernel.follow import Follower
    from rattlesweep.kernel.recorder import Samples
    from rattlesweep.physics.si import Units

# A run may swing faster than at its launch, so a step has at least a few pieces.
FEWEST_PIECES_A_STEP = 4
MOST_PIECES_A_STEP = 128
# An extreme is searched on a grid, then on a finer one about its lowest point.  The
# last is so fine that the value there is exact up to rounding.
GRID = np.linspace(0.0, 1.0, 9)
MOST_GRIDS = 14
NEIGHBOURS = np.array([-2, -1, 1, 2])
# Where a channel jumps, more remains of its heights at both ends of a piece.
SMOOTH = 1e-6
_ROUNDING = 1e-14  # of a value

# The kinds of quantities whose units follow from the size of the body.
_KINDS = {unit: kind for kind, unit in NATURAL.items()}
NO_SECTIONS = {
    "t": "it only grows; choose rows by times instead",
    "sliding": "it jumps; the begin and end of slides are known without one",
    "held": "it jumps; the spin n is 0 where it is held",
    "pivot_torque": "it jumps where the spin passes zero; choose n",
    "energy_drift": "it is an error of the method",
    "n_reduced": "it belongs to the reduced model; take that model, and n",
}
# Channels that only rounding changes, by the models that conserve them; dissipation
# takes energy.
_CONSTANTS = {"full": {"energy"}, "reduced": {"energy", "C_I", "casimir"}}
_DIRECTIONS = {"+": 1, "-": -1, "": 0}
RISES = "whether {} rises there"


@dataclass(frozen=True)
class Section:
    """A value of a channel, and the directions in which a run crosses it."""

    channel: Channel
    level: str  # the value as it was written
    sign: str  # "+" for rising, "-" for falling, empty for both
    value: float  # in the units of the body

    @classmethod
    def parse(cls, text: object, model: str, units: Units | None) -> Section:
        """Read a text such as ``omega_y``, ``omega_y=0.1+`` or ``n=-60 rpm-``.

        Raise a ConfigError for what is not a section of the model, and for a number
        without a unit if the body has a size.
        """
        match = re.fullmatch(r"\s*(\w+)\s*(?:=\s*(.+?)\s*)?([+-]?)\s*", str(text))
        if match is None:
            raise ConfigError(
                f"section: {one_line(repr(text))} is none; give a channel and a value, "
                "as in omega_y=0, and + or - for one direction"
            )
        name, level, sign = match.groups(default="0")
        if name in NO_SECTIONS:
            raise ConfigError(f"section: {name} has none: {NO_SECTIONS[name]}")
        channel = choose_channels([name], model)[0]
        try:
            value = _value(level, _KINDS.get(channel.unit), units)
        except ConfigError:
            raise  # it names the argument
        except ValueError as error:
            raise ConfigError(f"section: {one_line(level)} {error}") from None
        return cls(channel, level, sign, value)

    def refuse_constant(self, model: str, *, has_losses: bool) -> None:
        """Raise a ConfigError if the channel is a constant of a run."""
        name = self.channel.name
        if name in _CONSTANTS[model] and not has_losses:
            raise ConfigError(
                f"section: {name} has none: it is constant in this run; choose a "
                "channel that varies"
            )

    @property
    def text(self) -> str:
        """The section as it is written, such as ``omega_y=0+``."""
        return f"{self.channel.name}={self.level}{self.sign}"


def _value(level: str, kind: str | None, units: Units | None) -> float:
    """Return a level in the units of the body; raise a ValueError that says why not."""
    try:
        value = float(level)
    except ValueError:
        natural = natural_number(level, kind) if kind else None
        if natural is not None:
            return float(natural)
        if units is None or kind is None:
            raise ValueError(
                "is not a number; only spins, times, lengths and energies of a body "
                "with a size may have a unit"
            ) from None
        return float(units.natural(quantity(level, kind), kind))
    if not math.isfinite(value):
        raise ValueError("is not finite")
    if units is not None and kind is not None:
        require_unit("section", value, kind)
    return value


class CrossingSearch:
    """Finds the crossings of a section in a run, while it is integrated.

    The launch is no crossing, and neither is a jump over the value, as forces do where
    a slide ends.  A channel that touches the value does not cross it.

    Heights are values of the channel above that of the section.  Stretches of steps are
    arrays of shape (4, stretches): the step, the begin and the end as times within it,
    and the side, 1 or -1, on which the stretch ends.
    """

    def __init__(
        self,
        section: Section,
        follower: Follower,
        channel_of: Callable[[Samples], Floats],
    ) -> None:
        self._value = section.value
        self._direction = _DIRECTIONS[section.sign]
        self._follower = follower
        self._channel_of = channel_of

    def __iter__(self) -> Iterator[tuple[Samples, Flags]]:
        """Yield crossings and whether they rise, those of some steps at a time."""
        follower = self._follower
        height = self._heights(follower.launch())[0]
        side = None
        while not follower.ended:
            steps = follower.steps()
            which, begin, end = _pieces(follower.lengths(), follower.swing)
            is_last = np.diff(which, append=-1) != 0
            heights = np.append(height, self._heights_within(end, which))
            # Steps end where the next ones begin, up to the last bit.
            heights[1:][is_last] = self._heights(steps)
            if side is None:
                # A launch on the section is on neither side of it.
                largest = np.nanmax(np.abs([self._value, *heights]))
                is_beside = abs(height) > _ROUNDING * largest
                side = np.sign(height) if is_beside else 0.0
            sides = _sides(heights, side)
            may_turn = _may_turn(heights, sides)
            if (steps.slip[:, SLIP_SPEED] > 0).any():
                # The rate of a channel may jump where a slide begins or ends.
                may_turn |= is_last | np.append(True, is_last[:-1])
            stretches = np.stack([which, begin, end, sides[1:]])
            products = sides[:-1] * sides[1:]
            turning = stretches[:, may_turn & (products > 0)]
            brackets = np.hstack([stretches[:, products < 0], *self._pairs(turning)])
            if self._direction:
                brackets = brackets[:, brackets[3] == self._direction]
            if brackets.size:
                yield self._crossings(brackets)
            height = heights[-1]
            side = sides[-1]

    def _heights(self, samples: Samples) -> Floats:
        with np.errstate(all="ignore"):  # a failing run may overflow
            return self._channel_of(samples) - self._value

    def _heights_within(self, offset: Floats, which: Floats) -> Floats:
        """Return heights at times within steps, of the shape of these times."""
        steps = np.broadcast_to(which, offset.shape).astype(np.int64)
        samples = self._follower.within(steps.ravel(), offset.ravel())
        return self._heights(samples).reshape(offset.shape)

    def _pairs(self, stretches: Floats) -> Iterator[Floats]:
        """Yield brackets of pairs of crossings, in stretches that begin on one side."""
        last = GRID.size - 1
        for _ in range(MOST_GRIDS):
            if not stretches.size:
                return
            which, low, high, side = stretches
            offset = low[:, None] + (high - low)[:, None] * GRID
            heights = side[:, None] * self._heights_within(offset, which[:, None])
            rows = np.arange(len(which))
            lowest = heights.argmin(axis=1)
            before = np.maximum(lowest - 1, 0)
            after = np.minimum(lowest + 1, last)
            depth = heights[rows, lowest]
            bottom = offset[rows, lowest]
            # At both ends the side is known, if not the last bit of the height.
            is_beyond = (depth < 0) & (lowest > 0) & (lowest < last)
            yield np.stack([which, low, bottom, -side])[:, is_beyond]
            yield np.stack([which, bottom, high, side])[:, is_beyond]
            # A parabola falls below its lowest point of a grid by an eighth of its rise
            # to the next ones; a smooth function by less than that rise.
            around = np.clip(lowest[:, None] + NEIGHBOURS, 0, last)
            rise = np.take_along_axis(heights, around, axis=1).max(axis=1) - depth
            is_open = ~is_beyond & (depth < rise)
            narrower = [which, offset[rows, before], offset[rows, after], side]
            stretches = np.stack(narrower)[:, is_open]

    def _crossings(self, brackets: Floats) -> tuple[Samples, Flags]:
        """Return the crossings in brackets, in order of time, and whether they rise."""
        from scipy.optimize.elementwise import find_root

        order = np.lexsort((brackets[1], brackets[0]))
        which, low, high, direction = brackets[:, order]
        with np.errstate(all="ignore"):  # of the extrapolations
            roots = find_root(self._heights_within, (low, high), args=(which,))
        at_low = np.abs(self._heights_within(low, which))
        at_high = np.abs(self._heights_within(high, which))
        # The last bit may decide on which side of the value a step ends.
        nearer = np.where(at_low < at_high, low, high)
        offset = np.where(roots.success, roots.x, nearer)
        samples = self._follower.within(which.astype(np.int64), offset)
        most = SMOOTH * (at_low + at_high) + _ROUNDING * abs(self._value)
        is_smooth = np.abs(self._heights(samples)) <= most
        return take(samples, is_smooth), direction[is_smooth] > 0


def _pieces(lengths: Floats, swing: float) -> tuple[Floats, Floats, Floats]:
    """Return the pieces of steps of some lengths: step, begin and end within it."""
    counts = np.ceil(lengths * swing / PIECE_ANGLE)
    counts = counts.clip(FEWEST_PIECES_A_STEP, MOST_PIECES_A_STEP).astype(np.int64)
    which = np.repeat(np.arange(len(lengths)), counts)
    place = np.arange(len(which)) - (np.cumsum(counts) - counts)[which]
    share = place / counts[which]
    next_share = (place + 1) / counts[which]
    return which.astype(float), share * lengths[which], next_share * lengths[which]


def _sides(heights: Floats, first: float) -> Floats:
    """Return the sides of heights, 1 or -1; a height of zero is still on the last."""
    sides = np.sign(heights)
    sides[0] = first
    latest = np.where(sides != 0, np.arange(len(sides)), 0)
    return sides[np.maximum.accumulate(latest)]


def _may_turn(heights: Floats, sides: Floats) -> Flags:
    """Return the pieces between heights in which these may turn back beyond zero.

    That is by an end which is not higher than the next ones, by as much as in `_pairs`.
    """
    distance = sides * heights
    before = np.append(np.inf, sides[1:] * heights[:-1])
    after = np.append(sides[:-1] * heights[1:], np.inf)
    is_lowest = (distance <= before) & (distance <= after)
    turns: Flags = is_lowest & (distance < np.maximum(before, after) - distance)
    return turns[:-1] | turns[1:]
