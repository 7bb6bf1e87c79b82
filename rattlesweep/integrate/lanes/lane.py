"""The workspace: one flat array of rows, each of which holds one number of every lane.

So loops over lanes vectorise.  (With two arrays LLVM would have to prove that they do not overlap,
and leaves the loops scalar instead.)  In compiled code a lane reads as a record: ``lane.t_end``,
``lane.y1 = lane.y``.  A field is the lane's number in a row, or a tuple of those in some rows one
after another; reading and writing it are LLVM's loads and stores at once, in any loop.

:func:`gather` and :func:`scatter` read, sum and write many cells at a time.  Numba takes most of
the time of a kernel's compilation to type and lower the hundreds of indexed reads, products and
sums that they stand for.  They write the same LLVM instructions in the same order; the flags for
fast mathematics are those of the function that calls them.
"""

# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, get_type_hints

from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

from rattlesweep.integrate.lanes.intrinsics import intrinsic_or

if TYPE_CHECKING:
    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau

# 32 lanes: see benchmarks/kernel.py --lanes for the figures behind it.  One can step through one.
LANES = 1 if config.DISABLE_JIT else 32
DOUBLE = ir.DoubleType()


class Point(NamedTuple):
    """A point within a step: how far behind its start, the spin there and the spin's rate."""

    h: float
    n: float
    rate: float


class State(tuple[float, ...]):
    """Hold as many numbers as the model's state has."""


class Constants(tuple[float, ...]):
    """The body's constants."""


class Probe(tuple[float, ...]):
    """Coefficients of the watched amplitude."""


class Tangent(tuple[float, ...]):
    """Hold as many as a state; none in a model without a tangent."""


class Lane:
    """Keep what the lane kernel knows of a run; flags are 1 or 0.

    In compiled code ``lane.problem`` is the :class:`Problem` that the lane belongs to.
    """

    # Number of the run, -1 for none.
    run: float
    # Time, with the low part that compensated summation keeps, and where it ends.
    t: float
    t_low: float
    t_end: float
    # Accepted and rejected steps, extrema of the spin that the method could not decide.
    steps: float
    rejected: float
    near: float

    # The step tried: its size, its squared error in units of the tolerance, the root of that
    # (controller.py), and the root of the step before.
    h: float
    error: float
    root: float
    root0: float
    # The spin and its rate at the start and the end of the step, squared amplitude at the end.
    n0: float
    rate0: float
    n1: float
    rate1: float
    amplitude: float
    # Whether it ends at t_end; whether it follows a rejected one.
    last: float
    held: float
    # What is decided: whether the lane needs a closer look, whether it takes the step, and the
    # size of the next one.
    due: float
    accept: float
    h_next: float

    # Fastest frequency at which the spin swings; largest recent rate of the spin.
    swing: float
    rate_max: float
    # Spin of the launch and its sign; the smallest sign * n since.
    n_launch: float
    sign: float
    n_least: float
    # The spin from which on it has a side; the same while a run launched without spin has not
    # reached it, then 0; the bound of its rate from there on.
    far: float
    arm: float
    arm_rate: float

    # Search for the first zero within a held step (events.py): its mode; the pieces of the step
    # and where the search is in them; tries to find a minimum or a zero.
    mode: float
    pieces: float
    piece: float
    tries: float
    # Depth of an extremum of the spin, relative to its swing, that the method cannot decide.
    fuzz: float
    # The step as it was first tried, and the size of its next one.
    full: Point
    full_next: float
    # Start and end of the piece; the bracket of a minimum or a zero; what was behind a zero when
    # its search began.
    lo: Point
    end: Point
    hi: Point
    beyond: Point

    # Squared amplitudes: largest since the last comparison, least of those compared, largest
    # growth over one of them; how many were compared, and the least that counts.
    a_max: float
    a_min: float
    growth: float
    compared: float
    a_floor: float
    # Next time to compare; marks that double until the first window ends.
    next: float
    mark: float
    # Length, end and number of the window; its largest amplitude, extremes of the spin in it.
    window: float
    window_end: float
    window_no: float
    window_a_max: float
    window_n_min: float
    window_n_max: float

    # Energy of the launch and its largest drift; extremes of the ratio of contact forces and of
    # the normal force.
    energy0: float
    drift_max: float
    ratio_max: float
    normal_min: float

    # Where reversals are recorded: the first zero of all, the first since the spin was last far
    # (each -1 for none), the side it was on, how often it has changed, the largest spin since.
    t_zero: float
    t_pending: float
    side: float
    reversals: float
    n_after: float

    # Where recorded: the logarithm of the phase volume, and its mean rate over the step tried.
    volume: float
    volume_rate1: float

    # Share of the launch's energy below which a zero of the spin is no reversal; 0 for none.
    dead: float

    # Exponent of the power of two taken out of the tangent.
    shift: float

    # State and derivative at the start and the end of the step.
    y: State
    f: State
    y1: State
    f1: State
    constants: Constants
    probe: Probe
    # The tangent and its derivative there; state and derivative of the stage, for its stage.
    v: Tangent
    g: Tangent
    v1: Tangent
    g1: Tangent
    ys: Tangent
    fs: Tangent

    def __init__(self, problem: Problem, w: Any, l: int) -> None:
        cells = w.reshape(-1, problem.lanes)[:, l]
        vars(self).update(problem=problem, cells=cells, fields=problem.layout.fields)

    def __getattr__(self, name: str) -> Any:
        row, kind = self.fields[name]
        if kind is types.float64:
            return self.cells[row]
        values = tuple(self.cells[row : row + len(kind)])
        return Point(*values) if isinstance(kind, types.NamedUniTuple) else values

    def __setattr__(self, name: str, value: Any) -> None:
        row, kind = self.fields[name]
        if kind is types.float64:
            self.cells[row] = value
        else:
            self.cells[row : row + len(kind)] = value


