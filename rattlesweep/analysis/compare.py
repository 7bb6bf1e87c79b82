"""How far two directories of the same runs differ: one join, a table, and a figure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.analysis import style
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps.config.read import differences, fixed_part, resolved
from rattlesweep.sweeps.stored import Stored, open_stored

DPI, MOST_LISTED = 150, 10
# What makes runs the same; another machine may draw it with other last digits.
_RUN = ["alpha", "beta", "gamma", "theta", "phi", "xi", "n_i", "omega_xy0"]
_LISTED = ["case", "sample", "type_a", "type_b", "t_r_a", "t_r_b", "relative", "over_errors",
           "type_sure_a", "type_sure_b"]  # fmt: skip


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
    errors: bool  # whether both have t_r_error and type_sure
    runs: pd.DataFrame

    def __repr__(self) -> str:
        return as_text(self, 20)

    def row(self, runs: pd.DataFrame) -> dict[str, Any]:
        """Count some of the runs, ``beyond`` those that differ by more than both errors together.

        None is what is not known.
        """
        relative = runs.relative.dropna().to_numpy()
        ends = np.quantile(relative, [0.5, 0.99, 1], method="inverted_cdf") if len(relative) else []
        return {
            "runs": len(runs), "reversing": len(relative), "equal": int((relative == 0).sum()),
            "median": None, "p99": None, "worst": None,
            **dict(zip(("median", "p99", "worst"), map(float, ends), strict=False)),
            "beyond": int((runs.over_errors > 1).sum()) if self.errors else None,
            "types": int(runs.differs.sum()),
            "types_sure": int((runs.differs & runs.sure).sum()) if self.errors else None,
            "failed": int(runs.not_ok.sum()),
        }  # fmt: skip

    def disagree(self, allowed: float) -> bool:
        """Tell whether a larger fraction is beyond both errors, or types that are sure differ."""
        total = self.row(self.runs)
        return bool((total["beyond"] or 0) > allowed * total["reversing"] or total["types_sure"])

    def data(self) -> dict[str, Any]:
        """Return all of it as JSON can hold it; ``differing`` are the runs that differ most."""
        cases = self.sides[0].cases
        rows = self.runs[self.runs.differs | (self.runs.relative > 0)]
        rows = rows.sort_values(["differs", "over_errors", "relative"], ascending=False)
        listed = rows[_LISTED].head(MOST_LISTED).astype(object).replace([np.nan, np.inf], None)
        return {
            "directories": [str(side.directory) for side in self.sides], "differ": self.differ,
            "missing": self.missing, "total": self.row(self.runs),
            "cases": [cases[int(str(case))].dump() | self.row(own)
                      for case, own in self.runs.groupby("case")],
            "differing": listed.to_dict("records"),
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
    frames, errors = [], all("t_r_error" in side.schema.names for side in sides)
    for side in sides:
        names = ["case", "sample", *_RUN, "t_r", "type", "status"]
        rows = side.read([*names, *(["t_r_error", "type_sure"] if errors else [])]).to_pandas()
        if rows.empty:
            raise OutputError(f"{side.directory} holds no runs yet")
        frames.append(rows if errors else rows.assign(t_r_error=np.nan, type_sure=None))
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
    cases = data["cases"]
    lines += ["", style.text_table([*cases[:most_cases], {"case": "all"} | data["total"]])]
    lines += [f"{len(cases) - most_cases} more cases are in --json"] * (len(cases) > most_cases)
    lines += ["no errors stored in both; add record: [error]"] * (not found.errors)
    if data["differing"]:
        lines += ["\nruns that differ most:", style.text_table(data["differing"])]
    return "\n".join(lines)


def save(found: Comparison, path: Path) -> None:
    """Draw a histogram of the differences of t_r, over their errors if known, and write it."""
    total, name = found.row(found.runs), "over_errors" if found.errors else "relative"
    values = found.runs[name][found.runs[name].between(0, np.inf, inclusive="neither")]
    with style.styled():
        figure = style.new_figure(5.2, 3.9)
        axes: Any = figure.subplots()
        if len(values):
            bins = np.geomspace(values.min() / 2, 2 * values.max(), 60)
            axes.hist(values, bins, color=style.BLUE)
            axes.set(xscale="log", yscale="log", ylim=(0.7, None))
        below = "both errors" if found.errors else "$t_r$"
        axes.set(xlabel=rf"$|\Delta t_r|$ / {below}", ylabel="number of runs")
        style.light_grid(axes)
        style.add_caption(
            figure,
            f"{' against '.join(str(side.directory) for side in found.sides)}: "
            f"{total['reversing']:,} runs reverse in both, {total['equal']:,} of them equally.",
        )
        style.save(figure, [path], DPI)
