"""Newton, with its solver XPBD, in single precision."""

import math

import newton
import numpy as np
import warp as wp

PACKAGES = ("newton", "warp-lang")


def build(case, step):
    """Return the model, the solver and two states, which take turns."""
    wp.config.log_level = wp.LOG_ERROR
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -case["gravity"]))
    rubs = builder.ShapeConfig(
        density=0.0, mu=case["friction"], mu_torsional=case["lever"], mu_rolling=0.0
    )
    w, *xyz = case["quaternion"]
    stone = builder.add_body(
        xform=wp.transform(case["position"], wp.quat(*xyz, w)),
        mass=case["mass"],
        inertia=wp.mat33(*np.diag(case["inertia"]).ravel()),
        lock_inertia=True,
    )
    half = case["angle"] / 2
    place = wp.transform(
        case["centre"], wp.quat(0.0, 0.0, math.sin(half), math.cos(half))
    )
    rx, ry, rz = case["semi_axes"]
    builder.add_shape_ellipsoid(stone, xform=place, rx=rx, ry=ry, rz=rz, cfg=rubs)
    builder.add_ground_plane(cfg=rubs)
    model = builder.finalize(device="cpu")
    states = [model.state(), model.state()]
    turn = np.array(wp.quat_to_matrix(wp.quat(*xyz, w))).reshape(3, 3)
    omega = turn @ np.array(case["omega"])
    states[0].body_qd.assign(np.array([[*case["velocity"], *omega]], np.float32))
    solver = newton.solvers.SolverXPBD(model)
    detector = newton.CollisionPipeline(model)
    return {
        "detector": detector,
        "solver": solver,
        "states": states,
        "contacts": detector.contacts(),
        "step": step,
    }


def advance(scene):
    """Make one step."""
    before, after = scene["states"]
    before.clear_forces()
    scene["detector"].collide(before, scene["contacts"])
    scene["solver"].step(before, after, None, scene["contacts"], scene["step"])
    scene["states"] = [after, before]


def look(scene):
    """Return position, rotation, velocity, angular velocity and number of contacts."""
    state = scene["states"][0]
    x, y, z, *attitude = state.body_q.numpy()[0].astype(float)
    velocity, omega = state.body_qd.numpy()[0].astype(float).reshape(2, 3)
    turn = np.array(wp.quat_to_matrix(wp.quat(*attitude)), float).reshape(3, 3)
    count = int(scene["contacts"].rigid_contact_count.numpy()[0])
    return np.array([x, y, z]), turn, velocity, omega, count
