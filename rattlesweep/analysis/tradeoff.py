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
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from matplotlib.figure import Figure

from rattlesweep.analysis import style
from rattlesweep.arrays import Floats, Places, take
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import Batch, available_threads
from rattlesweep.integrate.compile import Kernel, load_kernel
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.integrate.task import Task, side_by_side
from rattlesweep.physics import full, theory
from rattlesweep.sweeps.block import compute, run_batch
from rattlesweep.sweeps.columns import runs_schema
from rattlesweep.sweeps.config.read import override_config, resolved
from rattlesweep.sweeps.config.schema import Config, SdSource
from rattlesweep.sweeps.files import probe_directory
from rattlesweep.sweeps.launches import Launches, make_batch, prepare, with_theory
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.provenance import machine, package_version

DEFAULT: dict[str, Any] = {
    "name": "tradeoff", "seed": 2017, "bodies": {"source": "sd"},
    "spin": {"n_i": [-0.1, -0.2, -0.3, -0.4, -0.5, 0.1, 0.2, 0.3, 0.4, 0.5],
             "omega_xy0": [0.001, 0.01, 0.1]},
    "horizon": {"t_rgh": 5, "t": 1e5},
}  # fmt: skip
"""The config of the command without one; also in ``configs/tradeoff.yaml``."""
# The references agree on a time to AGREE, and on the last spin of a run without one to AGREE_N: a
# tumbling body amplifies rounding, and whether it reverses one day is not for double precision.
AGREE, AGREE_N = 1e-8, 1e-6
WANTED = (1e-3, 1e-6, 1e-9, 1e-12)  # errors of t_r for which the cheapest setting is named
ROUNDS = 3  # measurements of each cost
HORIZON = 1000.0  # where runs are cut for the cost, in sqrt(a/g)
RK4_STAGES, DPI = 4, 150
COLUMNS = ("t_end", "t_r", "type", "status", "n_end", "energy_drift")
RESULTS = pa.schema([runs_schema().field(name) for name in COLUMNS])


# -- settings and runs ---------------------------------------------------------------------------


class Setting(NamedTuple):
    """A model, a method and its ``tol`` or ``dt``."""

    model: str
    method: str
    setting: str = "none"
    value: float = math.nan

    @property
    def name(self) -> str:
        """Method and setting, or the model where that says all."""
        method = "plain rk4" if self.method == "plain" else self.method
        return f"{method} {self.setting} {self.value:g}" if self.model == "full" else self.model


def tolerances(method: str, loosest: int, tightest: int) -> list[Setting]:
    """Return settings of an adaptive method, from 1e-`loosest` on."""
    powers = range(loosest, tightest + 1)
    return [Setting("full", method, "tol", float(f"1e-{k}")) for k in powers]


