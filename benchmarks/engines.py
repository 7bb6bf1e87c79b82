"""How far off the first reversals of physics engines are, and what that costs.

    pip install -e '.[engines]'
    python benchmarks/engines.py                 # MuJoCo, all cases
    python benchmarks/engines.py --engine drake --cases demo-clockwise
    python benchmarks/engines.py --check         # our times by an independent program

runs the cases of `benchmarks/engines/`, which `rattlesweep export --cases` writes.  A
row has the error of the first reversal, relative to the expected time, and the
seconds of the processor that it took.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from machine import ROOT, heading

FOLDER = ROOT / "benchmarks" / "engines"
LATE = 1.6  # a run ends at so many times the expected first reversal
# Time constants of MuJoCo's contact in sqrt(a/g), each with steps of half of it.
LADDER = (0.04, 0.02, 0.01, 0.005, 0.0025, 0.00125, 0.000625)
# Time constants with a stronger damping of slip: the share of the slip that one time
# step takes away, twice that at most being stable.
GRIPS = (0.04, 0.02, 0.01, 0.005)  # sqrt(a/g)
GRIP = 1.8
DRAKE_STEPS = (0.02, 0.01, 0.005, 0.0025, 0.00125)  # sqrt(a/g)
BULLET_STEPS = (0.005, 0.00125)  # sqrt(a/g)
BULLET_POINTS = (1_000, 10_000, 30_000, 100_000)


@dataclass(frozen=True)
class Result:
    """The first reversal that an engine found, in s, and what it cost."""

    first_reversal: float | None
    seconds: float
    energy: float  # at the end over that at launch, without the potential at rest


class Watch:
    """Finds the first zero of the spin that counts."""

    def __init__(self, case: dict) -> None:
        self.counts_above = case["expected"]["counts_above"]
        self.armed = self.counts_above == 0
        self.before: tuple[float, float] | None = None

    def sees(self, t: float, spin: float) -> float | None:
        """Return the time of a zero between the last look and this one."""
        before = self.before
        self.before = t, spin
        if not self.armed:
            self.armed = abs(spin) > self.counts_above
        elif before is not None and before[1] * spin <= 0:
            t0, spin0 = before
            return t0 + (t - t0) * spin0 / (spin0 - spin)
        return None


def time_unit(case: dict) -> float:
    """Return sqrt(a/g) in s."""
    return math.sqrt(case["body"]["height"] / case["plane"]["gravity"])


def watched(
    case: dict, step: Callable[[], tuple[float, float]], energy: Callable[[], float]
) -> Result:
    """Step an engine until the spin reverses; `step` returns time and spin."""
    watch = Watch(case)
    watch.sees(0.0, case["expected"]["poses"][0]["spin"])
    begin = time.process_time()
    end = LATE * case["expected"]["first_reversal"]["time"]
    found = None
    t = 0.0
    while found is None and t < end:
        t, spin = step()
        found = watch.sees(t, spin)
    seconds = time.process_time() - begin
    return Result(found, seconds, energy() / case["expected"]["energy"])


def mujoco_run(
    case: dict,
    share: float | None = None,
    steps: int = 2,
    defaults: bool = False,
    grip: float | None = None,
) -> Result:
    """Run the exported model, with another time constant in sqrt(a/g) if it is given.

    With `grip`, a contact pair damps slip by this share a time step, instead of by
    2 / `steps`.  With `defaults` the contact and the time step are those that MuJoCo
    has by default.
    """
    import mujoco

    spec = mujoco.MjSpec.from_file(str(FOLDER / f"{case['name']}.xml"))
    if share is not None and grip is not None:
        surface = spec.geom("surface")
        sliding, pivoting, _ = surface.friction
        time_constant = share * time_unit(case)
        spec.add_pair(
            geomname1="plane",
            geomname2="surface",
            condim=surface.condim,
            friction=[sliding, sliding, pivoting, 0, 0],
            solref=[time_constant, 1],
            # Without stiffness; negative numbers are taken as they are.
            solreffriction=[0, -grip * steps / time_constant],
            solimp=surface.solimp,
        )
    model = spec.compile()
    if share is not None:
        model.geom_solref[:, 0] = share * time_unit(case)
        model.opt.timestep = share * time_unit(case) / steps
    if defaults:
        model.geom_solref[:] = [0.02, 1.0]
        model.geom_solimp[:] = [0.9, 0.95, 0.001, 0.5, 2.0]
        model.opt.timestep = 0.002
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        model.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    rest = case["body"]["mass"] * case["plane"]["gravity"] * case["body"]["height"]

    def step() -> tuple[float, float]:
        mujoco.mj_step(model, data)
        # The third row of the body's rotation gives the vertical component.
        return data.time, float(data.xmat[1][6:] @ data.qvel[3:6])

    def energy() -> float:
        return float(data.energy.sum()) - rest

    return watched(case, step, energy)


def drake_run(case: dict, share: float) -> Result:
    """Run a case in Drake's discrete solver with a time step in sqrt(a/g)."""
    from pydrake.common.eigen_geometry import Quaternion
    from pydrake.geometry import (
        AddContactMaterial,
        Ellipsoid,
        HalfSpace,
        ProximityProperties,
    )
    from pydrake.math import RigidTransform, RotationMatrix
    from pydrake.multibody.math import SpatialVelocity
    from pydrake.multibody.plant import (
        AddMultibodyPlantSceneGraph,
        CoulombFriction,
        DiscreteContactApproximation,
    )
    from pydrake.multibody.tree import SpatialInertia, UnitInertia
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    step_size = share * time_unit(case)
    body = case["body"]
    surface = body["surface"]
    friction = case["plane"]["friction"] or 1.0
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, step_size)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    gravity = [0, 0, -case["plane"]["gravity"]]
    plant.mutable_gravity_field().set_gravity_vector(gravity)
    moments = np.array(body["inertia"]) / body["mass"]
    inertia = SpatialInertia(body["mass"], np.zeros(3), UnitInertia(*moments))
    stone = plant.AddRigidBody("rattleback", inertia)
    material = ProximityProperties()
    # Stiff enough that the body sinks in by a millionth of its height.
    stiffness = body["mass"] * case["plane"]["gravity"] / (1e-6 * body["height"])
    coulomb = CoulombFriction(friction, friction)
    AddContactMaterial(0.0, stiffness, coulomb, material)
    turn = RotationMatrix.MakeZRotation(surface["angle"])
    place = RigidTransform(turn, surface["centre"])
    shape = Ellipsoid(*surface["semi_axes"])
    plant.RegisterCollisionGeometry(stone, place, shape, "surface", material)
    plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform(), HalfSpace(), "plane", material
    )
    plant.Finalize()
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    start = case["launch"]
    attitude = Quaternion(wxyz=np.array(start["quaternion"]))
    pose = RigidTransform(attitude, start["position"])
    plant.SetFreeBodyPose(context, stone, pose)
    omega = pose.rotation().multiply(np.array(start["omega"]))
    velocity = SpatialVelocity(omega, start["velocity"])
    plant.SetFreeBodySpatialVelocity(context, stone, velocity)
    count = 0

    def step() -> tuple[float, float]:
        nonlocal count
        count += 1
        simulator.AdvanceTo(count * step_size)
        moving = plant.EvalBodySpatialVelocityInWorld(context, stone)
        return count * step_size, float(moving.rotational()[2])

    def energy() -> float:
        rest = body["mass"] * case["plane"]["gravity"] * body["height"]
        potential = plant.CalcPotentialEnergy(context)
        return plant.CalcKineticEnergy(context) + potential - rest

    return watched(case, step, energy)


