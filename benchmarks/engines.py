"""How far off the first reversals of physics engines are, and what that costs.

    pip install -e '.[engines]'
    python benchmarks/engines.py                 # MuJoCo by its settings, all cases
    python benchmarks/engines.py --all --cases demo-clockwise
    python benchmarks/engines.py --engine drake dart
    python benchmarks/engines.py --check         # our times by an independent program

runs the cases of `benchmarks/engines/`, which `rattlesweep export --cases` writes.  A
row has the error of the first reversal, relative to the expected time, and the
seconds of the processor that it took.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from typing import Any

import numpy as np
from machine import ROOT, heading

from rattlesweep.analysis.engines.adapters import frame
from rattlesweep.analysis.engines.case import EngineCase
from rattlesweep.analysis.engines.script import HERE, numbers_of
from rattlesweep.words.engines import ENGINES

FOLDER = ROOT / "benchmarks" / "engines"
LATE = 1.6  # a run ends at so many times the expected first reversal
# Time constants of MuJoCo's contact in sqrt(a/g), each with steps of half of it.
LADDER = (0.04, 0.02, 0.01, 0.005, 0.0025, 0.00125, 0.000625)
# Time constants with a stronger damping of slip: the share of the slip that one time
# step takes away, twice that at most being stable.
GRIPS = (0.04, 0.02, 0.01, 0.005)  # sqrt(a/g)
GRIP = 1.8
STEPS = (0.01, 0.005, 0.0025, 0.00125)  # of all engines, sqrt(a/g)
# Adapters that are here, since they have balls alone, and what pip installs for them.
BALLS_ALONE = {"jolt": "culverin", "drake_patch": "drake"}


@dataclass(frozen=True)
class Result:
    """The first reversal that an engine found, in s, and what it cost."""

    first_reversal: float | None
    seconds: float
    energy: float  # at the end over that at launch, without the potential at rest


class Watch:
    """Finds the first zero of the spin that counts."""

    def __init__(self, case: dict) -> None:
        self.counts_above = case["expected"]["counts_above"]
        self.armed = self.counts_above == 0
        self.before: tuple[float, float] | None = None

    def sees(self, t: float, spin: float) -> float | None:
        """Return the time of a zero between the last look and this one."""
        before = self.before
        self.before = t, spin
        if not self.armed:
            self.armed = abs(spin) > self.counts_above
        elif before is not None and before[1] * spin <= 0:
            t0, spin0 = before
            return t0 + (t - t0) * spin0 / (spin0 - spin)
        return None


def time_unit(case: dict) -> float:
    """Return sqrt(a/g) in s."""
    return math.sqrt(case["body"]["height"] / case["plane"]["gravity"])


def watched(
    case: dict, step: Callable[[], tuple[float, float]], energy: Callable[[], float]
) -> Result:
    """Step an engine until the spin reverses; `step` returns time and spin."""
    watch = Watch(case)
    watch.sees(0.0, case["expected"]["poses"][0]["spin"])
    begin = time.process_time()
    end = LATE * case["expected"]["first_reversal"]["time"]
    found = None
    t = 0.0
    while found is None and t < end:
        t, spin = step()
        found = watch.sees(t, spin)
    seconds = time.process_time() - begin
    return Result(found, seconds, energy() / case["expected"]["energy"])


def mujoco_run(
    case: dict,
    share: float | None = None,
    steps: int = 2,
    defaults: bool = False,
    grip: float | None = None,
) -> Result:
    """Run the exported model, with another time constant in sqrt(a/g) if it is given.

    With `grip`, a contact pair damps slip by this share a time step, instead of by
    2 / `steps`.  With `defaults` the contact and the time step are those that MuJoCo
    has by default.
    """
    import mujoco

    spec = mujoco.MjSpec.from_file(str(FOLDER / f"{case['name']}.xml"))
    if share is not None and grip is not None:
        surface = spec.geom("surface")
        sliding, pivoting, _ = surface.friction
        time_constant = share * time_unit(case)
        spec.add_pair(
            geomname1="plane",
            geomname2="surface",
            condim=surface.condim,
            friction=[sliding, sliding, pivoting, 0, 0],
            solref=[time_constant, 1],
            # Without stiffness; negative numbers are taken as they are.
            solreffriction=[0, -grip * steps / time_constant],
            solimp=surface.solimp,
        )
    model = spec.compile()
    if share is not None:
        model.geom_solref[:, 0] = share * time_unit(case)
        model.opt.timestep = share * time_unit(case) / steps
    if defaults:
        model.geom_solref[:] = [0.02, 1.0]
        model.geom_solimp[:] = [0.9, 0.95, 0.001, 0.5, 2.0]
        model.opt.timestep = 0.002
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        model.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    rest = case["body"]["mass"] * case["plane"]["gravity"] * case["body"]["height"]

    def step() -> tuple[float, float]:
        mujoco.mj_step(model, data)
        # The third row of the body's rotation gives the vertical component.
        return data.time, float(data.xmat[1][6:] @ data.qvel[3:6])

    def energy() -> float:
        return float(data.energy.sum()) - rest

    return watched(case, step, energy)


Settings = Iterator[tuple[str, Callable[[dict], Result]]]


def mujoco_settings(ladder: Sequence[float]) -> Settings:
    yield "defaults", lambda case: mujoco_run(case, defaults=True)
    yield "as exported", mujoco_run
    for share in ladder:
        yield f"{share}", lambda case, share=share: mujoco_run(case, share)
    for share in GRIPS:
        yield (
            f"{share} with grip",
            lambda case, share=share: mujoco_run(case, share, grip=GRIP),
        )


def ladder(
    case: dict, engine: str, steps: Sequence[float], at_most: float, pace: float
) -> float:
    """Print what an engine finds with each of the steps, in sqrt(a/g).

    A run that is expected to take more than `at_most` seconds of the processor is left
    out. `pace` is the time of one step in seconds, or 0; that of the last run is
    returned.
    """
    if case["plane"]["losses"] and not ENGINES[engine].pivots:
        print(f"{engine} | {case['name']} | no pivoting friction here")
        return pace
    numbers = numbers_of(EngineCase.model_validate(case))
    adapter = adapter_of(engine)
    # The first steps of a case compile.
    scene = adapter.build(numbers, steps[0] * time_unit(case))
    for _ in range(3):
        adapter.advance(scene)
    errors: list[float] = []
    for step in steps:
        count = numbers["first_reversal"] / (step * time_unit(case))
        if pace * count > at_most:
            print(
                f"{engine} | {case['name']} | {step:g} | left out: it would take "
                f"{pace * count:.0f} s of the processor, or more",
                flush=True,
            )
            break
        seen = frame.run(adapter, numbers, step * time_unit(case))
        if math.isnan(seen["reversal, s"]):
            count *= frame.LATEST
        pace = seen["CPU, s"] / count
        errors.append(seen["error, %"])
        order = ""
        if len(errors) > 1 and errors[-1] and errors[-2] / errors[-1] > 0:
            halvings = math.log2(steps[len(errors) - 2] / step)
            order = f"{math.log2(errors[-2] / errors[-1]) / halvings:.2f}"
        print(
            f"{engine} | {case['name']} | {step:g} | {errors[-1]:+.4g} | {order} | "
            f"{seen['energy left']:.4f} | {seen['slip, mm/s']:.4g} | "
            f"{seen['gap, um']:.4g} to {seen['to']:.4g} | {seen['CPU, s']:.2f}",
            flush=True,
        )
    return pace


def adapter_of(engine: str) -> Any:
    """Return an engine's adapter."""
    return import_module(engine if engine in BALLS_ALONE else f"{HERE}.{engine}")