# Kinds of the fields by name.
FIELDS = get_type_hints(Lane)


class Layout:
    """Rows of the fields of :class:`Lane` in the workspace of a model.

    Attributes
    ----------
    fields : dict
        First row and Numba's type of each field.
    stages : int
        First row of the stages but the first, which is ``f``; they come last, those of the tangent
        or of what is carried behind the state's.
    **others : int
        First row of each field, by its name.
    """

    def __init__(self, sizes: tuple[int, int, int, int]) -> None:
        self.sizes = sizes
        counts = dict(zip((State, Constants, Probe, Tangent), sizes, strict=True))
        self.fields: dict[str, tuple[int, Any]] = {}
        self.stages = 0
        for name, kind in FIELDS.items():
            count = {float: 1, Point: 3}.get(kind) or counts[kind]
            found: Any = types.UniTuple(types.float64, count) if count else types.Tuple(())
            if kind is float:
                found = types.float64
            elif kind is Point:
                found = types.NamedUniTuple(types.float64, 3, Point)
            self.fields[name] = self.stages, found
            setattr(self, name, self.stages)
            self.stages += count

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> int: ...

    @classmethod
    def of(cls, model: Model | None) -> Layout:
        """Return the layout for a model; without one it has the fields of all models alone."""
        if model is None:
            return cls((0, 0, 0, 0))
        n = model.n_state
        return cls((n, model.n_constants, model.n_probe, n if model.tangent else 0))

    def rows(self, tableau: Tableau, model: Model) -> int:
        """Number of rows of the workspace for a method."""
        rows = (tableau.stages - 1) * model.n_state * (2 if model.tangent else 1)
        carried = model.carried.n * (tableau.stages + 1) if model.carried else 0
        return self.stages + rows + carried


# -- problems --------------------------------------------------------------------------------------


