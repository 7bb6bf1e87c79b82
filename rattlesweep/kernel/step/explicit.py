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

from rattlesweep.compiling.intrinsics import FUSED
from rattlesweep.compiling.loading import import_written
from rattlesweep.kernel.method.tableau import Row, Tableau
from rattlesweep.kernel.state.fields import GROUP
from rattlesweep.kernel.state.lane import Problem

SUBSTEPS = 8  # steps of a fixed-step method between two decisions on the lanes
OPTIONS: dict[str, object] = FUSED | {"no_cpython_wrapper": False}
ATTEMPT_HEAD = '''"""A step of {tableau.name} for {model.name}, from step.explicit."""

from rattlesweep.compiling.intrinsics import barrier, widest_vectors
from rattlesweep.kernel.state.lane import gather, lane_of, scatter, sums
'''


HEADER = "def attempt(problem, w, scale, used):"


class _Attempt:
    """Writes ``attempt(problem, w, scale, used)``, where ``scale = 1 / tol**2``.

    The first ``used`` lanes are stepped, which are whole groups.
    """

    def __init__(self, tableau: Tableau, problem: Problem, volume: bool) -> None:
        model = problem.model
        assert model is not None
        self.tableau = tableau
        self.model = model
        self.lanes = problem.lanes
        self.volume = volume
        at = problem.layout
        self.at = at
        # Definitions of the readers and writers of cells, and the lines of the
        # function.
        self.cells: list[str] = []
        self.lines = [HEADER, "    widest_vectors()"]
        self.indent = 4
        if volume:
            self.loop("lane.volume_rate1 = 0.0")
        if tableau.adaptive:
            self.step(at.y, at.f, at.v, at.g, 1.0)
            self.errors()
        else:
            self.loop("lane.y1 = lane.y", "lane.f1 = lane.f")
            if model.n_tangents:
                self.loop("lane.v1 = lane.v", "lane.g1 = lane.g")
            self.lines.append(f"    for _ in range({SUBSTEPS}):")
            self.indent = 8
            self.step(at.y1, at.f1, at.v1, at.g1, 1 / SUBSTEPS)
            self.indent = 4
            # The error is 0, or NaN if the state is not finite.
            total = " + ".join(f"f[{c}]" for c in range(model.n_state))
            error = f"lane.error = 0.0 * ({total})"
            self.loop("y = lane.y1", "f = lane.f1", *SEEN, error)
        head = ATTEMPT_HEAD.format(tableau=tableau, model=model)
        self.source = "\n".join([head, *self.cells, "", "", *self.lines, ""])

    def step(self, y: int, f: int, v: int, g: int, share: float) -> None:
        """Write a step of size ``share * h`` from rows ``y``, ``f``, ``v``, ``g``."""
        tableau = self.tableau
        model = self.model
        n = model.n_state
        # First rows of the derivatives in the stages: of the state, and of the tangent.
        wide = model.n_tangents * n
        free = self.at.stages + (tableau.stages - 1) * n
        stages = [f, *range(self.at.stages, free, n)]
        tangents = [g, *(free + i * wide for i in range(tableau.stages - 1))]
        self.stages = stages
        # First rows of the carried functions: at the start, then of their derivatives.
        n_carried = model.n_carried
        carried = free
        rates = [free + (i + 1) * n_carried for i in range(tableau.stages)]
        if n_carried:
            self.start_carried(y, carried)
        for i in range(1, tableau.stages):
            values = self.sums(n, tableau.a[i], stages, y, share)
            rows = span(stages[i], n)
            rhs = f"rhs(q[:{n}], q[{n}:])"
            if n_carried:
                more = self.sums(n_carried, tableau.a[i], rates, carried, share)
                values += f" + {more}"
                rows += f" + {span(rates[i], n_carried)}"
                end = n + n_carried
                rhs = f"carried_rhs(q[:{n}], q[{n}:{end}], q[{end}:])"
            body = [
                f"q = {self.gather(values)}(w, l)",
                f"f = problem.model.{rhs}",
                f"{self.scatter(rows)}(w, l, f)",
            ]
            if not model.n_tangents:
                self.loop(*body)
                continue
            # Stored for the tangent's stage, which has its own loop.
            self.loop(*body, f"lane.ys = q[:{n}]", "lane.fs = f")
            at_stage = self.at.ys, self.at.fs
            read = self.tangent_at(tableau.a[i], tangents, v, share, *at_stage)
            write = self.scatter(span(tangents[i], wide))
            self.loop(
                *read,
                f"{write}(w, l, problem.model.rate(y, f, v, q))",
                barriers=True,
            )
        if self.volume:
            self.add_volume(y, share)
        body = [
            f"q = {self.gather(self.sums(n, tableau.b, stages, y, share))}(w, l)",
            f"y = q[:{n}]",
            f"f = problem.model.rhs(y, q[{n}:])",
            "lane.y1 = y",
            "lane.f1 = f",
        ]
        self.loop(*body, *(SEEN if tableau.adaptive else ()))
        if model.n_tangents:
            at_end = self.at.y1, self.at.f1
            read = self.tangent_at(tableau.b, tangents, v, share, *at_end)
            # Only the transverse part is kept: where it decays, rounding errors in the
            # other directions would soon hide it.
            self.loop(
                *read,
                "v = problem.model.transverse(y, f, v, q)",
                "lane.v1 = v",
                "lane.g1 = problem.model.rate(y, f, v, q)",
                barriers=True,
            )

    def start_carried(self, y: int, carried: int) -> None:
        """Write the computation of the carried functions at the start of the step."""
        n = self.model.n_state
        read = self.gather(span(y, n))
        write = self.scatter(span(carried, 2 * self.model.n_carried))
        # Only the last derivatives are used, and LLVM drops the computation of the
        # others.
        rate = f"problem.model.carried_rhs(q[:{n}], x, q[{n}:])[{n}:]"
        self.loop(
            f"q = {read}(w, l)",
            f"x = problem.model.carried_start(q[:{n}], q[{n}:])",
            f"{write}(w, l, x + {rate})",
        )

    def add_volume(self, y: int, share: float) -> None:
        """Write the sum over the stages for the phase volume."""
        n = self.model.n_state
        for i, weight in self.tableau.b.items():
            values = span(y, n)
            if i:
                values = self.sums(n, self.tableau.a[i], self.stages, y, share)
            read = self.gather(values)
            rate = f"problem.model.volume(q[:{n}], q[{n}:])"
            self.loop(
                f"q = {read}(w, l)",
                f"lane.volume_rate1 += {share * weight} * {rate}",
                barriers=True,
            )

    def errors(self) -> None:
        """Write the computation of the squared error, in units of the tolerance."""
        n = self.model.n_state
        body = ["h = lane.h"]
        for k, row in enumerate(self.tableau.errors):
            values = self.sums(n, row, [*self.stages, self.at.f1])
            read = self.gather(f"{values} + {span(self.at.y, n)}")
            body.append(f"q = {read}(w, l)")
            arguments = f"q[:{n}], q[{n}:{2 * n}], q[{2 * n}:]"
            body.append(f"e{k}, size = problem.model.error({arguments})")
        blend = "e0"
        if len(self.tableau.errors) == 2:
            # Hairer's blend of the estimates of fifth and third order (dop853.f); both
            # are squared.
            blend = "e0 * (e0 / (e0 + 0.01 * e1 + 1e-300))"
        self.loop(*body, f"lane.error = (scale * h * h) * ({blend} / size)")

    def tangent_at(
        self, row: Row, tangents: Sequence[int], v: int, share: float, y: int, f: int
    ) -> list[str]:
        """Return lines that read ``y, f``, a sum ``v`` of tangents, constants ``q``."""
        n = self.model.n_state
        end = (2 + self.model.n_tangents) * n
        tangent = self.sums(end - 2 * n, row, tangents, v, share)
        read = self.gather(f"{span(y, n)} + {span(f, n)} + {tangent}")
        return [
            f"cells = {read}(w, l)",
            f"y, f = cells[:{n}], cells[{n}:{2 * n}]",
            f"v, q = cells[{2 * n}:{end}], cells[{end}:]",
        ]

    def sums(
        self, count: int, row: Row, stages: Sequence[int], *from_and_share: float
    ) -> str:
        """Return the sum of a row of the tableau over stages.

        With ``start`` and ``share`` it is ``start + share * h`` times the sum.
        """
        terms = {stages[j]: value for j, value in row.items()}
        if not from_and_share:
            return f"sums({count}, {terms})"
        start, share = from_and_share
        return f"sums({count}, {terms}, {start}, {self.at.h}, {share})"

    def gather(self, values: str) -> str:
        """Return a reader of values, followed by the constants of the body."""
        constants = span(self.at.constants, self.model.n_constants)
        return self.name("read", f"gather({self.lanes}, {values}, {constants})")

    def scatter(self, rows: str) -> str:
        """Return a writer to rows."""
        return self.name("write", f"scatter({self.lanes}, {rows})")

    def name(self, kind: str, call: str) -> str:
        """Name the result of a call above the function."""
        name = f"{kind}_{len(self.cells)}"
        self.cells.append(f"{name} = {call}")
        return name

    def loop(self, *body: str, barriers: bool = False) -> None:
        """Write a loop over lanes."""
        lines = loop_over_lanes(self.lanes, body)
        if barriers:
            lines = ["barrier()", *lines, "barrier()"]
        self.lines += [" " * self.indent + line for line in lines]


