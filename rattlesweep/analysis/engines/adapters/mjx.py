"""MJX, MuJoCo in JAX, in double precision."""

import jax
import mujoco
import numpy as np
from mujoco import mjx

from rattlesweep.analysis.engines.adapters.mjcf import model

PACKAGES = ("mujoco-mjx", "jax")

jax.config.update("jax_enable_x64", True)
STEP = jax.jit(mjx.step)  # compiled once, for all time steps


def build(case, step):
    """Return the model and the state."""
    # MJX runs `implicitfast` as Euler, so the file says Euler.
    text = model(case, step).replace("implicitfast", "Euler")
    engine = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(engine)
    data.qpos[:] = [*case["position"], *case["quaternion"]]
    data.qvel[:] = [*case["velocity"], *case["omega"]]  # omega along the body's axes
    return {"model": mjx.put_model(engine), "state": mjx.put_data(engine, data)}


def advance(scene):
    """Make one step."""
    scene["state"] = STEP(scene["model"], scene["state"])


def look(scene):
    """Return position, rotation, velocity, angular velocity and number of contacts."""
    state = scene["state"]
    place, moving = np.array(state.qpos), np.array(state.qvel)
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, place[3:7])
    turn = turn.reshape(3, 3)
    count = int(np.sum(np.array(state._impl.contact.dist) < 0))
    return place[:3], turn, moving[:3], turn @ moving[3:6], count
