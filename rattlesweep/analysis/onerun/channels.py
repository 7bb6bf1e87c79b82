"""Quantities of a trajectory: each channel with its unit, its words and its formula."""
# ruff: noqa: D102 - names and types say it

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
    from rattlesweep.integrate.follow import Samples
    from rattlesweep.physics.si import Units
    from rattlesweep.sweeps.launches import Launches


def _touch(y: Floats, constants: Floats) -> tuple[Floats, Floats]:
    """Return the contact point (Eqs. def-xy, def-z) and its rate, shape (3, ...) each."""
    p, q, a, b, c = y[: full.N_STATE]
    cxx, cxy, cyy, k = np.append(constants, 0.0)[3:7]  # no k: a paraboloid
    dp, dq, _ = full.slope_rate.py_func(p, q, a, b, c)
    x, y0 = p + cxx * p + cxy * q, q + cxy * p + cyy * q
    s, rho_rate = x * p + y0 * q, k * (x * dp + y0 * dq)
    rho = np.sqrt(1 + k * s)
    rho_rate = rho_rate / rho
    at = np.array([x / rho, y0 / rho, 1 - s / (rho + rho**2)])
    dx = (dp + cxx * dp + cxy * dq - at[0] * rho_rate) / rho
    dy = (dq + cxy * dp + cyy * dq - at[1] * rho_rate) / rho
    return at, np.array([dx, dy, -p * dx - q * dy])  # in the plane


def spin(y: Floats) -> Floats:
    """Return the spin of states of the full model, shape (5 or more, ...)."""
    u, omega = full.to_vectors(y[: full.N_STATE])
    n: Floats = (u * omega).sum(axis=0)
    return n


def energy(y: Floats, constants: Floats) -> Floats:
    """Return the energy of states of the full model; the potential is a sum of small terms."""
    p, q = y[:2]
    cxx, cxy, cyy, k = np.append(constants, 0.0)[3:7]
    at, omega = _touch(y, constants)[0], y[2 : full.N_STATE]
    v = np.cross(at, omega, axis=0)
    tilt, bent = p * p + q * q, cxx * p * p + 2 * cxy * p * q + cyy * q * q
    root = np.sqrt(1 + tilt)
    half = (tilt + bent) / (1 + np.sqrt(1 + k * (tilt + bent)))
    potential = (bent + (tilt / (1 + root)) ** 2 - k * half**2) / root
    value: Floats = 0.5 * (
        np.tensordot(constants[:3], omega**2, 1) + (v**2).sum(axis=0) + potential
    )
    return value


def contact_force(y: Floats, constants: Floats) -> tuple[Floats, Floats]:
    """Return the normal and the tangential contact force (Eq. em-1) of states of the full model.

    The angular acceleration solves Eq. diff-omega,
    ``(I + r^2 - r r^T) domega/dt = r x (dr/dt x omega + omega x v + u) - omega x I omega - L``
    with ``v = r x omega``. The couple ``L`` of the dissipation is ``sigma omega``, and the rolling
    resistance against the part ``h`` of omega in the plane, which is linear in the force itself.
    """
    u, omega = full.to_vectors(y[: full.N_STATE])
    r, rate = _touch(y, constants)
    inertia = constants[:3, None]
    sigma, lever, eps = constants[7:10] if len(constants) > 7 else (0.0, 0.0, 0.0)

    cross = partial(np.cross, axis=0)

    def solve(torque: Floats) -> Floats:  # Sherman and Morrison's formula
        square = (r**2).sum(axis=0)
        d = inertia + square
        along = (r * torque / d).sum(axis=0) / (inertia * r**2 / d).sum(axis=0)
        rate: Floats = (torque + square * along * r) / d
        return rate

    v = cross(r, omega)
    known = cross(rate, omega) + cross(omega, v)  # of the acceleration dv/dt
    h = omega - (u * omega).sum(axis=0) * u
    torque = cross(r, known + u) - cross(omega, inertia * omega) - sigma * omega
    turning = solve(torque)
    if lever:
        slowed = solve(h)
        up = 1 + (u * (known + cross(r, turning))).sum(axis=0)
        change = (u * cross(r, slowed)).sum(axis=0)
        resisting = lever * up / (np.sqrt((h**2).sum(axis=0) + eps**2) + lever * change)
        turning = turning - np.maximum(resisting, 0) * slowed
    acceleration = known + cross(r, turning)
    lift = (u * acceleration).sum(axis=0)
    return 1 + lift, np.sqrt(((acceleration - lift * u) ** 2).sum(axis=0))


