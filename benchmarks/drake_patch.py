"""Drake for balls, with a patch of contact (hydroelastic) instead of a point.

The pressure of its patch falls as 1 - (r/a)^2 from the middle to the edge, as on a
bed of springs.  A ball is larger by the depth to which it is pressed, so that its
centre is where the scene says.
"""

import math

import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    HalfSpace,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    CoulombFriction,
    DiscreteContactApproximation,
)
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from rattlesweep.analysis.engines.adapters import drake

PACKAGES = drake.PACKAGES
EDGES = 6.25  # edges of the ball's mesh in the radius of its patch


def pressed(height, radius):
    """Return mean arm over the force, and the force, of a patch of unit modulus.

    `height` is that of the ball's centre and `radius` that of the patch.
    """
    ball = math.hypot(height, radius)
    r = radius * (np.arange(1000) + 0.5) / 1000
    pressure = 1 - np.hypot(height, r) / ball
    rings = 2 * math.pi * r * radius / 1000
    force = np.sum(pressure * rings)
    return np.sum(r * pressure * rings) / force, force


def build(case, step):
    """Return the scene at launch."""
    height = case["height"]
    arm = case["lever"] / case["friction"]
    radius = 15 / 8 * arm
    for _ in range(20):
        radius *= arm / pressed(height, radius)[0]
    _, force = pressed(height, radius)
    modulus = case["mass"] * case["gravity"] / force
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, step)
    plant.set_contact_model(ContactModel.kHydroelastic)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    plant.mutable_gravity_field().set_gravity_vector(case["pull"])
    moments = np.array(case["inertia"]) / case["mass"]
    inertia = SpatialInertia(case["mass"], np.zeros(3), UnitInertia(*moments))
    ball = plant.AddRigidBody("ball", inertia)
    rubs = CoulombFriction(case["friction"], case["friction"])
    materials = []
    for _ in range(2):
        material = ProximityProperties()
        AddContactMaterial(0.0, None, rubs, material)
        # A patch whose pressure has damping resists rolling.
        material.AddProperty("material", "relaxation_time", 0.0)
        materials.append(material)
    AddCompliantHydroelasticProperties(radius / EDGES, modulus, materials[0])
    AddRigidHydroelasticProperties(materials[1])
    sphere = Sphere(math.hypot(height, radius))
    plant.RegisterCollisionGeometry(
        ball, RigidTransform(), sphere, "surface", materials[0]
    )
    plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform(), HalfSpace(), "plane", materials[1]
    )
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFreeBodyPose(context, ball, RigidTransform(case["position"]))
    moving = SpatialVelocity(case["omega"], case["velocity"])
    plant.SetFreeBodySpatialVelocity(context, ball, moving)
    return {
        "plant": plant,
        "stone": ball,
        "simulator": simulator,
        "step": step,
        "n": 0,
    }


advance = drake.advance
look = drake.look
