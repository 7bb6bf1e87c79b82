"""The machine code of the lane kernels: their loops over lanes are vectorised.

What is compiled here is not run.
"""

import platform
import re
from functools import cache

import kernels
import pytest
from numba import boolean, float64, int64, njit, typeof

from rattlesweep.compiling.intrinsics import FUSED
from rattlesweep.kernel import recipes, tangents, turn
from rattlesweep.kernel.look import extremes
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.kernel.state.lane import lane_of

pytestmark = pytest.mark.skipif(
    platform.machine() not in ("x86_64", "AMD64"), reason="reads x86 assembly"
)

# Arithmetic on doubles, with (v...) or without AVX: "sd" on one number, "pd" on a full
# register.
ARITHMETIC = re.compile(
    r"^\s+v?(add|sub|mul|div|sqrt|min|max|cmp\w*|ucomi|comi|fn?m(?:add|sub)\d*)([sp])d\s",
    re.M,
)
SLOW = {"div", "sqrt"}
# A step takes seconds to compile: a few are always checked, the others in slow tests.
QUICK = {("dop853", "full"), ("rk4", "full_tangent")}
kinds = pytest.mark.parametrize(
    ("method", "model"),
    [
        pytest.param(m, model, marks=[] if (m, model) in QUICK else [pytest.mark.slow])
        for m in METHODS
        for model in kernels.MODEL_NAMES
    ],
)
models = pytest.mark.parametrize(
    "model",
    [
        pytest.param(m, marks=[] if m == "full" else [pytest.mark.slow])
        for m in kernels.MODEL_NAMES
    ],
)

TRAITS = typeof(recipes.TRAITS)
# Pieces of the loop, which all models share, and of the parts of a model.
SHARED = {
    "decide_adaptive": (turn.decide_adaptive, (float64[::1], float64, float64)),
    "decide_fixed": (turn.decide_fixed, (float64[::1], float64, float64)),
    "move_on": (turn.move_on, (float64[::1],)),
}
PIECES = {
    "advance_tangent": (tangents.advance_tangent, (float64[::1],)),
    "observe_contact": (extremes.observe_contact, (float64[::1], boolean)),
    "observe_spin": (extremes.observe_spin, (float64[::1],)),
}


@njit(**FUSED)
def rates(problem, w):
    """Compute the right-hand side at the start of the step of every lane."""
    for l in range(problem.lanes):
        lane = lane_of(problem, w, l)
        lane.f = problem.model.rhs(lane.y, lane.constants)


@cache
def assembly(function, signature):
    function.compile(signature)
    return function.inspect_asm(function.signatures[-1])


def piece(name, method, model):
    """Return the machine code of a piece of a kernel."""
    problem = typeof(kernels.problem(model))
    if name == "attempt":
        return assembly(
            kernels.attempt(method, model), (problem, float64[::1], float64, int64)
        )
    function, arguments = PIECES[name]
    return assembly(function, (problem, *arguments))


def counts(text):
    """Count scalar and packed operations, with divisions and roots apart."""
    found = ARITHMETIC.findall(text)
    return {
        (width, slow): sum(w == width and (name in SLOW) == slow for name, w in found)
        for width in "sp"
        for slow in (False, True)
    }


def assert_vectorised(text):
    """Check that no operation is scalar, and that no load or store is masked with
    AVX2.
    """
    found = counts(text)
    assert found["p", False] + found["p", True] > 0 or re.search(r"%[xyz]mm", text)
    assert found["s", False] == found["s", True] == 0, found
    assert "maskmov" not in text
    # The widest registers are used.
    if re.search(r"^\s+v\w+pd\s", text, re.M):
        assert re.search(r"%[yz]mm", text)


def models_that_roll():
    """Return the models but those with slides, which have the same right-hand side.

    All are tried with code for AVX2 by `.ci/run`; quick is the one with most couples.
    """
    for model in kernels.MODEL_NAMES:
        if not model.endswith("sliding"):
            marks = [] if model == "full_rolling_pivoting" else [pytest.mark.slow]
            yield pytest.param(model, marks=marks)


@pytest.mark.parametrize("model", [*models_that_roll()])
def test_rates_are_vectorised(model):
    """The right-hand side alone: it compiles in a fraction of a step's time."""
    problem = typeof(kernels.problem(model))
    assert_vectorised(assembly(rates, (problem, float64[::1])))


@kinds
def test_attempt_is_vectorised(method, model):
    text = piece("attempt", method, model)
    assert_vectorised(text)
    # Every stage of the full model divides and takes a root.
    assert (
        not model.startswith("full")
        or counts(text)["p", True] >= METHODS[method].stages
    )


@pytest.mark.parametrize("name", SHARED)
def test_the_loop_is_vectorised(name):
    function, arguments = SHARED[name]
    text = assembly(function, (typeof(recipes.problem_of(None)), *arguments))
    assert_vectorised(text)
    # The ratio of two steps is a quotient.
    assert (counts(text)["p", True] >= 1) == (name == "decide_adaptive")


@models
def test_steps_are_looked_into_vectorised(model):
    assert_vectorised(piece("observe_spin", "dop853", model))
    if model == "full_tangent":
        assert_vectorised(piece("advance_tangent", "dop853", model))


@models
def test_observations_are_vectorised(model):
    if model.endswith("rolling"):
        pytest.skip("the resistance of rolling has branches")
    if model != "reduced":
        assert_vectorised(piece("observe_contact", "dop853", model))
