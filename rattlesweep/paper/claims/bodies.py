"""Claims about bodies: of the set SD (T4, T5) and uniform ellipsoids (T6); random bodies."""

from __future__ import annotations

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.paper.claims.claim import EXACT, Measured, Tables, every, share
from rattlesweep.paper.figures.fig2 import BOUND, drawn_bodies
from rattlesweep.paper.figures.fig3 import DECADES, counts_of, edges
from rattlesweep.physics import theory
from rattlesweep.physics.body import shell_dumbbell
from rattlesweep.sweeps.config.schema import SdRanges

# Random bodies on which formulas are tried.
SAMPLES = 2000
# Distributions this close cannot be told apart in print.
CLOSE = 0.02
# What "much larger" means here.
MUCH = 10.0


def sd_bodies(samples: int, seed: int = 2017) -> tuple[Floats, ...]:
    """``alpha, beta, gamma, theta, phi, xi`` of random bodies of the set SD."""
    return drawn_bodies(0, samples, SdRanges(), seed)


def wide_bodies(samples: int, seed: int = 2017) -> tuple[Floats, ...]:
    """The same far beyond the set SD: any inertia, any skew angle, nearly any surface."""
    rng = np.random.default_rng(seed)
    largest = 10 ** rng.uniform(-1, 2, samples)
    alpha, beta = shell_dumbbell(largest, rng.uniform(0.01, 0.49, samples))
    # I_xx - I_yy < I_zz < I_xx + I_yy; the shell-dumbbell bodies are at the upper end.
    gamma = alpha - beta + (largest - (alpha - beta)) * rng.uniform(0, 1, samples)
    theta = rng.uniform(0.05, 0.99, samples)
    phi = theta * 10 ** rng.uniform(-3, -0.01, samples)
    return alpha, beta, gamma, theta, phi, -np.radians(rng.uniform(0.01, 89.99, samples))


def frequencies(tables: Tables) -> Measured:
    """T4: the ratio of the frequencies, and their zeroth order."""
    row = tables["fig2"]["summary"].to_pylist()[0]
    rare = []
    if "fig3" in tables:
        # Its bodies are a hundred times as many.
        many = tables["fig3"]["summary"].to_pylist()[0]
        own = share(many["below"], many["density_samples"])
        rare = [many | own | {"none": np.exp(-1e6 * own["value"])}]
    checks = [row["below"] == 0, row["ratio_bound"] >= BOUND,
              max(row["distance_p"], row["distance_r"]) < CLOSE]  # fmt: skip
    least = tables["fig2"]["cumulative"]["ratio"][0].as_py()
    return checks, {**row, "value": least, "low": row["ratio_bound"], "rare": rare}


def coefficients(tables: Tables) -> Measured:
    """T5: the distributions of the torque coefficients."""
    own = tables["fig3"]
    row = own["summary"].to_pylist()[0]
    data = {n: own["cumulative"][n].to_numpy() for n in ("probability", "K_p", "K_r", "ratio")}
    level = data["probability"]
    # Order statistics: the median's place is binomial.
    half = 0.98 / np.sqrt(row["samples"])
    low, median, high = np.interp([0.5 - half, 0.5, 0.5 + half], level, data["ratio"]).tolist()
    share = own["density"]["relative_frequency"].to_numpy()
    decades = (float(np.log10(share.min())), float(np.log10(share.max())))
    # The two parts of the figure come from two codes: vectorised theory and the counting loop.
    counts, total = counts_of(own), row["density_samples"]
    gap = 0.0
    for axis, name in enumerate(("K_p", "K_r")):
        rising = np.cumsum(counts.sum(axis=1 - axis)) / total
        drawn = np.interp(edges(name)[1:], data[name], level)
        gap = max(gap, float(np.abs(drawn - rising).max()))
    # Kolmogorov's 99.9 % quantile for each, and the steps of the stored levels.
    allowed = 1.95 * np.sqrt(1 / row["samples"] + 1 / total) + 1 / (len(level) - 1)
    allowed += row["outside"] / total
    checks = [
        median >= MUCH,
        bool(data["ratio"][0] > 1),
        -DECADES <= decades[0] <= decades[1] <= 0,
        int(own["density"]["count"].to_numpy().sum()) + row["outside"] == total,
        bool(gap < allowed),
    ]
    return checks, {
        "value": median, "low": low, "high": high, "samples": row["samples"], "total": total,
        "least": data["ratio"][0], "decades": decades, "gap": gap, "allowed": allowed,
        **{name: np.interp(0.5, level, data[name]) for name in ("K_p", "K_r")},
    }  # fmt: skip


