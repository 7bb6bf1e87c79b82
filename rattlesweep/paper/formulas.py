"""Claims about formulas (T1 to T3, T6 to T8, S9), measured without any run.

A formula that the package itself uses is checked by a second computation: torque
coefficients from their definition by eigenvectors, growth rates from the linearised
full dynamics.
"""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from rattlesweep.api import modes
from rattlesweep.arrays import Floats
from rattlesweep.paper.claim import ROUNDING_ALLOWED, Measured, Tally, every, extremes
from rattlesweep.paper.fig3_4 import drawn_bodies
from rattlesweep.paper.workspace import TABLE_I, Made
from rattlesweep.physics import full, reduced, steady, theory
from rattlesweep.physics.body import Rattleback, shell_dumbbell

# Number of random bodies for each check.
CHECKED_BODIES = 2000


def wide_bodies() -> tuple[Floats, ...]:
    """Return bodies far beyond the set SD: any inertia, any skew angle, nearly any
    surface.
    """
    rng = np.random.default_rng(2017)
    largest = 10 ** rng.uniform(-1, 2, CHECKED_BODIES)
    alpha, beta = shell_dumbbell(largest, rng.uniform(0.01, 0.49, CHECKED_BODIES))
    # I_xx - I_yy < I_zz < I_xx + I_yy; the shell-dumbbell bodies are at the upper end.
    gamma = (
        alpha - beta + (largest - (alpha - beta)) * rng.uniform(0, 1, CHECKED_BODIES)
    )
    theta = rng.uniform(0.05, 0.99, CHECKED_BODIES)
    phi = theta * 10 ** rng.uniform(-3, -0.01, CHECKED_BODIES)
    return (
        alpha,
        beta,
        gamma,
        theta,
        phi,
        -np.radians(rng.uniform(0.01, 89.99, CHECKED_BODIES)),
    )


# Printed numbers of the body GH (angles in degrees), and how many decimals they have.
PRINTED_NUMBERS = {
    "K_p": (0.553, 3),
    "K_r": (0.0967, 4),
    "omega_p": (1.44, 2),
    "omega_r": (0.602, 3),
    "psi_p": (-17, 0),
    "psi_r": (88, 0),
}
# Half a unit in the last digit of GH in Table I, where xi is in degrees.
_ROUNDING = {
    "alpha": 5e-3,
    "beta": 5e-4,
    "theta": 5e-5,
    "phi": 5e-5,
    "xi": np.radians(5e-3),
}


def gh_numbers(**parameters: Any) -> dict[str, float]:
    """Return the numbers in `PRINTED_NUMBERS` for GH with some parameters changed."""
    body_modes = modes(replace(Rattleback.gh(), **parameters))
    values = {name: float(getattr(body_modes, name)) for name in PRINTED_NUMBERS}
    return values | {
        name: float(np.degrees(values[name])) for name in ("psi_p", "psi_r")
    }


def as_printed(numbers: dict[str, float]) -> dict[str, bool]:
    """Return which of the numbers round to the printed ones."""
    return {
        name: round(numbers[name], digits) == value
        for name, (value, digits) in PRINTED_NUMBERS.items()
    }


def printed_modes(_: Made) -> Measured:
    """Measure T1: the numbers of GH, and of all bodies that Table I rounds to GH."""
    body = Rattleback.gh()
    numbers = gh_numbers()
    corners = []
    for steps in product(*((-half, half) for half in _ROUNDING.values())):
        moved = zip(_ROUNDING, steps, strict=True)
        corner = {name: getattr(body, name) + step for name, step in moved}
        corners.append(gh_numbers(**corner))
    ends = {
        name: extremes([corner[name] for corner in corners]) for name in PRINTED_NUMBERS
    }
    within = [
        ends[name][0] < value + 0.5 * 10.0**-digits
        and ends[name][1] > value - 0.5 * 10.0**-digits
        for name, (value, digits) in PRINTED_NUMBERS.items()
    ]
    # 0.03 rad is 1.719 degrees, which Table I would print as 1.72.
    skewed = gh_numbers(xi=-0.03)
    five = [same for name, same in as_printed(numbers).items() if name != "K_r"]
    checks = [every(within), every([*as_printed(skewed).values()]), every(five)]
    return checks, {
        **numbers,
        "value": numbers["K_r"],
        "low": ends["K_r"][0],
        "high": ends["K_r"][1],
        "other": skewed["K_r"],
    }


