"""The channels of a trajectory: quantities with unit, description and formula."""
# ruff: noqa: D102 - the names are enough

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.physics import full, reduced
from rattlesweep.physics.full import quaternion
from rattlesweep.sweeps.columns import ENERGY, FORCE, RATE, TIME
from rattlesweep.sweeps.config import not_one_of

if TYPE_CHECKING:
    from rattlesweep.integrate.follow import Follower, Samples
    from rattlesweep.physics.si import Units
    from rattlesweep.sweeps.launches import Launches


def contact_point(y: Floats, constants: Floats) -> Floats:
    """Return the point of contact with the plane (Eqs. 4 and 8), shape (3, ...)."""
    p, q = y[:2]
    cxx, cxy, cyy, k = np.append(constants, 0.0)[3:7]  # a paraboloid has k = 0
    x, y0 = p + cxx * p + cxy * q, q + cxy * p + cyy * q
    s = x * p + y0 * q
    rho = np.sqrt(1 + k * s)
    return np.array([x / rho, y0 / rho, 1 - s / (rho + rho**2)])


@dataclass(frozen=True)
class View:
    """Quantities of a run at the same times, each computed on first use."""

    launches: Launches
    constants: Floats
    follower: Follower
    samples: Samples
    beside: Any  # samples of the reduced model at the same times, or None

    @cached_property
    def y(self) -> Floats:
        return np.ascontiguousarray(self.samples.y.T)

    @cached_property
    def seen(self) -> Floats:
        return self.follower.observe(self.samples.y)

    @property
    def work(self) -> Floats:
        return (
            self.y[full.N_STATE]
            if len(self.y) > full.N_STATE
            else np.zeros(self.y.shape[1])
        )

    @cached_property
    def vectors(self) -> tuple[Floats, Floats]:
        return full.to_vectors(self.y[: full.N_STATE])

    @cached_property
    def modes(self) -> tuple[Floats, Floats]:
        """The energies of pitch and roll, the modes of the body without spin.

        Let ``e`` be an eigenvector of Eq. 23, ``omega`` the angular velocity less the
        spin, and ``tilt`` the angle whose rate it is (Eq. 16).  Then the energy of a
        mode is ``((e.J^1/2 omega)^2 + omega_j^2 (e.J^1/2 tilt)^2) / 2``.
        """
        if len(self.y) < full.N_STATE:  # the reduced model
            return self.y[1], self.y[2]
        u, omega = self.vectors
        wx, wy = omega[:2] - self.seen[0] * u[:2]
        m, bodies = self.launches.modes, self.launches.bodies

        def energy(psi: Floats, frequency: Floats) -> Any:
            x, y = bodies.alpha * np.cos(psi), bodies.beta * np.sin(psi)
            inertia = bodies.alpha * np.cos(psi) ** 2 + bodies.beta * np.sin(psi) ** 2
            rate, tilt = x * wx + y * wy, x * self.y[1] - y * self.y[0]
            return 0.5 * (rate**2 + (frequency * tilt) ** 2) / inertia

        return energy(m.psi_p, m.omega_p), energy(m.psi_r, m.omega_r)

    @property
    def casimir(self) -> Floats:
        m = self.launches.modes
        value = reduced.casimir(*self.modes, m.K_p, m.K_r)
        return np.where(np.isfinite(value), value, np.nan)


@dataclass(frozen=True)
class Channel:
    """One column of a trajectory."""

    name: str
    unit: str
    description: str
    models: tuple[str, ...]  # the models that have it
    of: Callable[[View], Floats]
    needs: str = ""  # "attitude" or "reduced" if these must be integrated, too
    size: float = 1.0  # of the unit, in the units of the body


FULL, BOTH = ("full",), ("full", "reduced")


def _components(
    names: str, unit: str, words: str, of: Callable[[View], Any], needs: str = ""
) -> Iterator[Channel]:
    """Yield the components of a vector; ``{}`` in `words` becomes their last letter."""
    for k, name in enumerate(names.split()):
        part = partial(lambda view, k: of(view)[k], k=k)
        yield Channel(name, unit, words.format(name[-1]), FULL, part, needs)


