"""DART, with the collision detector of FCL; its own and Bullet's are inexact here."""

import math

import dartpy as dart
import numpy as np

PACKAGES = ("dartpy",)


def build(case, step):
    """Return the scene at launch."""
    stone = dart.dynamics.Skeleton("stone")
    joint, body = stone.createFreeJointAndBodyNodePair()
    moments = np.diag(case["inertia"])
    body.setInertia(dart.dynamics.Inertia(case["mass"], np.zeros(3), moments))
    ellipsoid = dart.dynamics.EllipsoidShape(2 * np.array(case["semi_axes"]))
    surface = body.createShapeNode(ellipsoid)
    surface.createCollisionAspect()
    surface.createDynamicsAspect()
    half = case["angle"] / 2
    place = dart.math.Isometry3()
    turn = dart.math.Quaternion(math.cos(half), 0.0, 0.0, math.sin(half))
    place.set_quaternion(turn)
    place.set_translation(case["centre"])
    surface.setRelativeTransform(place)
    ground = dart.dynamics.Skeleton("ground")
    _, floor = ground.createWeldJointAndBodyNodePair()
    plane = floor.createShapeNode(dart.dynamics.PlaneShape([0, 0, 1], 0.0))
    plane.createCollisionAspect()
    plane.createDynamicsAspect()
    for shape in (surface, plane):
        shape.getDynamicsAspect().setFrictionCoeff(case["friction"])
        shape.getDynamicsAspect().setRestitutionCoeff(0.0)
    pose = dart.math.Isometry3()
    pose.set_quaternion(dart.math.Quaternion(*case["quaternion"]))
    pose.set_translation(case["position"])
    joint.setTransform(pose)
    omega = pose.rotation() @ np.array(case["omega"])
    joint.setSpatialVelocity(
        np.array([*omega, *case["velocity"]]),
        dart.dynamics.Frame.World(),
        dart.dynamics.Frame.World(),
    )
    world = dart.simulation.World()
    world.setGravity([0, 0, -case["gravity"]])
    world.setTimeStep(step)
    solver = world.getConstraintSolver()
    solver.setCollisionDetector(dart.collision.FCLCollisionDetector())
    world.addSkeleton(ground)
    world.addSkeleton(stone)
    return world, body


def advance(scene):
    """Make one step."""
    scene[0].step()


def look(scene):
    """Return position, rotation, velocity, angular velocity and number of contacts."""
    world, body = scene
    pose = body.getWorldTransform()
    return (
        pose.translation(),
        pose.rotation(),
        body.getLinearVelocity(),
        body.getAngularVelocity(),
        world.getLastCollisionResult().getNumContacts(),
    )
