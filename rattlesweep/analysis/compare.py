"""How far two directories of the same runs differ: one join, a table, and a figure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib.figure import Figure

from rattlesweep.analysis import style
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.read import differences, fixed_part, resolved
from rattlesweep.sweeps.stored import Stored, open_stored
from rattlesweep.text import align

DPI, MOST_LISTED = 150, 10
# What makes runs the same; another machine may draw it with other last digits.
_RUN = ["alpha", "beta", "gamma", "theta", "phi", "xi", "n_i", "omega_xy0"]
_LISTED = ["case", "sample", "type_a", "type_b", "t_r_a", "t_r_b", "relative", "over_errors",
           "type_sure_a", "type_sure_b"]  # fmt: skip
_FORMATS = {"n_i": ".4g", "omega_xy0": ".4g", "t_r_a": ".10g", "t_r_b": ".10g"}
_LISTS = {
    "differing_times": "t_r that differ most, by their relative difference",
    "beyond_errors": "t_r that differ by more than both errors, by that ratio",
    "differing_types": "types that differ, those that both are sure of first",
}


@dataclass
class Comparison:
    """How two directories of the same runs differ.

    `runs` has a row for each run of both: ``case``, ``sample``, ``t_r``, ``type``, ``status``,
    ``t_r_error`` and ``type_sure`` with the suffixes ``_a`` and ``_b``, ``dt_r`` (b less a),
    ``relative`` (to the mean of both), ``over_errors`` (to the root of the sum of the squares of
    both errors), ``differs`` (types), ``sure`` (of both types) and ``not_ok`` (one of them).
    """

    sides: tuple[Stored, Stored]
    differ: list[str]  # in what else: settings, versions, processors
    missing: list[int]  # runs that each directory lacks
    errors: list[bool]  # whether each has t_r_error and type_sure
    runs: pd.DataFrame

    def __repr__(self) -> str:
        return as_text(self, 20)

    def row(self, runs: pd.DataFrame) -> dict[str, Any]:
        """Count some of the runs; None is what is not known.

        ``beyond`` are runs whose times differ by more than both errors together.
        """
        relative, known = runs.relative.dropna().to_numpy(), all(self.errors)
        shares = [0.5, 0.99, 1.0]
        ends = (np.quantile(relative, shares, method="inverted_cdf").tolist() if len(relative)
                else [None] * 3)  # fmt: skip
        return {
            "runs": len(runs), "reversing": len(relative), "equal": int((relative == 0).sum()),
            **dict(zip(("median", "p99", "worst"), ends, strict=True)),
            "beyond": int((runs.over_errors > 1).sum()) if known else None,
            "types": int(runs.differs.sum()),
            "types_sure": int((runs.differs & runs.sure).sum()) if known else None,
            "not_ok": int(runs.not_ok.sum()),
        }  # fmt: skip

    def disagree(self, allowed: float) -> bool:
        """Tell whether a larger share is beyond both errors, or types that are sure differ."""
        total = self.row(self.runs)
        return bool((total["beyond"] or 0) > allowed * total["reversing"] or total["types_sure"])

    def data(self) -> dict[str, Any]:
        """Return all of it as JSON can hold it."""
        runs = self.runs
        listed = (
            runs[runs.relative > 0].sort_values("relative", ascending=False),
            runs[runs.over_errors > 1].sort_values("over_errors", ascending=False),
            runs[runs.differs].sort_values("sure", ascending=False, kind="stable"),
        )
        cases = self.sides[0].cases
        return {
            "directories": [str(side.directory) for side in self.sides],
            "differ": self.differ,
            "missing": self.missing,
            "errors_stored": self.errors,
            "total": self.row(runs),
            "cases": [cases[own["case"].iloc[0]].dump() | self.row(own)
                      for _, own in runs.groupby("case")],
        } | {
            name: rows[_LISTED].head(MOST_LISTED).astype(object)
            .replace([np.nan, np.inf], None).to_dict("records")
            for name, rows in zip(_LISTS, listed, strict=True)
        }  # fmt: skip

    def write_runs(self, path: Path) -> None:
        """Write the differences of all runs to a .csv or .parquet file, whole or not at all."""
        style.save_table(pa.Table.from_pandas(self.runs, preserve_index=False), path)


def compare(a: Path, b: Path) -> Comparison:
    """Compare the runs that two directories both have.

    Raises a ConfigError if they are not of the same runs, apart from how these were integrated and
    what was recorded, an OutputError if one of them has no runs.
    """
    sides = open_stored(a), open_stored(b)
    wrong = differences(*map(_same_runs, sides))[:3]
    frames, errors = [], ["t_r_error" in side.schema.names for side in sides]
    for side, has in zip(sides, errors, strict=True):
        names = ["case", "sample", *_RUN, "t_r", "type", "status"]
        rows = side.read([*names, *(["t_r_error", "type_sure"] if has else [])]).to_pandas()
        if rows.empty:
            raise OutputError(f"{side.directory} holds no runs yet")
        frames.append(rows if has else rows.assign(t_r_error=np.nan, type_sure=None))
    runs = frames[0].merge(frames[1], on=["case", "sample"], suffixes=("_a", "_b"))
    for name in _RUN if not wrong else ():
        x, y = (runs.pop(f"{name}_{side}").to_numpy(float) for side in "ab")
        for k in np.flatnonzero(~np.isclose(x, y, rtol=1e-9, atol=1e-12, equal_nan=True))[:1]:
            where = f"case {runs['case'][k]}, sample {runs['sample'][k]}"
            wrong.append(f"{where}: {name}: {x[k]:.10g} against {y[k]:.10g}")
    if wrong:
        raise ConfigError(
            f"{b}: its runs are not those of {a} ({'; '.join(wrong)}); only directories of the "
            "same runs can be compared"
        )
    ok = (runs.status_a == "ok") & (runs.status_b == "ok")
    dt_r = (runs.t_r_b - runs.t_r_a).where(ok)
    error = np.hypot(runs.t_r_error_a, runs.t_r_error_b)
    runs = runs.assign(
        dt_r=dt_r,
        relative=dt_r.abs() / ((runs.t_r_a + runs.t_r_b) / 2),
        # Any difference is beyond errors of 0, but no difference is not.
        over_errors=(dt_r.abs() / error).mask((error == 0) & (dt_r == 0), 0.0),
        differs=ok & (runs.type_a != runs.type_b),
        sure=runs.type_sure_a.eq(True) & runs.type_sure_b.eq(True),
        not_ok=~ok,
    )
    missing = [len(side.cases) * side.samples - len(rows)
               for side, rows in zip(sides, frames, strict=True)]  # fmt: skip
    return Comparison(sides, differences(*map(_settings, sides)), missing, errors, runs)


def _same_runs(side: Stored) -> dict[str, Any]:
    """Return what determines which runs there are, however they are integrated."""
    how = ("integrator", "record", "classify")
    data = {k: v for k, v in fixed_part(resolved(side.config)).items() if k not in how}
    # A table may have moved; what it says is compared row by row.
    data["bodies"] = {k: v for k, v in data["bodies"].items() if k != "path"}
    return data | {"cases": [str(case) for case in side.cases], "samples": side.samples}


def _settings(side: Stored) -> dict[str, Any]:
    """Return what else can make a difference."""
    config, manifest = resolved(side.config), side.manifest
    return {"integrator": config["integrator"], "record": config["record"],
            "classify": side.thresholds.model_dump(mode="json"),
            "versions": manifest["versions"], "cpu": manifest["machine"].get("cpu")}  # fmt: skip


def as_text(found: Comparison, most_cases: int) -> str:
    """Return all of it to be read, of many cases the first."""
    data, lines = found.data(), []
    for name, side, missing in zip("AB", found.sides, found.missing, strict=True):
        planned = len(side.cases) * side.samples
        some = f"{missing:,} of {planned:,} runs are missing"
        lines.append(f"{name}  {side.directory}: {some if missing else f'all {planned:,} runs'}")
    lines += [f"   {words}" for words in found.differ]
    shown = [*data["cases"][:most_cases], {"case": "all"} | data["total"]]
    lines.append("\n" + _table(shown))
    if (more := len(data["cases"]) - most_cases) > 0:
        lines.append(f"{more} more cases are in --json")
    if without := [n for n, stored in zip("AB", found.errors, strict=True) if not stored]:
        lines.append(f"{' and '.join(without)}: no errors stored; add record: [error]")
    lines += [f"\n{title}\n{_table(data[name])}" for name, title in _LISTS.items() if data[name]]
    return "\n".join(lines)


def _table(rows: list[dict[str, Any]]) -> str:
    """Lay rows out under their keys, without keys that none has."""
    names = [k for k in dict.fromkeys(k for row in rows for k in row)
             if any(row.get(k) is not None for row in rows)]  # fmt: skip

    def cell(value: Any, name: str) -> str:
        if value is None or isinstance(value, bool):
            return {None: "-", True: "yes", False: "no"}[value]
        return format(value, _FORMATS.get(name, ".2g")) if isinstance(value, float) else str(value)

    return align([names, *([cell(row.get(k), k) for k in names] for row in rows)])


def save(found: Comparison, path: Path) -> None:
    """Write the figure to an .svg, .png or .pdf file."""
    with style.styled():
        style.save(draw(found), [path], DPI)


def draw(found: Comparison) -> Figure:
    """Draw a histogram of the relative differences, and over their errors where both have them."""
    total, against = found.row(found.runs), all(found.errors)
    figure = style.new_figure(8.4 if against else 5.2, 3.9)
    panels: Any = figure.subplots(1, 1 + against, squeeze=False, sharey=True)[0]
    columns = {"relative": r"$|\Delta t_r|/t_r$", "over_errors": r"$|\Delta t_r|$ / both errors"}
    for axes, (name, words) in zip(panels, columns.items(), strict=False):
        values = found.runs[name].to_numpy()
        values = np.log10(values[np.isfinite(values) & (values > 0)])
        if len(values):
            edges = 10 ** np.arange(np.floor(values.min()), values.max() + 0.1, 0.1)
            axes.hist(10**values, edges, color=style.BLUE)
        axes.set(xscale="log", yscale="log", ylim=(0.7, None), xlabel=words)
        style.light_grid(axes)
    panels[0].set_ylabel("number of runs")
    caption = (
        f"{' against '.join(str(side.directory) for side in found.sides)}: "
        f"{total['reversing']:,} runs reverse in both, {total['equal']:,} of them equally."
    )
    if against:
        panels[1].axvline(1, **style.THEORY)
        caption += f" {total['beyond']:,} differ by more than both errors together."
    style.add_caption(figure, caption)
    return figure
