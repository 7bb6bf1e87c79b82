"""Time of each part of a sweep, relative to a plain run.

    python benchmarks/parts.py [--samples 70] [--repeats 7] [--part limit ...]

The runs are those of ``configs/tradeoff.yaml`` with a horizon of 1000, so that long
runs do not leave lanes empty. All parts take turns on one thread; the table shows
medians of processor time. An ellipsoid or dissipation changes when runs end, so these
are compared per unit of time.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from machine import all_runs, heading, in_turns, plan_of

from rattlesweep.design.batches import full_batch
from rattlesweep.design.prepare import prepare_launches
from rattlesweep.physics import full
from rattlesweep.physics.steady import steady_modes
from rattlesweep.rows.arrow import build_table
from rattlesweep.rows.columns import runs_schema
from rattlesweep.store.parquet import write_parquet
from rattlesweep.work.block import columns_of, run_batch

if TYPE_CHECKING:
    from collections.abc import Callable

HORIZON = 1000.0
ELLIPSOID = ("bodies.surface=ellipsoid", "bodies.c=2")
SIGMA = "dissipation={sigma: 0.001}"
LOOSE = "integrator.tol=1.0e-6"
LIMIT = "dissipation={mu: 900000}"  # almost nothing slides
ROLLING = "dissipation={rolling: 0.0001}"
PIVOT = "dissipation={pivot: 0.0005}"
RECORDS = (
    "energy",
    "contact",
    "windows",
    "error",
    "lyapunov",
    "spectrum",
    "volume",
    "reversals",
    "energy, contact, windows",
)
# Settings of what is compared with a plain run, by name.  What ends in "at 1e-6" is
# compared with a plain run at that tolerance.
VARIANTS: dict[str, tuple[str, ...]] = {
    "plain": (),
    **{f"record {names}": (f"record=[{names}]",) for names in RECORDS},
    "record spectrum, reversals": ("record=[spectrum, reversals]",),
    "plain at 1e-6": (LOOSE,),
    "record contact at 1e-6": ("record=[contact]", LOOSE),
    "record error at 1e-6": ("record=[error]", LOOSE),
    "limit": (LIMIT,),
    "limit at 1e-6": (LIMIT, LOOSE),
    "accuracy t_r 1e-6": ("integrator={accuracy: {t_r: 1e-6}}",),
    "model reduced": ("model=reduced",),
    "ellipsoid": ELLIPSOID,
    "sigma": (SIGMA,),
    "ellipsoid, sigma": (*ELLIPSOID, SIGMA),
    "rolling": (ROLLING,),
    "pivot": (PIVOT,),
    "ellipsoid, rolling": (*ELLIPSOID, ROLLING),
}


@dataclass
class Part:
    """One thing to be timed, and how many runs or units of time it does."""

    call: Callable[[], Any]
    amount: float


def integration(samples: int, settings: tuple[str, ...]) -> Part:
    """Return a variant of the integration, by the unit of time."""
    horizon = f"horizon={{t_rgh: 5, t: {HORIZON}}}"
    plan = plan_of("tradeoff.yaml", f"bodies.samples={samples}", horizon, *settings)
    launches, batch = all_runs(plan)

    def call() -> Any:
        outcome = run_batch(plan.config, batch, threads=1)
        return columns_of(plan.config, launches, batch, outcome)

    return Part(call, float(np.sum(call()["t_end"])))


def around(samples: int, folder: Path) -> dict[str, Part]:
    """Return the work before and after the kernel."""
    plan = plan_of("tradeoff.yaml", f"bodies.samples={samples}")
    launches, batch = all_runs(plan)
    outcome = run_batch(plan.config, batch, threads=1)
    columns = columns_of(plan.config, launches, batch, outcome)
    b = launches.bodies
    constants = full.constants(b.alpha, b.beta, b.gamma, b.theta, b.phi, b.xi)

    def write() -> None:
        table = build_table(columns, runs_schema([], "full"))
        write_parquet(table, folder / "rows.parquet")

    calls: dict[str, Callable[[], Any]] = {
        "bodies, theory": partial(
            prepare_launches, plan, launches.case, launches.sample
        ),
        "linear stability": partial(steady_modes, constants, launches.n_i),
        "initial states": partial(full_batch, launches),
        "Parquet file": write,
    }
    units = float(outcome.t_end.sum())
    return {name: Part(call, units) for name, call in calls.items()}


@click.command()
@click.option("--samples", default=70, show_default=True, help="Bodies a case.")
@click.option("--repeats", default=7, show_default=True)
@click.option("--part", "chosen", multiple=True, type=click.Choice(list(VARIANTS)))
def main(samples: int, repeats: int, chosen: tuple[str, ...]) -> None:
    """Print the time of each part, or of some beside plain runs."""
    names = dict.fromkeys(("plain", "plain at 1e-6", *chosen) if chosen else VARIANTS)
    parts = {name: integration(samples, VARIANTS[name]) for name in names}
    with tempfile.TemporaryDirectory() as folder:
        if not chosen:
            parts |= around(samples, Path(folder))
        calls = {name: part.call for name, part in parts.items()}
        seconds = in_turns(calls, repeats)
    click.echo(f"{heading()}\n{'part':32}{'us per unit of time':>20}{'of plain':>10}")
    for name, part in parts.items():
        base = "plain at 1e-6" if name.endswith("at 1e-6") else "plain"
        plain = seconds[base] / parts[base].amount
        price = seconds[name] / part.amount
        click.echo(f"{name:32}{1e6 * price:20.4g}{price / plain:10.4f}")


if __name__ == "__main__":
    main()
