"""Scenes with one fault of an engine each: their numbers by independent programs."""

import functools
import math

import numpy as np
import pytest
import stone_oracle
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipj
from sweeping import ROOT

GRAVITY = 9.81


@pytest.fixture
def scenes(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import faults

    return faults.scenes()


def about(scene, *, fault=False, number="expected"):
    """Return what a number should be about."""
    if fault:
        return pytest.approx(scene["fault"], abs=scene["tolerance"])
    return pytest.approx(scene[number], abs=0.1 * scene["tolerance"])


def test_a_fault_is_ten_times_the_tolerance_off(scenes):
    for name, scene in scenes.items():
        off = abs(scene["fault"] - scene["expected"])
        assert off >= 10 * scene["tolerance"], name


def test_the_scene_of_a_larger_body_is_similar(scenes):
    import faults

    for name, scene in scenes.items():
        larger = faults.larger(scene, 100.0)
        ratios = []
        for each in (scene, larger):
            size = each["semi_axes"][2]
            energies = 0.5 * np.square(each.get("omega", [0, 0, 0])) @ each["inertia"]
            energies += 0.5 * np.sum(np.square(each.get("velocity", [0, 0, 0])))
            fallen = 0.5 * GRAVITY * each["until"] ** 2 / size
            turned = each["step"] * np.linalg.norm(each.get("omega", [0, 0, 0]))
            flat = each["semi_axes"][0] / size
            ratios.append([energies / (GRAVITY * size), fallen, turned, flat])
        assert ratios[1] == pytest.approx(ratios[0], rel=1e-12), name
        assert larger["semi_axes"][2] == pytest.approx(100 * scene["semi_axes"][2])


def test_a_free_body_turns_over(scenes):
    scene = scenes["turns-over"]
    i1, i2, i3 = scene["inertia"]

    def euler(_, omega):
        x, y, z = omega
        return (i2 - i3) * y * z / i1, (i3 - i1) * z * x / i2, (i1 - i2) * x * y / i3

    path = solve_ivp(euler, (0, scene["until"]), scene["omega"], rtol=1e-10, atol=1e-12)
    launch = scene["omega"][1]
    assert path.y[1, -1] / launch == about(scene)
    # Jacobi's functions, cd(3.6056 t | 0.92308).
    _, cn, dn, _ = ellipj(3.6055513, 0.9230769)
    assert cn / dn == about(scene)
    assert scene["fault"] == 1


def patch(x, mu, radius, on_springs=False):
    """Return force and torque of a patch over the normal force.

    A circle of `radius` spins at 1 and slips at `x radius` with Coulomb's friction at
    each of its points, by a sum over them. The pressure is Hertz's, or 1 - (r/a)^2.
    """
    count = 70
    # Equal shares of the pressure, and angles.
    share = (np.arange(count) + 0.5) / count
    rho = np.sqrt(1 - (1 - share) ** (2 / 3))[:, None]
    if on_springs:
        rho = np.sqrt(1 - np.sqrt(1 - share))[:, None]
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    along = x - rho * np.sin(angle)
    across = rho * np.cos(angle)
    speed = np.hypot(along, across)
    force = np.mean(along / speed)
    torque = np.mean(rho * (across * np.cos(angle) - along * np.sin(angle)) / speed)
    return mu * force, mu * radius * torque


def rub(scene, law, mean=3 * math.pi / 16):
    """Return spins and slips of a ball of 1 kg by a law of its patch.

    `mean` is the mean distance of the pressure from the middle, over the radius.
    """
    radius = scene["semi_axes"][0]
    moment = scene["inertia"][0]
    mu = scene["friction"]
    patch_radius = scene["lever"] / (mean * mu)
    along, _, down = scene.get("gravity", [0, 0, -GRAVITY])

    def rhs(_, state):
        speed, omega, spin = state
        slip = speed - omega * radius
        force, torque = law(slip / (patch_radius * spin), mu, patch_radius)
        force *= -down
        torque *= -down
        return along - force, force * radius / moment, -torque / moment

    start = scene["velocity"][0], scene["omega"][1], scene["omega"][2]
    path = solve_ivp(
        rhs,
        (0, scene["until"]),
        start,
        "LSODA",
        rtol=1e-6,
        atol=1e-9,
        dense_output=True,
    )
    speeds, omegas, spins = path.sol(np.linspace(0, scene["until"], 1001))
    return spins, speeds - radius * omegas


@pytest.mark.parametrize("name", ["slides-and-spins", "spins-on-a-slope"])
def test_a_patch_shares_its_friction(scenes, name):
    scene = scenes[name]
    spins, _ = rub(scene, patch)
    assert spins[-1] / spins[0] == about(scene)
    # With a limit of its own, the torque does not know of sliding or rolling.
    rate = scene["lever"] * -scene.get("gravity", [0, 0, -GRAVITY])[2]
    left = 1 - rate * scene["until"] / scene["inertia"][0] / spins[0]
    assert left == about(scene, fault=True)


def test_a_patch_that_pivots_creeps(scenes):
    scene = scenes["creeps"]
    spins, slips = rub(scene, patch)
    # Slip and spin fall together.
    assert slips / spins == pytest.approx(scene["expected"], rel=5e-3)
    assert slips.sum() / spins.sum() == about(scene)


def test_a_patch_on_springs(scenes):
    law = functools.partial(patch, on_springs=True)
    spins, slips = rub(scenes["creeps"], law, 8 / 15)
    assert spins[-1] / spins[0] == about(
        scenes["spins-on-a-slope"], number="on springs"
    )
    assert slips.sum() / spins.sum() == about(scenes["creeps"], number="on springs")


def test_a_spheroid_rolls_in_a_circle(scenes):
    scene = scenes["circles"]
    flat, _, height = scene["semi_axes"]
    turn = Rotation.from_quat(np.roll(scene["quaternion"], -1)).as_matrix()
    unit = math.sqrt(height / GRAVITY)
    flip = np.array([1, -1, -1])
    alpha = 1 + scene["inertia"][0] / height**2
    parameters = {
        **{"alpha": alpha, "beta": alpha, "gamma": scene["inertia"][2] / height**2},
        **{"theta": (height / flat) ** 2, "phi": (height / flat) ** 2},
        **{"xi": 0.0, "c": 1.0},
    }
    omega = np.array(scene["omega"])
    end = scene["until"] / unit
    path = stone_oracle.follow(parameters, flip * turn[2], flip * omega * unit, end)
    tilts = path.sol(np.linspace(0, end, 1000))[2]
    assert np.ptp(tilts) < 1e-8
    # It rolls, and touches the plane.
    shape = turn * scene["semi_axes"]
    arm = -shape @ shape[2] / np.linalg.norm(shape[2])
    world_omega = turn @ omega
    slip = np.array(scene["velocity"]) + np.cross(world_omega, arm)
    assert slip == pytest.approx(0, abs=1e-12)
    assert scene["position"][2] + arm[2] == pytest.approx(0, abs=1e-15)
    # The creep h omega x dr/dt, and its work. All turns about the vertical at 15 rad/s.
    turning = np.array([0, 0, 15.0])
    creep = scene["step"] * np.cross(world_omega, np.cross(turning, arm))
    assert abs(creep[0]) == pytest.approx(1e-3 * 1.369, rel=1e-3)
    friction = np.cross(turning, scene["velocity"])
    energy = 0.5 * np.sum(np.square(scene["velocity"]))
    energy += 0.5 * omega**2 @ scene["inertia"]
    energy += GRAVITY * (scene["position"][2] - height)
    lost = abs(friction[0] * creep[0]) * scene["until"]
    assert 1 - lost / energy == about(scene, fault=True)


def test_a_convex_contact_hops(scenes):
    scene = scenes["skids"]
    mu = scene["friction"]
    speed = scene["velocity"][0]
    radius = scene["semi_axes"][0]
    # The least kinetic energy of the change, over impulses in the cone: the normal
    # impulse j of 1 kg, with the friction mu j against the slip.
    easy = 1 + radius**2 / scene["inertia"][0]  # slip per friction impulse
    impulses = np.linspace(0, speed, 200_001)
    slip = speed - mu * easy * impulses
    cost = impulses**2 / 2 + mu**2 * easy * impulses**2 / 2 - mu * speed * impulses
    jump = impulses[np.argmin(cost)]
    assert jump == pytest.approx(mu * slip[np.argmin(cost)], abs=1e-5)
    assert jump**2 / (2 * GRAVITY * radius) == about(scene, fault=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("engine", "name", "right"),
    [
        ("mujoco", "turns-over", True),
        ("mujoco", "bead", True),
        ("mujoco", "marble", True),
        ("mujoco", "slides-and-spins", True),
        ("mujoco", "spins-on-a-slope", False),
        ("drake", "turns-over", True),
        ("drake", "circles", False),
        ("drake_patch", "creeps", True),
        ("rapier", "marble", False),
        ("mujoco", "skids", False),
        ("jolt", "skids", True),
        ("jolt", "bead", True),
        ("jolt", "marble", True),
    ],
)
def test_engines_have_a_fault_or_not(scenes, engine, name, right):
    packages = {
        **{"drake": "pydrake", "drake_patch": "pydrake"},
        **{"rapier": "rapier3d", "jolt": "culverin"},
    }
    pytest.importorskip(packages.get(engine, engine))
    import faults

    scene = faults.scene_for(engine, scenes[name])
    off = abs(faults.measured(engine, scene) - scene["expected"])
    assert (off <= scene["tolerance"]) == right
