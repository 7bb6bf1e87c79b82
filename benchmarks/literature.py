"""Regimes that others report of the same model, and its Lyapunov exponents.

    python benchmarks/literature.py

prints all five Lyapunov exponents over the second half of long runs at published
parameters, in units of 1e-4 ``sqrt(g/a)``.

Parameters of the paraboloids: mass 1, g 100, height 1, radii of curvature 9 and 4,
moments of inertia (2, 6, 7) or (5, 6, 7), the angle delta between the axes of the
surface and of inertia, and an energy that includes ``m g h = 100`` at rest.  They are
those of the program "Numerical-Study" (CelticStoneC, CelticStonePython) at
github.com/KirillZaichikov/Numerical-Study, which starts from a launch of the program
"Chaos" of Izhevsk; that launch has the energy 752 that it names.  Of the papers we read
the abstracts, which name regimes without parameters.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from machine import ROOT, heading

import rattlesweep as rs

sys.path.insert(0, str(ROOT / "tests" / "helpers"))

from spectrum_oracle import body_of, contact

REST = 100.0  # m g h in their units
T_END = 200_000.0
TOL = 1e-11


@dataclass(frozen=True)
class Point:
    """A point of their parameters, a launch in our axes, and what is reported there."""

    inertia: tuple[float, float, float]
    delta: float
    energy: float
    omega: tuple[float, float, float]
    u: tuple[float, float, float]
    reported: str


SECOND = (2.0, 6.0, 7.0)
FIRST = (5.0, 6.0, 7.0)
GONCHENKO = "Gonchenko, Gonchenko and Kazakov (2013)"
BORISOV = "Borisov and others (2012)"
UNNAMED = "no regime named"

# Launches near the fixed point of the section come from a Newton iteration; the others
# are arbitrary.  `at_energy` scales the angular velocity.
POINTS = (
    Point(
        SECOND,
        0.485,
        745.0,
        (-1.023581, -1.206713, -0.256415),
        (0.290038, 0.165206, -0.942648),
        f"before the attractor below, {GONCHENKO}",
    ),
    Point(
        SECOND,
        0.485,
        748.4,
        (-1.022064, -1.196503, -0.268902),
        (0.290871, 0.164119, -0.942581),
        f"before the attractor below, {GONCHENKO}",
    ),
    Point(
        SECOND,
        0.485,
        752.0,
        (-1.021362, -1.188334, -0.279498),
        (0.291523, 0.163116, -0.942554),
        f"Lorenz-like attractor, {GONCHENKO}",
    ),
    Point(
        SECOND,
        0.485,
        752.0,
        (0.239443, -1.22271, 0.825371),
        (0.188817, -0.19839, -0.961764),
        f"strange attractor at high energies, {BORISOV}",
    ),
    Point(
        SECOND,
        0.485,
        600.0,
        (-0.180508, 0.055359, 0.060227),
        (-0.878687, -0.003239, -0.477387),
        f"strange attractor at high energies, {BORISOV}",
    ),
    Point(
        SECOND,
        0.485,
        300.0,
        (0.089464, 0.051936, 0.017579),
        (0.604299, -0.509466, -0.612591),
        f"quasi-conservative chaos at low energies, {BORISOV}",
    ),
    Point(
        FIRST,
        0.2,
        300.0,
        (-0.229192, 0.113084, 0.10425),
        (-0.480841, -0.286718, -0.828604),
        f"quasi-conservative chaos at low energies, {BORISOV}",
    ),
    Point(
        FIRST,
        0.2,
        470.0,
        (0.068148, -0.247828, -0.567678),
        (-0.569608, 0.193451, -0.798827),
        UNNAMED,
    ),
    Point(
        FIRST,
        0.2,
        555.0,
        (0.295057, -0.322344, 0.603986),
        (0.451727, -0.312926, -0.835476),
        UNNAMED,
    ),
    Point(
        FIRST,
        0.2,
        1380.0,
        (0.062251, -0.069949, -0.37061),
        (0.622188, 0.545042, -0.56197),
        UNNAMED,
    ),
)


def body_of_point(point: Point) -> rs.Rattleback:
    """Return the body in our units, with their axes 2, 1, -3 as x, y, z."""
    along, across, vertical = point.inertia
    return rs.Rattleback(across + 1, along + 1, vertical, 1 / 4, 1 / 9, -point.delta)


def at_energy(
    body: rs.Rattleback, omega: np.ndarray, u: np.ndarray, energy: float
) -> np.ndarray:
    """Return the angular velocity scaled so that the energy, 0 at rest, is `energy`."""
    matrices = body_of(body.alpha, body.beta, body.gamma, body.theta, body.phi, body.xi)
    r, _ = contact(u, matrices.radii)
    velocity = np.cross(r, omega)
    kinetic = 0.5 * (omega @ matrices.inertia @ omega + velocity @ velocity)
    return omega * np.sqrt((energy + r @ u + 1.0) / kinetic)


def main() -> None:
    """Print the table."""
    print(heading())
    print("| I | delta | E theirs | E ours | reported | exponents, 1e-4 | D | regime |")
    print("|---" * 8 + "|")
    for point in POINTS:
        body = body_of_point(point)
        energy = point.energy / REST - 1.0
        u = np.array(point.u) / np.linalg.norm(point.u)
        omega = at_energy(body, np.array(point.omega), u, energy)
        run = rs.simulate(
            body,
            omega=list(omega),
            u=list(u),
            t_end=T_END,
            tol=TOL,
            record=["spectrum"],
        )
        numbers = ", ".join(
            f"{1e4 * value:.1f}" for value in run.lyapunov_spectrum_late
        )
        print(
            f"| {point.inertia} | {point.delta} | {point.energy:g} | {energy:.4g} "
            f"| {point.reported} | {numbers} | {run.kaplan_yorke:.2f} | {run.regime} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
