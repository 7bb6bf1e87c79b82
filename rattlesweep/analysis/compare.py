"""The differences between two directories of the same runs, or of two models."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rattlesweep.analysis import room, style
from rattlesweep.config.read import differences, fixed_part, resolved
from rattlesweep.design.cases import Case
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.rows.types import TYPES
from rattlesweep.store.rows import Stored, open_stored
from rattlesweep.words.errors import ConfigError, OutputError, printable
from rattlesweep.words.quantities import INITIAL_RATES

MOST_LISTED = 10
# Keys of a config that determine the motion of a body after its launch.
PHYSICS = ("model", "dissipation", "base")
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
    written as JSON: differing settings, counts in all and by case, types against types,
    the runs that differ most.

    If the model, the dissipation or the base differs, the differences are those of
    models: ``data["of_models"]`` is true, and nothing is said to be beyond errors.
    Runs are then those of equal bodies and launches, and ``case_b`` is the case in `b`.
    """

    runs: pd.DataFrame
    data: dict[str, Any]

    def __repr__(self) -> str:
        return comparison_text(self, 20)

    def disagree(self, allowed: float) -> bool:
        """Return whether too many times differ beyond their errors, or a sure type."""
        if self.data["of_models"]:
            return False
        total = self.data["total"]
        beyond = total["beyond"] or 0
        return bool(beyond > allowed * total["reversing"] or total["types_sure"])


def compare(a: Path, b: Path) -> Comparison:
    """Compare the runs of two directories: other tolerances, machines or models."""
    stored_a = open_stored(a)
    stored_b = open_stored(b)
    of_models = _physics(stored_a) != _physics(stored_b)
    has_errors = all("t_r_error" in x.schema.names for x in (stored_a, stored_b))
    # Errors of the integration say nothing of the differences of models.
    has_errors = has_errors and not of_models
    names = ["case", "sample", *_RUN, "t_r", "type", "status"]
    if has_errors:
        names += ["t_r_error", "type_sure"]
    missing = []
    frames = []
    for stored in (stored_a, stored_b):
        frame = stored.read(names).to_pandas()
        if frame.empty:
            raise OutputError(f"{stored.directory} holds no runs yet")
        frames.append(frame)
        missing.append(len(stored.cases) * stored.samples - len(frame))
    wrong = differences(_same_runs(stored_a), _same_runs(stored_b))[:3]
    cases_a = stored_a.cases
    cases_b = stored_b.cases
    if of_models:
        cases_a = _without_actions(cases_a)
        cases_b = _without_actions(cases_b)
    matches = [cases_a.index(case) if case in cases_a else -1 for case in cases_b]
    if of_models and (-1 in matches or len({*cases_a}) < len(cases_a)):
        wrong.append(
            "each launch of the second needs one case in the first, without a list of "
            "dissipation or base"
        )
    if not wrong and max(matches) < 0:
        wrong.append(f"no case is in both, such as {cases_a[0]} and {cases_b[0]}")
    if wrong:
        matches = list(range(len(cases_b)))
    frames[1]["case_b"] = frames[1]["case"]
    # Cases that only the second has are -1, which no run of the first is.
    frames[1]["case"] = np.array(matches)[frames[1]["case"]]
    runs = frames[0].merge(frames[1], on=["case", "sample"], suffixes=("_a", "_b"))
    if not wrong:
        wrong = _differing_inputs(runs)
    if wrong:
        raise ConfigError(
            f"{b}: its runs are not those of {a} ({'; '.join(wrong)}); only "
            "directories of the same runs can be compared"
        )
    if not has_errors:
        runs[["t_r_error_a", "t_r_error_b", "type_sure_a", "type_sure_b"]] = np.nan
    _add_differences(runs)
    differing = runs[runs.differs | (runs.relative > 0)]
    differing = differing.sort_values(
        ["differs", "over_errors", "relative"], ascending=False
    )
    listed = differing[_LISTED].head(MOST_LISTED).astype(object)
    cases = []
    for case in sorted(set(runs["case_b"])):
        counts = _counted(runs[runs["case_b"] == case], has_errors, of_models)
        cases.append(stored_b.cases[case].dump() | counts)
    return Comparison(
        runs,
        {
            "directories": [str(a), str(b)],
            "of_models": of_models,
            "differ": differences(_settings(stored_a), _settings(stored_b)),
            "planned": [len(x.cases) * x.samples for x in (stored_a, stored_b)],
            "missing": missing,
            "total": _counted(runs, has_errors, of_models),
            "types": _types_against_types(runs),
            "cases": cases,
            "differing": listed.replace([np.nan, np.inf], None).to_dict("records"),
        },
    )


