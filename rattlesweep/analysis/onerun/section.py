"""Sections of one run: the states at which a channel passes through a value.

Each accepted step is cut into pieces that are short compared with a swing.  A piece
whose ends lie on two sides of the value has a crossing.  A piece whose ends lie on one
side has a pair of them if the channel turns back beyond the value, so its extreme is
searched wherever one may lie.  Every state is one step of the method from the accepted
step before it, and the searches of many pieces go on together.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize.elementwise import find_root

from rattlesweep.analysis.derived import si_of
from rattlesweep.analysis.onerun.channels import CHANNELS, Channel
from rattlesweep.arrays import Flags, Floats, Integers, Places, take
from rattlesweep.errors import ConfigError, one_line
from rattlesweep.integrate.lanes.events import PIECE_ANGLE
from rattlesweep.integrate.lanes.lane import SLIP_SPEED
from rattlesweep.physics.si import NATURAL
from rattlesweep.quantities import RATE
from rattlesweep.sweeps.config import not_one_of
from rattlesweep.units import quantity, require_unit

if TYPE_CHECKING:
    from rattlesweep.integrate.follow import Follower, Samples
    from rattlesweep.physics.si import Units

# A step has at least a few pieces, since a run may swing faster than at its launch.
FEWEST_PIECES = 4
MOST_PIECES = 128
# An extreme is searched on a grid, and then on a finer one about its lowest point.
# The last is so fine that the value there is exact up to rounding.
GRID = np.linspace(0.0, 1.0, 9)
MOST_GRIDS = 14
# Part of the values at both ends of a piece that remains where a channel jumps.
JUMP = 1e-6
ROUNDING = 1e-14  # of a value, relative to its size

# The kinds of quantities that have a unit of the body.
KINDS = {unit: kind for kind, unit in NATURAL.items()} | {RATE: "spin"}
NO_SECTIONS = {
    "t": "it only grows; rows at given times are those of points, dt or times",
    "sliding": "it jumps; `slides` of a trajectory has these times",
    "n_reduced": "it belongs to another model; take model: reduced, and n",
}
# The columns of a section for which none are asked.
VARIABLES = {
    "full": ("n", "omega_x", "omega_y", "omega_z", "u_x", "u_y", "u_z"),
    "reduced": ("n", "E_p", "E_r"),
}
DIRECTIONS = {"+": 1, "-": -1, "": 0}
RISES = "whether {} rises through its value"


@dataclass(frozen=True)
class Section:
    """A value of a channel, and the directions in which a run passes through it."""

    text: str  # as it was written
    channel: Channel
    value: float  # in the units of the body
    direction: int  # 1: only rising, -1: only falling, 0: both

    @classmethod
    def parse(
        cls, text: object, model: str, units: Units | None, *, is_typed: bool = False
    ) -> Section:
        """Read a text such as ``omega_y``, ``omega_y=0.1+`` or ``n=-60 rpm-``.

        A number that is typed on the command line needs a unit if the body has a size.
        Raise a ConfigError for what is not a section of the model.
        """
        match = None
        if isinstance(text, str):
            match = re.fullmatch(r"\s*(\w+)\s*(?:=\s*(.+?)\s*)?([+-]?)\s*", text)
        if match is None:
            raise ConfigError(
                f"section: {one_line(repr(text))} is none; give a channel "
                "and a value, as in omega_y=0, and + or - for one direction"
            )
        name, number, sign = match.groups()
        if name in NO_SECTIONS:
            raise ConfigError(f"section: {name} has no section: {NO_SECTIONS[name]}")
        known = [
            channel.name
            for channel in CHANNELS.values()
            if model in channel.models and channel.name not in NO_SECTIONS
        ]
        if name not in known:
            raise ConfigError(f"section: {not_one_of(name, known)}")
        channel = CHANNELS[name]
        value = 0.0
        if number is not None:
            value = _value(number, KINDS.get(channel.unit), units, is_typed)
        return cls(match[0].strip(), channel, value, DIRECTIONS[sign])

    def value_in(self, units: Units | None) -> tuple[float, str]:
        """Return the value and its unit, in SI if the size of the body is known."""
        unit = self.channel.unit
        if units is None or unit not in units.sizes:
            return self.value, unit
        size, si_unit = si_of(self.channel.name, unit, units)
        return size * self.value, si_unit


def _value(number: str, kind: str | None, units: Units | None, is_typed: bool) -> float:
    """Return the value of a section in the units of the body."""
    number = one_line(number)
    try:
        value = float(number)
    except ValueError:
        if units is None or kind is None:
            raise ConfigError(
                f"section: {number} is not a number; a unit needs a body with a size, "
                "and a channel with a unit"
            ) from None
    else:
        if not math.isfinite(value):
            raise ConfigError(f"section: {number} is not finite")
        if is_typed and units is not None and kind is not None:
            require_unit("--section", value, kind)
        return value
    try:
        return float(units.natural(quantity(number, kind), kind))
    except ValueError as error:
        raise ConfigError(f"section: {number} {error}") from None


@dataclass(frozen=True)
class Pieces:
    """Pieces of steps; times are within the step."""

    which: Integers  # the step
    begin: Floats
    end: Floats
    is_last: Flags  # whether the step ends with it

    @classmethod
    def of(cls, lengths: Floats, swing: float) -> Pieces:
        """Return the pieces of steps of some lengths."""
        angles = lengths * swing
        counts = np.clip(np.ceil(angles / PIECE_ANGLE), FEWEST_PIECES, MOST_PIECES)
        counts = counts.astype(np.int64)
        which = np.repeat(np.arange(len(lengths)), counts)
        place = np.arange(len(which)) - (np.cumsum(counts) - counts)[which]
        piece = (lengths / counts)[which]
        is_last = place == counts[which] - 1
        end = np.where(is_last, lengths[which], (place + 1) * piece)
        return cls(which, place * piece, end, is_last)


@dataclass(frozen=True)
class Brackets:
    """Stretches of steps, each with one crossing; times are within the step."""

    which: Integers  # the step
    low: Floats
    high: Floats
    direction: Floats  # 1 rising, -1 falling


class Search:
    """Finds the crossings of a section in a run, while it is integrated.

    The launch is no crossing, and neither is a jump over the value, as forces do where
    a slide ends.  A channel that touches the value does not cross it.
    """

    def __init__(
        self,
        section: Section,
        follower: Follower,
        channel_of: Callable[[Samples], Floats],
    ) -> None:
        self._section = section
        self._follower = follower
        self._channel_of = channel_of

    def __iter__(self) -> Iterator[tuple[Samples, Flags]]:
        """Yield crossings and whether they rise, those of some steps at a time."""
        follower = self._follower
        direction = self._section.direction
        height = self._heights(follower.launch())[0]
        side = None
        while not follower.ended:
            steps = follower.steps()
            pieces = Pieces.of(follower.lengths(), follower.swing)
            heights = self._heights_at_ends(pieces, steps, height)
            if side is None:
                # A launch on the section is on neither side of it.
                largest = np.nanmax(np.abs([self._section.value, *heights]))
                is_on_it = abs(height) <= ROUNDING * largest
                side = 0.0 if is_on_it else np.sign(height)
            sides = _sides(heights, side)
            # The rate of a channel may jump where a slide begins or ends.
            kinks = np.append(True, pieces.is_last)
            kinks &= (steps.slip[:, SLIP_SPEED] > 0).any()
            may_turn = _may_turn(heights, sides, kinks)
            brackets = _joined(
                _changes(pieces, sides), *self._pairs(pieces, sides, may_turn)
            )
            if direction:
                brackets = take(brackets, brackets.direction == direction)
            if brackets.which.size:
                yield self._crossings(brackets)
            height = heights[-1]
            side = sides[-1]

    def _heights(self, samples: Samples) -> Floats:
        """Return the channel less the value of the section."""
        with np.errstate(all="ignore"):  # a failing run may overflow
            return self._channel_of(samples) - self._section.value

    def _heights_within(self, offset: Floats, which: Integers) -> Floats:
        """Return heights at times within steps."""
        return self._heights(self._follower.within(which.astype(np.int64), offset))

    def _heights_at_ends(self, pieces: Pieces, steps: Samples, first: float) -> Floats:
        """Return the height where the steps begin, then those at ends of pieces."""
        inner = ~pieces.is_last
        ends = np.empty(len(pieces.which))
        ends[inner] = self._heights_within(pieces.end[inner], pieces.which[inner])
        # Steps end where the next ones begin, up to the last bit.
        ends[pieces.is_last] = self._heights(steps)
        return np.append(first, ends)

    def _pairs(
        self, pieces: Pieces, sides: Floats, may_turn: Flags
    ) -> Iterator[Brackets]:
        """Yield pairs of crossings in pieces with both ends on one side."""
        places = np.flatnonzero(may_turn & (sides[:-1] == sides[1:]) & (sides[1:] != 0))
        which = pieces.which[places]
        low = pieces.begin[places]
        high = pieces.end[places]
        side = sides[1:][places]
        for _ in range(MOST_GRIDS):
            if not which.size:
                return
            offset = low[:, None] + (high - low)[:, None] * GRID
            heights = self._heights_within(offset.ravel(), which.repeat(GRID.size))
            heights = side[:, None] * heights.reshape(offset.shape)
            lowest = heights.argmin(axis=1)[:, None]
            depth = _entries(heights, lowest)[:, 0]
            # Which side the ends are on is known, up to the last bit of a height there.
            is_inside = (lowest[:, 0] > 0) & (lowest[:, 0] < GRID.size - 1)
            beyond = is_inside & (depth < 0)
            bottom = _entries(offset, lowest)[:, 0]
            yield take(Brackets(which, low, bottom, -side), beyond)
            yield take(Brackets(which, bottom, high, side), beyond)
            # A smooth function is less below its lowest point of the grid than the next
            # ones are above it: by an eighth, if it is a parabola.
            around = _entries(heights, lowest + np.array([-2, -1, 1, 2]))
            is_open = ~beyond & (depth < around.max(axis=1) - depth)
            low = _entries(offset, lowest - 1)[is_open, 0]
            high = _entries(offset, lowest + 1)[is_open, 0]
            which = which[is_open]
            side = side[is_open]

    def _crossings(self, brackets: Brackets) -> tuple[Samples, Flags]:
        """Return the states at the crossings in order of time, and which rise."""
        which = brackets.which
        ends = brackets.low, brackets.high
        with np.errstate(all="ignore"):  # of the extrapolations
            roots = find_root(self._heights_within, ends, args=(which,))
        at_low, at_high = (abs(self._heights_within(end, which)) for end in ends)
        # At an accepted step, the last bit may decide on which side a state is.
        nearer = np.where(at_low < at_high, *ends)
        offset = np.where(roots.success, roots.x, nearer)
        order = np.lexsort((offset, which))
        samples = self._follower.within(which[order], offset[order])
        remaining = abs(self._heights(samples))
        allowed = JUMP * (at_low + at_high) + ROUNDING * abs(self._section.value)
        is_smooth = remaining <= allowed[order]
        rises = brackets.direction[order] > 0
        return take(samples, is_smooth), rises[is_smooth]


def _sides(heights: Floats, first: float) -> Floats:
    """Return the sides of heights, 1 or -1; a height of zero is still on the last."""
    sides = np.sign(heights)
    sides[0] = first
    latest = np.where(sides != 0, np.arange(len(sides)), 0)
    return sides[np.maximum.accumulate(latest)]


def _may_turn(heights: Floats, sides: Floats, kinks: Flags) -> Flags:
    """Return the pieces in which heights may turn back beyond zero.

    `heights` and `sides` are those at the ends of pieces.  At `kinks`, and at both ends
    of all, nothing is known from the next piece.
    """
    distance = sides * heights
    before = np.append(np.inf, sides[1:] * heights[:-1])
    after = np.append(sides[:-1] * heights[1:], np.inf)
    is_lowest = (distance <= before) & (distance <= after)
    is_near = distance < np.maximum(before, after) - distance
    turns: Flags = (is_lowest & is_near) | kinks
    return turns[:-1] | turns[1:]


def _changes(pieces: Pieces, sides: Floats) -> Brackets:
    """Return the pieces with ends on two sides."""
    changes = sides[:-1] * sides[1:] < 0
    return take(Brackets(pieces.which, pieces.begin, pieces.end, sides[1:]), changes)


def _joined(*several: Brackets) -> Brackets:
    """Return the brackets of several in one."""
    return Brackets(
        np.concatenate([each.which for each in several]),
        np.concatenate([each.low for each in several]),
        np.concatenate([each.high for each in several]),
        np.concatenate([each.direction for each in several]),
    )


def _entries(values: Floats, places: Places) -> Floats:
    """Return entries of each row, shape (rows, places); beyond the ends, these."""
    return np.take_along_axis(values, places.clip(0, values.shape[1] - 1), axis=1)
