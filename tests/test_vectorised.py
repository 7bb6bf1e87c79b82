"""The machine code of the lane kernels: their loops over lanes are vectorised."""

import platform
import re
from functools import cache

import kernels
import numpy as np
import pytest
from numba import njit

from rattlesweep.integrate.model import MODELS, WITH_TANGENT
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.physics.full import FASTMATH

pytestmark = pytest.mark.skipif(
    platform.machine() not in ("x86_64", "AMD64"), reason="reads x86 assembly"
)

# Arithmetic on doubles, with (v...) or without AVX; "sd" is one number, "pd" a register full.
ARITHMETIC = re.compile(
    r"^\s+v?(add|sub|mul|div|sqrt|min|max|cmp\w*|ucomi|comi|fn?m(?:add|sub)\d*)([sp])d\s", re.M
)
SLOW = {"div", "sqrt"}
TANGENTS = [model.name for model in WITH_TANGENT.values()]
# A step with a tangent takes seconds to compile: each once, the others when asked.
QUICK = {("dop853", "full_tangent"), ("rk4", "reduced_tangent")}
kinds = pytest.mark.parametrize(
    ("method", "model"),
    [
        pytest.param(
            method,
            model,
            marks=[pytest.mark.slow] if model in TANGENTS and (method, model) not in QUICK else [],
        )
        for method in METHODS
        for model in MODELS
    ],
)


@cache
def assembly(function, signature):
    function.compile(signature)
    return function.inspect_asm(function.signatures[0])


def counts(text):
    """Scalar and packed operations, and of them the divisions and roots."""
    found = ARITHMETIC.findall(text)
    return {
        (width, slow): sum(w == width and (name in SLOW) == slow for name, w in found)
        for width in "sp"
        for slow in (False, True)
    }


def assert_vectorised(text, share):
    """Scalar operations are at most ``share`` of the packed ones, in both kinds."""
    found = counts(text)
    assert found["p", False] > 0, found
    for slow in (False, True):
        assert found["s", slow] <= share * found["p", slow], found
    # Registers as wide as can be.
    if re.search(r"^\s+v\w+pd\s", text, re.M):
        assert re.search(r"%[yz]mm", text)


@kinds
def test_attempt_is_vectorised(method, model):
    text = assembly(kernels.attempt(method, model), "void(float64[::1], float64)")
    assert_vectorised(text, share=0)
    # Every stage of the full model divides and takes a root.
    assert not model.startswith("full") or counts(text)["p", True] >= METHODS[method].stages


@kinds
def test_decisions_are_vectorised(method, model):
    text = assembly(
        kernels.pieces(method, model)["decide"], "int64(float64[::1], float64, float64)"
    )
    assert_vectorised(text, share=0.1)
    # The step factor is a quotient and four roots.
    assert (counts(text)["p", True] >= 5) == METHODS[method].adaptive


@pytest.mark.parametrize("model", MODELS)
def test_commit_is_vectorised(model):
    text = assembly(kernels.pieces("dop853", model)["commit"], "void(float64[::1])")
    assert_vectorised(text, share=0.1)


@pytest.mark.parametrize("model", MODELS)
def test_advance_is_vectorised(model):
    text = assembly(kernels.pieces("dop853", model)["advance"], "void(float64[::1])")
    assert_vectorised(text, share=0)


@pytest.mark.parametrize("model", TANGENTS)
def test_tangents_move_on_vectorised(model):
    text = assembly(kernels.pieces("dop853", model)["tangent_advance"], "void(float64[::1])")
    assert_vectorised(text, share=0)


def test_a_scalar_loop_is_recognised():
    @njit(fastmath=FASTMATH, error_model="numpy")
    def chain(w):
        for l in range(1, 4096):
            w[l] = 1.0 / (w[l - 1] + 2.0)

    @njit(fastmath=FASTMATH, error_model="numpy")
    def free(w):
        for l in range(4096):
            w[l] = 1.0 / (w[l] + 2.0)

    assert_vectorised(assembly(free, "void(float64[::1])"), share=0)
    with pytest.raises(AssertionError):
        assert_vectorised(assembly(chain, "void(float64[::1])"), share=0.5)


def test_the_generated_step_keeps_lanes_apart():
    # A number put into one lane reaches no other.
    flat, rows, at = kernels.workspace("dop853", "full")
    rng = np.random.default_rng(0)
    rows[at.constants : at.constants + 6] = [[12.04], [0.5], [12.3], [0.6], [0.1], [26.0]]
    rows[at.y : at.y + 5] = 0.1 * rng.standard_normal((5, 1))
    rows[at.h] = 0.1
    kernels.attempt("dop853", "full")(flat, 1e12)
    before = rows.copy()
    assert (before == before[:, :1]).all()
    rows[at.y, 7] = np.nan
    kernels.attempt("dop853", "full")(flat, 1e12)
    changed = ~((rows == before) | (np.isnan(rows) & np.isnan(before)))
    assert changed[:, 7].any()
    assert not np.delete(changed, 7, axis=1).any()
