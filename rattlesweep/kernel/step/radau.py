"""Steps of slides side by side: the source of a module is generated from a model.

Lanes that slide are copied into racks of :data:`WIDTH`, whose loops vectorise as those
of `step.explicit` do.  In a rack, each lane solves the equations of its own step of a
Radau IIA method by its own number of iterations; its numbers stay as they are once
these are solved, until another lane takes its slot.  So they do not depend on the
lanes beside it.

The rates in a step are a polynomial, kept as coefficients of Legendre's polynomials: it
tells the error, and extrapolated it is a good guess of the next step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import config, njit

from rattlesweep.compiling.intrinsics import FUSED
from rattlesweep.compiling.loading import import_written
from rattlesweep.kernel.method.collocation import STAGES, radau
from rattlesweep.kernel.state.fields import N_SLIP, SLIP_ANGLE, SLIP_SPEED
from rattlesweep.kernel.state.lane import gather, scatter, sums
from rattlesweep.kernel.step.explicit import span
from rattlesweep.motion.model import Model
from rattlesweep.physics.full import TINY

METHOD = radau(STAGES)
INVERSE = np.linalg.inv(METHOD.integrals)
# Lanes in a rack, one or two vectors of the processor.
WIDTH = 1 if config.DISABLE_JIT else 8
# Of squared changes: they may fall by this less from one iteration to the next.
DECAY = 9.0
LARGEST_TURN = 0.5  # of the angle in an iteration
MAX_ITERATIONS = 25  # iterations of the equations of a step
# The same where a patch turns: Newton's method knows how its torque turns the direction
# of sliding, but not how the direction changes the spin.
MOST_OF_PATCH = 100
LEAST_GUESS = 1e-3  # of the speed at a stage, as a share of that at the start
HEAD = '''"""Steps of slides of the model {name}, from kernel.step.radau."""

from rattlesweep.compiling.intrinsics import chosen, moved, widest_vectors
from rattlesweep.kernel.state.fields import Slip
from rattlesweep.kernel.state.lane import gather, scatter, sums
from rattlesweep.kernel.step.sliding_motion import patch_rates, stage_rates
'''


Reader = Callable[..., tuple[float, ...]]


@dataclass(frozen=True)
class Rack:
    """Functions of a rack, and first rows of its numbers in a flat array ``z``.

    A row has ``width`` numbers, one of each lane.  Readers are called with ``z`` and
    the slot of a lane.
    """

    rows: int
    width: int
    count: int  # numbers in a state with slip
    h: int  # size of the step
    enough: int  # largest squared change of an iteration
    past: int  # coefficients of the rates of the last step, by degree
    past_h: int  # size of the last step
    offset: int  # share of the last step after which this one starts
    busy: int  # 1 until the equations are solved, then 0; -1 if they cannot be
    # State and slip at the stages, and constants: rows for all stages of each number.
    values: int
    growths: int  # rates of the speed at the stages
    lane: int  # 1 + index of the lane in a slot, 0 in a free one
    # load(z, slot, numbers): copy the step to be tried; its numbers are the state,
    # speed, angle and work, the constants with ``mu``, size, largest squared change of
    # an iteration, the rows from ``past_h`` on, and what marks a new step.
    load: Callable[..., None]
    predict: Callable[..., None]  # predict(problem, z): guess the stages of new steps
    iterate: Callable[..., int]  # iterate(problem, z): number of lanes not solved
    # At the end of the step.
    state: Reader
    slip: Reader
    rate: Reader
    rates: Reader  # all coefficients of the rates
    # third(rates): the coefficients from whose decay the error is estimated.
    third: Callable[..., tuple[float, ...]]
    third_slip: Callable[..., tuple[float, ...]]
    fourth: Callable[..., tuple[float, ...]]
    fifth: Callable[..., tuple[float, ...]]
    fifth_slip: Callable[..., tuple[float, ...]]
    forces: Reader  # normal forces at the stages, then margins


class _Writer:
    """Writes the functions of a rack, and assigns rows to its numbers.

    What differs between stages has rows for all of them, one after the other, so that
    one loop evaluates all stages of all lanes.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.n = model.n_state
        self.count = self.n + N_SLIP
        self.n_constants = model.n_constants + 1
        self.rows = 0
        self.values = self.take(self.count, STAGES)
        self.rates = self.take(self.count, STAGES)
        self.stiffness = self.take(1, STAGES)
        self.least = self.take(1, STAGES)  # what must be positive
        self.normal = self.take(1, STAGES)
        self.margin = self.take(1, STAGES)
        self.turns_patch = model.pivot is not None
        self.most = MOST_OF_PATCH if self.turns_patch else MAX_ITERATIONS
        if self.turns_patch:
            self.response = self.take(self.count, STAGES)
            self.ratio = self.take(1, STAGES)
            self.turning = self.take(1, STAGES)
            self.gain = self.take(1, STAGES)
            self.lag = self.take(1, STAGES)
        self.constants = self.take(self.n_constants, STAGES)
        self.busy = self.take(1, STAGES)
        self.start = self.take(self.count)
        self.h = self.take(1)
        self.enough = self.take(1)
        self.past_h = self.take(1)
        self.offset = self.take(1)
        self.past = [self.take(self.count) for _ in range(STAGES)]
        self.loaded = self.rows
        self.fresh = self.take(1)
        self.turns = self.take(STAGES)
        self.change = self.take(1)
        self.before = self.take(1)  # the change in the iteration before
        self.spent = self.take(1)
        self.lane = self.take(1)
        self.cells: list[str] = []
        self.lines: list[str] = []
        self.predict()
        self.iterate()
        self.split()
        head = HEAD.format(name=model.name)
        self.source = "\n".join([head, *self.cells, *self.lines, ""])

    def take(self, count: int, stages: int = 1) -> int:
        """Return the first of some rows that are free."""
        first = self.rows
        self.rows += count * stages
        return first

    def at(self, i: int, first: int, count: int = 1) -> list[int]:
        """Return the rows of stage ``i`` of some numbers."""
        return [first + c * STAGES + i for c in range(count)]

    def define(self, name: str) -> None:
        """Begin a function."""
        self.lines += ["", "", f"def {name}(problem, z):", "    widest_vectors()"]

    def loop(self, *body: str, width: int = WIDTH) -> None:
        """Write a loop over the lanes of the rack."""
        self.lines.append(f"    for l in range({width}):")
        self.lines += ["        " + line for line in body]

    def read(self, *values: object, width: int = WIDTH) -> str:
        """Name a reader of values above the functions, and return a call of it."""
        name = f"read_{len(self.cells)}"
        whole = " + ".join(map(str, values))
        self.cells.append(f"{name} = gather({width}, {whole}, [])")
        return f"{name}(z, l)"

    def write(self, numbers: str, *rows: object, width: int = WIDTH) -> str:
        """Name a writer to rows above the functions, and return a call of it."""
        name = f"write_{len(self.cells)}"
        whole = " + ".join(map(str, rows))
        self.cells.append(f"{name} = scatter({width}, {whole})")
        return f"{name}(z, l, {numbers})"

    def predict(self) -> None:
        """Write the guess of the stages: the polynomial of the step before goes on."""
        count = self.count
        self.define("predict")
        speed = self.n + SLIP_SPEED
        ends = count + 3
        for i, point in enumerate(METHOD.points):
            read = self.read(
                span(self.start, count),
                [self.h, self.past_h, self.offset],
                *(span(row, count) for row in self.past),
                [self.fresh],
                self.at(i, self.values, count),
            )
            old = ends + STAGES * count
            # Integrals of Legendre's polynomials from the start of this step.
            guess = [f"y = moved(q[:{count}], q[{ends}:{ends + count}], w)"]
            for k in range(1, STAGES):
                first = ends + k * count
                lower = f"p{k - 1}" if k > 1 else "1.0"
                guess += [
                    f"w = past_h * (p{k + 1} - {lower}) * {0.5 / (2 * k + 1)}",
                    f"y = moved(y, q[{first}:{first + count}], w)",
                ]
            polynomials = []
            for k in range(2, STAGES + 1):
                lower = f"p{k - 2}" if k > 2 else "1.0"
                two = f"{2 * k - 1} * p1 * p{k - 1} - {k - 1} * {lower}"
                polynomials.append(f"p{k} = ({two}) * {1 / k}")
            self.loop(
                f"q = {read}",
                f"h, past_h, offset = q[{count}:{ends}]",
                f"x = offset + {point} * h / past_h",
                "p1 = 2.0 * x - 1.0",
                *polynomials,
                "w = past_h * (x - offset)",
                *guess,
                f"speed = max(y[{speed}], {LEAST_GUESS} * q[{speed}])",
                f"y = y[:{speed}] + (speed,) + y[{speed + 1}:]",
                f"y = chosen(q[{old}] > 0.0, y, q[{old + 1}:])",
                self.write("y", self.at(i, self.values, count)),
            )
            if i:
                read = self.read(self.at(0, self.constants, self.n_constants))
                rows = self.at(i, self.constants, self.n_constants)
                self.loop(self.write(read, rows))
        self.loop(self.write("(0.0,)", [self.fresh]))

    def iterate(self) -> None:
        """Write an iteration: all rates, then the angles, then everything else."""
        self.define("iterate")
        self.evaluate()
        if self.turns_patch:
            self.respond()
        self.solve()
        for i in range(STAGES):
            self.update(i)
        self.lines.append("    busy = 0")
        stages = range(self.least, self.least + STAGES)
        numbers = [self.change, self.enough, self.before, self.spent, self.busy]
        read = self.read([*stages, *numbers])
        self.loop(
            f"q = {read}",
            f"change, enough, before, spent, was = q[{STAGES}:]",
            f"least = {nested('min', [f'q[{i}]' for i in range(STAGES)])}",
            # At most the change that the next iteration would make.
            f"next = {DECAY} * change * change / (before + {TINY})",
            "left = change if change < next else next",
            "state = 1.0 if left > enough else 0.0",
            "spent += 1.0",
            "possible = (least > 0.0) & (change < 1e300)",
            f"possible &= (state == 0.0) | (spent < {float(self.most)})",
            "state = state if possible else -1.0",
            "now = state if was > 0.0 else was",
            self.write(f"({'now, ' * STAGES})", span(self.busy, STAGES)),
            self.write("(change, spent)", [self.before, self.spent]),
            "busy += 1 if now > 0.0 else 0",
        )
        self.lines.append("    return busy")

    def evaluate(self) -> None:
        """Write the evaluation of the rates at all stages."""
        n = self.n
        count = self.count
        end = count + self.n_constants
        width = STAGES * WIDTH

        def wide(first: int, numbers: int) -> list[int]:
            return [first // STAGES + c for c in range(numbers)]

        # Rates, stiffness, least, normal and margin follow each other, and then what
        # `patch_rates` adds.
        rates = "patch_rates" if self.turns_patch else "stage_rates"
        further = count + 3 if self.turns_patch else 0
        results = wide(self.rates, count + 4 + further)
        read = self.read(
            wide(self.values, count),
            wide(self.constants, self.n_constants),
            wide(self.busy, 1),
            results,
            width=width,
        )
        self.loop(
            f"q = {read}",
            f"slip = Slip(q[{n}], q[{n + 1}], q[{n + 2}])",
            f"f = {rates}(problem.model, q[:{n}], slip, q[{count}:{end}])",
            f"f = chosen(q[{end}] > 0.0, f, q[{end + 1}:])",
            self.write("f", results, width=width),
            width=width,
        )

    def respond(self) -> None:
        """Write the correction of all rates by the torque of a patch that turns.

        This torque depends on the ratio of spin and speed, so near the begin of a slide
        from a rest of the spin, and near its end, the spin is stiff.  Its equations are
        solved by Newton's method, as those of the angle are, and the rates become what
        they are at the spins found.
        """
        count = self.count
        speed = self.n + SLIP_SPEED
        for i in range(STAGES):
            read = self.read(
                self.integrated(i),
                self.at(i, self.values, count),
                [self.ratio + i],
            )
            self.loop(
                f"q = {read}",
                f"y = q[:{count}]",
                f"before = q[{count}:{2 * count}]",
                "spin = problem.model.spin",
                f"turning = spin(y[:{self.n}]) - spin(before[:{self.n}])",
                f"gain = y[{speed}] - before[{speed}]",
                self.write(f"(turning - q[{2 * count}] * gain,)", [self.lag + i]),
            )
        stages = range(STAGES)
        read = self.read(
            [self.h],
            span(self.lag, STAGES),
            span(self.ratio, STAGES),
            span(self.turning, STAGES),
            span(self.gain, STAGES),
        )
        body = [f"q = {read}", "h = q[0]"]
        body += [f"t{i} = q[{1 + i}]" for i in stages]
        body += [f"ratio{i} = q[{1 + STAGES + i}]" for i in stages]
        body += [f"turning{i} = q[{1 + 2 * STAGES + i}]" for i in stages]
        body += [f"gain{i} = q[{1 + 3 * STAGES + i}]" for i in stages]
        matrix = []
        for i in stages:
            settling = [f"(turning{j} - ratio{i} * gain{j})" for j in stages]
            row = [f"-h * {METHOD.integrals[i, j]} * {settling[j]}" for j in stages]
            row[i] = f"1.0 {row[i].replace('-', '- ', 1)}"
            matrix.append(row)
        body += eliminated(matrix)
        found = ", ".join(f"t{k}" for k in stages)
        self.loop(*body, self.write(f"({found})", span(self.lag, STAGES)))
        wide = [self.rates // STAGES + c for c in range(count)]
        read = self.read(
            wide,
            [self.response // STAGES + c for c in range(count)],
            [self.lag // STAGES, self.busy // STAGES],
            width=STAGES * WIDTH,
        )
        self.loop(
            f"q = {read}",
            f"f = q[:{count}]",
            f"changed = moved(f, q[{count}:{2 * count}], q[{2 * count}])",
            f"f = chosen(q[{2 * count + 1}] > 0.0, changed, f)",
            self.write("f", wide, width=STAGES * WIDTH),
            width=STAGES * WIDTH,
        )

    def solve(self) -> None:
        """Write the elimination that solves the equations for the angles."""
        angle = self.n + SLIP_ANGLE
        stages = range(STAGES)
        read = self.read(
            [self.start + angle, self.h],
            span(self.values + angle * STAGES, STAGES),
            span(self.rates + angle * STAGES, STAGES),
            span(self.stiffness, STAGES),
        )
        body = [f"q = {read}", "start, h = q[:2]"]
        for i in stages:
            lacking = (f"{INVERSE[i, j]} * (start - q[{2 + j}])" for j in stages)
            body.append(f"t{i} = h * q[{2 + STAGES + i}] + {' + '.join(lacking)}")
        matrix = [[str(INVERSE[i, j]) for j in stages] for i in stages]
        for i in stages:
            matrix[i][i] += f" - h * q[{2 + 2 * STAGES + i}]"
        body += eliminated(matrix)
        bound = (f"min({LARGEST_TURN}, max(-{LARGEST_TURN}, t{k}))" for k in stages)
        self.loop(*body, self.write(f"({', '.join(bound)})", span(self.turns, STAGES)))

    def integrated(self, i: int) -> str:
        """Return the source of the sums that are the new values at a stage."""
        terms = {self.rates + j: float(METHOD.integrals[i, j]) for j in range(STAGES)}
        return f"sums({self.count}, {terms}, {self.start}, {self.h}, 1.0, {STAGES})"

    def update(self, i: int) -> None:
        """Write the new values at a stage, and the squared change of velocities."""
        count = self.count
        read = self.read(
            self.integrated(i),
            self.at(i, self.values, count),
            [self.turns + i, self.busy, self.change],
        )
        angle = self.n + SLIP_ANGLE
        speed = self.n + SLIP_SPEED
        squares = [f"d[{c}] * d[{c}]" for c in range(count) if c != angle]
        body = [
            f"q = {read}",
            f"y = q[:{count}]",
            f"before = q[{count}:{2 * count}]",
            f"turn, busy, largest = q[{2 * count}:]",
            "d = moved(y, before, -1.0)",
            f"across = turn * before[{speed}]",
            f"change = across * across + {' + '.join(squares)}",
            f"y = y[:{angle}] + (before[{angle}] + turn,) + y[{angle + 1}:]",
        ]
        if i:
            # A change that is not a number stays.
            body.append("change = largest if largest > change else change")
        self.loop(
            *body,
            self.write("chosen(busy > 0.0, y, before)", self.at(i, self.values, count)),
            self.write("(change,)", [self.change]),
        )

    def split(self) -> None:
        """Write what takes apart the coefficients of the rates, by their degree."""
        n = self.n
        for k, name in ((2, "third"), (3, "fourth"), (4, "fifth")):
            first = k * self.count
            slip = first + n
            end = first + self.count
            for own, a, b in ((name, first, slip), (f"{name}_slip", slip, end)):
                self.lines += ["", "", f"def {own}(rates):"]
                self.lines.append(f"    return rates[{a}:{b}]")


def eliminated(matrix: list[list[str]]) -> list[str]:
    """Return the source that solves equations of all stages for ``t0, t1, ...``.

    These are their right sides before.  No pivot is searched: the inverse of the
    method's matrix with any positive numbers added to its diagonal has large ones, and
    so has the sum of one and this matrix with its columns times any positive numbers.
    """
    stages = range(STAGES)
    body = [f"m{i}{j} = {matrix[i][j]}" for i in stages for j in stages]
    for k in stages:
        body.append(f"m{k}{k} = 1.0 / m{k}{k}")
        for i in range(k + 1, STAGES):
            body.append(f"s = m{i}{k} * m{k}{k}")
            body += [f"m{i}{j} -= s * m{k}{j}" for j in range(k + 1, STAGES)]
            body.append(f"t{i} -= s * t{k}")
    for k in reversed(stages):
        body += [f"t{k} -= m{k}{j} * t{j}" for j in range(k + 1, STAGES)]
        body.append(f"t{k} *= m{k}{k}")
    return body


def nested(function: str, values: list[str]) -> str:
    """Return the source of a function of two values applied to all of some."""
    *rest, last = values
    return f"{function}({nested(function, rest)}, {last})" if rest else last


def rack_of(model: Model) -> Rack:
    """Write and import the module of a model, and return its functions."""
    writer = _Writer(model)
    written = import_written(f"rack_{model.name}_{WIDTH}", writer.source)
    compiled: Any = njit(**FUSED)
    n = writer.n
    count = writer.count
    last = writer.at(STAGES - 1, writer.values, count)
    last_rates = writer.at(STAGES - 1, writer.rates, n)
    coefficients = [
        total
        for row in METHOD.spectrum
        for total in sums(
            count,
            {writer.rates + j: float(row[j]) for j in range(STAGES)},
            stride=STAGES,
        )
    ]
    constants = writer.at(0, writer.constants, writer.n_constants)
    begin = range(writer.start, writer.start + count)
    settings = range(writer.h, writer.loaded)
    new = [writer.fresh, *range(writer.busy, writer.busy + STAGES)]
    new += [writer.before, writer.spent]
    return Rack(
        rows=-(-writer.rows // STAGES) * STAGES,
        width=WIDTH,
        count=count,
        h=writer.h,
        enough=writer.enough,
        past=writer.past[0],
        past_h=writer.past_h,
        offset=writer.offset,
        busy=writer.busy,
        values=writer.values,
        growths=writer.rates + (n + SLIP_SPEED) * STAGES,
        lane=writer.lane,
        load=scatter(WIDTH, [*begin, *constants, *settings, *new]),
        predict=compiled(written.predict),
        iterate=compiled(written.iterate),
        state=gather(WIDTH, last[:n], []),
        slip=gather(WIDTH, last[n:], []),
        rate=gather(WIDTH, last_rates, []),
        rates=gather(WIDTH, coefficients, []),
        third=compiled(written.third),
        third_slip=compiled(written.third_slip),
        fourth=compiled(written.fourth),
        fifth=compiled(written.fifth),
        fifth_slip=compiled(written.fifth_slip),
        forces=_reader(writer.normal, 2 * STAGES),
    )


def _reader(first: int, count: int) -> Reader:
    """Return a reader of consecutive rows."""
    return gather(WIDTH, range(first, first + count), [])