def _differing_inputs(runs: pd.DataFrame) -> list[str]:
    """Return the first run of each parameter that differs, and drop the parameters."""
    differing = []
    for name in _RUN:
        x = runs.pop(f"{name}_a").to_numpy(float)
        y = runs.pop(f"{name}_b").to_numpy(float)
        equal = np.isclose(x, y, rtol=1e-9, atol=1e-12, equal_nan=True)
        for k in np.flatnonzero(~equal)[:1]:
            differing.append(
                f"case {runs['case'][k]}, sample {runs['sample'][k]}: {name}: "
                f"{x[k]:.10g} against {y[k]:.10g}"
            )
    return differing


def _add_differences(runs: pd.DataFrame) -> None:
    """Add the columns of a comparison."""
    ok = (runs.status_a == "ok") & (runs.status_b == "ok")
    dt_r = (runs.t_r_b - runs.t_r_a).where(ok)
    runs["dt_r"] = dt_r
    runs["relative"] = dt_r.abs() / ((runs.t_r_a + runs.t_r_b) / 2)
    # With errors of 0, any difference is beyond them, but equal times are not.
    error = np.hypot(runs.t_r_error_a.to_numpy(), runs.t_r_error_b.to_numpy())
    runs["over_errors"] = (dt_r.abs() / error).mask((error == 0) & (dt_r == 0), 0.0)
    runs["differs"] = ok & (runs.type_a != runs.type_b)
    runs["not_ok"] = ~ok
    runs["sure"] = runs.type_sure_a.eq(True) & runs.type_sure_b.eq(True)


def _types_against_types(runs: pd.DataFrame) -> dict[str, dict[str, int]]:
    """Return how many runs have each pair of types, by the first and the second."""
    ok = runs[~runs["not_ok"]]
    pairs = ok.groupby(["type_a", "type_b"]).size()
    counts: dict[str, dict[str, int]] = {}
    for first in TYPES:
        row = {second: int(pairs.get((first, second), 0)) for second in TYPES}
        if any(row.values()):
            counts[first] = row
    return counts


def _counted(
    runs: pd.DataFrame, has_errors: bool, of_models: bool
) -> dict[str, int | float | None]:
    """Return the counts and quantiles of some runs."""
    relative = runs["relative"].dropna()
    counts: dict[str, int | float | None] = {
        "runs": len(runs),
        "reversing": len(relative),
        "equal": int((relative == 0).sum()),
    }
    for name, level in (("median", 0.5), ("p99", 0.99), ("worst", 1.0)):
        counts[name] = None
        if len(relative):
            quantile = np.quantile(relative, level, method="inverted_cdf")
            counts[name] = float(quantile)
    if of_models:
        ratio = (runs["t_r_b"] / runs["t_r_a"])[runs["dt_r"].notna()]
        for name, level in (("ratio_p5", 5), ("ratio_median", 50), ("ratio_p95", 95)):
            counts[name] = float(np.percentile(ratio, level)) if len(ratio) else None
    # The order of the keys is that of the table.
    counts |= {"beyond": None, "types": int(runs["differs"].sum()), "types_sure": None}
    if has_errors:
        counts["beyond"] = int((runs["over_errors"] > 1).sum())
        counts["types_sure"] = int((runs["differs"] & runs["sure"]).sum())
    return counts | {"failed": int(runs["not_ok"].sum())}


def _same_runs(side: Stored) -> dict[str, object]:
    """Return what determines the runs, however they are integrated."""
    how = ("integrator", "record", "classify", *PHYSICS)
    data = {k: v for k, v in fixed_part(side.config).items() if k not in how}
    # A table may have moved; its content is compared row by row.
    data["bodies"] = {k: v for k, v in data["bodies"].items() if k != "path"}
    # A sweep that has grown has the runs of the smaller one, and more.
    return data


def _physics(side: Stored) -> dict[str, object]:
    """Return what determines the motion of a body after its launch."""
    config = resolved(side.config)
    return {name: config.get(name) for name in PHYSICS}


