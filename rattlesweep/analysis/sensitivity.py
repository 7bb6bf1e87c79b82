"""Which parameter matters: indices of Sobol' over the ranges that bodies are drawn from.

First-order indices are the share of a variance that goes with one parameter alone, total ones the
share that would be left if all others were known. With ``draw: saltelli`` both come from runs that
differ in one parameter, by `scipy.stats.sobol_indices` (Saltelli et al., Comput. Phys. Commun. 181,
259, 2010); else first-order ones come from means in bins of a parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from rattlesweep.analysis import style
from rattlesweep.analysis.plots.panels import legend_above
from rattlesweep.arrays import Floats
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.bodies import SdSource
from rattlesweep.sweeps.stored import open_stored
from rattlesweep.sweeps.types import TYPES
from rattlesweep.text import align

TIMES = ("t_r", "log10 t_r")
QUANTITIES = (*TIMES, *(f"P({name})" for name in TYPES))
FEWEST = 64
"""Values from which on there are indices."""
MOST_MISSING = 0.1
"""Share of groups that may lack a value: the others would be another population than the ranges."""
REPLICATES, SEED, IN_BIN = 300, 20170427, 16
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
        (bootstrap); None is what cannot be told.
    notes : list of str
        Quantities that have no indices, and why.
    """

    directory: Path
    draw: str
    parameters: tuple[str, ...]
    cases: list[dict[str, Any]]
    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def data(self) -> dict[str, Any]:
        """Return all of it as JSON can hold it."""
        return {"directory": str(self.directory), "draw": self.draw, "cases": self.cases,
                "indices": self.rows, "notes": self.notes}  # fmt: skip