# Spin, its rate and the amplitude in the state ``y`` with derivative ``f``.
SEEN = (
    "lane.n1 = problem.model.spin(y)",
    "lane.rate1 = problem.model.spin_rate(y, f)",
    "lane.amplitude = problem.model.amplitude(y, lane.probe)",
)


def loop_over_lanes(lanes: int, body: Sequence[str]) -> list[str]:
    """Return the lines of a loop over the lanes that are used.

    The inner loop has a known length, so that no remainder is left of its vectors.
    """
    group = min(GROUP, lanes)
    return [
        f"for first in range(0, used, {group}):",
        f"    for l in range(first, first + {group}):",
        "        lane = lane_of(problem, w, l)",
        *("        " + line for line in body),
    ]


def span(first: int, count: int) -> str:
    """Return the source of a list of consecutive rows."""
    return f"[*range({first}, {first + count})]"


def write_attempt(
    tableau: Tableau, problem: Problem, *, volume: bool = False
) -> Callable[..., None]:
    """Write and import the module of a method and a model, and return ``attempt``."""
    name = f"attempt_{tableau.name}_{problem.name}"
    if volume:
        name += "_volume"
    written = import_written(name, _Attempt(tableau, problem, volume).source)
    return written.attempt  # type: ignore[no-any-return]