def by_definition(body: tuple[Floats, ...]) -> dict[str, Floats]:
    """Return torque coefficients from eigenvectors, by Eqs. 33 and 35."""
    alpha, beta, _, theta, phi, xi = body
    cos = np.cos(xi + np.pi / 2)
    sin = np.sin(xi + np.pi / 2)
    rotation = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)
    stiff = np.stack([1 / theta, 1 / phi], -1)[..., None] * np.eye(2)
    root = np.sqrt(np.stack([alpha, beta], -1))
    roots = root[..., :, None] * root[..., None, :]
    hat = (rotation @ stiff @ rotation.mT - np.eye(2)) / roots
    squares, kets = np.linalg.eigh((hat + hat.mT) / 2)
    epsilon = np.array([[0.0, 1.0], [-1.0, 0.0]])
    # J^-1/2 epsilon J^1/2 H, and the same with J^-1/2 twice, as Eq. 38 prints it.
    operator = (epsilon * root[..., None, :] / root[..., :, None]) @ hat
    printed = (epsilon / roots) @ hat
    brackets = np.einsum("...ij,...ik,...kj->...j", kets, operator, kets)
    return {
        "K_p": brackets[..., 1],
        "K_r": -brackets[..., 0],
        "ratio": squares[..., 1] / squares[..., 0],
        "trace": np.trace(operator, axis1=-2, axis2=-1),
        "printed": np.trace(printed, axis1=-2, axis2=-1),
        # Amplification of rounding errors where the frequencies are nearly equal.
        "magnified": squares[..., 1] / (squares[..., 1] - squares[..., 0]),
    }


def identities(_: Made) -> Measured:
    """Measure T2: ratio, difference and signs of the torque coefficients."""
    body = tuple(np.hstack([drawn_bodies(0, CHECKED_BODIES), wide_bodies()]))
    alpha, beta, _gamma, theta, phi, xi = body
    exact = by_definition(body)
    closed = -0.5 * np.sin(2 * xi) * (1 / beta - 1 / alpha) * (1 / phi - 1 / theta)
    difference = exact["K_p"] - exact["K_r"]
    off = {
        "ratio": exact["K_p"] - exact["K_r"] * exact["ratio"],
        "difference": difference - closed,
        "trace": difference - exact["trace"],
    }
    scale = exact["K_p"] * exact["magnified"]
    largest = {
        name: float(np.max(np.abs(values) / scale)) for name, values in off.items()
    }
    signs = exact["K_p"] * exact["K_r"] > 0
    printed = float(np.max(np.abs(exact["printed"] / difference)))
    checks = [
        largest["ratio"] < ROUNDING_ALLOWED,
        largest["difference"] < ROUNDING_ALLOWED,
        every(signs),
        abs(printed - 1) < ROUNDING_ALLOWED,
    ]
    return checks, {
        **largest,
        "value": max(largest.values()),
        "positive": np.mean(signs),
        "bodies": len(alpha),
        "printed": printed,
    }


def limits(_: Made) -> Measured:
    """Measure T3: the limits phi -> 0 and theta -> 1."""
    alpha, beta, _gamma, theta, phi, _xi = drawn_bodies(0, CHECKED_BODIES)
    xi = -(2.0**-26)
    small = np.array(2.0**-36)
    lever = -xi * (1 / beta - 1 / alpha)
    flat = theory.modes(alpha, beta, theta, small, xi)
    tall = theory.modes(alpha, beta, 1 - small, phi, xi)
    pairs = (
        (small * flat.K_p, lever),
        (flat.K_r, lever * alpha / beta * (1 / theta - 1)),
        (tall.K_p, lever * (1 / phi - 1)),
        (tall.K_r / small, lever * alpha / beta),
    )
    off = [float(np.max(np.abs(values / limit - 1))) for values, limit in pairs]
    return [value < 1e-8 for value in off], {
        "off": off,
        "value": max(off),
        "bodies": CHECKED_BODIES,
    }


