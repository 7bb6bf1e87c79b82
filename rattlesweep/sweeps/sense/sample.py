"""A few thousand runs of a config, drawn in NumPy, by which its physical sense is judged.

Not the runs themselves: those of random bodies come from a compiled sampler, and may take hours of
redrawing.  The draw has a fixed seed, so that a config always gets the same answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.physics import theory
from rattlesweep.physics.body import shell_dumbbell
from rattlesweep.physics.launch import direction
from rattlesweep.sweeps.cases.launches import Launches, with_theory
from rattlesweep.sweeps.cases.sources import Bodies
from rattlesweep.sweeps.config.bodies import SdRanges, SdSource, Target
from rattlesweep.sweeps.config.schema import Config

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.sweeps.cases.sources import Source

    Floats = NDArray[np.float64]

RUNS = 4096
DRAWN = 65_536
TARGETS = 16
SEED = 2017


@dataclass(frozen=True)
class Sample:
    """Some runs of a config, and what they are in words: "4096 runs drawn from the ranges"."""

    launches: Launches
    words: str


def sample_runs(config: Config, source: Source | None = None) -> Sample | None:
    """Runs that stand for those of a sweep.

    Parameters
    ----------
    config : Config
    source : Source, optional
        The bodies; not needed for random ones, which are drawn here.

    Returns
    -------
    Sample or None
        All runs if they are few, else `RUNS` of them; None if nothing says how to launch.
    """
    spin = config.spin
    launches = list(product(spin.n_i, spin.omega_xy0)) if spin else []
    if isinstance(config.bodies, SdSource):
        target = config.bodies.target
        bodies = _drawn(config.bodies.ranges, target)
        size = bodies.alpha.size
        words = f"{size} runs drawn from the ranges"
        # Launches cycle within the bodies of each target, which follow one another.
        launch = np.arange(size) % max(1, len(launches))
        if len(launches) > size:
            launch = np.linspace(0, len(launches) - 1, size).astype(int)
    elif source is None:
        return None
    else:
        own = source.bodies(0, np.zeros(1, dtype=np.int64)).n_i is not None
        total = source.samples * (1 if own else len(launches))
        size = min(total, RUNS)
        runs = np.linspace(0, max(0, total - 1), size).astype(np.int64)
        launch, samples = np.divmod(runs, source.samples)
        bodies = source.bodies(0, samples)
        words = f"the {size} runs" if size == total else f"{size} of the {total} runs"
    if bodies.n_i is not None and bodies.omega_xy0 is not None:
        n_i, omega_xy0 = bodies.n_i, bodies.omega_xy0
    elif launches:
        n_i, omega_xy0 = np.array(launches, dtype=float)[launch].T
    else:
        return None
    modes = theory.modes(bodies.alpha, bodies.beta, bodies.theta, bodies.phi, bodies.xi)
    psi = bodies.psi
    if psi is None:
        psi = direction(modes, n_i, spin.psi if spin else "relevant")
    zero = np.zeros(size, dtype=np.int64)
    found = with_theory(zero, zero, bodies, n_i, omega_xy0, psi, modes, config.horizon)
    return Sample(found, words)


def bodies_at(points: Floats) -> Bodies:
    """Bodies at points of the ranges, shape (5, bodies)."""
    gamma, f_sd, theta, phi, minus_xi_deg = points
    alpha, beta = shell_dumbbell(gamma, f_sd)
    return Bodies(alpha, beta, gamma, theta, phi, -np.radians(minus_xi_deg), f_sd)


def draw(ranges: SdRanges, size: int = DRAWN) -> Floats:
    """Points drawn evenly from the ranges, shape (5, size)."""
    low, high = np.array(ranges.ends()).T[:, :, None]
    # Like the sampler: the skew angle's own range is open below.
    points: Floats = high - (high - low) * np.random.default_rng(SEED).random((5, size))
    return points


def coefficient(points: Floats, name: str) -> Floats:
    """The torque coefficient K_p or K_r of the bodies at `points`."""
    b = bodies_at(points)
    with np.errstate(all="ignore"):
        found = theory.torque_coefficients(b.alpha, b.beta, b.theta, b.phi, b.xi)
    chosen: Floats = found[2 if name == "K_p" else 3]
    return chosen


def _drawn(ranges: SdRanges, target: Target | None) -> Bodies:
    if target is None:
        return bodies_at(draw(ranges, RUNS))
    points = draw(ranges)
    found = coefficient(points, target.name)
    picks = np.unique(np.linspace(0, len(target.values) - 1, TARGETS).astype(int)).tolist()
    each = RUNS // len(picks)
    near = [
        np.sort(np.argpartition(np.abs(found - target.values[pick]), each)[:each]) for pick in picks
    ]
    return bodies_at(points[:, np.concatenate(near)])
