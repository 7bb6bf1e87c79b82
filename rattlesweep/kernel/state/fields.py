"""Kinds of fields of a lane, those that every turn uses, and rows of a workspace.

A noun, such as a mark, a slide or a search, declares its fields beside its code, in a
class whose annotations are kinds.  `kernel.collected` lists these classes.
"""

# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc"

from collections.abc import Mapping, Sequence
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    NamedTuple,
    NewType,
    TypeVar,
    get_origin,
    get_type_hints,
)

from numba import config, types

from rattlesweep.kernel.method.collocation import STAGES
from rattlesweep.kernel.method.tableau import Tableau
from rattlesweep.motion.model import Model

LANES = 1 if config.DISABLE_JIT else 32  # measured by benchmarks/kernel.py --lanes
# A step is tried on whole groups of lanes, so that the last runs of a thread, in the
# first groups, do not pay for all others: two vectors of AVX2 or one of AVX-512.
GROUP = min(8, LANES)


class Slip(NamedTuple):
    """Sliding of the contact point on the plane, in the body's units.

    A body slides while the speed is positive; where a slide begins, it is the smallest
    positive number.
    """

    speed: float
    angle: float  # direction in the plane, from the horizontal part of the x axis
    work: float  # of sliding friction since the launch, negative


# Columns of a table of slips.
SLIP_SPEED, SLIP_ANGLE, SLIP_WORK, N_SLIP = range(4)


# States of the search of a lane.  STEP: none; PEAK, RETAKE and PUT_OFF are
# of `event.peaks`, the others of `event.zeros`.
STEP, SCAN, MINIMUM, ROOT, REDO, PEAK, RETAKE, PUT_OFF = range(8)


class Point(NamedTuple):
    """A function of the state at a point of a step."""

    h: float  # time from the start of the step
    value: float
    rate: float


class Peak(NamedTuple):
    """A largest value within a step, and how the function bends there."""

    h: float  # time from the start of the step; 0 for none
    value: float
    bend: float  # second derivative


MOST_REVERSALS = 8  # reversals that are stored
NO_ROW = -1  # of a field that a model lacks
NEVER = 1e290  # above any time, modulus and force of a run
DIFFERENCE = 1e-7  # length of differences along the flow, in radians of the swing

# Kinds of fields of a lane, besides points, peaks and slips; all numbers are doubles.
Number = float
Flag = float  # 1 or 0
# As many numbers as the model has of them.
State = NewType("State", tuple[float, ...])
Constants = NewType("Constants", tuple[float, ...])
Probe = NewType("Probe", tuple[float, ...])
Tangent = NewType("Tangent", tuple[float, ...])  # all tangents together
Lengths = NewType("Lengths", tuple[float, ...])  # one for each tangent of a frame
Past = NewType("Past", tuple[float, ...])  # coefficients of rates in a step of a slide
_Kind = TypeVar("_Kind")
# What every lane knows of the end of the step tried and of its peaks, beside what the
# model has there.  A search in the step writes over it, and puts it back
# (`runs.keep_end`).
OfEnd = Annotated[_Kind, "of the end of the step"]


class TurnFields:
    """What every turn reads or writes.

    Side by side, and followed by the state and the stages, these rows use all sets of a
    first-level cache of 32 KiB alike.
    """

    t: Number  # time
    t_low: Number  # its low part in a compensated sum
    t_end: Number  # horizon
    steps: Number  # accepted steps

    # The step tried.
    h: OfEnd[Number]  # size
    error: OfEnd[Number]  # square of the error, in units of the tolerance
    root: OfEnd[Number]  # `rough_root` of the error
    root0: Number  # the same of the step before
    n0: Number  # spin at the start
    rate0: Number  # rate of the spin at the start
    n1: OfEnd[Number]  # spin at the end
    rate1: OfEnd[Number]
    amplitude: OfEnd[Number]  # squared, at the end
    last: Flag  # whether the step ends at the horizon
    held: Flag  # whether it repeats one that was rejected; the next does not grow then

    # The decision on it.
    accept: Flag  # whether the lane takes the step
    h_next: Number  # size of the next step
    h_longest: Number  # largest size of any step

    # The run, its search, and what is due.
    rate_max: Number  # largest recent rate
    sign: Number  # of the spin between its zeros; 0 if no more of them are searched
    n_least: Number  # smallest ``sign * n`` since the launch
    search: Number  # state of the search within a held step: STEP, SCAN, ...
    watched: Number  # above 0 if the step may hold a zero of a limit or a new extreme
    a_max: Number  # largest squared amplitude since the last comparison
    next: Number  # time at which a comparison or the end of a window is due


