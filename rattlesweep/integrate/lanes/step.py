"""The vectorised step: a module generated from a tableau and a model.

Its function ``attempt`` tries one step on every lane (:data:`SUBSTEPS` equal ones for a method
without error control).  Every stage is one loop over lanes that loads its combination of earlier
stages, calls the right-hand side and stores ``f``.  Coefficients and rows are constants in the
source, so LLVM keeps the stage in registers and vectorises each loop.

A tangent has loops of its own, with barriers between.  Else LLVM would share products between it
and the state, which would come out with other last bits than without a tangent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rattlesweep.integrate.compile import import_written
from rattlesweep.integrate.lanes.lane import INNER, LANES, Layout
from rattlesweep.physics.full import FASTMATH

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Row, Tableau

SUBSTEPS = 8  # of a fixed-step method between two looks at the lanes
OPTIONS: dict[str, Any] = {"fastmath": FASTMATH} | INNER | {"no_cpython_wrapper": False}
HEAD = '''"""One step of {tableau.name} for the model {model.name}, written by lanes.step."""

from rattlesweep.integrate.lanes.lane import (
    barrier, gather, lane_of, scatter, sums, widest_vectors,
)
'''


class _Attempt:
    """The text of ``attempt(problem, w, scale)``: one step tried; ``scale`` is ``1 / tol**2``."""

    def __init__(self, tableau: Tableau, model: Model, lanes: int, volume: bool) -> None:
        self.tableau, self.model, self.lanes, self.volume = tableau, model, lanes, volume
        self.at = at = Layout(model)
        # Readers and writers of many cells, by name, and the lines of the function.
        self.cells: list[str] = []
        self.lines = ["def attempt(problem, w, scale):", "    widest_vectors()"]
        self.indent = 4
        if volume:
            self.loop("lane.volume_rate1 = 0.0")
        if tableau.adaptive:
            self.step(at.y, at.f, at.v, at.g, 1.0)
            self.errors()
        else:
            self.loop("lane.y1 = lane.y", "lane.f1 = lane.f")
            if model.rate:
                self.loop("lane.v1 = lane.v", "lane.g1 = lane.g")
            self.lines.append(f"    for _ in range({SUBSTEPS}):")
            self.indent = 8
            self.step(at.y1, at.f1, at.v1, at.g1, 1 / SUBSTEPS)
            self.indent = 4
            # Zero, or not a number where the step left the numbers.
            total = " + ".join(f"f[{c}]" for c in range(model.n_state))
            error = f"lane.error = 0.0 * ({total})"
            self.loop("y = lane.y1", "f = lane.f1", *SEEN, error)
        head = HEAD.format(tableau=tableau, model=model)
        self.source = "\n".join([head, *self.cells, "", "", *self.lines, ""])

    def step(self, y: int, f: int, v: int, g: int, share: float) -> None:
        """Write a step of ``share * h`` from rows ``y, f``, and of the tangent from ``v, g``."""
        tableau, model, at, n = self.tableau, self.model, self.at, self.model.n_state
        beside = at.stages + (tableau.stages - 1) * n
        self.stages = stages = [f, *range(at.stages, beside, n)]
        tangents = [g, *range(beside, beside + (tableau.stages - 1) * n, n)]
        # What is carried: its start, and its derivative there and in the other stages.
        n_carried = model.n_carried
        start, *behind = (beside + i * n_carried for i in range(tableau.stages + 1))
        if n_carried:
            given, put = self.gather(span(y, n)), self.scatter(span(start, 2 * n_carried))
            # Of the derivatives LLVM works out those behind alone.
            rate = f"problem.carried_rhs(*(q[:{n}] + x + q[{n}:]))[{n}:]"
            self.loop(f"q = {given}(w, l)", "x = problem.carried_start(*q)",
                      f"{put}(w, l, x + {rate})")  # fmt: skip
        for i in range(1, tableau.stages):
            values = self.sums(n, tableau.a[i], stages, y, share)
            to, rhs = span(stages[i], n), "rhs"
            if n_carried:
                values += " + " + self.sums(n_carried, tableau.a[i], behind, start, share)
                to, rhs = f"{to} + {span(behind[i], n_carried)}", "carried_rhs"
            body = [f"q = {self.gather(values)}(w, l)", f"f = problem.{rhs}(*q)"]
            body.append(f"{self.scatter(to)}(w, l, f)")
            if model.rate:
                # For the tangent's stage, in a loop of its own.
                self.loop(*body, f"lane.ys = q[:{n}]", "lane.fs = f")
                given = self.tangent_at(tableau.a[i], tangents, v, share, at.ys, at.fs)
                put = self.scatter(span(tangents[i], n))
                self.loop(f"{put}(w, l, problem.rate(*{given}(w, l)))", barriers=True)
            else:
                self.loop(*body)
        if self.volume:
            # The sum of the method for a variable beside the state, which no stage depends on.
            for i, weight in tableau.b.items():
                values = self.sums(n, tableau.a[i], stages, y, share) if i else span(y, n)
                rate = f"problem.volume(*{self.gather(values)}(w, l))"
                self.loop(f"lane.volume_rate1 += {share * weight} * {rate}", barriers=True)
        given = self.gather(self.sums(n, tableau.b, stages, y, share))
        body = [f"q = {given}(w, l)", "f = problem.rhs(*q)", f"y = q[:{n}]"]
        self.loop(*body, "lane.y1 = y", "lane.f1 = f", *(SEEN if tableau.adaptive else ()))
        if model.rate:
            given = self.tangent_at(tableau.b, tangents, v, share, at.y1, at.f1)
            # Only the transverse part goes on.  If it decays, what rounding leaves of the others
            # would soon hide it.
            rate = f"problem.rate(*(q[:{2 * n}] + v + q[{3 * n}:]))"
            self.loop(f"q = {given}(w, l)", "v = problem.transverse(*q)", "lane.v1 = v",
                      f"lane.g1 = {rate}", barriers=True)  # fmt: skip

    def errors(self) -> None:
        """Write the squared error, in units of the tolerance."""
        n, body = self.model.n_state, ["h = lane.h"]
        for k, row in enumerate(self.tableau.errors):
            values = f"{self.sums(n, row, [*self.stages, self.at.f1])} + {span(self.at.y, n)}"
            body.append(f"e{k}, size = problem.error(*{self.gather(values)}(w, l))")
        # Hairer's blend of the fifth and third order estimates; both are squared here.
        blend = "e0 * (e0 / (e0 + 0.01 * e1 + 1e-300))" if len(self.tableau.errors) == 2 else "e0"
        self.loop(*body, f"lane.error = (scale * h * h) * ({blend} / size)")

    def tangent_at(
        self, row: Row, tangents: Sequence[int], v: int, share: float, y: int, f: int
    ) -> str:
        """Return a reader of state, derivative, the tangent at a row of the tableau, constants."""
        n = self.model.n_state
        tangent = self.sums(n, row, tangents, v, share)
        return self.gather(f"{span(y, n)} + {span(f, n)} + {tangent}")

    def sums(self, count: int, row: Row, stages: Sequence[int], *from_and_share: float) -> str:
        """Return a row of the tableau times the stages, or ``start`` and ``share * h`` times it."""
        terms = {stages[j]: value for j, value in row.items()}
        if not from_and_share:
            return f"sums({count}, {terms})"
        start, share = from_and_share
        return f"sums({count}, {terms}, {start}, {self.at.h}, {share})"

    def gather(self, values: str) -> str:
        """Return a reader of values and, behind them, the body's constants."""
        behind = span(self.at.constants, self.model.n_constants)
        return self.name("given", f"gather({self.lanes}, {values}, behind={behind})")

    def scatter(self, to: str) -> str:
        return self.name("put", f"scatter({self.lanes}, {to})")

    def name(self, word: str, call: str) -> str:
        name = f"{word}_{len(self.cells)}"
        self.cells.append(f"{name} = {call}")
        return name

    def loop(self, *body: str, barriers: bool = False) -> None:
        """Write a loop over lanes."""
        inner = ["    lane = lane_of(problem, w, l)", *("    " + text for text in body)]
        lines = [f"for l in range({self.lanes}):", *inner]
        lines = ["barrier()", *lines, "barrier()"] if barriers else lines
        self.lines += [" " * self.indent + text for text in lines]


# Spin, its rate and amplitude at the state ``y`` with derivative ``f``.
SEEN = (
    "lane.n1 = problem.spin(*y)",
    "lane.rate1 = problem.spin_rate(*(y + f))",
    "lane.amplitude = problem.amplitude(*(y + lane.probe))",
)


def span(first: int, count: int) -> str:
    """Return the text of rows one after another."""
    return f"[*range({first}, {first + count})]"


def write_attempt(
    tableau: Tableau, model: Model, lanes: int = LANES, *, volume: bool = False
) -> Callable[..., Any]:
    """Write and import the step of a method and a model, and return its function."""
    name = f"attempt_{tableau.name}_{model.name}_{lanes}{'_volume' * volume}"
    written = import_written(name, _Attempt(tableau, model, lanes, volume).source)
    return written.attempt  # type: ignore[no-any-return]
