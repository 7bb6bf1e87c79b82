"""A lane of the workspace as a record, for compiled code: ``lane.t_end``, ``lane.y1 = lane.y``.

The workspace is one flat array of rows, and a row holds one number of every lane: so loops over
lanes vectorise.  (With two arrays LLVM would have to prove that they do not overlap, and leaves the
loops scalar instead.)  A field is the lane's number in a row, or a tuple of those in some rows one
after another; reading and writing it are LLVM's loads and stores at once, in any loop.
"""

# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, get_type_hints

from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    register_model,
)

from rattlesweep.integrate.lanes.cells import DOUBLE, Cells

if TYPE_CHECKING:
    from collections.abc import Callable

    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Tableau

# 32 lanes: see benchmarks/kernel.py --lanes for the figures behind it.
LANES = 32


class Point(NamedTuple):
    """A point within a step: how far behind its start, the spin there and the spin's rate."""

    h: float
    n: float
    rate: float


class State(tuple[float, ...]):
    """As many numbers as the model's state has."""


class Constants(tuple[float, ...]):
    """The body's constants."""


class Probe(tuple[float, ...]):
    """Coefficients of the watched amplitude."""


class Tangent(tuple[float, ...]):
    """As a state; empty in a model without a tangent."""


class Lane:
    """What the lane kernel keeps of a run; flags are 1 or 0."""

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
        for name, kind in get_type_hints(Lane).items():
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
    def of(cls, model: Model) -> Layout:
        """Layout for a model."""
        n = model.n_state
        return cls((n, model.n_constants, model.n_probe, n if model.tangent else 0))

    def rows(self, tableau: Tableau, model: Model) -> int:
        """Number of rows of the workspace for a method."""
        rows = (tableau.stages - 1) * model.n_state * (2 if model.tangent else 1)
        carried = model.carried.n * (tableau.stages + 1) if model.carried else 0
        return self.stages + rows + carried


class LaneType(types.Type):  # type: ignore[misc]
    """Numba's type of a lane."""

    def __init__(self, layout: Layout, lanes: int) -> None:
        self.layout, self.lanes = layout, lanes
        super().__init__(f"Lane{(lanes, *layout.sizes)}")


@register_model(LaneType)
class _LaneModel(models.StructModel):  # type: ignore[misc]
    def __init__(self, manager: Any, lane: LaneType) -> None:
        members = [("data", types.CPointer(types.float64)), ("place", types.intp)]
        super().__init__(manager, lane, members)


def _cells(context: Any, builder: Any, lane: LaneType, value: Any) -> Cells:
    found = cgutils.create_struct_proxy(lane)(context, builder, value)
    return Cells(builder, found.data, found.place, lane.lanes)


@infer_getattr
class _Fields(AttributeTemplate):  # type: ignore[misc]
    key = LaneType

    def generic_resolve(self, lane: LaneType, name: str) -> Any:
        return lane.layout.fields.get(name, (0, None))[1]


@lower_getattr_generic(LaneType)
def _get(context: Any, builder: Any, lane: LaneType, value: Any, name: str) -> Any:
    cells, (row, kind) = _cells(context, builder, lane, value), lane.layout.fields[name]
    if kind is types.float64:
        return cells.read(row)
    return context.make_tuple(builder, kind, [cells.read(row + i) for i in range(len(kind))])


@lower_setattr_generic(LaneType)
def _set(context: Any, builder: Any, signature: Any, args: Any, name: str) -> None:
    lane = signature.args[0]
    cells, (row, kind) = _cells(context, builder, lane, args[0]), lane.layout.fields[name]
    if kind is types.float64:
        cells.write(row, args[1])
        return
    for i in range(len(kind)):
        cells.write(row + i, builder.extract_value(args[1], i))


def lane_of(layout: Layout, lanes: int = LANES) -> Callable[..., Any]:
    """``lane_of(w, l)``, for compiled code: lane ``l`` of a workspace ``w``."""
    found = LaneType(layout, lanes)

    def lane(typingctx, w, l):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            made = cgutils.create_struct_proxy(found)(context, builder)
            made.data = context.make_array(signature.args[0])(context, builder, args[0]).data
            made.place = args[1]
            return made._getvalue()

        return found(w, types.intp), codegen

    compiled: Callable[..., Any] = intrinsic(lane)
    return compiled


# Without what depends on the model.
any_lane = lane_of(Layout((0, 0, 0, 0)))


@intrinsic
def clear(typingctx, lane):  # type: ignore[no-untyped-def]
    """Set all numbers to zero that are there in every model."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        kind = signature.args[0]
        cells = _cells(context, builder, kind, args[0])
        end = cells.lane.type(kind.layout.y * kind.lanes)
        with cgutils.for_range_slice(builder, cells.lane, end, cells.lane.type(kind.lanes)) as (
            index,
            _,
        ):
            builder.store(DOUBLE(0.0), cgutils.gep(builder, cells.data, index))
        return context.get_dummy_value()

    return types.void(lane), codegen
