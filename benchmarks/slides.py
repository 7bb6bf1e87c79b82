"""Time of sweeps of bodies that slide, relative to those that roll.

    python benchmarks/slides.py [--samples 75] [--repeats 3]

The bodies are those of Table I with pushes of 0.01 and 0.1.  Runs end at their first
reversal or at the horizon; friction delays reversals, so the table has the ratio of the
time per run, and per unit of time on the body's clock.  All variants take turns on one
thread; the table shows medians of processor time.
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

N_I = (0.1, 0.3, 0.5, -0.3)
# With the first coefficient of friction almost nothing slides.
MU = (9e5, 0.3, 0.2, 0.1)


def sweep(n_i: float, dissipation: str, samples: int) -> Callable[[], Outcome]:
    """Return the integration of one spin."""
    horizon = 50 if n_i > 0 else 5
    plan = plan_of(
        "unsteady.yaml",
        f"bodies={{source: sd, samples: {samples}}}",
        f"spin.n_i=[{n_i}]",
        "spin.omega_xy0=[0.01, 0.1]",
        f"horizon={{t_rgh: {horizon}}}",
        f"dissipation={dissipation}",
    )
    _, batch = all_runs(plan)
    return partial(run_batch, plan.config, batch, threads=1)


@click.command()
@click.option("--samples", default=75, show_default=True, help="Bodies.")
@click.option("--repeats", default=3, show_default=True)
def main(samples: int, repeats: int) -> None:
    """Print the time of each sweep."""
    click.echo(heading())
    click.echo(f"{'n_i':>5}{'mu':>8}{'slides':>8}{'per run':>9}{'per time':>10}")
    for n_i in N_I:
        calls = {"rolls": sweep(n_i, "{}", samples)}
        for mu in MU:
            calls[f"{mu:g}"] = sweep(n_i, f"{{mu: {mu}}}", samples)
        seconds = in_turns(calls, repeats)
        units = {name: float(call().t_end.sum()) for name, call in calls.items()}
        for mu in MU:
            name = f"{mu:g}"
            slides = calls[name]().n_slides.mean()
            ratio = seconds[name] / seconds["rolls"]
            same = ratio * units["rolls"] / units[name]
            click.echo(f"{n_i:5}{name:>8}{slides:8.1f}{ratio:9.2f}{same:10.2f}")


if __name__ == "__main__":
    main()
