"""Bodies and runs of other people: their numbers (theirs.json) against ours.

- Kane and Levinson's stone: angular velocities (rad/s) by the package RattleBack 0.0.2
  with ``rtol=1e-12``, from 0.5 degrees of tilt; keys are its ``sigma`` in cm^2/s and
  the spin.
- The stone of physics-atlas (A. Kanjilal, github.com/akanjilal-work/physics-atlas,
  commit 5b64f8e): spin at 1 ... 12 s and its first zeros, by its Runge-Kutta scheme
  with steps of 50 us.
- Two stones of C. Wittenstein (*Simulation des Wackelsteines*, Mainz 2024,
  github.com/cwittens/Simulation-of-the-Rattleback): points of the curves in the vector
  drawings vergleich_kuypers_omega, kuypers_omega_pushed_down and kuypers0_reproduced.
"""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

import rattlesweep as rs

THEIRS = json.loads(Path(__file__).with_name("theirs.json").read_text(encoding="utf-8"))


class Stone:
    """A half ellipsoid by its tensor of inertia, in the axes of those who described it
    (z up).
    """

    def __init__(self, mass, inertia, axes, centre, gravity=9.81):
        long, wide, deep = axes
        height = deep - centre
        self.body = rs.Rattleback.from_si(
            mass=mass,
            inertia=inertia,
            height=height,
            c=deep,
            gravity=gravity,
            z_up=True,
            radii=(long**2 / deep, wide**2 / deep),
        ).replace(units=None)  # launches are in units of the body
        x = np.array([*np.linalg.eigh(np.array(inertia)[:2, :2])[1][:, 1], 0.0])
        z = np.array([0.0, 0.0, -1.0])
        self.axes = np.array([x, np.cross(z, x), z])
        self.time = math.sqrt(height / gravity)
        self.friction = mass * height**2 / self.time

    def run(self, up, omega, times, sigma=0.0):
        """Return angular velocities (rad/s), the vertical, and zeros of the spin in
        seconds.
        """
        found = rs.trajectory(
            self.body,
            u=self.axes @ up,
            omega=self.axes @ omega * self.time,
            tol=1e-13,
            t_end=times[-1] / self.time,
            times=times / self.time,
            sigma=sigma / self.friction,
            channels=["t", "omega_x", "omega_y", "omega_z", "u_x", "u_y", "u_z"],
        )
        rows = found.table
        rates = (
            rows[["omega_x", "omega_y", "omega_z"]].to_numpy() @ self.axes / self.time
        )
        return (
            rates,
            rows[["u_x", "u_y", "u_z"]].to_numpy() @ self.axes,
            found.zeros * self.time,
        )


def tilted(alpha, beta):
    """Return the vertical in the stone for angles of Kane and Levinson, and of
    Kuypers.
    """
    flat = math.cos(alpha)
    return np.array([-flat * math.sin(beta), math.sin(alpha), flat * math.cos(beta)])


@pytest.mark.parametrize("key", THEIRS["kane_levinson"]["runs"])
def test_kane_and_levinsons_stone_by_the_package_rattleback(key):
    sigma, spin = map(float, key.split(","))
    inertia = [[2e-4, -0.2e-4, 0.0], [-0.2e-4, 16e-4, 0.0], [0.0, 0.0, 17e-4]]
    stone = Stone(1.0, inertia, (0.2, 0.03, 0.02), 0.01, gravity=9.80665)
    half = math.radians(0.5)
    times = np.array(THEIRS["kane_levinson"]["t"])
    rates, _, _ = stone.run(tilted(half, half), [0, 0, spin], times, sigma * 1e-4)
    assert abs(rates - THEIRS["kane_levinson"]["runs"][key]).max() < 2e-6


