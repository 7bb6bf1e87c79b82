"""How far two directories of the same runs differ: one join, a table, and a figure."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as parquet
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from rattlesweep.analysis import style
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.sweeps import columns
from rattlesweep.sweeps.columns import F64, I32, I64, TEXT, TIME
from rattlesweep.sweeps.config.load import differences, fixed_part, resolved
from rattlesweep.sweeps.files import replace_file
from rattlesweep.sweeps.stored import Stored, open_stored
from rattlesweep.text import align

DPI, MOST_LISTED = 150, 10
DIFFERENCE = r"$|\Delta t_r|/t_r$"
# What makes runs the same; another machine may draw it with other last digits.
_RUN = ("alpha", "beta", "gamma", "theta", "phi", "xi", "n_i", "omega_xy0")
_SIDES = [("a", "the first directory"), ("b", "the second")]
DATA = pa.schema(
    [
        columns.required("case", I32, "1", "number of the case, from 0"),
        columns.required("sample", I64, "1", "number of the run within its case"),
        *(columns.field(f"type_{x}", TEXT, "1", f"type in {words}") for x, words in _SIDES),
        *(columns.field(f"t_r_{x}", F64, TIME, f"t_r in {words}") for x, words in _SIDES),
        columns.field("dt_r", F64, TIME, "t_r_b - t_r_a; null: does not reverse in both"),
        columns.field("relative", F64, "1", "abs(dt_r) over the mean of both t_r"),
        *(columns.field(f"t_r_error_{x}", F64, TIME, f"t_r_error in {w}") for x, w in _SIDES),
        columns.field("over_errors", F64, "1", "abs(dt_r) over the root of the sum of the squares "
                      "of both errors"),
        *(columns.field(f"type_sure_{x}", pa.bool_(), "1", f"type_sure in {w}") for x, w in _SIDES),
    ]
)  # fmt: skip
"""Columns of the differences, one row for each run that both directories have."""
# Columns of the tables, with their headings.
_TABLE = {
    "n_i": "n_i", "omega_xy0": "omega_xy0", "runs": "runs", "reversing": "both R",
    "equal": "equal", "median": "median", "p99": "99 %", "worst": "worst", "beyond": "beyond",
    "types": "types", "types_sure": "sure", "not_ok": "not ok",
}  # fmt: skip
_LISTED = {
    "case": "case", "sample": "sample", "type_a": "type A", "type_b": "type B", "t_r_a": "t_r A",
    "t_r_b": "t_r B", "relative": "|dt_r|/t_r", "over_errors": "over errors",
    "type_sure_a": "sure A", "type_sure_b": "sure B",
}  # fmt: skip
_FORMS = {
    "n_i": ".4g", "omega_xy0": ".4g", "t_r_a": ".10g", "t_r_b": ".10g", "over_errors": ".3g",
}  # fmt: skip


@dataclass
class Comparison:
    """How two directories of the same runs differ.

    `runs` has a row for each run of both, with the columns of `DATA`, ``differs`` (types), ``sure``
    (both types) and ``not_ok`` (in one of them or both).
    """

    sides: tuple[Stored, Stored]
    differ: list[str]  # in what else: settings, versions, processors
    counts: tuple[int, int]  # rows of each directory
    errors: tuple[bool, bool]  # whether each has t_r_error and type_sure
    runs: pd.DataFrame

    def row(self, runs: pd.DataFrame) -> dict[str, Any]:
        """Count some of the runs; None for what is not known.

        ``beyond`` are runs whose times differ by more than both errors together.
        """
        relative, known = runs.relative.dropna(), all(self.errors)
        found = {"median": 0.5, "p99": 0.99, "worst": 1.0}
        return {
            "runs": len(runs), "reversing": len(relative), "equal": int((relative == 0).sum()),
            "beyond": int((runs.over_errors > 1).sum()) if known else None,
            "types": int(runs.differs.sum()),
            "types_sure": int((runs.differs & runs.sure).sum()) if known else None,
            "not_ok": int(runs.not_ok.sum()),
        } | {
            name: float(np.quantile(relative, share, method="inverted_cdf"))
            if len(relative) else None
            for name, share in found.items()
        }  # fmt: skip

    def disagree(self, allowed: float) -> bool:
        """Tell whether more than this share is beyond both errors, or types that are sure differ."""
        total = self.row(self.runs)
        beyond, sure = total["beyond"] or 0, total["types_sure"] or 0
        return bool(beyond > allowed * total["reversing"] or sure > 0)

    def listed(self) -> dict[str, pd.DataFrame]:
        """Return the runs that differ most, each list sorted by what its name says."""
        runs = self.runs
        beyond = runs[runs.over_errors > 1] if all(self.errors) else runs[:0]
        types = runs[runs.differs].sort_values("sure", ascending=False, kind="stable")
        return {
            "differing_times": runs[runs.relative > 0].nlargest(MOST_LISTED, "relative"),
            "beyond_errors": beyond.nlargest(MOST_LISTED, "over_errors"),
            "differing_types": types.head(MOST_LISTED),
        }

    def data(self) -> dict[str, Any]:
        """Return all of it as JSON can hold it."""
        planned = [len(side.cases) * side.samples for side in self.sides]
        cases = [self.sides[0].cases[k].dump() | self.row(own)
                 for k, own in self.runs.groupby("case")]  # fmt: skip
        return {
            "directories": [str(side.directory) for side in self.sides],
            "differ": self.differ,
            "missing": [n - rows for n, rows in zip(planned, self.counts, strict=True)],
            "errors_stored": list(self.errors),
            "total": self.row(self.runs),
            "cases": cases,
            **{name: _table(rows).to_pylist() for name, rows in self.listed().items()},
        }

    def write_runs(self, path: Path) -> None:
        """Write the differences of all runs to a .csv or .parquet file, whole or not at all."""
        buffer = io.BytesIO()
        write = csv.write_csv if path.suffix.lower() == ".csv" else parquet.write_table
        write(_table(self.runs), buffer)
        replace_file(path, buffer.getvalue())


def _table(runs: pd.DataFrame) -> pa.Table:
    finite = runs.assign(over_errors=runs.over_errors.where(np.isfinite(runs.over_errors)))
    return pa.Table.from_pandas(finite[DATA.names], DATA, preserve_index=False)


def compare(a: Path, b: Path) -> Comparison:
    """Compare the runs that two directories both have.

    Raises
    ------
    ConfigError
        They are not of the same runs, apart from how these were integrated and what was recorded.
    OutputError
        One of them has no runs.
    """
    sides = open_stored(a), open_stored(b)
    one, other = sides

    def refused(what: str) -> ConfigError:
        return ConfigError(
            f"{other.directory}: its runs are not those of {one.directory} ({what}); only "
            "directories of the same runs can be compared"
        )

    if changes := differences(*map(_same_runs, sides)):
        raise refused("; ".join(changes[:3]))
    frames, errors = [], []
    for side in sides:
        errors.append("t_r_error" in side.schema.names)
        names = ["case", "sample", *_RUN, "t_r", "type", "status"]
        rows = side.read([*names, *(["t_r_error", "type_sure"] if errors[-1] else [])]).to_pandas()
        if rows.empty:
            raise OutputError(f"{side.directory} holds no runs yet")
        frames.append(rows if errors[-1] else rows.assign(t_r_error=np.nan, type_sure=None))
    runs = frames[0].merge(frames[1], on=["case", "sample"], suffixes=("_a", "_b"))
    for name in _RUN:
        x, y = runs[f"{name}_a"].to_numpy(float), runs[f"{name}_b"].to_numpy(float)
        if len(wrong := np.flatnonzero(~np.isclose(x, y, rtol=1e-9, atol=1e-12, equal_nan=True))):
            k = int(wrong[0])
            where = f"case {runs['case'][k]}, sample {runs['sample'][k]}"
            raise refused(f"{where}: {name}: {x[k]:.10g} against {y[k]:.10g}")
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
    counts = len(frames[0]), len(frames[1])
    differ = differences(_settings(one), _settings(other))
    return Comparison(sides, differ, counts, (errors[0], errors[1]), runs)


def _same_runs(side: Stored) -> dict[str, Any]:
    """Return what determines which runs there are, however they are integrated."""
    how = ("integrator", "record", "classify", "stop")
    data = {k: v for k, v in fixed_part(resolved(side.config)).items() if k not in how}
    # A table may have moved; what it says is compared row by row.
    data["bodies"] = {k: v for k, v in data["bodies"].items() if k not in ("path", "refine")}
    cases = {"cases": [case.dump() for case in side.cases], "samples": side.samples}
    return data | cases if data["bodies"]["source"] != "table" else data


def _settings(side: Stored) -> dict[str, Any]:
    """Return what else can make a difference."""
    config, manifest = resolved(side.config), side.manifest
    settings = {key: config[key] for key in ("integrator", "record")}
    settings["classify"] = side.thresholds.model_dump(mode="json")
    return settings | {"versions": manifest["versions"], "cpu": manifest["machine"].get("cpu")}


def as_text(found: Comparison, most_cases: int) -> str:
    """Return all of it to be read, of many cases the first."""
    return "\n".join(_lines(found, most_cases))


def _lines(found: Comparison, most_cases: int) -> Iterator[str]:
    data = found.data()
    for name, side, missing in zip("AB", found.sides, data["missing"], strict=True):
        planned = len(side.cases) * side.samples
        some = f"{missing:,} of {planned:,} runs are missing" if missing else f"all {planned:,} runs"
        yield f"{name}  {side.directory}: {some}"
    yield from (f"   {words}" for words in found.differ)
    yield ""
    table = [["case", "target", *_TABLE.values()]]
    for case in [*data["cases"][:most_cases], {"case": "all"} | data["total"]]:
        targets = [f"{name}={case[name]:.4g}" for name in ("K_p", "K_r") if name in case]
        cells = [_cell(case.get(name), name) for name in _TABLE]
        table.append([str(case["case"]), *(targets or ["-"]), *cells])
    yield align(table)
    if (more := len(data["cases"]) - most_cases) > 0:
        yield f"{more} more cases are in --json"
    without = [n for n, stored in zip("AB", found.errors, strict=True) if not stored]
    if without:
        yield f"{' and '.join(without)}: no errors stored; add record: [error]"
    for name, title in (
        ("differing_times", "t_r that differ most, by |dt_r|/t_r"),
        ("beyond_errors", "t_r that differ by more than both errors, by their ratio"),
        ("differing_types", "types that differ, those that both are sure of first"),
    ):
        if runs := data[name]:
            names = [key for key in _LISTED if any(run[key] is not None for run in runs)]
            yield f"\n{title} (`rattlesweep replay DIR --case CASE --sample SAMPLE` follows one)"
            listed = [[_cell(run[key], key) for key in names] for run in runs]
            yield align([[_LISTED[key] for key in names], *listed])


def _cell(value: Any, name: str) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value == 0:
        return "0"
    return format(value, _FORMS.get(name, ".1e")) if isinstance(value, float) else str(value)


def save(found: Comparison, path: Path) -> None:
    """Write the figure to an .svg, .png or .pdf file."""
    with style.styled():
        style.save(draw(found), [path], DPI)


def draw(found: Comparison) -> Figure:
    """Draw runs by relative difference, and against their errors where both directories have them."""
    runs = found.runs
    relative = runs.relative[runs.relative > 0]
    error = (relative / runs.over_errors[relative.index]).where(lambda e: e > 0).dropna()
    against = all(found.errors) and len(error) > 0
    figure = style.new_figure(8.4 if against else 5.2, 3.9)
    panels: Any = figure.subplots(1, 2 if against else 1, squeeze=False)[0]
    axes = panels[0]
    if len(relative):
        edges = 10 ** np.arange(np.floor(np.log10(relative.min())), 1.1, 0.1)
        axes.hist(np.minimum(relative, edges[-1]), edges, color=style.BLUE)
        axes.set(xscale="log", yscale="log", ylim=(0.7, None))  # the few that differ most are seen
    else:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no run differs in t_r", transform=axes.transAxes, ha="center")
    total = found.row(runs)
    equal = f", {total['equal']:,} of them equally" if total["equal"] else ""
    axes.set(xlabel=DIFFERENCE, ylabel="runs")
    axes.set_title(f"{total['reversing']:,} runs reverse in both{equal}", fontsize="medium")
    if against:
        axes, y = panels[1], relative[error.index]
        bins = [10 ** np.linspace(*np.log10([0.7 * v.min(), 1.5 * v.max()]), 60) for v in (error, y)]
        counts, *_ = np.histogram2d(error, y, bins)
        shown = axes.pcolormesh(*bins, np.where(counts, counts, np.nan).T, norm=LogNorm(),
                                rasterized=True)  # fmt: skip
        figure.colorbar(shown, ax=axes, label="runs")
        axes.plot(bins[0], bins[0], **style.THEORY, scaley=False)
        axes.set(xscale="log", yscale="log", ylim=(bins[1][0], bins[1][-1]), ylabel=DIFFERENCE,
                 xlabel="both errors / $t_r$ (dashed: as large as the difference)")  # fmt: skip
        axes.set_title(f"{total['beyond']:,} runs beyond both errors", fontsize="medium")
    for axes in panels:
        style.light_grid(axes)
    words = " against ".join(str(side.directory) for side in found.sides)
    figure.suptitle(words, fontsize="medium").set_parse_math(False)
    return figure