CHANNELS: dict[str, Channel] = {
    channel.name: channel
    for channel in (
        Channel("t", TIME, "time", BOTH, lambda v: v.samples.t),
        Channel("n", RATE, "spin u . omega", BOTH, lambda v: v.seen[0]),
        *_components(
            "u_x u_y u_z",
            "1",
            "vertical unit vector, body's {}",
            lambda v: v.vectors[0],
        ),
        *_components(
            "omega_x omega_y omega_z",
            RATE,
            "angular velocity, body's {}",
            lambda v: v.vectors[1],
        ),
        Channel("energy", ENERGY, "energy", BOTH, lambda v: v.seen[1] + v.work),
        Channel(
            "energy_drift",
            "1",
            "energy less the work over the launch's energy, minus 1",
            BOTH,
            lambda v: v.seen[1] / v.follower.energy_0 - 1,
        ),
        Channel(
            "work", ENERGY, "work of the dissipation, negative", FULL, lambda v: v.work
        ),
        Channel(
            "E_p",
            ENERGY,
            "energy of the pitch, not averaged over its period",
            BOTH,
            lambda v: v.modes[0],
        ),
        Channel(
            "E_r",
            ENERGY,
            "energy of the roll, not averaged over its period",
            BOTH,
            lambda v: v.modes[1],
        ),
        Channel(
            "C_I",
            "1",
            "Casimir invariant ln(E_p)/K_p + ln(E_r)/K_r",
            BOTH,
            lambda v: v.casimir,
        ),
        *_components(
            "contact_x contact_y contact_z",
            "a",
            "contact point from the centre of mass, body's {}",
            lambda v: contact_point(v.y, v.constants),
        ),
        *_components(
            "trace_x trace_y",
            "a",
            "contact point on the plane, from the first one",
            lambda v: v.samples.extra.T[1:],
            "attitude",
        ),
        Channel(
            "F_normal",
            FORCE,
            "contact force along the vertical",
            FULL,
            lambda v: v.seen[2],
        ),
        Channel(
            "F_tangential",
            FORCE,
            "contact force in the plane",
            FULL,
            lambda v: v.seen[3],
        ),
        Channel(
            "yaw",
            "rad",
            "heading of the body's x axis from the start, turns counted",
            FULL,
            lambda v: v.samples.extra[:, 0],
            "attitude",
        ),
        *_components(
            "q0 q1 q2 q3",
            "1",
            "attitude, unit quaternion from body to plane, scalar first",
            lambda v: quaternion(v.vectors[0], v.samples.extra[:, 0]),
            "attitude",
        ),
        Channel(
            "n_reduced",
            RATE,
            "spin of the reduced model beside",
            FULL,
            lambda v: v.beside.y[:, 0],
            "reduced",
        ),
        Channel(
            "n_gh",
            RATE,
            "spin of Garcia and Hubbard's solution",
            BOTH,
            lambda v: v.launches.gh.spin(v.samples.t),
        ),
    )
}


def choose(names: Iterable[str], model: str) -> tuple[Channel, ...]:
    """Return the channels of a model by their names; raise a ConfigError for others."""
    own = [channel.name for channel in CHANNELS.values() if model in channel.models]
    names = list(dict.fromkeys(names))
    if unknown := [name for name in names if name not in own]:
        raise ConfigError(
            f"channels of the model {model}: {not_one_of(unknown[0], own)}"
        )
    return tuple(CHANNELS[name] for name in names)


def in_si(channels: Iterable[Channel], units: Units | None) -> dict[str, Channel]:
    """Return by their plain names the channels that exist in SI units, such as ``t_s``
    of ``t``.
    """
    found, sizes = {}, {} if units is None else units.sizes
    for channel in channels:
        size, unit = sizes.get(channel.unit, (math.nan, ""))
        if math.isfinite(size):  # the mass may be unknown
            if channel.name in ("n", "n_reduced", "n_gh"):
                size, unit = size * 30 / math.pi, "rpm"
            name = f"{channel.name}_{unit.replace('/', '_')}"
            found[channel.name] = replace(channel, name=name, unit=unit, size=size)
    return found
