"""Price of a step and of a run under each law of friction, relative to a plain one.

    python benchmarks/friction.py [--samples 16] [--repeats 3] [--law pivot ...]

The runs are those of ``configs/steady.yaml`` and ``configs/unsteady.yaml`` with a few
bodies a case, so the lanes that are left alone at the end count.  All laws take turns
on one thread; the table shows medians of the kernel's processor time over accepted
steps, and over runs.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import click
from machine import all_runs, heading, in_turns, plan_of

from rattlesweep.work.block import run_batch

if TYPE_CHECKING:
    from collections.abc import Callable

    from rattlesweep.kernel.outcome import Outcome

# With the last coefficient of friction almost nothing slides: the test of the limit.
LAWS = {
    "plain": ("dissipation={}",),
    "sigma": ("dissipation={sigma: 0.001}",),
    "rolling": ("dissipation={rolling: 0.0001}",),
    "pivot": ("dissipation={pivot: 0.0005}",),
    "pivot, creep": ("dissipation={pivot: 0.0005, creep: 0.3}",),
    "viscous": ("dissipation={viscous: 30}",),
    "base": ("base={frequency: 0.7, acceleration: 0.1}",),
    "mu 0.3": ("dissipation={mu: 0.3}",),
    "mu 0.1": ("dissipation={mu: 0.1}",),
    "limit": ("dissipation={mu: 900000}",),
}
CONFIGS = ("steady.yaml", "unsteady.yaml")


def sweep(config: str, law: str, samples: int) -> Callable[[], Outcome]:
    """Return the integration of a config under a law."""
    plan = plan_of(config, f"bodies.samples={samples}", *LAWS[law])
    _, batch = all_runs(plan)
    return partial(run_batch, plan.config, batch, threads=1)


@click.command()
@click.option("--samples", default=16, show_default=True, help="Bodies a case.")
@click.option("--repeats", default=3, show_default=True)
@click.option("--law", "laws", multiple=True, type=click.Choice(list(LAWS)))
@click.option("--config", "configs", multiple=True, type=click.Choice(CONFIGS))
def main(
    samples: int, repeats: int, laws: tuple[str, ...], configs: tuple[str, ...]
) -> None:
    """Print the price of each law."""
    chosen = dict.fromkeys(("plain", *(laws or LAWS)))
    click.echo(heading())
    header = f"{'config':15}{'law':14}{'us a step':>10}{'a step':>8}{'a run':>8}"
    click.echo(header)
    for config in configs or CONFIGS:
        calls = {law: sweep(config, law, samples) for law in chosen}
        seconds = in_turns(calls, repeats)
        steps = {law: float(call().n_steps.sum()) for law, call in calls.items()}
        plain = seconds["plain"] / steps["plain"]
        for law in chosen:
            price = seconds[law] / steps[law]
            run = seconds[law] / seconds["plain"]
            line = f"{1e6 * price:10.4f}{price / plain:8.2f}{run:8.2f}"
            click.echo(f"{config:15}{law:14}{line}")


if __name__ == "__main__":
    main()