class Problem:
    """Hold what a kernel is compiled for: equations, kind of method, number of lanes.

    Compiled functions take it as an argument that has a type and no value, and see its attributes
    as constants.

    Parameters
    ----------
    model : Model, optional
        The equations, whose attributes and whose tangent's are the problem's too.  Without it only
        fields that all models have are there.
    adaptive : bool
        Whether the method controls its error.
    lanes : int
        Row length of the workspace.
    **hooks : callable
        Functions that differ between models with and without a tangent, see
        :func:`rattlesweep.integrate.lanes.build.problem_of`.
    """

    known: ClassVar[dict[str, Problem]] = {}

    def __init__(
        self,
        model: Model | None,
        adaptive: bool,
        lanes: int = LANES,
        **hooks: Callable[..., Any],
    ) -> None:
        name = model.name if model else "any"
        self.name = f"{name}_{'adaptive' if adaptive else 'fixed'}_{lanes}"
        self.adaptive, self.lanes = adaptive, lanes
        if model is not None:
            parts = vars(model) | (vars(model.tangent) if model.tangent else {}) | hooks
            vars(self).update(parts | vars(self))
            if model.carried:
                self.carried_start, self.carried_rhs = model.carried.start, model.carried.rhs
            self.n_given = model.n_given or model.n_state
            self.others = (0.0,) * (model.n_state - self.n_given)
            # The state of empty lanes is some spinning one.
            state, constants = (1.0,) * model.n_state, (1.0,) * model.n_constants
            self.idle = state, constants, (0.0,) * model.n_probe
        self.layout = Layout.of(model)
        self.known[self.name] = self

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


class ProblemType(types.Type):  # type: ignore[misc]
    """Numba's type of a problem, which is known by its name: types are kept on disk."""

    def __init__(self, problem: str) -> None:
        self.problem = problem
        super().__init__(f"Problem({problem})")

    def value_of(self, name: str) -> Any:
        """Return an attribute of the problem."""
        return getattr(Problem.known[self.problem], name)


@register_model(ProblemType)
class _ProblemModel(models.StructModel):  # type: ignore[misc]
    def __init__(self, manager: Any, problem: ProblemType) -> None:
        super().__init__(manager, problem, [])


@typeof_impl.register(Problem)
def _typeof_problem(problem: Problem, _: Any) -> ProblemType:
    return ProblemType(problem.name)


@unbox(ProblemType)
def _unbox_problem(problem: ProblemType, _: Any, c: Any) -> NativeValue:
    return NativeValue(_empty(c.context, c.builder, problem))


def _empty(context: Any, builder: Any, problem: ProblemType) -> Any:
    return cgutils.create_struct_proxy(problem)(context, builder)._getvalue()


@infer_getattr
class _Attributes(AttributeTemplate):  # type: ignore[misc]
    key = ProblemType

    def generic_resolve(self, problem: ProblemType, name: str) -> Any:
        value = problem.value_of(name)
        if isinstance(value, int):
            return types.literal(value)
        return self.context.resolve_value_type(value)


@lower_getattr_generic(ProblemType)
def _get_attribute(context: Any, builder: Any, problem: ProblemType, _: Any, name: str) -> Any:
    value = problem.value_of(name)
    if callable(value):
        return context.get_dummy_value()
    kind = context.typing_context.resolve_value_type(value)
    return context.get_constant_generic(builder, kind, value)


# -- lanes -----------------------------------------------------------------------------------------


class LaneType(types.Type):  # type: ignore[misc]
    """Numba's type of a lane."""

    def __init__(self, problem: ProblemType) -> None:
        self.problem = problem
        super().__init__(f"Lane({problem.problem})")

    @property
    def fields(self) -> dict[str, tuple[int, Any]]:
        """First row and type of each field."""
        fields: dict[str, tuple[int, Any]] = self.problem.value_of("layout").fields
        return fields

    @property
    def lanes(self) -> int:
        """Row length of the workspace."""
        lanes: int = self.problem.value_of("lanes")
        return lanes


@register_model(LaneType)
class _LaneModel(models.StructModel):  # type: ignore[misc]
    def __init__(self, manager: Any, lane: LaneType) -> None:
        members = [("data", types.CPointer(types.float64)), ("place", types.intp)]
        super().__init__(manager, lane, members)


