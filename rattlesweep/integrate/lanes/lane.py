"""Lanes: many runs side by side in one workspace, as compiled code sees them.

The workspace is one flat array of rows, each of which holds one number of every lane,
so that loops over lanes vectorise.  (With several arrays, LLVM would have to prove that
they do not overlap.)  In compiled code a lane reads as a record: ``lane.t_end``,
``lane.y1 = lane.y``.  A field is the lane's number in one row, or the tuple of its
numbers in consecutive rows.

:func:`gather` and :func:`scatter` replace hundreds of indexed reads, products and sums.
Typing and lowering these would take Numba most of the time that a kernel takes to
compile.

Each operation written as LLVM code has a Python twin, which runs with
``NUMBA_DISABLE_JIT=1``, so that a debugger can step through a kernel.

Only this module uses private interfaces of Numba (tried with 0.68.1): ``cgutils``,
``AttributeTemplate``, ``to_fixed_tuple``; ``make_array``, ``make_tuple``,
``get_dummy_value``, ``get_constant_generic``, ``resolve_value_type`` and ``call_conv``
of contexts; ``library`` and ``fndesc`` of overloads.
"""

# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc"
from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce, wraps
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from llvmlite import ir
from numba import config, extending, types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.np.unsafe.ndarray import to_fixed_tuple

from rattlesweep.integrate.model import Model
from rattlesweep.integrate.tableau import Tableau

LANES = 1 if config.DISABLE_JIT else 32  # measured by benchmarks/kernel.py --lanes
DOUBLE = ir.DoubleType()
# Options of functions that only compiled functions call.  Wrappers for Python and C,
# which would take time to compile, are left out; a call from Python would crash the
# process.
INNER: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
INNER |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# first_of(array, length): the first numbers of an array, as a tuple.
first_of = (
    (lambda array, length: tuple(array[:length]))
    if config.DISABLE_JIT
    else to_fixed_tuple
)


def intrinsic(
    signature_of: Callable[..., Any], python: Callable[..., Any]
) -> Callable[..., Any]:
    """Make an intrinsic of a function that writes LLVM code; without compilation, use
    ``python``.

    ``signature_of`` returns the signature for the types of the arguments.
    """

    def decorate(codegen: Callable[..., Any]) -> Any:
        @wraps(signature_of)
        def typed(*given):
            return signature_of(*given), codegen

        typed.__name__ = codegen.__name__
        return python if config.DISABLE_JIT else extending.intrinsic(typed)

    return decorate


def _fetch_add(array, index, value):
    before = int(array[index])
    array[index] += value
    return before


@intrinsic(
    lambda typingctx, array, index, value: types.int64(array, types.intp, types.int64),
    _fetch_add,
)
def fetch_add(context, builder, signature, args):
    """Add ``value`` to ``array[index]`` (int64) atomically, and return the value
    before.
    """
    kind, index = signature.args[0], [args[1]]
    array = context.make_array(kind)(context, builder, args[0])
    pointer = cgutils.get_item_pointer(
        context, builder, kind, array, index, wraparound=False
    )
    return builder.atomic_rmw("add", pointer, args[2], "monotonic")


@intrinsic(lambda typingctx: types.void(), lambda: None)
def barrier(context, builder, signature, args):
    """Keep the compiler from sharing products across this point, at no cost.

    A shared product is not fused with a sum, which would change the last bits.
    """
    builder.fence("seq_cst", "singlethread")
    return context.get_dummy_value()


@intrinsic(lambda typingctx: types.void(), lambda: None)
def widest_vectors(context, builder, signature, args):
    """Let LLVM use the widest vectors of the processor in the calling function.

    By default it uses 256 of the 512 bits of AVX-512 on Intel processors.
    """
    # llvmlite has no attributes with a value, but prints whatever the set contains.
    set.add(builder.function.attributes, '"prefer-vector-width"="512"')
    return context.get_dummy_value()


