"""Behind Fig. 6: the paper's integrator, other readings of its words, how much SS bears."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pyarrow as pa

from rattlesweep.paper.sweeps import LAUNCH, bodies_of, horizons, part
from rattlesweep.sweeps.config.schema import Integrator
from rattlesweep.sweeps.tables.columns import RATE, TIME

if TYPE_CHECKING:
    from rattlesweep.paper.sweeps import Place, Report, Sweep
    from rattlesweep.sweeps.config.schema import Classify, Config

# Two times of reversal are the same if they differ by less than this, relatively.
SAME = 1e-6
REFERENCE_TOL = 1e-12
RESULTS = ("t_r", "type", "amp_growth", "n_departure")


def column(name: str, kind: pa.DataType, words: str, unit: str = "1") -> pa.Field:
    """A field of a table with its unit and a description."""
    return pa.field(name, kind, metadata={"unit": unit, "description": words})


F64, I64, TEXT = pa.float64(), pa.int64(), pa.string()

# ------------------------------------------------------------------ the paper's integrator

RK4 = pa.schema(
    [
        column("K_r", F64, "target of the torque coefficient"),
        column("n_i", F64, "initial spin", RATE),
        column("omega_xy0", F64, "initial rate of the oscillation", RATE),
        column("sample", I64, "number of the run within its case"),
        column("type", TEXT, "with the sweep's own integrator"),
        column("type_rk4", TEXT, "with fourth-order Runge-Kutta"),
        column("t_r", F64, "time of reversal with the sweep's own integrator", TIME),
        column("t_r_rk4", F64, "time of reversal with fourth-order Runge-Kutta", TIME),
        column("t_r_reference", F64, "at tol 1e-12, for the exceptions only", TIME),
        column("difference", F64, "t_r_rk4 / t_r - 1"),
        column("exception", TEXT, "why they differ; null where they do not"),
    ]
)


def rk4(place: Place, sweep: Sweep, report: Report) -> pa.Table:
    """The first samples of every case with RK4: one row a run, exceptions with their cause."""
    settings = place.paper.fig6.rk4
    chosen = []
    for case, runs in sweep.cases((*LAUNCH, "sample", "t_rgh", *RESULTS)):
        assert case.target is not None
        if case.target >= settings.least_K_r:
            first = runs[runs["sample"] < settings.samples]
            chosen.append(first.assign(K_r=case.target))
    if not chosen or not sum(map(len, chosen)):
        return RK4.empty_table()
    ours = pd.concat(chosen, ignore_index=True)
    config = sweep.plan.config
    method = Integrator(method="rk4", dt=settings.dt)
    theirs = again(place, "rk4", config, method, ours, part(report, 0.0, 0.97))
    table = ours[["K_r", "n_i", "omega_xy0", "sample", "type", "t_r"]].assign(
        type_rk4=theirs["type"], t_r_rk4=theirs["t_r"]
    )
    table["difference"] = table["t_r_rk4"] / table["t_r"] - 1
    both = table["t_r"].notna() & table["t_r_rk4"].notna()
    odd = (table["type"] != table["type_rk4"]) | (both & (table["difference"].abs() > SAME))
    reference = np.full(len(table), np.nan)
    causes = np.full(len(table), None, dtype=object)
    places = np.flatnonzero(odd.to_numpy())
    if len(places):
        third = Integrator(method="dop853", tol=REFERENCE_TOL)
        few, report = ours.iloc[places], part(report, 0.97, 1.0)
        exact = again(place, "rk4-exceptions", config, third, few, report)
        reference[places] = exact["t_r"].to_numpy(dtype=float)
        trios = (few, theirs.iloc[places], exact)
        causes[places] = [
            cause(one, other, judge, config.classify)
            for one, other, judge in zip(*(f.to_dict("records") for f in trios), strict=True)
        ]
    table = table.assign(t_r_reference=reference, exception=causes)
    return pa.Table.from_pandas(table[RK4.names], schema=RK4, preserve_index=False)


def again(
    place: Place,
    name: str,
    config: Config,
    integrator: Integrator,
    runs: pd.DataFrame,
    report: Report,
) -> pd.DataFrame:
    """Integrate runs of the sweep once more; one row a run, in their order, NaN where it failed."""
    changed = config.model_copy(update={"name": name, "integrator": integrator, "block_size": 1000})
    table = bodies_of(runs, horizons(config, runs["t_rgh"].to_numpy(dtype=float)))
    found = place.derived(name, changed, report, table)
    frames = [frame for _, frame in found.cases(("sample", *RESULTS))]
    return frames[0].set_index("sample").reindex(range(len(runs))).set_axis(runs.index)


def cause(
    ours: dict[str, Any], rk4: dict[str, Any], exact: dict[str, Any], thresholds: Classify
) -> str:
    """Why two integrators part on a run, judged by a third one that is far more accurate."""
    if not isinstance(rk4["type"], str):
        return "RK4 gave no result: its status is not ok"
    if ours["type"] != rk4["type"]:
        for name, border in (
            ("amp_growth", thresholds.ss_growth),
            ("n_departure", thresholds.sw_departure),
        ):
            sides = [run[name] for run in (ours, rk4)]
            if min(sides) <= border < max(sides) and max(sides) - min(sides) < 0.1 * border:
                return f"threshold: {name} is {sides[0]:.6g} and {sides[1]:.6g} beside {border:g}"
    if same(exact, rk4):
        return "the sweep's tolerance: at tol 1e-12 it is as with RK4"
    if same(exact, ours):
        return "RK4's step: at tol 1e-12 it is as in the sweep"
    return "chaotic: at tol 1e-12 it is a third one; rounding decides"


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two integrations of a run agree on its type and its time of reversal."""
    if one["type"] != other["type"]:
        return False
    return one["type"] != "R" or bool(abs(one["t_r"] / other["t_r"] - 1) <= SAME)