class _Cells:
    """Write LLVM code that reads and writes the cells of one lane."""

    def __init__(self, builder: Any, data: Any, lane: Any, lanes: int) -> None:
        self.builder, self.data, self.lane, self.lanes = builder, data, lane, lanes

    @classmethod
    def of(cls, context: Any, builder: Any, array_type: Any, args: Any, lanes: int) -> _Cells:
        """Cells of a lane, the second of some arguments, in an array, the first of them."""
        array = context.make_array(array_type)(context, builder, args[0])
        return cls(builder, array.data, args[1], lanes)

    def place(self, row: int) -> Any:
        """Pointer to the cell in a row."""
        index = self.builder.add(self.lane.type(row * self.lanes), self.lane)
        return cgutils.gep(self.builder, self.data, index)

    def read(self, row: int) -> Any:
        """Return what the cell holds."""
        return self.builder.load(self.place(row))

    def write(self, row: int, value: Any) -> None:
        """Put a value there."""
        self.builder.store(value, self.place(row))

    def product(self, number: float, row: int) -> Any:
        """A number times what the cell holds."""
        value = self.read(row)
        return value if number == 1.0 else self.builder.fmul(DOUBLE(number), value)

    def value(self, wanted: Sum) -> Any:
        """Return what a sum comes to."""
        if not wanted.terms:
            return self.read(wanted.row)  # type: ignore[arg-type]
        products = [self.product(*term) for term in wanted.terms]
        # Two chains: half as long to wait for.
        chains = [products[i::2] for i in range(min(2, len(products)))]
        total = reduce(self.builder.fadd, (reduce(self.builder.fadd, chain) for chain in chains))
        if wanted.factor is not None:
            total = self.builder.fmul(self.product(wanted.share, wanted.factor), total)
        return total if wanted.row is None else self.builder.fadd(self.read(wanted.row), total)


def _cells(context: Any, builder: Any, lane: LaneType, value: Any) -> _Cells:
    found = cgutils.create_struct_proxy(lane)(context, builder, value)
    return _Cells(builder, found.data, found.place, lane.lanes)


@infer_getattr
class _Fields(AttributeTemplate):  # type: ignore[misc]
    key = LaneType

    def generic_resolve(self, lane: LaneType, name: str) -> Any:
        return lane.problem if name == "problem" else lane.fields.get(name, (0, None))[1]


@lower_getattr_generic(LaneType)
def _get(context: Any, builder: Any, lane: LaneType, value: Any, name: str) -> Any:
    if name == "problem":
        return _empty(context, builder, lane.problem)
    cells, (row, kind) = _cells(context, builder, lane, value), lane.fields[name]
    if kind is types.float64:
        return cells.read(row)
    return context.make_tuple(builder, kind, [cells.read(row + i) for i in range(len(kind))])


@lower_setattr_generic(LaneType)
def _set(context: Any, builder: Any, signature: Any, args: Any, name: str) -> None:
    lane = signature.args[0]
    cells, (row, kind) = _cells(context, builder, lane, args[0]), lane.fields[name]
    if kind is types.float64:
        cells.write(row, args[1])
        return
    for i in range(len(kind)):
        cells.write(row + i, builder.extract_value(args[1], i))


@intrinsic_or(Lane)
def lane_of(typingctx, problem, w, l):  # type: ignore[no-untyped-def]
    """Return lane ``l`` of a workspace ``w``."""
    found = LaneType(problem)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        made = cgutils.create_struct_proxy(found)(context, builder)
        made.data = context.make_array(signature.args[1])(context, builder, args[1]).data
        made.place = args[2]
        return made._getvalue()

    return found(problem, w, types.intp), codegen


def _clear(lane: Lane) -> None:
    lane.cells[: lane.fields["y"][0]] = 0.0


