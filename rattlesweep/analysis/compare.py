"""The differences between two directories of the same runs: numbers, text and a
figure.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rattlesweep.analysis import style
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.sweeps.config.read import differences, fixed_part, resolved
from rattlesweep.sweeps.stored import Stored, open_stored

MOST_LISTED = 10
# Columns that identify a run; their last digits may differ between machines.
_RUN = [*PARAMETERS, "n_i", "omega_xy0"]
_LISTED = [
    "case",
    "sample",
    "type_a",
    "type_b",
    "t_r_a",
    "t_r_b",
    "relative",
    "over_errors",
    "type_sure_a",
    "type_sure_b",
]


@dataclass
class Comparison:
    """The differences between two directories of the same runs.

    `runs` has a row for each run that is in both: the columns of each directory with
    the suffixes ``_a`` and ``_b``; ``dt_r``, the difference of the times; ``relative``,
    its size over their mean; ``over_errors``, its size over both errors added in
    quadrature; ``differs`` and ``sure`` of the types; ``not_ok``.  `data` can be
    written as JSON: differing settings, counts in all and by case, the runs that differ
    most.
    """

    runs: pd.DataFrame
    data: dict[str, Any]

    def __repr__(self) -> str:
        return as_text(self, 20)

    def disagree(self, allowed: float) -> bool:
        """Return whether too many runs differ beyond their errors, or sure types
        differ.
        """
        total = self.data["total"]
        return bool(
            (total["beyond"] or 0) > allowed * total["reversing"] or total["types_sure"]
        )


def compare(a: Path, b: Path) -> Comparison:
    """Compare the runs of two directories whose configs differ only in how to
    integrate.
    """
    sides = open_stored(a), open_stored(b)
    wrong = differences(*map(_same_runs, sides))[:3]
    errors = all("t_r_error" in side.schema.names for side in sides)
    names = ["case", "sample", *_RUN, "t_r", "type", "status"]
    names += ["t_r_error", "type_sure"] if errors else []
    frames = [side.read(names).to_pandas() for side in sides]
    if empty := [
        side for side, frame in zip(sides, frames, strict=True) if frame.empty
    ]:
        raise OutputError(f"{empty[0].directory} holds no runs yet")
    runs = frames[0].merge(frames[1], on=["case", "sample"], suffixes=("_a", "_b"))
    for name in _RUN if not wrong else ():
        x, y = (runs.pop(f"{name}_{side}").to_numpy(float) for side in "ab")
        for k in np.flatnonzero(
            ~np.isclose(x, y, rtol=1e-9, atol=1e-12, equal_nan=True)
        )[:1]:
            where = f"case {runs['case'][k]}, sample {runs['sample'][k]}"
            wrong.append(f"{where}: {name}: {x[k]:.10g} against {y[k]:.10g}")
    if wrong:
        raise ConfigError(
            f"{b}: its runs are not those of {a} ({'; '.join(wrong)}); only "
            "directories of the same runs can be compared"
        )
    if not errors:
        runs[["t_r_error_a", "t_r_error_b", "type_sure_a", "type_sure_b"]] = np.nan
    ok = (runs.status_a == "ok") & (runs.status_b == "ok")
    runs["dt_r"] = dt_r = (runs.t_r_b - runs.t_r_a).where(ok)
    runs["relative"] = dt_r.abs() / ((runs.t_r_a + runs.t_r_b) / 2)
    # With errors of 0, any difference is beyond them, but equal times are not.
    error = np.hypot(runs.t_r_error_a, runs.t_r_error_b)
    runs["over_errors"] = (dt_r.abs() / error).mask((error == 0) & (dt_r == 0), 0.0)
    runs["differs"], runs["not_ok"] = ok & (runs.type_a != runs.type_b), ~ok
    runs["sure"] = runs.type_sure_a.eq(True) & runs.type_sure_b.eq(True)
    most = runs[runs.differs | (runs.relative > 0)]
    most = most.sort_values(["differs", "over_errors", "relative"], ascending=False)
    listed = (
        most[_LISTED].head(MOST_LISTED).astype(object).replace([np.nan, np.inf], None)
    )
    planned = [len(side.cases) * side.samples for side in sides]
    return Comparison(
        runs,
        {
            "directories": [str(a), str(b)],
            "differ": differences(*map(_settings, sides)),
            "planned": planned,
            "missing": [
                n - len(frame) for n, frame in zip(planned, frames, strict=True)
            ],
            "total": _counted(runs, errors),
            "cases": [
                sides[0].cases[case].dump()
                | _counted(runs[runs["case"] == case], errors)
                for case in sorted(set(runs["case"]))
            ],
            "differing": listed.to_dict("records"),
        },
    )


def _counted(runs: pd.DataFrame, errors: bool) -> dict[str, Any]:
    relative = runs["relative"].dropna()
    quantiles = {"median": 0.5, "p99": 0.99, "worst": 1.0}
    return {
        "runs": len(runs),
        "reversing": len(relative),
        "equal": int((relative == 0).sum()),
        **{
            name: float(np.quantile(relative, q, method="inverted_cdf"))
            if len(relative)
            else None
            for name, q in quantiles.items()
        },
        "beyond": int((runs["over_errors"] > 1).sum()) if errors else None,
        "types": int(runs["differs"].sum()),
        "types_sure": int((runs["differs"] & runs["sure"]).sum()) if errors else None,
        "failed": int(runs["not_ok"].sum()),
    }


def _same_runs(side: Stored) -> dict[str, Any]:
    """Return the part of the config that determines the runs, however they are
    integrated.
    """
    how = ("integrator", "record", "classify")
    data = {k: v for k, v in fixed_part(side.config).items() if k not in how}
    # A table may have moved; its content is compared row by row.
    data["bodies"] = {k: v for k, v in data["bodies"].items() if k != "path"}
    return data | {"cases": [str(case) for case in side.cases], "samples": side.samples}


def _settings(side: Stored) -> dict[str, Any]:
    """Return the settings that may explain differences."""
    config, manifest = resolved(side.config), side.manifest
    return {
        "integrator": config["integrator"],
        "record": config["record"],
        "classify": side.thresholds.model_dump(mode="json"),
        "versions": manifest["versions"],
        "cpu": manifest["machine"].get("cpu"),
    }


def as_text(found: Comparison, most_cases: int) -> str:
    """Return the comparison as text, with at most so many cases."""
    data, lines = found.data, []
    for k, name in enumerate("AB"):
        runs, missing = f"{data['planned'][k]:,} runs", data["missing"][k]
        some = f"{missing:,} of {runs} are missing" if missing else f"all {runs}"
        lines.append(f"{name}  {data['directories'][k]}: {some}")
    lines += [f"   {words}" for words in data["differ"]]
    cases = data["cases"]
    lines += [
        "",
        style.text_table([*cases[:most_cases], {"case": "all"} | data["total"]]),
    ]
    lines += [f"{len(cases) - most_cases} more cases are in --json"] * (
        len(cases) > most_cases
    )
    lines += ["no errors are stored; add record: [error]"] * (
        data["total"]["beyond"] is None
    )
    if data["differing"]:
        lines += ["\nruns that differ most:", style.text_table(data["differing"])]
    return "\n".join(lines)


def save(found: Comparison, path: Path) -> None:
    """Write a histogram of the differences of t_r, relative to their errors if these
    are known.
    """
    total, runs = found.data["total"], found.runs
    errors = total["beyond"] is not None
    values, below = (
        (runs.over_errors, "both errors") if errors else (runs.relative, "$t_r$")
    )
    values = values[values.between(0, np.inf, inclusive="neither")]
    with style.styled():
        figure = style.new_figure(5.2, 3.9)
        axes: Any = figure.subplots()
        if len(values):
            bins = np.geomspace(values.min() / 2, 2 * values.max(), 60)
            axes.hist(values, bins, color=style.BLUE)
            axes.set(xscale="log", yscale="log", ylim=(0.7, None))
        else:
            told = (
                f"{total['equal']:,} of {total['reversing']:,} reversal times are equal"
            )
            axes.text(0.5, 0.5, told, ha="center", transform=axes.transAxes)
            axes.set(xticks=[], yticks=[])
        axes.set(xlabel=rf"$|\Delta t_r|$ / {below}", ylabel="number of runs")
        style.light_grid(axes)
        words = (
            f"{' against '.join(found.data['directories'])}: {total['reversing']:,} runs "
            f"reverse in both, {total['equal']:,} of them at equal times."
        )
        style.add_caption(figure, words)
        style.save(figure, [path])
