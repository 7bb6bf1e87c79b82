"""Measure the cost and the accuracy of methods, settings and models on the same runs.

The error of a reversal time refers to two methods at a tight tolerance that agree on
it. The cost is the median processor time of several rounds on one thread. For it, runs
end at a common horizon: the few longest would otherwise leave most lanes of a small
batch empty.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib.figure import Figure

from rattlesweep.analysis import room, style
from rattlesweep.arrays import take
from rattlesweep.config.body_sources import SdSource
from rattlesweep.config.read import parse_config, resolved
from rattlesweep.config.schema import Config
from rattlesweep.design.batches import make_batch
from rattlesweep.design.plan import make_plan
from rattlesweep.design.prepare import prepare_launches
from rattlesweep.kernel.task import Control, Task, side_by_side
from rattlesweep.kernel.threads import available_threads
from rattlesweep.rows.columns import runs_schema
from rattlesweep.rows.prepared import PreparedRuns
from rattlesweep.store.provenance import machine
from rattlesweep.system.files import probe_directory
from rattlesweep.words.errors import ConfigError
from rattlesweep.work.block import compute

DEFAULT: dict[str, object] = {
    "name": "tradeoff",
    "seed": 2017,
    "bodies": {"source": "sd"},
    "spin": {
        "n_i": [-0.1, -0.2, -0.3, -0.4, -0.5, 0.1, 0.2, 0.3, 0.4, 0.5],
        "omega_xy0": [0.001, 0.01, 0.1],
    },
    "horizon": {"t_rgh": 5, "t": 1e5},
}
"""The config that the command uses by default; also in ``configs/tradeoff.yaml``."""
AGREE = 1e-8  # relative difference up to which the references agree on a reversal time
# The same for the last spin of a run without a reversal.  A tumbling body amplifies
# rounding errors, and double precision cannot decide whether it will reverse one day.
AGREE_N = 1e-6
# Errors of t_r for which the cheapest setting is named.
WANTED = (1e-3, 1e-6, 1e-9, 1e-12)
ADVISED = 1e-6  # error, one of these, for which the text names an integrator
_ROUNDS = 3  # measurements of each cost
_HORIZON = 1000.0  # end of the runs whose cost is measured, in sqrt(a/g)
_SHORT = 0.2  # the cost of fixed steps below this is measured on shorter runs
FEWER = 0.02  # the errors of fixed steps below this are measured on fewer runs
_COLUMNS = ("t_end", "t_r", "type", "status", "n_end", "energy_drift")
_RESULTS = pa.schema([runs_schema().field(name) for name in _COLUMNS])


class MethodSetting(NamedTuple):
    """A model and a method with its ``tol`` or ``dt``."""

    model: str
    method: str
    setting: str = "none"
    value: float = math.nan

    @property
    def name(self) -> str:
        """The method and its setting; the model if it is not the full one."""
        if self.model == "full":
            return f"{self.method} {self.setting} {self.value:g}"
        return self.model


def _settings(method: str, name: str, *values: float) -> list[MethodSetting]:
    return [MethodSetting("full", method, name, value) for value in values]


# Two methods that must agree on a reversal time.
REFERENCES = [
    MethodSetting("full", method, "tol", 1e-13) for method in ("verner98", "dop853")
]
PAPER = MethodSetting("full", "rk4", "dt", 0.002)
QUICK_SETTINGS = [
    PAPER,
    *_settings("dop853", "tol", 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12),
    *_settings("verner98", "tol", 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12),
    MethodSetting("gh", "none"),
]
FULL_SETTINGS = [
    *_settings("rk4", "dt", 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.001),
    *_settings("dopri5", "tol", 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9),
    MethodSetting("reduced", "dop853", "tol", 1e-9),
    *QUICK_SETTINGS,
]
"""The settings to measure: all of them, or those of ``--quick``."""


def draw_runs(
    config: Config, base: Path | None, samples: int | None, least: int
) -> tuple[Config, PreparedRuns]:
    """Draw `samples` runs of each case that have an end, or at least `least` in all."""
    data = resolved(config) | {"record": [], "model": "full"}
    config = parse_config(data, ["integrator={method: dop853}"])
    plan = make_plan(config, base)
    wanted = samples or -(-least // len(plan.cases))
    if isinstance(config.bodies, SdSource):
        config = parse_config(resolved(config), [f"bodies.samples={wanted}"])
        plan = make_plan(config, base)
    count = min(wanted, plan.samples)
    picks = np.linspace(0, plan.samples - 1, count).astype(np.int64)
    case, sample = np.meshgrid(np.arange(len(plan.cases)), picks, indexing="ij")
    runs = prepare_launches(plan, case.ravel(), sample.ravel())
    return config, take(runs, np.isfinite(runs.horizon) & (runs.horizon > 0))


def _solve(
    config: Config,
    setting: MethodSetting,
    runs: PreparedRuns,
    threads: int = 1,
    horizon: float = math.inf,
) -> pd.DataFrame:
    """Integrate runs up to `horizon` at most, and return the columns of `_RESULTS`.

    ``t_r`` is NaN without a reversal.
    """
    batch = make_batch(runs, setting.model)
    keys: dict[str, str | float] = {}
    if batch is not None:
        batch = replace(batch, t_end=np.minimum(batch.t_end, horizon))
        keys = {"method": setting.method, setting.setting: setting.value}
    integrator = type(config.integrator).model_validate(keys)
    changed = config.model_copy(
        update={"model": setting.model, "integrator": integrator}
    )
    # Only the main thread receives Ctrl-C, so the work is done by another.
    work = Task(
        lambda control: compute(changed, _RESULTS, (runs, batch), threads, control)
    )
    results: pd.DataFrame = work.wait().to_pandas()
    return results.assign(t_r=results["t_r"].where(results["status"] == "ok"))


class Study(NamedTuple):
    """The measurements: a row for each setting, and facts about runs and machine."""

    rows: pd.DataFrame
    facts: dict[str, Any]


def measure(
    config: Config,
    base: Path | None = None,
    *,
    settings: Sequence[MethodSetting] = FULL_SETTINGS,
    samples: int | None = None,
    least: int = 2000,
    threads: int = 1,
    report: Callable[[str], None] = lambda text: None,
) -> Study:
    """Measure settings on the runs of :func:`draw_runs`.

    `threads` applies to the errors only; costs are measured on one thread.
    """
    config, runs = draw_runs(config, base, samples, least)
    calls = [partial(_units, config, runs, setting) for setting in settings]
    report("kernels, compiled if they are not in the cache")
    # One call for each kernel, so that no two compile the same one.
    kernels = {}
    for setting, call in zip(settings, calls, strict=True):
        kernels[setting.model, setting.method] = call
    side_by_side(list(kernels.values()), available_threads())
    report("references")
    reference = make_reference(config, runs, threads)
    if not reference["both"].any():
        raise ConfigError(
            "no run of this config reverses by its horizon, so the error of t_r "
            "cannot be measured; choose other spins or a longer horizon"
        )
    spent = np.zeros((_ROUNDS, len(calls)))
    for r, k in np.ndindex(spent.shape):
        report(f"costs, round {r + 1} of {_ROUNDS}")
        before = time.process_time()
        units = calls[k]()
        spent[r, k] = 1e6 * (time.process_time() - before) / units
    cost = dict(zip(settings, np.median(spent, axis=0).tolist(), strict=True))
    rows = []
    for setting in settings:
        report(f"errors of {setting.name}")
        stride = 1
        if setting.setting == "dt":
            stride = max(1, round(FEWER / setting.value))
        index = np.arange(0, len(reference), stride)
        exact = reference.iloc[index].reset_index(drop=True)
        results = _solve(config, setting, take(runs, index), threads)
        rows.append(
            {
                "name": setting.name,
                **setting._asdict(),
                "us_per_unit": cost[setting],
                "speedup": cost.get(PAPER, math.nan) / cost[setting],
                "runs": len(exact),
                "reversing": int(exact["both"].sum()),
                **errors(results, exact),
            }
        )
    apart = reference["apart"].dropna()
    table = pd.DataFrame(rows)
    here = machine()
    facts = {
        "config": config.name,
        "rattlesweep": version("rattlesweep"),
        "machine": f"{here['cpu']}, {here['processors']} processors, {here['system']}",
        "runs": len(reference),
        "reversing_in_both": len(apart),
        "compared": int(reference["both"].sum()),
        "dropped": int((~reference["both"] & ~reference["neither"]).sum()),
        "references_differ_median": float(apart.median()),
        "references_differ_p99": float(apart.quantile(0.99)),
        "cheapest": cheapest(table),
    }
    return Study(table, facts)


def _units(
    config: Config, runs: PreparedRuns, setting: MethodSetting, _: Control | None = None
) -> float:
    """Integrate runs on one thread, and return the sum of their durations."""
    horizon = _HORIZON
    if setting.setting == "dt":
        # Equal steps cost the same at any time, so shorter runs measure as well.
        horizon *= setting.value / _SHORT
    results = _solve(config, setting, runs, horizon=horizon)
    return float(results["t_end"].clip(upper=_HORIZON).sum())


def make_reference(
    config: Config, runs: PreparedRuns, threads: int = 1
) -> pd.DataFrame:
    """Return the columns of a reference, and where both or neither of two reverse."""
    first, second = (_solve(config, setting, runs, threads) for setting in REFERENCES)
    apart = (first["t_r"] / second["t_r"] - 1).abs()
    neither = first["t_r"].isna() & second["t_r"].isna()
    neither &= first["type"] == second["type"]
    last_apart = (first["n_end"] - second["n_end"]).abs()
    neither &= last_apart <= AGREE_N * np.abs(runs.n_i)
    return first.assign(apart=apart, both=apart < AGREE, neither=neither)


def errors(results: pd.DataFrame, reference: pd.DataFrame) -> dict[str, object]:
    """Return the errors of runs as numbers; a missed reversal is an infinite error."""
    both = reference["both"]
    neither = reference["neither"]
    ok = results["status"] == "ok"
    error = (results["t_r"] / reference["t_r"] - 1).abs().fillna(np.inf)[both]
    known = both | neither
    return {
        # Do not interpolate: one end may be infinite.
        "error_median": error.quantile(0.5, interpolation="higher"),
        "error_p99": error.quantile(0.99, interpolation="higher"),
        "share_above_1e_6": (error > 1e-6).mean(),
        "missed": int((results["t_r"].isna() & both & ok).sum()),
        "false": int((results["t_r"].notna() & neither).sum()),
        "type_flips": (results["type"] != reference["type"])[known].mean(),
        "energy_drift_median": results["energy_drift"].where(ok).abs().median(),
        "failed": int((~ok).sum()),
    }


def cheapest(rows: pd.DataFrame) -> list[dict[str, object]]:
    """Return the cheapest setting for each error in `WANTED`, as median and of 99 %."""
    table = []
    for error in WANTED:
        row: dict[str, object] = {"error": error}
        for statistic in ("median", "p99"):
            row[statistic] = None
            row[f"{statistic}_us_per_unit"] = None
            good = rows[rows[f"error_{statistic}"] <= error]
            for best in good.nsmallest(1, "us_per_unit").itertuples():
                row[statistic] = best.name
                row[f"{statistic}_us_per_unit"] = best.us_per_unit
        table.append(row)
    return table


def tradeoff_text(study: Study) -> str:
    """Return the measurements as text."""
    hidden = ["model", "method", "setting", "value", "reversing"]
    rows = study.rows.drop(columns=hidden).to_dict("records")
    return "\n".join(
        [
            "{machine}, rattlesweep {rattlesweep}\n"
            "{runs} runs, {reversing_in_both} with a reversal in both references; "
            "{compared} of them agree to 1e-8; {dropped} are left out, as the "
            "references do not agree; these differ by "
            "{references_differ_median:.1e} (median)\n"
            "costs on one thread, of runs cut at t = {horizon:g}\n".format(
                horizon=_HORIZON, **study.facts
            ),
            style.text_table(rows, ".3g"),
            "\ncheapest setting by the error of t_r",
            style.text_table(study.facts["cheapest"], ".3g"),
            f"\n{_advice(study)}",
        ]
    )


def _advice(study: Study) -> str:
    """Return the integrator to write in a config, in one line."""
    [row] = [row for row in study.facts["cheapest"] if row["error"] == ADVISED]
    goal = f"for 99 % of the runs below {ADVISED:g}:".replace("e-0", "e-")
    if row["p99"] is None:
        return (
            f"{goal} no setting of this study; try {{accuracy: {{t_r: {ADVISED:g}}}}}"
        )
    best = study.rows[study.rows["name"] == row["p99"]].iloc[0]
    value = f"{best['value']:g}".replace("e-0", "e-")
    if best["model"] != "full":
        return f"{goal} model: {best['model']}"
    return f"{goal} {{method: {best['method']}, {best['setting']}: {value}}}"


def as_data(study: Study) -> dict[str, object]:
    """Return the measurements as plain data."""
    return {"facts": study.facts, "rows": study.rows.to_dict("records")}


def save_tradeoff(study: Study, directory: Path) -> list[Path]:
    """Write ``tradeoff.parquet``, ``.svg`` and ``.png``, and return their paths."""
    probe_directory(directory)
    table = directory / "tradeoff.parquet"
    pictures = [directory / f"tradeoff.{kind}" for kind in ("svg", "png")]
    style.save_table(study.rows, table)
    with style.styled():
        figure = _draw(study.rows)
        style.add_caption(
            figure,
            [
                "Markers: median error; lines: up to the error that 99 % of the runs "
                "keep. {runs} runs of {config}, {compared} with a sure reversal; "
                "{machine}, rattlesweep {rattlesweep}.".format(**study.facts)
            ],
        )
        style.save_figure(figure, pictures)
    return [table, *pictures]


def _draw(rows: pd.DataFrame) -> Figure:
    """Draw the cost against the median error, with a line to its 99th percentile."""
    figure = room.usual_figure(8.4, 5.6)
    axes = figure.subplots()
    looks = iter(style.SERIES)
    known = rows[rows["error_median"].between(0, math.inf, "neither")]
    known = known.sort_values("us_per_unit")
    series = known["method"].where(known["model"] == "full", known["model"])
    for name, points in known.groupby(series, sort=False):
        # The other models are single points.
        is_curve = bool((points["model"] == "full").all())
        colour = style.GREY
        marker = "o"
        if is_curve:
            colour, marker = next(looks)
        axes.plot(
            points["error_median"],
            points["us_per_unit"],
            color=colour,
            marker=marker,
            zorder=3,
            label=name if is_curve else None,
        )
        far = points["error_p99"].replace(np.inf, np.nan)
        axes.hlines(
            points["us_per_unit"], points["error_median"], far, color=colour, alpha=0.35
        )
        # The curves of orders 8 and 9 nearly coincide, so their labels are on different
        # sides.
        shift = (5, 5)
        side = "left"
        if name == "verner98":
            shift = (-5, -12)
            side = "right"
        for row in points.itertuples():
            text = f"{row.value:g}".replace("e-0", "e-")
            if not is_curve:
                text = str(name)
            elif row.setting == "dt":
                text = f"dt {text}"
            axes.annotate(
                text,
                (row.error_median, row.us_per_unit),
                shift,
                color=colour,
                ha=side,
                textcoords="offset points",
                fontsize=7.5,
            )
    axes.set(
        xscale="log",
        yscale="log",
        ylabel="cost of a run (µs per unit of time)",
        xlabel="relative error of $t_r$",
    )
    axes.margins(x=0.1)  # for the labels of the most accurate settings
    style.light_grid(axes)
    axes.legend(loc="upper right")
    return figure
