"""Time of a thousand runs: in one call of `simulate`, in a thousand calls, and as a
sweep.

    python benchmarks/simulate.py [--runs 1000] [--rounds 5]

The runs are those of a small sweep in both directions; their rows are compared bit for
bit.  All three are timed in turn, round by round, so that other work on the machine
affects them equally. Medians and ratios are printed.  The sweep writes a directory and
has the same config each time.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import rattlesweep as rs
from rattlesweep.physics.body import PARAMETERS

# Long enough for most runs in the unsteady direction to reverse.
HORIZON = 1000.0


def main() -> None:
    """Time and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--runs", type=int, default=1000, help="rounded up to an even number"
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=None)
    given = parser.parse_args()
    samples = -(-given.runs // 2)
    config: dict[str, Any] = {
        "bodies": {"source": "sd", "samples": samples},
        "spin": {"n_i": [-0.3, 0.3], "omega_xy0": 0.01},
        "horizon": {"t": HORIZON},
    }
    with tempfile.TemporaryDirectory() as folder:
        begun = rs.sweep(config, output=Path(folder) / "first", threads=given.threads)
        table = begun.runs
        bodies = [rs.Rattleback(*row) for row in table[list(PARAMETERS)].to_numpy()]
        spins = table.n_i.to_numpy()
        rest: dict[str, Any] = {"t_end": HORIZON, "threads": given.threads}
        results: dict[str, Any] = {}
        count = iter(range(10**9))

        def sweep() -> np.ndarray:
            output = Path(folder) / str(next(count))
            return rs.sweep(
                config, output=output, threads=given.threads
            ).runs.n_end.to_numpy()

        def vectorised() -> np.ndarray:
            runs: Any = rs.simulate(bodies, n_i=spins, omega_xy0=0.01, **rest)
            return runs.n_end.to_numpy()

        def one_by_one() -> np.ndarray:
            calls = zip(bodies, spins, strict=True)
            return np.array(
                [rs.simulate(b, n_i=n, omega_xy0=0.01, **rest).n_end for b, n in calls]
            )

        ways: dict[str, Callable[[], np.ndarray]] = {
            "one call of simulate": vectorised,
            "a sweep": sweep,
            "a call of simulate a run": one_by_one,
        }
        seconds: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(given.rounds):
            for name, way in ways.items():
                start = time.perf_counter()
                results[name] = way()
                seconds[name].append(time.perf_counter() - start)
    for name, values in results.items():
        assert np.array_equal(values, table.n_end), f"{name}: other bits"
    unit = float(np.median(seconds["one call of simulate"]))
    print(f"{len(table)} runs, {given.rounds} rounds, the same bits in all")
    print(f"{'':26} {'ms a run':>9} {'ratio':>7}   spread")
    for name, times in seconds.items():
        mean, low, high = (1e3 * f(times) / len(table) for f in (np.median, min, max))
        print(
            f"{name:26} {mean:9.4f} {mean * len(table) / 1e3 / unit:7.2f}   {low:.4f} to {high:.4f}"
        )


if __name__ == "__main__":
    main()
