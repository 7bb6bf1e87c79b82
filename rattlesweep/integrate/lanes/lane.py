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
``AttributeTemplate``, ``to_fixed_tuple``; the option ``_nrt``; ``make_array``,
``make_tuple``, ``get_dummy_value``, ``get_constant_generic``, ``resolve_value_type``
and ``call_conv`` of contexts; ``library`` and ``fndesc`` of overloads.  Types of
private interfaces are imported for annotations alone.
"""

# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc"
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from functools import reduce, wraps
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, ParamSpec, TypeVar

import numpy as np
from llvmlite import ir
from numba import config, extending, njit, types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.np.unsafe.ndarray import to_fixed_tuple

from rattlesweep.arrays import Floats
from rattlesweep.integrate.collocation import STAGES
from rattlesweep.integrate.tableau import Tableau
from rattlesweep.motion.model import Model

if TYPE_CHECKING:
    from numba.core.base import BaseContext
    from numba.core.datamodel import DataModelManager
    from numba.core.dispatcher import Dispatcher
    from numba.core.pythonapi import _UnboxContext
    from numba.core.typing.templates import Signature
    from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")

LANES = 1 if config.DISABLE_JIT else 32  # measured by benchmarks/kernel.py --lanes
DOUBLE = ir.DoubleType()
# Options of functions that only compiled functions call.  Wrappers for Python and C,
# which would take time to compile, are left out; a call from Python would crash the
# process.
INNER: dict[str, object] = {"nogil": True, "error_model": "numpy"}
INNER |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# They own no arrays.  Otherwise Numba counts references to each array at each call,
# which took 3 to 5 % of the time of a kernel.
INNER |= {"_nrt": False}
# The same for functions that are kept :func:`apart`; without this, Numba takes over
# from their callers that they are always inlined.
KEPT_APART: dict[str, object] = INNER | {"forceinline": False}


def _first_of(array, length):
    return tuple(array[:length])


# first_of(array, length): the first numbers of an array, as a tuple.
first_of = _first_of if config.DISABLE_JIT else to_fixed_tuple


def intrinsic(
    signature_of: Callable[..., Signature], python: Callable[P, R]
) -> Callable[[Callable[..., ir.Value]], Callable[P, R]]:
    """Make an intrinsic of a function that writes LLVM code, and its Python twin.

    ``signature_of`` returns the signature for the types of the arguments.
    """

    def decorate(codegen: Callable[..., ir.Value]) -> Callable[P, R]:
        @wraps(signature_of)
        def typed(*arguments):
            return signature_of(*arguments), codegen

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
    """Add to an element (int64) atomically, and return the value before."""
    kind = signature.args[0]
    array = context.make_array(kind)(context, builder, args[0])
    pointer = cgutils.get_item_pointer(
        context, builder, kind, array, [args[1]], wraparound=False
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

    By default it uses 256 of the 512 bits of AVX-512 on Intel processors, and aligns
    the stack to 16 bytes: in three processes of four, every vector that is kept there
    would cross a cache line.
    """
    # llvmlite has no attributes with a value, but prints whatever the set contains.
    set.add(builder.function.attributes, '"prefer-vector-width"="512"')
    builder.function.attributes.alignstack = 64
    return context.get_dummy_value()


@intrinsic(lambda typingctx: types.void(), lambda: None)
def apart(context, builder, signature, args):
    """Keep the calling function out of its callers, with which it might share products.

    Then its last bits do not depend on how large they are.
    """
    builder.function.attributes.add("noinline")
    return context.get_dummy_value()


@intrinsic(
    lambda typingctx, bits: types.int64(types.int64),
    lambda bits: (bits & -bits).bit_length() - 1,
)
def lowest_bit(context, builder, signature, args):
    """Return the place of the lowest bit of an integer that is not zero."""
    return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))


# For a root of 1, where 1023 << 52 is 1.0.
ROOT_OF_ONE = np.uint64((1023 << 52) - (1023 << 46))


@njit(**INNER)
def rough_root(x):
    """Return roughly ``x^(1/64)`` of a positive number, from its bits as a logarithm.

    The result is 0 to 6.2 % too large, as ``1 + m`` replaces ``2^m``, and rises with
    ``x``.
    """
    bits = np.float64(x).view(np.uint64) >> np.uint64(6)
    return np.uint64(bits + ROOT_OF_ONE).view(np.float64)


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