def bullet_run(case: dict, share: float, points: int) -> Result:
    """Run a case in Bullet with the convex hull of points on the ellipsoid."""
    import pybullet as bullet
    from scipy.spatial.transform import Rotation

    step_size = share * time_unit(case)
    body = case["body"]
    surface = body["surface"]
    friction = math.sqrt(case["plane"]["friction"] or 1.0)  # Bullet multiplies both
    server = bullet.connect(bullet.DIRECT)
    bullet.setGravity(0, 0, -case["plane"]["gravity"])
    bullet.setTimeStep(step_size)
    ground = bullet.createMultiBody(
        0, bullet.createCollisionShape(bullet.GEOM_PLANE, planeNormal=[0, 0, 1])
    )
    # A spiral of points on the lower half, which alone touches the plane.
    k = np.arange(points) + 0.5
    z = -k / points
    angle = math.pi * (1 + math.sqrt(5)) * k
    flat = np.sqrt(1 - z**2)
    sphere = np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)
    turn = Rotation.from_euler("z", surface["angle"])
    vertices = turn.apply(sphere * surface["semi_axes"]) + surface["centre"]
    hull = bullet.createCollisionShape(bullet.GEOM_MESH, vertices=vertices.tolist())
    start = case["launch"]
    w, *xyz = start["quaternion"]
    lift = [*start["position"][:2], start["position"][2]]
    stone = bullet.createMultiBody(body["mass"], hull, -1, lift, [*xyz, w])
    bullet.changeDynamics(ground, -1, lateralFriction=friction, restitution=0)
    bullet.changeDynamics(
        stone,
        -1,
        lateralFriction=friction,
        rollingFriction=0,
        spinningFriction=0,
        restitution=0,
        linearDamping=0,
        angularDamping=0,
        localInertiaDiagonal=body["inertia"],
        collisionMargin=0,
        activationState=bullet.ACTIVATION_STATE_DISABLE_SLEEPING,
    )
    omega = Rotation.from_quat([*xyz, w]).apply(start["omega"])
    bullet.resetBaseVelocity(stone, start["velocity"], omega.tolist())
    count = 0

    def step() -> tuple[float, float]:
        nonlocal count
        count += 1
        bullet.stepSimulation()
        return count * step_size, bullet.getBaseVelocity(stone)[1][2]

    def energy() -> float:
        place, attitude = bullet.getBasePositionAndOrientation(stone)
        velocity, spinning = map(np.array, bullet.getBaseVelocity(stone))
        along = Rotation.from_quat(attitude).inv().apply(spinning)
        kinetic = body["mass"] * velocity @ velocity / 2
        kinetic += along**2 @ body["inertia"] / 2
        weight = body["mass"] * case["plane"]["gravity"]
        return float(kinetic + weight * (place[2] - body["height"]))

    result = watched(case, step, energy)
    bullet.disconnect(server)
    return result