class MotionFields:
    """The state at either end of the step."""

    y: State
    f: State  # derivative


class BodyFields:
    """What the equations need of a run."""

    probe: Probe
    constants: Constants


def rows_in(kind: types.Type) -> int:
    """Return the number of rows of a field of a Numba type."""
    if kind is types.float64:
        return 1
    return len(kind)


class Layout:
    """Rows of a workspace: the first row of each field is an attribute of its name.

    First come the fields that every lane has, whatever its model.  The fields of a
    model begin with the row ``first``: those at the start of a step; from the row
    ``second`` on the same at its end, with a 1 at the end of their names; and others.
    ``kept`` is the first row of an end of a step that is kept (`runs.keep_end`): copies
    of ``rows_of_end``, which are those of fields :data:`OfEnd`, and of the model's
    fields at the end.  ``results`` is the first row of what its modes add to the
    results of a run, and ``stages`` that of the stages.  ``fields`` has the first row
    and the Numba type by name.  A number within a field may have a name of its own.

    Parameters
    ----------
    shared, ends, others, results : sequence of type
        Classes that declare fields: of every lane; at both ends of a step; others of
        the model; and results of its modes.
    counts : mapping
        How many numbers a field has, by kinds that depend on the model.
    parts : mapping
        By their names, the field in which a number is, and its place there.
    """

    def __init__(
        self,
        shared: Sequence[type],
        ends: Sequence[type] = (),
        others: Sequence[type] = (),
        results: Sequence[type] = (),
        counts: Mapping[Any, int] | None = None,
        parts: Mapping[str, tuple[str, int]] | None = None,
    ) -> None:
        self.fields: dict[str, tuple[int, types.Type]] = {}
        self.counts = counts or {}
        self.first = self._add(0, shared)
        self.second = self._add(self.first, ends)
        self.kept = self._add(self._add(self.second, ends, "1"), others)
        self.rows_of_end = self._rows_of_end(shared)
        kept_rows = len(self.rows_of_end) + self.second - self.first
        self.results = self.kept + kept_rows
        self.stages = self._add(self.results, results)
        for name, (whole, place) in (parts or {}).items():
            first, _ = self.fields[whole]
            self.fields[name] = first + place, types.float64

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> int: ...

    def row_of(self, name: str) -> int:
        """Return the first row of a field, or `NO_ROW` if the model has no such."""
        row, _ = self.fields.get(name, (NO_ROW, None))
        return row

    def _add(self, row: int, nouns: Sequence[type], suffix: str = "") -> int:
        """Add the fields of classes from a row on, and return the row after them."""
        for noun in nouns:
            for name, kind in get_type_hints(noun).items():
                type_of_field = self._type_of(kind)
                self.fields[name + suffix] = row, type_of_field
                setattr(self, name + suffix, row)
                row += rows_in(type_of_field)
        return row

    def _rows_of_end(self, nouns: Sequence[type]) -> tuple[int, ...]:
        """Return the rows of the fields of classes that are :data:`OfEnd`."""
        rows: list[int] = []
        for noun in nouns:
            for name, kind in get_type_hints(noun, include_extras=True).items():
                if get_origin(kind) is Annotated:
                    first, type_of_field = self.fields[name]
                    rows += range(first, first + rows_in(type_of_field))
        return tuple(rows)

    def _type_of(self, kind: object) -> types.Type:
        """Return the Numba type of a kind of field."""
        if self.counts.get(kind) == 0:
            return types.Tuple(())
        if kind in self.counts:
            return types.UniTuple(types.float64, self.counts[kind])
        if kind in (Point, Slip, Peak):
            return types.NamedUniTuple(types.float64, 3, kind)
        # A Number or a Flag.
        return types.float64

    def rows(self, tableau: Tableau, model: Model) -> int:
        """Return the number of rows of the workspace for a method."""
        vectors = 1 + model.n_tangents
        stages = (tableau.stages - 1) * vectors * model.n_state
        if model.stiffness is not None:
            # At each stage, the state, its derivative and the rates of three positions;
            # and ten numbers that say how stiff the slip is (`step.implicit`).
            stages = STAGES * (2 * model.n_state + 3) + 10
        # What is carried from stage to stage: its start, and a rate at each stage.
        carried = model.n_carried * (tableau.stages + 1)
        return self.stages + stages + carried