@intrinsic(
    lambda typingctx, condition, yes, no: yes(types.boolean, yes, yes),
    lambda condition, yes, no: yes if condition else no,
)
def chosen(context, builder, signature, args):
    """Return one of two tuples, without a branch."""
    condition, yes, no = args
    components = []
    for i in range(len(signature.return_type)):
        pair = (builder.extract_value(each, i) for each in (yes, no))
        components.append(builder.select(condition, *pair))
    return context.make_tuple(builder, signature.return_type, components)


def addresses_of(
    *compiled: Dispatcher | None,
) -> NDArray[np.int64] | NDArray[np.object_]:
    """Return the addresses of compiled functions, which the caller must keep alive.

    The address of None, for a function that is never called, is 0.
    """
    if config.DISABLE_JIT:
        return np.array(compiled, object)
    addresses = np.zeros(len(compiled), np.int64)
    for place, function in enumerate(compiled):
        if function is not None:
            (result,) = function.overloads.values()
            name = result.fndesc.llvm_func_name
            addresses[place] = result.library.get_pointer_to_function(name)
    return addresses


def _calling(result: types.Type) -> Callable[[int, tuple[object, ...]], object]:
    @intrinsic(
        lambda typingctx, address, arguments: result(types.intp, arguments),
        lambda function, arguments: function(*arguments),
    )
    def call(context, builder, signature, args):
        kinds = signature.args[1].types
        function_type = context.call_conv.get_function_type(result, kinds)
        function = builder.inttoptr(args[0], function_type.as_pointer())
        status, returned = context.call_conv.call_function(
            builder, function, result, kinds, cgutils.unpack_tuple(builder, args[1])
        )
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return returned

    return call


# Call the compiled function at an address with a tuple of arguments; the second returns
# a pair of integers.
call = _calling(types.none)
call_for_pair = _calling(types.UniTuple(types.intp, 2))


def choice(
    functions: Mapping[float, Callable[..., R]], *, inline: bool = False
) -> Callable[..., R]:
    """Return ``one_of(key, *arguments)``, which calls the function of a key.

    For any other key, it calls the last one.  ``inline`` is for small functions.
    """
    compiled = njit(forceinline=inline, **INNER)
    (first, own), *others = functions.items()
    if not others:

        @compiled
        def last(key, *arguments):
            return own(*arguments)

        return last  # type: ignore[no-any-return]
    rest = choice(dict(others), inline=inline)

    @compiled
    def one_of(key, *arguments):
        if key == first:
            return own(*arguments)
        return rest(key, *arguments)

    return one_of  # type: ignore[no-any-return]


class Slip(NamedTuple):
    """Sliding of the contact point on the plane, in the body's units.

    A body slides while the speed is positive; where a slide begins, it is the smallest
    positive number.
    """

    speed: float
    angle: float  # direction in the plane, from the horizontal part of the x axis
    work: float  # of sliding friction since the launch, negative


# Modes of a lane (`lanes.modes`): it rolls, slides, rolls with a torque against its
# spin, or rolls with its spin held at zero.
ROLLING, SLIDING, PIVOTING, HELD = 0.0, 1.0, 2.0, 3.0

# Columns of a table of slips.
SLIP_SPEED, SLIP_ANGLE, SLIP_WORK, N_SLIP = range(4)


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


NEVER = 1e290  # beyond any time, modulus and force of a run
DIFFERENCE = 1e-7  # length of differences along the flow, in radians of the swing

# Kinds of fields of a lane; all numbers are doubles.
RECORDS = {"Point": Point, "Slip": Slip, "Peak": Peak}
Number = float
Flag = float  # 1 or 0
State = tuple[float, ...]  # as many numbers as the state of the model
Constants = tuple[float, ...]
Probe = tuple[float, ...]
Tangent = tuple[float, ...]  # as many as the tangents of the model, or none
Stage = tuple[float, ...]  # as many as the state, or none without tangents
Lengths = tuple[float, ...]  # one for each tangent of a frame
Past = tuple[float, ...]  # coefficients of the rates in a step of a slide


