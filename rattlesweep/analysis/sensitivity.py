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

    Attributes
    ----------
    rows : list of dict
        By ``case``, ``of`` (one of `QUANTITIES`) and ``parameter``: ``used`` and ``left_out`` runs,
        ``first`` and ``total`` with the ends ``_low`` and ``_high`` of their 95 % intervals
        (bootstrap).
    notes : list of str
        Quantities that have no indices, and why.
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
    ``t_r`` that only some of the bodies have says nothing about the ranges.

    Raises
    ------
    ConfigError
        The bodies are not drawn from ranges by ``draw: saltelli``.
    OutputError
        No quantity of any case has indices; the message says why.
    """
    stored = open_stored(directory)
    bodies = stored.config.bodies
    if not isinstance(bodies, SdSource):
        raise ConfigError(
            f"{directory}: its bodies are not drawn from ranges (source: {bodies.source}), so no "
            "share of a variance goes with any; indices need source: sd"
        )
    if bodies.draw != "saltelli":
        raise ConfigError(
            f"{directory}: its bodies were drawn one by one (draw: {bodies.draw}), and indices "
            "need some that differ in one parameter; run the sweep with bodies.draw: saltelli"
        )
    found = Sensitivity(directory, bodies.drawn, [case.dump() for case in stored.cases])
    frame = stored.read(["case", "sample", "t_r", "type", "status"]).to_pandas()
    group = 2 + len(bodies.drawn)
    for case, runs in frame.groupby("case"):
        kind = runs.type.where(runs.status == "ok")
        t_r = runs.t_r.where(kind == "R").to_numpy()
        values = [t_r, np.log10(t_r)]
        values += [(kind == name).where(kind.notna(), np.nan).to_numpy(float) for name in TYPES]
        sample = runs["sample"].to_numpy()
        shape = group, int(sample.max()) // group + 1
        done = np.zeros(shape, bool)
        done[sample % group, sample // group] = True
        for of, y in zip(QUANTITIES, values, strict=True):
            f = np.full(shape, np.nan)
            f[sample % group, sample // group] = y
            f = f[:, done.all(axis=0)]
            whole = np.isfinite(f).all(axis=0)
            if whole.sum() < FEWEST or whole.mean() < 1 - MOST_MISSING:
                does = "reverse" if "t_r" in of else "end with status ok"
                if of != "log10 t_r":  # said of t_r
                    found.notes.append(
                        f"case {case}, {of}: no indices, as all runs {does} in only "
                        f"{whole.sum():,} of {whole.size:,} groups; below {1 - MOST_MISSING:.0%} "
                        f"or {FEWEST} they would tell of those bodies and not of the ranges"
                    )
                continue
            f = f[:, whole]
            if np.ptp(f[:2]) == 0:
                continue  # it does not vary
            head = {"case": int(case), "of": of, "used": f.size,
                    "left_out": done.all(axis=0).sum().item() * group - f.size}  # fmt: skip
            for name, index in zip(bodies.drawn, _indices(f), strict=True):
                found.rows.append(head | {"parameter": name} | index)
    if not found.rows:
        why = found.notes[0] if found.notes else "nothing varies"
        raise OutputError(f"{directory}: no quantity has indices; {why}; it takes more runs")
    return found


def _indices(f: Floats) -> list[dict[str, Any]]:
    """Return the indices of each parameter with their intervals, from drawing groups again.

    `f` are values at points A, at points B, and at those of A with one parameter of B each.
    """

    def estimate(f: Floats) -> Floats:
        a, b, *mixed = f - f[:2].mean()
        variance = f[:2].var() or np.nan  # some drawn again may not vary
        first = [np.mean(b * (ab - a)) / variance for ab in mixed]
        return np.array([first, [0.5 * np.mean((a - ab) ** 2) / variance for ab in mixed]])

    random, n = np.random.default_rng(SEED), f.shape[1]
    again = [estimate(f[:, random.integers(0, n, n)]) for _ in range(REPLICATES)]
    value, (low, high) = estimate(f), np.nanquantile(again, [0.025, 0.975], axis=0)
    parts = {"": value, "_low": low, "_high": high}
    return [
        {name + end: float(part[k, j]) for k, name in enumerate(_INDICES)
         for end, part in parts.items()}
        for j in range(len(f) - 2)
    ]  # fmt: skip


def as_text(found: Sensitivity, most_cases: int) -> str:
    """Return a table of indices with their intervals, of many cases the first."""
    table = [["case", *_SPIN, "of", "runs", "left out", "index", *found.parameters]]
    for (case, of), rows in found.grouped.items():
        if case >= most_cases:
            continue
        said = found.cases[case]
        head = [str(case), *(f"{said[k]:.4g}" if k in said else "-" for k in _SPIN), of]
        counts = [str(rows[0]["used"]), str(rows[0]["left_out"])]
        for index in _INDICES:
            cells = ["{:.2f} ({:.2f} {:.2f})".format(*_values(row, index)) for row in rows]
            table.append([*head, *counts, index, *cells])
    more = len(found.cases) - most_cases
    return "\n".join(
        [
            align(table),
            "in brackets: intervals of 95 %; left out: runs of groups that lack a value",
            *found.notes[: 2 * most_cases],
            *([f"{more} more cases are in --json"] if more > 0 else []),
        ]
    )


def _values(row: dict[str, Any], index: str) -> tuple[float, ...]:
    return tuple(row[index + end] for end in ("", "_low", "_high"))


def save(found: Sensitivity, path: Path) -> None:
    """Write the figure to an .svg, .png or .pdf file."""
    with style.styled():
        style.save(draw(found), [path], DPI)


def draw(found: Sensitivity) -> Figure:
    """Draw a panel for each case and quantity: bars for each parameter, with their intervals."""
    shown = found.grouped
    names = [of for of in QUANTITIES if any(key[1] == of for key in shown)]
    cases = list(dict.fromkeys(case for case, _ in shown))[:MOST_CASES]
    figure = style.new_figure(max(4.0, 1.2 + 2.0 * len(names)), 1.2 + 1.9 * len(cases))
    panels: Any = figure.subplots(len(cases), len(names), squeeze=False, sharex=True, sharey=True)
    symbols = [style.symbol(name) for name in found.parameters]
    for line, case in zip(panels, cases, strict=True):
        for axes, of in zip(line, names, strict=True):
            rows = shown.get((case, of), [])
            for k, (index, (_, colour)) in enumerate(_INDICES.items()):
                for j, row in enumerate(rows):
                    value, low, high = _values(row, index)
                    ends = [[max(0.0, value - low)], [max(0.0, high - value)]]
                    axes.bar(j + 0.38 * k - 0.19, value, 0.36, color=colour, yerr=ends,
                             error_kw={"linewidth": 0.9})  # fmt: skip
            if not rows:
                axes.text(0.5, 0.4, "no indices", transform=axes.transAxes, ha="center",
                          fontsize="small", color=style.GREY)  # fmt: skip
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
    caption = "Sobol' indices with 95 % intervals."
    if any(not shown.get((case, of)) for case in cases for of in names):
        caption += " No indices: the quantity does not vary, or too few groups of runs have it."
    style.add_caption(figure, caption)
    return figure
