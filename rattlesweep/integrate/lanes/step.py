"""The vectorised step: a module generated from a tableau and a model.

One call of its function ``attempt`` tries one step on every lane (:data:`SUBSTEPS` equal ones for a
method without error control).  All arrays are rows of one flat workspace, each row as long as there
are lanes, and every stage is one loop over lanes that loads its combination of earlier stages,
calls the scalar right-hand side and stores ``f``.  With the coefficients and the offsets as
constants in the source, LLVM drops the zeros, keeps the stage in registers and vectorises each
loop; one workspace instead of many arrays lets it prove that rows do not overlap.

A tangent has loops of its own, behind those of the state, and barriers between.  Else LLVM would
share products between the two, fuse other sums with them, and the state would come out with other
last bits than without a tangent.

The module is written into the folder of the kernels, where it can be read and stepped through.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from numba import njit

from rattlesweep.integrate.compile import import_written
from rattlesweep.integrate.lanes.intrinsics import INNER
from rattlesweep.integrate.lanes.lane import LANES, Layout
from rattlesweep.physics.full import FASTMATH

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Row, Tableau

# Steps of a fixed-step method between two looks at the lanes: the looks then cost little.
SUBSTEPS = 8


HEAD = '''"""{title}.

Written by rattlesweep.integrate.lanes.step; numbers of rows are those of its workspace.
"""

from rattlesweep.integrate.lanes.intrinsics import barrier, widest_vectors
from rattlesweep.integrate.lanes.lane import gather, lane_of, rows, scatter, sums

'''


class Attempt:
    """Write ``attempt(problem, w, scale)``: one step tried on every lane.

    ``w`` is the flat workspace, ``scale`` is ``1 / tol**2``.  Each method of this class writes the
    loop over lanes of one part of the step.

    Parameters
    ----------
    tableau, model
        The method and the equations.
    lanes : int
        Row length of the workspace.

    Attributes
    ----------
    source : str
        The text of the module.
    """

    def __init__(
        self, tableau: Tableau, model: Model, lanes: int = LANES, *, volume: bool = False
    ) -> None:
        self.tableau, self.model, self.lanes, self.volume = tableau, model, lanes, volume
        self.at = Layout.of(model)
        self.n = model.n_state
        # Reads and writes of many cells, by name, and the lines of the function.
        self._cells: list[str] = []
        self._lines = ["def attempt(problem, w, scale):"]
        self._indent = 4
        self._line("widest_vectors()")
        at = self.at
        if volume:
            self._loop("lane.volume_rate1 = 0.0")
        if tableau.adaptive:
            self.step(at.y, at.f, at.v, at.g, 1.0)
            self.errors()
        else:
            self._loop("lane.y1 = lane.y", "lane.f1 = lane.f")
            if model.tangent:
                self._loop("lane.v1 = lane.v", "lane.g1 = lane.g")
            self._line(f"for _ in range({SUBSTEPS}):")
            self._indent = 8
            self.step(at.y1, at.f1, at.v1, at.g1, 1 / SUBSTEPS)
            self._indent = 4
            self.outcome()
        title = f"One step of {tableau.name} for the model {model.name} on {lanes} lanes"
        self.source = "\n".join([HEAD.format(title=title), *self._cells, "", "", *self._lines, ""])

    def step(self, y: int, f: int, v: int, g: int, share: float) -> None:
        """A step of ``share * h`` from rows ``y, f``, and of the tangent from ``v, g``."""
        n, stages = self.n, self.tableau.stages
        rows = [self.at.stages + i * n for i in range(2 * stages - 2)]
        self._stages = [f, *rows[: stages - 1]]
        self._tangents = [g, *rows[stages - 1 :]]
        if self.model.carried:
            self.carried_start(y)
        for i in range(1, stages):
            self.stage(i, y, share)
            if self.model.tangent:
                self.tangent_stage(i, v, share)
        if self.volume:
            self.volume_sum(y, share)
        self.end(y, share)
        if self.model.tangent:
            self.tangent_end(v, share)

    def stage(self, i: int, y: int, share: float) -> None:
        """Stage ``i`` of a step from rows ``y``."""
        values = self._sums(self.tableau.a[i], self._stages, y, share)
        to, rhs = self._rows(self._stages[i], self.n), "rhs"
        if self.model.carried:
            count, (start, *behind) = self.model.carried.n, self._carried
            values += " + " + self._sums(self.tableau.a[i], behind, start, share, count)
            to, rhs = f"{to} + {self._rows(behind[i], count)}", "carried_rhs"
        given = self._gather("given", values)
        put = self._scatter("put", to)
        body = [f"q = {given}(w, l)", f"f = problem.{rhs}(*q)", f"{put}(w, l, f)"]
        if self.model.tangent:
            # For the tangent's stage, in a loop of its own.
            body += [f"lane.ys = q[:{self.n}]", "lane.fs = f"]
        self._loop(*body)

    def end(self, y: int, share: float) -> None:
        """State and derivative at the end of the step and, if it ends here, what is seen there."""
        given = self._gather("given", self._sums(self.tableau.b, self._stages, y, share))
        body = [f"q = {given}(w, l)", "f = problem.rhs(*q)", f"y = q[:{self.n}]"]
        body += ["lane.y1 = y", "lane.f1 = f"]
        self._loop(*body, *(self._seen() if self.tableau.adaptive else []))

    def volume_sum(self, y: int, share: float) -> None:
        """Add the rate of phase volume in the stages of a step from rows ``y``, by their weights.

        The sum is that of the method for a variable beside the state, which no stage depends on.
        """
        for i, weight in self.tableau.b.items():
            values = self._sums(self.tableau.a[i], self._stages, y, share)
            given = self._gather("given", values if i else self._rows(y, self.n))
            rate = f"problem.volume(*{given}(w, l))"
            self._loop(f"lane.volume_rate1 += {share * weight} * {rate}", barriers=True)

    def carried_start(self, y: int) -> None:
        """Write what is carried, and its derivative, where a step from rows ``y`` starts."""
        assert self.model.carried is not None
        n, stages, count = self.n, self.tableau.stages, self.model.carried.n
        # Behind the stages: its start, and its derivative there and in the other stages.
        first = self.at.stages + (stages - 1) * n
        self._carried = [first + i * count for i in range(stages + 1)]
        given = self._gather("given", self._rows(y, n))
        put = self._scatter("put", self._rows(first, 2 * count))
        # Of the derivatives LLVM works out those behind alone.
        self._loop(
            f"q = {given}(w, l)",
            "x = problem.carried_start(*q)",
            f"{put}(w, l, x + problem.carried_rhs(*(q[:{n}] + x + q[{n}:]))[{n}:])",
        )

    def outcome(self) -> None:
        """Write what is seen at the end of a step without error control."""
        total = " + ".join(f"f[{c}]" for c in range(self.n))
        # Zero, or not a number where the step left the numbers.
        error = f"lane.error = 0.0 * ({total})"
        self._loop("y = lane.y1", "f = lane.f1", *self._seen(), error)

    def errors(self) -> None:
        """The squared error, in units of the tolerance."""
        at = self.at
        rows = [*self._stages, at.f1]
        body = ["h = lane.h"]
        for k, row in enumerate(self.tableau.errors):
            values = f"{self._sums(row, rows)} + {self._rows(at.y, self.n)}"
            given = self._gather("given", values)
            body.append(f"e{k}, size = problem.error(*{given}(w, l))")
        # Hairer's blend of the fifth and third order estimates; both are squared here.
        blend = "e0 * (e0 / (e0 + 0.01 * e1 + 1e-300))" if len(self.tableau.errors) == 2 else "e0"
        self._loop(*body, f"lane.error = (scale * h * h) * ({blend} / size)")

    def tangent_stage(self, i: int, v: int, share: float) -> None:
        """Stage ``i`` of the tangent of a step from rows ``v``."""
        given = self._tangent_at(self.tableau.a[i], v, share, self.at.ys, self.at.fs)
        put = self._scatter("put", self._rows(self._tangents[i], self.n))
        self._loop(f"{put}(w, l, problem.rate(*{given}(w, l)))", barriers=True)

    def tangent_end(self, v: int, share: float) -> None:
        """The tangent and its rate at the end of the step."""
        n = self.n
        given = self._tangent_at(self.tableau.b, v, share, self.at.y1, self.at.f1)
        # Only the transverse part goes on.  If it decays, what rounding leaves of the others
        # would soon hide it.
        self._loop(
            f"q = {given}(w, l)",
            "v = problem.transverse(*q)",
            "lane.v1 = v",
            f"lane.g1 = problem.rate(*(q[:{2 * n}] + v + q[{3 * n}:]))",
            barriers=True,
        )

    def _tangent_at(self, row: Row, v: int, share: float, y: int, f: int) -> str:
        """State, derivative, the tangent at ``row``, constants."""
        both = f"{self._rows(y, self.n)} + {self._rows(f, self.n)}"
        return self._gather("given", f"{both} + {self._sums(row, self._tangents, v, share)}")

    def _seen(self) -> list[str]:
        """Spin, its rate and amplitude at the state ``y`` with derivative ``f``."""
        return [
            "lane.n1 = problem.spin(*y)",
            "lane.rate1 = problem.spin_rate(*(y + f))",
            "lane.amplitude = problem.amplitude(*(y + lane.probe))",
        ]

    def _sums(
        self,
        row: Row,
        stages: Sequence[int],
        start: int | None = None,
        share: float = 1.0,
        count: int | None = None,
    ) -> str:
        """A row of the tableau times the stages; with ``start``, that plus ``share * h`` times."""
        terms = {stages[j]: value for j, value in row.items()}
        count = count or self.n
        if start is None:
            return f"sums({count}, {terms})"
        return f"sums({count}, {terms}, start={start}, factor={self.at.h}, share={share})"

    def _rows(self, first: int, count: int) -> str:
        return f"rows({first}, {count})"

    def _gather(self, word: str, values: str) -> str:
        """A function that reads values and, behind them, the body's constants."""
        constants = self._rows(self.at.constants, self.model.n_constants)
        return self._name(word, f"gather({self.lanes}, {values}, behind={constants})")

    def _scatter(self, word: str, to: str) -> str:
        return self._name(word, f"scatter({self.lanes}, {to})")

    def _name(self, word: str, call: str) -> str:
        name = f"{word}_{len(self._cells)}"
        self._cells.append(f"{name} = {call}")
        return name

    def _line(self, text: str) -> None:
        self._lines.append(" " * self._indent + text)

    def _loop(self, *body: str, barriers: bool = False) -> None:
        if barriers:
            self._line("barrier()")
        self._line(f"for l in range({self.lanes}):")
        self._line("    lane = lane_of(problem, w, l)")
        for text in body:
            self._line("    " + text)
        if barriers:
            self._line("barrier()")


OPTIONS: dict[str, Any] = {"fastmath": FASTMATH} | INNER | {"no_cpython_wrapper": False}


def write_attempt(
    tableau: Tableau, model: Model, lanes: int = LANES, *, volume: bool = False
) -> Callable[..., Any]:
    """Write and import the step of a method and a model, and return its function."""
    name = f"attempt_{tableau.name}_{model.name}_{lanes}{'_volume' * volume}"
    written = import_written(name, Attempt(tableau, model, lanes, volume=volume).source)
    function: Callable[..., Any] = written.attempt
    return function


def compile_attempt(tableau: Tableau, model: Model, lanes: int = LANES) -> Callable[..., Any]:
    """Return the step of a method and a model, to be compiled at its first call."""
    compiled: Callable[..., Any] = njit(**OPTIONS)(write_attempt(tableau, model, lanes))
    return compiled
