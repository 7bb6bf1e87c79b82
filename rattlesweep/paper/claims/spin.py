"""The paper's claims about bodies that spin slowly or steadily (T7, S9)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.paper.claims.claim import EXACT, Claim
from rattlesweep.paper.data.sd import sd_bodies, wide_bodies
from rattlesweep.physics import full, reduced, steady, theory

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


def growth_slopes(body: tuple[Floats, ...]) -> tuple[Floats, Floats]:
    """Derivatives at ``n = 0`` of the growth rates of pitch and roll, in the full dynamics.

    First-order perturbation of the linear system: ``w M'(0) v / (w v)``, with the left and right
    eigenvectors ``w, v``; ``M`` is of second degree in ``n``.
    """
    constants = full.constants(*body)
    at_rest = steady.matrix(constants, 0.0)
    change = (steady.matrix(constants, 1.0) - steady.matrix(constants, -1.0)) / 2
    values, right = np.linalg.eig(at_rest)
    left = np.linalg.inv(right)
    slopes = np.einsum("...ji,...ik,...kj->...j", left, change, right).real
    order = np.argsort(-values.imag, axis=-1)
    ranked = np.take_along_axis(slopes, order, -1)
    return ranked[..., 0], ranked[..., 1]


def prs(state: Floats, ratio: Floats) -> Floats:
    """Moffatt and Tokieda's vector field (Eq. (75) [toki-prs]) on ``(P, R, S)``, shape (3, ...)."""
    p, r, s = state
    return np.stack([ratio * p * s, -r * s, r**2 - ratio * p**2])


def moffatt_tokieda(body: tuple[Floats, ...], seed: int = 2017) -> float:
    """Largest relative distance of the three-variable system from Moffatt and Tokieda's.

    With ``n = S``, ``E_p = (I/2) P^2``, ``E_r = (I/2) R^2``, ``t = (2/K_r) tau`` and ``lambda`` the
    squared ratio of the frequencies, at random states.
    """
    alpha, beta, gamma, theta, phi, xi = body
    found = theory.modes(alpha, beta, theta, phi, xi)
    state = np.random.default_rng(seed).normal(size=(3, len(alpha)))
    p, r, s = state
    scale = 2 / found.K_r
    spin, pitch, roll = (
        scale * np.asarray(rate)
        for rate in reduced.rhs.py_func(
            s, gamma / 2 * p**2, gamma / 2 * r**2, found.K_p, found.K_r, gamma
        )
    )
    mapped = np.stack([pitch / (gamma * p), roll / (gamma * r), spin])
    wanted = prs(state, (found.omega_p / found.omega_r) ** 2)
    return float(np.max(np.abs(mapped - wanted) / np.linalg.norm(wanted, axis=0)))


def slow_spin(samples: int) -> Claim:
    """T7: growth rates at small spin, and the system of Moffatt and Tokieda."""
    bodies = {"SD": sd_bodies(samples), "far beyond": wide_bodies(samples)}
    off: dict[str, float] = {}
    for name, body in bodies.items():
        alpha, beta, _, theta, phi, xi = body
        found = theory.modes(alpha, beta, theta, phi, xi)
        magnified = found.omega_p**2 / (found.omega_p**2 - found.omega_r**2)
        pitch, roll = growth_slopes(body)
        # Near zero K_r the slope is what is left of larger terms: measured against K_p.
        for mode, value in (("pitch", pitch - found.K_p / 2), ("roll", roll + found.K_r / 2)):
            part = np.abs(value) / (found.K_p * magnified)
            off[f"{mode}, {name}"] = float(part.max())
    field = moffatt_tokieda(bodies["SD"])
    # How far the small-spin rate carries.
    alpha, beta, _, theta, phi, xi = bodies["SD"]
    found = theory.modes(alpha, beta, theta, phi, xi)
    carries = []
    for n in (-0.1, -0.3):
        _, exact = steady.growth(full.constants(*bodies["SD"]), n)
        carries.append(float(np.median(exact / (-n * found.K_r / 2))))
    return Claim(
        id="T7",
        where="Discussion, Eqs. (74) [case-instab1] and (75) [toki-prs]",
        words="growth rates delta_x = (n/2) K_p of the pitch and delta_y = -(n/2) K_r of the roll "
        "“at a small constant spin and small skewness”; Moffatt and Tokieda's equation “is "
        "equivalent with” the three-variable dynamics, “again the difference comes from choice of "
        "the variables”",
        measured=(
            "largest deviation of the slopes at n = 0, in units of K_p: "
            + ", ".join(f"{name} {value:.1g}" for name, value in off.items())
            + f"; of the vector fields, relative: {field:.1g}"
        ),
        value=max(*off.values(), field),
        checks=[
            *(
                (f"slope of the growth rate, {name}, to {EXACT:g}", value < EXACT)
                for name, value in off.items()
            ),
            (f"Moffatt and Tokieda's vector field to {EXACT:g}", field < EXACT),
        ],
        notes=(
            "Slopes of the eigenvalues of the linearised full dynamics by first-order "
            f"perturbation theory, for {samples:,} bodies of SD and as many far beyond; they hold "
            "at any skew angle, not only at small ones. Moffatt and Tokieda's system follows with "
            "n = S, E_p = (I/2)P^2, E_r = (I/2)R^2, t = (2/K_r) tau, lambda = "
            f"omega_p^2/omega_r^2. In SD the exact growth rate of the roll is {carries[0]:.2f} "
            f"times the small-spin one at n = -0.1 and {carries[1]:.2f} times at n = -0.3 "
            "(medians)."
        ),
    )


