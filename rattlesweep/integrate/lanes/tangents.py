"""The tangent that a lane carries along its run: how it begins, moves on and is measured.

The tangent obeys a linear equation, so its length may be changed at any time.  It is multiplied by
a power of two when it has become very long or short; that rounds nothing, costs no
logarithm, and the tangent never overflows.
"""

from __future__ import annotations

from math import log, sqrt
from typing import TYPE_CHECKING, Any

from numba import njit

from rattlesweep.integrate.lanes.cells import INNER, move
from rattlesweep.integrate.lanes.rows import ACCEPT
from rattlesweep.integrate.lanes.step import LANES, Layout
from rattlesweep.physics.full import FASTMATH

if TYPE_CHECKING:
    from collections.abc import Callable

    from rattlesweep.integrate.model import Model

# A tangent is scaled by 2^SHIFT when its norm leaves 2^-SHIFT .. 2^SHIFT.
SHIFT = 200
NAMES = ("tangent_seed", "tangent_begin", "tangent_log", "tangent_advance")


def tangent_source(model: Model, lanes: int = LANES) -> str:
    """Source of what is done with the tangents of a model.

    ``tangent_seed(w, l)`` gives lane ``l`` the model's first tangent, ``tangent_begin(w, l)`` makes
    it transverse and of norm 1.  ``tangent_log(w, l)`` is the logarithm of its norm at the end of
    the step just tried.  ``tangent_advance(w)`` moves the tangents of the accepted lanes to the end
    of their step.
    """
    at = Layout.of(model)
    states = range(model.n_state)

    def cells(first: int, count: int = model.n_state) -> list[str]:
        return [f"w[{(first + c) * lanes} + l]" for c in range(count)]

    def names(first: int, count: int = model.n_state) -> str:
        return ", ".join(cells(first, count))

    constants = names(at.constants, model.n_constants)
    v = ", ".join(f"v{c}" for c in states)
    scale = [f"{a} = {a} * factor" for a in (*cells(at.v), *cells(at.g))]
    step = "\n        "
    return f"""\
def tangent_seed(w, l):
    {names(at.v)} = seed({names(at.y)}, {constants})

def tangent_begin(w, l):
    {v} = transverse({names(at.y)}, {names(at.f)}, {names(at.v)}, {constants})
    norm = sqrt(square({v}, {constants}))
    {step.join(f"{a} = v{c} / norm" for c, a in enumerate(cells(at.v))).replace(step, "; ")}
    {names(at.g)} = rate({names(at.y)}, {names(at.f)}, {names(at.v)}, {constants})
    w[{at.shift * lanes} + l] = 0.0

def tangent_log(w, l):
    return 0.5 * log(square({names(at.v1)}, {constants})) + {log(2.0)!r} * w[{at.shift * lanes} + l]

def tangent_advance(w):
    for l in range({lanes}):
        move(w, l, w[{ACCEPT * lanes} + l] > 0.0)
    for l in range({lanes}):
        square_ = square({names(at.v)}, {constants})
        factor = {2.0**-SHIFT!r} if square_ > {4.0**SHIFT!r} else 1.0
        factor = {2.0**SHIFT!r} if square_ < {4.0**-SHIFT!r} else factor
        out = {float(SHIFT)} if square_ > {4.0**SHIFT!r} else 0.0
        out = {-float(SHIFT)} if square_ < {4.0**-SHIFT!r} else out
        {step.join(scale)}
        w[{at.shift * lanes} + l] = w[{at.shift * lanes} + l] + out
"""


def compile_tangent_functions(model: Model, lanes: int = LANES) -> dict[str, Callable[..., Any]]:
    """Compiled functions of :func:`tangent_source`, by name; none for a model without tangent."""
    if model.tangent is None:
        return {}
    at, n = Layout.of(model), model.n_state
    both = [*range(at.v, at.v + n), *range(at.g, at.g + n)]
    ends = [*range(at.v1, at.v1 + n), *range(at.g1, at.g1 + n)]
    namespace: dict[str, Any] = {
        **vars(model.tangent), "sqrt": sqrt, "log": log, "move": move(both, ends, lanes)
    }  # fmt: skip
    exec(tangent_source(model, lanes), namespace)
    compiled = {}
    for name in NAMES:
        function = namespace[name]
        function.__name__ = function.__qualname__ = f"{name}_{model.name}_{lanes}"
        compiled[name] = njit(fastmath=FASTMATH, **INNER)(function)
    return compiled
