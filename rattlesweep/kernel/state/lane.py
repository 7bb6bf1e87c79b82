"""Lanes: many runs side by side in one workspace, as compiled code sees them.

The workspace is one flat array of rows, each of which holds one number of every lane,
so that loops over lanes vectorise.  (With several arrays, LLVM would have to prove that
they do not overlap.)  In compiled code a lane reads as a record: ``lane.t_end``,
``lane.y1 = lane.y``.  A field is the lane's number in one row, or the tuple of its
numbers in consecutive rows.

:func:`gather` and :func:`scatter` replace hundreds of indexed reads, products and sums.
Typing and lowering these would take Numba most of the time that a kernel takes to
compile.

Private interfaces of Numba that are used here (tried with 0.68.1): ``cgutils``,
``AttributeTemplate``; ``make_array``, ``make_tuple``, ``get_dummy_value``,
``get_constant_generic`` and ``resolve_value_type`` of contexts.  Types of private
interfaces are imported for annotations alone.  Others are in
:mod:`rattlesweep.compiling.intrinsics`.
"""

# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc"
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, is_dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from llvmlite import ir
from numba import extending, njit, types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate

from rattlesweep.arrays import Floats
from rattlesweep.motion.model import Model

if TYPE_CHECKING:
    from numba.core.base import BaseContext
    from numba.core.datamodel import DataModelManager
    from numba.core.pythonapi import _UnboxContext
    from numba.core.typing.templates import Signature
from rattlesweep.compiling.intrinsics import DOUBLE, INNER, intrinsic
from rattlesweep.kernel.state.fields import LANES, Layout, Point, rows_in
from rattlesweep.physics.full import scalar


@njit(**INNER)
def nothing(*arguments):
    """Do nothing, for a run without tangents or a body that only rolls."""


@njit(**INNER)
def recorded(table):
    """Return whether an observation is recorded: its table has rows for runs then."""
    return table.shape[0] > 0


@scalar
def never(lane):
    """Return no."""
    return False


@scalar
def as_found(lane, limit):
    """Return a limit as it is."""
    return limit


@dataclass(frozen=True)
class Mode:
    """A way of moving, as compiled functions of a lane that moves so."""

    number: float  # `lane.mode`
    # limit(lane, h, y, f): positive while the body moves so
    limit: Callable[..., Point]
    # change(lane, status, move, goes_on, reversals_recorded): after a step that is
    # taken or ends the run, let the lane go over to the mode that follows; return the
    # status and the move then
    change: Callable[..., tuple[int, int]]
    # margin(lane, y, f): of a mode in which most lanes are, a smooth function with the
    # sign of the limit; None where the limit is never zero
    margin: Callable[..., float] | None = None
    # is_calm(lane): whether it stays positive in a step tried that is short of rims;
    # None where that is not known
    is_calm: Callable[..., bool] | None = None
    # observe_limit(problem, w, used): compute the limit for those of the first ``used``
    # lanes that move so, where that of most lanes is another
    observe_limit: Callable[..., None] | None = None
    # gives_way(lane): whether the plane may let a spin go that it holds in the step
    # tried, from a closer look
    gives_way: Callable[..., bool] = never


@dataclass(frozen=True)
class ModeSet:
    """All modes of a model's bodies together, as compiled functions of any lane."""

    limit: Callable[..., Point]
    # Whether there is one that may be zero, whether `schedule` and `decide` have a
    # choice, and whether `advance` moves something.
    limited: bool
    schedules: bool
    advances: bool
    # margin(lane, y, f): that of the mode in which most lanes are
    margin: Callable[..., float]
    # observe_limit(problem, w, used): tell which steps tried on the used lanes
    # may end at a zero of the limit
    observe_limit: Callable[..., None]
    gives_way: Callable[..., bool]  # as in `Mode`
    change: Callable[..., tuple[int, int]]
    # schedule(problem, w): return whether lanes that roll try a step in this turn, and
    # whether there are lanes that slide
    schedule: Callable[..., tuple[bool, bool]]
    # decide(problem, w, due): decide on lanes that slide or wait; return which are due
    decide: Callable[..., int]
    # settle(lane, y, n, t): go over to the mode of a body that rolls in the state y,
    # with the spin n, which is at most `TINY` where that of y is a rounding error
    settle: Callable[..., None]
    # left(lane, y): height from the contact up to the rim; 1 without a rim
    left: Callable[..., float]
    # At the end of the step: the energy minus the work of friction, and this work.
    energy: Callable[..., float]
    work: Callable[..., float]
    # observe(model, y, slip, constants, mu): energy minus work, normal and tangential
    # force, torque of friction along the vertical
    observe: Callable[..., tuple[float, float, float, float]]
    # look(lane): compute the limit at the ends of a step tried that is to be searched
    look: Callable[..., None] = nothing
    # at_start(lane, limit): the limit at the start of the step, from its value there
    at_start: Callable[..., Point] = as_found
    # refuses(lane): whether the plane would have to pull the body at its launch, where
    # this ends its run
    refuses: Callable[..., bool] = never
    # prepare(lane): set what the equations need of a launch
    prepare: Callable[..., None] = nothing
    # launch(lane): go over to the mode of the launch, once the run is started
    launch: Callable[..., None] = nothing
    # free(lane): let a body at rest begin to slide at the end of the step
    free: Callable[..., None] = nothing
    # slow(lane): after a step to the end of a slide, or towards it, correct the spin
    slow: Callable[..., None] = nothing
    # advance(problem, w): move what modes add to the state to the end of the step
    advance: Callable[..., None] = nothing
    # store(lane): set what modes add to the results of a run that has ended
    store: Callable[..., None] = nothing


