"""One slide in 50 digits, by collocation with many stages.

Run ``python tests/helpers/exact_slide.py FILE``; it takes a few minutes.  The body
rolls from a given state until its foot slips, and slides until its foot holds.  Steps
are those of Radau's methods of order 2 s - 1, which `friction_oracle` takes with s = 3;
Newton's method runs in 50 digits with derivatives in double precision.
"""

import json
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import contact_mechanics as mechanics
import friction_oracle
import numpy as np
from contact_mechanics import LOG_SPEED, N_ROLLING, N_SLIDING, Body, Stone
from mpmath import findroot, lu_solve, matrix, mp, mpf
from numpy.polynomial.legendre import legroots

DIGITS = 50
GH = Body(13.04, 1.522, 12.28, 0.6429, 0.0360, -0.030019663134302467)
MU = 0.3
# Where the body is 19.5 units of time after a launch with n_i = 0.3: u and omega.
START = (
    -0.41509430339400105,
    -0.12299944682654132,
    -0.9014254574674186,
    -0.12612664693637018,
    -0.7470529170801267,
    -0.07285240463132055,
)


@dataclass(frozen=True)
class Tableau:
    """A collocation method: its nodes in (0, 1] and its matrix."""

    nodes: list
    weights: list


def radau(stages):
    """Return the method of Radau of order ``2 stages - 1``."""

    def polynomial(x):
        return mp.legendre(stages, 2 * x - 1) - mp.legendre(stages - 1, 2 * x - 1)

    near = legroots([0.0] * (stages - 1) + [-1.0, 1.0])
    with mp.workdps(3 * DIGITS):
        nodes = [findroot(polynomial, (1 + mpf(float(x))) / 2) for x in near[:-1]]
        nodes.append(mpf(1))
        powers = matrix(stages, stages)
        for i, node in enumerate(nodes):
            for k in range(stages):
                powers[k, i] = node**k
        weights = []
        for node in nodes:
            moments = matrix([node ** (k + 1) / (k + 1) for k in range(stages)])
            weights.append(list(lu_solve(powers, moments)))
    return Tableau([+node for node in nodes], [[+w for w in row] for row in weights])


def newton_matrix(double, guess, weights):
    """Return the matrix of Newton's method for the stages of a step."""
    size = len(guess[0])
    jacobians = []
    for stage in guess:
        state = np.array([float(value) for value in stage])
        columns = double(state[:, None] + 1e-40j * np.eye(size))
        rows = [np.broadcast_to(row, size) for row in columns]
        jacobians.append(np.array(rows).imag / 1e-40)
    blocks = weights[:, :, None, None] * np.array(jacobians)
    whole = blocks.transpose(0, 2, 1, 3).reshape(size * len(guess), -1)
    return np.eye(len(whole)) - whole


def step(tableau, exact, double, y, h):
    """Return the state a time h later.

    `exact` are the rates in many digits; `double` those of arrays of double precision.
    """
    size = len(y)
    stages = len(tableau.nodes)
    weights = np.array([[float(w) for w in row] for row in tableau.weights])
    slopes = exact(y)
    guess = [
        [y[k] + h * node * slopes[k] for k in range(size)] for node in tableau.nodes
    ]
    last = mp.inf
    for iteration in range(40):
        if iteration < 5:
            inverse = np.linalg.inv(newton_matrix(double, guess, float(h) * weights))
        rates = [exact(stage) for stage in guess]
        residual = [
            guess[i][k]
            - y[k]
            - h * sum(w * rates[j][k] for j, w in enumerate(tableau.weights[i]))
            for i in range(stages)
            for k in range(size)
        ]
        largest = max(abs(value) for value in residual)
        is_exact = largest < mpf(10) ** (4 - DIGITS)
        if is_exact or (largest >= last and largest < mpf(10) ** (22 - DIGITS)):
            return guess[-1]
        # The residual is scaled, since doubles cannot hold it beside the state.
        scaled = inverse @ np.array([float(value / largest) for value in residual])
        for i in range(stages):
            for k in range(size):
                guess[i][k] -= largest * mpf(float(scaled[size * i + k]))
        last = largest
    raise ArithmeticError(f"Newton's method stops at {mp.nstr(largest, 3)}")


def rolling(stone, y):
    """Return the rates of a state that rolls."""
    u = tuple(y[:3])
    omega = tuple(y[3:6])
    forces = mechanics.rolling_forces(stone, u, omega, 0)
    return mechanics.rolling_rates(stone, y, forces)


