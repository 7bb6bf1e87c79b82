"""The paper's claims about its theory (T1 to T7, S9), checked without any run.

What a claim says is computed a second way wherever the package itself uses the formula in question:
torque coefficients from their definition by eigenvectors, growth rates from the linearised full
dynamics, inertia of ellipsoids by slices.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.paper.claims.bodies import coefficient_claim, frequency_claim
from rattlesweep.paper.claims.claim import EXACT, Claim
from rattlesweep.paper.claims.ellipsoid import ellipsoids
from rattlesweep.paper.claims.spin import bondi, slow_spin
from rattlesweep.paper.data.sd import sd_bodies, wide_bodies
from rattlesweep.physics import theory
from rattlesweep.physics.body import Rattleback

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pyarrow as pa
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


def claims(figures: Mapping[str, Mapping[str, pa.Table]], samples: int = 2000) -> list[Claim]:
    """Rows of the claims table.

    Parameters
    ----------
    figures : mapping
        Tables of the figures that were made, by name; T4 needs ``fig2`` and T5 ``fig3``.
    samples : int
        Random bodies on which identities are tried.
    """
    rows = [garcia_hubbard(), identities(samples), limits(samples)]
    if "fig2" in figures:
        rows.append(frequency_claim(figures["fig2"], figures.get("fig3")))
    if "fig3" in figures:
        rows.append(coefficient_claim(figures["fig3"]))
    return [*rows, ellipsoids(samples), slow_spin(samples), bondi(samples)]


# --- T1 -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Printed:
    """A number as the paper prints it, and what it is here, in the same unit."""

    name: str
    value: float
    digits: int
    found: float

    @property
    def agrees(self) -> bool:
        """Whether the number found rounds to the one printed."""
        return round(self.found, self.digits) == self.value


def gh_figures(body: Rattleback) -> list[Printed]:
    """The paper's six figures of the body GH."""
    found = theory.modes(body.alpha, body.beta, body.theta, body.phi, body.xi)
    return [
        Printed("K_p", 0.553, 3, float(found.K_p)),
        Printed("K_r", 0.0967, 4, float(found.K_r)),
        Printed("omega_p", 1.44, 2, float(found.omega_p)),
        Printed("omega_r", 0.602, 3, float(found.omega_r)),
        Printed("psi_p", -17, 0, float(np.degrees(found.psi_p))),
        Printed("psi_r", 88, 0, float(np.degrees(found.psi_r))),
    ]


def garcia_hubbard() -> Claim:
    """T1: the figures of the body GH."""
    body = Rattleback.gh()
    rows = gh_figures(body)
    # Table I is rounded, too: what its last digits leave open.
    halves = {"alpha": 0.005, "beta": 0.0005, "theta": 5e-5, "phi": 5e-5, "xi": np.radians(0.005)}
    corners: list[list[float]] = []
    for signs in product((-1, 1), repeat=len(halves)):
        moved = {
            n: getattr(body, n) + s * h for s, (n, h) in zip(signs, halves.items(), strict=True)
        }
        corners.append([r.found for r in gh_figures(Rattleback(gamma=body.gamma, **moved))])
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    possible = [
        a - 0.5 * 10.0**-r.digits <= r.value <= b + 0.5 * 10.0**-r.digits
        for r, a, b in zip(rows, low, high, strict=True)
    ]
    # 0.03 rad is 1.719 degrees, which Table I would print as 1.72.
    other = gh_figures(Rattleback(body.alpha, body.beta, body.gamma, body.theta, body.phi, -0.03))
    return Claim(
        id="T1",
        where="Methods; text on Fig. 4",
        words="“The parameter set GH gives K_p = 0.553 and K_r = 0.0967”; pitch frequency "
        "“omega_p ~ 1.44 omega~”, roll frequency “omega_r ~ 0.602 omega~”; eigenvectors at "
        "“psi_p ~ -17^deg” and “psi_r ~ 88^deg” from the x axis",
        measured=", ".join(f"{r.name} = {r.found:.4g}" for r in rows),
        value=rows[1].found,
        low=float(low[1]),
        high=float(high[1]),
        checks=[
            ("all six are possible for a body that Table I rounds to GH", all(possible)),
            *((f"{r.name} rounds to {r.value:g}", r.agrees) for r in rows),
        ],
        notes=(
            "The range given is that of K_r over all bodies that Table I rounds to GH. With "
            f"xi = -0.03 rad, which it rounds to 1.72 degrees, {sum(r.agrees for r in other)} of "
            f"6 come out as printed (K_r = {other[1].found:.5f})."
        ),
    )