class Fields:
    """The fields of a lane."""

    # The run.
    run: Number  # index, or -1 in an empty lane
    t: Number  # time
    t_low: Number  # its low part in a compensated sum
    t_end: Number  # horizon
    steps: Number  # accepted steps
    rejected: Number  # rejected steps
    near: Number  # extrema of the spin whose sign the method could not decide

    # The step tried.
    h: Number  # size
    error: Number  # square of the error, in units of the tolerance
    root: Number  # `rough_root` of the error
    root0: Number  # the same of the step before
    n0: Number  # spin at the start
    rate0: Number  # rate of the spin at the start
    n1: Number  # spin at the end
    rate1: Number
    amplitude: Number  # squared, at the end
    last: Flag  # whether the step ends at the horizon
    held: Flag  # whether it repeats a rejected one

    # The decision on it.
    accept: Flag  # whether the lane takes the step
    h_next: Number  # size of the next step
    h_longest: Number  # largest size of any step

    # Spin.
    swing: Number  # fastest angular frequency
    rate_max: Number  # largest recent rate
    n_launch: Number
    sign: Number  # of the spin between its zeros; 0 if no more of them are searched
    n_least: Number  # smallest ``sign * n`` since the launch
    far: Number  # modulus beyond which the spin counts as being on one side
    # The same while it matters when the spin gets there, else `NEVER`: after a launch
    # without spin, and after a zero if reversals are recorded.
    awaited: Number
    arm: Flag  # whether no zero counts before that
    arm_rate: Number  # `rate_max` from there on
    far_rate: Number  # largest recent rate until then

    # Search within a held step (events.py).
    search: Number  # its state: STEP, SCAN, ...
    searched: Number  # which function: SPIN, LIMIT, ...
    pieces: Number
    piece: Number  # index of the present one
    tries: Number
    fuzz: Number  # depth of an undecided extremum, relative to the swing
    full: Point  # end of the step as first tried
    full_next: Number  # size of the step after it
    lo: Point  # bracket within the piece
    end: Point  # end of the piece
    hi: Point
    beyond: Point  # the point after the bracketed zero

    t_moved: Number  # time up to which searches have brought the lane
    looked: Number  # tries and steps since then that have brought it no further

    # Functions of the state, at both ends of the step.
    margin0: Number  # a smooth one with the sign of the limit, while the lane rolls
    margin1: Number
    # The limit of the mode; while the lane rolls, only of steps that are searched.
    limit0: Point
    limit1: Point
    ratio0: Point  # ratio of the contact forces
    ratio1: Point
    lift0: Point  # normal force with a minus sign
    lift1: Point
    ratio_peak: Peak  # of the step tried, as interpolated (inside.py)
    lift_peak: Peak
    turn_peak: Peak
    bend: Number  # curvature at the peak that is searched
    inside: Flag  # whether the step tried is long, and may hold a peak
    leaves: Flag  # whether the step may end at a zero of the limit
    h_limit: Number  # size of the step that does
    watched: Number  # above 0 if the step may hold such a zero or a new extreme
    move: Number  # what happens after the search for extremes

    # Marks (marks.py).
    marks_due: Number  # bits of those that the step may hold
    mark_peak: Peak  # where one may fall to zero within it, with a minus sign
    looks: Flag  # whether the point tried is to tell if a mark lies before it
    mark_found: Number  # 1 + the index of one that was found in it, or 0
    t_mark: Number  # its time

    # Comparisons of squared amplitudes.
    a_max: Number  # largest since the last comparison
    a_min: Number  # smallest of those compared
    growth: Number  # largest ratio
    compared: Number  # number of comparisons
    a_floor: Number  # smallest amplitude that counts
    next: Number  # time at which a comparison or the end of a window is due
    comparison: Number  # time of the next one within the first window

    # The present window.
    window: Number  # length
    window_end: Number
    window_no: Number
    window_a_max: Number  # squared amplitude
    window_n_min: Number
    window_n_max: Number

    # Energy and contact.
    rim: Number  # height of the rim
    energy0: Number  # at launch
    drift_max: Number
    dead: Number  # fraction of the energy below which a body is dead
    ratio_max: Number
    normal_min: Number

    # Slides; used by models that slide.
    slip: Slip  # at the start of the step
    slip1: Slip  # at its end
    mu: Number  # coefficient of friction
    slides: Number  # number of slides so far
    t_slide: Number  # begin of the first one
    t_begin: Number  # begin of the last one
    slide_time: Number  # time spent in those that have ended
    h_rolling: Number  # size of the step before the last slide
    refused: Number  # status of a body that can neither roll nor slide at launch, or 0
    past_h: Number  # size of the last step of the slide, 0 if there is none
    tried_h: Number  # the same of the step tried
    # Ratio of the next step to the step tried, 0 where `kernel.decide` finds it.
    stretch: Number
    rise: Number  # 18th root of the squared error of the step tried
    past_rise: Number  # the same of the last step
    waits: Flag  # whether the lane tries no step in this turn

    # Modes (modes.py).
    mode: Number  # ROLLING, SLIDING, ...

    # Spins held at zero; used by models with pivoting friction.
    slack: Number  # by how much the spin may be on the wrong side of zero
    t_held: Number  # begin of the first rest, -1 for none
    t_hold: Number  # begin of the last one
    held_time: Number  # time held in rests that have ended
    rate_held: Number  # `rate_max` at the begin of the last one
    left_zero: Number  # `steps` when the spin last left zero, -1 for never
    pulled: Flag  # whether a step tried ended where the plane would have to pull
    # What the torque that holds the spin lacks of its limits, one on either side: at
    # the start of the step, and at its end.  These are smooth.
    below0: Number
    above0: Number
    below1: Number
    above1: Number

    # Reversals; times are -1 for none.
    t_zero: Number  # first zero of the spin
    t_pending: Number  # first zero since the spin was last far
    t_crossed: Number  # latest zero, also of a dead body
    t_turn: Number  # latest reversal
    side: Number  # sign of the spin when it was last far, 0 if it has never been
    reversals: Number  # changes of side
    n_after: Number  # largest modulus of the spin since the last one
    n_peak: Number  # largest modulus found within the step

    # Phase volume and tangents.
    volume: Number  # logarithm
    volume_rate1: Number  # its rate over the step
    shift: Number  # exponent of the power of two taken out of the tangent
    flow0: Number  # logarithm of the flow's norm at launch
    steep0: Number  # logarithm of the norm of the energy's gradient at launch

    # What depends on the model: the fields from `y` on.
    y: State  # at the start of the step
    f: State  # derivative
    y1: State  # at its end
    f1: State
    constants: Constants
    probe: Probe
    v: Tangent
    g: Tangent  # its derivative
    v1: Tangent
    g1: Tangent
    ys: Stage  # the state in a stage
    fs: Stage
    # Growth of the tangents of a frame so far, with powers of two taken out.
    length: Lengths
    shifts: Lengths  # exponents of these powers
    past: Past  # rates in the last step of a slide (block.py)
    tried: Past  # rates in the step tried