@dataclass(frozen=True)
class View:
    """Quantities of a run at the same times, computed when they are first asked for."""

    model: str
    launches: Launches
    constants: Floats
    energy_0: float
    samples: Samples
    beside: Samples | None  # of the reduced model

    @cached_property
    def y(self) -> Floats:
        return np.ascontiguousarray(self.samples.y.T)

    @cached_property
    def gh(self) -> Floats:
        return self.launches.gh.spin(self.samples.t)

    @cached_property
    def n(self) -> Floats:
        if self.model == "full":
            return spin(self.y)
        return self.gh if self.model == "gh" else self.y[0]

    @cached_property
    def energy(self) -> Floats:
        if self.model == "full":
            return energy(self.y, self.constants)
        value: Floats = 0.5 * self.constants[2] * self.y[0] ** 2 + self.y[1] + self.y[2]
        return value

    @property
    def work(self) -> Floats:
        has = self.model == "full" and len(self.y) > full.N_STATE
        return self.y[full.N_STATE] if has else np.zeros(self.y.shape[1])

    @cached_property
    def vectors(self) -> tuple[Floats, Floats]:
        return full.to_vectors(self.y[: full.N_STATE])

    @cached_property
    def modes(self) -> tuple[Floats, Floats]:
        """Energies of pitch and roll, whose modes are those without spin.

        With ``e`` an eigenvector of Eq. def-omgpr, ``omega`` without the spin and ``tilt`` the
        angle whose rate it is (Eq. lin-u), the energy of a mode is
        ``((e.J^1/2 omega)^2 + omega_j^2 (e.J^1/2 tilt)^2) / 2``.
        """
        if self.model == "reduced":
            return self.y[1], self.y[2]
        u, omega = self.vectors
        wx, wy = omega[:2] - self.n * u[:2]
        m, bodies = self.launches.modes, self.launches.bodies

        def energy(psi: Floats, frequency: Floats) -> Floats:
            x, y = bodies.alpha * np.cos(psi), bodies.beta * np.sin(psi)
            inertia = bodies.alpha * np.cos(psi) ** 2 + bodies.beta * np.sin(psi) ** 2
            rate, tilt = x * wx + y * wy, x * self.y[1] - y * self.y[0]
            value: Floats = 0.5 * (rate**2 + (frequency * tilt) ** 2) / inertia
            return value

        return energy(m.psi_p, m.omega_p), energy(m.psi_r, m.omega_r)

    @property
    def casimir(self) -> Floats:
        m = self.launches.modes
        value = reduced.casimir(*self.modes, m.K_p, m.K_r)
        return np.where(np.isfinite(value), value, np.nan)

    @cached_property
    def contact(self) -> Floats:
        return _touch(self.y, self.constants)[0]

    @cached_property
    def force(self) -> tuple[Floats, Floats]:
        return contact_force(self.y, self.constants)

    @cached_property
    def attitude(self) -> Floats:
        return quaternion(self.vectors[0], self.samples.extra[:, 0])

    @property
    def reduced(self) -> Floats:
        assert self.beside is not None
        return self.beside.y.T


@dataclass(frozen=True)
class Channel:
    """One column of a trajectory."""

    name: str
    unit: str
    description: str
    models: tuple[str, ...]  # that have it
    of: Callable[[View], Floats]
    needs: str = ""  # "attitude" or "reduced" where that must be integrated too
    size: float = 1.0  # of the unit, in the units of the body


FULL, BOTH, ALL = ("full",), ("full", "reduced"), ("full", "reduced", "gh")


