"""How much the types depend on their thresholds.

    rattlesweep run configs/steady.yaml
    python benchmarks/thresholds.py out/steady

Reads a finished sweep and prints, without integrating: how the fractions of the four
types move when each threshold of ``classify`` is halved and doubled, and where type SS
and Bondi's threshold differ.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pandas as pd

from rattlesweep.api import load
from rattlesweep.sweeps.config.schema import Classify
from rattlesweep.sweeps.types import TYPES, classify


def settings(default: Classify) -> Iterator[tuple[str, Classify]]:
    """Return the thresholds as they are, and with each of them halved and doubled."""
    yield "default", default
    for name in ("ss_growth", "sw_departure"):
        for factor in (0.5, 2.0):
            value = getattr(default, name) * factor
            yield f"{name} = {value:g}", default.model_copy(update={name: value})


def codes(runs: pd.DataFrame, thresholds: Classify) -> np.ndarray:
    """Types of the runs under some thresholds."""
    return classify(
        (runs["status"] == "ok").to_numpy(),
        runs["t_r"].to_numpy(float, na_value=np.nan),
        runs["amp_growth"].to_numpy(float, na_value=np.nan),
        runs["n_departure"].to_numpy(float, na_value=np.nan),
        thresholds,
    )


@click.command()
@click.argument("directory", type=click.Path(exists=True, path_type=Path))
def main(directory: Path) -> None:
    """Print how the types of a sweep depend on the thresholds."""
    sweep = load(directory)
    runs = sweep.runs
    default = Classify(**sweep.manifest["config"]["classify"])
    typed = codes(runs, default)

    click.echo(
        f"{len(runs)} runs of {sweep.manifest['name']}; fractions of each type\n"
    )
    click.echo(
        f"{'thresholds':<24}"
        + "".join(f"{name:>14}" for name in TYPES)
        + f"{'changed':>10}"
    )
    for words, thresholds in settings(default):
        now = codes(runs, thresholds)
        shares = [np.mean(now == k) for k in range(len(TYPES))]
        row = "".join(f"{share:14.5f}" for share in shares)
        click.echo(f"{words:<24}{row}{np.count_nonzero(now != typed):>10}")

    click.echo("\nlargest change of a fraction in any case (n_i, omega_xy0, target)")
    for words, thresholds in settings(default):
        now = codes(runs, thresholds)
        frame = pd.DataFrame({"case": runs["case"], "before": typed, "now": now})
        worst = [
            (
                frame["now"].eq(k).groupby(frame["case"]).mean()
                - frame["before"].eq(k).groupby(frame["case"]).mean()
            )
            .abs()
            .max()
            for k in range(len(TYPES))
        ]
        click.echo(f"{words:<24}" + "".join(f"{w:14.4f}" for w in worst))

    click.echo("\ntype SS against Bondi's threshold abs(n_c1) < abs(n_i), run by run")
    click.echo(
        f"{'omega_xy0':>9} {'n_i':>5} {'runs':>7} {'Bondi':>7} {'SS':>7} {'SS only':>8} "
        f"{'Bondi only':>10}"
    )
    bondi = (runs["n_c1"].abs() < runs["n_i"].abs()).fillna(False).to_numpy(bool)
    steady = typed == TYPES.index("SS")
    for (omega, n_i), group in runs.groupby(["omega_xy0", "n_i"]):
        here = runs.index.isin(group.index)
        only_ss = here & steady & ~bondi
        only_bondi = here & bondi & ~steady
        click.echo(
            f"{omega:9g} {n_i:5g} {here.sum():7d} {(here & bondi).sum():7d} "
            f"{(here & steady).sum():7d} {only_ss.sum():8d} {only_bondi.sum():10d}"
        )
    small = (runs["omega_xy0"] == 0.001).to_numpy() & (steady != bondi)
    click.echo(f"\nexceptions at omega_xy0 = 0.001: {small.sum()}")
    for _, run in runs[small].iterrows():
        click.echo(
            f"  case {run['case']} sample {run['sample']}: n_i {run['n_i']:g}, n_c1 "
            f"{run['n_c1']:.6f}, amp_growth {run['amp_growth']:.3g}"
        )


if __name__ == "__main__":
    main()