def _numbers_of(model: Model | None) -> dict[str, int]:
    """Return how many numbers a field has, by kinds that depend on the model."""
    if model is None:
        kinds = "State", "Constants", "Probe", "Tangent", "Stage", "Lengths", "Past"
        return dict.fromkeys(kinds, 0)
    tangents = model.n_tangents
    return {
        "State": model.n_state,
        "Constants": model.n_constants,
        "Probe": model.n_probe,
        "Tangent": tangents * model.n_state,
        "Stage": model.n_state if tangents else 0,
        "Lengths": tangents if tangents > 1 else 0,
        "Past": STAGES * (model.n_state + N_SLIP) if model.slide else 0,
    }


# Fields that every turn reads or writes.  Side by side, and followed by the state and
# the stages, their rows use all sets of a first-level cache of 32 KiB alike.
OF_EVERY_TURN = (
    *("t", "t_low", "t_end", "steps", "h", "error", "root", "root0", "n0", "rate0"),
    *("n1", "rate1", "amplitude", "last", "held", "accept", "h_next"),
    *("h_longest", "rate_max", "sign", "n_least", "search", "watched", "a_max", "next"),
)


def _in_order() -> list[str]:
    """Return the fields in the order of their rows."""
    names = list(Fields.__annotations__)
    first_of_model = names.index("y")
    shared = names[:first_of_model]
    others = [name for name in shared if name not in OF_EVERY_TURN]
    return [*others, *OF_EVERY_TURN, *names[first_of_model:]]


