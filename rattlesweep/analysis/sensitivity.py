"""Sobol' indices: which parameters of the bodies the results depend on.

A first-order index is the fraction of the variance that one parameter explains alone; a
total index is the fraction that would remain if all other parameters were known. The
estimators are those of Saltelli et al., Comput. Phys. Commun. 181, 259, 2010. SciPy has
the same ones, but accepts only powers of two of groups.
"""

from itertools import product
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from rattlesweep.analysis import room, style
from rattlesweep.arrays import Floats
from rattlesweep.config.body_sources import SdSource
from rattlesweep.rows.types import TYPES
from rattlesweep.statistics.tails import LEAST_INDEX, tail_index
from rattlesweep.store.rows import open_stored
from rattlesweep.words.errors import ConfigError, OutputError

_QUANTITIES = {"t_r": "$t_r$", "log10 t_r": r"$\log\,t_r$"} | {
    f"P({n})": f"P({n})" for n in TYPES
}
_FEWEST = 64  # groups that indices need
MOST_MISSING = 0.05  # of the groups; with more, the rest no longer represent the ranges
# Of the bootstrap.
REPLICATES = 300
_SEED = 20170427
NO_INDEX = "none"  # in a panel without bars
_MOST_CASES = 6  # in a figure
_INDICES = {"first": ("first order", style.BLUE), "total": ("total", style.ORANGE)}


class Indices(TypedDict):
    """The result of :func:`sensitivity`."""

    cases: list[dict[str, int | float | str]]
    indices: list[dict[str, int | float | str]]
    notes: list[str]


def sensitivity(directory: Path) -> Indices:
    """Compute the indices of the complete groups of runs on disk.

    ``indices`` has a row for each ``case``, ``of`` (one of `_QUANTITIES`) and
    ``parameter``, with 95 % intervals by bootstrap; ``notes`` says which quantities
    have no indices, and why.  The result can be written as JSON.
    """
    stored = open_stored(directory)
    bodies = stored.config.bodies
    if not isinstance(bodies, SdSource) or bodies.draw != "saltelli":
        raise ConfigError(
            f"{directory}: indices need bodies that differ in one parameter; run the "
            "sweep with bodies.source: sd and bodies.draw: saltelli"
        )
    frame = stored.read(["case", "sample", "t_r", "type", "status"]).to_pandas()
    frame["group"], frame["place"] = np.divmod(frame["sample"], bodies.group)
    _add_quantities(frame)
    rows: list[dict[str, int | float | str]] = []
    notes: list[str] = []
    for (case, runs), quantity in product(frame.groupby("case"), _QUANTITIES):
        # One row for each group whose runs are all stored.
        size = runs.groupby("group")["group"].transform("size")
        groups = runs[size == bodies.group].pivot(
            index="group", columns="place", values=quantity
        )
        # A group is usable if all of its runs have a value.
        usable = groups.dropna()
        if len(usable) < max(_FEWEST, (1 - MOST_MISSING) * len(groups)):
            notes.append(
                f"case {case}, {quantity}: no indices, as only {len(usable):,} of "
                f"{len(groups):,} groups have a value in all runs, and these do not "
                "represent the ranges"
            )
        elif quantity == "t_r" and tail_index(usable[0].to_numpy()) < LEAST_INDEX:
            notes.append(
                f"case {case}, t_r: no indices, as its variance depends on the few "
                "longest runs and may not exist; log10 t_r has indices"
            )
        elif np.ptp(usable[[0, 1]].to_numpy()) > 0:
            estimates = indices(usable.to_numpy().T)
            for name, estimate in zip(bodies.drawn, estimates, strict=True):
                row = {
                    "case": case,
                    "of": quantity,
                    "used": usable.size,
                    "left_out": groups.size - usable.size,
                    "parameter": name,
                }
                rows.append(row | estimate)
    if not rows:
        reason = notes[0] if notes else "nothing varies"
        raise OutputError(
            f"{directory}: no quantity has indices; {reason}; more runs are needed"
        )
    return {
        "cases": [case.dump() for case in stored.cases],
        "indices": rows,
        "notes": notes,
    }


def _add_quantities(frame: pd.DataFrame) -> None:
    """Add a column for each of `_QUANTITIES`, NaN where a run has no value."""
    frame["type"] = frame["type"].where(frame["status"] == "ok")
    frame["t_r"] = frame["t_r"].where(frame["type"] == "R")
    frame["log10 t_r"] = np.log10(frame["t_r"])
    for name in TYPES:
        is_type = (frame["type"] == name).astype(float)
        frame[f"P({name})"] = is_type.where(frame["type"].notna())


