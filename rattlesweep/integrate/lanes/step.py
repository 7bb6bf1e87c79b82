"""The vectorised step: the source of a module is generated from a tableau and a model.

The module's function ``attempt`` tries one step on every lane, or :data:`SUBSTEPS`
equal steps of a method without error control.  Each stage is one loop over lanes, which
loads its combination of earlier stages, calls the right-hand side and stores the
derivative.  Coefficients and rows are constants in the source, so that LLVM keeps a
stage in registers and vectorises each loop.

A tangent has its own loops between barriers.  LLVM would otherwise share products
between it and the state, and change the last bits of the state.
"""

from collections.abc import Callable, Sequence
from typing import Any

from rattlesweep.integrate.compile import import_written
from rattlesweep.integrate.lanes.lane import INNER, LANES, Layout
from rattlesweep.integrate.model import Model
from rattlesweep.integrate.tableau import Row, Tableau
from rattlesweep.physics.full import FASTMATH

SUBSTEPS = 8  # steps of a fixed-step method between two decisions on the lanes
OPTIONS: dict[str, Any] = {"fastmath": FASTMATH} | INNER | {"no_cpython_wrapper": False}
HEAD = '''"""One step of {tableau.name} for the model {model.name}, written by lanes.step."""

from rattlesweep.integrate.lanes.lane import (
    barrier, gather, lane_of, scatter, sums, widest_vectors,
)
'''


