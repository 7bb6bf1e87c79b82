"""Which parameter matters: indices of Sobol' over the ranges that bodies are drawn from.

First-order indices are the share of a variance that goes with one parameter alone, total ones the
share that would be left if all others were known, by the estimators of Saltelli et al., Comput.
Phys. Commun. 181, 259, 2010. SciPy's function has the same, but of powers of two of groups alone.
"""

from itertools import product
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

QUANTITIES = {"t_r": "$t_r$", "log10 t_r": r"$\log\,t_r$"} | {f"P({n})": f"P({n})" for n in TYPES}
# Groups from which on there are indices, and the share of them that may lack a value: the others
# would be another population than the ranges.
FEWEST, MOST_MISSING = 64, 0.05
REPLICATES, SEED = 300, 20170427
DPI, MOST_CASES = 150, 6
_INDICES = {"first": ("first order", style.BLUE), "total": ("total", style.ORANGE)}


def sensitivity(directory: Path) -> dict[str, Any]:
    """Compute the indices of the runs that are on disk, from whole groups, as JSON can hold them.

    ``indices`` are rows by ``case``, ``of`` (one of `QUANTITIES`) and ``parameter`` with 95 %
    intervals (bootstrap); ``notes`` tell of which quantities there are none, and why.
    """
    stored = open_stored(directory)
    bodies = stored.config.bodies
    if not isinstance(bodies, SdSource) or bodies.draw != "saltelli":
        raise ConfigError(
            f"{directory}: indices need bodies that differ in one parameter; run the sweep with "
            "bodies.source: sd and bodies.draw: saltelli"
        )
    rows, notes = list[dict[str, Any]](), list[str]()
    frame = stored.read(["case", "sample", "t_r", "type", "status"]).to_pandas()
    frame["group"], frame["place"] = np.divmod(frame["sample"], bodies.group)
    frame["type"] = frame["type"].where(frame["status"] == "ok")
    frame["t_r"] = frame["t_r"].where(frame["type"] == "R")
    frame["log10 t_r"] = np.log10(frame["t_r"])
    for name in TYPES:
        frame[f"P({name})"] = (frame["type"] == name).astype(float).where(frame["type"].notna())
    for (case, runs), of in product(frame.groupby("case"), QUANTITIES):
        # A row a group, as far as its runs are there; whole if all of them have a value.
        size = runs.groupby("group")["group"].transform("size")
        groups = runs[size == bodies.group].pivot(index="group", columns="place", values=of)
        whole = groups.dropna()
        if len(whole) < max(FEWEST, (1 - MOST_MISSING) * len(groups)):
            notes.append(
                f"case {case}, {of}: no indices, as only {len(whole):,} of {len(groups):,} groups "
                "have it in all runs; they would tell of those bodies, not of the ranges"
            )
        elif np.ptp(whole[[0, 1]].to_numpy()) > 0:
            left_out = groups.size - whole.size
            head = {"case": case, "of": of, "used": whole.size, "left_out": left_out}
            for name, index in zip(bodies.drawn, indices(whole.to_numpy().T), strict=True):
                rows.append(head | {"parameter": name} | index)
    if not rows:
        why = [*notes, "nothing varies"][0]
        raise OutputError(f"{directory}: no quantity has indices; {why}; it takes more runs")
    return {"cases": [case.dump() for case in stored.cases], "indices": rows, "notes": notes}


def indices(f: Floats) -> list[dict[str, float]]:
    """Return indices and intervals of values at A, at B, and at A with a parameter of B each."""

    def estimate(f: Floats) -> Floats:
        a, b, mixed = f[0], f[1], f[2:]
        variance = f[:2].var() or np.nan  # some drawn again may not vary
        first = ((b - f[:2].mean()) * (mixed - a)).mean(axis=1)
        return np.array([first, 0.5 * ((a - mixed) ** 2).mean(axis=1)]) / variance

    random, n = np.random.default_rng(SEED), f.shape[1]
    again = [estimate(f[:, random.integers(0, n, n)]) for _ in range(REPLICATES)]
    low, high = np.nanquantile(again, (0.025, 0.975), axis=0)
    parts = {"": estimate(f), "_low": low, "_high": high}
    return [
        {f"{name}{end}": float(part[k, j]) for k, name in enumerate(_INDICES)
         for end, part in parts.items()}
        for j in range(len(f) - 2)
    ]  # fmt: skip


def as_text(found: dict[str, Any], most_cases: int) -> str:
    """Return a table of indices with their intervals, of many cases the first."""
    cases, more = found["cases"], len(found["cases"]) - most_cases
    rows = [cases[row["case"]] | row for row in found["indices"] if row["case"] < most_cases]
    lines = [style.text_table(rows, ".3g"), *found["notes"][:most_cases]]
    return "\n".join(lines + [f"{more} more cases are in --json"] * (more > 0))


def save(found: dict[str, Any], path: Path) -> None:
    """Draw a panel of bars for each case and quantity, and write the figure."""
    frame = pd.DataFrame(found["indices"])
    names = [of for of in QUANTITIES if of in set(frame["of"])]
    cases = frame["case"].unique()[:MOST_CASES]
    with style.styled():
        figure = style.new_figure(max(4.0, 1.2 + 2.0 * len(names)), 1.2 + 1.9 * len(cases))
        panels: Any = figure.subplots(len(cases), len(names), squeeze=False, sharey=True)
        for (i, case), (j, of) in product(enumerate(cases), enumerate(names)):
            axes, own = panels[i, j], frame[(frame["case"] == case) & (frame["of"] == of)]
            for k, (index, (_, colour)) in enumerate(_INDICES.items()):
                value, low, high = (own[index + end].to_numpy() for end in ("", "_low", "_high"))
                at, ends = np.arange(len(own)) + 0.38 * k - 0.19, [value - low, high - value]
                axes.bar(at, value, 0.36, color=colour, yerr=np.maximum(ends, 0))
            axes.set_xticks(range(len(own)), [*map(style.symbol, own["parameter"])])
            axes.set_title(QUANTITIES[of], fontsize="medium")
            axes.set_ylabel(f"case {case}" if j == 0 else "")
            style.light_grid(axes)
        low, high = panels[0, 0].get_ylim()
        panels[0, 0].set_ylim(max(low, -0.2), min(high, 1.4))
        style.add_legend(figure, [Patch(color=c, label=words) for words, c in _INDICES.values()])
        style.add_caption(figure, "Sobol' indices with 95 % intervals; none where too few groups "
                          "of runs have a value.")  # fmt: skip
        style.save(figure, [path], DPI)
