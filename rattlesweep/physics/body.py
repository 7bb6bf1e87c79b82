"""Bodies: six parameters, the shell-dumbbell map, the preset GH, the mirror image."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

T = TypeVar("T", float, "Floats")

PARAMETERS = ("alpha", "beta", "gamma", "theta", "phi", "xi")

# Relative; the shell-dumbbell bodies have I_zz = I_xx + I_yy exactly, but for rounding.
_TRIANGLE = 1e-12


@dataclass(frozen=True)
class Rattleback:
    """A rattleback (Eqs. def-abg, def-z); units M = a = g = 1.

    Parameters
    ----------
    alpha, beta, gamma : float
        ``I_xx + 1``, ``I_yy + 1`` and ``I_zz`` in ``M a^2``; ``alpha > beta > 1``.
    theta, phi : float
        Principal curvatures at the bottom, in ``1/a``; ``0 < phi < theta < 1``.
    xi : float
        Skew angle in radians, in (-pi/2, 0); positive for the mirror image.

    Raises
    ------
    ValueError
        If a parameter is out of its range, or if no body has such an inertia.
    """

    alpha: float
    beta: float
    gamma: float
    theta: float
    phi: float
    xi: float

    def __post_init__(self) -> None:
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        for _, sentence in violations(**values):
            raise ValueError(sentence)

    @classmethod
    def gh(cls) -> Rattleback:
        """The body of Garcia and Hubbard (1988), Table I."""
        return cls(13.04, 1.522, 12.28, 0.6429, 0.0360, -math.radians(1.72))

    @classmethod
    def shell_dumbbell(
        cls, *, gamma: float, f_sd: float, theta: float, phi: float, xi: float
    ) -> Rattleback:
        """A light shell with two dumbbells; ``f_sd = I_yy / I_zz`` in (0, 0.5)."""
        if not 0 < f_sd < 0.5:
            raise ValueError(f"f_sd is {f_sd:g}; it must lie between 0 and 0.5")
        return cls(*shell_dumbbell(gamma, f_sd), gamma, theta, phi, xi)

    def mirrored(self) -> Rattleback:
        """Reflection in the x-z plane: the steady and the unsteady direction change places."""
        return Rattleback(self.alpha, self.beta, self.gamma, self.theta, self.phi, -self.xi)


def shell_dumbbell(gamma: T, f_sd: T) -> tuple[T, T]:
    """``alpha`` and ``beta`` of shell-dumbbell bodies; the sampler compiles it for scalars."""
    return (1 - f_sd) * gamma + 1, f_sd * gamma + 1


def violations(
    alpha: ArrayLike,
    beta: ArrayLike,
    gamma: ArrayLike,
    theta: ArrayLike,
    phi: ArrayLike,
    xi: ArrayLike,
) -> Iterator[tuple[int, str]]:
    """What is wrong with bodies: the first offender of each rule, as (place, sentence)."""
    alpha, beta, gamma, theta, phi, xi = (
        np.atleast_1d(np.asarray(x, float)) for x in (alpha, beta, gamma, theta, phi, xi)
    )
    i_xx, i_yy = alpha - 1, beta - 1
    slack = _TRIANGLE * (alpha + gamma)
    both = "0 < phi < theta < 1 is needed"
    rules: tuple[tuple[NDArray[np.bool_], Callable[[int], str]], ...] = (
        (np.isfinite(alpha + beta + gamma + theta + phi + xi),
         lambda i: "a parameter is not a finite number"),
        (phi > 0, lambda i: f"phi is {phi[i]:g}; {both}"),
        (theta < 1, lambda i: f"theta is {theta[i]:g}; {both}"),
        (phi < theta, lambda i: f"phi {phi[i]:g} is not below theta {theta[i]:g}; {both}"),
        (beta > 1, lambda i: f"beta is {beta[i]:g}; alpha > beta > 1 is needed"),
        (alpha > beta,
         lambda i: f"alpha {alpha[i]:g} is not above beta {beta[i]:g}; alpha > beta > 1 is needed"),
        (gamma > 0, lambda i: f"gamma is {gamma[i]:g}; it must be positive"),
        ((xi != 0) & (np.abs(xi) < np.pi / 2),
         lambda i: f"xi is {xi[i]:g} rad; -pi/2 < xi < 0 is needed, or xi > 0 for a mirror image"),
        (i_xx <= i_yy + gamma + slack,
         lambda i: f"no body has this inertia: I_xx = alpha - 1 = {i_xx[i]:g} exceeds "
                   f"I_yy + I_zz = {i_yy[i] + gamma[i]:g}"),
        (gamma <= i_xx + i_yy + slack,
         lambda i: f"no body has this inertia: I_zz = gamma = {gamma[i]:g} exceeds "
                   f"I_xx + I_yy = {i_xx[i] + i_yy[i]:g}"),
    )  # fmt: skip
    for good, sentence in rules:
        bad = np.flatnonzero(~good)
        if bad.size:
            place = int(bad[0])
            yield place, sentence(place)
