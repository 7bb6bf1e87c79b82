"""The bodies of a sweep's runs, and what a source of them can do."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.arrays import Floats, Integers


@dataclass(frozen=True)
class Scale:
    """Units of bodies in SI units, arrays of one length: ``M`` in kg, ``a`` in m, and gravity.

    The mass is NaN where it is not known.
    """

    mass: Floats
    length: Floats
    gravity: Floats

    @property
    def second(self) -> Floats:
        """``sqrt(a/g)`` in seconds."""
        return np.sqrt(self.length / self.gravity)

    def natural(self, value: float | Floats, kind: str) -> Floats:
        """Return quantities that are given in SI units in those of the bodies.

        `kind` is one of :data:`rattlesweep.units.KINDS`.
        """
        if kind == "spin":
            return value * self.second
        units = {"time": self.second, "length": self.length,
                 "energy": self.mass * self.gravity * self.length,
                 "torque per spin": self.mass * self.length**2 / self.second}  # fmt: skip
        return np.asarray(value / units[kind])


@dataclass(frozen=True)
class Bodies:
    """Parameters of the bodies of some runs, and what a table says of these runs beside them.

    All arrays have one length.  What is None, and NaN in `t_end`, is for the config to say.

    Attributes
    ----------
    alpha, beta, gamma, theta, phi, xi : ndarray
        As for :class:`rattlesweep.physics.body.Rattleback`.
    f_sd : ndarray
        ``I_yy / I_zz`` of shell-dumbbell bodies; NaN for others.
    c : ndarray or None
        Vertical semi-axes of ellipsoids, NaN for paraboloids among them; None: all paraboloids.
    n_i, omega_xy0, psi, t_end, omega, u, sigma, rolling : ndarray or None
        Launches, horizons and dissipation; a full state has `omega` and `u` of shape (runs, 3).
    scale : Scale or None
        Units of bodies whose size is known.
    carried : dict of ndarray
        Columns of a table that the runs get too.
    """

    alpha: Floats
    beta: Floats
    gamma: Floats
    theta: Floats
    phi: Floats
    xi: Floats
    f_sd: Floats
    c: Floats | None = None
    n_i: Floats | None = None
    omega_xy0: Floats | None = None
    psi: Floats | None = None
    t_end: Floats | None = None
    omega: Floats | None = None
    u: Floats | None = None
    sigma: Floats | None = None
    rolling: Floats | None = None
    scale: Scale | None = None
    carried: dict[str, NDArray[Any]] = field(default_factory=dict)


class Source(Protocol):
    """A source of bodies; it can be pickled, and gives the same bodies in another process."""

    @property
    def samples(self) -> int:
        """Samples of each case."""

    @property
    def fields(self) -> tuple[pa.Field, ...]:
        """Columns that the runs have because of the bodies."""

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some runs.

        `target` is that of each run, or of all of them, and NaN without one; `sample` has the
        number of each run's sample, in any order.
        """
