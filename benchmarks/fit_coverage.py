"""How often the 95 % intervals of `rs.fit` contain the truth, and how long a fit takes.

Each data set is a synthetic video of a wooden stone at 240 frames a second, of which 5
% are missing: the angle of its long axis with a noise of 0.5 degrees, or its spin with
one of 3 rpm. The truth is drawn anew each time and not known to the fit. Prints the
tables of fit.md.  With `--ruler` the sizes of the stone are drawn, too, there is no
rolling resistance, and the fit knows the sizes as measured: `errors` takes them with
their errors, `exact` as exact.

    python benchmarks/fit_coverage.py --sets 500
    python benchmarks/fit_coverage.py --sets 200 --ruler errors
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

# What the ruler says, in SI units and radians, and its standard errors.
SIZES = {
    "length": (0.12, 2e-4),
    "width": (0.03, 2e-4),
    "height": (0.012, 1e-4),
    "mass": (0.06, 1e-3),
    "skew": (math.radians(3), math.radians(0.2)),
}
UNITS = {"mass": "kg", "skew": "rad"}


def stone_of(sizes: dict[str, float]) -> rs.Rattleback:
    """Return the stone of some sizes in SI units."""
    texts = {
        name: f"{float(value)!r} {UNITS.get(name, 'm')}"
        for name, value in sizes.items()
    }
    return rs.Rattleback.half_ellipsoid(**texts)


RULER = {name: value for name, (value, _) in SIZES.items()}
STONE = stone_of(RULER)
NOISE = {"angle_deg": 0.5, "n_rpm": 3.0}
MISSING = 0.05


def measured(
    stone: rs.Rattleback,
    truth: dict[str, Any],
    column: str,
    seconds: float,
    rate: float,
    generator: np.random.Generator,
) -> pd.DataFrame:
    """Return the table of a video; the angle is that of the attitude as a
    quaternion.
    """
    assert stone.units is not None
    t = np.arange(0, seconds, 1 / rate)
    times = t / stone.units.time
    names = ["q0", "q1", "q2", "q3", "n"]
    # The truth is in units of the body.
    run = rs.trajectory(
        stone.replace(units=None), **truth, t_end=times[-1], times=times, channels=names
    ).table
    w, x, y, z, value = run[names].to_numpy().T
    if column == "angle_deg":
        a = -math.sin(stone.xi)
        b = math.cos(stone.xi)
        east = (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b
        north = 2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b
        value = np.degrees(np.arctan2(north, east))
    else:
        value = value / stone.units.time * 30 / math.pi
    value = value + generator.normal(0, NOISE[column], len(t))
    value[generator.random(len(t)) < MISSING] = np.nan
    if column == "angle_deg":
        value = value % 180
    return pd.DataFrame({"t_s": t, column: value})


def drawn(generator: np.random.Generator) -> dict[str, Any]:
    """Return a truth: launched by hand on a table, in the units of the stone."""
    return {
        "n_i": generator.uniform(0.2, 0.4),
        "omega_xy0": 0.01 * 6 ** generator.random(),
        "sigma": generator.uniform(2e-3, 6e-3),
        "rolling": generator.uniform(5e-4, 2e-3),
    }


def drawn_sizes(generator: np.random.Generator) -> dict[str, float]:
    """Return true sizes that the ruler could have measured as it did."""
    return {name: generator.normal(*size) for name, size in SIZES.items()}


def in_si(stone: rs.Rattleback, truth: dict[str, Any]) -> dict[str, float]:
    """Return a truth in rpm and SI units."""
    assert stone.units is not None
    sizes = stone.units.sizes
    rpm = 30 / math.pi / stone.units.time
    return {
        "n_i": rpm * truth["n_i"],
        "omega_xy0": rpm * truth["omega_xy0"],
        "sigma": sizes["M a^2 sqrt(g/a)"][0] * truth["sigma"],
        "rolling": sizes["a"][0] * truth["rolling"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sets", type=int, default=500)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--column", choices=list(NOISE), default="angle_deg")
    parser.add_argument("--ruler", choices=["errors", "exact"])
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    if options.write:
        truth: dict[str, Any] = {
            "n_i": 0.3,
            "omega_xy0": 0.03,
            "sigma": 4e-3,
            "rolling": 0.0,
        }
        table = measured(
            STONE, truth, "angle_deg", 3.0, 120.0, np.random.default_rng(2017)
        ).round(4)
        table.to_csv(options.write, index=False)
        return
    rows: list[dict[str, Any]] = []
    for number in range(options.first, options.first + options.sets):
        generator = np.random.default_rng([2017, number])
        truth = drawn(generator)
        stone = STONE
        if options.ruler:
            stone = stone_of(drawn_sizes(generator))
            truth["rolling"] = 0.0
        free = [name for name, value in truth.items() if value > 0]
        table = measured(stone, truth, options.column, 4.0, 240.0, generator)
        body: Any = STONE
        if options.ruler == "errors":
            body = {"shape": "half_ellipsoid"}
            for name, (value, error) in SIZES.items():
                body[name] = f"{value} +- {error} {UNITS.get(name, 'm')}"
        begin = time.process_time()
        fit = rs.fit(body, table, free=free)
        seconds = time.process_time() - begin
        true_values = in_si(stone, truth)
        for name in free:
            value = true_values[name]
            best, low, high, _ = fit.in_si[name]
            rows.append(
                {
                    "set": number,
                    "seconds": seconds,
                    "noise": fit.noise,
                    "remarks": len(fit.remarks),
                    "parameter": name,
                    "covered": low <= value <= high,
                    "width": (high - low) / 2 / value,
                    "error": best / value - 1,
                }
            )
        print(
            number,
            *(int(row["covered"]) for row in rows[-len(free) :]),
            f"{seconds:.1f}",
            flush=True,
        )
    fits = pd.DataFrame(rows)
    sets = fits.groupby("set")[["seconds", "noise", "remarks"]].first()
    with_remarks = (sets.remarks > 0).sum()
    print(
        f"{len(sets)} data sets of {options.column}; one fit takes "
        f"{sets.seconds.median():.1f} s (median), {sets.seconds.max():.1f} s (most); "
        f"noise {sets.noise.median():.3f}; {with_remarks} with a remark\n"
    )
    print(
        "| parameter | truth within 95 % interval | half width (median) | mean error |"
    )
    print("|---|---|---|---|")
    for parameter, fits_of_one in fits.groupby("parameter", sort=False):
        errors = fits_of_one.error
        doubt = errors.std() / math.sqrt(len(errors))
        print(
            f"| `{parameter}` | {100 * fits_of_one.covered.mean():.1f} % "
            f"| {100 * fits_of_one.width.median():.2g} % "
            f"| {100 * errors.mean():.2g} +- {100 * doubt:.1g} % |"
        )


if __name__ == "__main__":
    main()
