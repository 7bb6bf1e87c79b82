"""Attitude and path of a body, which single steps add to its state.

In slopes they are the heading and the contact point on the plane.  In any position no
heading is defined, so they are the rotation and the path since the start of a step
(:mod:`rotations`).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass

from rattlesweep.motion.chart import ANYWHERE, Chart
from rattlesweep.physics import full, vectors
from rattlesweep.physics.friction import sliding, slip
from rattlesweep.physics.full import scalar
from rattlesweep.physics.surface import Formula

HEADING_COMPONENT = "heading", "X", "Y"
ROTATION = "q_0 - 1", "q_1", "q_2", "q_3", "path_x", "path_y", "path_z"


@scalar
def _zero(y):
    return 0.0


@scalar
def _no_slip(y):
    return 0.0, 0.0


@scalar
def _no_rate(y, dy):
    return 0.0


@scalar
def _no_amplitude(y, probe):
    return 0.0


@scalar
def _no_error(e, y, constants):
    return 0.0, 1.0


UNSEEN: dict[str, Formula] = {
    "spin": _zero,
    "spin_rate": _no_rate,
    "amplitude": _no_amplitude,
    "error": _no_error,
}
"""Formulas of models whose single steps nobody looks at."""


@dataclass(frozen=True)
class Track:
    """Attitude and path as further components of a state."""

    names: tuple[str, ...]
    rhs: Formula  # rhs(y, constants): with the rates of the components
    # slid(y, slip, placed): their rates while the body slides
    slid: Formula


def track_of(
    chart: Chart,
    plain: Formula,
    n: int,
    contact: Formula,
    slip_of: Formula | None = None,
) -> Track:
    """Return the track of a body with equations ``plain`` of ``n`` components.

    ``slip_of(y)`` is the velocity of a contact point that slips, along ``h_1`` and
    ``h_2``.
    """
    if chart is ANYWHERE:
        return Track(ROTATION, _with_rotation(plain, n, slip_of), _slid_rotation(n))
    rhs = _with_track(plain, n, contact)
    if slip_of is not None:
        rhs = _with_slip(rhs, n, slip_of)
    return Track(HEADING_COMPONENT, rhs, _slid_track(n))


def _with_slip(rolled: Formula, n: int, slip_of: Formula) -> Formula:
    """Return equations of a track with the slip of the contact point."""
    # Slices of tuples are compiled for constants alone.
    east = n + 1
    north = n + 2

    @scalar
    def rhs(y, constants):
        f = rolled(y, constants)
        v = slip_of(y)
        # h_1 is the x axis, from which the heading tells.
        c, s = sliding.cos_sin(y[n])
        x = f[east] + c * v[0] - s * v[1]
        y_ = f[north] + s * v[0] + c * v[1]
        return f[:east] + (x, y_)  # noqa: RUF005

    return rhs  # type: ignore[no-any-return]


def _with_track(plain: Formula, n: int, touch: Formula) -> Formula:
    @scalar
    def rhs(y, constants):
        p, q, a, b, _ = y[:5]
        f = plain(y[:n], constants)
        slope_rates = f[0], f[1], p * b - q * a
        return f + full.track(y, y[n], touch(y, slope_rates, constants[3:7]))

    return rhs  # type: ignore[no-any-return]


def _slid_track(n: int) -> Formula:
    @scalar
    def slid_track(y, slip, placed):
        return sliding.track(
            placed.u, placed.omega, placed.r, placed.w, slip.speed, slip.angle, y[n]
        )

    return slid_track  # type: ignore[no-any-return]


def _with_rotation(plain: Formula, n: int, slip_of: Formula | None) -> Formula:
    last = n + 4
    slips = slip_of is not None
    slip_at = slip_of or _no_slip

    @scalar
    def rhs(y, constants):
        f = plain(y[:n], constants)
        u, omega = vectors.position(y)
        velocity = vectors.rolled(u, omega, constants[3:7])
        if slips:
            first, second = slip_at(y)
            x, y_, z = slip.along(u, first, second)
            vx, vy, vz = velocity
            velocity = vx + x, vy + y_, vz + z
        return f + vectors.carried_on(y[n:last], omega, velocity)

    return rhs  # type: ignore[no-any-return]


def _slid_rotation(n: int) -> Formula:
    last = n + 4

    @scalar
    def slid_path(y, slip, placed):
        x, y_, z = sliding.cross(placed.r, placed.omega)
        wx, wy, wz = placed.w
        ex, ey, ez = sliding.slip_direction(placed.u, slip.angle)
        velocity = (
            x - wx + slip.speed * ex,
            y_ - wy + slip.speed * ey,
            z - wz + slip.speed * ez,
        )
        return vectors.carried_on(y[n:last], placed.omega, velocity)

    return slid_path  # type: ignore[no-any-return]
