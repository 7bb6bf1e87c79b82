"""`rattlesweep classify`: other thresholds for stored runs."""

from __future__ import annotations

from pathlib import Path

import click

from rattlesweep.cli.common import DONE, OVERRIDES, guarded, print_summary, say


@click.command(
    epilog="\b\nExample:\n  rattlesweep classify out/quickstart --set classify.sw_departure=0.1"
)
@click.argument("directory", type=click.Path())
@OVERRIDES
@guarded
def classify(directory: str, overrides: tuple[str, ...]) -> int:
    """Classify the stored runs of a directory again, without integrating.

    Prints one row per case on standard output.
    """
    from rattlesweep.sweep.retype import retype

    changed, summary = retype(Path(directory), overrides)
    print_summary(summary, Path(directory))
    say(f"{changed} runs have changed their type")
    return DONE
