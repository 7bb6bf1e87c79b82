"""The vectorised step: source generated from a tableau and a model.

One call of the generated function tries one step on every lane (:data:`SUBSTEPS` equal ones for
a method without error control).  All arrays are rows of one
flat workspace, each row as long as there are lanes, and every stage is one loop over lanes that
loads its combination of earlier stages, calls the scalar right-hand side and stores ``f``.  With
the coefficients and the offsets as constants in the source, LLVM drops the zeros, keeps the
stage in registers and vectorises each loop; one workspace instead of many arrays
lets it prove that rows do not overlap.

A tangent has loops of its own, behind those of the state, and barriers between.  Else LLVM would
share products between the two, fuse other sums with them, and the state would come out with other
last bits than without a tangent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from numba import njit

from rattlesweep.integrate.lanes.atomics import barrier, widest_vectors
from rattlesweep.integrate.lanes.cells import INNER, Sum, cells, gather, scatter
from rattlesweep.integrate.lanes.lane import LANES, Layout, lane_of
from rattlesweep.physics.full import FASTMATH

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rattlesweep.integrate.model import Model
    from rattlesweep.integrate.tableau import Row, Tableau

# Steps of a fixed-step method between two looks at the lanes: the looks then cost little.
SUBSTEPS = 8


class Attempt:
    """Writes ``attempt(w, scale)``: one step tried on every lane.

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
        The function's text.
    names : dict
        What it sees as globals.
    """

    def __init__(self, tableau: Tableau, model: Model, lanes: int = LANES) -> None:
        self.tableau, self.model, self.lanes = tableau, model, lanes
        self.at = Layout.of(model)
        self.n = model.n_state
        self.names: dict[str, Any] = {
            "rhs": model.rhs,
            "carried_start": model.carried and model.carried.start,
            "carried_rhs": model.carried and model.carried.rhs,
            "spin": model.spin,
            "spin_rate": model.spin_rate,
            "amplitude": model.amplitude,
            "error": model.error,
            "tangent_rate": model.tangent and model.tangent.rate,
            "transverse": model.tangent and model.tangent.transverse,
            "barrier": barrier,
            "widest_vectors": widest_vectors,
            "lane_of": lane_of(self.at, lanes),
            "__name__": __name__,
        }
        self._lines = ["def attempt(w, scale):"]
        self._indent = 4
        self._line("widest_vectors()")
        at = self.at
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
        self.source = "\n".join(self._lines) + "\n"

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
        self.end(y, share)
        if self.model.tangent:
            self.tangent_end(v, share)

    def stage(self, i: int, y: int, share: float) -> None:
        """Stage ``i`` of a step from rows ``y``."""
        sums = self._sums(self.tableau.a[i], self._stages, y, share)
        to, rhs = self._rows(self._stages[i]), "rhs"
        if self.model.carried:
            count, (start, *behind) = self.model.carried.n, self._carried
            sums += self._sums(self.tableau.a[i], behind, start, share, count)
            to, rhs = [*to, *range(behind[i], behind[i] + count)], "carried_rhs"
        given = self._gather("given", sums, behind=self._constants())
        put = self._scatter("stage", to)
        body = [f"q = {given}(w, l)", f"f = {rhs}(*q)", f"{put}(w, l, f)"]
        if self.model.tangent:
            # For the tangent's stage, in a loop of its own.
            body += [f"lane.ys = q[:{self.n}]", "lane.fs = f"]
        self._loop(*body)

    def end(self, y: int, share: float) -> None:
        """State and derivative at the end of the step and, if it ends here, what is seen there."""
        sums = self._sums(self.tableau.b, self._stages, y, share)
        given = self._gather("given", sums, behind=self._constants())
        body = [f"q = {given}(w, l)", "f = rhs(*q)", f"y = q[:{self.n}]"]
        body += ["lane.y1 = y", "lane.f1 = f"]
        self._loop(*body, *(self._seen() if self.tableau.adaptive else []))

    def carried_start(self, y: int) -> None:
        """What is carried, and its derivative, where a step from rows ``y`` starts."""
        assert self.model.carried is not None
        n, stages, count = self.n, self.tableau.stages, self.model.carried.n
        # Behind the stages: its start, and its derivative there and in the other stages.
        first = self.at.stages + (stages - 1) * n
        self._carried = [first + i * count for i in range(stages + 1)]
        given = self._gather("given", cells(y, n), behind=self._constants())
        put = self._scatter("start", range(first, first + 2 * count))
        # Of the derivatives LLVM works out those behind alone.
        self._loop(
            f"q = {given}(w, l)",
            "x = carried_start(*q)",
            f"{put}(w, l, x + carried_rhs(*(q[:{n}] + x + q[{n}:]))[{n}:])",
        )

    def outcome(self) -> None:
        """What is seen at the end of a step without error control."""
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
            sums = self._sums(row, rows)
            given = self._gather("error", sums + cells(at.y, self.n), behind=self._constants())
            body.append(f"e{k}, size = error(*{given}(w, l))")
        # Hairer's blend of the fifth and third order estimates; both are squared here.
        blend = "e0 * (e0 / (e0 + 0.01 * e1 + 1e-300))" if len(self.tableau.errors) == 2 else "e0"
        self._loop(*body, f"lane.error = (scale * h * h) * ({blend} / size)")

    def tangent_stage(self, i: int, v: int, share: float) -> None:
        """Stage ``i`` of the tangent of a step from rows ``v``."""
        given = self._tangent_at(self.tableau.a[i], v, share, self.at.ys, self.at.fs)
        put = self._scatter("stage", self._rows(self._tangents[i]))
        self._loop(f"{put}(w, l, tangent_rate(*{given}(w, l)))", barriers=True)

    def tangent_end(self, v: int, share: float) -> None:
        """The tangent and its rate at the end of the step."""
        n = self.n
        given = self._tangent_at(self.tableau.b, v, share, self.at.y1, self.at.f1)
        # Only the transverse part goes on.  If it decays, what rounding leaves of the others
        # would soon hide it.
        self._loop(
            f"q = {given}(w, l)",
            "v = transverse(*q)",
            "lane.v1 = v",
            f"lane.g1 = tangent_rate(*(q[:{2 * n}] + v + q[{3 * n}:]))",
            barriers=True,
        )

    def _tangent_at(self, row: Row, v: int, share: float, y: int, f: int) -> str:
        """State, derivative, the tangent at ``row``, constants."""
        sums = self._sums(row, self._tangents, v, share)
        both = cells(y, self.n) + cells(f, self.n)
        return self._gather("tangent", both + sums, behind=self._constants())

    def _seen(self) -> list[str]:
        """Spin, its rate and amplitude at the state ``y`` with derivative ``f``."""
        return [
            "lane.n1 = spin(*y)",
            "lane.rate1 = spin_rate(*(y + f))",
            "lane.amplitude = amplitude(*(y + lane.probe))",
        ]

    def _sums(
        self,
        row: Row,
        stages: Sequence[int],
        start: int | None = None,
        share: float = 1.0,
        count: int | None = None,
    ) -> list[Sum]:
        """A row of the tableau times the stages; with ``start``, that plus ``share * h`` times."""
        factor = None if start is None else self.at.h
        return [
            Sum(
                None if start is None else start + c,
                tuple((value, stages[j] + c) for j, value in row.items()),
                factor,
                share,
            )
            for c in range(count or self.n)
        ]

    def _constants(self) -> list[Sum]:
        return cells(self.at.constants, self.model.n_constants)

    def _rows(self, first: int) -> list[int]:
        return list(range(first, first + self.n))

    def _name(self, word: str, function: Callable[..., Any]) -> str:
        name = f"{word}_{len(self.names)}"
        self.names[name] = function
        return name

    def _gather(self, word: str, values: Sequence[Sum], behind: Sequence[Sum] = ()) -> str:
        return self._name(word, gather(values, self.lanes, behind))

    def _scatter(self, word: str, rows: Sequence[int]) -> str:
        return self._name(word, scatter(rows, self.lanes))

    def _line(self, text: str) -> None:
        self._lines.append(" " * self._indent + text)

    def _loop(self, *body: str, barriers: bool = False) -> None:
        if barriers:
            self._line("barrier()")
        self._line(f"for l in range({self.lanes}):")
        self._line("    lane = lane_of(w, l)")
        for text in body:
            self._line("    " + text)
        if barriers:
            self._line("barrier()")


OPTIONS: dict[str, Any] = {"fastmath": FASTMATH} | INNER | {"no_cpython_wrapper": False}


def compile_attempt(tableau: Tableau, model: Model, lanes: int = LANES) -> Callable[..., Any]:
    """Compiled ``attempt`` of a method and a model (lazily, at its first use)."""
    compiled: Callable[..., Any] = njit(**OPTIONS)(write_attempt(tableau, model, lanes))
    return compiled


def write_attempt(tableau: Tableau, model: Model, lanes: int = LANES) -> Callable[..., Any]:
    """``attempt`` of a method and a model."""
    written = Attempt(tableau, model, lanes)
    # In the name of this file, beside whose kernels it is kept.
    exec(compile(written.source, __file__, "exec"), written.names)
    function: Callable[..., Any] = written.names["attempt"]
    # The name becomes part of the compiled symbol; two methods must not share one.
    function.__name__ = function.__qualname__ = f"attempt_{tableau.name}_{model.name}_{lanes}"
    return function