PLAIN = Setting("full", "plain", "dt", 0.002)
STEPS = (0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
ADAPTIVE = [*tolerances("dop853", 5, 12), *tolerances("verner98", 6, 12)]
REDUCED = Setting("reduced", "dop853", "tol", 1e-9)
CLOSED_FORM = Setting("gh", "none")
# Two methods that must agree.
REFERENCES = [Setting("full", method, "tol", 1e-13) for method in ("verner98", "dop853")]


@dataclass(frozen=True)
class Scope:
    """How much is measured."""

    settings: list[Setting]  # in the order of the table
    least: int = 2000  # runs to draw
    # Evaluations of the right-hand side to spend on the errors of a fixed step, which come from a
    # part of the runs where all would take more; a fifth of it on scalar RK4, a tenth on one cost.
    evaluations: float = 6e8


FULL = Scope(
    [PLAIN, *(Setting("full", "rk4", "dt", dt) for dt in STEPS), *tolerances("dopri5", 4, 9),
     *ADAPTIVE, REDUCED, CLOSED_FORM]
)  # fmt: skip
# A quick study needs no kernel but those of the references.
QUICK = Scope([PLAIN, *ADAPTIVE, CLOSED_FORM], least=300, evaluations=1e8)


def draw_runs(
    config: Config, base: Path | None, samples: int | None, least: int
) -> tuple[Config, Launches]:
    """Draw `samples` runs of each case, or so many that there are `least` runs, or all.

    Those without a horizon are left out.
    """
    data: dict[str, Any] = resolved(config) | {"record": [], "model": "full"}
    config = override_config(data, ["integrator={method: dop853}"])
    plan = make_plan(config, base)
    wanted = samples or -(-least // len(plan.cases))
    if isinstance(config.bodies, SdSource):
        config = override_config(resolved(config), [f"bodies.samples={wanted}"])
        plan = make_plan(config, base)
    count = min(wanted, plan.samples)
    picks = np.linspace(0, plan.samples - 1, count).astype(np.int64)
    case = np.repeat(np.arange(len(plan.cases)), len(picks))
    runs = prepare(plan, case, np.tile(picks, len(plan.cases)))
    return config, take(runs, np.isfinite(runs.t_end) & (runs.t_end > 0))


def with_setting(config: Config, setting: Setting) -> Config:
    """Return the config of one setting; of plain RK4 and the closed form the method is moot."""
    model, method, name, value = setting
    given = {"method": method, name: value} if method in METHODS else {}
    integrator = type(config.integrator).model_validate(given)
    return config.model_copy(update={"model": model, "integrator": integrator})


def solve(config: Config, setting: Setting, runs: Launches, threads: int = 1) -> pd.DataFrame:
    """Return the columns `RESULTS` of runs; ``t_r`` is NaN without a reversal."""
    batch = make_batch(runs, setting.model)
    if setting.method == "plain" and batch is not None:
        found = pd.DataFrame({"t_r": scalar_rk4(batch), "status": "ok"})
        return found.reindex(columns=RESULTS.names)
    own = with_setting(config, setting)
    work = Task(lambda control: compute(own, RESULTS, (runs, batch), threads, control))
    found = work.wait()[0].to_pandas()
    return found.assign(t_r=found["t_r"].where(found["status"] == "ok"))


# -- measuring -----------------------------------------------------------------------------------


class Study(NamedTuple):
    """What was measured: one row a setting, and what the rows rest on."""

    rows: pd.DataFrame
    facts: dict[str, Any]


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
    config, runs = draw_runs(config, base, samples, scope.least)
    calls = {setting: timed_call(config, setting, runs, scope) for setting in scope.settings}
    methods = dict.fromkeys(f"{setting.model} {setting.method}" for setting in calls)
    report(f"kernels, compiled where this machine has them not yet: {', '.join(methods)}")
    side_by_side([lambda _, call=call: call() for call in calls.values()], available_threads())
    report("references")
    reference = make_reference(config, runs, threads)
    if not reference["both"].any():
        raise ConfigError(
            "no run of this config reverses by its horizon, so there is no error of t_r to "
            "measure; choose other spins or a longer horizon"
        )
    spent: dict[Setting, list[float]] = {setting: [] for setting in calls}
    for r in range(ROUNDS):
        report(f"costs, round {r + 1} of {ROUNDS}")
        for setting, call in calls.items():
            before = time.process_time()
            units = call()
            spent[setting].append(1e6 * (time.process_time() - before) / units)
    cost = {setting: statistics.median(found) for setting, found in spent.items()}
    rows = []
    for setting in scope.settings:
        report(f"errors of {setting.name}")
        index = affordable(setting, reference["t_end"].to_numpy(), scope)
        own = reference.iloc[index].reset_index(drop=True)
        found = solve(config, setting, take(runs, index), threads)
        rows.append(
            {"name": setting.name, **setting._asdict(), "us_per_unit": cost[setting],
             "speedup": cost.get(PLAIN, math.nan) / cost[setting], "runs": len(own),
             "reversing": int(own["both"].sum()), **errors(found, own)}
        )  # fmt: skip
    apart = reference["apart"].dropna()
    facts = {
        "config": config.name,
        "runs": len(reference),
        "reversing_in_both": len(apart),
        "compared": int(reference["both"].sum()),
        "dropped": int((~reference["both"] & ~reference["neither"]).sum()),
        "references_differ_median": float(apart.median()),
        "references_differ_p99": float(apart.quantile(0.99)),
    }
    return Study(pd.DataFrame(rows), facts)


def make_reference(config: Config, runs: Launches, threads: int = 1) -> pd.DataFrame:
    """Integrate runs with two methods at a tight tolerance.

    Returns the columns of the first, with ``apart`` (relative difference of both times), ``both``
    (both reverse at the same time) and ``neither`` (none does, and both end alike).
    """
    one, other = (solve(config, setting, runs, threads) for setting in REFERENCES)
    apart = (one["t_r"] / other["t_r"] - 1).abs()
    none = one["t_r"].isna() & other["t_r"].isna() & (one["type"] == other["type"])
    none &= (one["n_end"] - other["n_end"]).abs() <= AGREE_N * np.abs(runs.n_i)
    return one.assign(apart=apart, both=apart < AGREE, neither=none)


def timed_call(
    config: Config, setting: Setting, runs: Launches, scope: Scope
) -> Callable[[], float]:
    """Return what is timed: a call that returns the units of time of all runs together."""
    batch, plain = make_batch(runs, setting.model), setting.method == "plain"
    own, horizon = with_setting(config, setting), np.full(len(runs.n_i), HORIZON)
    if setting.setting == "dt":
        # Steps of one size cost the same anywhere: shorter runs tell as much.
        most = (0.03 if plain else 0.1) * scope.evaluations
        horizon = np.minimum(horizon, most * setting.value / RK4_STAGES / len(horizon))
    t_end = np.minimum(runs.t_end, horizon)
    cut = None if batch is None else replace(batch, t_end=t_end)

    def call() -> float:
        if cut is None:
            b = runs.bodies
            modes = theory.modes(b.alpha, b.beta, b.theta, b.phi, b.xi)
            with_theory(runs.case, runs.sample, b, runs.n_i, runs.omega_xy0, runs.psi, modes,
                        config.horizon)  # fmt: skip
            return float(np.fmin(runs.gh.t_rgh, t_end).sum())
        if plain:
            return float(np.fmin(scalar_rk4(cut), t_end).sum())
        # In a thread of its own, so that Ctrl-C is heard.
        work = Task(lambda control: run_batch(own, cut, threads=1, control=control))
        return float(work.wait().t_end.sum())

    return call


def affordable(setting: Setting, t_end: Floats, scope: Scope) -> Places:
    """Return places of runs for the errors: of a fixed step as many as one can afford."""
    every = np.arange(len(t_end))
    if setting.setting != "dt":
        return every
    most = scope.evaluations / 5 if setting.method == "plain" else scope.evaluations
    price = np.maximum(t_end, 1.0) * RK4_STAGES / setting.value
    if price.sum() <= most:
        return every
    # A run that is long beside the rest would be integrated alone, in one lane of many.
    order = np.random.default_rng(0).permutation(np.flatnonzero(price <= most / 200))
    return np.sort(order[np.cumsum(price[order]) <= most])


def errors(found: pd.DataFrame, reference: pd.DataFrame) -> dict[str, Any]:
    """Return how well runs came out; a reversal that is missing is an infinite error.

    ``missed`` are reversals of the reference that are not found, ``false`` those found where the
    reference has none, ``type_flips`` the share of runs with another type.
    """
    both, neither, ok = reference["both"], reference["neither"], found["status"] == "ok"
    error = (found["t_r"] / reference["t_r"] - 1).abs().fillna(np.inf)[both]
    # Scalar RK4 sees no oscillation and so knows no types.
    known = (both | neither) & found["type"].notna().any()
    return {
        # No interpolation: half of infinity is no error.
        "error_median": error.quantile(0.5, interpolation="higher"),
        "error_p99": error.quantile(0.99, interpolation="higher"),
        "share_above_1e_6": (error > 1e-6).mean(),
        "missed": int((found["t_r"].isna() & both & ok).sum()),
        "false": int((found["t_r"].notna() & neither).sum()),
        "type_flips": (found["type"] != reference["type"])[known].mean(),
        "energy_drift_median": found["energy_drift"].where(ok).abs().median(),
        "failed": int((~ok).sum()),
    }


# -- scalar RK4, one run after another, as one would write it first: the yardstick of speed --------


@full.scalar
def _moved(y, h, k):  # type: ignore[no-untyped-def]
    """Return ``y + h k``, component by component."""
    return (y[0] + h * k[0], y[1] + h * k[1], y[2] + h * k[2], y[3] + h * k[3], y[4] + h * k[4])


@full.scalar
def rk4_step(y, body, dt):  # type: ignore[no-untyped-def]
    """Return the state after one step of the classical method; `y` and `body` are tuples."""
    k1 = full.rhs(*(y + body))
    k2 = full.rhs(*(_moved(y, dt / 2, k1) + body))
    k3 = full.rhs(*(_moved(y, dt / 2, k2) + body))
    k4 = full.rhs(*(_moved(y, dt, k3) + body))
    slope = _moved(_moved(k1, 2.0, _moved(k2, 1.0, k3)), 1.0, k4)
    return _moved(y, dt / 6, slope)


def _reversals(y0, constants, t_end, dt, t_r):  # type: ignore[no-untyped-def]
    for k in range(len(y0)):
        p, q, a, b, c = y0[k]
        ix, iy, iz, cxx, cxy, cyy = constants[k]
        y, body = (p, q, a, b, c), (ix, iy, iz, cxx, cxy, cyy)
        n = full.spin(*y)
        t_r[k] = np.nan
        for step in range(int(np.ceil(t_end[k] / dt))):
            y = rk4_step(y, body, dt)
            n1 = full.spin(*y)
            if n * n1 <= 0:
                t_r[k] = (step + n / (n - n1)) * dt
                break
            n = n1


def reversals() -> Kernel:
    """Return the loop over runs, to be compiled."""
    arguments = np.zeros((0, 5)), np.zeros((0, 6)), np.zeros(0), 0.0, np.zeros(0)
    options = {"fastmath": full.FASTMATH, "error_model": "numpy", "nogil": True}
    return Kernel(_reversals, arguments, options, (__file__,))


def scalar_rk4(batch: Batch) -> Floats:
    """Return times of reversal, NaN for none, from the package's own equations of motion.

    The spin's sign is looked at once a step and its zero interpolated linearly; nothing else is
    observed.
    """
    t_r = np.empty(len(batch))
    state, constants = map(np.ascontiguousarray, (batch.y0, batch.constants))
    load_kernel(reversals)(state, constants, batch.t_end, PLAIN.value, t_r)
    return t_r


# -- table and figure ----------------------------------------------------------------------------


def cheapest(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the cheapest settings at some errors, by their median and for 99 % of the runs."""
    found = []
    for error in WANTED:
        entry: dict[str, Any] = {"error": error}
        for word in ("median", "p99"):
            good = rows[rows[f"error_{word}"] <= error].nsmallest(1, "us_per_unit")
            entry[word] = None if good.empty else good["name"].item()
            entry[f"{word}_us_per_unit"] = None if good.empty else good["us_per_unit"].item()
        found.append(entry)
    return found


def as_text(study: Study) -> str:
    """Return everything that was measured, to be read."""
    here = machine()
    shown = study.rows.drop(columns=["model", "method", "setting", "value", "reversing"])
    return "\n".join([
        f"{here['cpu']}, {here['processors']} processors, {here['system']}, Python "
        f"{platform.python_version()}, rattlesweep {package_version()}",
        "{runs} runs, {reversing_in_both} with a reversal in both references; {compared} of them "
        "agree to 1e-8; {dropped} are left out, as the references do not agree; these differ by "
        "{references_differ_median:.1e} (median)".format(**study.facts),
        f"costs on one thread, of runs cut at t = {HORIZON:g}",
        "",
        style.text_table(shown.to_dict("records"), ".3g"),
        "",
        "cheapest setting by the error of t_r",
        style.text_table(cheapest(study.rows), ".3g"),
    ])  # fmt: skip


def as_data(study: Study) -> dict[str, Any]:
    """Return the same as JSON can hold it."""
    rows = study.rows.astype(object).replace([np.nan, np.inf], None)
    return {
        "machine": machine() | {"python": platform.python_version()},
        "rattlesweep": package_version(),
        "facts": study.facts,
        "rows": rows.to_dict("records"),
        "cheapest": cheapest(study.rows),
    }


def save(study: Study, directory: Path) -> list[Path]:
    """Write ``tradeoff.parquet``, ``.svg`` and ``.png``, each in one step; return their paths."""
    probe_directory(directory)
    table, *pictures = (directory / f"tradeoff.{kind}" for kind in ("parquet", "svg", "png"))
    style.save_table(study.rows, table)
    with style.styled():
        figure = draw(study.rows)
        style.add_caption(
            figure,
            "Markers are medians of the runs, lines lead to 99 % of them: {runs} runs of {config}, "
            "{compared} with a sure reversal; ".format(**study.facts)
            + f"{machine()['cpu']}, rattlesweep {package_version()}.",
        )
        style.save(figure, pictures, DPI)
    return [table, *pictures]


def draw(rows: pd.DataFrame) -> Figure:
    """Draw cost against error: the median as markers, and a line to the 99th percentile."""
    figure = style.new_figure(8.4, 5.6)
    axes = figure.subplots()
    looks = iter(style.SERIES)
    series = rows["method"].where((rows["model"] == "full") & (rows["method"] != "plain"), "")
    for method, own in rows[rows["error_median"].between(0, math.inf, "neither")].groupby(
        series, sort=False
    ):
        colour, marker = next(looks) if method else (style.GREY, "o")
        axes.plot(own["error_median"], own["us_per_unit"], color=colour, marker=marker, zorder=3,
                  linestyle="-" if method else "none", label=method)  # fmt: skip
        far = own[np.isfinite(own["error_p99"])]
        axes.hlines(far["us_per_unit"], far["error_median"], far["error_p99"], color=colour,
                    alpha=0.35)  # fmt: skip
        # Labels of the second curve stand below it, as it runs along the first.
        below = marker == style.SERIES[0][1] and bool(method)
        for row in own.itertuples():
            value = f"{'' if row.setting == 'tol' else 'dt '}{row.value:g}"
            axes.annotate(value if method else row.name, (row.error_median, row.us_per_unit),
                          xytext=(-5, -12) if below else (5, 5), fontsize=7.5, color=colour,
                          textcoords="offset points", ha="right" if below else "left",
                          zorder=4)  # fmt: skip
    axes.set(xscale="log", yscale="log", ylabel="cost of a run (µs per unit of time)",
             xlabel="relative error of $t_r$")  # fmt: skip
    style.light_grid(axes)
    axes.legend(loc="upper right")
    return figure
