"""Runs before their integration, as arrays: bodies, launches, theory, horizons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.physics import theory
from rattlesweep.physics.si import Units
from rattlesweep.words.quantities import ACTING, COUPLE_CONSTANTS, SURFACE_CONSTANTS


@dataclass(frozen=True)
class Bodies:
    """Bodies of some runs, with the launches, horizons and dissipation that a table
    gives.

    Where these are None or missing, and where `t_end` is NaN, the config applies.
    `f_sd` is NaN unless the body is a shell-dumbbell.
    """

    alpha: Floats
    beta: Floats
    gamma: Floats
    theta: Floats
    phi: Floats
    xi: Floats
    f_sd: Floats
    # Further constants of the surface by name, NaN for a paraboloid.
    further: dict[str, Floats] = field(default_factory=dict)
    n_i: Floats | None = None
    omega_xy0: Floats | None = None
    psi: Floats | None = None
    t_end: Floats | None = None
    omega: Floats | None = None
    u: Floats | None = None
    # Constants of dissipation by name.
    losses: dict[str, Floats] = field(default_factory=dict)
    units: Units | None = None
    # Further columns of runs.
    carried: dict[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def rim(self) -> Floats:
        """Heights of rims in a, NaN without one; no entries if no body has a rim."""
        return self.carried.get("rim", np.zeros(0))

    @classmethod
    def of(cls, columns: Mapping[str, Floats], **others: Any) -> Bodies:
        """Return the bodies of columns, and what else is known of them."""
        known: dict[str, Any] = {
            name: columns[name] for name in columns if name in _COLUMNS
        }
        further = {name: columns[name] for name in SURFACE_CONSTANTS if name in columns}
        losses = {name: columns[name] for name in ACTING if name in columns}
        return cls(**known, further=further, losses=losses, **others)


_COLUMNS = {each.name for each in fields(Bodies)}


@dataclass(frozen=True)
class PreparedRuns:
    """Runs that are ready to be integrated, as arrays with one entry per run."""

    case: Integers
    sample: Integers
    bodies: Bodies

    # Spin and oscillation
    n_i: Floats
    omega_xy0: Floats
    psi: Floats

    # Theory
    modes: theory.Modes
    gh: theory.GarciaHubbard
    n_0: Floats  # spin if all energy were spin
    n_c1: Floats  # Bondi's threshold; NaN if there is none

    # Time at which a run without a reversal ends; not finite if there is none
    horizon: Floats

    # Name of the model that is integrated for `model: full`
    full_model: str
    # Constants of dissipation by name; none without it
    losses: dict[str, Floats] = field(default_factory=dict)
    # Fraction of the initial energy below which a body is dead; no rows without losses
    dead: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def spin_scale(self) -> Floats:
        """Spin to compare others with: ``|n_i|``, or ``n_0`` if that is zero."""
        return np.where(self.n_i == 0, self.n_0, np.abs(self.n_i))

    @property
    def has_couples(self) -> Flags:
        """Whether couples of friction let the spin of a run decay."""
        lossy = np.zeros(len(self.n_i), bool)
        for name in COUPLE_CONSTANTS & self.losses.keys():
            lossy |= self.losses[name] > 0
        return lossy

    @property
    def has_linear_rate(self) -> Flags:
        """Whether small oscillations of a run grow or decay at a rate of theory."""
        linear = np.ones(len(self.n_i), bool)
        for name, values in self.losses.items():
            if not ACTING[name].is_linear:
                linear &= ~(values > 0)
        return linear