@dataclass(frozen=True)
class Tangents:
    """Compiled functions of the tangents that a run carries (`kernel.tangents`)."""

    start: Callable[..., None]
    advance: Callable[..., None]
    # note(lane, t, k, growths): store the growth in row k of the run
    note: Callable[..., None]


class Problem:
    """What a kernel is compiled for: a model, or none, and the number of lanes.

    The runs of a rimmed problem end where the contact passes the rim of their body.

    For compiled functions it is an argument without data, and its attributes, like
    those of its model and its modes, are constants.
    """

    known: ClassVar[dict[str, Problem]] = {}

    def __init__(
        self,
        model: Model | None,
        layout: Layout,
        lanes: int = LANES,
        modes: ModeSet | None = None,
        tangents: Tangents | None = None,
        rimmed: bool = False,
        rack: Any = None,
    ) -> None:
        if model is not None:
            # State, constants and probe of an empty lane.
            state = (1.0,) * model.n_state
            constants = (1.0,) * model.n_constants
            self.idle = state, constants, (0.0,) * model.n_probe
        self.model = model
        if modes is not None and tangents is not None:
            self.modes = modes
            self.tangents = tangents
        self.rack = rack  # `radau.Rack` of a model that slides
        self.name = f"any_{lanes}"
        if model is not None:
            self.name = f"{model.name}_{lanes}"
        if rimmed:
            self.name += "_rimmed"
        self.lanes = lanes
        self.layout = layout
        self.first = layout.first  # first row of the fields that depend on the model
        self.rows_of_end = layout.rows_of_end
        self.known[self.name] = self


# How Numba types, stores and reads a problem and a lane.  It calls what is registered
# with `extending`, by the types of the values in a compiled function.


class RecordType(types.Type):
    """Numba's type of a problem or of a record in it, whose attributes are constants.

    It has the name of the problem and not the problem, since types are stored on disk.
    """

    def __init__(self, problem: str, *path: str) -> None:
        self.problem = problem
        self.path = path
        super().__init__(f"Record({'.'.join([problem, *path])})")

    def value_of(self, name: str) -> object:
        """Return an attribute."""
        record: object = Problem.known[self.problem]
        for step in (*self.path, name):
            record = getattr(record, step)
        return record


# Without members a record takes no argument in machine code, so `turn.drive` leaves
# it out.
@extending.register_model(RecordType)
class _RecordModel(extending.models.StructModel):
    def __init__(self, manager: DataModelManager, record: RecordType) -> None:
        super().__init__(manager, record, [])


@extending.typeof_impl.register(Problem)
def _typeof(problem: Problem, _: object) -> RecordType:
    return RecordType(problem.name)


@extending.unbox(RecordType)
def _unbox_problem(
    problem: RecordType, _: object, c: _UnboxContext
) -> extending.NativeValue:
    return extending.NativeValue(_empty(c.context, c.builder, problem))


def _empty(context: BaseContext, builder: ir.IRBuilder, record: RecordType) -> ir.Value:
    return cgutils.create_struct_proxy(record)(context, builder)._getvalue()


