"""Fields of a lane, and their rows in a workspace."""

# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc"

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

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


# Modes of a lane (`mode.modes`): it rolls, slides, rolls with a torque against its
# spin, or rolls with its spin held at zero.
ROLLING, SLIDING, PIVOTING, HELD = 0.0, 1.0, 2.0, 3.0

# Columns of a table of slips.
SLIP_SPEED, SLIP_ANGLE, SLIP_WORK, N_SLIP = range(4)


# States of the search of a lane (`kernel.event`).
STEP, SCAN, MINIMUM, ROOT, REDO, PEAK, RETAKE = range(7)


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
    refused0: Number  # status of a launch that ends at once, or 0
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
    # What the model says of its end when asked (`kernel.answer`): the energy less the
    # work, the work of friction and of pivoting, the largest oscillation.
    energy1: Number
    work1: Number
    pivot_work1: Number
    oscillation1: Number

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
    energy_most: Number  # largest at launch and at the ends of windows
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
    # Ratio of the next step to the step tried, 0 where `turn.decide` finds it.
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

    # The last quarter of the run (late.py).
    late_spin: Number  # spin at its begin, or at the end of the first step in it
    late_sum: Number  # integral of the spin less that
    late_square: Number  # integral of its square
    # The Casimir invariant (casimir.py).
    casimir_low: Number  # its range so far
    casimir_high: Number
    casimir_seen: Number  # number of its values so far
    casimir_time: Number  # time and integrals of both energies in the present period
    casimir_pitch: Number
    casimir_roll: Number
    casimir_sum: Number  # sum and number of the values since the last reversal
    casimir_count: Number
    casimir_next: Number  # the same since a zero that may be a reversal
    casimir_nexts: Number
    casimir_turns: Number  # reversals until now whose means are stored

    # Phase volume and tangents.
    volume: Number  # logarithm
    volume_rate1: Number  # its rate over the step
    shift: Number  # exponent of the power of two taken out of the tangent
    flow0: Number  # logarithm of the flow's norm at launch
    steep0: Number  # logarithm of the norm of the energy's gradient at launch

    # What depends on the model: the fields from `y` on.
    # First the start of a step, then its end in the same order (`Traits.n_end`).
    y: State  # at the start of the step
    f: State  # derivative
    v: Tangent
    g: Tangent  # its derivative
    y1: State  # at its end
    f1: State
    v1: Tangent
    g1: Tangent
    constants: Constants
    probe: Probe
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
        if model.stiffness is not None:
            # States and derivatives, rates of positions, and how stiff they are
            # (`step.implicit`).
            stages = STAGES * (2 * model.n_state + 3) + 10
        return self.stages + stages + model.n_carried * (tableau.stages + 1)


def _type_of(kind: str, count: int) -> types.Type:
    """Return the Numba type of a kind of field."""
    if kind in ("Number", "Flag"):
        return types.float64
    if kind in RECORDS:
        return types.NamedUniTuple(types.float64, 3, RECORDS[kind])
    return types.UniTuple(types.float64, count) if count else types.Tuple(())
