"""Exudyn, with a law of contact of this file's own."""

import math

import exudyn
import numpy as np
from exudyn.rigidBodyUtilities import RigidBodyInertia, RotXYZ2RotationMatrix

PACKAGES = ("exudyn",)
# Stiffness and damping in units of the mass and the step: the largest that are stable
# with some room.
STIFFNESS = 0.1
DAMPING = 0.2


def build(case, step):
    """Return the scene at launch."""
    system = exudyn.SystemContainer()
    mbs = system.AddSystem()
    ground = mbs.CreateGround()
    w, x, y, z = case["quaternion"]
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    body = mbs.CreateRigidBody(
        referencePosition=case["position"],
        referenceRotationMatrix=turn,
        initialVelocity=case["velocity"],
        initialAngularVelocity=turn @ np.array(case["omega"]),
        inertia=RigidBodyInertia(case["mass"], np.diag(case["inertia"])),
        gravity=[0, 0, -case["gravity"]],
        nodeType=exudyn.NodeType.RotationRotationVector,
    )
    cos, sin = math.cos(case["angle"]), math.sin(case["angle"])
    axes = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    shape = axes * np.array(case["semi_axes"])
    centre = np.array(case["centre"])
    stiffness = STIFFNESS * case["mass"] / step**2
    damping = DAMPING * case["mass"] / step

    def contact(mbs, t, item, place, angles, velocity, omega, *rest):
        turn = RotXYZ2RotationMatrix(angles)
        turned = turn @ shape
        arm = turn @ centre - turned @ turned[2] / math.sqrt(turned[2] @ turned[2])
        slip = velocity + np.cross(omega, arm)
        normal = max(0.0, -stiffness * (place[2] + arm[2]) - damping * slip[2])
        force = -damping * slip
        force[2] = 0.0
        size = math.sqrt(force @ force)
        if size > case["friction"] * normal:
            force *= case["friction"] * normal / size
        force[2] = normal
        # What the spring takes from the body.
        return list(-np.array([*force, *np.cross(arm, force)]))

    markers = [
        mbs.AddMarker(exudyn.itemInterface.MarkerBodyRigid(bodyNumber=number))
        for number in (ground, body)
    ]
    mbs.AddObject(
        exudyn.itemInterface.ObjectConnectorRigidBodySpringDamper(
            markerNumbers=markers, springForceTorqueUserFunction=contact
        )
    )
    mbs.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps = 1
    settings.timeIntegration.endTime = step
    settings.timeIntegration.verboseMode = 0
    settings.solution.file.write = False
    return {"mbs": mbs, "body": body, "settings": settings, "system": system}


def advance(scene):
    """Make one step."""
    scene["mbs"].SolveDynamic(
        scene["settings"],
        solverType=exudyn.DynamicSolverType.ExplicitMidpoint,
        updateInitialValues=True,
    )


def look(scene):
    """Return position, rotation, velocity, angular velocity and number of contacts."""
    outputs = (
        exudyn.OutputVariableType.Position,
        exudyn.OutputVariableType.RotationMatrix,
        exudyn.OutputVariableType.Velocity,
        exudyn.OutputVariableType.AngularVelocity,
    )
    position, turn, velocity, omega = (
        np.array(scene["mbs"].GetObjectOutputBody(scene["body"], output))
        for output in outputs
    )
    return position, turn.reshape(3, 3), velocity, omega, 1
