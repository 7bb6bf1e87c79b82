"""Which parameter matters: indices of Sobol' over the ranges that bodies are drawn from.

First-order indices are the share of a variance that goes with one parameter alone, total ones the
share that would be left if all others were known. Both come from runs that differ in one parameter
(``draw: saltelli``), by the estimators of Saltelli et al., Comput. Phys. Commun. 181, 259, 2010.
These are SciPy's too, whose function takes powers of two of groups alone: one run that does not
reverse would cost half of the others.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from rattlesweep.analysis import style
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.schema import SdSource
from rattlesweep.sweeps.stored import open_stored
from rattlesweep.sweeps.types import TYPES
from rattlesweep.text import align

QUANTITIES = {"t_r": "$t_r$", "log10 t_r": r"$\log\,t_r$"} | {f"P({n})": f"P({n})" for n in TYPES}
FEWEST = 64
"""Groups from which on there are indices."""
MOST_MISSING = 0.05
"""Share of groups that may lack a value: the others would be another population than the ranges."""
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
    parameters: tuple[str, ...]
    cases: list[dict[str, Any]]
    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def data(self) -> dict[str, Any]:
        """Return all of it as JSON can hold it."""
        return {"directory": str(self.directory), "cases": self.cases, "indices": self.rows,
                "notes": self.notes}  # fmt: skip

    @property
    def grouped(self) -> dict[tuple[int, str], list[dict[str, Any]]]:
        """The rows of each case and quantity."""
        parts = groupby(self.rows, key=lambda row: (row["case"], row["of"]))
        return {key: list(rows) for key, rows in parts}


def sensitivity(directory: Path) -> Sensitivity:
    """Compute the indices of the runs that are on disk.

    Those of a quantity come from whole groups of runs, and only where nearly all groups have it: a
    ``t_r`` that only some of the bodies have says nothing about the ranges. Raises a ConfigError if
    bodies are not drawn from ranges by ``draw: saltelli``, an OutputError if nothing has indices.
    """
    stored = open_stored(directory)
    bodies = stored.config.bodies
    if not isinstance(bodies, SdSource) or bodies.draw != "saltelli":
        raise ConfigError(
            f"{directory}: indices need bodies that differ in one parameter; run the sweep with "
            "bodies.source: sd and bodies.draw: saltelli"
        )
    found = Sensitivity(directory, bodies.drawn, [case.dump() for case in stored.cases])
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
                    f"groups have it in all runs; below {1 - MOST_MISSING:.0%} or {FEWEST} they "
                    "would tell of those bodies and not of the ranges"
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
    table = [["case", *_SPIN, "of", "runs", "left out", "index", *found.parameters]]
    for (case, of), rows in found.grouped.items():
        spin = [found.cases[case].get(name) for name in _SPIN]
        head = [str(case), *("-" if value is None else f"{value:.4g}" for value in spin), of,
                str(rows[0]["used"]), str(rows[0]["left_out"])]  # fmt: skip
        for k in _INDICES if case < most_cases else ():
            cells = [f"{r[k]:.2f} ({r[f'{k}_low']:.2f} {r[f'{k}_high']:.2f})" for r in rows]
            table.append([*head, k, *cells])
    lines = [align(table), "in brackets: intervals of 95 %", *found.notes[: 2 * most_cases]]
    more = len(found.cases) - most_cases
    return "\n".join(lines + ([f"{more} more cases are in --json"] if more > 0 else []))


def save(found: Sensitivity, path: Path) -> None:
    """Write the figure to an .svg, .png or .pdf file."""
    with style.styled():
        style.save(draw(found), [path], DPI)


def draw(found: Sensitivity) -> Figure:
    """Draw a panel for each case and quantity: bars for each parameter, with their intervals."""
    shown = found.grouped
    names = [of for of in QUANTITIES if any(of == key[1] for key in shown)]
    cases = list(dict.fromkeys(case for case, _ in shown))[:MOST_CASES]
    figure = style.new_figure(max(4.0, 1.2 + 2.0 * len(names)), 1.2 + 1.9 * len(cases))
    panels: Any = figure.subplots(len(cases), len(names), squeeze=False, sharex=True, sharey=True)
    symbols = [style.symbol(name) for name in found.parameters]
    for line, case in zip(panels, cases, strict=True):
        for axes, of in zip(line, names, strict=True):
            for k, (index, (_, colour)) in enumerate(_INDICES.items()):
                for j, row in enumerate(shown.get((case, of), [])):
                    value, low, high = (row[index + end] for end in ("", "_low", "_high"))
                    ends = [[max(0.0, value - low)], [max(0.0, high - value)]]
                    axes.bar(j + 0.38 * k - 0.19, value, 0.36, color=colour, yerr=ends)
            axes.set_xticks(range(len(symbols)), symbols)
            style.light_grid(axes)
        said = found.cases[case]
        lines = [style.value_text(k, said[k]) for k in _SPIN if k in said]
        line[0].set_ylabel("\n".join(lines) or f"case {case}")
    for axes, of in zip(panels[0], names, strict=True):
        axes.set_title(QUANTITIES[of], fontsize="medium")
    low, high = panels[0, 0].get_ylim()
    panels[0, 0].set_ylim(max(low, -0.2), min(high, 1.4))
    style.add_legend(figure, [Patch(color=c, label=words) for words, c in _INDICES.values()])
    caption = "Sobol' indices with 95 % intervals; none where too few groups of runs have a value."
    style.add_caption(figure, caption)
    return figure