@extending.infer_getattr
class _Attributes(AttributeTemplate):
    key = RecordType

    def generic_resolve(self, record: RecordType, name: str) -> types.Type:
        value = record.value_of(name)
        if is_dataclass(value):
            return RecordType(record.problem, *record.path, name)
        if isinstance(value, int):
            return types.literal(value)
        return self.context.resolve_value_type(value)


@extending.lower_getattr_generic(RecordType)
def _get_attribute(
    context: BaseContext,
    builder: ir.IRBuilder,
    record: RecordType,
    _: object,
    name: str,
) -> ir.Value:
    value = record.value_of(name)
    if is_dataclass(value):
        return _empty(context, builder, RecordType(record.problem, *record.path, name))
    if callable(value):
        return context.get_dummy_value()
    kind = context.typing_context.resolve_value_type(value)
    return context.get_constant_generic(builder, kind, value)


class LaneType(types.Type):
    """Numba's type of a lane."""

    def __init__(self, problem: RecordType) -> None:
        self.problem = problem
        super().__init__(f"Lane({problem.problem})")

    def field(self, name: str) -> tuple[int, types.Type]:
        """Return the first row and the type of a field."""
        return Problem.known[self.problem.problem].layout.fields[name]


@extending.register_model(LaneType)
class _LaneModel(extending.models.StructModel):
    def __init__(self, manager: DataModelManager, lane: LaneType) -> None:
        members = [("data", types.CPointer(types.float64)), ("place", types.intp)]
        super().__init__(manager, lane, members)


class Lane:
    """A lane in Python, used where nothing is compiled."""

    problem: Problem

    def __init__(self, problem: Problem, w: Floats, l: int) -> None:
        vars(self)["problem"] = problem
        vars(self)["cells"] = w.reshape(-1, problem.lanes)[:, l]

    def __getattr__(self, name: str) -> Any:
        row, kind = self.problem.layout.fields[name]
        cells: Floats = vars(self)["cells"]
        if kind is types.float64:
            return cells[row]
        values = tuple(cells[row : row + len(kind)])
        if hasattr(kind, "instance_class"):
            return kind.instance_class(*values)
        return values

    def __setattr__(self, name: str, value: Any) -> None:
        row, kind = self.problem.layout.fields[name]
        vars(self)["cells"][row : row + rows_in(kind)] = value


class _Cells(NamedTuple):
    """A writer of LLVM code that reads and writes the cells of one lane."""

    builder: ir.IRBuilder
    data: ir.Value
    lane: ir.Value
    lanes: int

    def place(self, row: int) -> ir.Value:
        index = self.builder.add(self.lane.type(row * self.lanes), self.lane)
        return cgutils.gep(self.builder, self.data, index)

    def read(self, row: int) -> ir.Value:
        return self.builder.load(self.place(row))

    def write(self, row: int, value: ir.Value) -> None:
        self.builder.store(value, self.place(row))

    def product(self, number: float, row: int) -> ir.Value:
        value = self.read(row)
        if number == 1.0:
            return value
        return self.builder.fmul(DOUBLE(number), value)

    def value(self, wanted: int | Sum) -> ir.Value:
        if isinstance(wanted, int):
            return self.read(wanted)
        products = [self.product(*term) for term in wanted.terms]
        # Two chains of sums have half the latency of one.
        chains = [products[i::2] for i in range(min(2, len(products)))]
        total = reduce(
            self.builder.fadd, (reduce(self.builder.fadd, chain) for chain in chains)
        )
        if wanted.factor is not None:
            total = self.builder.fmul(self.product(wanted.share, wanted.factor), total)
        if wanted.row is None:
            return total
        return self.builder.fadd(self.read(wanted.row), total)


def _cells(
    context: BaseContext, builder: ir.IRBuilder, lane: LaneType, value: ir.Value
) -> _Cells:
    record = cgutils.create_struct_proxy(lane)(context, builder, value)
    lanes = Problem.known[lane.problem.problem].lanes
    return _Cells(builder, record.data, record.place, lanes)


@extending.infer_getattr
class _Fields(AttributeTemplate):
    key = LaneType

    def generic_resolve(self, lane: LaneType, name: str) -> types.Type:
        if name == "problem":
            return lane.problem
        _, kind = lane.field(name)
        return kind


@extending.lower_getattr_generic(LaneType)
def _get(
    context: BaseContext,
    builder: ir.IRBuilder,
    lane: LaneType,
    value: ir.Value,
    name: str,
) -> ir.Value:
    if name == "problem":
        return _empty(context, builder, lane.problem)
    cells = _cells(context, builder, lane, value)
    row, kind = lane.field(name)
    if kind is types.float64:
        return cells.read(row)
    return context.make_tuple(
        builder, kind, [cells.read(row + i) for i in range(len(kind))]
    )


