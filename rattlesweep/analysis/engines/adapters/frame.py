"""Steps an engine until the spin reverses, and tells what it did on the way."""

import argparse
import math
import time
from importlib.metadata import version

import numpy as np

LATEST = 1.6  # a run ends at so many times the expected first reversal


def look_of(case, position, turn, velocity, omega):
    """Return spin, energy, and the gap and slip of the lowest point of the ellipsoid.

    `turn` is the rotation from body to world axes; all vectors are the world's.
    """
    along = turn.T @ omega
    energy = 0.5 * case["mass"] * velocity @ velocity
    energy += 0.5 * along @ (np.array(case["inertia"]) * along)
    energy += case["mass"] * case["gravity"] * (position[2] - case["height"])
    cos, sin = math.cos(case["angle"]), math.sin(case["angle"])
    axes = turn @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    shape = axes * np.array(case["semi_axes"])  # its columns are the semi-axes
    down = shape @ shape[2] / math.sqrt(shape[2] @ shape[2])
    arm = turn @ np.array(case["centre"]) - down
    slip = velocity + np.cross(omega, arm)
    return omega[2], energy, position[2] + arm[2], math.hypot(slip[0], slip[1])


def run(engine, case, step):
    """Step the engine until the spin reverses; return the time and what was seen.

    `engine` has `build(case, step)`, `advance(scene)` and `look(scene)`, which returns
    position, rotation, velocity, angular velocity and the number of contacts.
    """
    begin = time.process_time()
    scene = engine.build(case, step)
    steps = math.ceil(LATEST * case["first_reversal"] / step)
    armed = case["counts_above"] == 0
    spin_before = case["spin"]
    gaps, slips, contacts = [], [], []
    for count in range(1, steps + 1):
        engine.advance(scene)
        *motion, touching = engine.look(scene)
        spin, energy, gap, slip = look_of(case, *motion)
        gaps.append(gap)
        slips.append(slip)
        contacts.append(touching)
        if armed and spin * spin_before <= 0:
            found = step * (count - spin / (spin - spin_before))
            break
        armed = armed or abs(spin) > case["counts_above"]
        spin_before = spin
    else:
        found = math.nan
    return {
        "reversal, s": found,
        "error, %": 100 * (found / case["first_reversal"] - 1),
        "energy left": energy / case["energy"],
        "slip, mm/s": 1e3 * sum(slips) / len(slips),
        "most": 1e3 * max(slips),
        "gap, um": 1e6 * min(gaps),
        "to": 1e6 * max(gaps),
        "contacts": sum(contacts) / len(contacts),
        "CPU, s": time.process_time() - begin,
    }


def main(engine, case, step):
    """Run a case with a step and with half of it, and extrapolate to none."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--step", type=float, default=step, help="longest step, s")
    parser.add_argument("--rungs", type=int, default=2, help="each halves the step")
    options = parser.parse_args()
    print(", ".join(f"{name} {version(name)}" for name in engine.PACKAGES))
    print(f"{case['name']}: the first reversal is at {case['first_reversal']:.10g} s")
    rows = []
    for rung in range(options.rungs):
        step = options.step / 2**rung
        rows.append(run(engine, case, step))
        if rung == 0:
            print("step, ms", *rows[0], sep=" | ")
        print(f"{1e3 * step:.5g}", *(f"{x:.6g}" for x in rows[-1].values()), sep=" | ")
    coarse, fine = ([math.nan] + [row["reversal, s"] for row in rows])[-2:]
    best = 2 * fine - coarse
    if not math.isnan(best):
        error = 100 * (best / case["first_reversal"] - 1)
        print(f"extrapolated to a step of 0: {best:.8g} s, {error:+.3g} %")