class Slider:
    """Follows one slide in many digits."""

    def __init__(self, body, mu, stages, steps):
        xi = mpf(body.xi)
        long = 1 / mpf(body.theta)
        short = 1 / mpf(body.phi)
        cosine = mp.cos(xi)
        sine = mp.sin(xi)
        self.stone = Stone(
            inertia=(mpf(body.alpha) - 1, mpf(body.beta) - 1, mpf(body.gamma)),
            radii=(
                cosine**2 * long + sine**2 * short,
                sine * cosine * (long - short),
                sine**2 * long + cosine**2 * short,
            ),
            mu=mpf(mu),
            sigma=mpf(0),
        )
        self.in_double = mechanics.stone_of(body, mu)
        self.tableau = radau(stages)
        self.steps = steps  # how many steps are taken in place of one

    def rolled(self, y, time):
        """Return a state that has rolled for a time, in steps of at most 0.05."""
        exact = partial(rolling, self.stone)
        double = partial(rolling, self.in_double)
        count = max(1, int(mp.ceil(abs(time) / mpf("0.05")))) * self.steps
        for _ in range(count):
            y = step(self.tableau, exact, double, y, time / count)
        return y

    def begin(self, y, guess):
        """Return when the foot slips, and the state a moment later, as it slides."""

        def grip(time):
            return mechanics.grip(self.stone, self.rolled(y, time), 1)

        begin = mp.findroot(grip, (guess, guess + mpf("1e-6")), tol=mpf(10) ** -60)
        y = self.rolled(y, begin)
        # The mean of the rates at the ends of the moment leaves an error of its third
        # power.
        moment = mpf("1e-9")
        y = self.rolled(y, moment)
        (_, s, _), *_ = friction_oracle.outgoing(self.in_double, list(map(float, y)), 1)
        s = self.direction(y, s)
        slides = self.slide_rates(s, y)
        rolls = rolling(self.stone, y)
        _, pull, _ = friction_oracle.leaving_forces(self.stone, y, 1, s)
        speed = moment * mechanics.dot(pull, s) / 2
        y = [
            value + moment * (a - b) / 2
            for value, a, b in zip(y, slides, rolls, strict=True)
        ]
        return begin, begin + moment, [*y, mechanics.spin(y), *s, mp.log(speed)]

    def slide_rates(self, s, y):
        """Return the rates of a foot that begins to slide."""
        forces, _, _ = friction_oracle.leaving_forces(self.stone, y, 1, s)
        return [*forces.contact.du, *forces.turn, mpf(0), mpf(0), mpf(0)]

    def direction(self, y, s):
        """Return the direction in which the pull has no part across."""
        u = tuple(y[:3])
        first = mechanics.cross(u, tuple(mpf(float(x)) for x in s))
        length = mp.sqrt(mechanics.dot(first, first))
        across = mechanics.times(1 / length, first)
        along = mechanics.cross(across, u)

        def turned(angle):
            return mechanics.plus(
                mechanics.times(mp.cos(angle), along),
                mechanics.times(mp.sin(angle), across),
            )

        def strays(angle):
            s = turned(angle)
            _, pull, _ = friction_oracle.leaving_forces(self.stone, y, 1, s)
            return mechanics.dot(pull, mechanics.cross(u, s))

        angle = mp.findroot(strays, (mpf(0), mpf("1e-9")), tol=mpf(10) ** -70)
        return turned(angle)

    def slid(self, t, y):
        """Return the end of a slide and the state there."""
        exact = partial(mechanics.rates_in_time, self.stone, exp=mp.exp)
        double = partial(mechanics.rates_in_time, self.in_double, exp=np.exp)
        begin = t - mpf("1e-9")
        quickest = y[LOG_SPEED]
        while y[LOG_SPEED] > quickest - 1:
            h = min((t - begin) / 4, mpf("0.02"))
            y, t = self.steps_of(exact, double, y, t, h)
            quickest = max(quickest, y[LOG_SPEED])

        def exact_slow(y):
            rates, speed = mechanics.sliding_rates(self.stone, y[:N_SLIDING], mp.exp)
            return [*rates, speed]

        def double_slow(y):
            rates, speed = mechanics.sliding_rates(
                self.in_double, y[:N_SLIDING], np.exp
            )
            return [*rates, speed]

        y = [*y, t]
        while y[LOG_SPEED] > -60:
            for _ in range(self.steps):
                y = step(self.tableau, exact_slow, double_slow, y, mpf(1) / self.steps)
        # What is left is a straight line.
        rates = exact_slow(y)
        rest = -1 / rates[LOG_SPEED]
        y = [value + rest * rate for value, rate in zip(y, rates, strict=True)]
        return y[N_SLIDING], y[:N_ROLLING]

    def steps_of(self, exact, double, y, t, h):
        for _ in range(self.steps):
            y = step(self.tableau, exact, double, y, h / self.steps)
        return y, t + h


NAMES = ("begin", "end", "u_x", "u_y", "u_z", "omega_x", "omega_y", "omega_z", "work")


def followed(stages, steps=1):
    """Return the numbers of the slide: begin, end, and state and work at the end."""
    slider = Slider(GH, MU, stages, steps)
    y = [mpf(value) for value in (*START, 0.0, 0.0, 0.0)]
    begin, t, y = slider.begin(y, mpf("0.1438"))
    end, y = slider.slid(t, y)
    return [begin, end, *y[:7]]


def main(path):
    mp.dps = DIGITS
    rough = followed(10)
    fine = followed(12)
    error = max(abs(a - b) for a, b in zip(rough, fine, strict=True))
    slide = {name: mp.nstr(value, 30) for name, value in zip(NAMES, fine, strict=True)}
    result = {
        "body": vars(GH),
        "mu": MU,
        "start": START,
        "slide": slide,
        "error": float(error),
    }
    path.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
