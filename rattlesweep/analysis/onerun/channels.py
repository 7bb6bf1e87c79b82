"""The channels of a trajectory: quantities with unit, description and formula."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from rattlesweep.analysis.derived import si_of
from rattlesweep.arrays import Flags, Floats
from rattlesweep.kernel.state.fields import SLIP_ANGLE, SLIP_SPEED, SLIP_WORK
from rattlesweep.motion.chart import ANYWHERE
from rattlesweep.motion.rotations import HEADING, PLACE, QUATERNION
from rattlesweep.physics import full, reduced
from rattlesweep.physics.full import quaternion
from rattlesweep.physics.readings import (
    Shape,
    mode_energies,
    placed_contact,
)
from rattlesweep.words.errors import ConfigError, not_one_of
from rattlesweep.words.quantities import ENERGY, FORCE, LENGTH, RATE, SPEED, TIME

if TYPE_CHECKING:
    from rattlesweep.kernel.abreast import RunAbreast
    from rattlesweep.kernel.follow import Follower
    from rattlesweep.kernel.recorder import Samples
    from rattlesweep.physics.si import Units
    from rattlesweep.rows.prepared import PreparedRuns

_FULL = ("full",)
BOTH = ("full", "reduced")
# The variables of the models, which are the columns of a section by default.
VARIABLES = {
    "full": ("n", "omega_x", "omega_y", "omega_z", "u_x", "u_y", "u_z"),
    "reduced": ("n", "E_p", "E_r"),
}


@dataclass(frozen=True)
class View:
    """Quantities of a run at the same times, each computed on first use."""

    launches: PreparedRuns
    follower: Follower | RunAbreast
    samples: Samples
    beside: Samples | None  # of the reduced model at the same times

    @cached_property
    def y(self) -> Floats:
        """The states, shape (variables, times)."""
        return np.ascontiguousarray(self.samples.y.T)

    @property
    def is_anywhere(self) -> bool:
        """Whether the variables are those of a body in any position."""
        return self.follower.model.chart is ANYWHERE

    @cached_property
    def observed(self) -> Floats:
        """What the follower observes, shape (5, times): see `Follower.observe`."""
        return self.follower.observe(self.samples)

    @property
    def work(self) -> Floats:
        """The work of the dissipation: of couples, a variable, and of slides."""
        of_slides: Floats = self.samples.slip[:, SLIP_WORK]
        model = self.follower.model
        if "work" in model.components:
            of_slides = of_slides + self.y[model.column("work")]
        return of_slides

    @property
    def held(self) -> Flags:
        """Whether pivoting friction holds the spin at zero."""
        if self.follower.model.pivot is None:
            return np.zeros(len(self.samples.t), bool)
        return (self.samples.sense == 0) & ~self.slides

    @property
    def slides(self) -> Flags:
        """Whether the contact point slides."""
        return self.samples.slip[:, SLIP_SPEED] > 0

    @property
    def viscous_slip(self) -> tuple[Floats, Floats]:
        """The velocity of a foot that slips, along ``h_1`` and ``h_2``."""
        model = self.follower.model
        return self.y[model.column("slip_1")], self.y[model.column("slip_2")]

    @property
    def slip_speed(self) -> Floats:
        """The speed of the contact point on the plane."""
        if self.follower.model.slip is None:
            return self.samples.slip[:, SLIP_SPEED]
        first, second = self.viscous_slip
        return np.hypot(first, second)

    @property
    def slip_angle(self) -> Floats:
        """The direction of sliding from -pi to pi, NaN where the body rolls."""
        if self.follower.model.slip is not None:
            first, second = self.viscous_slip
            return np.arctan2(second, first)
        angle = self.samples.slip[:, SLIP_ANGLE]
        turns = np.round(angle / (2 * np.pi))
        return np.where(self.slides, angle - 2 * np.pi * turns, np.nan)

    @cached_property
    def vectors(self) -> tuple[Floats, Floats]:
        """Vertical unit vector and angular velocity, both of shape (3, times)."""
        if self.is_anywhere:
            return self.y[:3] / np.linalg.norm(self.y[:3], axis=0), self.y[3:6]
        return full.to_vectors(self.y[: full.N_STATE])

    @property
    def slopes(self) -> tuple[Floats, Floats]:
        """The slopes p = u_x/u_z and q = u_y/u_z, both of shape (times,)."""
        if self.is_anywhere:
            return self.y[0] / self.y[2], self.y[1] / self.y[2]
        return self.y[0], self.y[1]

    @property
    def contact(self) -> Floats:
        """The contact point from the centre of mass, shape (3, times)."""
        constants = self.follower.constants
        shape = Shape(*(constants[name] for name in Shape._fields if name in constants))
        point = placed_contact(*self.slopes, shape)
        if not self.is_anywhere:
            return point
        # An ellipsoid upside down stands on the opposite point, seen from its centre.
        centre = np.array([[0.0], [0.0], [1.0 - 1.0 / shape.k]])
        return np.where(self.y[2] < 0, point, 2 * centre - point)

    @property
    def axis_angle(self) -> Floats:
        """The angle of the long axis from above, turns counted, shape (times,).

        The axis of curvature phi lies at the angle xi from the y axis of inertia.
        """
        xi = self.launches.bodies.xi
        x = -np.sin(xi)
        y = np.cos(xi)
        q0, q1, q2, q3 = self.attitude
        east = (1 - 2 * (q2 * q2 + q3 * q3)) * x + 2 * (q1 * q2 - q0 * q3) * y
        north = 2 * (q1 * q2 + q0 * q3) * x + (1 - 2 * (q1 * q1 + q3 * q3)) * y
        folded = np.arctan2(north, east)
        # From above, the axis is behind the x axis by this, whose turns are counted.
        behind = math.pi / 2 + xi
        heading = self.samples.extra[:, HEADING]
        turns = np.round((heading - behind - folded) / math.tau)
        return folded + math.tau * turns

    @property
    def attitude(self) -> Floats:
        """The unit quaternions from body to plane, shape (4, times)."""
        extra = self.samples.extra.T
        if self.is_anywhere:
            return extra[QUATERNION]
        return quaternion(self.vectors[0], extra[HEADING])

    @cached_property
    def modes(self) -> tuple[Floats, Floats]:
        """The energies of pitch and roll."""
        if self.follower.model.chart is None:  # the reduced model has them as variables
            return self.y[1], self.y[2]
        u, omega = self.vectors
        oscillation = omega[:2] - self.observed[0] * u[:2]
        bodies = self.launches.bodies
        return mode_energies(
            self.launches.modes,
            moments=(bodies.alpha, bodies.beta),
            slope=self.slopes,
            rate=(oscillation[0], oscillation[1]),
        )

    @property
    def casimir(self) -> Floats:
        """The Casimir invariant, NaN where an energy is zero."""
        modes = self.launches.modes
        value = reduced.casimir(*self.modes, modes.K_p, modes.K_r)
        return np.where(np.isfinite(value), value, np.nan)

    @property
    def spin_beside(self) -> Floats:
        """The spin of the reduced model."""
        assert self.beside is not None
        return self.beside.y[:, 0]


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
    conserved: tuple[str, ...] = ()  # the models that keep it where nothing dissipates

    def __reduce__(self) -> tuple[Callable[..., Channel], tuple[object, ...]]:
        # Formulas cannot be pickled, but are found again by the name of their channel.
        plain = next(c for c in CHANNELS.values() if c.of is self.of)
        return _channel_again, (plain.name, self.name, self.unit, self.size)


def _components(
    names: str,
    unit: str,
    description: str,
    vector: Callable[[View], Floats],
    needs: str = "",
) -> Iterator[Channel]:
    """Yield the components of a vector; ``{}`` in a description is their letter."""
    for k, name in enumerate(names.split()):
        component = partial(lambda view, k: vector(view)[k], k=k)
        yield Channel(name, unit, description.format(name[-1]), _FULL, component, needs)


def _channels() -> Iterator[Channel]:
    """Yield all channels, in the order of ``--channels list``."""
    yield Channel("t", TIME, "time", BOTH, lambda view: view.samples.t)
    yield Channel("n", RATE, "spin u . omega", BOTH, lambda view: view.observed[0])
    yield from _components(
        "u_x u_y u_z",
        "1",
        "vertical unit vector, body's {}",
        lambda view: view.vectors[0],
    )
    yield from _components(
        "omega_x omega_y omega_z",
        RATE,
        "angular velocity, body's {}",
        lambda view: view.vectors[1],
    )
    yield Channel(
        "energy",
        ENERGY,
        "energy",
        BOTH,
        lambda view: view.observed[1] + view.work,
        conserved=BOTH,
    )
    yield Channel(
        "energy_drift",
        "1",
        "energy less the work over the launch's energy, minus 1",
        BOTH,
        lambda view: view.observed[1] / view.follower.energy_0 - 1,
    )
    yield Channel(
        "work",
        ENERGY,
        "work of the dissipation, negative",
        BOTH,
        lambda view: view.work,
    )
    yield Channel(
        "E_p",
        ENERGY,
        "energy of the pitch, not averaged over its period",
        BOTH,
        lambda view: view.modes[0],
    )
    yield Channel(
        "E_r",
        ENERGY,
        "energy of the roll, not averaged over its period",
        BOTH,
        lambda view: view.modes[1],
    )
    yield Channel(
        "C_I",
        "1",
        "Casimir invariant ln(E_p)/K_p + ln(E_r)/K_r",
        BOTH,
        lambda view: view.casimir,
        conserved=("reduced",),
    )
    yield Channel(
        "casimir",
        "1",
        "the same as C_I, by the name of record: [casimir]",
        BOTH,
        lambda view: view.casimir,
        conserved=("reduced",),
    )
    yield from _components(
        "contact_x contact_y contact_z",
        LENGTH,
        "contact point from the centre of mass, body's {}",
        lambda view: view.contact,
    )
    yield from _components(
        "trace_x trace_y",
        LENGTH,
        "contact point on the plane, from the first one",
        lambda view: view.samples.extra.T[PLACE],
        "attitude",
    )
    yield Channel(
        "F_normal",
        FORCE,
        "contact force along the vertical",
        _FULL,
        lambda view: view.observed[2],
    )
    yield Channel(
        "F_tangential",
        FORCE,
        "contact force in the plane",
        _FULL,
        lambda view: view.observed[3],
    )
    yield Channel(
        "friction_ratio",
        "1",
        "tangential over normal force of the contact",
        _FULL,
        lambda view: view.observed[3] / view.observed[2],
    )
    yield Channel(
        "sliding",
        "1",
        "1 where the contact point slides, else 0",
        _FULL,
        lambda view: view.slides.astype(float),
    )
    yield Channel(
        "held",
        "1",
        "1 where friction holds the spin at zero, else 0",
        BOTH,
        lambda view: view.held.astype(float),
    )
    yield Channel(
        "pivot_torque",
        ENERGY,
        "torque of pivoting friction along the vertical",
        BOTH,
        lambda view: view.observed[4],
    )
    yield Channel(
        "v_slip",
        SPEED,
        "speed of the contact point on the plane",
        _FULL,
        lambda view: view.slip_speed,
    )
    yield Channel(
        "slip_angle",
        "rad",
        "direction of sliding from the horizontal part of the body's x axis",
        _FULL,
        lambda view: view.slip_angle,
    )
    yield Channel(
        "yaw",
        "rad",
        "heading of the body's x axis from the start, turns counted",
        _FULL,
        lambda view: view.samples.extra[:, HEADING],
        "attitude",
    )
    yield Channel(
        "angle_deg",
        "deg",
        "angle of the long axis seen from above, counterclockwise, turns counted",
        _FULL,
        lambda view: np.degrees(view.axis_angle),
        "attitude",
    )
    yield from _components(
        "q0 q1 q2 q3",
        "1",
        "attitude, unit quaternion from body to plane, scalar first",
        lambda view: view.attitude,
        "attitude",
    )
    yield Channel(
        "n_reduced",
        RATE,
        "spin of the reduced model beside",
        _FULL,
        lambda view: view.spin_beside,
        "reduced",
    )
    yield Channel(
        "n_gh",
        RATE,
        "spin of Garcia and Hubbard's solution",
        BOTH,
        lambda view: view.launches.gh.spin(view.samples.t),
    )


CHANNELS = {channel.name: channel for channel in _channels()}


def _channel_again(plain: str, name: str, unit: str, size: float) -> Channel:
    return replace(CHANNELS[plain], name=name, unit=unit, size=size)


def choose_channels(names: Iterable[str], model: str) -> tuple[Channel, ...]:
    """Return the channels of a model by their names; raise a ConfigError for others."""
    known = [channel.name for channel in CHANNELS.values() if model in channel.models]
    chosen = []
    for name in dict.fromkeys(names):
        if name not in known:
            raise ConfigError(
                f"channels of the model {model}: {not_one_of(name, known)}"
            )
        chosen.append(CHANNELS[name])
    return tuple(chosen)


def channels_in_si(
    channels: Iterable[Channel], units: Units | None
) -> dict[str, Channel]:
    """Return the channels that exist in SI units, such as ``t_s``, by plain names."""
    in_si: dict[str, Channel] = {}
    if units is None:
        return in_si
    sizes = units.sizes
    for channel in channels:
        # Pure numbers have no size, and without a mass neither have forces.
        if channel.unit not in sizes or not math.isfinite(sizes[channel.unit][0]):
            continue
        size, unit = si_of(channel.name, channel.unit, units)
        name = f"{channel.name}_{unit.replace('/', '_').replace(' ', '_')}"
        in_si[channel.name] = replace(channel, name=name, unit=unit, size=size)
    return in_si