def _ellipsoid(centre: float, b2: Floats, c2: Floats) -> dict[str, Floats]:
    """Return the parameters of an ellipsoid of semi-axes c, b, 1, or of its half."""
    height = 1 - centre
    vertical = 1 / 5 - centre**2
    return {
        "alpha": (b2 / 5 + vertical) / height**2 + 1,
        "beta": (c2 / 5 + vertical) / height**2 + 1,
        "theta": height / c2,
        "phi": height / b2,
    }


def ellipsoids(_: Made) -> Measured:
    """Measure T6: pitch is faster than roll for uniform ellipsoids and half ones."""
    excess = []
    off = []
    for centre, factor, p, q in ((0.0, 35, 1, 6), (3 / 8, 25 / 16 * 92, 4, 9)):
        first, second = 10.0 ** np.random.default_rng(2017).uniform(
            -6, 4, (2, 2 * CHECKED_BODIES)
        )
        c2 = (1 - centre) * (1 + first)
        b2 = c2 * (1 + second)
        modes = theory.modes(**_ellipsoid(centre, b2, c2), xi=0.0)
        pitch = modes.omega_p0**2
        roll = modes.omega_r0**2
        excess.append(pitch / roll - 1)
        closed = factor * (b2 - c2) / ((p * b2 + q) * (p * c2 + q))
        off.append(np.abs(pitch - roll - closed) / pitch)
    more = np.concatenate(excess)
    formula = float(np.max(off))
    return [every(more > 0), formula < ROUNDING_ALLOWED], {
        "shapes": len(more),
        "value": float(more.min()),
        "formula": formula,
    }


def growth_slopes(body: tuple[Floats, ...]) -> tuple[Floats, Floats]:
    """Return the slopes of the growth rates of pitch and roll at n = 0, ``w M'(0) v /
    (w v)``.
    """
    constants = full.constants(*body)
    change = (steady.matrix(constants, 1.0) - steady.matrix(constants, -1.0)) / 2
    values, right = np.linalg.eig(steady.matrix(constants, 0.0))
    slopes = np.einsum(
        "...ji,...ik,...kj->...j", np.linalg.inv(right), change, right
    ).real
    ranked = np.take_along_axis(slopes, np.argsort(-values.imag, axis=-1), -1)
    return ranked[..., 0], ranked[..., 1]


def slow_spin(_: Made) -> Measured:
    """Measure T7: growth rates at small spin, and the system of Moffatt and Tokieda."""
    off: list[float] = []
    for body in (wide_bodies(), drawn_bodies(0, CHECKED_BODIES)):
        alpha, beta, gamma, theta, phi, xi = body
        modes = theory.modes(alpha, beta, theta, phi, xi)
        magnified = modes.omega_p**2 / (modes.omega_p**2 - modes.omega_r**2)
        pitch, roll = growth_slopes(body)
        # At small K_r larger terms cancel in the slope, so the error is measured
        # against K_p.
        rest = np.abs([pitch - modes.K_p / 2, roll + modes.K_r / 2])
        off = [*np.max(rest / (modes.K_p * magnified), axis=1).tolist(), *off]
    # Eq. 75 with n = S, E_p = (I/2) P^2, E_r = (I/2) R^2, t = (2/K_r) tau.
    p, r, s = np.random.default_rng(2017).normal(size=(3, CHECKED_BODIES))
    rates = reduced.rhs.py_func(
        (s, gamma / 2 * p**2, gamma / 2 * r**2), (modes.K_p, modes.K_r, gamma)
    )
    spin, pitch, roll = (2 / modes.K_r * np.asarray(rate) for rate in rates)
    ratio = (modes.omega_p / modes.omega_r) ** 2
    wanted = np.stack([ratio * p * s, -r * s, r**2 - ratio * p**2])
    rest = np.stack([pitch / (gamma * p), roll / (gamma * r), spin]) - wanted
    field = float(np.max(np.abs(rest) / np.linalg.norm(wanted, axis=0)))
    return [value < ROUNDING_ALLOWED for value in (*off, field)], {
        "off": off,
        "field": field,
        "value": max(*off, field),
        "bodies": CHECKED_BODIES,
    }


