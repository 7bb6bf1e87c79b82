"""Sobol' indices: which parameters of the bodies the results depend on.

A first-order index is the fraction of the variance that one parameter explains alone; a
total index is the fraction that would remain if all other parameters were known. The
estimators are those of Saltelli et al., Comput. Phys. Commun. 181, 259, 2010. SciPy has
the same ones, but accepts only powers of two of groups.
"""

from itertools import product, starmap
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.patches import Patch

from rattlesweep.analysis import style
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.schema import SdSource
from rattlesweep.sweeps.stored import open_stored
from rattlesweep.sweeps.types import TYPES

QUANTITIES = {"t_r": "$t_r$", "log10 t_r": r"$\log\,t_r$"} | {
    f"P({n})": f"P({n})" for n in TYPES
}
FEWEST = 64  # groups that indices need
MOST_MISSING = 0.05  # of the groups; with more, the rest no longer represent the ranges
REPLICATES, SEED = 300, 20170427  # of the bootstrap
MOST_CASES = 6  # in a figure
_INDICES = {"first": ("first order", style.BLUE), "total": ("total", style.ORANGE)}


def sensitivity(directory: Path) -> dict[str, Any]:
    """Compute the indices from the complete groups of runs on disk, as JSON can hold
    them.

    ``indices`` has a row for each ``case``, ``of`` (one of `QUANTITIES`) and
    ``parameter``, with 95 % intervals by bootstrap; ``notes`` says which quantities
    have no indices, and why.
    """
    stored = open_stored(directory)
    bodies = stored.config.bodies
    if not isinstance(bodies, SdSource) or bodies.draw != "saltelli":
        raise ConfigError(
            f"{directory}: indices need bodies that differ in one parameter; run the "
            "sweep with bodies.source: sd and bodies.draw: saltelli"
        )
    rows, notes = list[dict[str, Any]](), list[str]()
    frame = stored.read(["case", "sample", "t_r", "type", "status"]).to_pandas()
    frame["group"], frame["place"] = np.divmod(frame["sample"], bodies.group)
    frame["type"] = frame["type"].where(frame["status"] == "ok")
    frame["t_r"] = frame["t_r"].where(frame["type"] == "R")
    frame["log10 t_r"] = np.log10(frame["t_r"])
    for name in TYPES:
        frame[f"P({name})"] = (
            (frame["type"] == name).astype(float).where(frame["type"].notna())
        )
    for (case, runs), of in product(frame.groupby("case"), QUANTITIES):
        # One row for each group whose runs are all stored; usable if all of them have a
        # value.
        size = runs.groupby("group")["group"].transform("size")
        groups = runs[size == bodies.group].pivot(
            index="group", columns="place", values=of
        )
        whole = groups.dropna()
        if len(whole) < max(FEWEST, (1 - MOST_MISSING) * len(groups)):
            few = f"only {len(whole):,} of {len(groups):,} groups have a value in all runs"
            notes.append(
                f"case {case}, {of}: no indices, as {few}, and these do not represent the "
                "ranges"
            )
        elif np.ptp(whole[[0, 1]].to_numpy()) > 0:
            head = {
                "case": case,
                "of": of,
                "used": whole.size,
                "left_out": groups.size - whole.size,
            }
            for name, index in zip(
                bodies.drawn, indices(whole.to_numpy().T), strict=True
            ):
                rows.append(head | {"parameter": name} | index)
    if not rows:
        why = [*notes, "nothing varies"][0]
        raise OutputError(
            f"{directory}: no quantity has indices; {why}; more runs are needed"
        )
    return {
        "cases": [case.dump() for case in stored.cases],
        "indices": rows,
        "notes": notes,
    }


def indices(f: Floats) -> list[dict[str, float]]:
    """Return indices with intervals; rows of `f`: at A, at B, at A with one parameter
    of B each.
    """

    def estimate(f: Floats) -> Floats:
        a, b, mixed = f[0], f[1], f[2:]
        variance = f[:2].var() or np.nan  # a resample may not vary
        first = ((b - f[:2].mean()) * (mixed - a)).mean(axis=1)
        return np.array([first, 0.5 * ((a - mixed) ** 2).mean(axis=1)]) / variance

    random, n = np.random.default_rng(SEED), f.shape[1]
    again = [estimate(f[:, random.integers(0, n, n)]) for _ in range(REPLICATES)]
    low, high = np.nanquantile(again, (0.025, 0.975), axis=0)
    parts = {"": estimate(f), "_low": low, "_high": high}
    return [
        {
            f"{name}{end}": float(part[k, j])
            for k, name in enumerate(_INDICES)
            for end, part in parts.items()
        }
        for j in range(len(f) - 2)
    ]


def as_text(found: dict[str, Any], most_cases: int) -> str:
    """Return a table of the indices with their intervals, for at most so many cases."""
    cases, more = found["cases"], len(found["cases"]) - most_cases
    rows = [
        cases[row["case"]] | row for row in found["indices"] if row["case"] < most_cases
    ]
    lines = [style.text_table(rows, ".3g"), *found["notes"][:most_cases]]
    return "\n".join(lines + [f"{more} more cases are in --json"] * (more > 0))


def save(found: dict[str, Any], path: Path) -> None:
    """Write a figure with a panel of bars for each case and quantity."""
    frame = pd.DataFrame(found["indices"])
    names = [of for of in QUANTITIES if of in set(frame["of"])]
    cases = frame["case"].unique()[:MOST_CASES]
    with style.styled():
        figure = style.new_figure(
            max(4.0, 1.2 + 2.0 * len(names)), 1.2 + 1.9 * len(cases)
        )
        panels: Any = figure.subplots(
            len(cases), len(names), squeeze=False, sharex=True, sharey=True
        )
        for (i, case), (j, of) in product(enumerate(cases), enumerate(names)):
            axes, own = (
                panels[i, j],
                frame[(frame["case"] == case) & (frame["of"] == of)],
            )
            for k, (index, (_, colour)) in enumerate(_INDICES.items()):
                value, low, high = (
                    own[index + end].to_numpy() for end in ("", "_low", "_high")
                )
                at, ends = (
                    np.arange(len(own)) + 0.38 * k - 0.19,
                    [value - low, high - value],
                )
                axes.bar(at, value, 0.36, color=colour, yerr=np.maximum(ends, 0))
            axes.set_xticks(range(len(own)), [*map(style.symbol, own["parameter"])])
            varied = {k: v for k, v in found["cases"][case].items() if k != "case"}
            axes.set_title(QUANTITIES[of] if i == 0 else "", fontsize="medium")
            axes.set_ylabel(
                "\n".join(starmap(style.value_text, varied.items())) if j == 0 else ""
            )
            style.light_grid(axes)
        low, high = panels[0, 0].get_ylim()
        panels[0, 0].set_ylim(max(low, -0.2), min(high, 1.4))
        style.add_legend(
            figure, [Patch(color=c, label=words) for words, c in _INDICES.values()]
        )
        style.add_caption(
            figure,
            "Sobol' indices with 95 % intervals; a panel is empty where the "
            "value does not vary or too few groups of runs have one.",
        )
        style.save(figure, [path])
