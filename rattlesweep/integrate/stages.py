"""The vectorised step: source generated from a tableau and a model.

One call of the generated function tries one step on every lane (:data:`SUBSTEPS` equal ones for
a method without error control).  All arrays are rows of one
flat workspace, each row as long as there are lanes, and every stage is one loop over lanes that
loads its combination of earlier stages, calls the scalar right-hand side and stores ``h f``.  With
the coefficients and the offsets as constants in the source, LLVM drops the zeros, keeps the
stage in registers and vectorises each loop; one workspace instead of many arrays
lets it prove that rows do not overlap.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numba import njit

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
    stages : int
        First row of the stages; they come last.
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
    stages: int

    @classmethod
    def of(cls, model: Model) -> Layout:
        """Layout for a model."""
        n = model.n_state
        sizes = (n, n, n, n, model.n_constants, model.n_probe, 1, 1, 1, 1, 1, 0)
        rows = [STATE_ROWS + sum(sizes[:i]) for i in range(len(sizes))]
        return cls(*rows)


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

    def combine(row: Row, c: int) -> str:
        return " + ".join(f"{coefficient!r} * {stage(j, c)}" for j, coefficient in row.items())

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

    def stages(y: int, f: int, share: str, last: list[str]) -> None:
        """A step of ``share * h`` from rows ``y, f``; ``last`` joins the last loop."""
        h = f"h = {cell(at.h)}{share}"
        loop([h, *(f"{stage(0, c)} = h * {cell(f + c)}" for c in states)])
        for i in range(1, tableau.stages):
            loop(
                [
                    h,
                    *load_constants,
                    *(f"y{c} = {cell(y + c)} + ({combine(tableau.a[i], c)})" for c in states),
                    f"{names('f')} = rhs({names('y')}, {constants})",
                    *(f"{stage(i, c)} = h * f{c}" for c in states),
                ]
            )
        loop(
            [
                *load_constants,
                *(f"y{c} = {cell(y + c)} + ({combine(tableau.b, c)})" for c in states),
                *derivative(at.y1, at.f1),
                *last,
            ]
        )

    if tableau.adaptive:
        stages(at.y, at.f, "", ends)
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
        lines.append(f"    for _ in range({SUBSTEPS}):")
        indent = 8
        stages(at.y1, at.f1, f" * {1 / SUBSTEPS!r}", [])
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