def is_installed(name: str) -> bool:
    """Print the versions of an engine's packages, or how to install them."""
    try:
        adapter = adapter_of(name)
    except ImportError:
        installs = BALLS_ALONE.get(name) or ENGINES[name].installs
        print(f"{name} | not installed: pip install {installs}")
        return False
    print(*(f"{each} {version(each)}" for each in adapter.PACKAGES), sep=", ")
    return True


def climb(
    names: Sequence[str], cases: Sequence[dict], steps: Sequence[float], at_most: float
) -> None:
    """Print the ladders of engines; those that are not installed are named."""
    print(
        "engine | case | step, sqrt(a/g) | error, % | order | energy left | "
        "slip, mm/s | gap, um | CPU, s"
    )
    for name in names:
        if not is_installed(name):
            continue
        pace = 0.0
        for case in cases:
            pace = ladder(case, name, steps, at_most, pace)


def independent(case: dict) -> float:
    """Return the first reversal of a case by the vector program of the tests, in s."""
    sys.path.insert(0, str(ROOT / "tests" / "helpers"))
    import friction_oracle
    import stone_oracle

    from rattlesweep import Rattleback

    unit = time_unit(case)
    parameters = case["body"]["parameters"]
    start = case["launch"]
    # Back to axes with z down.
    flip = np.array([1.0, -1.0, -1.0])
    omega = flip * np.array(start["omega"]) * unit
    w, x, y, z = start["quaternion"]
    vertical = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 0.0])
    vertical[2] = 1 - 2 * (x * x + y * y)
    u = flip * vertical
    expected = case["expected"]["first_reversal"]["time"] / unit
    mu = case["plane"]["friction"]
    if mu is not None:
        body = Rattleback(**parameters)
        options = {"mu": mu, "rtol": 1e-11, "through": False}
        found = friction_oracle.run(body, u, omega, 1.1 * expected, **options)
        return unit * found.t_r
    if "pivot" in case["plane"]["losses"]:
        body = Rattleback(**parameters)
        lever = case["plane"]["losses"]["pivot"]["value"] / case["body"]["height"]
        found = friction_oracle.run(body, u, omega, 1.02 * expected, lever, rtol=1e-12)
        return unit * found.t_r
    path = stone_oracle.follow(parameters, u, omega, 1.02 * expected)
    above = case["expected"]["counts_above"] * unit
    times = np.linspace(0.0, 1.02 * expected, 100_001)
    spin = np.einsum("ij,ij->j", path.sol(times)[:3], path.sol(times)[3:6])
    armed = np.maximum.accumulate(np.abs(spin)) > above
    crossings = np.flatnonzero((spin[1:] * spin[:-1] < 0) & armed[:-1])
    first = int(crossings[0])
    from scipy.optimize import brentq

    def spin_at(t: float) -> float:
        y = path.sol(t)
        return float(y[:3] @ y[3:6])

    return unit * brentq(spin_at, times[first], times[first + 1], xtol=1e-15)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--engine", nargs="+", choices=ENGINES, help="ladders of these")
    parser.add_argument("--all", action="store_true", help="ladders of all engines")
    parser.add_argument("--cases", nargs="*", help="names of cases; by default all")
    parser.add_argument(
        "--ladder",
        nargs="*",
        type=float,
        help="time steps, or time constants of MuJoCo, in sqrt(a/g)",
    )
    parser.add_argument(
        "--at-most",
        type=float,
        default=math.inf,
        help="leave out runs of more seconds of the processor",
    )
    parser.add_argument("--check", action="store_true", help="our own times instead")
    options = parser.parse_args()
    names = options.cases or [path.stem for path in sorted(FOLDER.glob("*.xml"))]
    cases = [json.loads((FOLDER / f"{name}.json").read_text()) for name in names]
    print(heading())
    if options.check:
        print("case | first reversal, s | methods differ by | independent differs by")
        for case in cases:
            expected = case["expected"]["first_reversal"]["time"]
            _, other = (method["first_reversal"] for method in case["methods"])
            differs = independent(case) / expected - 1
            print(
                f"{case['name']} | {expected:.12g} | {other / expected - 1:.1e} | "
                f"{differs:.1e}",
                flush=True,
            )
        return
    if options.all or options.engine:
        steps = options.ladder or STEPS
        climb(options.engine or list(ENGINES), cases, steps, options.at_most)
        return
    print("mujoco", version("mujoco"))
    print("case | settings | first reversal, s | error | seconds | energy left")
    for case in cases:
        expected = case["expected"]["first_reversal"]["time"]
        for label, run in mujoco_settings(options.ladder or LADDER):
            result = run(case)
            found = "none"
            error = ""
            if result.first_reversal is not None:
                found = f"{result.first_reversal:.6g}"
                error = f"{result.first_reversal / expected - 1:+.3%}"
            print(
                f"{case['name']} | {label} | {found} | {error} | "
                f"{result.seconds:.2f} | {result.energy:.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
