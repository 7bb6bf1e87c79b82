"""`rattlesweep sensitivity`: which parameter of the bodies matters."""

from __future__ import annotations

from pathlib import Path

import click

from rattlesweep.cli.common import command, options, probe, to_json
from rattlesweep.cli.common.output import MOST_ROWS


@command(
    "Sweeps",
    "rattlesweep sensitivity out/design",
    "rattlesweep sensitivity out/design --json --figure indices.svg",
)
@options.directory
@options.figure
@options.as_json
def sensitivity(directory: Path, figure: Path | None, as_json: bool) -> None:
    """Tell which of the sampled parameters t_r and the types depend on.

    Prints Sobol' indices by case, with 95 % intervals (bootstrap): first-order ones, the share of
    the variance that goes with a parameter alone, and total ones, the share that would be left if
    all others were known. They need bodies.draw: saltelli in the sweep's config. Those of t_r and
    log10 t_r are told where nearly all runs reverse, those of P(R), P(SS), ... always.
    """
    from rattlesweep.analysis.sensitivity import as_text, save
    from rattlesweep.analysis.sensitivity import sensitivity as told

    probe(figure)
    found = told(directory)
    if figure is not None:
        save(found, figure)
    click.echo(to_json(found.data()) if as_json else as_text(found, MOST_ROWS))
