"""The vectorised step: source generated from a tableau and a model.

One call of the generated function tries one step on every lane (:data:`SUBSTEPS` equal ones for
a method without error control).  All arrays are rows of one
flat workspace, each row as long as there are lanes, and every stage is one loop over lanes that
loads its combination of earlier stages, calls the scalar right-hand side and stores ``h f``.  With
the coefficients and the offsets as constants in the source, LLVM drops the zeros, keeps the
stage in registers and vectorises each loop; one workspace instead of many arrays
lets it prove that rows do not overlap.

A tangent has loops of its own, behind those of the state, and barriers between.  Else LLVM would
share products between the two, fuse other sums with them, and the state would come out with other
last bits than without a tangent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numba import njit

from rattlesweep.integrate.atomics import barrier
from rattlesweep.integrate.rows import ACCEPT, STATE_ROWS
from rattlesweep.physics.full import FASTMATH

if TYPE_CHECKING:
    from collections.abc import Callable

    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Row, Tableau

# 32 lanes: see benchmarks/kernel.py --lanes for the figures behind it.
LANES = 32
# Steps of a fixed-step method between two looks at the lanes: the looks then cost little.
SUBSTEPS = 8


@dataclass(frozen=True)
class Layout:
    """Rows of the workspace of one model, behind those of :mod:`rattlesweep.integrate.rows`.

    Attributes
    ----------
    y, f, y1, f1 : int
        First row of the state and its derivative at the start and at the end of the step.
    constants, probe : int
        First row of the body's constants and of the amplitude's coefficients.
    h, error, n1, rate1, amplitude : int
        Rows of the step size, the squared error in units of the tolerance, and of the spin, its
        rate and the squared amplitude at the end of the step.
    v, g, v1, g1 : int
        First row of the tangent and its derivative at the start and at the end of the step; this
        and the next have no rows in a model without tangent.
    ys, fs : int
        First row of a stage's state and derivative, for the tangent's stage.
    shift : int
        Row of the exponent of the power of two taken out of the tangent.
    stages : int
        First row of the stages; they come last, those of the tangent behind the state's.
    """

    y: int
    f: int
    y1: int
    f1: int
    constants: int
    probe: int
    h: int
    error: int
    n1: int
    rate1: int
    amplitude: int
    v: int
    g: int
    v1: int
    g1: int
    ys: int
    fs: int
    shift: int
    stages: int

    @classmethod
    def of(cls, model: Model) -> Layout:
        """Layout for a model."""
        n = model.n_state
        t = n if model.tangent else 0
        sizes = (n, n, n, n, model.n_constants, model.n_probe, 1, 1, 1, 1, 1,
                 t, t, t, t, t, t, min(t, 1), 0)  # fmt: skip
        rows = [STATE_ROWS + sum(sizes[:i]) for i in range(len(sizes))]
        return cls(*rows)

    def rows(self, tableau: Tableau, model: Model) -> int:
        """Number of rows of the workspace for a method."""
        return self.stages + tableau.stages * model.n_state * (2 if model.tangent else 1)


def source(tableau: Tableau, model: Model, lanes: int = LANES) -> str:
    """Source text of ``attempt(w, scale)``.

    Parameters
    ----------
    tableau, model
        The method and the equations.
    lanes : int
        Row length of the workspace.

    Returns
    -------
    str
        Defines ``attempt(w, scale)``: ``w`` is the flat workspace, ``scale`` is ``1 / tol**2``.
    """
    at = Layout.of(model)
    n = model.n_state
    states = range(n)

    def cell(row: int) -> str:
        return f"w[{row * lanes} + l]"

    def stage(j: int, c: int) -> str:
        return cell(at.stages + j * n + c)

    def combine(row: Row, c: int, first: int = 0) -> str:
        return " + ".join(
            f"{coefficient!r} * {stage(first + j, c)}" for j, coefficient in row.items()
        )

    constants = ", ".join(f"q{i}" for i in range(model.n_constants))
    load_constants = [f"q{i} = {cell(at.constants + i)}" for i in range(model.n_constants)]
    load_probe = [f"o{i} = {cell(at.probe + i)}" for i in range(model.n_probe)]
    probe = ", ".join(f"o{i}" for i in range(model.n_probe))

    def names(prefix: str) -> str:
        return ", ".join(f"{prefix}{c}" for c in states)

    def derivative(y: int, f: int) -> list[str]:
        return [
            f"{names('f')} = rhs({names('y')}, {constants})",
            *(f"{cell(y + c)} = y{c}" for c in states),
            *(f"{cell(f + c)} = f{c}" for c in states),
        ]

    ends = [
        f"{cell(at.n1)} = spin({names('y')})",
        f"{cell(at.rate1)} = spin_rate({names('y')}, {names('f')})",
        *load_probe,
        f"{cell(at.amplitude)} = amplitude({names('y')}, {probe})",
    ]
    lines = ["def attempt(w, scale):"]
    indent = 4

    def loop(body: list[str]) -> None:
        lines.append(" " * indent + f"for l in range({lanes}):")
        lines.extend(" " * (indent + 4) + text for text in body)

    def tangent_loop(body: list[str]) -> None:
        lines.append(" " * indent + "barrier()")
        loop(body)
        lines.append(" " * indent + "barrier()")

    def tangent_at(row: Row, v: int, y: int, f: int, project: bool = False) -> list[str]:
        """The tangent at ``row`` and its rate, with the state and its derivative at ``y, f``."""
        first = tableau.stages
        given = f"{names('y')}, {names('f')}, {names('v')}, {constants}"
        return [
            *load_constants,
            *(f"y{c} = {cell(y + c)}" for c in states),
            *(f"f{c} = {cell(f + c)}" for c in states),
            *(f"v{c} = {cell(v + c)} + ({combine(row, c, first)})" for c in states),
            *([f"{names('v')} = transverse({given})"] if project else []),
            f"{names('g')} = tangent_rate({given})",
        ]

    share = "" if tableau.adaptive else f" * {1 / SUBSTEPS!r}"
    keep = [f"{cell(at.ys + c)} = y{c}" for c in states if model.tangent]
    keep += [f"{cell(at.fs + c)} = f{c}" for c in states if model.tangent]

    def stages(y: int, f: int, v: int, g: int, last: list[str]) -> None:
        """A step of ``share * h`` from rows ``y, f, v, g``; ``last`` joins the last loop."""
        h = f"h = {cell(at.h)}{share}"
        loop([h, *(f"{stage(0, c)} = h * {cell(f + c)}" for c in states)])
        if model.tangent:
            first = tableau.stages
            tangent_loop([h, *(f"{stage(first, c)} = h * {cell(g + c)}" for c in states)])
        for i in range(1, tableau.stages):
            loop(
                [
                    h,
                    *load_constants,
                    *(f"y{c} = {cell(y + c)} + ({combine(tableau.a[i], c)})" for c in states),
                    f"{names('f')} = rhs({names('y')}, {constants})",
                    *(f"{stage(i, c)} = h * f{c}" for c in states),
                    *keep,
                ]
            )
            if model.tangent:
                body = tangent_at(tableau.a[i], v, at.ys, at.fs)
                body += [f"{stage(tableau.stages + i, c)} = h * g{c}" for c in states]
                tangent_loop([h, *body])
        loop(
            [
                *load_constants,
                *(f"y{c} = {cell(y + c)} + ({combine(tableau.b, c)})" for c in states),
                *derivative(at.y1, at.f1),
                *last,
            ]
        )
        if model.tangent:
            # Only the transverse part goes on.  If it decays, what rounding leaves of the others
            # would soon hide it.
            body = tangent_at(tableau.b, v, at.y1, at.f1, project=True)
            body += [f"{cell(at.v1 + c)} = v{c}" for c in states]
            body += [f"{cell(at.g1 + c)} = g{c}" for c in states]
            tangent_loop(body)

    if tableau.adaptive:
        stages(at.y, at.f, at.v, at.g, ends)
        body = [f"h = {cell(at.h)}", *load_constants]
        body += [f"y{c} = {cell(at.y + c)}" for c in states]
        for k, row in enumerate(tableau.errors):
            inner = {j: v for j, v in row.items() if j < tableau.stages}
            end = row.get(tableau.stages)
            for c in states:
                tail = f" + {end!r} * h * {cell(at.f1 + c)}" if end else ""
                body.append(f"e{c} = {combine(inner, c)}{tail}")
            body.append(f"s{k} = scale * error({names('e')}, {names('y')}, {constants})")
        if len(tableau.errors) == 2:
            # Hairer's blend of the fifth and third order estimates; both are squared here.
            body.append(f"{cell(at.error)} = s0 * s0 / (s0 + 0.01 * s1 + 1e-300)")
        else:
            body.append(f"{cell(at.error)} = s0")
        loop(body)
    else:
        both = range(2 * n)
        loop([f"{cell(at.y1 + c)} = {cell(at.y + c)}" for c in both])
        if model.tangent:
            loop([f"{cell(at.v1 + c)} = {cell(at.v + c)}" for c in both])
        lines.append(f"    for _ in range({SUBSTEPS}):")
        indent = 8
        stages(at.y1, at.f1, at.v1, at.g1, [])
        indent = 4
        loop(
            [
                *(f"y{c} = {cell(at.y1 + c)}" for c in states),
                *(f"f{c} = {cell(at.f1 + c)}" for c in states),
                *ends,
                # Zero, or not a number where the step left the numbers.
                f"{cell(at.error)} = 0.0 * ({' + '.join(f'f{c}' for c in states)})",
            ]
        )
    return "\n".join(lines) + "\n"


def compile_attempt(tableau: Tableau, model: Model, lanes: int = LANES) -> Callable[..., Any]:
    """Compiled ``attempt`` of a method and a model (lazily, at its first use)."""
    namespace: dict[str, Any] = {
        "rhs": model.rhs,
        "spin": model.spin,
        "spin_rate": model.spin_rate,
        "amplitude": model.amplitude,
        "error": model.error,
        "tangent_rate": model.tangent and model.tangent.rate,
        "transverse": model.tangent and model.tangent.transverse,
        "barrier": barrier,
    }
    exec(source(tableau, model, lanes), namespace)
    function = namespace["attempt"]
    # The name becomes part of the compiled symbol; two methods must not share one.
    function.__name__ = function.__qualname__ = f"attempt_{tableau.name}_{model.name}_{lanes}"
    compiled: Callable[..., Any] = njit(fastmath=FASTMATH, error_model="numpy", nogil=True)(
        function
    )
    return compiled


def lane_source(model: Model, lanes: int = LANES) -> str:
    """Source of the small functions that depend on the model's number of components.

    ``lane_energy``, ``lane_contact`` and ``lane_rhs`` look at one lane; ``advance`` moves the
    accepted lanes to the end of their step.
    """
    at = Layout.of(model)
    states = range(model.n_state)
    constants = ", ".join(f"w[{(at.constants + i) * lanes} + l]" for i in range(model.n_constants))
    any_row = ", ".join(f"w[(row + {c}) * {lanes} + l]" for c in states)
    start = ", ".join(f"w[{(at.y + c) * lanes} + l]" for c in states)
    rates = ", ".join(f"w[{(at.f + c) * lanes} + l]" for c in states)
    old = [f"w[{(at.y + c) * lanes} + l]" for c in range(2 * model.n_state)]
    new = [f"w[{(at.y1 + c) * lanes} + l]" for c in range(2 * model.n_state)]
    # Both values are loaded before the choice: a load in one arm alone would stay a branch.
    moves = "\n        ".join(
        f"a = {a}\n        b = {b}\n        {a} = b if accept else a"
        for a, b in zip(old, new, strict=True)
    )
    return f"""\
def advance(w):
    for l in range({lanes}):
        accept = w[{ACCEPT * lanes} + l] > 0.0
        {moves}

def lane_energy(w, row, l):
    return energy({any_row}, {constants})

def lane_contact(w, row, l):
    return contact({any_row}, {constants})

def lane_rhs(w, l):
    {rates} = rhs({start}, {constants})
    return spin({start}), spin_rate({start}, {rates})
"""


def compile_lane_functions(model: Model, lanes: int = LANES) -> dict[str, Callable[..., Any]]:
    """Compiled functions of :func:`lane_source`, by name."""
    namespace: dict[str, Any] = {
        "rhs": model.rhs,
        "spin": model.spin,
        "spin_rate": model.spin_rate,
        "energy": model.energy,
        "contact": model.contact,
    }
    exec(lane_source(model, lanes), namespace)
    compiled = {}
    for name in ("advance", "lane_energy", "lane_contact", "lane_rhs"):
        function = namespace[name]
        function.__name__ = function.__qualname__ = f"{name}_{model.name}_{lanes}"
        compiled[name] = njit(fastmath=FASTMATH, error_model="numpy", nogil=True)(function)
    return compiled