@intrinsic(
    lambda typingctx, y, f, h: y(y, f, types.float64),
    lambda y, f, h: tuple(a + h * b for a, b in zip(y, f, strict=True)),
)
def moved(context, builder, signature, args):
    """Return the state ``y + h f``."""
    y, f, h = args
    components = []
    for i in range(len(signature.return_type)):
        change = builder.fmul(h, builder.extract_value(f, i))
        components.append(builder.fadd(builder.extract_value(y, i), change))
    return context.make_tuple(builder, signature.return_type, components)


def addresses_of(*compiled: Any) -> Any:
    """Return the addresses of compiled functions, which the caller must keep alive."""
    if config.DISABLE_JIT:
        return np.array(compiled, object)
    results = [
        result for function in compiled for result in function.overloads.values()
    ]
    return np.array(
        [r.library.get_pointer_to_function(r.fndesc.llvm_func_name) for r in results]
    )


def _calling(result: Any) -> Any:
    @intrinsic(
        lambda typingctx, address, arguments: result(types.intp, arguments),
        lambda function, arguments: function(*arguments),
    )
    def call(context, builder, signature, args):
        given = signature.args[1].types
        function_type = context.call_conv.get_function_type(result, given)
        function = builder.inttoptr(args[0], function_type.as_pointer())
        status, returned = context.call_conv.call_function(
            builder, function, result, given, cgutils.unpack_tuple(builder, args[1])
        )
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return returned

    return call


# Call the compiled function at an address with a tuple of arguments; the second returns
# a pair of integers.
call, call_for_pair = _calling(types.none), _calling(types.UniTuple(types.intp, 2))


class Point(NamedTuple):
    """A point within a step: its time from the start of the step, the spin and the
    spin's rate.
    """

    h: float
    n: float
    rate: float


# Fields of a lane, in the order of their rows; flags are 1 or 0.
FIELDS = (
    # Index of the run or -1; time, its low part in a compensated sum, horizon; numbers
    # of accepted and rejected steps, and of extrema of the spin whose sign the method
    # could not decide.
    ("number", "run t t_low t_end steps rejected near"),
    # The step tried: size, squared error, `rough_root` of it and of the step before;
    # spin and rate at both ends, squared amplitude at the end; whether it is the last,
    # whether it repeats a rejected one.
    ("number", "h error root root0 n0 rate0 n1 rate1 amplitude last held"),
    # Whether the lane needs a closer look; whether it takes the step; size of the next
    # step.
    ("number", "due accept h_next"),
    # Fastest angular frequency of the spin; its largest recent rate; its value and sign
    # at launch; the smallest sign * n since.
    ("number", "swing rate_max n_launch sign n_least"),
    # Modulus beyond which the spin counts as being on one side; for a run launched
    # without spin the same until it gets there, else 0; the bound of the spin's rate
    # from there on.
    ("number", "far arm arm_rate"),
    # Search in a held step (events.py): mode; number of pieces and the present one;
    # tries; depth of an undecided extremum, relative to the swing; the step as first
    # tried and the size of the one after it; ends of the piece and of the bracket in
    # it; the point after the bracketed zero.
    ("number", "mode pieces piece tries fuzz"),
    ("point", "full"),
    ("number", "full_next"),
    ("point", "lo end hi beyond"),
    # Squared amplitudes: largest since the last comparison, smallest of those compared,
    # largest growth, number of comparisons, smallest that counts; next time at which a
    # comparison or the end of a window is due; time of the next comparison within the
    # first window.
    ("number", "a_max a_min growth compared a_floor next mark"),
    # Length, end and number of the window; largest squared amplitude and extremes of
    # the spin.
    ("number", "window window_end window_no window_a_max window_n_min window_n_max"),
    # Energy at launch and its largest drift; extremes of the contact forces.
    ("number", "energy0 drift_max ratio_max normal_min"),
    # Times of the first zero of the spin, and of the first one since the spin was last
    # far (-1 for none); the side it was on, the number of changes of side, the largest
    # spin since the last, the largest one found within the step.
    ("number", "t_zero t_pending side reversals n_after n_top"),
    # Whether the step may hold a new extreme; which function is climbed, the step to
    # take after that, the size of the next one, and the move.
    ("number", "peak climbed taken taken_next move"),
    # Ratio of the contact forces, and normal force with a minus sign, at both ends.
    ("point", "ratio0 ratio1 lift0 lift1"),
    # Logarithm of phase volume, its rate over the step; share of the energy below which
    # a body is dead; exponent of the power of two taken out of the tangent.
    ("number", "volume volume_rate1 dead shift"),
    # State and derivative at both ends of the step; last the tangents and the state of
    # a stage.
    ("state", "y f y1 f1"),
    ("constants", "constants"),
    ("probe", "probe"),
    ("tangent", "v g v1 g1 ys fs"),
)