class _Attempt:
    """Writes the source of ``attempt(problem, w, scale)``, where ``scale = 1 /
    tol**2``.
    """

    def __init__(
        self, tableau: Tableau, model: Model, lanes: int, volume: bool
    ) -> None:
        self.tableau, self.model, self.lanes, self.volume = (
            tableau,
            model,
            lanes,
            volume,
        )
        self.at = at = Layout(model)
        # Definitions of the readers and writers of cells, and the lines of the
        # function.
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
            # The error is 0, or NaN if the state is not finite.
            total = " + ".join(f"f[{c}]" for c in range(model.n_state))
            error = f"lane.error = 0.0 * ({total})"
            self.loop("y = lane.y1", "f = lane.f1", *SEEN, error)
        head = HEAD.format(tableau=tableau, model=model)
        self.source = "\n".join([head, *self.cells, "", "", *self.lines, ""])

    def step(self, y: int, f: int, v: int, g: int, share: float) -> None:
        """Write a step of size ``share * h`` from rows ``y, f``, and ``v, g`` of the
        tangent.
        """
        tableau, model, at, n = self.tableau, self.model, self.at, self.model.n_state
        free = at.stages + (tableau.stages - 1) * n
        self.stages = stages = [f, *range(at.stages, free, n)]
        tangents = [g, *range(free, free + (tableau.stages - 1) * n, n)]
        # Rows of the carried functions: their start, and their derivative in each
        # stage.
        n_carried = model.n_carried
        start, *derivatives = (free + i * n_carried for i in range(tableau.stages + 1))
        if n_carried:
            given, put = (
                self.gather(span(y, n)),
                self.scatter(span(start, 2 * n_carried)),
            )
            # Only the last derivatives are used, and LLVM drops the computation of the
            # others.
            rate = f"problem.carried_rhs(*(q[:{n}] + x + q[{n}:]))[{n}:]"
            self.loop(
                f"q = {given}(w, l)",
                "x = problem.carried_start(*q)",
                f"{put}(w, l, x + {rate})",
            )
        for i in range(1, tableau.stages):
            values = self.sums(n, tableau.a[i], stages, y, share)
            to, rhs = span(stages[i], n), "rhs"
            if n_carried:
                values += " + " + self.sums(
                    n_carried, tableau.a[i], derivatives, start, share
                )
                to, rhs = f"{to} + {span(derivatives[i], n_carried)}", "carried_rhs"
            body = [f"q = {self.gather(values)}(w, l)", f"f = problem.{rhs}(*q)"]
            body.append(f"{self.scatter(to)}(w, l, f)")
            if model.rate:
                # Stored for the tangent's stage, which has its own loop.
                self.loop(*body, f"lane.ys = q[:{n}]", "lane.fs = f")
                given = self.tangent_at(tableau.a[i], tangents, v, share, at.ys, at.fs)
                put = self.scatter(span(tangents[i], n))
                self.loop(f"{put}(w, l, problem.rate(*{given}(w, l)))", barriers=True)
            else:
                self.loop(*body)
        if self.volume:
            # The weighted sum over the stages for the phase volume, on which no stage
            # depends.
            for i, weight in tableau.b.items():
                values = (
                    self.sums(n, tableau.a[i], stages, y, share) if i else span(y, n)
                )
                rate = f"problem.volume(*{self.gather(values)}(w, l))"
                self.loop(
                    f"lane.volume_rate1 += {share * weight} * {rate}", barriers=True
                )
        given = self.gather(self.sums(n, tableau.b, stages, y, share))
        body = [f"q = {given}(w, l)", "f = problem.rhs(*q)", f"y = q[:{n}]"]
        self.loop(
            *body, "lane.y1 = y", "lane.f1 = f", *(SEEN if tableau.adaptive else ())
        )
        if model.rate:
            given = self.tangent_at(tableau.b, tangents, v, share, at.y1, at.f1)
            # Only the transverse part is kept: where it decays, rounding errors in the
            # other directions would soon hide it.
            rate = f"problem.rate(*(q[:{2 * n}] + v + q[{3 * n}:]))"
            self.loop(
                f"q = {given}(w, l)",
                "v = problem.transverse(*q)",
                "lane.v1 = v",
                f"lane.g1 = {rate}",
                barriers=True,
            )

    def errors(self) -> None:
        """Write the computation of the squared error, in units of the tolerance."""
        n, body = self.model.n_state, ["h = lane.h"]
        for k, row in enumerate(self.tableau.errors):
            values = f"{self.sums(n, row, [*self.stages, self.at.f1])} + {span(self.at.y, n)}"
            body.append(f"e{k}, size = problem.error(*{self.gather(values)}(w, l))")
        # Hairer's blend of the estimates of fifth and third order (dop853.f); both are
        # squared.
        blend = (
            "e0 * (e0 / (e0 + 0.01 * e1 + 1e-300))"
            if len(self.tableau.errors) == 2
            else "e0"
        )
        self.loop(*body, f"lane.error = (scale * h * h) * ({blend} / size)")

    def tangent_at(
        self, row: Row, tangents: Sequence[int], v: int, share: float, y: int, f: int
    ) -> str:
        """Return a reader of ``y, f``, the tangent at a row of the tableau, and the
        constants.
        """
        n = self.model.n_state
        tangent = self.sums(n, row, tangents, v, share)
        return self.gather(f"{span(y, n)} + {span(f, n)} + {tangent}")

    def sums(
        self, count: int, row: Row, stages: Sequence[int], *from_and_share: float
    ) -> str:
        """Return the sum of a row of the tableau over stages, or ``start + share * h``
        times it.
        """
        terms = {stages[j]: value for j, value in row.items()}
        if not from_and_share:
            return f"sums({count}, {terms})"
        start, share = from_and_share
        return f"sums({count}, {terms}, {start}, {self.at.h}, {share})"

    def gather(self, values: str) -> str:
        """Return a reader of values, followed by the constants of the body."""
        constants = span(self.at.constants, self.model.n_constants)
        return self.name("given", f"gather({self.lanes}, {values}, {constants})")

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


# Spin, its rate and the amplitude in the state ``y`` with derivative ``f``.
SEEN = (
    "lane.n1 = problem.spin(*y)",
    "lane.rate1 = problem.spin_rate(*(y + f))",
    "lane.amplitude = problem.amplitude(*(y + lane.probe))",
)


def span(first: int, count: int) -> str:
    """Return the source of a list of consecutive rows."""
    return f"[*range({first}, {first + count})]"


def write_attempt(
    tableau: Tableau, model: Model, lanes: int = LANES, *, volume: bool = False
) -> Callable[..., Any]:
    """Write and import the module of a method and a model, and return ``attempt``."""
    name = f"attempt_{tableau.name}_{model.name}_{lanes}{'_volume' * volume}"
    written = import_written(name, _Attempt(tableau, model, lanes, volume).source)
    return written.attempt  # type: ignore[no-any-return]