def _components(
    names: str, unit: str, words: str, of: Callable[[View], Any], needs: str = ""
) -> Iterator[Channel]:
    """Make channels of the components of a quantity; ``{}`` is their last letter."""
    for k, name in enumerate(names.split()):
        part = partial(lambda view, k: of(view)[k], k=k)
        yield Channel(name, unit, words.format(name[-1]), FULL, part, needs)


CHANNELS: dict[str, Channel] = {
    channel.name: channel
    for channel in (
        Channel("t", TIME, "time", ALL, lambda v: v.samples.t),
        Channel("n", RATE, "spin u . omega", ALL, lambda v: v.n),
        *_components("u_x u_y u_z", "1", "vertical unit vector, body's {}",
                     lambda v: v.vectors[0]),
        *_components("omega_x omega_y omega_z", RATE, "angular velocity, body's {}",
                     lambda v: v.vectors[1]),
        Channel("energy", ENERGY, "energy", BOTH, lambda v: v.energy),
        Channel("energy_drift", "1", "energy less the work over the launch's energy, minus 1", BOTH,
                lambda v: (v.energy - v.work) / v.energy_0 - 1),
        Channel("work", ENERGY, "work of the dissipation, negative", FULL, lambda v: v.work),
        Channel("E_p", ENERGY, "energy of the pitch, not averaged over its period", BOTH,
                lambda v: v.modes[0]),
        Channel("E_r", ENERGY, "energy of the roll, not averaged over its period", BOTH,
                lambda v: v.modes[1]),
        Channel("C_I", "1", "Casimir invariant ln(E_p)/K_p + ln(E_r)/K_r", BOTH,
                lambda v: v.casimir),
        *_components("contact_x contact_y contact_z", "a",
                     "contact point from the centre of mass, body's {}", lambda v: v.contact),
        *_components("trace_x trace_y", "a", "contact point on the plane, from the first one",
                     lambda v: v.samples.extra.T[1:], "attitude"),
        Channel("F_normal", FORCE, "contact force along the vertical", FULL, lambda v: v.force[0]),
        Channel("F_tangential", FORCE, "contact force in the plane", FULL, lambda v: v.force[1]),
        Channel("yaw", "rad", "heading of the body's x axis from the start, turns counted", FULL,
                lambda v: v.samples.extra[:, 0], "attitude"),
        *_components("q0 q1 q2 q3", "1",
                     "attitude, unit quaternion from body to plane, scalar first",
                     lambda v: v.attitude, "attitude"),
        Channel("n_reduced", RATE, "spin of the reduced model beside", FULL,
                lambda v: v.reduced[0], "reduced"),
        Channel("E_p_reduced", ENERGY, "energy of the pitch in the reduced model", FULL,
                lambda v: v.reduced[1], "reduced"),
        Channel("E_r_reduced", ENERGY, "energy of the roll in the reduced model", FULL,
                lambda v: v.reduced[2], "reduced"),
        Channel("n_gh", RATE, "spin of Garcia and Hubbard's solution", ALL, lambda v: v.gh),
    )
}  # fmt: skip

SUFFIXES = {"s": "s", "rad/s": "rad_s", "rpm": "rpm", "m": "m", "J": "J", "N": "N"}


def choose(names: Iterable[str], model: str) -> tuple[Channel, ...]:
    """Return channels of a model by name."""
    own = [channel.name for channel in CHANNELS.values() if model in channel.models]
    names = list(dict.fromkeys(names))
    for name in names:
        if name not in own:
            raise ConfigError(f"channels of the model {model}: {not_one_of(name, own)}")
    return tuple(CHANNELS[name] for name in names)


def in_si(channels: Iterable[Channel], units: Units | None) -> dict[str, Channel]:
    """Return the channels that have an SI unit, such as ``t_s`` of ``t``, by their plain names."""
    found = {}
    for channel in channels:
        if units is not None and channel.unit in units.sizes:
            size, unit = units.sizes[channel.unit]
            if channel.name in ("n", "n_reduced", "n_gh"):
                size, unit = size * 30 / math.pi, "rpm"
            name = f"{channel.name}_{SUFFIXES[unit]}"
            found[channel.name] = replace(channel, name=name, unit=unit, size=size)
    return found