# --- T2 -----------------------------------------------------------------------------------------


def by_definition(body: tuple[Floats, ...]) -> dict[str, Floats]:
    """Torque coefficients from eigenvectors, by Eqs. (33) [kp-1] and (35) [kr-1].

    Matrices and ``numpy.linalg.eigh``; nothing of :mod:`rattlesweep.physics.theory`.
    """
    alpha, beta, _, theta, phi, xi = body
    turn = xi + np.pi / 2
    cos, sin = np.cos(turn), np.sin(turn)
    rotation = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)
    zero = np.zeros_like(alpha)
    stiff = np.stack([np.stack([1 / theta, zero], -1), np.stack([zero, 1 / phi], -1)], -2)
    gamma_hat = rotation @ stiff @ np.swapaxes(rotation, -1, -2)
    root = np.sqrt(np.stack([alpha, beta], -1))
    hat = (gamma_hat - np.eye(2)) / (root[..., :, None] * root[..., None, :])
    squares, kets = np.linalg.eigh((hat + np.swapaxes(hat, -1, -2)) / 2)
    epsilon = np.array([[0.0, 1.0], [-1.0, 0.0]])
    # J^-1/2 epsilon J^1/2 H, and the same with J^-1/2 twice, as Eq. (38) [k-diff] prints it.
    operator = (epsilon * root[..., None, :] / root[..., :, None]) @ hat
    printed = (epsilon / (root[..., None, :] * root[..., :, None])) @ hat
    brackets = np.einsum("...ij,...ik,...kj->...j", kets, operator, kets)
    return {
        "K_p": brackets[..., 1],
        "K_r": -brackets[..., 0],
        "ratio": squares[..., 1] / squares[..., 0],
        "trace": np.trace(operator, axis1=-2, axis2=-1),
        "printed": np.trace(printed, axis1=-2, axis2=-1),
        # How much rounding is magnified where the frequencies nearly meet.
        "magnified": squares[..., 1] / (squares[..., 1] - squares[..., 0]),
    }


def identities(samples: int) -> Claim:
    """T2: the ratio, the difference and the signs of the torque coefficients."""
    body = tuple(np.concatenate(pair) for pair in
                 zip(sd_bodies(samples), wide_bodies(samples), strict=True))  # fmt: skip
    alpha, beta, _, theta, phi, xi = body
    found = by_definition(body)
    scale = found["K_p"] * found["magnified"]
    closed = -0.5 * np.sin(2 * xi) * (1 / beta - 1 / alpha) * (1 / phi - 1 / theta)
    difference = found["K_p"] - found["K_r"]
    off = {
        "K_p/K_r": np.abs(found["K_p"] - found["K_r"] * found["ratio"]) / scale,
        "K_p - K_r": np.abs(difference - closed) / scale,
        "trace with J^+1/2": np.abs(difference - found["trace"]) / scale,
    }
    largest = {name: float(values.max()) for name, values in off.items()}
    signs = found["K_p"] * found["K_r"] > 0
    printed = float(np.max(np.abs(found["printed"] / difference)))
    return Claim(
        id="T2",
        where="Eqs. (37) [k-rat] and (38) [k-diff]",
        words="K_p/K_r = omega_p^2/omega_r^2; K_p - K_r = Tr[J^-1/2 eps J^-1/2 H] = "
        "-(1/2) sin(2 xi)(1/beta - 1/alpha)(1/phi - 1/theta); K_p K_r > 0, “namely, the torques "
        "generated by the pitching and the rolling always have opposite signs to each other”",
        measured=(
            "largest relative deviation: "
            + ", ".join(f"{name} {value:.1g}" for name, value in largest.items())
            + f"; K_p K_r > 0 in {np.mean(signs):.0%} of {len(alpha):,} bodies; the trace "
            f"as printed is at most {printed:.1g} of K_p - K_r"
        ),
        value=max(largest.values()),
        checks=[
            (
                f"K_p/K_r is the squared ratio of the frequencies, to {EXACT:g}",
                largest["K_p/K_r"] < EXACT,
            ),
            ("K_p - K_r is as the second line has it", largest["K_p - K_r"] < EXACT),
            ("K_p K_r > 0 for every body", bool(signs.all())),
            ("the trace, first line, as printed", abs(printed - 1) < EXACT),
        ],
        notes=(
            "K_p and K_r are computed from the eigenvectors by Eqs. (33) [kp-1] and (35) [kr-1], "
            "for bodies of SD and far beyond it; the tolerance grows where nearly equal "
            "frequencies amplify rounding. The trace in the first line of Eq. (38) [k-diff] is "
            "zero for every body, since J^-1/2 eps J^-1/2 is antisymmetric and H symmetric; "
            f"Tr[J^-1/2 eps J^+1/2 H] must be meant, and equals K_p - K_r to "
            f"{largest['trace with J^+1/2']:.1g}."
        ),
    )