class Layout:
    """Rows of a workspace: the first row of each field is an attribute of its name.

    ``fields`` has the first row and the Numba type by name; ``stages`` is the first row
    of the stages after the first.  Without a model, the layout has the fields that all
    models share.
    """

    def __init__(self, model: Model | None) -> None:
        n, constants, probe = (
            (model.n_state, model.n_constants, model.n_probe) if model else (0, 0, 0)
        )
        counts = {
            "number": 1,
            "point": 3,
            "state": n,
            "constants": constants,
            "probe": probe,
        }
        counts["tangent"] = n if model and model.rate else 0
        found = {
            kind: types.UniTuple(types.float64, n) if n else types.Tuple(())
            for kind, n in counts.items()
        }
        found |= {
            "number": types.float64,
            "point": types.NamedUniTuple(types.float64, 3, Point),
        }
        self.fields: dict[str, tuple[int, Any]] = {}
        self.stages = 0
        for kind, names in FIELDS:
            for name in names.split():
                self.fields[name] = self.stages, found[kind]
                setattr(self, name, self.stages)
                self.stages += counts[kind]

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> int: ...

    def rows(self, tableau: Tableau, model: Model) -> int:
        """Return the number of rows of the workspace for a method."""
        stages = (tableau.stages - 1) * model.n_state * (2 if model.rate else 1)
        return self.stages + stages + model.n_carried * (tableau.stages + 1)


class Problem:
    """What a kernel is compiled for: a model, the kind of method, the number of lanes.

    For compiled functions it is an argument without data, and its attributes, among
    them those of the model, are constants.  Hooks are the functions that differ for
    models with a tangent.
    """

    known: ClassVar[dict[str, Problem]] = {}

    def __init__(
        self,
        model: Model | None,
        adaptive: bool,
        lanes: int = LANES,
        **hooks: Callable[..., Any],
    ) -> None:
        if model is not None:
            vars(self).update(vars(model) | hooks)
            self.n_given = model.n_state - model.n_extra
            self.others = (0.0,) * model.n_extra
            # State, constants and probe of an empty lane.
            state, constants = (1.0,) * model.n_state, (1.0,) * model.n_constants
            self.idle = state, constants, (0.0,) * model.n_probe
        kind = "adaptive" if adaptive else "fixed"
        self.name = f"{model.name if model else 'any'}_{kind}_{lanes}"
        self.adaptive, self.lanes, self.layout = adaptive, lanes, Layout(model)
        self.known[self.name] = self


class ProblemType(types.Type):
    """Numba's type of a problem, which it knows by name, since types are stored on
    disk.
    """

    def __init__(self, problem: str) -> None:
        self.problem = problem
        super().__init__(f"Problem({problem})")

    def value_of(self, name: str) -> Any:
        """Return an attribute of the problem."""
        return getattr(Problem.known[self.problem], name)


# Without members a problem takes no argument in machine code, so `kernel.drive` leaves
# it out.
@extending.register_model(ProblemType)
class _ProblemModel(extending.models.StructModel):
    def __init__(self, manager: Any, problem: ProblemType) -> None:
        super().__init__(manager, problem, [])


