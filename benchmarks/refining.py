"""What a refined map saves, misses and gets wrong, from the runs of a full grid.

rattlesweep run configs/map_theta_spin.yaml
python benchmarks/refining.py out/map-theta-spin --figure docs/map_refined.png
python benchmarks/refining.py out/maps --means
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib.colors import ListedColormap
from scipy.ndimage import label as islands

from rattlesweep.analysis import style
from rattlesweep.analysis.layout import fill
from rattlesweep.arrays import Flags
from rattlesweep.config.read import parse_config, resolved
from rattlesweep.store.decide import wanted_runs
from rattlesweep.store.rows import FOLDER, Stored, nothing_found, open_stored
from rattlesweep.store.summary import summarise

# The types, and cells without a run, with their colours.
COLOURS = {name: look.colour for name, look in style.TYPE_STYLE.items()}
COLOURS |= {"failed": style.FAILED_COLOUR, "missing": style.MISSING_COLOUR}
CODES = {name: code for code, name in enumerate(COLOURS)}
LEVELS = (2, 3, 4, 5)
REFINEMENTS: list[dict[str, Any]] = [
    *({"levels": levels} for levels in LEVELS),
    {"levels": 4, "by": "t_r"},
]


def refined(rows: pa.Table, stored: Stored, refine: dict[str, Any]) -> Flags:
    """Return which runs a refined sweep would do, in the order of their keys."""
    data = resolved(stored.config)
    config = parse_config(data | {"bodies": data["bodies"] | {"refine": refine}}, [])
    design = replace(stored, config=config)
    known = nothing_found(design)
    todo = wanted_runs(design, known)
    while todo.any():
        known.add(rows.take(np.flatnonzero(todo)))
        todo = wanted_runs(design, known) & ~known.done
    return known.done


def summary_of(rows: pa.Table, stored: Stored, refine: dict[str, Any]) -> pd.DataFrame:
    """Return the summary of a refined sweep, from the rows of the full grid."""
    done = refined(rows, stored, refine)
    data = resolved(stored.config)
    config = parse_config(data | {"bodies": data["bodies"] | {"refine": refine}}, [])
    with tempfile.TemporaryDirectory() as folder:
        sweep = replace(stored, config=config, directory=Path(folder))
        (sweep.directory / FOLDER).mkdir()
        sweep.append(rows.take(np.flatnonzero(done)), "{}")
        return summarise(sweep).to_pandas()


def print_means(stored: Stored) -> None:
    """Print how far the summaries of refined sweeps are off those of the full grid."""
    rows = stored.read()
    full = summarise(stored).to_pandas()
    print("refine                   runs  column       mean error   worst")
    for refine in REFINEMENTS:
        refined_summary = summary_of(rows, stored, refine)
        share = refined_summary.runs.sum() / full.runs.sum()
        for name in ("fraction_R", "t_r_mean", "t_r_std"):
            error = refined_summary[name] - full[name]
            if name != "fraction_R":
                error /= full[name]
            print(
                f"{in_words(refine):20} {share:8.3f}  {name:12} "
                f"{error.mean():10.4f} {error.abs().max():7.4f}"
            )


def in_words(refine: dict[str, Any]) -> str:
    """Return a refinement as it stands in a config."""
    return ", ".join(f"{key}: {value}" for key, value in refine.items())


def main() -> None:
    """Print a table of runs and missed cells; draw those of one refinement."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("full", type=Path)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--means", action="store_true", help="compare the summaries")
    options = parser.parse_args()
    stored = open_stored(options.full)
    if options.means:
        print_means(stored)
        return
    names = ["case", "sample", "type", "status", "t_r", "t_rgh"]
    rows = stored.read(names)
    spin = stored.config.spin
    shape = (len(spin.n_i), len(spin.omega_xy0), stored.samples)
    types = rows.column("type").to_pylist()
    code = np.array([CODES[name] for name in types]).reshape(shape)
    ratio = rows.column("t_r").to_numpy() / rows.column("t_rgh").to_numpy()
    ratio = ratio.reshape(shape)
    print(
        "refine                   runs  fewer  missed     islands  largest  "
        "t_r off by 5 %"
    )
    for refine in REFINEMENTS:
        done = refined(rows, stored, refine).reshape(shape)
        missed = np.zeros(shape, bool)
        times_off = 0
        largest = 0
        count = 0
        for k in range(shape[1]):
            known = done[:, k].T
            types_done = np.where(known, code[:, k].T, CODES["missing"])
            missed[:, k] = (fill(types_done, known) != code[:, k].T).T
            number, islands_of_map = islands(missed[:, k], np.ones((3, 3)))
            count += islands_of_map
            largest = max(largest, *np.bincount(number[number > 0], minlength=2))
            times = fill(np.where(known, ratio[:, k].T, np.nan), known)
            both_reverse = ~missed[:, k] & (code[:, k] == CODES["R"])
            is_off = np.abs(times.T / ratio[:, k] - 1) > 0.05
            times_off += int((is_off & both_reverse).sum())
        print(
            f"{in_words(refine):20} {done.sum():8d} {done.size / done.sum():6.1f} "
            f"{missed.sum():7d} {count:11d} {largest:8d} "
            f"{times_off / (code == CODES['R']).sum():15.4f}"
        )
        if refine == {"levels": 4} and options.figure is not None:
            with style.styled():
                figure = draw(stored, code, done, missed)
                style.save_figure(figure, [options.figure], 150)


def draw(stored, code: np.ndarray, done: np.ndarray, missed: np.ndarray) -> object:
    """Draw the runs that are done on the left and the missed cells on the right."""
    spin = stored.config.spin
    theta = np.array(stored.config.bodies.axes.theta)
    n_i = np.array(spin.n_i)
    figure = style.new_figure(9.0, 7.4)
    panels = figure.subplots(
        len(spin.omega_xy0), 2, sharex=True, sharey=True, squeeze=False
    )
    colours = list(COLOURS.values())
    for k, (left, right) in enumerate(panels):
        y, x = np.nonzero(done[:, k])
        left.scatter(
            theta[x],
            n_i[y],
            s=0.6,
            linewidths=0,
            c=[colours[c] for c in code[y, k, x]],
        )
        right.pcolormesh(
            theta,
            n_i,
            code[:, k],
            cmap=ListedColormap(colours),
            vmin=-0.5,
            vmax=len(colours) - 0.5,
            alpha=0.35,
            rasterized=True,
        )
        y, x = np.nonzero(missed[:, k])
        right.scatter(
            theta[x],
            n_i[y],
            s=5,
            color="#C00000",
            linewidths=0,
        )
        left.set_title(
            f"{done[:, k].sum():,} of {done[:, k].size:,} runs", fontsize="medium"
        )
        right.set_title(f"{missed[:, k].sum():,} cells missed", fontsize="medium")
        left.set_ylabel(style.label("n_i"))
        right.text(
            1.02,
            0.5,
            style.value_text("omega_xy0", spin.omega_xy0[k]),
            rotation=270,
            transform=right.transAxes,
            va="center",
        )
    for axes in panels[-1]:
        axes.set_xlabel(style.label("theta"))
    return figure


if __name__ == "__main__":
    main()
