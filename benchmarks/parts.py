"""Time of each part of a sweep, measured in one run on one machine.

    python benchmarks/parts.py [--quick]

The runs are those of ``configs/tradeoff.yaml`` with a horizon of 1000, so that long
runs do not leave lanes empty.  All variants of the integration take turns on one
thread; the table shows medians of processor time, as ratios to the plain run.  The
observables behind the types (the amplitude in windows, the smallest spin) cannot be
switched off.  The time of the amplitude is found by compiling the generated step with
and without it, and that of the rest is the time of the integration beyond its steps.
An ellipsoid or dissipation changes when runs end, so these are compared per unit of
time; the table also has the steps tried per unit of time.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from numba import njit

from rattlesweep.arrays import take
from rattlesweep.integrate.batch import Batch, problem_of
from rattlesweep.integrate.lanes.lane import LANES, Layout
from rattlesweep.integrate.lanes.step import OPTIONS, write_attempt
from rattlesweep.integrate.model import FULL
from rattlesweep.integrate.tableau import DOP853
from rattlesweep.physics import full, theory
from rattlesweep.physics.steady import steady_modes
from rattlesweep.sweeps.block import columns_of, run_batch
from rattlesweep.sweeps.columns import build_table, runs_schema
from rattlesweep.sweeps.config.read import load_config
from rattlesweep.sweeps.config.schema import Config, Integrator
from rattlesweep.sweeps.launches import Launches, full_batch, prepare, reduced_batch
from rattlesweep.sweeps.parquet import write_parquet
from rattlesweep.sweeps.plan import make_plan

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

CONFIG = Path(__file__).resolve().parent.parent / "configs" / "tradeoff.yaml"
HORIZON = 1000.0
STEP = "step with what the types need"
RECORDS = (
    [],
    ["energy"],
    ["contact"],
    ["windows"],
    ["error"],
    ["lyapunov"],
    ["volume"],
    ["reversals"],
    ["energy", "contact", "windows"],
)

# Settings of each scene; few runs reverse before the horizon.
SCENES = {
    "plain": [],
    "ellipsoid": ["bodies.surface=ellipsoid", "bodies.c=2"],
    "sigma": ["dissipation={sigma: 0.001}"],
    "ellipsoid, sigma": [
        "bodies.surface=ellipsoid",
        "bodies.c=2",
        "dissipation={sigma: 0.001}",
    ],
    "rolling": ["dissipation={rolling: 0.0001}"],
    "ellipsoid, rolling": [
        "bodies.surface=ellipsoid",
        "bodies.c=2",
        "dissipation={rolling: 0.0001}",
    ],
}


@dataclass
class Part:
    """One thing to be timed; ``base`` is the name of the part that it is compared
    with.
    """

    name: str
    call: Callable[[], Any]
    runs: int
    base: str = "plain"
    unit: str = "run"


def columns(config: Config, launches: Launches, batch: Batch) -> Mapping[str, Any]:
    """Integrate runs on one thread, and return their columns."""
    return columns_of(config, launches, batch, run_batch(config, batch, threads=1))


def integration(samples: int) -> tuple[list[Part], Any, Any, dict[str, Any]]:
    """Variants of the integration, and the plan and launches they are of."""
    config = load_config(
        CONFIG, [f"bodies.samples={samples}", f"horizon={{t_rgh: 5, t: {HORIZON}}}"]
    )
    plan = make_plan(config)
    case, sample = np.divmod(np.arange(plan.runs), plan.samples)
    launches = prepare(plan, case, sample)
    batch = full_batch(launches)
    runs = len(batch)
    parts = []
    for record in RECORDS:
        changed = config.model_copy(update={"record": record})
        parts.append(
            Part(
                "record " + ", ".join(record) if record else "plain",
                lambda changed=changed: columns(changed, launches, batch),
                len(batch),
            )
        )
    goal = Integrator.model_validate({"accuracy": {"t_r": 1e-6}})
    changed = config.model_copy(update={"integrator": goal, "record": ["error"]})
    parts.append(
        Part(
            "accuracy t_r 1e-6",
            lambda changed=changed: columns(changed, launches, batch),
            runs,
        )
    )
    reduced = config.model_copy(update={"model": "reduced"})
    closed = config.model_copy(update={"model": "gh"})
    small = reduced_batch(launches)
    parts += [
        Part("model reduced", lambda: columns(reduced, launches, small), runs),
        Part("model gh", lambda: columns_of(closed, launches, None, None), runs),
        Part("integration alone", lambda: run_batch(config, batch, threads=1), runs),
    ]
    # Runs for which the horizon of 5 t_rGH is the smaller one.
    short = np.flatnonzero(5.0 * launches.gh.t_rgh <= HORIZON)
    chosen = take(batch, short)
    for units in (1.0, 2.0, 5.0):
        cut = replace(chosen, t_end=units * launches.gh.t_rgh[short])
        parts.append(
            Part(
                f"integration, horizon {units:g} t_rGH",
                lambda cut=cut: run_batch(config, cut, threads=1),
                len(short),
                "integration, horizon 5 t_rGH",
            )
        )
    return parts, plan, launches, columns(config, launches, batch)


def scenes(samples: int) -> list[Part]:
    """The integration of bodies with another surface or with dissipation, by the unit
    of time.
    """
    parts = []
    for scene, changes in SCENES.items():
        given = [
            f"bodies.samples={samples}",
            f"horizon={{t_rgh: 5, t: {HORIZON}}}",
            *changes,
        ]
        config = load_config(CONFIG, given)
        plan = make_plan(config)
        batch = full_batch(
            prepare(plan, *np.divmod(np.arange(plan.runs), plan.samples))
        )
        out = run_batch(config, batch, threads=1)
        spent = float(out.t_end.sum())
        tries = (out.n_steps.sum() + out.n_rejected.sum()) / spent
        parts.append(
            Part(
                f"scene {scene} ({tries:.3f} tries)",
                lambda config=config, batch=batch: run_batch(config, batch, threads=1),
                round(spent),
                parts[0].name if parts else "",
                "unit",
            )
        )
    parts[0].base = parts[0].name
    return parts


def around(
    plan: Any, launches: Any, found: Mapping[str, Any], directory: Path
) -> list[Part]:
    """The work before and after the kernel."""
    case, sample, b = launches.case, launches.sample, launches.bodies
    constants = full.constants(b.alpha, b.beta, b.gamma, b.theta, b.phi, b.xi)
    runs = len(sample)
    schema = runs_schema([], "full")
    return [
        Part("bodies", lambda: plan.source.bodies(np.nan, sample), runs),
        Part("bodies, theory, horizons", lambda: prepare(plan, case, sample), runs),
        Part(
            "theory: modes",
            lambda: theory.modes(b.alpha, b.beta, b.theta, b.phi, b.xi),
            runs,
        ),
        Part("steady modes", lambda: steady_modes(constants, launches.n_i), runs),
        Part("initial states, steady modes", lambda: full_batch(launches), runs),
        Part(
            "Parquet file",
            lambda: write_parquet(
                build_table(found, schema), directory / "rows.parquet"
            ),
            runs,
        ),
    ]


def without_amplitude() -> Any:
    """The generated step without the amplitude; None if the generator cannot leave it
    out.
    """

    @full.scalar
    def nothing(p, q, a, b, c, p0, q0, a0, b0, p1, q1, a1, b1):  # type: ignore[no-untyped-def]
        return 0.0

    blind = replace(FULL, name="blind", amplitude=nothing)
    return njit(**OPTIONS)(write_attempt(DOP853, blind)), problem_of(blind, True)


def steps(calls: int) -> list[Part]:
    """The generated step, with and without what the types need."""
    at, n = Layout(FULL), FULL.n_state
    size = (at.stages + (DOP853.stages + 1) * n) * LANES
    flat = np.zeros(size + 8)
    flat = flat[(-flat.ctypes.data // 8) % 8 :][:size]
    rows = flat.reshape(-1, LANES)
    body = {
        "alpha": 13.04,
        "beta": 1.522,
        "gamma": 12.28,
        "theta": 0.6429,
        "phi": 0.036,
        "xi": -0.03,
    }
    rows[at.constants : at.constants + 6] = full.constants(**body)[:, None]
    rows[at.y + 2], rows[at.y + 4] = 0.01, -0.1
    rows[at.h], rows[at.probe : at.probe + FULL.n_probe] = 0.3, 0.1
    parts = []
    for name, (attempt, problem) in (
        (STEP, (njit(**OPTIONS)(write_attempt(DOP853, FULL)), problem_of(FULL, True))),
        ("step without the amplitude", without_amplitude()),
    ):
        many = partial(_many(attempt), problem, flat, calls)
        parts.append(Part(name, many, calls * LANES, STEP, "step"))
    return parts


def _many(attempt: Any) -> Any:
    @njit(nogil=True)
    def many(problem, flat, calls):  # type: ignore[no-untyped-def]
        for _ in range(calls):
            attempt(problem, flat, 1e18)

    return many


def measure(parts: list[Part], rounds: int) -> dict[str, float]:
    """Median processor seconds of every part, all taking turns."""
    spent: dict[str, list[float]] = {part.name: [] for part in parts}
    for r in range(rounds + 1):
        for part in parts:
            before = time.process_time()
            part.call()
            if r:  # the first round loads and compiles
                spent[part.name].append(time.process_time() - before)
    return {name: statistics.median(values) for name, values in spent.items()}


@click.command()
@click.option("--quick", is_flag=True, help="Fewer runs and repeats.")
def main(quick: bool) -> None:
    """Print the time of each part."""
    parts, plan, launches, found = integration(20 if quick else 70)
    out = run_batch(plan.config, full_batch(launches), threads=1)
    tries = int(out.n_steps.sum() + out.n_rejected.sum())
    with tempfile.TemporaryDirectory() as directory:
        parts += scenes(20 if quick else 70)
        parts += around(plan, launches, found, Path(directory))
        parts += steps(2000 if quick else 10_000)
        seconds = measure(parts, 3 if quick else 7)
    click.echo(
        f"{len(launches.n_i)} runs to the horizon {HORIZON:g}, "
        f"{found['t_end'].sum():.3g} units of time, {tries:.3g} steps tried; "
        "one thread, medians"
    )
    click.echo(f"{'part':40}{'us':>10}{'of one':>8}{'ratio':>9}  to")
    price = {part.name: seconds[part.name] / part.runs * 1e6 for part in parts}
    for part in parts:
        ratio = price[part.name] / price[part.base]
        click.echo(
            f"{part.name:40}{price[part.name]:10.4g}{part.unit:>8}{ratio:9.4f}  "
            f"{part.base}"
        )
    alone = 1 - tries * price[STEP] / (seconds["integration alone"] * 1e6)
    click.echo(
        "step control, search for zeros, windows, refilling: "
        f"{100 * alone:.0f} % of the integration; the rest is the steps"
    )


if __name__ == "__main__":
    main()
