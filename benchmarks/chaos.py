"""Evidence for the criterion of chaos: growth of differences in the second half of SW
runs.

    rattlesweep run configs/steady.yaml --set 'record=[lyapunov]' --output out/lyapunov
    python benchmarks/chaos.py out/lyapunov

Prints histograms of the logarithm of the growth, and the growth in some of the runs
when they are followed to six times their horizon, past reversals.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
import pandas as pd

import rattlesweep as rs
from rattlesweep.paper.workspace import LAUNCH
from rattlesweep.sweeps.types import LEAST_GROWTH

EDGES = [-np.inf, -2, 0, 2, 4, 6, 8, 10, 15, 20, 40, np.inf]
LONGER = 6


def later(runs: pd.DataFrame) -> pd.Series:
    """Return the growth in the second half of longer runs from the same launches."""
    t_end = LONGER * runs["t_end"].to_numpy()
    longer = rs.simulate(runs[LAUNCH], t_end=t_end, record=["lyapunov", "reversals"])
    return longer.lyapunov_late * longer.t_end / 2


@click.command()
@click.argument("directory", type=click.Path(exists=True, path_type=Path))
@click.option("--runs", default=60, help="Runs of each kind to follow on.")
def main(directory: Path, runs: int) -> None:
    """Print the evidence from the output of a sweep."""
    frame = pd.concat(
        [pd.read_parquet(path) for path in sorted(directory.glob("runs/*.parquet"))],
        ignore_index=True,
    )
    growth = frame.lyapunov_late * frame.t_end / 2
    click.echo(f"borders of growth: {EDGES}")
    for kind, one in frame.groupby("type"):
        for n_i, few in one.groupby("n_i"):
            found = few.lyapunov_late * few.t_end / 2
            counts = np.histogram(found.dropna(), EDGES)[0]
            chaotic = int((found > LEAST_GROWTH).sum())
            click.echo(
                f"{kind:13} n_i {n_i:5}: {len(few):6} runs, chaotic {chaotic:4}, {counts}"
            )
    sw = frame.assign(growth=growth)[frame.type == "SW"]
    many = sw[sw.growth > LEAST_GROWTH]
    share = many.groupby(["n_i", many.K_r.round(3)]).size()
    click.echo(f"chaotic SW by n_i and K_r:\n{share.to_string()}")
    click.echo(f"their exponents by n_i:\n{many.groupby('n_i').lyapunov_late.median()}")
    for low, high in ((LEAST_GROWTH, np.inf), (4, LEAST_GROWTH), (-np.inf, 4)):
        chosen = sw[(sw.growth > low) & (sw.growth <= high)]
        chosen = chosen.sample(min(runs, len(chosen)), random_state=0)
        on = later(chosen)
        click.echo(
            f"growth {low:g} to {high:g}: {len(on)} runs, {LONGER} times as long: "
            f"{(on > LEAST_GROWTH).sum()} chaotic, {(on < 0).sum()} decay; "
            f"10, 50, 90 %: {np.quantile(on, [0.1, 0.5, 0.9]).round(1)}"
        )


if __name__ == "__main__":
    main()