# --- T3 -----------------------------------------------------------------------------------------


def _extrapolated(values: Floats) -> Floats:
    """Limit of a sequence whose argument is halved, freed of its first and second order."""
    first = 2 * values[1:] - values[:-1]
    second = (4 * first[1:] - first[:-1]) / 3
    return np.asarray(second[-1])


def limits(samples: int) -> Claim:
    """T3: long curvature to zero, short curvature to one."""
    alpha, beta, _, theta, phi, _ = sd_bodies(samples)
    xi = -(2.0**-26)
    lever = -xi * (1 / beta - 1 / alpha)
    small = 2.0 ** -np.arange(12, 18)
    flat = [theory.modes(alpha, beta, theta, s, xi) for s in small]
    tall = [theory.modes(alpha, beta, 1 - s, phi, xi) for s in small]
    pairs = {
        "phi K_p, phi -> 0": ([s * m.K_p for s, m in zip(small, flat, strict=True)], lever),
        "K_r, phi -> 0": ([m.K_r for m in flat], lever * alpha / beta * (1 / theta - 1)),
        "K_p, theta -> 1": ([m.K_p for m in tall], lever * (1 / phi - 1)),
        "K_r/(1 - theta), theta -> 1": (
            [m.K_r / s for s, m in zip(small, tall, strict=True)], lever * alpha / beta,
        ),
    }  # fmt: skip
    off = {
        name: float(np.max(np.abs(_extrapolated(np.array(values)) / limit - 1)))
        for name, (values, limit) in pairs.items()
    }
    # What "|xi| << 1" leaves out at the largest skew angle of SD.
    at_six = theory.modes(alpha, beta, theta, 1e-9, -np.radians(6.0)).K_r
    small_xi = np.radians(6.0) * (1 / beta - 1 / alpha) * alpha / beta * (1 / theta - 1)
    gap = np.abs(at_six / small_xi - 1)
    return Claim(
        id="T3",
        where="end of Theory",
        words="abs(xi) << 1 and phi -> 0: K_p -> infinity, K_r -> (-xi)(1/beta - 1/alpha)"
        "(alpha/beta)(1/theta - 1), “thus the time for reversal t_rGH- remains constant while "
        "t_rGH+ approaches 0”; theta -> 1: K_p -> (-xi)(1/beta - 1/alpha)(1/phi - 1), K_r -> 0, "
        "“the negative spin rotation never reverses”",
        measured="largest relative distance from the limit: "
        + ", ".join(f"{name}: {value:.1g}" for name, value in off.items()),
        value=max(off.values()),
        checks=[(f"limit of {name} to 1e-8", value < 1e-8) for name, value in off.items()],
        notes=(
            "Extrapolated from phi and 1 - theta = 2^-12 ... 2^-17 at xi = -2^-26, for "
            f"{samples:,} bodies of SD. phi K_p and K_r/(1 - theta) have finite, nonzero limits, "
            "so K_p diverges as 1/phi and K_r vanishes as 1 - theta. The limits are those of "
            "small xi: at -6 degrees, the largest skew angle of SD, K_r for phi -> 0 is off by "
            f"{gap.min():.0%} to {gap.max():.0%}."
        ),
    )
