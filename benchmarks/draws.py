"""Errors of shares and means against the number of samples and the kind of draw.

Compares sweeps of the closed form (`model: gh`) with many seeds to one with a million
samples.

    python benchmarks/draws.py --figure docs/draws.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from rattlesweep.analysis import style
from rattlesweep.config.read import parse_config
from rattlesweep.design.plan import make_plan
from rattlesweep.work.block import columns_of, prepare_runs

CONFIG = {
    "spin": {"n_i": -0.3, "omega_xy0": 0.01},
    "model": "gh",
    "horizon": {"t": 2000},
}
MEASURES = ("share of type R", "share past Bondi's threshold", r"mean $t_r$ of type R")
SIZES = [2**k for k in range(5, 15)]
BITS = 20


def measure(draw: str, samples: int, seed: int) -> np.ndarray:
    """Return measures of the first samples, shape (sizes up to `samples`, measures)."""
    bodies = {"source": "sd", "samples": samples, "draw": draw}
    plan = make_plan(parse_config(CONFIG | {"bodies": bodies, "seed": seed}))
    sample = np.arange(samples)
    launches, _ = prepare_runs(plan, np.zeros(samples, dtype=np.int64), sample)
    columns = columns_of(plan.config, launches, None, None)
    t_r = columns["t_r"]
    sizes = np.array([n for n in SIZES if n < samples] + [samples])
    reversing = np.cumsum(np.isfinite(t_r))[sizes - 1]
    past_threshold = np.cumsum(np.abs(columns["n_c1"]) < 0.3)[sizes - 1]
    total_time = np.cumsum(np.nan_to_num(t_r))[sizes - 1]
    measures = reversing / sizes, past_threshold / sizes, total_time / reversing
    return np.stack(measures, axis=1)


def main() -> None:
    """Print a table of root mean square errors, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    longest = [measure("sobol", 2**BITS, 10**6 + k)[-1] for k in range(4)]
    exact = np.mean(longest, axis=0)
    print(f"measures of four sequences of 2^{BITS} samples: {exact}")
    errors = {}
    for draw in ("random", "sobol"):
        sweeps = [measure(draw, SIZES[-1], seed) for seed in range(options.seeds)]
        relative = np.array(sweeps) / exact - 1
        errors[draw] = np.sqrt(np.mean(relative**2, axis=0))
    print(f"root mean square of relative errors, {options.seeds} seeds")
    for draw, values in errors.items():
        print(f"{draw}\nsamples, {', '.join(MEASURES)}")
        for size, row in zip(SIZES, values, strict=True):
            print(f"{size:7d}", *(f"{value:11.2e}" for value in row))
    if options.figure is not None:
        with style.styled():
            style.save_figure(draw_figure(errors), [options.figure], 150)


def draw_figure(errors: dict[str, np.ndarray]) -> Figure:
    """Return a figure with one panel for each measure."""
    figure = style.new_figure(9.0, 3.1)
    panels = figure.subplots(1, 3, sharey=True)
    for m, (axes, words) in enumerate(zip(panels, MEASURES, strict=True)):
        for (draw, values), (colour, mark) in zip(
            errors.items(), style.SERIES, strict=False
        ):
            axes.loglog(
                SIZES, values[:, m], color=colour, marker=mark, label=f"draw: {draw}"
            )
        axes.loglog(
            SIZES,
            errors["random"][0, m] * (np.array(SIZES) / SIZES[0]) ** -0.5,
            label=r"$N^{-1/2}$",
            **style.THEORY,
        )
        axes.set_title(words, fontsize="medium")
        axes.set_xlabel("samples $N$")
        style.light_grid(axes)
    panels[0].set_ylabel("relative error (root mean square)")
    panels[0].legend(frameon=False)
    return figure


if __name__ == "__main__":
    main()
