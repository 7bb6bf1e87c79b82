"""The tangent that a lane carries along its run: how it begins, moves on and is measured.

The tangent obeys a linear equation, so its length may be changed at any time.  It is multiplied by
a power of two when it has become very long or short; that rounds nothing, costs no
logarithm, and the tangent never overflows.
"""

from __future__ import annotations

from math import log, sqrt
from typing import TYPE_CHECKING, Any

from numba import njit

from rattlesweep.integrate.lanes.atomics import widest_vectors
from rattlesweep.integrate.lanes.cells import INNER, cells, gather, move
from rattlesweep.integrate.lanes.step import LANES, Layout
from rattlesweep.physics.full import FASTMATH

if TYPE_CHECKING:
    from collections.abc import Callable

    from rattlesweep.integrate.model import Model

# A tangent is scaled by 2^SHIFT when its norm leaves 2^-SHIFT .. 2^SHIFT.
SHIFT = 200
NAMES = ("tangent_seed", "tangent_begin", "tangent_log", "tangent_stay", "tangent_advance")


def _lane(first: int, count: int) -> str:
    """Rows of a lane, as a tuple of Python's."""
    return ", ".join(f"lane[{first + c}]" for c in range(count))


def tangent_source(model: Model, lanes: int = LANES) -> str:
    """Source of what is done with the tangents of a model.

    ``tangent_seed(lane)`` gives a lane the model's first tangent, ``tangent_begin(lane)`` makes
    it transverse and of norm 1.  ``tangent_log(lane)`` is the logarithm of its norm at the end of
    the step just tried.  ``tangent_advance(w)`` moves the tangents of all lanes to the end of their
    step, ``tangent_stay(lane)`` makes that the start of the step.
    """
    at, n = Layout.of(model), model.n_state
    y, f, v, g, v1, g1 = (_lane(row, n) for row in (at.y, at.f, at.v, at.g, at.v1, at.g1))
    constants = _lane(at.constants, model.n_constants)
    found = ", ".join(f"v{c}" for c in range(n))
    unit = ", ".join(f"v{c} / norm" for c in range(n))
    # One line a row: a loop over rows inside that over lanes would stay scalar.
    rows = (*range(at.v, at.v + n), *range(at.g, at.g + n))
    scaled = "\n        ".join(f"w[{row * lanes} + l] *= factor" for row in rows)
    return f"""\
def tangent_seed(lane):
    {v} = seed({y}, {constants})

def tangent_begin(lane):
    {found} = transverse({y}, {f}, {v}, {constants})
    norm = sqrt(square({found}, {constants}))
    {v} = {unit}
    {g} = rate({y}, {f}, {v}, {constants})
    lane[{at.shift}] = 0.0

def tangent_log(lane):
    return 0.5 * log(square({v1}, {constants})) + {log(2.0)!r} * lane[{at.shift}]

def tangent_stay(lane):
    {v1} = {v}
    {g1} = {g}

def tangent_advance(w):
    widest_vectors()
    for l in range({lanes}):
        move(w, l)
    for l in range({lanes}):
        square_ = square(*measured(w, l))
        factor = {2.0**-SHIFT!r} if square_ > {4.0**SHIFT!r} else 1.0
        factor = {2.0**SHIFT!r} if square_ < {4.0**-SHIFT!r} else factor
        out = {float(SHIFT)} if square_ > {4.0**SHIFT!r} else 0.0
        out = {-float(SHIFT)} if square_ < {4.0**-SHIFT!r} else out
        {scaled}
        w[{at.shift * lanes} + l] += out
"""


def compile_tangent_functions(model: Model, lanes: int = LANES) -> dict[str, Callable[..., Any]]:
    """Compiled functions of :func:`tangent_source`, by name; none for a model without tangent."""
    if model.tangent is None:
        return {}
    at, n = Layout.of(model), model.n_state
    both = [*range(at.v, at.v + n), *range(at.g, at.g + n)]
    ends = [*range(at.v1, at.v1 + n), *range(at.g1, at.g1 + n)]
    namespace: dict[str, Any] = {
        **vars(model.tangent), "sqrt": sqrt, "log": log,
        "widest_vectors": widest_vectors, "move": move(both, ends, lanes),
        "measured": gather(cells(at.v, n) + cells(at.constants, model.n_constants), lanes),
    }  # fmt: skip
    exec(tangent_source(model, lanes), namespace)
    compiled = {}
    for name in NAMES:
        function = namespace[name]
        function.__name__ = function.__qualname__ = f"{name}_{model.name}_{lanes}"
        compiled[name] = njit(fastmath=FASTMATH, **INNER)(function)
    return compiled
