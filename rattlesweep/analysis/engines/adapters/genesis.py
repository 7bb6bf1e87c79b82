"""Genesis, in double precision."""

import genesis as gs
import numpy as np

from rattlesweep.analysis.engines.adapters.mjcf import model

PACKAGES = ("genesis-world", "quadrants", "torch")

gs.init(backend=gs.cpu, precision="64", logging_level="warning")  # once a process


def build(case, step):
    """Return the scene and the body at launch."""
    scene = gs.Scene(
        sim_options=gs.options.SimOptions(dt=step, gravity=(0, 0, -case["gravity"])),
        # It takes none of these from the model.
        rigid_options=gs.options.RigidOptions(
            integrator=gs.integrator.Euler,
            friction_cone=gs.friction_cone.elliptic,
            enable_torsional_friction=case["lever"] > 0,
            iterations=100,
            tolerance=1e-12,
        ),
        show_viewer=False,
    )
    entity = scene.add_entity(gs.morphs.MJCF(file=model(case, step)))
    scene.build()
    entity.set_qpos([*case["position"], *case["quaternion"]])
    entity.set_dofs_velocity([*case["velocity"], *case["omega"]])  # the body's axes
    return scene, entity.get_link("rattleback"), entity


def advance(scene):
    """Make one step."""
    scene[0].step(update_visualizer=False)


def look(scene):
    """Return position, rotation, velocity, angular velocity and number of contacts."""
    _, stone, entity = scene
    w, x, y, z = np.array(stone.get_quat())
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    place, velocity, omega = map(
        np.array, (stone.get_pos(), stone.get_vel(), stone.get_ang())
    )
    count = len(entity.get_contacts()["penetration"])
    return place, turn, velocity, omega, count
