"""Errors of shares and means against the number of samples, for random and Sobol'
draws.

Compares sweeps of the closed form (`model: gh`) with many seeds to one with a million
samples.

    python benchmarks/draws.py --figure docs/draws.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from rattlesweep.analysis import style
from rattlesweep.sweeps.block import columns_of, prepare_runs
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.plan import make_plan

CONFIG = {
    "spin": {"n_i": -0.3, "omega_xy0": 0.01},
    "model": "gh",
    "horizon": {"t": 2000},
}
MEASURES = ("share of type R", "share past Bondi's threshold", r"mean $t_r$ of type R")
SIZES = [2**k for k in range(5, 15)]
BITS = 20


def measure(draw: str, samples: int, seed: int) -> np.ndarray:
    """Cumulative measures at the sizes up to `samples`, shape (sizes, measures)."""
    bodies = {"source": "sd", "samples": samples, "draw": draw}
    plan = make_plan(parse_config(CONFIG | {"bodies": bodies, "seed": seed}))
    sample = np.arange(samples)
    launches, _ = prepare_runs(plan, np.zeros(samples, dtype=np.int64), sample)
    columns = columns_of(plan.config, launches, None, None)
    t_r = columns["t_r"]
    rows = np.stack(
        [np.isfinite(t_r), np.abs(columns["n_c1"]) < 0.3, np.nan_to_num(t_r)]
    )
    sums = np.cumsum(rows, axis=1)[
        :, [n - 1 for n in SIZES if n < samples] + [samples - 1]
    ]
    counts = np.array([n for n in SIZES if n < samples] + [samples])
    return np.stack([sums[0] / counts, sums[1] / counts, sums[2] / sums[0]], axis=1)


def main() -> None:
    """Print a table of root mean square errors, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    exact = np.mean(
        [measure("sobol", 2**BITS, 10**6 + k)[-1] for k in range(4)], axis=0
    )
    print("measures of four sequences of 2^20 samples:", exact)
    errors = {}
    for draw in ("random", "sobol"):
        found = np.array(
            [measure(draw, SIZES[-1], seed) for seed in range(options.seeds)]
        )
        errors[draw] = np.sqrt(np.mean((found / exact - 1) ** 2, axis=0))
    print(f"root mean square of relative errors, {options.seeds} seeds")
    print("samples", *(f"{d:>10} " for _ in MEASURES for d in errors))
    for k, size in enumerate(SIZES):
        cells = (
            f"{errors[d][k, m]:11.2e}" for m in range(len(MEASURES)) for d in errors
        )
        print(f"{size:7d}", *cells)
    for m, words in enumerate(MEASURES):
        slopes = {
            d: np.polyfit(np.log(SIZES), np.log(errors[d][:, m]), 1)[0] for d in errors
        }
        gain = (errors["random"][-1, m] / errors["sobol"][-1, m]) ** 2
        falls = ", ".join(f"{d} as N^{s:.2f}" for d, s in slopes.items())
        print(
            f"{words}: {falls}; at {SIZES[-1]} samples as good as {gain:.0f} times as many"
        )
    if options.figure is not None:
        with style.styled():
            style.save(draw_figure(errors), [options.figure], 150)


def draw_figure(errors: dict[str, np.ndarray]) -> object:
    """One panel a measure."""
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
