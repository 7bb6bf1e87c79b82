"""The bodies of a sweep's runs, and what a source of them can do."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

from numpy.typing import NDArray

from rattlesweep.arrays import Floats, Integers


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
    second : ndarray or None
        ``sqrt(a/g)`` in seconds, of bodies whose size is known.
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
    second: Floats | None = None
    carried: dict[str, NDArray[Any]] = field(default_factory=dict)


class Source(Protocol):
    """A source of bodies; it can be pickled, and gives the same bodies in another process."""

    @property
    def samples(self) -> int:
        """Samples of each case."""

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some runs.

        Parameters
        ----------
        target : float or ndarray
            Target of each run, or of all of them; NaN without one.
        sample : ndarray of int
            Sample number of each run, in any order.
        """
