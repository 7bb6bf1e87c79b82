"""What can be asked of a trajectory: each channel with its unit, its words and its formula."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, partial
from types import CellType, FunctionType, ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError
from rattlesweep.physics import full, reduced
from rattlesweep.physics.attitude import quaternion
from rattlesweep.sweeps.columns import ENERGY, FORCE, RATE, TIME
from rattlesweep.sweeps.config.messages import not_one_of

if TYPE_CHECKING:
    from rattlesweep.integrate.follow.trajectory import Samples
    from rattlesweep.integrate.model import Model
    from rattlesweep.sweeps.launches import Launches


def _arrays(function: Any) -> Callable[..., Any]:
    """Return the formula for arrays: the scalar function's own code with NumPy's square root.

    What it calls is replaced likewise, whether by its name or by that of its module.
    """
    formula = function.py_func
    names = formula.__code__.co_names

    def called(found: Mapping[str, Any]) -> dict[str, Any]:
        # Names of attributes are among them, and may be its own.
        named = {name: found.get(name) for name in names if found.get(name) is not function}
        return {n: _arrays(f) for n, f in named.items() if hasattr(f, "py_func")}

    others = called(formula.__globals__)
    for name in names:
        if isinstance(module := formula.__globals__.get(name), ModuleType):
            others[name] = SimpleNamespace(**called(vars(module)))
    cells = [cell.cell_contents for cell in formula.__closure__ or ()]
    return FunctionType(
        formula.__code__,
        {**formula.__globals__, "sqrt": np.sqrt, **others},
        formula.__name__,
        None,
        tuple(CellType(_arrays(f) if hasattr(f, "py_func") else f) for f in cells),
    )


class Formulas(NamedTuple):
    """Formulas of a model, for arrays."""

    spin: Callable[..., Any]
    energy: Callable[..., Any]
    force: Callable[..., Any]
    touch: Callable[..., Any]


@cache
def formulas(model: Model) -> Formulas:
    """Return spin, energy (what is conserved of it), contact force and point."""
    touch = model.touch or model.contact
    return Formulas(*map(_arrays, (model.spin, model.energy, model.contact, touch)))


@dataclass(frozen=True)
class View:
    """Quantities of a run at the same times, computed when they are first asked for.

    `equations` are those integrated, None for the closed form, with their `constants` and the
    launch's energy; `samples` are theirs, `beside` those of the reduced model.
    """

    model: str
    equations: Model | None
    launches: Launches
    constants: Floats
    energy_0: float
    samples: Samples
    beside: Samples | None

    @property
    def _own(self) -> Formulas | None:
        """Formulas of the run's model; None for the closed form."""
        return None if self.equations is None else formulas(self.equations)

    @cached_property
    def y(self) -> Floats:
        """State, components first."""
        return np.ascontiguousarray(self.samples.y.T)

    @cached_property
    def gh(self) -> Floats:
        """Garcia and Hubbard's spin."""
        return self.launches.gh.spin(self.samples.t)

    @cached_property
    def n(self) -> Floats:
        """Spin."""
        spin: Floats = self.gh if self._own is None else self._own.spin(*self.y)
        return spin

    @cached_property
    def energy(self) -> Floats:
        """Energy."""
        assert self._own is not None
        kept: Floats = self._own.energy(*self.y, *self.constants)
        return kept + self.work

    @property
    def work(self) -> Floats:
        """Work of the dissipation so far."""
        # Behind the five variables that the full model has.
        has = self.model == "full" and len(self.y) > full.N_STATE
        return self.y[full.N_STATE] if has else np.zeros(self.y.shape[1])

    @cached_property
    def vectors(self) -> tuple[Floats, Floats]:
        """Vertical vector and angular velocity."""
        return full.to_vectors(self.y[: full.N_STATE])

    @cached_property
    def modes(self) -> tuple[Floats, Floats]:
        """Energies of pitch and roll.

        With ``e`` an eigenvector of Eq. def-omgpr, ``omega`` without the spin and ``tilt`` the
        angle whose rate it is (Eq. lin-u), the energy of a mode is
        ``((e.J^1/2 omega)^2 + omega_j^2 (e.J^1/2 tilt)^2) / 2``.  The modes are those without spin.
        For GH at n = 0.1 the pitch's energy then swings by 1.4 % within a period, and by 11 % with
        the spin's own part left in omega.
        """
        if self.model == "reduced":
            return self.y[1], self.y[2]
        p, q = self.y[:2]
        u, omega = self.vectors
        a, b = omega[:2] - self.n * u[:2]
        m, bodies = self.launches.modes, self.launches.bodies

        def energy(psi: Floats, frequency: Floats) -> Floats:
            x, y = bodies.alpha * np.cos(psi), bodies.beta * np.sin(psi)
            inertia = bodies.alpha * np.cos(psi) ** 2 + bodies.beta * np.sin(psi) ** 2
            rate, tilt = x * a + y * b, x * q - y * p
            value: Floats = 0.5 * (rate**2 + (frequency * tilt) ** 2) / inertia
            return value

        return energy(m.psi_p, m.omega_p), energy(m.psi_r, m.omega_r)

    @cached_property
    def casimir(self) -> Floats:
        """Casimir invariant, NaN where a mode has no energy at all."""
        m = self.launches.modes
        value = reduced.casimir(*self.modes, m.K_p, m.K_r)
        return np.where(np.isfinite(value), value, np.nan)

    @cached_property
    def contact(self) -> tuple[Floats, Floats, Floats]:
        """Contact point in the body's frame (Eqs. def-xy, def-z)."""
        p, q = self.y[:2]
        assert self._own is not None
        # Where it is does not depend on how it moves.
        still = np.zeros_like(p)
        shape = self.constants[3:7]
        fx, fy, rise, *_ = self._own.touch(p, q, *[still] * 6, *shape)
        return p + fx, q + fy, 1 - rise

    @cached_property
    def force(self) -> tuple[Floats, Floats]:
        """Normal and tangential contact force."""
        assert self._own is not None
        normal, tangential = self._own.force(*self.y, *self.constants)
        return normal, tangential

    @cached_property
    def attitude(self) -> Floats:
        """Quaternion, components first."""
        return quaternion(self.vectors[0], self.samples.extra[:, 0])

    @property
    def reduced(self) -> Floats:
        """State of the reduced model beside, components first."""
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


def choose(names: Iterable[str], model: str) -> tuple[Channel, ...]:
    """Return channels by name; unknown, repeated or foreign ones, or none, are a ConfigError."""
    names = list(names)
    own = [channel.name for channel in CHANNELS.values() if model in channel.models]
    for name in names:
        if name not in CHANNELS:
            raise ConfigError(f"channels: {not_one_of(name, own)}")
        if name not in own:
            raise ConfigError(
                f"channels: {name} is not of the model {model}, which has {', '.join(own)}"
            )
        if names.count(name) > 1:
            raise ConfigError(f"channels: {name} is named {names.count(name)} times; once is right")
    if not names:
        raise ConfigError("channels: none is named; t,n for instance")
    return tuple(CHANNELS[name] for name in names)
