"""Scenes that show one fault of a physics engine each.

    python benchmarks/faults.py                  # the engines that are installed
    python benchmarks/faults.py --engine rapier --scenes marble --step 0.004

runs the scenes of `benchmarks/engines/faults.yaml`.  A row has the number that the
scene measures, what is right within a tolerance, and what the fault gives.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
from engines import BALLS_ALONE, adapter_of, is_installed
from machine import ROOT, heading
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from rattlesweep.analysis.engines.adapters import frame
from rattlesweep.words.engines import ENGINES

SCENES = ROOT / "benchmarks" / "engines" / "faults.yaml"
GRAVITY = 9.81


def scenes() -> dict[str, dict[str, Any]]:
    """Return the scenes by name."""
    return YAML(typ="safe").load(SCENES.read_text("utf-8"))


def larger(scene: dict[str, Any], times: float) -> dict[str, Any]:
    """Return a scene of a larger body, whose number is the same."""
    return {
        key: (np.array(value) * times ** POWERS[key]).tolist()
        if key in POWERS
        else value
        for key, value in scene.items()
    }


def case_of(scene: dict[str, Any]) -> dict[str, Any]:
    """Return the numbers of a scene, as the adapters of engines take them."""
    pull = [float(x) for x in scene.get("gravity", [0, 0, -GRAVITY])]
    return {
        "mass": 1.0,
        "height": scene["semi_axes"][2],
        "inertia": scene["inertia"],
        "semi_axes": scene["semi_axes"],
        "angle": 0.0,
        "centre": [0.0, 0.0, 0.0],
        "gravity": -pull[2],
        "pull": pull,
        "friction": float(scene.get("friction", 1)),
        "lever": scene.get("lever", 0.0),
        "position": [float(x) for x in scene["position"]],
        "quaternion": [float(x) for x in scene.get("quaternion", [1, 0, 0, 0])],
        "velocity": [float(x) for x in scene.get("velocity", [0, 0, 0])],
        "omega": [float(x) for x in scene.get("omega", [0, 0, 0])],
    }


# How an engine gets a gravity that is not along z; others have no scenes with a slope.
SLOPES: dict[str, Callable[[Any, Sequence[float]], None]] = {
    "mujoco": lambda scene, gravity: np.copyto(scene[0].opt.gravity, gravity),
    "bullet": lambda scene, gravity: import_module("pybullet").setGravity(*gravity),
    "newton": lambda scene, gravity: scene["solver"].model.set_gravity(gravity),
    "genesis": lambda scene, gravity: scene[0].sim.set_gravity(np.array(gravity)),
    "drake_patch": lambda scene, gravity: None,  # it has it from its case
}

# Engines with a patch whose pressure falls as on a bed of springs: they have another
# number, and the patch resists rolling in proportion to the step.
PATCHES = {"drake_patch"}
PATCH_STEPS = 4  # a step of the scene

# Engines whose contact is made for larger bodies: how much larger their scenes are.
# Jolt's allows a depth of 20 mm, and its bodies turn at 47 rad/s at most.
LARGER = {"jolt": 100.0}
# What grows with the size of a scene at the same gravity, and by which power.
POWERS = {
    **{"inertia": 2, "semi_axes": 1, "position": 1, "velocity": 0.5, "omega": -0.5},
    **{"step": 0.5, "until": 0.5},
}


# Engines whose files have hulls: the shape of a ball.
BALLS: dict[str, Callable[[Any, dict[str, Any]], Any]] = {
    "rapier": lambda adapter, case: adapter.rapier.Collider.ball(
        case["height"], density=0.0, friction=case["friction"], restitution=0.0
    ),
    "bullet": lambda adapter, case: adapter.bullet.createCollisionShape(
        adapter.bullet.GEOM_SPHERE, radius=case["height"]
    ),
}


def built(name: str, adapter: Any, case: dict[str, Any], step: float) -> Any:
    """Return an engine's scene at launch; a ball has its own shape."""
    if name not in BALLS or len(set(case["semi_axes"])) > 1:
        return adapter.build(case, step)
    hull = adapter.surface
    adapter.surface = partial(BALLS[name], adapter)
    try:
        return adapter.build(case, step)
    finally:
        adapter.surface = hull


def soft(scene: Any) -> None:
    """Give MuJoCo the contact that it has by default."""
    scene[0].geom_solref[:] = [0.02, 1.0]
    scene[0].geom_solimp[:] = [0.9, 0.95, 0.001, 0.5, 2.0]