@extending.typeof_impl.register(Problem)
def _typeof(problem: Problem, _: Any) -> ProblemType:
    return ProblemType(problem.name)


@extending.unbox(ProblemType)
def _unbox_problem(problem: ProblemType, _: Any, c: Any) -> Any:
    return extending.NativeValue(_empty(c.context, c.builder, problem))


def _empty(context: Any, builder: Any, problem: ProblemType) -> Any:
    return cgutils.create_struct_proxy(problem)(context, builder)._getvalue()


@extending.infer_getattr
class _Attributes(AttributeTemplate):
    key = ProblemType

    def generic_resolve(self, problem: ProblemType, name: str) -> Any:
        value = problem.value_of(name)
        if isinstance(value, int):
            return types.literal(value)
        return self.context.resolve_value_type(value)


@extending.lower_getattr_generic(ProblemType)
def _get_attribute(
    context: Any, builder: Any, problem: ProblemType, _: Any, name: str
) -> Any:
    value = problem.value_of(name)
    if callable(value):
        return context.get_dummy_value()
    kind = context.typing_context.resolve_value_type(value)
    return context.get_constant_generic(builder, kind, value)


class LaneType(types.Type):
    """Numba's type of a lane."""

    def __init__(self, problem: ProblemType) -> None:
        self.problem = problem
        super().__init__(f"Lane({problem.problem})")

    def field(self, name: str) -> Any:
        """Return the first row and the type of a field."""
        return self.problem.value_of("layout").fields[name]


@extending.register_model(LaneType)
class _LaneModel(extending.models.StructModel):
    def __init__(self, manager: Any, lane: LaneType) -> None:
        members = [("data", types.CPointer(types.float64)), ("place", types.intp)]
        super().__init__(manager, lane, members)


class Lane:
    """A lane in Python, used where nothing is compiled."""

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
        self.cells[row : row + (1 if kind is types.float64 else len(kind))] = value


class _Cells(NamedTuple):
    """A writer of LLVM code that reads and writes the cells of one lane."""

    builder: Any
    data: Any
    lane: Any
    lanes: int

    def place(self, row: int) -> Any:
        index = self.builder.add(self.lane.type(row * self.lanes), self.lane)
        return cgutils.gep(self.builder, self.data, index)

    def read(self, row: int) -> Any:
        return self.builder.load(self.place(row))

    def write(self, row: int, value: Any) -> None:
        self.builder.store(value, self.place(row))

    def product(self, number: float, row: int) -> Any:
        value = self.read(row)
        return value if number == 1.0 else self.builder.fmul(DOUBLE(number), value)

    def value(self, wanted: int | Sum) -> Any:
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
        return (
            total
            if wanted.row is None
            else self.builder.fadd(self.read(wanted.row), total)
        )


def _cells(context: Any, builder: Any, lane: LaneType, value: Any) -> _Cells:
    found = cgutils.create_struct_proxy(lane)(context, builder, value)
    return _Cells(builder, found.data, found.place, lane.problem.value_of("lanes"))


@extending.infer_getattr
class _Fields(AttributeTemplate):
    key = LaneType

    def generic_resolve(self, lane: LaneType, name: str) -> Any:
        return lane.problem if name == "problem" else lane.field(name)[1]


@extending.lower_getattr_generic(LaneType)
def _get(context: Any, builder: Any, lane: LaneType, value: Any, name: str) -> Any:
    if name == "problem":
        return _empty(context, builder, lane.problem)
    cells, (row, kind) = _cells(context, builder, lane, value), lane.field(name)
    if kind is types.float64:
        return cells.read(row)
    return context.make_tuple(
        builder, kind, [cells.read(row + i) for i in range(len(kind))]
    )


