"""Whether the 95 % intervals of `rs.fit` contain the truth 95 times of 100, and how long a fit takes.

Each data set is a synthetic video of a wooden stone at 240 frames a second: the angle of its long
axis with a noise of 0.5 degrees, or the spin as its central differences, of which 5 % are missing.
The truth is drawn anew each time, and the fit is told nothing of it.

    python benchmarks/fit_coverage.py --sets 500 --measured spin
    python benchmarks/fit_coverage.py --write configs/fit/data.csv
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import rattlesweep as rs
from rattlesweep.arrays import Floats

STONE = rs.Rattleback.half_ellipsoid(
    length="12 cm", width="3 cm", height="12 mm", mass="60 g", skew="3 deg"
)
NOISE = math.radians(0.5)
MISSING = 0.05


def measured(
    truth: dict[str, float], kind: str, seconds: float, rate: float, generator: np.random.Generator
) -> pd.DataFrame:
    """Return the table of a video."""
    t = np.arange(0, seconds, 1 / rate)
    angle = heading(truth, t / STONE.units.time) + generator.normal(0, NOISE, len(t))
    if kind == "angle":
        value, name = np.degrees(angle) % 180, "angle_deg"
    else:
        value, name = np.gradient(angle, t) * 30 / math.pi, "spin_rpm"
    value[generator.random(len(t)) < MISSING] = np.nan
    return pd.DataFrame({"t_s": t, name: value})


def heading(truth: dict[str, float], times: Floats) -> Floats:
    """Return the direction of the long axis from above, by the attitude as a quaternion."""
    names = ["q0", "q1", "q2", "q3"]
    run = rs.trajectory(STONE, **truth, t_end=times[-1], times=times, channels=names)
    w, x, y, z = run.table[names].to_numpy().T
    a, b = -math.sin(STONE.xi), math.cos(STONE.xi)
    east = (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b
    north = 2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b
    return np.unwrap(np.arctan2(north, east))


def drawn(generator: np.random.Generator) -> dict[str, float]:
    """Return a truth: launched by hand on a table, in the units of the stone."""
    return {
        "n_i": generator.uniform(0.2, 0.4),
        "omega_xy0": 0.01 * 6 ** generator.random(),
        "sigma": generator.uniform(2e-3, 6e-3),
        "rolling": generator.uniform(5e-4, 2e-3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sets", type=int, default=500)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--measured", choices=["angle", "spin"], default="spin")
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    if options.write:
        truth = {"n_i": 0.3, "omega_xy0": 0.03, "sigma": 4e-3, "rolling": 0.0}
        table = measured(truth, "angle", 3.0, 120.0, np.random.default_rng(2017)).round(4)
        table.to_csv(options.write, index=False)
        return
    rows: list[dict[str, Any]] = []
    for number in range(options.first, options.first + options.sets):
        generator = np.random.default_rng([2017, number])
        truth = drawn(generator)
        table = measured(truth, options.measured, options.seconds, 240.0, generator)
        begin = time.perf_counter()
        found = rs.fit(STONE, table, free=list(truth))
        row: dict[str, Any] = {"seconds": time.perf_counter() - begin, "noise": found.noise,
                               "remarks": len(found.remarks)}  # fmt: skip
        for name, value in truth.items():
            low, high = found.intervals[name]
            row |= {name: low <= value <= high, f"{name} width": (high - low) / 2 / value,
                    f"{name} error": found.values[name] / value - 1}  # fmt: skip
        rows.append(row)
    table = pd.DataFrame(rows)
    print(f"{len(table)} data sets of {options.measured}, {options.seconds:g} s at 240 Hz")
    print(f"one fit: median {table.seconds.median():.2f} s, longest {table.seconds.max():.2f} s")
    print(f"noise: median {table.noise.median():.4f} deg; sets with a remark: "
          f"{(table.remarks > 0).sum()}")  # fmt: skip
    for name in truth:
        covered, error = table[name].mean(), table[f"{name} error"]
        print(f"{name:>10}: {100 * covered:5.1f} % within; half width {table[f'{name} width'].median():.2%}, "
              f"error {error.mean():+.2%} +- {error.std() / math.sqrt(len(table)):.2%}")  # fmt: skip


if __name__ == "__main__":
    main()
