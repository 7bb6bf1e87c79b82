"""Which parameter matters: indices of Sobol' over the ranges that bodies are drawn from.

First-order indices are the share of a variance that goes with one parameter alone, total ones the
share that would be left if all others were known, by the estimators of Saltelli et al., Comput.
Phys. Commun. 181, 259, 2010. They are SciPy's, whose function takes powers of two of groups alone:
one run that does not reverse would cost half of the others.
"""

from __future__ import annotations

from dataclasses import dataclass
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
_SPIN = ("n_i", "omega_xy0")
_INDICES = {"first": ("first order", style.BLUE), "total": ("total", style.ORANGE)}


@dataclass
class Sensitivity:
    """Indices of a sweep.

    `rows` are by ``case``, ``of`` (one of `QUANTITIES`) and ``parameter``: ``used`` and
    ``left_out`` runs, ``first`` and ``total`` with the ends ``_low`` and ``_high`` of their 95 %
    intervals (bootstrap). `notes` say of which quantities there are none, and why.
    """

    directory: Path
    cases: list[dict[str, Any]]
    rows: list[dict[str, Any]]
    notes: list[str]

    def data(self) -> dict[str, Any]:
        """Return all of it as JSON can hold it."""
        return {"directory": str(self.directory), "cases": self.cases, "indices": self.rows,
                "notes": self.notes}  # fmt: skip


def sensitivity(directory: Path) -> Sensitivity:
    """Compute the indices of the runs that are on disk, from whole groups of runs.

    Raises a ConfigError if bodies are not drawn from ranges by ``draw: saltelli``, an OutputError
    if no quantity is there in nearly all groups.
    """
    stored = open_stored(directory)
    bodies = stored.config.bodies
    if not isinstance(bodies, SdSource) or bodies.draw != "saltelli":
        raise ConfigError(
            f"{directory}: indices need bodies that differ in one parameter; run the sweep with "
            "bodies.source: sd and bodies.draw: saltelli"
        )
    found = Sensitivity(directory, [case.dump() for case in stored.cases], [], [])
    frame = stored.read(["case", "sample", "t_r", "type", "status"]).to_pandas()
    for case, runs in frame.groupby("case"):
        kind = runs.type.where(runs.status == "ok")
        t_r = runs.t_r.where(kind == "R").to_numpy()
        values = [t_r, np.log10(t_r)]
        values += [(kind == name).where(kind.notna(), np.nan).to_numpy(float) for name in TYPES]
        group, place = np.divmod(runs["sample"].to_numpy(), bodies.group)
        f = np.full((len(values), bodies.group, group.max() + 1), np.nan)
        f[:, place, group] = values
        f = f[:, :, np.bincount(group) == bodies.group]
        for of, y in zip(QUANTITIES, f, strict=True):
            whole = np.isfinite(y).all(axis=0)
            if whole.sum() < FEWEST or whole.mean() < 1 - MOST_MISSING:
                found.notes.append(
                    f"case {case}, {of}: no indices, as only {whole.sum():,} of {whole.size:,} "
                    "groups have it in all runs; they would tell of those bodies, not of the ranges"
                )
            elif np.ptp(y[:2, whole]) > 0:
                head = {"case": int(case), "of": of, "used": int(whole.sum()) * bodies.group,
                        "left_out": int((~whole).sum()) * bodies.group}  # fmt: skip
                for name, index in zip(bodies.drawn, indices(y[:, whole]), strict=True):
                    found.rows.append(head | {"parameter": name} | index)
    if not found.rows:
        why = [*found.notes, "nothing varies"][0]
        raise OutputError(f"{directory}: no quantity has indices; {why}; it takes more runs")
    return found


def indices(f: Floats) -> list[dict[str, float]]:
    """Return the indices of each parameter with their intervals, from drawing groups again.

    `f` are values at points A, at points B, and at those of A with one parameter of B each.
    """

    def estimate(f: Floats) -> Floats:
        a, b, mixed = f[0], f[1], f[2:]
        variance = f[:2].var() or np.nan  # some drawn again may not vary
        first = ((b - f[:2].mean()) * (mixed - a)).mean(axis=1)
        return np.array([first, 0.5 * ((a - mixed) ** 2).mean(axis=1)]) / variance

    random, n = np.random.default_rng(SEED), f.shape[1]
    again = [estimate(f[:, random.integers(0, n, n)]) for _ in range(REPLICATES)]
    parts = {"": estimate(f), "_low": np.nanquantile(again, 0.025, axis=0),
             "_high": np.nanquantile(again, 0.975, axis=0)}  # fmt: skip
    return [
        {f"{name}{end}": float(part[k, j]) for k, name in enumerate(_INDICES)
         for end, part in parts.items()}
        for j in range(len(f) - 2)
    ]  # fmt: skip


def as_text(found: Sensitivity, most_cases: int) -> str:
    """Return a table of indices with their intervals, of many cases the first."""
    rows = [{"case": row["case"]} | {n: found.cases[row["case"]].get(n) for n in _SPIN} | row
            for row in found.rows if row["case"] < most_cases]  # fmt: skip
    lines = [style.text_table(rows, ".3g"), *found.notes[:most_cases]]
    more = len(found.cases) - most_cases
    return "\n".join(lines + ([f"{more} more cases are in --json"] if more > 0 else []))


def save(found: Sensitivity, path: Path) -> None:
    """Draw a panel of bars for each case and quantity, and write the figure."""
    frame = pd.DataFrame(found.rows)
    names = [of for of in QUANTITIES if of in set(frame["of"])]
    cases = [int(case) for case in frame["case"].unique()[:MOST_CASES]]
    with style.styled():
        figure = style.new_figure(max(4.0, 1.2 + 2.0 * len(names)), 1.2 + 1.9 * len(cases))
        panels: Any = figure.subplots(len(cases), len(names), squeeze=False, sharey=True)
        for (i, case), (j, of) in product(enumerate(cases), enumerate(names)):
            axes = panels[i, j]
            own = frame[(frame["case"] == case) & (frame["of"] == of)]
            for k, (index, (_, colour)) in enumerate(_INDICES.items()):
                value, low, high = (own[index + end].to_numpy() for end in ("", "_low", "_high"))
                at, ends = np.arange(len(own)) + 0.38 * k - 0.19, [value - low, high - value]
                axes.bar(at, value, 0.36, color=colour, yerr=np.maximum(ends, 0))
            axes.set_xticks(range(len(own)), [*map(style.symbol, own["parameter"])])
            axes.set_title(QUANTITIES[of], fontsize="medium")
            style.light_grid(axes)
            axes.set_ylabel(f"case {case}" if j == 0 else "")
        low, high = panels[0, 0].get_ylim()
        panels[0, 0].set_ylim(max(low, -0.2), min(high, 1.4))
        style.add_legend(figure, [Patch(color=c, label=words) for words, c in _INDICES.values()])
        style.add_caption(figure, "Sobol' indices with 95 % intervals; none where too few groups "
                          "of runs have a value.")  # fmt: skip
        style.save(figure, [path], DPI)