def sensitivity(directory: Path) -> Sensitivity:
    """Compute the indices of the runs that are on disk.

    Raises
    ------
    ConfigError
        The bodies are not drawn from ranges alone.
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
    if bodies.target is not None:
        raise ConfigError(
            f"{directory}: its bodies are drawn for a target, by which their parameters depend on "
            "each other; indices need a sweep without bodies.target"
        )
    cases = [case.dump() for case in stored.cases]
    found = Sensitivity(directory, bodies.draw, bodies.drawn, cases)
    own = ["xi" if name == "minus_xi_deg" else name for name in bodies.drawn]
    frame = stored.read(["case", "sample", "t_r", "type", "status", *own]).to_pandas()
    for case, runs in frame.groupby("case"):
        kind = runs.type.where(runs.status == "ok")
        t_r = runs.t_r.where(kind == "R").to_numpy()
        values = {"t_r": t_r, "log10 t_r": np.log10(t_r)}
        for name in TYPES:
            values[f"P({name})"] = (kind == name).where(kind.notna(), np.nan).to_numpy(float)
        sample, x = runs["sample"].to_numpy(), runs[own].to_numpy(float).T
        for of, y in values.items():
            if bodies.draw == "saltelli":
                group = bodies.group
                f = np.full((group, int(sample.max()) // group + 1), np.nan)
                done = np.zeros(f.shape, bool)
                f[sample % group, sample // group] = y
                done[sample % group, sample // group] = True
                f = f[:, done.all(axis=0)]
            else:
                f = y[None]
            whole = np.isfinite(f).all(axis=0)
            # SciPy takes powers of two.
            used = int(whole.sum())
            used = 1 << used.bit_length() - 1 if len(f) > 1 and used else used
            places = np.flatnonzero(whole)[:used]
            missing = 1 - whole.mean() if whole.size else 0.0
            if whole.sum() and np.ptp(f[:2, places]) == 0:
                continue  # it does not vary
            if used < FEWEST or missing > MOST_MISSING:
                what = "groups of runs" if len(f) > 1 else "runs"
                found.notes.append(
                    f"case {case}, {of}: none, as {whole.sum():,} of {whole.size:,} {what} have a "
                    f"value; at least {FEWEST} must, and {1 - MOST_MISSING:.0%}, or the others would "
                    "be another population than the ranges"
                )
                continue
            estimate, data = (_from_design, f[:, places]) if len(f) > 1 else (
                _from_bins, np.stack([*map(_bins, x[:, places]), f[0, places]]))  # fmt: skip
            for name, index in zip(bodies.drawn, _intervals(estimate, data), strict=True):
                run = {"case": int(case), "of": of, "parameter": name, "used": used * len(f),
                       "left_out": f.size - used * len(f)}  # fmt: skip
                found.rows.append(run | index)
    if not found.rows:
        why = found.notes[0] if found.notes else "nothing varies"
        raise OutputError(f"{directory}: no quantity has indices; {why}; it takes more runs")
    return found


def _intervals(estimate: Callable[[Floats], Floats], data: Floats) -> list[dict[str, Any]]:
    """Return indices of each parameter with their intervals, by drawing columns of data again."""
    random, count = np.random.default_rng(SEED), data.shape[1]
    value = estimate(data)
    with np.errstate(divide="ignore", invalid="ignore"):  # some drawn again may not vary
        again = np.array([estimate(data[:, random.integers(0, count, count)])
                          for _ in range(REPLICATES)])  # fmt: skip
        # Bins with repeated values vary more, which shifts all alike.
        off = np.nanquantile(np.nan_to_num(again - np.nanmean(again, axis=0)), [0.025, 0.975], axis=0)
    ends = value + off
    parts = {"": value, "_low": ends[0], "_high": ends[1]}
    return [
        {name + end: None if np.isnan(part[k, j]) else float(part[k, j])
         for k, name in enumerate(_INDICES) for end, part in parts.items()}
        for j in range(value.shape[1])
    ]  # fmt: skip


def _from_design(f: Floats) -> Floats:
    """Return first-order and total indices, shape (2, parameters), of a design.

    `f` are values at points A, at points B, and at those of A with one parameter of B each.
    """
    from scipy.stats import sobol_indices

    design = {"f_A": f[:1], "f_B": f[1:2], "f_AB": f[2:, None]}
    found = sobol_indices(func=design, n=f.shape[1])
    return np.array([np.ravel(found.first_order), np.ravel(found.total_order)])


def _bins(x: Floats) -> Floats:
    """Return the bins of values of a parameter, as many in each, as numbers from 0."""
    rank = np.argsort(np.argsort(x, kind="stable"))
    places: Floats = np.floor(rank / (len(x) / max(4, len(x) // IN_BIN)))
    return places


def _from_bins(data: Floats) -> Floats:
    """Return first-order indices from means in bins, less what they vary by chance; no total ones.

    `data` are the bins of each parameter and, last, the values.
    """
    *bins, y = data
    off, first = y - y.mean(), []
    for place in bins:
        counts = np.bincount(place.astype(int))
        kept = counts > 1
        means, squares = (
            np.bincount(place.astype(int), off**k)[kept] / counts[kept] for k in (1, 2)
        )
        chance = (squares - means**2) / (counts[kept] - 1)
        first.append(np.average(means**2 - chance, weights=counts[kept]) / y.var(ddof=1))
    return np.array([first, np.full(len(first), np.nan)])


def as_text(found: Sensitivity, most_cases: int) -> str:
    """Return a table of indices with their intervals, of many cases the first."""
    return "\n".join(_lines(found, most_cases))


def _lines(found: Sensitivity, most_cases: int) -> Iterator[str]:
    table = [["case", "n_i", "omega_xy0", "of", "runs", "left out", "index", *found.parameters]]
    for case, of, rows in _grouped(found):
        if case >= most_cases:
            continue
        said = found.cases[case]
        head = [str(case), *(f"{said[k]:.4g}" if k in said else "-" for k in _SPIN)]
        for index in _INDICES:
            if rows[0][index] is not None:
                cells = ["{:.2f} ({:.2f} {:.2f})".format(*_values(row, index)) for row in rows]
                counts = [str(rows[0]["used"]), str(rows[0]["left_out"])]
                table.append([*head, of, *counts, index, *cells])
    yield align(table)
    yield "in brackets intervals of 95 %; left out: runs in groups without all values (t_r has one"
    yield "only where the spin reverses), and those beyond a power of two"
    yield from found.notes[: 2 * most_cases]
    if found.draw != "saltelli":
        yield "no total indices: they take a sweep with bodies.draw: saltelli"
    if (more := len(found.cases) - most_cases) > 0:
        yield f"{more} more cases are in --json"


def _grouped(found: Sensitivity) -> Iterator[tuple[int, str, list[dict[str, Any]]]]:
    for case, of in dict.fromkeys((row["case"], row["of"]) for row in found.rows):
        yield case, of, [row for row in found.rows if (row["case"], row["of"]) == (case, of)]


def _values(row: dict[str, Any], index: str) -> tuple[float, ...]:
    return tuple(row[index + end] for end in ("", "_low", "_high"))


def save(found: Sensitivity, path: Path) -> None:
    """Write the figure to an .svg, .png or .pdf file."""
    with style.styled():
        style.save(draw(found), [path], DPI)


def draw(found: Sensitivity) -> Figure:
    """Draw a panel for each case and quantity: bars for each parameter, with their intervals."""
    names = [of for of in QUANTITIES if any(row["of"] == of for row in found.rows)]
    cases = list(dict.fromkeys(row["case"] for row in found.rows))[:MOST_CASES]
    figure = style.new_figure(max(4.0, 1.2 + 2.0 * len(names)), 1.2 + 1.9 * len(cases))
    panels: Any = figure.subplots(len(cases), len(names), squeeze=False, sharex=True, sharey=True)
    shown = {(case, of): rows for case, of, rows in _grouped(found)}
    symbols = [style.symbol(name) for name in found.parameters]
    for line, case in zip(panels, cases, strict=True):
        for axes, of in zip(line, names, strict=True):
            rows = shown.get((case, of), [])
            for k, (index, (_, colour)) in enumerate(_INDICES.items()):
                for j, row in enumerate(rows):
                    if row[index] is not None:
                        value, low, high = _values(row, index)
                        ends = [[max(0.0, value - low)], [max(0.0, high - value)]]
                        axes.bar(j + 0.38 * k - 0.19, value, 0.36, color=colour, yerr=ends,
                                 error_kw={"linewidth": 0.9})  # fmt: skip
            if not rows:
                words = "does not vary,\nor too few\nhave a value"
                axes.text(0.5, 0.4, words, transform=axes.transAxes, ha="center", fontsize="small")
            axes.set_xticks(range(len(symbols)), symbols)
            style.light_grid(axes)
        said = found.cases[case]
        words = [style.value_text(k, said[k]) for k in _SPIN if k in said]
        line[0].set_ylabel("\n".join(words) or f"case {case}")
    for axes, of in zip(panels[0], names, strict=True):
        axes.set_title({"t_r": "$t_r$", "log10 t_r": r"$\log\,t_r$"}.get(of, of), fontsize="medium")
    low, high = panels[0, 0].get_ylim()
    panels[0, 0].set_ylim(max(low, -0.2), min(high, 1.4))
    shown_indices = [i for i in _INDICES if any(row[i] is not None for row in found.rows)]
    handles = [Patch(color=_INDICES[i][1], label=_INDICES[i][0]) for i in shown_indices]
    legend_above(figure, handles, 1.2)
    return figure