# ------------------------------------------------------------------ other readings of "SS"

DEFINITIONS = pa.schema(
    [
        column("n_i", F64, "initial spin", RATE),
        column("omega_xy0", F64, "initial rate of the oscillation", RATE),
        column("definition", TEXT, "what is counted as SS"),
        column("count", I64, "runs that it takes for SS"),
        column("runs", I64, "runs with status ok"),
    ]
)
GROWTHS = (0.01, 0.1, 0.3)
DEPARTURES = (0.01, 0.02, 0.05)


def definitions(sweep: Sweep) -> pa.Table:
    """How many runs count as SS by several readings of "decays monotonously"."""
    counts: dict[tuple[float, float, str], int] = {}
    totals: dict[tuple[float, float], int] = {}
    for case, runs in sweep.cases(("n_c1", "n_i", "type", "amp_growth", "n_departure", "t_r")):
        assert case.n_i is not None
        assert case.omega_xy0 is not None
        key = (case.n_i, case.omega_xy0)
        stays = runs["t_r"].isna()
        past = runs["n_c1"].abs() < runs["n_i"].abs()
        readings = {"type SS (amplitude never grows by more than the threshold)":
                    runs["type"] == "SS"}  # fmt: skip
        for limit in GROWTHS:
            readings[f"amplitude never grows by more than {limit:.0%}"] = stays & (
                runs["amp_growth"] <= limit
            )
        for limit in DEPARTURES:
            readings[f"no reversal, spin never falls by more than {limit:.0%}"] = stays & (
                runs["n_departure"] <= limit
            )
        readings["no reversal, past Bondi's threshold"] = stays & past
        totals[key] = totals.get(key, 0) + len(runs)
        for name, chosen in readings.items():
            counts[(*key, name)] = counts.get((*key, name), 0) + int(chosen.sum())
    rows = [
        {"n_i": n, "omega_xy0": w, "definition": name, "count": count, "runs": totals[n, w]}
        for (n, w, name), count in counts.items()
    ]
    return pa.Table.from_pylist(rows, schema=DEFINITIONS)


# ------------------------------------------------------------------ how much SS bears

BASIN = pa.schema(
    [
        column("n_i", F64, "initial spin", RATE),
        column("omega_xy0", F64, "initial rate of the oscillation", RATE),
        column("runs", I64, "bodies past Bondi's threshold at this spin"),
        *(column(name, I64, f"of them, type {name}") for name in ("R", "SS", "SW", "unclassified")),
    ]
)


def basin(place: Place, sweep: Sweep, report: Report) -> pa.Table:
    """Types of the bodies past Bondi's threshold, launched with larger and larger oscillations.

    The bodies are those of the sweep; empty if it has no such bodies or not this spin.
    """
    settings = place.paper.fig6.basin
    spin = sweep.plan.config.spin
    assert spin is not None
    found = [
        runs[runs["n_c1"].abs() < abs(settings.n_i)]
        for case, runs in sweep.cases((*LAUNCH, "n_c1"))
        # Cases of one target share their bodies.
        if case.n_i == settings.n_i and case.omega_xy0 == spin.omega_xy0[0]
    ]
    if not found or not sum(map(len, found)):
        return BASIN.empty_table()
    bodies = pd.concat(found, ignore_index=True)
    launches = pd.concat(
        [bodies.assign(omega_xy0=size) for size in settings.omega_xy0], ignore_index=True
    )
    config = sweep.plan.config.model_copy(update={"name": "basin"})
    done = place.derived("basin", config, report, bodies_of(launches))
    _, runs = next(iter(done.cases(("omega_xy0", "type"))))
    rows = []
    for size in settings.omega_xy0:
        own = runs[runs["omega_xy0"] == size]
        counts = {name: int((own["type"] == name).sum()) for name in ("R", "SS", "SW",
                                                                      "unclassified")}  # fmt: skip
        rows.append({"n_i": settings.n_i, "omega_xy0": size, "runs": len(own), **counts})
    return pa.Table.from_pylist(rows, schema=BASIN)