class Layout:
    """Rows of a workspace: the first row of each field is an attribute of its name.

    ``fields`` has the first row and the Numba type by name; ``stages`` is the first row
    of the stages after the first.  Without a model, the layout has the fields that all
    models share.
    """

    def __init__(self, model: Model | None) -> None:
        numbers = _numbers_of(model)
        self.fields: dict[str, tuple[int, types.Type]] = {}
        row = 0
        # The annotations are texts, such as "State".
        for name in _in_order():
            kind = Fields.__annotations__[name]
            self.fields[name] = row, _type_of(kind, numbers.get(kind, 1))
            setattr(self, name, row)
            row += 3 if kind in RECORDS else numbers.get(kind, 1)
        self.stages = row

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> int: ...

    def rows(self, tableau: Tableau, model: Model) -> int:
        """Return the number of rows of the workspace for a method."""
        vectors = 1 + model.n_tangents
        stages = (tableau.stages - 1) * vectors * model.n_state
        return self.stages + stages + model.n_carried * (tableau.stages + 1)


def _type_of(kind: str, count: int) -> types.Type:
    """Return the Numba type of a kind of field."""
    if kind in ("Number", "Flag"):
        return types.float64
    if kind in RECORDS:
        return types.NamedUniTuple(types.float64, 3, RECORDS[kind])
    return types.UniTuple(types.float64, count) if count else types.Tuple(())


@dataclass(frozen=True)
class Mode:
    """A way of moving, as compiled functions of a lane that moves so."""

    number: float  # `lane.mode`
    # limit(lane, h, y, f): positive while the body moves so
    limit: Callable[..., Point]
    # change(lane, status, move, recording): after a step that is taken or ends the run,
    # let the lane go over to the mode that follows; return the status and the move then
    change: Callable[..., tuple[int, int]]
    # margin(lane, y, f): of a mode in which most lanes are, a smooth function with the
    # sign of the limit; None where the limit is never zero
    margin: Callable[..., float] | None = None
    # is_calm(lane): whether it stays positive in a step tried that is short of rims;
    # None where that is not known
    is_calm: Callable[..., bool] | None = None
    # observe_limit(problem, w): compute the limit for the lanes that move so, where
    # that of most lanes is another
    observe_limit: Callable[..., None] | None = None
    # Fields that it adds to the results of a run, with their types, and
    # store(lane, t, result), which writes them at the end of the run, the time t.
    results: tuple[tuple[str, type], ...] = ()
    store: Callable[..., None] | None = None


@dataclass(frozen=True)
class ModeSet:
    """All modes of a model's bodies together, as compiled functions of any lane."""

    limit: Callable[..., Point]
    # margin(lane, y, f): that of the mode in which most lanes are
    margin: Callable[..., float]
    # observe_limit(problem, w): tell which steps tried may end at a zero of the limit
    observe_limit: Callable[..., None]
    # look(lane): compute the limit at the ends of a step tried that is to be searched
    look: Callable[..., None]
    # plan(problem, w): return whether lanes that roll try a step in this turn, and
    # whether there are lanes that slide
    plan: Callable[..., tuple[bool, bool]]
    # decide(problem, w, due): decide on lanes that slide or wait; return which are due
    decide: Callable[..., int]
    change: Callable[..., tuple[int, int]]
    # prepare(lane, constants, rate): set what the equations need of a launch, of which
    # `constants` are all and `rate` bounds the rate of the spin
    prepare: Callable[..., None]
    # launch(lane): go over to the mode of the launch, once the run is started
    launch: Callable[..., None]
    # settle(lane, y, t): go over to the mode of a body that rolls in the state y
    settle: Callable[..., None]
    # free(lane): let a body at rest begin to slide at the end of the step
    free: Callable[..., None]
    # advance(problem, w): move what modes add to the state to the end of the step
    advance: Callable[..., None]
    # left(lane, y): height from the contact up to the rim; 1 without a rim
    left: Callable[..., float]
    # At the end of the step: the energy minus the work of friction, and this work.
    energy: Callable[..., float]
    work: Callable[..., float]
    # observe(model, y, slip, constants, mu): energy minus work, normal and tangential
    # force, torque of friction along the vertical
    observe: Callable[..., tuple[float, float, float, float]]
    store: Callable[..., None]
    results: tuple[str, ...]  # names of the fields that `store` writes