@pytest.mark.parametrize("spin", THEIRS["atlas"])
def test_the_stone_of_physics_atlas(spin):
    long = 0.1
    wide = 0.02
    deep = 0.016
    mass = 0.2
    skew = 0.1
    centre = 3 * deep / 8
    across = mass * (wide**2 + deep**2) / 5 - mass * centre**2
    along = mass * (long**2 + deep**2) / 5 - mass * centre**2
    turn = np.array(
        [[math.cos(skew), -math.sin(skew)], [math.sin(skew), math.cos(skew)]]
    )
    inertia = np.diag([0.0, 0.0, mass * (long**2 + wide**2) / 5])
    inertia[:2, :2] = turn @ np.diag([across, along]) @ turn.T
    stone = Stone(mass, inertia, (long, wide, deep), centre)
    # The shape itself; its skew has the paper's sign, which is that of the mirrored
    # stone.
    shape = rs.Rattleback.half_ellipsoid(
        length=f"{2 * long} m",
        width=f"{2 * wide} m",
        height=f"{deep} m",
        mass=f"{mass} kg",
        skew=skew,
    )
    for name in ("alpha", "beta", "gamma", "theta", "phi", "c"):
        assert getattr(shape, name) == pytest.approx(
            getattr(stone.body, name), rel=1e-12
        )
    assert shape.xi == pytest.approx(-stone.body.xi, rel=1e-12)
    rates, up, zeros = stone.run(
        [0, 0, 1], [0.01, 0.01, float(spin)], np.arange(1.0, 13.0)
    )
    theirs = THEIRS["atlas"][spin]
    assert abs((rates * up).sum(axis=1) - theirs["spin"]).max() < 1e-7
    assert zeros[:3] == pytest.approx(theirs["zeros"], abs=2e-7)


@pytest.mark.parametrize(
    ("name", "omega"), [("spun", (0.01, -0.02, -2.0)), ("pushed", (0.01, -1.0, -0.02))]
)
def test_wittensteins_stone(name, omega):
    """Half an ellipsoid, semi-axes golden ratio, 1 and 1 m, of 0.1 kg, with two weights
    of 50 g.
    """
    inertia = [
        [0.05796875, -0.025, 0.0],
        [-0.025, 0.0903294297749979, 0.0],
        [0.0, 0.0, 0.12236067977499791],
    ]
    stone = Stone(0.2, inertia, ((1 + math.sqrt(5)) / 2, 1.0, 1.0), 0.1875)
    times = np.linspace(0, 69, 6901)
    rates, _, _ = stone.run([0, 0, 1], omega, times)
    for ours, curve in zip(rates.T, THEIRS["wittenstein"][name], strict=True):
        t, theirs = np.transpose(curve)
        # A step of the drawing is 0.01 points: 0.001 s, and 1e-4 rad/s.
        assert abs(np.interp(t, times, ours) - theirs).max() < 4e-3


def test_kuypers_stone_with_friction():
    """His angles over 8 s; the drawing lacks a scale, so a line is fitted and the rest
    compared.
    """
    turn = 0.1
    inertia = np.diag([0.0, 0.0, 1.7e-3])
    c = math.cos(turn)
    s = math.sin(turn)
    inertia[:2, :2] = [
        [2e-4 * c * c + 16e-4 * s * s, -14e-4 * s * c],
        [-14e-4 * s * c, 2e-4 * s * s + 16e-4 * c * c],
    ]
    stone = Stone(1.0, inertia, (0.2, 0.03, 0.02), 1e-3)
    times = np.linspace(0, 8, 80_001)
    rates, up, _ = stone.run(tilted(-0.02, -0.02), [0, 0, -8.0], times, sigma=1e-4)
    alpha = np.arcsin(up[:, 1])
    beta = np.arctan2(-up[:, 0], up[:, 2])
    turning = (rates[:, 2] * np.cos(beta) - rates[:, 0] * np.sin(beta)) / np.cos(alpha)
    gamma = cumulative_simpson(turning, x=times, initial=0)
    curves = THEIRS["wittenstein"]["kuypers"]
    for ours, curve in zip((gamma, alpha, beta), curves, strict=False):
        t, drawn = np.transpose(curve)
        here = np.interp(t, times, ours)
        off = here - np.polyval(np.polyfit(drawn, here, 1), drawn)
        assert abs(off).max() < 3e-3 * np.ptp(ours)
