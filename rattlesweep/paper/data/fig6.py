"""Fig. 6: fractions of the types R, SS and SW in the steady direction, and examples of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from rattlesweep.paper.data.chaos import CHAOS, EDGE, exponents, launch_of
from rattlesweep.paper.data.columns import count, number, schema, table, word
from rattlesweep.paper.data.follow import FORCE_CHANNELS, FORCES, SPIN, follow, forces, thinned
from rattlesweep.paper.data.integrators import basin, rk4
from rattlesweep.paper.data.progress import Progress, between
from rattlesweep.paper.workspace import LAUNCH, StoredRuns, Workspace
from rattlesweep.sweeps.tables.cells import wilson
from rattlesweep.sweeps.tables.columns import RATE, TIME

# In the order of the legend.
TYPES = ("R", "SW", "SS", "unclassified")
FRACTIONS = schema(
    "K_r n_i omega_xy0 runs",
    count("bondi", "bodies with abs(n_c1) < abs(n_i)"),
    count("ss_only", "runs of type SS without abs(n_c1) < abs(n_i)"),
    count("bondi_only", "bodies with abs(n_c1) < abs(n_i) that are not SS"),
    number("fraction_bondi", "share with abs(n_c1) < abs(n_i)"),
    *(
        column
        for name in TYPES
        for column in (
            count(name, f"runs of type {name}"),
            number(f"fraction_{name}", f"share of type {name}"),
            number(f"low_{name}", "its 95 % confidence interval (Wilson), lower end"),
            number(f"high_{name}", "the same, upper end"),
        )
    ),
)


def data(ws: Workspace, progress: Progress) -> dict[str, pa.Table]:
    """Data of the figure, and what its claims need.

    Returns
    -------
    dict
        ``fractions``: one row a point. ``definitions``: :func:`readings`. ``rk4``, ``basin``: see
        :mod:`rattlesweep.paper.data.integrators`. ``chaos``: see
        :mod:`rattlesweep.paper.data.chaos`. ``examples``, ``forces``, ``spin_ss``, ``spin_sw``,
        ``spin_chaotic``: part (b), as far as the sweep has such runs.
    """
    sweep = ws.sweep("steady", progress)
    escaped = basin(ws, between(progress, 0.1, 0.15))
    wobbling = exponents(ws, between(progress, 0.15, 0.5))
    return {
        "fractions": fractions(sweep),
        "definitions": readings(sweep),
        "basin": escaped,
        "chaos": pa.Table.from_pandas(wobbling[CHAOS.names], schema=CHAOS, preserve_index=False),
        **examples(sweep, wobbling, between(progress, 0.5, 0.6)),
        "rk4": rk4(ws, between(progress, 0.6, 1.0)),
    }


def fractions(sweep: StoredRuns) -> pa.Table:
    """Count the types of every case."""
    rows = []
    for point, runs in sweep.points(("n_c1", "type")):
        total = len(runs)
        past, steady = runs["n_c1"].abs() < abs(point["n_i"]), runs["type"] == "SS"
        row = point | {
            "runs": total,
            "bondi": past.sum(),
            "ss_only": (steady & ~past).sum(),
            "bondi_only": (past & ~steady).sum(),
            "fraction_bondi": past.mean(),
        }
        for name in TYPES:
            hits = (runs["type"] == name).sum()
            low, high = wilson(hits, total)
            row |= {name: hits, f"fraction_{name}": hits / total if total else None,
                    f"low_{name}": float(low), f"high_{name}": float(high)}  # fmt: skip
        rows.append(row)
    return table(rows, FRACTIONS)


# ------------------------------------------------------------------ other readings of "SS"

DEFINITIONS = schema(
    "n_i omega_xy0",
    word("definition", "what is counted as SS"),
    count("count", "runs that it takes for SS"),
    more="runs",
)
GROWTHS = (0.01, 0.1, 0.3)
DEPARTURES = (0.01, 0.02, 0.05)


def readings(sweep: StoredRuns) -> pa.Table:
    """How many runs count as SS by several readings of "decays monotonously"."""
    runs = sweep.runs(("n_i", "omega_xy0", "n_c1", "type", "amp_growth", "n_departure", "t_r"))
    stays = runs["t_r"].isna()
    found = {
        "type SS (amplitude never grows by more than the threshold)": runs["type"] == "SS",
        **{
            f"amplitude never grows by more than {limit:.0%}": stays & (runs["amp_growth"] <= limit)
            for limit in GROWTHS
        },
        **{
            f"no reversal, spin never falls by more than {limit:.0%}": stays
            & (runs["n_departure"] <= limit)
            for limit in DEPARTURES
        },
        "no reversal, past Bondi's threshold": stays & (runs["n_c1"].abs() < runs["n_i"].abs()),
    }
    rows = []
    for (n_i, size), own in runs.groupby(["n_i", "omega_xy0"], sort=False):
        for words, counted in found.items():
            row = {"n_i": n_i, "omega_xy0": size, "definition": words, "runs": len(own)}
            rows.append(row | {"count": counted[own.index].sum()})
    return table(rows, DEFINITIONS)


# ------------------------------------------------------------------------------ examples

# The paper says of the chaotic run only where it lies.
SS_AT = {"n_i": -0.5, "omega_xy0": 0.1}
SW_AT = {"n_i": -0.4, "omega_xy0": 0.01}
CHAOTIC_AT = {"K_r": 0.0041, "n_i": -0.5}
# Longest that is shown, in sqrt(a/g).
LONGEST = 20_000.0
BINS = 1100
CHOSEN = schema(
    "",
    word("example", "spin_ss, spin_sw or spin_chaotic"),
    *list(CHAOS)[:6],
    number("lyapunov_late", "Lyapunov exponent over the second half of the run", RATE),
    number("shown", "time shown", TIME),
)


def examples(sweep: StoredRuns, wobbling: pd.DataFrame, progress: Progress) -> dict[str, pa.Table]:
    """Table ``examples``, the forces in these runs, and the spin of each, thinned."""
    columns = (*LAUNCH, "sample", "n_end", "n_departure", "t_end", "type")
    runs = sweep.runs(columns)
    rows = choose(runs, wobbling)
    integrator = sweep.config.integrator.model_dump(exclude_none=True)
    tables, presses = {}, []
    for k, row in enumerate(rows):
        key = ["K_r", "n_i", "omega_xy0", "sample"]
        run = runs[(runs[key] == [row[name] for name in key]).all(axis=1)].iloc[0]
        row["shown"] = min(LONGEST, float(run["t_end"]))
        launch = replace(launch_of(run), t_end=row["shown"], integrator=integrator)
        words, part = f"Fig. 6(b), {row['example']}", between(progress, k / 3, (k + 1) / 3)
        found, _ = follow(launch, ("t", "n", *FORCE_CHANNELS), words, part)
        tables[row["example"]] = thinned(found.table, SPIN, {"n": BINS})
        name = row["example"].removeprefix("spin_").replace("chaotic", "chaotic SW")
        presses.append(forces(f"Fig. 6(b), {name}", found.table))
    return tables | {"examples": table(rows, CHOSEN), "forces": table(presses, FORCES)}


def choose(runs: pd.DataFrame, wobbling: pd.DataFrame) -> list[dict[str, Any]]:
    """The examples, as far as there are such runs.

    SS: of this launch, the run with the median spin at its end.  SW: of this launch, the run with
    the median loss of spin among those that are not chaotic.  Chaotic: at this ``K_r`` and spin,
    the run with the largest exponent over its second half.
    """
    chaotic = wobbling["chaotic"].astype(bool)
    last = [*SS_AT, "K_r", "sample"]
    ordered = {
        "spin_ss": runs[(runs["type"] == "SS") & at(runs, SS_AT)].sort_values(["n_end", *last]),
        "spin_sw": wobbling[~chaotic & at(wobbling, SW_AT)].sort_values(["n_departure", *last]),
        "spin_chaotic": wobbling[chaotic & at(wobbling, CHAOTIC_AT)].nlargest(1, "lyapunov_late"),
    }
    # The one in the middle, the lower one of two.
    return [
        {"example": name, **{str(k): v for k, v in own.iloc[(len(own) - 1) // 2].items()}}
        for name, own in ordered.items() if len(own)
    ]  # fmt: skip


def at(runs: pd.DataFrame, values: dict[str, float]) -> NDArray[np.bool_]:
    """Which runs have these values, as they come from a file."""
    same = [np.isclose(runs[name].to_numpy(float), value, rtol=EDGE, atol=0)
            for name, value in values.items()]  # fmt: skip
    both: NDArray[np.bool_] = np.logical_and.reduce(same)
    return both