@dataclass(frozen=True)
class Tangents:
    """Compiled functions of the tangents that a run carries (`lanes.tangents`)."""

    start: Callable[..., None]
    advance: Callable[..., None]
    # note(lane, t, run, k, growths): store the growth in row k
    note: Callable[..., None]


class Problem:
    """What a kernel is compiled for: a model, the kind of method, the number of lanes.

    The runs of a rimmed problem end where the contact passes the rim of their body.

    For compiled functions it is an argument without data, and its attributes, like
    those of its model and its modes, are constants.
    """

    known: ClassVar[dict[str, Problem]] = {}

    def __init__(
        self,
        model: Model | None,
        adaptive: bool,
        lanes: int = LANES,
        modes: ModeSet | None = None,
        tangents: Tangents | None = None,
        rimmed: bool = False,
        block: Any = None,
    ) -> None:
        if model is not None:
            # The state of a sweep lacks the extra components of the model.
            self.n_given = model.n_state - model.n_extra
            self.extra = (0.0,) * model.n_extra
            # State, constants and probe of an empty lane.
            state = (1.0,) * model.n_state
            constants = (1.0,) * model.n_constants
            self.idle = state, constants, (0.0,) * model.n_probe
            self.slides = model.slide is not None
            self.pivots = model.pivot is not None
            has_limit = self.slides or self.pivots or model.limit is not None
            self.limited = has_limit or rimmed
        self.model = model
        if modes is not None and tangents is not None:
            self.modes = modes
            self.tangents = tangents
        self.block = block  # `block.Block` of a model that slides
        self.name = f"{model.name if model else 'any'}_"
        self.name += f"{'adaptive' if adaptive else 'fixed'}_{lanes}"
        if rimmed:
            self.name += "_rimmed"
        self.adaptive = adaptive
        self.lanes = lanes
        self.layout = Layout(model)
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


# Without members a record takes no argument in machine code, so `kernel.drive` leaves
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


class Lane(Fields):
    """A lane in Python, used where nothing is compiled."""

    problem: Problem

    def __init__(self, problem: Problem, w: Floats, l: int) -> None:
        vars(self)["problem"] = problem
        vars(self)["cells"] = w.reshape(-1, problem.lanes)[:, l]

    def __getattr__(self, name: str) -> float | tuple[float, ...]:
        row, kind = self.problem.layout.fields[name]
        cells: Floats = vars(self)["cells"]
        if kind is types.float64:
            number: float = cells[row]
            return number
        values = tuple(cells[row : row + len(kind)])
        return (
            kind.instance_class(*values) if hasattr(kind, "instance_class") else values
        )

    def __setattr__(self, name: str, value: float | tuple[float, ...]) -> None:
        row, kind = self.problem.layout.fields[name]
        count = 1 if kind is types.float64 else len(kind)
        vars(self)["cells"][row : row + count] = value


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
        return value if number == 1.0 else self.builder.fmul(DOUBLE(number), value)

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
        return lane.problem if name == "problem" else lane.field(name)[1]


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


def _clear(lane):
    vars(lane)["cells"][: lane.problem.layout.y] = 0.0


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

    def value(self, w: Floats) -> float:
        """Return the value for the cells of a lane, summed as in compiled code."""
        products = [number * w[row] for number, row in self.terms]
        total = sum(products[1::2], start=0.0) + sum(products[::2], start=0.0)
        if self.factor is not None:
            total *= self.share * w[self.factor]
        return total if self.row is None else w[self.row] + total


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
        row = None if start is None else start + i
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
        return tuple(
            cells[value] if isinstance(value, int) else value.value(cells)
            for value in wanted
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