def indices(f: Floats) -> list[dict[str, float]]:
    """Return the indices of each parameter, with intervals.

    The rows of `f` are the values at A, at B, and at A with one parameter of B each.
    """

    def estimate(f: Floats) -> Floats:
        a = f[0]
        b = f[1]
        mixed = f[2:]
        variance = f[:2].var() or np.nan  # a resample may not vary
        first = ((b - f[:2].mean()) * (mixed - a)).mean(axis=1)
        total = 0.5 * ((a - mixed) ** 2).mean(axis=1)
        return np.array([first, total]) / variance

    random = np.random.default_rng(_SEED)
    n = f.shape[1]
    resampled = [estimate(f[:, random.integers(0, n, n)]) for _ in range(REPLICATES)]
    low, high = np.nanquantile(resampled, (0.025, 0.975), axis=0)
    numbers = {"": estimate(f), "_low": low, "_high": high}
    rows = []
    for parameter in range(len(f) - 2):
        row = {}
        for k, name in enumerate(_INDICES):
            for end, values in numbers.items():
                row[f"{name}{end}"] = float(values[k, parameter])
        rows.append(row)
    return rows


def sensitivity_text(result: Indices, most_cases: int) -> str:
    """Return a table of the indices with their intervals, for at most so many cases."""
    cases = result["cases"]
    rows = []
    for row in result["indices"]:
        case = int(row["case"])
        if case < most_cases:
            rows.append(cases[case] | row)
    lines = [style.text_table(rows, ".3g"), *result["notes"][:most_cases]]
    if len(cases) > most_cases:
        lines.append(f"{len(cases) - most_cases} more cases are in --json")
    return "\n".join(lines)


def save_sensitivity(result: Indices, path: Path) -> None:
    """Write a figure with a panel of bars for each case and quantity."""
    frame = pd.DataFrame(result["indices"])
    names = [name for name in _QUANTITIES if name in set(frame["of"])]
    cases = frame["case"].unique()[:_MOST_CASES]
    width = max(4.0, 1.2 + 2.0 * len(names))
    height = 1.2 + 1.9 * len(cases)
    with style.styled():
        figure = room.usual_figure(width, height)
        panels: Any = figure.subplots(
            len(cases), len(names), squeeze=False, sharex=True, sharey=True
        )
        for (i, case), (j, name) in product(enumerate(cases), enumerate(names)):
            axes = panels[i, j]
            of_panel = frame[(frame["case"] == case) & (frame["of"] == name)]
            _draw_bars(axes, of_panel)
            if i == 0:
                axes.set_title(_QUANTITIES[name], fontsize="medium")
            if j == 0:
                varied = {k: v for k, v in result["cases"][case].items() if k != "case"}
                lines = [style.value_text(k, v) for k, v in varied.items()]
                axes.set_ylabel("\n".join(lines))
            style.light_grid(axes)
            if of_panel[list(_INDICES)].isna().all(axis=None):
                axes.grid(visible=False)
                axes.text(
                    0.5,
                    0.5,
                    NO_INDEX,
                    color=style.GREY,
                    ha="center",
                    transform=axes.transAxes,
                )
        # The axes are shared; intervals of few groups may be very long.
        low, high = panels[0, 0].get_ylim()
        panels[0, 0].set_ylim(max(low, -0.2), min(high, 1.4))
        handles = [
            Patch(color=colour, label=name) for name, colour in _INDICES.values()
        ]
        style.add_legend(figure, handles)
        style.add_caption(
            figure,
            [
                "Sobol' indices with 95 % intervals. None: the value does not vary, or "
                "too few groups of runs have one."
            ],
        )
        room.fit_to_size(figure)
        style.save_figure(figure, [path])


def _draw_bars(axes: Axes, rows: pd.DataFrame) -> None:
    """Draw the first-order and the total index of each parameter side by side."""
    for k, (index, (_, colour)) in enumerate(_INDICES.items()):
        value = rows[index].to_numpy()
        below = value - rows[f"{index}_low"].to_numpy()
        above = rows[f"{index}_high"].to_numpy() - value
        place = np.arange(len(rows)) + 0.38 * k - 0.19
        errors = np.maximum([below, above], 0)
        axes.bar(place, value, 0.36, color=colour, yerr=errors)
    symbols = [style.symbol(name) for name in rows["parameter"]]
    axes.set_xticks(range(len(rows)), symbols)
