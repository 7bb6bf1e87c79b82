"""The step of bodies that slip: implicit in the friction.

The friction lets the velocity of the contact point decay at a rate ``k`` that may be a
million times that of the oscillation.  The step is that of the Radau IIA method of
`step.radau`, of order 9.  :data:`SWEEPS` sweeps over its stages solve its equations:

1. The derivatives at all stages follow from the states there.
2. The velocities follow from the derivatives.  They are implicit in the friction
   (`physics.friction.slip.stiffness`): as this is linear, two slips at right angles to
   each other obey five linear equations each.
3. The positions follow from these velocities.

So a sweep gains two orders, at the pace of the oscillation, whatever ``k`` is.  The
first one begins with the derivative at the start of the step.

The module's function ``attempt`` does what that of `step.explicit` does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.compiling.loading import import_written
from rattlesweep.kernel.method.collocation import STAGES
from rattlesweep.kernel.state.lane import Problem
from rattlesweep.kernel.step.explicit import HEADER, SEEN, loop_over_lanes, span
from rattlesweep.kernel.step.radau import METHOD

SWEEPS = 8
# Shares of squared estimates that count as the error.  The coefficients of rates say
# too much, and the sweeps leave less than the last one changed.  So errors at the
# default tolerance are about those of bodies that do not slip.
_SHARE = 0.1
LEFT = 0.01
N_STIFFNESS = 10  # numbers of `physics.friction.slip.stiffness`
_HEAD = '''"""An implicit step for {name}, from step.implicit."""

from rattlesweep.compiling.intrinsics import moved, widest_vectors
from rattlesweep.kernel.state.lane import gather, lane_of, scatter, sums
'''


def real_blocks(matrix: Floats) -> tuple[Floats, list[tuple[float, float]]]:
    """Return a basis in which a matrix has blocks, and the eigenvalues of the blocks.

    A block is a real eigenvalue, or ``[[a, b], [-b, a]]`` for a pair ``a +- i b``.
    """
    values, vectors = np.linalg.eig(matrix)
    columns = []
    blocks = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value.imag < 0:
            continue
        blocks.append((float(value.real), float(value.imag)))
        columns.append(vector.real)
        if value.imag > 0:
            columns.append(vector.imag)
    return np.transpose(columns), blocks


BASIS, BLOCKS = real_blocks(METHOD.integrals)
_INVERSE = np.linalg.inv(BASIS)


class _Attempt:
    """Writes what that of `step.explicit` does."""

    def __init__(self, problem: Problem) -> None:
        model = problem.model
        assert model is not None
        assert model.chart is not None
        self.model = model
        self.lanes = problem.lanes
        self.n = model.n_state
        # Components: of the position, of omega after it, and of the slip.
        self.n_place = len(model.chart.place) - 3
        self.slip = model.components.index("slip_1")
        at = problem.layout
        self.at = at
        # First rows of the states and the derivatives at the stages, of the rates of
        # the positions, and of the stiffness.
        self.states = at.stages
        self.rates = self.states + STAGES * self.n
        self.moving = self.rates + STAGES * self.n
        self.stiffness = self.moving + STAGES * self.n_place
        self.cells: list[str] = []
        self.lines = [HEADER, "    widest_vectors()"]
        self.begin()
        self.sweep(4)
        self.lines.append(f"    for _ in range({SWEEPS - 1}):")
        self.differentiate()
        self.sweep(8)
        self.finish()
        head = _HEAD.format(name=model.name)
        self.source = "\n".join([head, *self.cells, "", "", *self.lines, ""])

    def at_stage(self, first: int, stage: int, count: int) -> str:
        """Return the source of the rows of some numbers of a stage."""
        return span(first + stage * count, count)

    def summed(self, component: int, stage: int, first: int, count: int) -> str:
        """Return the source of a component at a stage, summed from rates there."""
        row = METHOD.integrals[stage]
        terms = {first + j * count + component: float(row[j]) for j in range(STAGES)}
        start = self.at.y + component
        return f"sums(1, {terms}, {start}, {self.at.h}, 1.0)"

    def begin(self) -> None:
        """Write the guess of the stages: that all goes on as it starts."""
        n = self.n
        rows = [self.at_stage(self.states, i, n) for i in range(STAGES)]
        rows += [self.at_stage(self.rates, i, n) for i in range(STAGES)]
        rows.append(span(self.stiffness, N_STIFFNESS))
        write = self.scatter(rows)
        states = " + ".join(["lane.y"] * STAGES + ["lane.f"] * STAGES)
        self.loop(
            "k1, k2, c, s, a, b = problem.model.stiffness(lane.y, lane.constants)",
            f"{write}(w, l, {states} + (k1, k2, c, s) + a + b)",
            indent=4,
        )

    def differentiate(self) -> None:
        """Write the derivatives at all stages."""
        for i in range(STAGES):
            read = self.gather([self.at_stage(self.states, i, self.n)])
            write = self.scatter([self.at_stage(self.rates, i, self.n)])
            self.loop(
                f"q = {read}(w, l)",
                f"{write}(w, l, problem.model.rhs(q[:{self.n}], q[{self.n}:]))",
                indent=8,
            )

    def sweep(self, indent: int) -> None:
        """Write what a sweep does with the derivatives."""
        self.settle(indent)
        n = self.n
        places = self.n_place
        for i in range(STAGES):
            values = [
                self.summed(c, i, self.moving, places) for c in range(self.n_place)
            ]
            if i < STAGES - 1:
                read = self.gather(values, constants=False)
                write = self.scatter([span(self.states + i * n, places)])
                self.loop(f"{write}(w, l, {read}(w, l))", indent=indent)
                continue
            # The end of the step, and how much the sweep changes it.
            rest = span(self.states + i * n + places, n - places)
            read = self.gather([*values, rest])
            write = self.scatter([self.at_stage(self.states, i, n)])
            self.loop(
                f"q = {read}(w, l)",
                f"y = q[:{n}]",
                "change = moved(y, lane.y1, -1.0)",
                f"lane.error, _ = problem.model.error(change, y, q[{n}:])",
                "lane.y1 = y",
                f"{write}(w, l, y)",
                indent=indent,
            )

    def settle(self, indent: int) -> None:
        """Write the velocities at all stages, and what follows from rates alone.

        One loop solves for the slips.  For each stage another one then finds all that
        follows, and the rates of the position, which in a loop of their own LLVM would
        not vectorise.  In between, the slips lie in the rows of these rates.
        """
        n = self.n
        omega = range(self.n_place, self.n_place + 3)
        slip = range(self.slip, self.slip + 2)
        others = [c for c in range(self.n_place + 3, n) if c not in slip]
        directions = span(self.stiffness + 2, 2)
        values = [span(self.stiffness, 4), f"[{self.at.h}]"]
        for i in range(STAGES):
            values += self.slips(i)
        read = self.gather(values, constants=False)
        body = [f"q = {read}(w, l)", "k1, k2, c, s, h = q[:5]"]
        for i in range(STAGES):
            first = 5 + 4 * i
            body += [f"a = q[{first}:{first + 4}]", *lacking(i)]
        body += self.solved("1") + self.solved("2")
        found = ", ".join(f"d1{i}, d2{i}" for i in range(STAGES))
        places = self.n_place
        slips = [self.moving + i * places + j for i in range(STAGES) for j in range(2)]
        write = self.scatter([str(slips)])
        self.loop(*body, f"{write}(w, l, ({found}))", indent=indent)
        for i in range(STAGES):
            values = [directions, span(self.stiffness + 4, 6), *self.slips(i)]
            values.append(span(self.moving + i * places, 2))
            values += [self.summed(c, i, self.rates, n) for c in (*omega, *others)]
            values.append(span(self.states + i * n, places))
            read = self.gather(values)
            last = 17 + len(others)
            body = [
                f"q = {read}(w, l)",
                "c, s, a0, a1, a2, b0, b1, b2 = q[:8]",
                "a = q[8:12]",
                *lacking(i),
                "d1, d2 = q[12:14]",
                f"g1, g2 = r1{i} - d1, r2{i} - d2",
            ]
            body += [f"o{j} = q[{14 + j}] + (a{j} * g1 + b{j} * g2)" for j in range(3)]
            body += ["v1 = a[0] + (c * d1 - s * d2)", "v2 = a[1] + (s * d1 + c * d2)"]
            results = {c: f"o{j}" for j, c in enumerate(omega)}
            results |= {c: f"v{1 + j}" for j, c in enumerate(slip)}
            results |= {c: f"q[{17 + j}]" for j, c in enumerate(others)}
            places_at = {c: f"q[{last + c}]" for c in range(places)}
            state = ", ".join((places_at | results)[c] for c in range(n))
            body.append(f"place = problem.model.moving(({state}), q[{last + places}:])")
            rows = [self.states + i * n + c for c in results]
            write = self.scatter([str(rows), self.at_stage(self.moving, i, places)])
            changed = ", ".join(results.values())
            self.loop(*body, f"{write}(w, l, ({changed}) + place)", indent=indent)

    def slips(self, stage: int) -> list[str]:
        """Return the source of the slip at a stage, and of the one that rates make."""
        first = self.states + stage * self.n + self.slip
        sums = [self.summed(self.slip + j, stage, self.rates, self.n) for j in range(2)]
        return [span(first, 2), *sums]

    def solved(self, name: str) -> list[str]:
        """Return lines that solve ``(1 + h k A) d = r`` with the method's matrix A."""

        def product(row: Sequence[float], vector: str) -> str:
            return " + ".join(f"{float(x)!r} * {vector}{j}" for j, x in enumerate(row))

        lines = [f"z = h * k{name}"]
        lines += [f"u{i} = {product(_INVERSE[i], f'r{name}')}" for i in range(STAGES)]
        i = 0
        for real, imaginary in BLOCKS:
            lines.append(f"p = 1.0 + {real!r} * z")
            if imaginary == 0.0:
                lines.append(f"u{i} = u{i} / p")
                i += 1
                continue
            lines += [
                f"t = {imaginary!r} * z",
                "inverse = 1.0 / (p * p + t * t)",
                f"e = (p * u{i} - t * u{i + 1}) * inverse",
                f"u{i + 1} = (t * u{i} + p * u{i + 1}) * inverse",
                f"u{i} = e",
            ]
            i += 2
        lines += [f"d{name}{i} = {product(BASIS[i], 'u')}" for i in range(STAGES)]
        return lines

    def finish(self) -> None:
        """Write the squared error, and what is seen at the end of the step.

        If the coefficients of the derivative in Legendre's polynomials fall by ``rho``
        from one degree to the next, the error at the end of a step falls as ``rho^9``;
        this is ``rho^8``.
        """
        n = self.n
        body = ["y = lane.y1", "h = lane.h"]
        for name, degree in (("high", STAGES - 1), ("low", STAGES - 3)):
            weights = METHOD.spectrum[degree]
            terms = {self.rates + j * n: float(weights[j]) for j in range(STAGES)}
            read = self.gather([f"sums({n}, {terms})"])
            body += [
                f"q = {read}(w, l)",
                f"{name}, size = problem.model.error(q[:{n}], y, q[{n}:])",
            ]
        body += [
            "fall = high / (low + 1e-300)",
            f"error = {_SHARE} * h * h * (high * fall * fall) + {LEFT} * lane.error",
            "lane.error = scale * error / size",
            f"f = problem.model.rhs(y, q[{n}:])",
            "lane.f1 = f",
            *SEEN,
        ]
        self.loop(*body, indent=4)

    def gather(self, values: Sequence[str], *, constants: bool = True) -> str:
        """Return a reader of values, followed by the constants of the body."""
        of_body = span(self.at.constants, self.model.n_constants) if constants else "[]"
        return self.name(
            "read", f"gather({self.lanes}, {' + '.join(values)}, {of_body})"
        )

    def scatter(self, rows: Sequence[str]) -> str:
        """Return a writer to rows."""
        return self.name("write", f"scatter({self.lanes}, {' + '.join(rows)})")

    def name(self, kind: str, call: str) -> str:
        """Name the result of a call above the function."""
        name = f"{kind}_{len(self.cells)}"
        self.cells.append(f"{name} = {call}")
        return name

    def loop(self, *body: str, indent: int) -> None:
        """Write a loop over lanes."""
        lines = loop_over_lanes(self.lanes, body)
        self.lines += [" " * indent + line for line in lines]


def lacking(stage: int) -> list[str]:
    """Return lines for what the slip ``a[:2]`` lacks, along the two directions."""
    return [
        "x = a[2] - a[0]",
        "y = a[3] - a[1]",
        f"r1{stage} = c * x + s * y",
        f"r2{stage} = c * y - s * x",
    ]


def write_implicit(problem: Problem) -> Callable[..., None]:
    """Write and import the module of a model, and return ``attempt``."""
    written = import_written(f"implicit_{problem.name}", _Attempt(problem).source)
    return written.attempt  # type: ignore[no-any-return]
