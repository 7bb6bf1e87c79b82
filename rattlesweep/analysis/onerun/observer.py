"""Reversals and contact forces of a run, from its accepted steps, whatever rows are asked for."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.integrate.batch import PLATEAU_SHARE


@dataclass
class Observer:
    """Looks at the launch and at the accepted steps as they come."""

    plateau: float
    """Modulus of the launch's spin, in ``sqrt(g/a)``; of one without spin, ``n_0``."""
    zeros: list[float] = field(default_factory=list)
    """Times of all zeros of the spin up to the last look, kept by whoever finds them."""
    reversals: list[float] = field(default_factory=list)  # the first zero of each
    normal_min: float = math.inf  # least normal force in M g
    friction_max: float = 0.0  # largest ratio of the tangential force to it
    lifts: float = math.nan  # when the first is first negative; NaN if never
    slips: float = math.nan  # when the second is first above 1; NaN if never
    # The last time beyond the share PLATEAU_SHARE of the plateau, and the sign of the spin then.
    _last: tuple[float, float] = (0.0, 0.0)

    def spin(self, t: Floats, n: Floats) -> None:
        """Look at spins."""
        far = np.abs(n) > PLATEAU_SHARE * self.plateau
        t = np.concatenate([[self._last[0]], t[far]])
        side = np.concatenate([[self._last[1]], np.sign(n[far])])
        for k in np.flatnonzero(side[1:] * side[:-1] < 0):
            first = bisect_right(self.zeros, t[k])
            self.reversals += self.zeros[first : first + 1]
        self._last = float(t[-1]), float(side[-1])

    def forces(self, t: Floats, normal: Floats, tangential: Floats) -> None:
        """Look at contact forces."""
        down = normal > 0
        ratio = np.divide(tangential, normal, out=np.zeros(len(t)), where=down)
        if not self.lifts <= t[0] and (normal < 0).any():
            self.lifts = float(t[np.argmax(normal < 0)])
        if not self.slips <= t[0] and (ratio > 1).any():
            self.slips = float(t[np.argmax(ratio > 1)])
        self.normal_min = min(self.normal_min, float(normal.min()))
        self.friction_max = max(self.friction_max, float(ratio.max()))

    @property
    def warning(self) -> str:
        """What the model does that no real body would, in one sentence; empty if nothing."""
        if math.isfinite(self.lifts):
            return (
                f"contact would be lost at t = {self.lifts:.4g}, where the normal force becomes "
                f"negative (least: {self.normal_min:.2g} M g); the model keeps the body on the "
                "plane all the same"
            )
        if math.isfinite(self.slips):
            return (
                "rolling without slip needs a coefficient of friction above 1 from "
                f"t = {self.slips:.4g} (largest: {self.friction_max:.3g})"
            )
        return ""
