"""What compiled functions see of lanes, and each private interface of Numba for it.

One function uses every operation that `state.lane` writes as LLVM code; without
compilation, its Python twins give the same numbers.
"""

import ast

import numpy as np
import pytest
from numba import njit, types
from sweeping import CONFIGS

from rattlesweep.compiling import intrinsics
from rattlesweep.kernel.collected import layout_of
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.kernel.mode.modes import places_of
from rattlesweep.kernel.recipes import problem_of, traits_for
from rattlesweep.kernel.state import lane as lanes
from rattlesweep.kernel.state.fields import NO_ROW, Point
from rattlesweep.kernel.state.lane import Lane
from rattlesweep.motion.model import FULL, find_model

WIDTH = 2
DOP853 = METHODS["dop853"]
PROBLEM = problem_of(FULL, WIDTH)
AT = PROBLEM.layout
N_ROWS = AT.stages + FULL.n_state
STAGE = AT.stages
# y + 0.5 h (2 f + 3 k), and the constants of the body.
STEP = lanes.sums(FULL.n_state, {AT.f: 2.0, STAGE: 3.0}, AT.y, AT.h, 0.5)
read = lanes.gather(WIDTH, STEP, range(AT.constants, AT.constants + FULL.n_constants))
write = lanes.scatter(WIDTH, range(STAGE, STAGE + FULL.n_state))


def _pair(first, second):
    return first + second, first * second


def _every_operation(problem, w, shared, address):
    """Use every operation on lane 1; return what they return."""
    intrinsics.widest_vectors()
    lane = lanes.lane_of(problem, w, 1)
    lane.y = 1.0, 2.0, 3.0, 4.0, 5.0
    lane.h = 0.25
    lane.t = 0.0
    lane.f = intrinsics.moved(lane.y, lane.y, lane.h)
    lane.lo = Point(lane.h, 7.0, lane.t)
    lane.constants = intrinsics.first_of(w, problem.model.n_constants)
    write(w, 1, lane.f)
    intrinsics.barrier()
    spin = problem.model.spin(lane.y)
    before = intrinsics.fetch_add(shared, 0, 3)
    pair = intrinsics.call_for_pair(address, (before, 6))
    place = intrinsics.lowest_bit(before + 3)
    return read(w, 1), lane.lo, spin, pair, place, problem.lanes, problem.idle


def test_every_operation_is_that_of_its_python_twin():
    start = np.linspace(-1, 1, N_ROWS * WIDTH)
    pair = njit("UniTuple(intp, 2)(intp, intp)", error_model="numpy")(_pair)
    (address,) = intrinsics.addresses_of(pair)
    w = start.copy()
    shared = np.array([5])
    compiled = njit(error_model="numpy")(_every_operation)
    values, point, spin, numbers, place, width, idle = compiled(
        PROBLEM, w, shared, address
    )
    lane = Lane(PROBLEM, w, 1)
    y = np.arange(1.0, 6.0)
    assert lane.y == tuple(y)
    assert lane.f == tuple(1.25 * y)
    assert point == lane.lo == (0.25, 7, 0)
    assert spin == FULL.spin(y)
    assert shared == [8]
    assert numbers == (11, 30)
    assert place == 3
    assert (width, idle) == (WIDTH, PROBLEM.idle)
    step = y + 0.5 * 0.25 * (2 * 1.25 * y + 3 * 1.25 * y)
    assert values[: FULL.n_state] == pytest.approx(step)
    assert values[FULL.n_state :] == lane.constants
    # The other lane is untouched.
    assert np.array_equal(w.reshape(-1, WIDTH)[:, 0], start.reshape(-1, WIDTH)[:, 0])


@pytest.mark.parametrize(
    "name", ["full", "full_sliding", "ellipsoid_creep_pivoting_sliding", "full_frame"]
)
def test_a_lane_has_each_field_once_in_the_order_of_its_nouns(name):
    model = find_model(name)
    at = layout_of(model)
    shared = layout_of(None)
    # Some constants have a name of their own beside that of all.
    named = places_of(model)
    assert {each: at.row_of(each) - at.constants for each in named} == named
    own = {field: place for field, place in at.fields.items() if field not in named}
    for field, place in shared.fields.items():
        # A kernel without a model finds the same rows.
        assert at.fields[field] == place
    rows = [row for row, _ in own.values()]
    assert rows == sorted(rows)
    kinds = [kind for _, kind in own.values()]
    sizes = [1 if kind is types.float64 else len(kind) for kind in kinds]
    # A name that two nouns declared would leave rows that nothing is in.
    kept = at.results - at.kept  # an end of a step, without names
    assert sum(sizes) == at.stages - kept
    assert at.y == at.first == shared.first
    # What it has at the end of a step is as far behind that at its start, for all rows.
    ends = [field for field in own if at.first <= at.row_of(field) < at.second]
    distances = {at.row_of(field + "1") - at.row_of(field) for field in ends}
    assert distances == {traits_for(DOP853, model).n_end}


def test_rows_that_others_read_are_named_and_some_models_lack_them():
    sliding = traits_for(DOP853, find_model("full_sliding"))
    pivoting = traits_for(DOP853, find_model("full_pivoting"))
    plain = traits_for(DOP853, FULL)
    assert plain.slip == plain.mu == plain.sense == NO_ROW
    assert sliding.sense == pivoting.slip == pivoting.mu == NO_ROW
    assert min(sliding.slip, sliding.mu, pivoting.sense) > 0
    assert (plain.n_results, sliding.n_results, pivoting.n_results) == (0, 4, 4)


def test_only_models_that_slide_have_rows_for_slides():
    sliding = layout_of(find_model("full_sliding")).fields.keys()
    pivoting = layout_of(find_model("full_pivoting")).fields.keys()
    plain = layout_of(FULL).fields.keys()
    assert {"slip", "mu", "t_slide", "past"} <= sliding - plain
    assert {"t_held", "pulled", "slack"} <= pivoting - sliding
    assert not pivoting & {"slip", "mu", "t_slide", "past"}


def test_only_modes_tell_modes_apart():
    kernel = CONFIGS.parent / "rattlesweep" / "kernel"
    own = {kernel / "state" / "ways.py", *(kernel / "mode").glob("*.py")}
    # The steps of slides are those of one mode, and of one with and without a torque.
    step = {*(kernel / "step").glob("*.py")}
    tests = []
    for path in sorted(set(kernel.rglob("*.py")) - own):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
                asked = f"{ast.unparse(node.value)}.{node.attr}"
                is_trait = node.attr in ("slide", "slides", "pivot", "pivots")
                if asked == "lane.mode" or (is_trait and path not in step):
                    tests.append(f"{path.name}:{node.lineno} {asked}")
    # Others ask by the functions of `state.ways` and of `ModeSet`.
    assert tests == []


def test_numbers_of_a_workspace_are_copied():
    @njit(error_model="numpy")
    def copied(w, count):
        intrinsics.copy_numbers(w, 1, 5, count)

    w = np.arange(9.0)
    copied(w, 3)
    assert w.tolist() == [0, 5, 6, 7, 4, 5, 6, 7, 8]