# --- T6: the ellipsoid x^2/c^2 + y^2/b^2 + z^2/a^2 = 1, a = 1, whole or its lower half ------------

# The least c^2 at which the body stands upright: its curvature, c^-2 times the height of the
# centre of mass, must be below 1.
LEAST = {"whole": 1.0, "half": 5 / 8}
BOTTOM = {"whole": -1.0, "half": 0.0}


def shapes(kind: str, samples: int, seed: int = 2017) -> tuple[Floats, Floats]:
    """``b^2`` and ``c^2`` over all that is allowed, ``b^2 > c^2 > LEAST``: a grid and random ones.

    Distances from both borders run from 1e-6 to 1e4 of the border itself, as far as doubles tell
    the two frequencies apart.
    """
    steps = 10.0 ** np.linspace(-6, 4, max(2, int(np.sqrt(samples))))
    grid = [axis.ravel() for axis in np.meshgrid(steps, steps)]
    rng = np.random.default_rng(seed)
    first, second = (np.append(axis, 10.0 ** rng.uniform(-6, 4, samples)) for axis in grid)
    c2 = LEAST[kind] * (1 + first)
    return c2 * (1 + second), c2


def by_slices(kind: str, b2: Floats, c2: Floats) -> dict[str, Floats]:
    """Parameters of the body, its inertia by integration over horizontal slices.

    At height ``z`` the slice is an ellipse of area ``pi b c s`` and mean squares ``s c^2/4`` and
    ``s b^2/4``, ``s = 1 - z^2``; Gauss's rule is exact for these polynomials.
    """
    bottom = BOTTOM[kind]
    node, weight = np.polynomial.legendre.leggauss(6)
    z = (1 + bottom) / 2 + (1 - bottom) / 2 * node
    square = 1 - z**2
    share = weight * square / np.sum(weight * square)
    centre = float(np.sum(share * z))
    xx, yy = c2 * np.sum(share * square) / 4, b2 * np.sum(share * square) / 4
    zz = np.sum(share * (z - centre) ** 2)
    height = 1 - centre
    return {
        "alpha": (yy + zz) / height**2 + 1,
        "beta": (xx + zz) / height**2 + 1,
        # The surface has the curvatures 1/c^2 and 1/b^2 at the bottom.
        "theta": height / c2,
        "phi": height / b2,
    }


def square_difference(kind: str, b2: Floats, c2: Floats) -> Floats:
    """``omega_p0^2 - omega_r0^2`` in closed form, a positive number times ``b^2 - c^2``."""
    if kind == "whole":
        # f(s) = 5 (s - 1)/(s + 6)
        return 35 * (b2 - c2) / ((b2 + 6) * (c2 + 6))
    # f(s) = (25/16) (8 s - 5)/(4 s + 9)
    return 25 / 16 * 92 * (b2 - c2) / ((4 * b2 + 9) * (4 * c2 + 9))


def ellipsoids(_: Tables, samples: int = SAMPLES) -> Measured:
    """T6: pitch faster than roll for uniform ellipsoids and their lower halves."""
    excess, off = [], []
    for kind in LEAST:
        b2, c2 = shapes(kind, samples)
        found = theory.modes(**by_slices(kind, b2, c2), xi=0.0)
        pitch, roll = found.omega_p0**2, found.omega_r0**2
        excess.append(pitch / roll - 1)
        off.append(np.abs(pitch - roll - square_difference(kind, b2, c2)) / pitch)
    more, formula = np.concatenate(excess), float(np.concatenate(off).max())
    return [every(more > 0), formula < EXACT], {
        "shapes": len(more), "value": float(more.min()), "formula": formula,
    }  # fmt: skip
