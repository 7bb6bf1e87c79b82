"""`rattlesweep body`: what theory says of one body."""

from __future__ import annotations

import json
from typing import Any

import click

from rattlesweep.cli import options
from rattlesweep.cli.common import DONE, guarded


@click.command(
    epilog="\b\nExamples:\n  rattlesweep body --preset GH\n  rattlesweep body --gamma 10 --f-sd "
    "0.1 --theta 0.8 --phi 0.05 --xi-deg -3 --json"
)
@options.body_options
@options.spin_options
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@guarded
def body(as_json: bool, n_i: float, omega_xy0: float, **given: Any) -> int:
    """Print derived quantities of one body: modes, torque coefficients, thresholds, reversal times.

    The spin and the oscillation, in sqrt(g/a), matter for the reversal times only.
    """
    from rattlesweep.study.derived import derived, make_body

    values = derived(make_body(given), n_i, omega_xy0)
    if as_json:
        click.echo(json.dumps({q.name: q.value for q in values}, indent=2, allow_nan=False))
        return DONE
    width = max(len(q.name) for q in values)
    for q in values:
        shown = "none" if q.value is None else f"{q.value:.10g}"
        click.echo(f"{q.name:<{width}}  {shown:>15}  {q.unit:<9}  {q.description}".rstrip())
    return DONE
