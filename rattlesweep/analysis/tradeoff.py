"""Speed against accuracy, measured: methods, settings and models on the same runs.

The error of a reversal time is taken against two methods at a tight tolerance that agree on it. The
cost is processor time on one thread, medians of measurements that take turns; the runs are cut at a
common horizon for it, since the few longest would leave most lanes of a small batch empty, which a
sweep does not. benchmarks/single_precision.py says why single precision is no setting.
"""

from __future__ import annotations

import math
import platform
import statistics
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib.figure import Figure

from rattlesweep.analysis import style
from rattlesweep.analysis.scalar_rk4 import DT, scalar_rk4
from rattlesweep.arrays import Flags, Floats, Integers, Places, take
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import Batch, Control, available_threads
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.integrate.task import Task, side_by_side
from rattlesweep.physics import theory
from rattlesweep.sweeps.block import columns_of, load_kernel, run_batch
from rattlesweep.sweeps.columns import (
    F64,
    I64,
    TEXT,
    TIME,
    build_table,
    field,
    required,
    write_parquet,
)
from rattlesweep.sweeps.config.read import parse_config, resolved
from rattlesweep.sweeps.config.schema import Config, SdSource
from rattlesweep.sweeps.files import probe_directory
from rattlesweep.sweeps.launches import (
    Launches,
    full_batch,
    prepare,
    reduced_batch,
)
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.provenance import machine, package_version
from rattlesweep.text import align

