"""Bullet (PyBullet), with the convex hull of points on the lower half."""

import math

import numpy as np
import pybullet as bullet

PACKAGES = ("pybullet",)
POINTS = 30_000


def vertices(case):
    """Return points on the lower half of the ellipsoid, on a spiral."""
    count = np.arange(POINTS) + 0.5
    z = -count / POINTS
    angle = math.pi * (1 + math.sqrt(5)) * count
    flat = np.sqrt(1 - z**2)
    sphere = np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)
    x, y, z = (sphere * case["semi_axes"]).T
    cos, sin = math.cos(case["angle"]), math.sin(case["angle"])
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1) + case["centre"]


def surface(case):
    """Return the shape of the body."""
    points = vertices(case).tolist()
    return bullet.createCollisionShape(bullet.GEOM_MESH, vertices=points)


def build(case, step):
    """Return the scene at launch."""
    bullet.connect(bullet.DIRECT)
    bullet.resetSimulation()
    bullet.setGravity(0, 0, -case["gravity"])
    bullet.setTimeStep(step)
    ground = bullet.createMultiBody(
        0, bullet.createCollisionShape(bullet.GEOM_PLANE, planeNormal=[0, 0, 1])
    )
    w, *xyz = case["quaternion"]
    stone = bullet.createMultiBody(
        case["mass"], surface(case), -1, case["position"], [*xyz, w]
    )
    friction = math.sqrt(case["friction"])  # Bullet multiplies both
    spinning = 0.0
    if case["lever"] > 0:
        spinning = case["lever"] / friction  # times the plane's friction
    bullet.changeDynamics(ground, -1, lateralFriction=friction, restitution=0)
    bullet.changeDynamics(
        stone,
        -1,
        lateralFriction=friction,
        rollingFriction=0,
        spinningFriction=spinning,
        restitution=0,
        linearDamping=0,
        angularDamping=0,
        localInertiaDiagonal=case["inertia"],
        collisionMargin=0,
        maxJointVelocity=1e6,  # by default a body spins at 100 rad/s at most
        activationState=bullet.ACTIVATION_STATE_DISABLE_SLEEPING,
    )
    turn = np.array(bullet.getMatrixFromQuaternion([*xyz, w])).reshape(3, 3)
    omega = turn @ np.array(case["omega"])
    bullet.resetBaseVelocity(stone, case["velocity"], omega.tolist())
    return stone


def advance(scene):
    """Make one step."""
    bullet.stepSimulation()


def look(scene):
    """Return position, rotation, velocity, angular velocity and number of contacts."""
    place, attitude = bullet.getBasePositionAndOrientation(scene)
    velocity, omega = map(np.array, bullet.getBaseVelocity(scene))
    turn = np.array(bullet.getMatrixFromQuaternion(attitude)).reshape(3, 3)
    return np.array(place), turn, velocity, omega, len(bullet.getContactPoints())
