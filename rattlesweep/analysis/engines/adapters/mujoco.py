"""MuJoCo."""

import mujoco
import numpy as np

from rattlesweep.analysis.engines.adapters.mjcf import model

PACKAGES = ("mujoco",)


def build(case, step):
    """Return the scene at launch."""
    engine = mujoco.MjModel.from_xml_string(model(case, step))
    data = mujoco.MjData(engine)
    data.qpos[:] = [*case["position"], *case["quaternion"]]
    data.qvel[:] = [*case["velocity"], *case["omega"]]  # omega along the body's axes
    return engine, data


def advance(scene):
    """Make one step."""
    mujoco.mj_step(*scene)


def look(scene):
    """Return position, rotation, velocity, angular velocity and number of contacts."""
    _, data = scene
    # data.xmat is that at the begin of the step.
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, data.qpos[3:7])
    turn = turn.reshape(3, 3)
    return data.qpos[:3], turn, data.qvel[:3], turn @ data.qvel[3:6], data.ncon