@extending.lower_setattr_generic(LaneType)
def _set(
    context: BaseContext,
    builder: ir.IRBuilder,
    signature: Signature,
    args: Sequence[ir.Value],
    name: str,
) -> None:
    lane = signature.args[0]
    cells = _cells(context, builder, lane, args[0])
    row, kind = lane.field(name)
    if kind is types.float64:
        cells.write(row, args[1])
        return
    for i in range(len(kind)):
        cells.write(row + i, builder.extract_value(args[1], i))


@intrinsic(
    lambda typingctx, problem, w, l: LaneType(problem)(problem, w, types.intp), Lane
)
def lane_of(context, builder, signature, args):
    """Return lane ``l`` of a workspace ``w``."""
    lane = cgutils.create_struct_proxy(signature.return_type)(context, builder)
    lane.data = context.make_array(signature.args[1])(context, builder, args[1]).data
    lane.place = args[2]
    return lane._getvalue()


class Sum(NamedTuple):
    """``w[row] + share * w[factor] * (a * w[i] + b * w[j] + ...)``; what is None is
    left out.
    """

    row: int | None
    terms: tuple[tuple[float, int], ...]
    factor: int | None = None
    share: float = 1.0

    def value(self, w: Floats) -> float:
        """Return the value for the cells of a lane, summed as in compiled code."""
        products = [number * w[row] for number, row in self.terms]
        total = sum(products[1::2], start=0.0) + sum(products[::2], start=0.0)
        if self.factor is not None:
            total *= self.share * w[self.factor]
        if self.row is not None:
            total += w[self.row]
        return total


def sums(
    count: int,
    terms: dict[int, float],
    start: int | None = None,
    factor: int | None = None,
    share: float = 1.0,
    stride: int = 1,
) -> list[Sum]:
    """Return sums for ``count`` components, with coefficients by first rows.

    Rows of terms are a stride apart.
    """
    components = []
    for i in range(count):
        shifted = tuple((number, row + stride * i) for row, number in terms.items())
        row = start
        if start is not None:
            row = start + i
        components.append(Sum(row, shifted, factor, share))
    return components


def gather(
    lanes: int, values: Sequence[int | Sum], constants: Sequence[int]
) -> Callable[[Floats, int], tuple[float, ...]]:
    """Return ``read(w, l)``, which returns values and then constants as a tuple.

    Constants are read first, and single cells before sums: the last bits depend on this
    order.
    """
    wanted = [*values, *constants]
    order = sorted(
        range(len(wanted)), key=lambda i: (i < len(values), isinstance(wanted[i], Sum))
    )

    def python(w: Floats, l: int) -> tuple[float, ...]:
        cells = w.reshape(-1, lanes)[:, l]
        numbers = []
        for value in wanted:
            if isinstance(value, int):
                numbers.append(cells[value])
            else:
                numbers.append(value.value(cells))
        return tuple(numbers)

    @intrinsic(
        lambda typingctx, w, l: types.UniTuple(types.float64, len(wanted))(
            w, types.intp
        ),
        python,
    )
    def read(context, builder, signature, args):
        array = context.make_array(signature.args[0])(context, builder, args[0])
        lane = _Cells(builder, array.data, args[1], lanes)
        numbers = {i: lane.value(wanted[i]) for i in order}
        components = [numbers[i] for i in range(len(wanted))]
        return context.make_tuple(builder, signature.return_type, components)

    return read


def scatter(
    lanes: int, rows: Sequence[int]
) -> Callable[[Floats, int, tuple[float, ...]], None]:
    """Return ``write(w, l, values)``, which writes a tuple to rows of lane ``l``."""
    values = types.UniTuple(types.float64, len(rows))

    def python(w: Floats, l: int, numbers: tuple[float, ...]) -> None:
        w.reshape(-1, lanes)[list(rows), l] = numbers

    @intrinsic(
        lambda typingctx, w, l, numbers: types.void(w, types.intp, values), python
    )
    def write(context, builder, signature, args):
        array = context.make_array(signature.args[0])(context, builder, args[0])
        lane = _Cells(builder, array.data, args[1], lanes)
        for i, row in enumerate(rows):
            lane.write(row, builder.extract_value(args[2], i))
        return context.get_dummy_value()

    return write
