"""The full dynamics in slopes against the paper's six variables, also at 60 digits."""

import itertools

import numpy as np
import pytest
import reference
from exact import exactly
from mpmath import mp
from samples import any_body, table_one

from rattlesweep.physics import full

EPS = np.finfo(float).eps
DIGITS = 60


mp_rhs = exactly(full.rhs)
mp_energy = exactly(full.energy)
mp_spin = exactly(full.spin)
mp_spin_rate = exactly(full.spin_rate)
mp_force = exactly(full.contact_force)
mp_oscillation = exactly(full.oscillation)


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


class Paper:
    """Eqs. 1, 10 and 11 for a body and a state, from `reference`."""

    def __init__(self, body, state):
        self.q = q = reference.constants([body], exact=True)[:, 0]
        # The constants of the code: inertia and B - 1.
        self.constants = [*q[:3], q[3] - 1, q[4], q[5] - 1]
        p, q_, *omega = (mp.mpf(x) for x in state)
        upright = -1 / mp.sqrt(1 + p * p + q_ * q_)
        self.u = (p * upright, q_ * upright, upright)
        self.omega = omega
        d = reference.rhs(np.array([*self.u, *omega]), q)
        self.du = d[:3]
        self.domega = d[3:]
        self.r, self.dr = reference.contact(self.u, self.du, q)
        # p = u_x/u_z, q = u_y/u_z
        slopes = [
            (self.du[i] - x * self.du[2]) / upright for i, x in enumerate((p, q_))
        ]
        self.rates = [*slopes, *self.domega]

    def energy(self):
        v = reference.cross(self.r, self.omega)
        w = self.omega
        inertia = [i * x for i, x in zip(self.q[:3], w, strict=True)]
        return (dot(v, v) + dot(w, inertia)) / 2 - dot(self.r, self.u) - 1

    def force(self):
        w = self.omega
        r = self.r
        cross = reference.cross
        f = reference.add(
            cross(self.dr, w), cross(r, self.domega), cross(w, cross(r, w)), self.u
        )
        along = dot(f, self.u)
        return along, mp.norm([x - along * y for x, y in zip(f, self.u, strict=True)])


def states(size, seed):
    """States with slopes and horizontal rates from 1e-8 to 1, and spins up to 5."""
    rng = np.random.default_rng(seed)
    for _ in range(size):
        slope, rate = 10 ** rng.uniform(-8, 0, 2)
        yield np.concatenate(
            [
                slope * rng.normal(size=2),
                rate * rng.normal(size=2),
                rng.uniform(-5, 5, 1),
            ]
        )


BODIES = [*any_body(30, 11).T.tolist(), *table_one(30, 11).T.tolist()]
CASES = list(zip(BODIES, states(60, 12), strict=True))

# theta and phi at the ends of their ranges, slopes from 1e-150 to steep, with and
# without spin.
EXTREMES = [
    (
        (*inertia, *surface),
        np.array([0.3 * slope, -1.1 * slope, 0.7 * rate, 0.9 * rate, n]),
    )
    for inertia in [(13.04, 1.522, 12.28), (1.3 + 3e-9, 1.3, 0.5)]
    for surface in itertools.product(
        (0.7, 1 - 1e-9), (0.05, 1e-4), (-1e-6, -0.03, -1.2)
    )
    for slope, rate, n in [
        (1e-150, 1e-150, -0.2),
        (1e-150, 1e-2, 0.2),
        (1e-2, 1e-150, 1e-150),
        (1e-8, 1e-6, 3.0),
        (0.2, 0.7, -40.0),
    ]
]


@pytest.mark.parametrize(
    "cases", [CASES[::2], EXTREMES[::3]], ids=["random", "extreme"]
)
def test_formulas_are_the_papers(cases):
    """At 60 digits the compiled formulas and the paper's six variables agree to 50."""
    for parameters, state in cases:
        with mp.workdps(3 * DIGITS):  # enough for the potential of a slope of 1e-150
            paper = Paper(parameters, state)
            at = tuple(mp.mpf(float(x)) for x in state)
            body = tuple(paper.constants)
            small = mp.mpf(10) ** -50
            for got, wanted in zip(mp_rhs(at, body), paper.rates, strict=True):
                assert abs(got - wanted) <= small * abs(wanted)
            spin = dot(paper.u, paper.omega)
            assert abs(mp_spin(at) / spin - 1) < small
            rate = dot(paper.u, paper.domega)
            got = mp_spin_rate(at, (0, 0, *paper.domega))
            assert abs(got - rate) <= small * abs(rate)
            rates = mp_rhs(at, body)
            normal, square = mp_force(at, rates, body)
            tangential = mp.sqrt(square)
            normal_p, tangential_p = paper.force()
            assert abs(normal - normal_p) <= small * (1 + abs(normal_p))
            assert abs(tangential - tangential_p) <= small * (abs(tangential_p) + small)
        with mp.workdps(6 * DIGITS):
            paper = Paper(parameters, state)
            body = tuple(paper.constants)
            energy = paper.energy()
            assert abs(mp_energy(at, body) - energy) <= small * energy


def errors(parameters, state):
    """Relative errors of the rates."""
    got = full.rhs(tuple(state), tuple(full.constants(*parameters)))
    with mp.workdps(DIGITS):
        wanted = Paper(parameters, state).rates
        pairs = zip(got, wanted, strict=True)
        return [float(abs(mp.mpf(g) - w) / abs(w)) for g, w in pairs]


def test_relative_accuracy_in_the_extremes():
    """Every component is right to a few dozen units in its own last place."""
    body = (13.04, 1.522, 12.28, 1 - 1e-9, 1e-4, -0.03)
    # At 1e-150 the spin's rate, of second order, is near the smallest double.
    for slope in (1e-5, 1e-75, 1e-150):
        for n in (0.1, -0.1, 3.0):
            state = np.array([0.3 * slope, -1.1 * slope, 0.7 * slope, 0.9 * slope, -n])
            assert max(errors(body, state)) < 100 * EPS, (slope, n)


def test_mirrored_bodies_move_in_mirror_images():
    """The x-z plane reflects u to (u_x, -u_y, u_z), omega to (-w_x, w_y, -w_z)."""
    image = np.array([1, -1, -1, 1, -1])
    for parameters, state in CASES:
        body = tuple(full.constants(*parameters))
        mirrored = tuple(full.constants(*parameters[:5], -parameters[5]))
        assert not np.array_equal(body, mirrored)
        state = tuple(state)
        reflected = tuple(image * state)
        rates = full.rhs(state, body)
        turned = tuple(image * rates)
        assert full.rhs(reflected, mirrored) == turned
        assert full.energy(reflected, mirrored) == full.energy(state, body)
        assert full.spin(reflected) == -full.spin(state)
        force = full.contact_force(state, rates, body)
        assert full.contact_force(reflected, turned, mirrored) == force
        # Without the reflection the rates differ.
        assert full.rhs(state, mirrored) != rates
