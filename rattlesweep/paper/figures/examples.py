"""Fig. 6(b): example runs, chosen by rule from the sweep; and which wobbling runs are chaotic.

The runs of type SW are integrated once more with their Lyapunov exponents; the same launches give
the same runs.  A run is chaotic if a small difference grows more than e^10-fold in its second half
(:mod:`rattlesweep.sweeps.tables.chaos`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pyarrow as pa
from pydantic import Field

from rattlesweep.integrate.follow.lyapunov import growth_along
from rattlesweep.paper.claims.checks import EDGE
from rattlesweep.paper.follow import (
    F64,
    FORCE_CHANNELS,
    FORCES,
    I64,
    TEXT,
    column,
    follow,
    forces,
    spin_table,
)
from rattlesweep.paper.sweeps import LAUNCH, bodies_of, horizons, part
from rattlesweep.paper.workers import side_by_side
from rattlesweep.physics.body import PARAMETERS, Rattleback
from rattlesweep.sweeps.blocks import single
from rattlesweep.sweeps.config.fields import Base
from rattlesweep.sweeps.tables.chaos import LEAST_GROWTH, is_chaotic
from rattlesweep.sweeps.tables.columns import RATE, TIME

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.paper.sweeps import Place, Report, Sweep

    Floats = NDArray[np.float64]

BINS = 1100
# Runs called chaotic although they are slow are followed to this many horizons.
LONGER = 6
SLOW = 0.4


class Launch(Base):
    """A spin and an oscillation of the sweep."""

    n_i: float = Field(lt=0, description="Spin, in sqrt(g/a).")
    omega_xy0: float = Field(gt=0, description="Oscillation, in sqrt(g/a).")


class Chaotic(Base):
    """Where the paper found a chaotic example."""

    K_r: float = Field(gt=0, description="Target of the torque coefficient.")
    n_i: float = Field(lt=0, description="Spin, in sqrt(g/a).")


class Examples(Base):
    """The runs of Fig. 6(b)."""

    ss: Launch
    sw: Launch
    chaotic: Chaotic
    t_end: float = Field(gt=0, description="Longest that is shown, in sqrt(a/g).")


CHAOS = pa.schema(
    [
        column("K_r", F64, "target of the torque coefficient"),
        column("n_i", F64, "initial spin", RATE),
        column("omega_xy0", F64, "initial rate of the oscillation", RATE),
        column("sample", I64, "number of the run within its case"),
        column("t_end", F64, "horizon", TIME),
        column("n_departure", F64, "largest loss of spin over the run, relative"),
        column("lyapunov", F64, "largest Lyapunov exponent over the run", RATE),
        column("lyapunov_late", F64, "the same over its second half", RATE),
        column("chaotic", pa.bool_(), "whether a difference grows e^10-fold in the second half"),
        column("growth_longer", F64, "logarithm of the growth in the second half of six horizons; "
               "only for runs called chaotic with abs(n_i) <= 0.4"),
    ]
)  # fmt: skip
CHOSEN = pa.schema(
    [
        column("example", TEXT, "spin_ss, spin_sw or spin_chaotic"),
        *list(CHAOS)[:6],
        column("lyapunov_late", F64, "Lyapunov exponent over the second half of the run", RATE),
        column("shown", F64, "time shown", TIME),
    ]
)


@dataclass(frozen=True)
class Example:
    """A run of the sweep by its rule."""

    name: str
    run: dict[str, Any]


def compute(place: Place, sweep: Sweep, report: Report) -> dict[str, pa.Table]:
    """Tables ``chaos`` (one row a run of type SW), ``examples``, ``forces`` and the spins.

    The spins ``spin_ss``, ``spin_sw`` and ``spin_chaotic`` are there as far as the sweep has such
    runs.
    """
    wobbling, runs = exponents(place, sweep, part(report, 0.0, 0.7))
    longer = confirm(place, sweep, wobbling, runs, part(report, 0.7, 0.9))
    chosen = choose(place.paper.fig6.examples, sweep, wobbling)
    tables: dict[str, pa.Table] = {}
    presses = []
    for k, example in enumerate(chosen):
        table, press = _follow(place, sweep, example, part(report, 0.9 + k / 30, 0.93 + k / 30))
        tables[example.name] = table
        presses.append(press)
    rows = [
        {"example": e.name, **e.run, "shown": shown_until(place, e.run["t_end"])} for e in chosen
    ]
    return tables | {
        "chaos": pa.Table.from_pandas(
            wobbling.assign(growth_longer=longer)[CHAOS.names], schema=CHAOS, preserve_index=False
        ),
        "examples": pa.Table.from_pylist(
            [{name: row.get(name) for name in CHOSEN.names} for row in rows], schema=CHOSEN
        ),
        "forces": pa.Table.from_pylist(presses, schema=FORCES),
    }


def shown_until(place: Place, t_end: float) -> float:
    """Time shown of a run with this horizon."""
    return min(place.paper.fig6.examples.t_end, float(t_end))


def exponents(place: Place, sweep: Sweep, report: Report) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Lyapunov exponents of the runs of type SW.

    Returns
    -------
    wobbling, runs : DataFrame
        Columns of :data:`CHAOS` but the last, and launches of the same runs.
    """
    columns = (*LAUNCH, "sample", "t_rgh", "n_departure", "type")
    found = [own[own["type"] == "SW"].assign(K_r=case.target) for case, own in sweep.cases(columns)]
    runs = pd.concat(found, ignore_index=True)
    most = place.paper.fig6.lyapunov
    runs = runs.iloc[:: max(1, -(-len(runs) // most))].reset_index(drop=True)
    if not len(runs):
        return pd.DataFrame(columns=CHAOS.names[:-1]), runs
    config = sweep.plan.config.model_copy(
        update={"name": "lyapunov", "record": ["lyapunov"], "block_size": 1000}
    )
    table = bodies_of(runs, horizons(config, runs["t_rgh"].to_numpy(dtype=float)))
    done = place.derived("lyapunov", config, report, table)
    _, theirs = next(iter(done.cases(("sample", "t_end", "lyapunov", "lyapunov_late"))))
    theirs = theirs.set_index("sample").reindex(range(len(runs)))
    wobbling = runs[["K_r", "n_i", "omega_xy0", "sample", "n_departure"]].copy()
    for name in ("t_end", "lyapunov", "lyapunov_late"):
        wobbling[name] = theirs[name].to_numpy(dtype=float)
    wobbling["chaotic"] = is_chaotic(wobbling["lyapunov_late"], wobbling["t_end"])
    return wobbling, runs


def confirm(
    place: Place, sweep: Sweep, wobbling: pd.DataFrame, runs: pd.DataFrame, report: Report
) -> Floats:
    """Growth of a difference in the second half of six horizons, for slow runs called chaotic."""
    growth = np.full(len(wobbling), np.nan)
    slow = wobbling["chaotic"].astype(bool) & (wobbling["n_i"].abs() <= SLOW + EDGE)
    places = np.flatnonzero(slow.to_numpy())
    tasks = []
    for index in places:
        t_end = float(wobbling["t_end"].iloc[index])
        constants, y0 = launch(sweep, runs.iloc[index])
        times = t_end * np.array([LONGER / 2, LONGER])
        tasks.append(partial(growth_along, constants, y0, times, tol=1e-11))
    if tasks:
        # Compiled here, and not in two threads at once.
        growth_along(constants, y0, [1.0])
        words = "are the chaotic ones chaotic for good?"
        found = side_by_side(tasks, place.threads, lambda share: report(share, words))
        growth[places] = [late - early for early, late in found]
    return growth


def body_of(run: pd.Series) -> Rattleback:
    """Body of a run of the sweep."""
    return Rattleback(**{name: float(run[name]) for name in PARAMETERS})


def launch(sweep: Sweep, run: pd.Series) -> tuple[Floats, Floats]:
    """Constants and first state of a run of the sweep."""
    spin = sweep.plan.config.spin
    assert spin is not None
    _, _, batch = single.single_run(
        single.Launch(body_of(run), float(run["n_i"]), float(run["omega_xy0"]), 1.0, spin.psi)
    )
    assert batch is not None
    return batch.constants[0], batch.y0[0]


# ------------------------------------------------------------------------------ which runs


def choose(settings: Examples, sweep: Sweep, wobbling: pd.DataFrame) -> list[Example]:
    """The examples, as far as there are such runs.

    SS: of this launch, the run with the median spin at its end.  SW: of this launch, the run with
    the median loss of spin among those that are not chaotic.  Chaotic: at this ``K_r`` and spin,
    the run with the largest exponent over its second half.
    """
    found = []
    steady = _of_type(sweep, settings.ss, "SS")
    if len(steady):
        found.append(Example("spin_ss", median(steady, "n_end")))
    at = wobbling[_same(wobbling["n_i"], settings.sw.n_i)]
    at = at[_same(at["omega_xy0"], settings.sw.omega_xy0) & ~at["chaotic"].astype(bool)]
    if len(at):
        found.append(Example("spin_sw", median(at, "n_departure")))
    at = wobbling[_same(wobbling["n_i"], settings.chaotic.n_i)]
    at = at[_same(at["K_r"], settings.chaotic.K_r) & at["chaotic"].astype(bool)]
    if len(at):
        found.append(Example("spin_chaotic", row_of(at, int(at["lyapunov_late"].argmax()))))
    return found


def median(runs: pd.DataFrame, name: str) -> dict[str, Any]:
    """The run in the middle of a column, the lower one of two."""
    ordered = runs.sort_values([name, "K_r", "sample"], kind="stable")
    return row_of(ordered, (len(ordered) - 1) // 2)


def row_of(runs: pd.DataFrame, place: int) -> dict[str, Any]:
    """A row by its place."""
    return {str(name): value for name, value in runs.iloc[place].to_dict().items()}


def _same(values: pd.Series, wanted: float) -> NDArray[np.bool_]:
    close: NDArray[np.bool_] = np.isclose(values.to_numpy(dtype=float), wanted, rtol=EDGE, atol=0)
    return close


def _of_type(sweep: Sweep, at: Launch, kind: str) -> pd.DataFrame:
    found = [
        own[own["type"] == kind].assign(K_r=case.target)
        for case, own in sweep.cases(
            ("sample", "n_i", "omega_xy0", "n_end", "n_departure", "t_end", "type")
        )
        if case.n_i is not None
        and case.omega_xy0 is not None
        and abs(case.n_i / at.n_i - 1) < EDGE
        and abs(case.omega_xy0 / at.omega_xy0 - 1) < EDGE
    ]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame()


def stored(sweep: Sweep, example: dict[str, Any]) -> pd.Series:
    """Row of the sweep's table that an example is."""
    for case, own in sweep.cases((*LAUNCH, "sample", "n_end", "t_end")):
        if (case.target, case.n_i, case.omega_xy0) == tuple(
            example[name] for name in ("K_r", "n_i", "omega_xy0")
        ):
            found: pd.Series = own[own["sample"] == example["sample"]].iloc[0]
            return found
    raise LookupError("no such run")


def _follow(
    place: Place, sweep: Sweep, example: Example, report: Report
) -> tuple[pa.Table, dict[str, Any]]:
    run = stored(sweep, example.run)
    config = sweep.plan.config
    assert config.spin is not None
    found, _ = follow(
        body_of(run), n_i=float(run["n_i"]), omega_xy0=float(run["omega_xy0"]),
        t_end=shown_until(place, run["t_end"]), channels=("t", "n", *FORCE_CHANNELS),
        psi=config.spin.psi, integrator=config.integrator.model_dump(exclude_none=True),
        words=f"Fig. 6(b), {example.name}", report=report,
    )  # fmt: skip
    name = f"Fig. 6(b), {example.name.removeprefix('spin_').replace('chaotic', 'chaotic SW')}"
    return spin_table(found, BINS), forces(name, found.table)


__all__ = ["CHAOS", "LEAST_GROWTH", "Examples", "choose", "compute"]