# Spins at which stability is asked for, in thresholds, and whether there is any, after Bondi.
NEAR = ((0.1, False), (0.5, False), (1 - 1e-5, False), (1 + 1e-5, True))
FAR = ((1.5, True), (4.0, True))
ANGLES = (0.01, 1.0, 6.0, 20.0, 45.0, 70.0, 89.0)


def contradictions(
    body: tuple[Floats, ...], spins: tuple[tuple[float, bool], ...]
) -> tuple[int, int]:
    """How often the eigenvalues contradict Bondi's threshold, and out of how many trials.

    Parameters
    ----------
    body : tuple of ndarray
        ``alpha, beta, gamma, theta, phi, xi``; each is tried at the skew angles ``ANGLES``.
    spins : tuple
        Spins in thresholds, and whether the steady spin should be stable there; bodies without a
        threshold should be unstable at any spin.
    """
    alpha, beta, gamma, theta, phi, _ = body
    threshold = theory.bondi_threshold(alpha, beta, gamma, theta, phi)
    exists = np.isfinite(threshold)
    wrong = tried = 0
    for angle in ANGLES:
        constants = full.constants(alpha, beta, gamma, theta, phi, -np.radians(angle))
        for factor, stable in spins:
            growth = _fastest(constants[:, exists], factor * threshold[exists])
            wrong += int(np.count_nonzero((growth < 0) != stable))
            growth = _fastest(constants[:, ~exists], -factor)
            wrong += int(np.count_nonzero(growth < 0))
            tried += len(alpha)
    return wrong, tried


def bondi(samples: int) -> Claim:
    """S9: Bondi's threshold and the exact steady solution."""
    body, wide = sd_bodies(samples), wide_bodies(samples)
    bad, tried = contradictions(body, NEAR + FAR)
    wide_near, wide_tried = contradictions(wide, NEAR)
    wide_far, far_tried = contradictions(wide, FAR)
    spins = np.random.default_rng(2017).normal(size=2 * samples).tolist()
    both = np.concatenate([full.constants(*body), full.constants(*wide)], axis=1)
    moved = max(
        max(map(abs, full.rhs.py_func(0.0, 0.0, 0.0, 0.0, spin, *constants)))
        for spin, constants in zip(spins, both.T.tolist(), strict=True)
    )
    return Claim(
        id="S9",
        where="Eq. (73) [def-nc1]",
        words="“There always exists a steady solution”, and for the steady direction “this "
        "solution is linearly stable for n < n_c1 < 0”; without a threshold “the steady solution "
        "is always unstable”; “Note that n_c1 does not depend on xi”",
        measured=(
            f"eigenvalues in contradiction: SD {bad} of {tried:,}; any inertia {wide_near} of "
            f"{wide_tried:,} up to n_c1 (1 + 1e-5), {wide_far:,} of {far_tried:,} at 1.5 n_c1 and "
            f"4 n_c1; rate of change of the steady spin: {moved:g}"
        ),
        value=wide_far / far_tried,
        checks=[
            (
                "the vertical spin is an exact solution, in SD stable beyond the threshold and at "
                "no smaller spin, at any skew angle",
                bad == 0 and moved == 0,
            ),
            ("any inertia: stability sets in at the threshold", wide_near == 0),
            ("any inertia: and stays for all larger spins", wide_far == 0),
        ],
        notes=(
            f"Eigenvalues of the linearised full dynamics at skew angles of "
            f"{', '.join(f'{a:g}' for a in ANGLES)} degrees, for {samples:,} bodies of SD and as "
            "many with any inertia: unstable up to n_c1 (1 - 1e-5), stable at n_c1 (1 + 1e-5), "
            "hence one threshold for all xi. Bodies with I_zz < I_xx + I_yy, of which SD has none, "
            "can become unstable again at a larger spin, where the squared frequency of one mode "
            "passes through zero."
        ),
    )


def _fastest(constants: Floats, n: Any) -> Floats:
    growth: Floats = np.linalg.eigvals(steady.matrix(constants, n)).real.max(axis=-1)
    return growth
