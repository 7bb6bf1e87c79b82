"""How often the range of a forecast contains the time that the sweep then takes.

Each trial forecasts and runs a shipped config, made small, with a seed of its own. The
range should contain the time in at least 90 % of 40 trials. Other work on the machine
makes the times vary, so the load is printed as well.

    python benchmarks/forecast_coverage.py --trials 40
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

from machine import heading, plan_of

from rattlesweep.work.forecast import forecast
from rattlesweep.work.run import run_sweep

# Each takes at least a second of integration on two threads.
SMALL = [
    ("quickstart.yaml", "bodies.samples=250"),
    ("steady.yaml", "bodies.samples=16"),
    ("unsteady.yaml", "bodies.samples=100"),
    ("tradeoff.yaml", "bodies.samples=60"),
    (
        "map_theta_spin.yaml",
        "bodies.axes.theta.linspace=[0.6, 0.99, 50]",
        "spin.n_i={linspace: [-0.6, 0.6, 50]}",
    ),
]


def main() -> None:
    """Print a line for each trial, and the share at the end."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--budget", type=float, default=2.0, help="seconds of a pilot")
    options = parser.parse_args()
    print(heading())
    held = 0
    with tempfile.TemporaryDirectory() as place:
        # Trial -1 is not counted, because it includes costs that a process has only
        # once.
        for trial in range(-1, options.trials):
            name, *small = SMALL[trial % len(SMALL)]
            plan = plan_of(name, *small, f"seed={abs(trial)}")
            f = forecast(plan, options.threads, seconds=options.budget)
            begin = time.perf_counter()
            run_sweep(plan, Path(place) / str(trial), threads=options.threads)
            took = time.perf_counter() - begin
            holds = f.low <= took <= f.high
            held += holds and trial >= 0
            print(
                f"{trial:3d}  {took:6.2f} s, forecast {f.seconds:6.2f} ({f.low:.2f} to "
                f"{f.high:.2f}) holds: {holds}  {f.runs} runs, "
                f"load {os.getloadavg()[0]:.1f}  {name}",
                flush=True,
            )
    print(f"{held} of {options.trials} ranges hold")


if __name__ == "__main__":
    main()
