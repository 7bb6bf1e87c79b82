"""Drake, with its discrete solver SAP."""

import numpy as np
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

PACKAGES = ("drake",)


def build(case, step):
    """Return the scene at launch."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, step)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -case["gravity"]])
    moments = np.array(case["inertia"]) / case["mass"]
    inertia = SpatialInertia(case["mass"], np.zeros(3), UnitInertia(*moments))
    stone = plant.AddRigidBody("rattleback", inertia)
    # The body sinks in by a millionth of its height.
    stiffness = case["mass"] * case["gravity"] / (1e-6 * case["height"])
    rubs = CoulombFriction(case["friction"], case["friction"])
    material = ProximityProperties()
    AddContactMaterial(0.0, stiffness, rubs, material)
    # SAP does not use the dissipation above.  With its relaxation time of 0.1 s the
    # body would sink in by .3 mm.
    material.AddProperty("material", "relaxation_time", step)
    place = RigidTransform(RotationMatrix.MakeZRotation(case["angle"]), case["centre"])
    plant.RegisterCollisionGeometry(
        stone, place, Ellipsoid(*case["semi_axes"]), "surface", material
    )
    plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform(), HalfSpace(), "plane", material
    )
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    attitude = Quaternion(wxyz=np.array(case["quaternion"]))
    pose = RigidTransform(attitude, case["position"])
    plant.SetFreeBodyPose(context, stone, pose)
    omega = pose.rotation().multiply(np.array(case["omega"]))
    velocity = SpatialVelocity(omega, case["velocity"])
    plant.SetFreeBodySpatialVelocity(context, stone, velocity)
    return {
        "plant": plant,
        "stone": stone,
        "simulator": simulator,
        "step": step,
        "n": 0,
    }


def advance(scene):
    """Make one step."""
    scene["n"] += 1
    scene["simulator"].AdvanceTo(scene["n"] * scene["step"])


def look(scene):
    """Return position, rotation, velocity, angular velocity and number of contacts."""
    plant, stone = scene["plant"], scene["stone"]
    context = plant.GetMyContextFromRoot(scene["simulator"].get_context())
    pose = plant.EvalBodyPoseInWorld(context, stone)
    moving = plant.EvalBodySpatialVelocityInWorld(context, stone)
    results = plant.get_contact_results_output_port().Eval(context)
    contacts = results.num_point_pair_contacts()
    turn = pose.rotation().matrix()
    return (
        pose.translation(),
        turn,
        moving.translational(),
        moving.rotational(),
        contacts,
    )
