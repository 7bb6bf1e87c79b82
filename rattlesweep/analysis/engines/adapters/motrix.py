"""MotrixSim, in single precision."""

import motrixsim
import numpy as np

from rattlesweep.analysis.engines.adapters.mjcf import model

PACKAGES = ("motrixsim",)


def build(case, step):
    """Return the model and the state."""
    engine = motrixsim.load_mjcf_str(model(case, step))
    data = motrixsim.SceneData(engine)
    w, *xyz = case["quaternion"]
    data.set_dof_pos(np.array([*case["position"], *xyz, w]), engine)
    data.set_dof_vel(np.array([*case["velocity"], *case["omega"]]))
    engine.forward_kinematic(data)
    return engine, data


def advance(scene):
    """Make one step."""
    engine, data = scene
    engine.step(data)


def look(scene):
    """Return position, rotation, velocity, angular velocity and number of contacts."""
    engine, data = scene
    turn = np.array(engine.get_link_rotation_mats(data)[0], float)
    moving = np.array(engine.get_link_velocities(data)[0], float)
    position = np.array(engine.get_link_poses(data)[0][:3], float)
    count = engine.get_contact_query(data).num_contacts
    return position, turn, moving[:3], moving[3:], int(np.sum(count))