def _without_actions(cases: Sequence[Case]) -> tuple[Case, ...]:
    """Return the targets and launches of cases, without what acts on the bodies."""
    return tuple(
        replace(
            case,
            losses=(),
            in_si=tuple(of for of in case.in_si if of[0] in INITIAL_RATES),
        )
        for case in cases
    )


def _settings(side: Stored) -> dict[str, object]:
    """Return the settings that may explain differences."""
    config = resolved(side.config)
    manifest = side.manifest
    return {
        **_physics(side),
        "integrator": config["integrator"],
        "record": config["record"],
        "classify": side.thresholds.model_dump(mode="json"),
        "versions": manifest["versions"],
        "cpu": manifest["machine"].get("cpu"),
    }


def comparison_text(comparison: Comparison, most_cases: int) -> str:
    """Return the comparison as text, with at most so many cases."""
    data = comparison.data
    lines = []
    for k, name in enumerate("AB"):
        state = f"all {data['planned'][k]:,} runs"
        if data["missing"][k]:
            state = f"{data['missing'][k]:,} of {data['planned'][k]:,} runs are missing"
        if data["total"]["runs"] < data["planned"][k] - data["missing"][k]:
            state += f", of which {data['total']['runs']:,} are in both"
        lines.append(printable(f"{name}  {data['directories'][k]}: {state}"))
    lines += [printable(f"   {difference}") for difference in data["differ"]]
    cases = data["cases"]
    rows = [*cases[:most_cases], {"case": "all"} | data["total"]]
    lines += ["", style.text_table(rows)]
    if len(cases) > most_cases:
        lines.append(f"{len(cases) - most_cases} more cases are in --json")
    if data["of_models"]:
        lines.append("the differences are those of the models, not errors of either")
        lines.append("\ntypes in A (rows) against types in B:")
        lines.append(_type_table(data["types"]))
    elif data["total"]["beyond"] is None:
        lines.append("no errors are stored; add record: [error]")
    if data["differing"]:
        lines += ["\nruns that differ most:", style.text_table(data["differing"])]
    return "\n".join(lines)


def _type_table(types: dict[str, dict[str, int]]) -> str:
    """Return the numbers of types against types, without types that do not occur."""
    seen = [name for name in TYPES if any(row[name] for row in types.values())]
    return style.text_table(
        [
            {"A": first, **{name: row[name] for name in seen}}
            for first, row in types.items()
        ]
    )


def save_comparison(comparison: Comparison, path: Path) -> None:
    """Write a histogram of the differences of t_r, over their errors if known."""
    total = comparison.data["total"]
    values = comparison.runs.over_errors
    below = "both errors"
    if total["beyond"] is None:
        values = comparison.runs.relative
        below = "$t_r$"
    of_models = comparison.data["of_models"]
    if of_models:
        values = (comparison.runs.t_r_b / comparison.runs.t_r_a).dropna()
    values = values[values.between(0, np.inf, inclusive="neither")]
    with style.styled():
        figure = room.usual_figure(5.2, 3.9)
        axes = figure.subplots()
        if len(values):
            bins = np.geomspace(values.min() / 2, 2 * values.max(), 60)
            axes.hist(values, bins.tolist(), color=style.BLUE)
            axes.set(xscale="log", yscale="log", ylim=(0.7, None))
        else:
            equal = (
                f"{total['equal']:,} of {total['reversing']:,} reversal times are equal"
            )
            axes.text(0.5, 0.5, equal, ha="center", transform=axes.transAxes)
            axes.set(xticks=[], yticks=[])
        axes.set(xlabel=rf"$|\Delta t_r|$ / {below}", ylabel="number of runs")
        if of_models:
            axes.axvline(1, **style.THEORY)
            axes.set_xlabel("$t_r$ of the second / $t_r$ of the first")
        style.light_grid(axes)
        directories = " against ".join(comparison.data["directories"])
        caption = (
            f"{directories}: {total['reversing']:,} runs reverse in both, "
            f"{total['equal']:,} of them at equal times."
        )
        if of_models:
            caption += " The differences are those of models, not errors."
        style.add_caption(figure, [caption])
        room.fit_to_size(figure)
        style.save_figure(figure, [path])