@intrinsic_or(_clear)
def clear(typingctx, lane):  # type: ignore[no-untyped-def]
    """Set all numbers to zero that are there in every model."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        kind = signature.args[0]
        cells = _cells(context, builder, kind, args[0])
        end = cells.lane.type(kind.fields["y"][0] * kind.lanes)
        with cgutils.for_range_slice(builder, cells.lane, end, cells.lane.type(kind.lanes)) as (
            index,
            _,
        ):
            builder.store(DOUBLE(0.0), cgutils.gep(builder, cells.data, index))
        return context.get_dummy_value()

    return types.void(lane), codegen


# -- many cells ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sum:
    """A cell and a multiple of a sum: ``w[row] + share * w[factor] * (a * w[i] + b * w[j] + ...)``.

    Attributes
    ----------
    row : int, optional
        Row of the cell; without one the value is the sum alone.
    terms : tuple
        Of each product the number and the row.
    factor : int, optional
        Row of the factor; without one it is 1.
    share : float
        What the factor is multiplied by.
    """

    row: int | None
    terms: tuple[tuple[float, int], ...] = ()
    factor: int | None = None
    share: float = 1.0

    def value(self, w: Any) -> Any:
        """Return the value from the rows of one lane, as compiled code does."""
        if not self.terms:
            return w[self.row]
        products = [number * w[row] for number, row in self.terms]
        total = sum(products[1::2], start=0.0) + sum(products[::2], start=0.0)
        if self.factor is not None:
            total *= self.share * w[self.factor]
        return total if self.row is None else w[self.row] + total


def rows(first: int, count: int) -> list[Sum]:
    """Return rows one after another, as they are."""
    return [Sum(first + i) for i in range(count)]


def sums(
    count: int,
    terms: dict[int, float],
    *,
    start: int | None = None,
    factor: int | None = None,
    share: float = 1.0,
) -> list[Sum]:
    """Return sums for ``count`` components, whose rows stand one after another.

    ``terms`` has the numbers by the first rows of what they multiply.
    """
    return [
        Sum(
            None if start is None else start + i,
            tuple((number, row + i) for row, number in terms.items()),
            factor,
            share,
        )
        for i in range(count)
    ]


def gather(lanes: int, values: Sequence[Sum], behind: Sequence[Sum] = ()) -> Callable[..., Any]:
    """``gather(w, l)``: the values in lane ``l``, and those ``behind`` them, a tuple.

    What comes behind is read first, and single cells before sums.  Which of two products LLVM fuses
    with their sum depends on such an order, and with it the last bits.
    """
    wanted = [*values, *behind]
    order = sorted(range(len(wanted)), key=lambda i: (i < len(values), bool(wanted[i].terms)))

    def read(typingctx, w, l):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            lane = _Cells.of(context, builder, signature.args[0], args, lanes)
            found = {i: lane.value(wanted[i]) for i in order}
            parts = [found[i] for i in range(len(wanted))]
            return context.make_tuple(builder, signature.return_type, parts)

        return types.UniTuple(types.float64, len(wanted))(w, types.intp), codegen

    def python(w: Any, l: int) -> tuple[float, ...]:
        cells = w.reshape(-1, lanes)[:, l]
        return tuple(each.value(cells) for each in wanted)

    return intrinsic_or(python)(read)  # type: ignore[no-any-return]


def scatter(lanes: int, cells: Sequence[Sum]) -> Callable[..., Any]:
    """``scatter(w, l, values)``: write a tuple to the rows in lane ``l``."""
    rows_of = [cell.row for cell in cells if cell.row is not None]

    def write(typingctx, w, l, values):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            lane = _Cells.of(context, builder, signature.args[0], args, lanes)
            for i, row in enumerate(rows_of):
                lane.write(row, builder.extract_value(args[2], i))
            return context.get_dummy_value()

        return types.void(w, types.intp, types.UniTuple(types.float64, len(rows_of))), codegen

    def python(w: Any, l: int, values: tuple[float, ...]) -> None:
        w.reshape(-1, lanes)[rows_of, l] = values

    return intrinsic_or(python)(write)  # type: ignore[no-any-return]
