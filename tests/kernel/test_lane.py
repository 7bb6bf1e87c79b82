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
from rattlesweep.kernel.recipes import problem_of
from rattlesweep.kernel.state import lane as lanes
from rattlesweep.kernel.state.fields import N_SLIP, Point
from rattlesweep.kernel.state.lane import Lane
from rattlesweep.motion.model import FULL, find_model

WIDTH = 2
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
    at = layout_of(find_model(name))
    shared = layout_of(None)
    for field, place in shared.fields.items():
        # A kernel without a model finds the same rows.
        assert at.fields[field] == place
    rows = [row for row, _ in at.fields.values()]
    assert rows == sorted(rows)
    kinds = [kind for _, kind in at.fields.values()]
    sizes = [1 if kind is types.float64 else len(kind) for kind in kinds]
    # A name that two nouns declared would leave rows that nothing is in.
    kept = at.results - at.kept  # an end of a step, without names
    assert sum(sizes) == at.stages - kept
    assert at.y == at.first == shared.first
    if "slip" in at.fields:
        # Trajectories read it and write it there.
        assert at.slip == at.second - N_SLIP
        # A run begins with its constants and this one in one piece.
        assert at.mu == at.constants + find_model(name).n_constants


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
    tests = []
    for path in sorted(set(kernel.rglob("*.py")) - own):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            is_read = isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load)
            if is_read and node.attr == "mode" and ast.unparse(node.value) == "lane":
                tests.append(f"{path.name}:{node.lineno}")
    # Others ask by the functions of `state.ways`.
    assert tests == []


def test_numbers_of_a_workspace_are_copied():
    @njit(error_model="numpy")
    def copied(w, count):
        intrinsics.copy_numbers(w, 1, 5, count)

    w = np.arange(9.0)
    copied(w, 3)
    assert w.tolist() == [0, 5, 6, 7, 4, 5, 6, 7, 8]