@extending.lower_setattr_generic(LaneType)
def _set(context: Any, builder: Any, signature: Any, args: Any, name: str) -> None:
    lane = signature.args[0]
    cells, (row, kind) = _cells(context, builder, lane, args[0]), lane.field(name)
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
    made = cgutils.create_struct_proxy(signature.return_type)(context, builder)
    made.data = context.make_array(signature.args[1])(context, builder, args[1]).data
    made.place = args[2]
    return made._getvalue()


def _clear(lane):
    lane.cells[: lane.fields["y"][0]] = 0.0


@intrinsic(lambda typingctx, lane: types.void(lane), _clear)
def clear(context, builder, signature, args):
    """Set the fields before ``y``, which every model has, to zero."""
    kind = signature.args[0]
    cells = _cells(context, builder, kind, args[0])
    end = cells.lane.type(kind.field("y")[0] * cells.lanes)
    step = cells.lane.type(cells.lanes)
    with cgutils.for_range_slice(builder, cells.lane, end, step) as (index, _):
        builder.store(DOUBLE(0.0), cgutils.gep(builder, cells.data, index))
    return context.get_dummy_value()


class Sum(NamedTuple):
    """``w[row] + share * w[factor] * (a * w[i] + b * w[j] + ...)``; what is None is
    left out.
    """

    row: int | None
    terms: tuple[tuple[float, int], ...]
    factor: int | None = None
    share: float = 1.0

    def value(self, w: Any) -> Any:
        """Return the value for the cells of a lane, in the order of the compiled
        code.
        """
        products = [number * w[row] for number, row in self.terms]
        total = sum(products[1::2], start=0.0) + sum(products[::2], start=0.0)
        if self.factor is not None:
            total *= self.share * w[self.factor]
        return total if self.row is None else w[self.row] + total


def sums(
    count: int, terms: dict[int, float], start: int | None = None, *scale: Any
) -> list[Sum]:
    """Return sums for ``count`` components; ``terms`` are coefficients by the first row
    of each.
    """
    shifted = [
        tuple((number, row + i) for row, number in terms.items()) for i in range(count)
    ]
    return [
        Sum(None if start is None else start + i, shifted[i], *scale)
        for i in range(count)
    ]


def gather(lanes: int, values: Sequence[int | Sum], constants: Sequence[int]) -> Any:
    """Return ``read(w, l)``, which returns the values and then the constants as a
    tuple.

    Constants are read first, and single cells before sums: the last bits depend on this
    order.
    """
    wanted = [*values, *constants]
    order = sorted(
        range(len(wanted)), key=lambda i: (i < len(values), isinstance(wanted[i], Sum))
    )

    def python(w: Any, l: int) -> tuple[float, ...]:
        cells = w.reshape(-1, lanes)[:, l]
        return tuple(
            cells[one] if isinstance(one, int) else one.value(cells) for one in wanted
        )

    @intrinsic(
        lambda typingctx, w, l: types.UniTuple(types.float64, len(wanted))(
            w, types.intp
        ),
        python,
    )
    def read(context, builder, signature, args):
        array = context.make_array(signature.args[0])(context, builder, args[0])
        lane = _Cells(builder, array.data, args[1], lanes)
        found = {i: lane.value(wanted[i]) for i in order}
        parts = [found[i] for i in range(len(wanted))]
        return context.make_tuple(builder, signature.return_type, parts)

    return read


def scatter(lanes: int, rows: Sequence[int]) -> Any:
    """Return ``write(w, l, values)``, which writes a tuple to the rows of lane
    ``l``.
    """
    values = types.UniTuple(types.float64, len(rows))

    def python(w: Any, l: int, given: tuple[float, ...]) -> None:
        w.reshape(-1, lanes)[list(rows), l] = given

    @intrinsic(lambda typingctx, w, l, given: types.void(w, types.intp, values), python)
    def write(context, builder, signature, args):
        array = context.make_array(signature.args[0])(context, builder, args[0])
        lane = _Cells(builder, array.data, args[1], lanes)
        for i, row in enumerate(rows):
            lane.write(row, builder.extract_value(args[2], i))
        return context.get_dummy_value()

    return write