DEFAULT: dict[str, Any] = {
    "name": "tradeoff",
    "seed": 2017,
    "bodies": {"source": "sd"},
    "spin": {
        "n_i": [-0.1, -0.2, -0.3, -0.4, -0.5, 0.1, 0.2, 0.3, 0.4, 0.5],
        "omega_xy0": [0.001, 0.01, 0.1],
    },
    "horizon": {"t_rgh": 5, "t": 1e5},
}
"""The config of the command without one; also in ``configs/tradeoff.yaml``."""
TOLERANCES: dict[str, tuple[float, ...]] = {
    "dopri5": (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9),
    "dop853": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12),
    "verner98": (1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12),
}
OTHER_TOLERANCES = (1e-6, 1e-8, 1e-10, 1e-12)
STEPS = (0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
# The references agree on a time to AGREE, and on the last spin of a run without one to AGREE_N: a
# tumbling body amplifies rounding, and whether it reverses one day is not for double precision.
AGREE, AGREE_N = 1e-8, 1e-6
# Errors of t_r for which the cheapest setting is named, and by which of the runs' errors.
WANTED = (1e-3, 1e-6, 1e-9, 1e-12)
QUANTILES = {"median": "error_median", "p99": "error_p99"}
_MISSED = "; a run without t_r counts as infinite, and null is infinite"
SCHEMA = pa.schema(
    [
        required("model", TEXT, "1", "full, reduced or gh"),
        required("method", TEXT, "1", "integrator; plain: scalar RK4, one run after another"),
        required("setting", TEXT, "1", "tol, dt, or none"),
        field("value", F64, "1", "value of the setting; dt in sqrt(a/g)"),
        required("runs", I64, "1", "runs integrated for the errors"),
        required("reversing", I64, "1", "runs among them whose reference reverses"),
        required("us_per_unit", F64, "us", f"cost on one thread for one run over one {TIME}"),
        field("speedup", F64, "1", "cost per unit of plain over that of this row"),
        field("error_median", F64, "1", "median of abs(t_r/t_ref - 1)" + _MISSED),
        field("error_p99", F64, "1", "99th percentile of the same" + _MISSED),
        field("share_above_1e_6", F64, "1", "fraction of runs off by over 1e-6, or without t_r"),
        required("missed", I64, "1", "runs with a reversal in the reference and none here"),
        required("false", I64, "1", "runs with a reversal here and none in the reference"),
        field("type_flips", F64, "1", "fraction of runs with another type"),
        field("energy_drift_median", F64, "1", "median change of energy, relative"),
        required("failed", I64, "1", "runs with a status other than ok"),
    ]
)  # fmt: skip


# -- settings and runs ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """A model, a method and its setting."""

    model: str
    method: str
    name: str = "none"
    value: float = float("nan")

    @property
    def integrator(self) -> dict[str, Any]:
        """The part of a config."""
        return {} if self.method == "none" else {"method": self.method, self.name: self.value}

    @property
    def stages(self) -> int:
        """Evaluations of the right-hand side in a step."""
        return METHODS["rk4" if self.method == "plain" else self.method].stages


# Two methods that must agree.
REFERENCES = tuple(Setting("full", method, "tol", 1e-13) for method in ("verner98", "dop853"))
PLAIN = Setting("full", "plain", "dt", DT)
REDUCED = Setting("reduced", "dop853", "tol", 1e-9)
CLOSED_FORM = Setting("gh", "none")


def settings(methods: Collection[str]) -> list[Setting]:
    """Return the settings of some methods, by their order."""
    found = []
    for name in sorted(methods, key=lambda name: METHODS[name].order):
        key = "tol" if METHODS[name].adaptive else "dt"
        values = TOLERANCES.get(name, OTHER_TOLERANCES) if key == "tol" else STEPS
        found += [Setting("full", name, key, value) for value in values]
    return found


@dataclass(frozen=True)
class Scope:
    """How much is measured."""

    settings: tuple[Setting, ...]  # in the order of the table
    references: tuple[Setting, ...] = REFERENCES
    least: int = 2000  # runs to draw
    rounds: int = 3  # measurements of each cost
    horizon: float = 1000.0  # where runs are cut for the cost, in sqrt(a/g)
    # Evaluations of the right-hand side to spend on the errors of one setting, which come from a
    # part of the runs where all would take more; a fifth of it on scalar RK4, a tenth on one cost.
    stages: float = 6e8


FULL = Scope((PLAIN, *settings(METHODS), REDUCED, CLOSED_FORM))
# A quick study needs no kernel but those of the references.
QUICK = Scope(
    (PLAIN, *settings([s.method for s in REFERENCES]), CLOSED_FORM),
    least=300, rounds=2, horizon=500.0, stages=1e8,
)  # fmt: skip


@dataclass(frozen=True)
class Solution:
    """What a setting makes of some runs; arrays over runs, times in ``sqrt(a/g)``."""

    t_r: Floats  # first zero of the spin; NaN without one
    t_end: Floats  # time reached
    types: Integers  # places in TYPES; -1 where not ok, -2 where a method knows no types
    ok: Flags  # whether the status is ok
    n_end: Floats  # spin at t_end
    drift: Floats  # relative change of energy
    tries: float  # steps tried in all, accepted or not


@dataclass(frozen=True)
class Runs:
    """Runs of a config, ready for every model."""

    config: Config
    launches: Launches

    def __len__(self) -> int:
        return len(self.launches.n_i)

    @cached_property
    def bounded(self) -> Places:
        """Places of the runs that have a horizon to be integrated to."""
        t_end = self.launches.t_end
        return np.flatnonzero(np.isfinite(t_end) & (t_end > 0))

    @cached_property
    def _batches(self) -> dict[str, Batch]:
        return {"full": full_batch(self.launches), "reduced": reduced_batch(self.launches)}

    def batch(self, setting: Setting, index: Places) -> Batch | None:
        """Return some of the runs as the model takes them; None: it is a formula."""
        return None if setting.model == "gh" else take(self._batches[setting.model], index)

    def load(self, setting: Setting, _: Control | None = None) -> None:
        """Load the kernel, compiled if need be."""
        if setting.method == "plain":
            scalar_rk4(take(self._batches["full"], np.empty(0, np.intp)))
        else:
            load_kernel(self._config(setting))

    def solve(
        self, setting: Setting, index: Places, batch: Batch | None = None, *, threads: int = 1
    ) -> Solution:
        """Solve some of the runs by a setting; `batch` is theirs, with the horizons wanted."""
        batch = self.batch(setting, index) if batch is None else batch
        nothing = np.full(len(index), np.nan)
        if setting.method == "plain" and batch is not None:
            # It sees no oscillation and so knows no types.
            t_r = scalar_rk4(batch)
            t_end = np.where(np.isnan(t_r), batch.t_end, t_r)
            ok, tries = np.ones(len(batch), dtype=bool), float(t_end.sum()) / setting.value
            none = np.full(len(batch), -2)
            return Solution(t_r, t_end, none, ok, nothing, nothing, tries)
        config, outcome = self._config(setting), None
        if batch is not None:
            work = batch
            # In a thread of its own, so that Ctrl-C is heard.
            outcome = Task(
                lambda control: run_batch(config, work, threads=threads, control=control)
            ).wait()
        columns = columns_of(config, take(self.launches, index), batch, outcome)
        ok = columns["status"][0] == Status.OK
        tries = 0 if outcome is None else (outcome.n_steps + outcome.n_rejected).sum()
        return Solution(
            t_r=np.where(ok, columns["t_r"], np.nan),
            t_end=columns["t_end"],
            types=columns["type"][0],
            ok=ok,
            n_end=columns["n_end"],
            drift=nothing if outcome is None else np.abs(outcome.energy_drift),
            tries=float(tries),
        )

    def _config(self, setting: Setting) -> Config:
        integrator = type(self.config.integrator).model_validate(setting.integrator)
        return self.config.model_copy(
            update={"model": setting.model, "integrator": integrator, "record": []}
        )


def draw_runs(config: Config, base: Path | None, *, samples: int | None, least: int) -> Runs:
    """Draw `samples` runs of each case, or so many that there are `least` runs, or all."""
    data: dict[str, Any] = resolved(config) | {"record": [], "model": "full"}
    config = parse_config(data, ["integrator={method: dop853}"])
    plan = make_plan(config, base)
    wanted = samples or -(-least // len(plan.cases))
    if isinstance(config.bodies, SdSource):
        config = parse_config(resolved(config), [f"bodies.samples={wanted}"])
        plan = make_plan(config, base)
    count = min(wanted, plan.samples)
    picks = np.unique(np.linspace(0, plan.samples - 1, count).round().astype(np.int64))
    case = np.repeat(np.arange(len(plan.cases)), len(picks))
    return Runs(config, prepare(plan, case, np.tile(picks, len(plan.cases))))


# -- measuring -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Reference:
    """What the runs come to by two methods at a tight tolerance."""

    solution: Solution  # of the first method
    both: Flags  # both have a reversal, and agree on its time
    neither: Flags  # neither has one, and both give the same type and last spin
    apart: Floats  # relative difference of the times of each run with a reversal in both


@dataclass(frozen=True)
class Study:
    """What was measured on the runs of a config."""

    name: str  # of the config
    rows: pd.DataFrame  # one row a setting, with the columns of `SCHEMA`
    facts: dict[str, Any]  # what the rows rest on


def measure(
    config: Config,
    base: Path | None = None,
    *,
    samples: int | None = None,
    scope: Scope = FULL,
    threads: int = 1,
    report: Callable[[str], None] = lambda text: None,
) -> Study:
    """Measure cost and error of every setting on the runs of :func:`draw_runs`.

    `threads` are those for the errors; `report` is called with what is about to be done.
    """
    begin = time.perf_counter()
    runs = draw_runs(config, base, samples=samples, least=scope.least)
    kernels = {f"{s.model} {s.method}": s for s in (*scope.references, *scope.settings)
               if s.model != "gh"}  # fmt: skip
    report(f"kernels, compiled where this machine has them not yet: {', '.join(kernels)}")
    side_by_side([partial(runs.load, each) for each in kernels.values()], available_threads())
    report("references")
    reference = make_reference(runs, scope.references, threads)
    if not reference.both.any():
        raise ConfigError(
            "no run of this config reverses by its horizon, so there is no error of t_r to "
            "measure; choose other spins or a longer horizon"
        )
    lived = np.minimum(reference.solution.t_end, scope.horizon)
    mean = float(lived[runs.bounded].mean())

    # Processor time of every setting: medians over rounds in which all take their turn. A first
    # call, which is not timed, counts steps and units of time.
    report("steps of every setting")
    calls = {setting: _timed_call(runs, setting, mean, scope) for setting in scope.settings}
    counts = {setting: call() for setting, call in calls.items()}
    spent: dict[Setting, list[float]] = {setting: [] for setting in calls}
    for r in range(scope.rounds):
        report(f"costs, round {r + 1} of {scope.rounds}")
        for setting, call in calls.items():
            before = time.process_time()
            call()
            spent[setting].append(time.process_time() - before)
    seconds = {s: statistics.median(spent[s]) / units for s, (_, units) in counts.items()}

    rows = []
    for setting, (tries, units) in counts.items():
        report(f"errors of {setting.model}, {setting.method} {setting.name} {setting.value:g}")
        index = _affordable(runs, reference, setting, tries / units, scope)
        found = runs.solve(setting, index, threads=threads)
        rows.append(
            {
                "model": setting.model, "method": setting.method, "setting": setting.name,
                "value": setting.value, "runs": len(index),
                "reversing": int(reference.both[index].sum()),
                "us_per_unit": 1e6 * seconds[setting],
                "speedup": seconds.get(PLAIN, np.nan) / seconds[setting],
                **errors(found, reference, index),
            }
        )  # fmt: skip
    apart = reference.apart
    facts = {
        "runs": len(runs),
        "reversing_in_both": len(apart),
        "compared": int(reference.both.sum()),
        "dropped": int((~reference.both & ~reference.neither).sum()),
        "references_differ_median": float(np.median(apart)),
        "references_differ_p99": float(np.quantile(apart, 0.99)),
        "units": float(reference.solution.t_end.sum()),
        "timing_horizon": scope.horizon,
        "seconds": time.perf_counter() - begin,
    }
    return Study(runs.config.name, pd.DataFrame(rows), facts)


def make_reference(runs: Runs, settings: tuple[Setting, ...], threads: int) -> Reference:
    """Integrate the runs with two methods at a tight tolerance."""
    every = np.arange(len(runs))
    one, other = (runs.solve(setting, every, threads=threads) for setting in settings)
    reversal = np.isfinite(one.t_r) & np.isfinite(other.t_r)
    apart = np.abs(one.t_r / other.t_r - 1)
    none = np.isnan(one.t_r) & np.isnan(other.t_r) & one.ok & other.ok
    none &= np.abs(one.n_end - other.n_end) <= AGREE_N * np.abs(runs.launches.n_i)
    both, neither = reversal & (apart < AGREE), none & (one.types == other.types)
    return Reference(one, both, neither, apart[reversal])


def _timed_call(
    runs: Runs, setting: Setting, mean: float, scope: Scope
) -> Callable[[], tuple[float, float]]:
    """Return what is timed: it gives the steps tried, and the runs' units of time together."""
    batch = runs.batch(setting, runs.bounded)
    if batch is None:
        la, b = runs.launches, runs.launches.bodies

        def closed_form() -> tuple[float, float]:
            modes = theory.modes(b.alpha, b.beta, b.theta, b.phi, b.xi)
            theory.garcia_hubbard(b, modes, la.n_i, la.omega_xy0, la.psi).t_rgh.sum()
            return 0.0, len(runs) * mean

        return closed_form
    horizon = scope.horizon
    if setting.name == "dt":
        # Steps of one size cost the same anywhere: shorter runs tell as much.
        share = 0.03 if setting.method == "plain" else 0.1
        horizon = min(horizon, share * scope.stages * setting.value / setting.stages / len(batch))
    cut = replace(batch, t_end=np.minimum(batch.t_end, horizon))

    def call() -> tuple[float, float]:
        found = runs.solve(setting, runs.bounded, cut)
        return found.tries, float(found.t_end.sum())

    return call


def _affordable(
    runs: Runs, reference: Reference, setting: Setting, tries: float, scope: Scope
) -> Places:
    """Return runs for the errors, as many as `tries` steps a unit of time let one afford."""
    good = runs.bounded
    if setting.model != "full":
        return good
    most = scope.stages / 5 if setting.method == "plain" else scope.stages
    price = np.maximum(reference.solution.t_end[good], 1.0) * tries * setting.stages
    if price.sum() <= most:
        return good
    # A run that is long beside the rest would be integrated alone, in one lane of many.
    order = np.random.default_rng(0).permutation(np.flatnonzero(price <= most / 200))
    return np.sort(good[order[np.cumsum(price[order]) <= most]])


def errors(found: Solution, reference: Reference, index: Places) -> dict[str, Any]:
    """Return the columns of a row that say how well the runs `index` came out."""
    both, neither = reference.both[index], reference.neither[index]
    error = np.abs(found.t_r / reference.solution.t_r[index] - 1)[both]
    error = np.where(np.isfinite(error), error, np.inf)
    # No interpolation: half of infinity is no error.
    median, p99 = (
        np.quantile(error, (0.5, 0.99), method="inverted_cdf") if len(error) else [np.nan] * 2
    )
    known = (both | neither) & (found.types > -2)
    flips = found.types[known] != reference.solution.types[index][known]
    drift = found.drift[found.ok & np.isfinite(found.drift)]

    def mean(values: Any) -> float:
        return float(values.mean()) if len(values) else np.nan

    return {
        "error_median": float(median),
        "error_p99": float(p99),
        "share_above_1e_6": mean(error > 1e-6),
        "missed": int((np.isnan(found.t_r) & both & found.ok).sum()),
        "false": int((np.isfinite(found.t_r) & neither).sum()),
        "type_flips": mean(flips),
        "energy_drift_median": float(np.median(drift)) if len(drift) else np.nan,
        "failed": int((~found.ok).sum()),
    }


# -- table and figure ----------------------------------------------------------------------------


def row_name(row: Any) -> str:
    """Return method and setting of a row, or the model where that says all."""
    if row.model != "full":
        return str(row.model)
    word = "plain rk4" if row.method == "plain" else row.method
    return f"{word} {row.setting} {number(row.value)}"


def number(value: float) -> str:
    """Return the short form of a setting or an error, two digits: ``1e-9``, ``0.05``."""
    if not math.isfinite(value):
        return "-"
    if value >= 1e-3:
        return f"{value:.2g}"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def _percent(value: float) -> str:
    return "-" if math.isnan(value) else f"{100 * value:.2f} %"


def cheapest(rows: pd.DataFrame, error: float, quantile: str) -> Any:
    """Return the row of the cheapest setting whose `quantile` of errors is small enough."""
    good = rows[rows[quantile] <= error].nsmallest(1, "us_per_unit")
    return next(good.itertuples(), None)


def advice(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the cheapest settings at some errors, by median and for 99 % of the runs."""
    found = []
    for error in WANTED:
        entry: dict[str, Any] = {"error": error}
        for word, quantile in QUANTILES.items():
            row = cheapest(rows, error, quantile)
            entry[word] = None if row is None else row_name(row)
            entry[f"{word}_us_per_unit"] = None if row is None else row.us_per_unit
        found.append(entry)
    return found


def as_text(study: Study) -> str:
    """Return everything that was measured, to be read."""
    rows, f, here = study.rows, study.facts, machine()
    shown = pd.DataFrame({
        "setting": [row_name(row) for row in rows.itertuples()],
        "us a unit": rows.us_per_unit.map("{:.3g}".format),
        "faster than plain": rows.speedup.map("{:.3g}".format),
        "median error": rows.error_median.map(number),
        "of 99 %": rows.error_p99.map(number),
        "> 1e-6": rows.share_above_1e_6.map(_percent),
        "other type": rows.type_flips.map(_percent),
        "energy drift": rows.energy_drift_median.map(number),
        **rows[["missed", "false", "failed", "runs"]].astype(str),
    })  # fmt: skip
    best = [["error of t_r", "median", "us a unit", "99 % of runs", "us a unit"]]
    for entry in advice(rows):
        error, *rest = entry.values()
        best.append([number(error), *("none" if x is None else x if isinstance(x, str)
                                      else f"{x:.3g}" for x in rest)])  # fmt: skip
    return "\n".join([
        f"{here['cpu']}, {here['processors']} processors, {here['system']}, Python "
        f"{platform.python_version()}, rattlesweep {package_version()}",
        f"{f['runs']} runs, {f['reversing_in_both']} with a reversal in both references; "
        f"{f['compared']} of them agree to 1e-8; {f['dropped']} are left out, as the references do "
        f"not agree; these differ by {f['references_differ_median']:.1e} (median)",
        f"costs on one thread, of runs cut at t = {f['timing_horizon']:g}",
        "",
        align([[*map(str, shown)], *shown.to_numpy().tolist()], "<>"),
        "",
        "cheapest setting",
        align(best, "<"),
    ])  # fmt: skip


def as_data(study: Study) -> dict[str, Any]:
    """Return the same as JSON can hold it."""
    rows = [
        {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}
        for row in study.rows.to_dict("records")
    ]
    return {
        "machine": machine() | {"python": platform.python_version()},
        "rattlesweep": package_version(),
        "facts": study.facts,
        "rows": rows,
        "cheapest": advice(study.rows),
    }


WIDTH, HEIGHT, DPI = 8.4, 5.6, 150
# Settings that stand alone: plain RK4, and models without the full dynamics.
SINGLES = {"plain": "plain scalar rk4, dt 0.002", "reduced": "reduced", "gh": "gh"}


def save(study: Study, directory: Path) -> list[Path]:
    """Write ``tradeoff.parquet``, ``.svg`` and ``.png``, each in one step; return their paths."""
    probe_directory(directory)
    table, *pictures = (directory / f"tradeoff.{kind}" for kind in ("parquet", "svg", "png"))
    columns = {name: study.rows[name].to_numpy() for name in SCHEMA.names}
    write_parquet(build_table(columns, SCHEMA), table)
    caption = (
        f"Markers are medians of the runs, lines lead to 99 % of them: {study.facts['runs']} runs "
        f"of {study.name}, {study.facts['compared']} with a sure reversal; {machine()['cpu']}, "
        f"rattlesweep {package_version()}."
    )
    with style.styled():
        style.save(draw(study.rows, caption), pictures, DPI)
    return [table, *pictures]


def draw(rows: pd.DataFrame, caption: str = "") -> Figure:
    """Draw cost against error: the median as markers, and a line to the 99th percentile."""
    figure = style.new_figure(WIDTH, HEIGHT)
    axes = figure.subplots()
    looks = iter(style.SERIES * len(rows))
    for series, own in rows.groupby(
        rows.method.where(rows.model == "full", rows.model), sort=False
    ):
        word = SINGLES.get(str(series))
        own = own[np.isfinite(own.error_median) & (own.error_median > 0)]
        if own.empty:
            continue
        colour, marker = (style.GREY, "o") if word else next(looks)
        axes.plot(own.error_median, own.us_per_unit, color=colour, marker=marker, zorder=3,
                  linestyle="none" if word else "-", label=None if word else series)  # fmt: skip
        far = own[np.isfinite(own.error_p99)]
        axes.hlines(far.us_per_unit, far.error_median, far.error_p99, color=colour, alpha=0.35)
        above = bool(word) or marker != "o"
        for row in own.itertuples():
            value = f"{'' if row.setting == 'tol' else 'dt '}{number(row.value)}"
            axes.annotate(word or value, (row.error_median, row.us_per_unit), color=colour,
                          xytext=(5, 5) if above else (-5, -12), fontsize=7.5, zorder=4,
                          textcoords="offset points", ha="left" if above else "right",
                          )  # fmt: skip
    axes.set(xscale="log", yscale="log", ylabel="cost of a run (µs per unit of time)",
             xlabel="relative error of $t_r$")  # fmt: skip
    style.light_grid(axes)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="upper right")
    style.add_caption(figure, caption)
    return figure