def times_by_skew(_: Made) -> Measured:
    """Measure T8: Garcia and Hubbard's times against the skew, and their ratio."""
    alpha, beta, _gamma, theta_, phi, xi = body = drawn_bodies(0, CHECKED_BODIES)
    n_i = 0.1
    n_0 = 0.11

    def times(xi: Floats | float) -> Floats:
        """Return t_rGH+ and t_rGH- (Eqs. 56 and 58), shape (2, samples)."""
        modes = theory.modes(alpha, beta, theta_, phi, xi)
        time = np.log((n_0 + n_i) / (n_0 - n_i)) / n_0
        return np.stack([time / modes.K_p, time / modes.K_r])

    small = 2.0**-20
    largest = np.radians(TABLE_I["minus_xi_deg"][1])
    slope = float(np.abs(np.log2(times(-2 * small) / times(-small)) + 1).max())
    exact = by_definition(body)
    (unsteady, in_steady) = times(xi)
    off = float(
        (np.abs(in_steady / unsteady / exact["ratio"] - 1) / exact["magnified"]).max()
    )
    far = times(-largest) * largest / (times(-small) * small)
    return [slope < 1e-6, off < ROUNDING_ALLOWED], {
        "value": slope,
        "slope": slope,
        "ratio": off,
        "bodies": CHECKED_BODIES,
        "far": (float(far.min()), float(far.max())),
    }


# Spins in units of Bondi's threshold, and whether the steady spin should be stable
# there.
_NEAR = ((0.1, False), (0.5, False), (1 - 1e-5, False), (1 + 1e-5, True))
_FAR = ((1.5, True), (4.0, True))
_ANGLES = (0.01, 1.0, 6.0, 20.0, 45.0, 70.0, 89.0)


def contradictions(
    body: tuple[Floats, ...], spins: tuple[tuple[float, bool], ...]
) -> Tally:
    """Count how often eigenvalues contradict Bondi's threshold, over ``_ANGLES``."""
    alpha, beta, gamma, theta_, phi, _ = body
    threshold = theory.bondi_threshold(alpha, beta, gamma, theta_, phi)
    exists = np.isfinite(threshold)
    wrong = []
    for angle, (factor, stable) in product(_ANGLES, spins):
        constants = full.constants(alpha, beta, gamma, theta_, phi, -np.radians(angle))
        spin = np.where(exists, factor * threshold, -factor)
        growth = np.linalg.eigvals(steady.matrix(constants, spin)).real.max(axis=-1)
        wrong.append((growth < 0) != (exists & stable))
    return every(wrong)


def bondi(_: Made) -> Measured:
    """Measure S9: Bondi's threshold and the exact steady solution."""
    bodies = drawn_bodies(0, CHECKED_BODIES), wide_bodies()
    sd_near, sd_far, near, far = (
        contradictions(*trial) for trial in product(bodies, (_NEAR, _FAR))
    )
    spins = np.random.default_rng(2017).normal(size=2 * CHECKED_BODIES).tolist()
    both = np.concatenate([full.constants(*body) for body in bodies], axis=1)
    moved = max(
        max(map(abs, full.rhs.py_func((0.0, 0.0, 0.0, 0.0, spin), tuple(constants))))
        for spin, constants in zip(spins, both.T.tolist(), strict=True)
    )
    checks = [
        not sd_near.hits + near.hits and moved == 0,
        not sd_far.hits,
        not far.hits,
    ]
    return checks, {
        "sd": sd_near + sd_far,
        "near": near,
        "far": far,
        "moved": moved,
        "value": far.hits / far.total,
        "angles": ", ".join(map("{:g}".format, _ANGLES)),
        "bodies": CHECKED_BODIES,
    }
