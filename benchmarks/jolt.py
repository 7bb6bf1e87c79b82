"""Jolt (culverin) for balls: the package sets no moments of inertia."""

import math

import culverin
import numpy as np
from scipy.spatial.transform import Rotation

PACKAGES = ("culverin",)
DAMPING = 0.05  # 1/s, Jolt's own, which the package cannot set


def build(case, step):
    """Return the scene at launch."""
    world = culverin.PhysicsWorld({"gravity": (0.0, 0.0, -case["gravity"])})
    world.create_body(
        size=(0.0, 0.0, 1.0, 0.0),
        shape=culverin.SHAPE_PLANE,
        motion=culverin.MOTION_STATIC,
        friction=case["friction"],
    )
    ball = world.create_body(
        pos=tuple(case["position"]),
        size=(case["height"],),
        shape=culverin.SHAPE_SPHERE,
        motion=culverin.MOTION_DYNAMIC,
        mass=case["mass"],
        friction=case["friction"],
    )
    world.set_linear_velocity(ball, *case["velocity"])
    world.set_angular_velocity(ball, *case["omega"])
    return world, ball, step, case["height"]


def advance(scene):
    """Make one step, and undo its damping."""
    world, ball, step, _ = scene
    world.step(step)
    kept = 1 - DAMPING * step
    for read, write in (
        (world.get_velocity, world.set_linear_velocity),
        (world.get_angular_velocity, world.set_angular_velocity),
    ):
        write(ball, *(x / kept for x in read(ball)))


def look(scene):
    """Return position, rotation and velocities; the contacts are not counted."""
    world, ball, *_ = scene
    turn = Rotation.from_quat(world.get_rotation(ball)).as_matrix()
    position, velocity, omega = (
        np.array(read(ball))
        for read in (
            world.get_position,
            world.get_velocity,
            world.get_angular_velocity,
        )
    )
    return position, turn, velocity, omega, math.nan