def without_gyroscopic_term(scene: Any) -> None:
    """Give a body of Rapier what it has by default."""
    world, stone = scene
    world.rigid_bodies[stone].gyroscopic_forces_enabled = False


def deep(scene: Any) -> None:
    """Put a ball of Jolt 0.1 of its radius into the plane, which Jolt allows."""
    world, ball, _, radius = scene
    world.set_position(ball, 0.0, 0.0, 0.9 * radius)


# Engines with other settings than those of their files, for a scene each.
OTHERWISE = {
    ("mujoco", "bead"): ("contact by default", soft),
    ("rapier", "turns-over"): ("by default", without_gyroscopic_term),
    ("jolt", "bead"): ("0.1 of the radius deep", deep),
}


def measured(
    name: str, scene: dict[str, Any], change: Callable[[Any], None] | None = None
) -> float:
    """Return the number of a scene in an engine."""
    adapter = adapter_of(name)
    scene = larger(scene, LARGER.get(name, 1.0))
    case = case_of(scene)
    state = built(name, adapter, case, scene["step"])
    if change is not None:
        change(state)
    if "gravity" in scene:
        SLOPES[name](state, scene["gravity"])
    turn = Rotation.from_quat(np.roll(case["quaternion"], -1)).as_matrix()
    at_launch = frame.look_of(
        case,
        np.array(case["position"]),
        turn,
        np.array(case["velocity"]),
        turn @ np.array(case["omega"]),
    )
    gaps, slips, spins = [], [], []
    for _ in range(round(scene["until"] / scene["step"])):
        adapter.advance(state)
        position, turn, velocity, omega, _ = adapter.look(state)
        spin, energy, gap, slip = frame.look_of(case, position, turn, velocity, omega)
        gaps.append(gap)
        slips.append(slip)
        spins.append(spin)
    return {
        "spin about the body's y": lambda: (turn.T @ omega)[1] / case["omega"][1],
        "speed": lambda: velocity[0] / case["velocity"][0],
        "hop": lambda: max(gaps) / case["height"],
        "depth": lambda: -np.mean(gaps[len(gaps) // 2 :]) / case["height"],
        "spin": lambda: spin / at_launch[0],
        "slip over spin": lambda: sum(slips) / sum(spins),
        "energy": lambda: energy / at_launch[1],
    }[scene["measure"]]()


def scene_for(name: str, scene: dict[str, Any]) -> dict[str, Any]:
    """Return a scene with the number and the step that are right for an engine."""
    if name not in PATCHES:
        return dict(scene)
    return {
        **scene,
        "expected": scene["on springs"],
        "step": scene["step"] / PATCH_STEPS,
    }


def suits(name: str, scene: dict[str, Any]) -> bool:
    """Return whether an engine has what a scene asks for."""
    if name == "jolt":
        return len(set(scene["semi_axes"])) == 1 and "lever" not in scene
    if name in PATCHES:
        return "on springs" in scene
    if "lever" in scene and not ENGINES[name].pivots:
        return False
    return "gravity" not in scene or name in SLOPES


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known = [*ENGINES, *BALLS_ALONE]
    parser.add_argument("--engine", nargs="+", choices=known, default=known)
    parser.add_argument("--scenes", nargs="+", choices=scenes(), default=list(scenes()))
    parser.add_argument("--step", type=float, help="instead of those of the scenes, s")
    options = parser.parse_args()
    print(heading())
    print("engine | scene | step, ms | number | right | tolerance | with the fault")
    for name in options.engine:
        if not is_installed(name):
            continue
        for label in options.scenes:
            scene = scenes()[label]
            if not suits(name, scene):
                continue
            scene = scene_for(name, scene)
            scene["step"] = options.step or scene["step"]
            runs = [("", None)]
            if (name, label) in OTHERWISE:
                runs.append(OTHERWISE[name, label])
            for setting, change in runs:
                number = measured(name, scene, change)
                off = abs(number - scene["expected"])
                verdict = "right" if off <= scene["tolerance"] else "WRONG"
                print(
                    f"{name} {setting} | {label} | {1e3 * scene['step']:g} | "
                    f"{number:.6g} | {scene['expected']:.6g} | "
                    f"{scene['tolerance']:g} | {scene['fault']:g} | {verdict}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
