"""Steps that ``classify.early`` saves, types that it changes, and its margin.

    python benchmarks/early.py [configs/steady.yaml] [--set seed=1] [--factors
    1,4,16,64]

Integrates every run to its horizon and with ``classify.early``, in turn, on one thread.
A factor other than 1 multiplies the oscillation below which runs end; the margin is the
factor at which types begin to change.  ``--only-candidates`` leaves out the runs that
cannot end early, so that there is time for more of the others.
"""

from __future__ import annotations

import time
from dataclasses import fields, replace

import click
import numpy as np
import pandas as pd
from peer_work import processor

from rattlesweep.arrays import take
from rattlesweep.integrate.batch import Outcome, integrate
from rattlesweep.integrate.model import FULL
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import METHODS, TOL
from rattlesweep.sweeps.block import prepare_runs
from rattlesweep.sweeps.config.read import load_config
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.types import TYPES, classify

AT_ONCE = 4_000
MOST_CASES = 1_000
SS = TYPES.index("SS")


def same_bits(one: Outcome, other: Outcome) -> bool:
    """Return whether all numbers of two integrations are equal, bit for bit."""
    names = (part.name for part in fields(Outcome) if part.name != "stopped")
    return all(getattr(one, n).tobytes() == getattr(other, n).tobytes() for n in names)


def measure(plan, factors, only_candidates):
    """Yield, for some runs at a time, the results to the horizon and with early ends,
    by factor.
    """
    settings = plan.config.integrator
    numbers = np.arange(plan.runs)
    for first in range(0, plan.runs, AT_ONCE):
        part = numbers[first : first + AT_ONCE]
        launches, batch = prepare_runs(plan, *np.divmod(part, plan.samples))
        kept = np.isfinite(batch.t_end)
        if only_candidates:
            kept &= batch.settled > 0
        launches, batch = take(launches, kept), take(batch, kept)
        if not len(batch):
            continue
        outcomes, seconds = [], []
        for factor in (0.0, *factors):
            begin = time.process_time()
            outcomes.append(
                integrate(
                    replace(batch, settled=factor * batch.settled),
                    METHODS[settings.method],
                    FULL,
                    tol=settings.tol or TOL,
                    max_steps=settings.max_steps,
                    threads=1,
                )
            )
            seconds.append(time.process_time() - begin)
        yield launches, outcomes, seconds


def typed(out: Outcome, thresholds) -> np.ndarray:
    """Types of the runs."""
    ok = out.status == Status.OK
    return classify(ok, out.t_r, out.amp_growth, out.n_departure, thresholds)


@click.command()
@click.argument("config", default="configs/steady.yaml")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE")
@click.option("--factors", default="1", show_default=True, help="With commas between.")
@click.option("--only-candidates", is_flag=True)
def main(
    config: str, overrides: tuple[str, ...], factors: str, only_candidates: bool
) -> None:
    """Print how many runs end early, by case, and every type that changes."""
    plan = make_plan(load_config(config, [*overrides, "classify.early=true"]))
    thresholds = plan.config.classify
    scales = [float(word) for word in factors.split(",")]
    frames, spent, equal, changes = [], np.zeros(1 + len(scales)), True, []
    growth, fall, apart = -1.0, 0.0, 0.0
    for launches, (full, *early), seconds in measure(plan, scales, only_candidates):
        spent += seconds
        before = typed(full, thresholds)
        data = {
            "n_i": launches.n_i,
            "omega_xy0": launches.omega_xy0,
            "SS": before == SS,
        }
        data["steps"] = full.n_steps + full.n_rejected
        for k, out in enumerate(early):
            ended = (
                (out.t_end < full.t_end) & np.isnan(out.t_r) & (out.status == Status.OK)
            )
            other = typed(out, thresholds) != before
            data |= {f"ended{k}": ended, f"changed{k}": other}
            data |= {f"steps{k}": out.n_steps + out.n_rejected}
            equal &= same_bits(take(full, ~ended), take(out, ~ended))
            if k == 0:
                growth = max(growth, full.amp_growth[ended].max(initial=-1.0))
                deeper, settles = full.n_departure - out.n_departure, launches.gh.n_0
                fall = max(fall, deeper[ended].max(initial=0.0))
                off = np.abs(np.abs(full.n_end) / settles - 1)
                apart = max(apart, off[ended].max(initial=0.0))
                for i in np.flatnonzero(other):
                    changes.append(
                        (
                            launches.case[i],
                            launches.sample[i],
                            before[i],
                            full.amp_growth[i],
                            full.n_departure[i],
                        )
                    )
        frames.append(pd.DataFrame(data))
    runs = pd.concat(frames)
    total = int(runs["steps"].sum())
    click.echo(
        f"{processor()}; {len(runs)} of {plan.runs} runs, {total:,} steps, tried ones too"
    )
    click.echo(f"runs that did not end early are the same to the last bit: {equal}")
    click.echo(
        f"those that did, to their horizons: amp_growth {growth:.3g} at most, n_departure "
        f"larger by {fall:.1e}, n_end off n_0 by {apart:.1e}\n"
    )
    click.echo(
        f"{'omega_xy0':>9} {'n_i':>6} {'runs':>7} {'SS':>6} {'ended':>6} {'changed':>7} "
        f"{'steps of SS':>11} {'saved, of SS':>12} {'of all':>7}"
    )
    cases = runs.groupby(["omega_xy0", "n_i"])
    # A table may have as many launches as runs.
    groups = [*(cases if len(cases) < MOST_CASES else []), (("all", ""), runs)]
    for (omega, n_i), rows in groups:
        steady, saved = (
            rows["steps"][rows["SS"]].sum(),
            (rows["steps"] - rows["steps0"]).sum(),
        )
        click.echo(
            f"{omega:>9} {n_i:>6} {len(rows):7d} {rows['SS'].sum():6d} {rows['ended0'].sum():6d} "
            f"{rows['changed0'].sum():7d} {steady / rows['steps'].sum():11.1%} "
            f"{saved / max(1, steady):12.1%} {saved / rows['steps'].sum():7.1%}"
        )
    click.echo("\nfactor    ended  changed   steps saved   CPU seconds, 1 in all")
    for k, scale in enumerate(scales):
        saved = 1 - runs[f"steps{k}"].sum() / total
        click.echo(
            f"{scale:6g} {runs[f'ended{k}'].sum():8d} {runs[f'changed{k}'].sum():8d} "
            f"{saved:13.2%}   {spent[1 + k]:.1f} against {spent[0]:.1f}: "
            f"{spent[1 + k] / spent[0]:.3f}"
        )
    for case, sample, kind, amp_growth, departure in changes:
        click.echo(
            f"changed: case {case}, sample {sample}: {TYPES[kind]} to its horizon, "
            f"amp_growth {amp_growth:.3g}, n_departure {departure:.3g}"
        )


if __name__ == "__main__":
    main()
