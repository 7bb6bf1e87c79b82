"""How often a forecast's interval of 95 % holds the time that the sweep then takes.

Small sweeps of several kinds, each with a seed of its own: forecast, run, compare. A share of 90 %
or more of 40 trials is wanted. Whatever else the machine does meanwhile widens the times; the load
is printed beside.

    python benchmarks/forecast_coverage.py --trials 40
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import Any

from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.config.load import parse_config
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.forecast.forecast import forecast

SPIN = {"n_i": [-0.1, -0.3], "omega_xy0": [0.01, 0.1]}
KINDS: list[dict[str, Any]] = [
    {"bodies": {"source": "sd", "samples": 500}, "spin": SPIN, "horizon": {"t": 10000}},
    {"bodies": {"source": "sd", "samples": 2000}, "spin": SPIN, "horizon": {"t": 2000}},
    {
        "bodies": {"source": "sd", "samples": 100, "target": {"K_r": [0.03, 0.1]}},
        "spin": {"n_i": [-0.1, -0.2, 0.2], "omega_xy0": [0.01, 0.1]},
    },
    {
        "bodies": {
            "source": "grid",
            "base": {"preset": "GH"},
            "axes": {"theta": {"linspace": [0.6, 0.9, 40]}, "phi": {"linspace": [0.02, 0.036, 20]}},
        },
        "spin": {"n_i": [-0.1, 0.1], "omega_xy0": 0.02},
        "horizon": {"t": 3000},
    },
]


def main() -> None:
    """Print a line a trial, and the share at the end."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--budget", type=float, default=1.0, help="seconds of a pilot")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        # What a process pays once.
        run_sweep(make_plan(parse_config({**KINDS[0], "bodies": {"source": "sd", "samples": 1}})),
                  Path(place) / "first", threads=options.threads)  # fmt: skip
        held = 0
        for trial in range(options.trials):
            plan = make_plan(parse_config({**KINDS[trial % len(KINDS)], "seed": trial}))
            f = forecast(plan, options.threads, budget=options.budget)
            begin = time.perf_counter()
            run_sweep(plan, Path(place) / str(trial), threads=options.threads)
            took = time.perf_counter() - begin
            holds = f.low <= took <= f.high
            held += holds
            print(
                f"{trial:3d}  {took:6.2f} s, forecast {f.seconds:6.2f} ({f.low:.2f} to "
                f"{f.high:.2f}) {'holds' if holds else 'MISSES'}  {f.pilot_runs} runs, load "
                f"{os.getloadavg()[0]:.1f}",
                flush=True,
            )
    print(f"{held} of {options.trials} intervals hold")


if __name__ == "__main__":
    main()
