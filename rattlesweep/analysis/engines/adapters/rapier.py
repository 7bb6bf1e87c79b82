"""Rapier, with the convex hull of points near the lowest one, in single precision."""

import math

import numpy as np
import rapier3d as rapier

PACKAGES = ("rapier3d",)
# With more points its hull leaves some out, and with fewer the facets are wide.
POINTS = 300
# The points reach to this height of the unit sphere; one more is at the top.
HIGHEST = -0.4


def vertices(case):
    """Return points on the lower part of the ellipsoid, on a spiral."""
    count = np.arange(POINTS) + 0.5
    z = -1 + (1 + HIGHEST) * count / POINTS
    angle = math.pi * (1 + math.sqrt(5)) * count
    flat = np.sqrt(1 - z**2)
    sphere = np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)
    sphere = np.vstack([sphere, [0, 0, 1]])
    x, y, z = (sphere * case["semi_axes"]).T
    cos, sin = math.cos(case["angle"]), math.sin(case["angle"])
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1) + case["centre"]


def surface(case):
    """Return the shape of the body."""
    return rapier.Collider.convex_hull(
        vertices(case), density=0.0, friction=case["friction"], restitution=0.0
    )


def build(case, step):
    """Return the scene at launch."""
    world = rapier.PhysicsWorld(gravity=(0.0, 0.0, -case["gravity"]))
    settings = world.integration_parameters
    settings.dt = step
    settings.friction_model = rapier.FrictionModel.COULOMB
    # Its defaults let the body sink in by millimetres.
    stiff = rapier.SpringCoefficients(natural_frequency=400.0, damping_ratio=5.0)
    settings.contact_softness = stiff
    settings.static_contact_softness = stiff
    settings.num_solver_iterations = 20
    settings.contact_recycling = False
    settings.contact_clustering = False
    ground = rapier.Collider.halfspace((0.0, 0.0, 1.0), friction=case["friction"])
    world.add_collider(ground)
    turn = rapier.Rotation3(*case["quaternion"])
    mass = rapier.MassProperties((0.0, 0.0, 0.0), case["mass"], tuple(case["inertia"]))
    omega = turn.transform_vector(rapier.Vec3(*case["omega"]))
    body = (
        rapier.RigidBody.dynamic()
        .position(rapier.Isometry3(rapier.Vec3(*case["position"]), turn))
        .linvel(rapier.Vec3(*case["velocity"]))
        .angvel(omega)
        .additional_mass_properties(mass)
        .gyroscopic_forces(True)
        .can_sleep(False)
    )
    return world, world.add_body(body, [surface(case)])


def advance(scene):
    """Make one step."""
    scene[0].step()


def look(scene):
    """Return position, rotation, velocity, angular velocity and number of contacts."""
    world, stone = scene
    body = world.rigid_bodies[stone]
    turn = np.array(body.rotation.to_matrix(), float).reshape(3, 3)
    place, velocity, omega = (
        np.array([vector.x, vector.y, vector.z])
        for vector in (body.translation, body.linvel, body.angvel)
    )
    count = sum(
        len(manifold.points)
        for pair in world.narrow_phase.contact_pairs()
        for manifold in pair.manifolds
    )
    return place, turn, velocity, omega, count