Settings = Iterator[tuple[str, Callable[[dict], Result]]]


def mujoco_settings(ladder: Sequence[float]) -> Settings:
    yield "defaults", lambda case: mujoco_run(case, defaults=True)
    yield "as exported", mujoco_run
    for share in ladder:
        yield f"{share}", lambda case, share=share: mujoco_run(case, share)
    for share in GRIPS:
        yield (
            f"{share} with grip",
            lambda case, share=share: mujoco_run(case, share, grip=GRIP),
        )


def drake_settings(ladder: Sequence[float]) -> Settings:
    for share in ladder:
        yield f"{share}", lambda case, share=share: drake_run(case, share)


def bullet_settings(ladder: Sequence[float]) -> Settings:
    for points in BULLET_POINTS:
        for share in ladder:
            yield (
                f"{points} points, {share}",
                lambda case, share=share, points=points: bullet_run(
                    case, share, points
                ),
            )


ENGINES = {
    "mujoco": ("mujoco", mujoco_settings, LADDER),
    "drake": ("drake", drake_settings, DRAKE_STEPS),
    "bullet": ("pybullet", bullet_settings, BULLET_STEPS),
}


def independent(case: dict) -> float:
    """Return the first reversal of a case by the vector program of the tests, in s."""
    sys.path.insert(0, str(ROOT / "tests" / "helpers"))
    import pivot_oracle
    import slide_oracle
    import stone_oracle

    from rattlesweep import Rattleback

    unit = time_unit(case)
    parameters = case["body"]["parameters"]
    start = case["launch"]
    # Back to axes with z down.
    flip = np.array([1.0, -1.0, -1.0])
    omega = flip * np.array(start["omega"]) * unit
    w, x, y, z = start["quaternion"]
    vertical = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 0.0])
    vertical[2] = 1 - 2 * (x * x + y * y)
    u = flip * vertical
    expected = case["expected"]["first_reversal"]["time"] / unit
    mu = case["plane"]["friction"]
    if mu is not None:
        body = Rattleback(**parameters)
        found = slide_oracle.run(body, u, omega, 1.1 * expected, mu, rtol=1e-11)
        return unit * found.t_r
    if "pivot" in case["plane"]["losses"]:
        body = Rattleback(**parameters)
        lever = case["plane"]["losses"]["pivot"]["value"] / case["body"]["height"]
        found = pivot_oracle.run(body, u, omega, 1.02 * expected, lever, rtol=1e-12)
        return unit * found.t_r
    path = stone_oracle.follow(parameters, u, omega, 1.02 * expected)
    above = case["expected"]["counts_above"] * unit
    times = np.linspace(0.0, 1.02 * expected, 100_001)
    spin = np.einsum("ij,ij->j", path.sol(times)[:3], path.sol(times)[3:6])
    armed = np.maximum.accumulate(np.abs(spin)) > above
    crossings = np.flatnonzero((spin[1:] * spin[:-1] < 0) & armed[:-1])
    first = int(crossings[0])
    from scipy.optimize import brentq

    def spin_at(t: float) -> float:
        y = path.sol(t)
        return float(y[:3] @ y[3:6])

    return unit * brentq(spin_at, times[first], times[first + 1], xtol=1e-15)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--engine", choices=ENGINES, default="mujoco")
    parser.add_argument("--cases", nargs="*", help="names of cases; by default all")
    parser.add_argument(
        "--ladder",
        nargs="*",
        type=float,
        help="time constants of MuJoCo, or time steps of others, in sqrt(a/g)",
    )
    parser.add_argument("--check", action="store_true", help="our own times instead")
    options = parser.parse_args()
    names = options.cases or [path.stem for path in sorted(FOLDER.glob("*.xml"))]
    cases = [json.loads((FOLDER / f"{name}.json").read_text()) for name in names]
    print(heading())
    if options.check:
        print("case | first reversal, s | methods differ by | independent differs by")
        for case in cases:
            expected = case["expected"]["first_reversal"]["time"]
            _, other = (method["first_reversal"] for method in case["methods"])
            differs = independent(case) / expected - 1
            print(
                f"{case['name']} | {expected:.12g} | {other / expected - 1:.1e} | "
                f"{differs:.1e}",
                flush=True,
            )
        return
    package, settings, ladder = ENGINES[options.engine]
    print(package, version(package))
    print("case | settings | first reversal, s | error | seconds | energy left")
    for case in cases:
        if case["plane"]["losses"] and options.engine != "mujoco":
            print(f"{case['name']} | no pivoting friction here")
            continue
        expected = case["expected"]["first_reversal"]["time"]
        for label, run in settings(options.ladder or ladder):
            result = run(case)
            found = "none"
            error = ""
            if result.first_reversal is not None:
                found = f"{result.first_reversal:.6g}"
                error = f"{result.first_reversal / expected - 1:+.3%}"
            print(
                f"{case['name']} | {label} | {found} | {error} | "
                f"{result.seconds:.2f} | {result.energy:.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
